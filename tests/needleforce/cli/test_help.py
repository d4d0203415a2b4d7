"""What `--help` lists works: arms, units, robots and defaults are those of the code."""

import re
from dataclasses import fields, is_dataclass

import pytest

from needleforce.cli import main, shared_options
from needleforce.cli.patient import options
from needleforce.recordings.channels import CHANNELS
from needleforce.sensor_replay import AUTOMATIC_TARE_S
from residual import DEFAULT
from urdf import load_example

FILES = (shared_options, options)
OPTIONS = {
    kind.__name__: kind
    for file in FILES
    for kind in vars(file).values()
    if is_dataclass(kind) and "Attributes:" in (kind.__doc__ or "")
}


def help_of(command, capsys):
    """The text of `--help`, each paragraph in one line."""
    assert main([command, "--help"]) == 0
    return " ".join(re.sub("[│╭╮╰╯─]", " ", capsys.readouterr().out).split())


@pytest.mark.parametrize("command", ["live", "record", "touch", "lag"])
def test_every_arm_is_listed(command, capsys):
    kinds = ("fri", "iiwa", "fr3", "franka", "ur", "ros2", "sim")
    listed = help_of(command, capsys).split("ARM", 1)[-1]

    for kind in kinds:
        assert re.search(rf"\b{kind}\b(?=[ :,.\[])", listed), kind


def attributes_of(kind):
    """Text of each field of a class, in its docstring."""
    listed = kind.__doc__.split("Attributes:")[1]
    found = re.findall(r"^ {8}(\w+): (.*(?:\n {12}.*)*)", listed, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in found}


@pytest.mark.parametrize("kind", OPTIONS.values(), ids=OPTIONS)
def test_defaults_that_are_stated_are_those_of_the_code(kind):
    defaults = {item.name: item.default for item in fields(kind)}
    for name, text in attributes_of(kind).items():
        for stated in re.findall(r"default: (-?[\d.]*\d)(?![\d ]*,? \d)", text):
            if isinstance(defaults[name], int | float):
                assert defaults[name] == float(stated), name


def test_defaults_of_the_sensor_are_those_of_its_config(capsys):
    text = help_of("force", capsys)

    assert f"(lag 1/K; default: {DEFAULT.gain_per_s:g})" in text
    assert f"the first {AUTOMATIC_TARE_S:g} s after the filters have settled" in text


@pytest.mark.parametrize(
    "kind", [shared_options.JointColumns, shared_options.DepthColumns]
)
def test_units_that_are_listed_are_read(kind):
    listed = attributes_of(shared_options.Columns) | attributes_of(kind)
    checked = 0
    for name in listed.keys() & CHANNELS.keys():
        for units in re.findall(r"\(([^()]*)\)\.?", listed[name])[:1]:
            for unit in (unit for unit in units.split(", ") if " " not in unit):
                assert CHANNELS[name].units.find(unit) is not None, (name, unit)
                checked += 1

    assert checked >= 15


def test_robots_that_are_listed_exist():
    text = attributes_of(shared_options.RobotOptions)["robot"].replace("lwr (", "")
    names = re.findall(r"\b(panda|ur\w+|xarm7)\b", text)

    assert len(names) == 7
    assert all(load_example(name).nv >= 6 for name in names)
