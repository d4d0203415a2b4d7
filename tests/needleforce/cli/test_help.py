"""What `--help` lists works: arms, units, robots and defaults are those of the code."""

import re
from dataclasses import fields, is_dataclass

import pytest

from needleforce.cli import live as live_file
from needleforce.cli import main, plan, register, shared_options, simulate, touch, view
from needleforce.devices.arm_names import CALLED_KINDS, LISTENING_KINDS
from needleforce.recordings.channels import CHANNELS
from needleforce.sensor_replay import AUTOMATIC_TARE_S
from residual import DEFAULT
from tests.needleforce.cli.residual_command_log import refusal
from urdf import load_example

ARMS = {*LISTENING_KINDS, *CALLED_KINDS}
FILES = (live_file, plan, register, shared_options, simulate, touch, view)
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


def arms_named(text):
    """The kinds of arm in a help or a message."""
    kinds = r"\b(fri|iiwa|fr3|franka|ur|ros2|sim)\b(?=[ :,.\[])"
    return set(re.findall(kinds, text.split("ARM", 1)[-1]))


@pytest.mark.parametrize("command", ["live", "record", "touch"])
def test_an_arm_that_is_listened_to_is_any(command, capsys):
    assert arms_named(help_of(command, capsys)) == {*ARMS, "ros2", "sim"}


def test_lag_lists_the_arms_that_it_moves(capsys):
    assert arms_named(help_of("lag", capsys)) == {*ARMS, "ros2", "sim"}


@pytest.mark.parametrize(
    ("argv", "kinds"),
    [
        (["live", "nao"], {*ARMS, "ros2", "sim"}),
        (["lag", "nao", "--yes"], {*ARMS, "ros2", "sim"}),
    ],
)
def test_a_refused_arm_hears_which_are_taken(argv, kinds, capsys):
    assert arms_named(f"ARM {refusal(argv, capsys).split('expected')[1]} ") == kinds


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


@pytest.mark.parametrize("command", ["force", "identify"])
def test_units_that_are_listed_are_read(command, capsys):
    kind = {
        "force": shared_options.JointColumns,
        "identify": shared_options.DepthColumns,
    }[command]
    listed = {**attributes_of(shared_options.Columns), **attributes_of(kind)}
    checked = 0
    for name, text in listed.items():
        units = re.findall(r"\(([^()]*)\)\.?", text)
        for unit in units[0].split(", ") if units and name in CHANNELS else ():
            if " " not in unit:
                assert CHANNELS[name].units.find(unit) is not None, (name, unit)
                checked += 1

    assert checked >= 15


def test_robots_that_are_listed_exist():
    text = attributes_of(shared_options.RobotOptions)["robot"].replace("lwr (", "")
    names = re.findall(r"\b(panda|ur\w+|xarm7)\b", text)

    assert len(names) == 7
    assert all(load_example(name).nv >= 6 for name in names)


@pytest.mark.parametrize(
    ("argv", "said"),
    [
        (["lag", "sim:gel-25-constant", "--yes"], "moves in free air"),
        (["demo", "--data", "ct"], "needleforce demo abdomen"),
        (["simulate", "torso", "-o", "x", "--plant", "fri"], "leave --plant out"),
        (["simulate", "torso", "-o", "x", "--truth", "y"], "leave --truth out"),
        (["simulate", "p.json", "-o", "x.csv", "--seed", "1"], "leave --seed out"),
        (["simulate", "p.json", "-o", "x.csv", "--plant", "fri"], "leave --plant out"),
    ],
)
def test_an_option_that_would_change_nothing_is_refused(argv, said, capsys):
    assert said in refusal(argv, capsys)
