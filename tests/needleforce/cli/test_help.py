"""What `--help` lists works: arms, units, robots and defaults are those of the code."""

import re
from dataclasses import is_dataclass
from inspect import signature

import pytest

from needleforce.cli import commands, main, options
from needleforce.recordings import CHANNELS
from residual import DEFAULT
from urdf import load_example

COMMANDS = {
    name.removesuffix("_command"): value
    for name, value in vars(commands).items()
    if name.endswith("_command")
}


def help_of(command, capsys):
    """The text of `--help`, each paragraph in one line."""
    assert main([command, "--help"]) == 0
    return " ".join(re.sub("[│╭╮╰╯─]", " ", capsys.readouterr().out).split())


@pytest.mark.parametrize("command", ["live", "record", "touch", "lag"])
def test_every_arm_is_listed(command, capsys):
    listed = help_of(command, capsys).split("ARM", 1)[-1]
    words = re.findall(r"\b\w+\b(?=[ :,.\[])", listed)

    assert {"fri", "iiwa", "fr3", "franka", "ur", "ros2", "sim"} <= set(words)


def listed_in(docstring):
    """Text of each parameter or field that a docstring lists."""
    found = re.findall(r"^ {8}(\w+): (.*(?:\n {12}.*)*)", docstring, re.MULTILINE)
    return {name: " ".join(text.split()) for name, text in found}


def attributes_of(kind):
    return listed_in(kind.__doc__.partition("Attributes:")[2])


@pytest.mark.parametrize("command", COMMANDS)
def test_defaults_that_are_stated_are_those_of_the_code(command):
    parameters = signature(COMMANDS[command]).parameters.values()
    defaults = {each.name: each.default for each in parameters}
    texts = listed_in(COMMANDS[command].__doc__)
    for value in [each for each in defaults.values() if is_dataclass(each)]:
        defaults |= vars(value)
        texts |= attributes_of(type(value))
    for name, text in texts.items():
        for stated in re.findall(r"default: (-?[\d.]*\d)(?![\d ]*,? \d)", text):
            if isinstance(defaults[name], int | float):
                assert defaults[name] == float(stated), name


def test_defaults_of_the_sensor_are_those_of_its_config(capsys):
    text = help_of("force", capsys)

    assert f"(lag 1/K; default: {DEFAULT.gain_per_s:g})" in text


@pytest.mark.parametrize("kind", [options.JointColumns, options.DepthColumns])
def test_units_that_are_listed_are_read(kind):
    listed = attributes_of(options.Columns) | attributes_of(kind)
    found = {
        (name, unit): CHANNELS[name].units.find(unit)
        for name in listed.keys() & CHANNELS.keys()
        for units in re.findall(r"\(([^()]*)\)\.?", listed[name])[:1]
        for unit in units.split(", ")
        if " " not in unit
    }

    assert len(found) >= 15
    assert [key for key, unit in found.items() if unit is None] == []


def test_robots_that_are_listed_exist():
    text = attributes_of(options.RobotOptions)["robot"].replace("lwr (", "")
    names = re.findall(r"\b(panda|ur\w+|xarm7)\b", text)

    assert len(names) == 7
    assert all(load_example(name).nv >= 6 for name in names)
