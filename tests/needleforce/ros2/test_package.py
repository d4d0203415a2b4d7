"""Launch file and ROS package, and a layout against the bags."""

import json
import runpy
import sys
import tomllib
from configparser import ConfigParser
from dataclasses import replace
from importlib import import_module
from types import SimpleNamespace
from typing import NamedTuple
from xml.etree import ElementTree

import pytest

from needleforce.cli import main
from tests.insertion_run import cut, short_run
from tests.needleforce.ros2.layouts import FOLDER, RVIZ_TYPES, foxglove_topics


@pytest.mark.slow
def test_foxglove_shows_topics_of_the_bags(tmp_path, monkeypatch):
    reader = pytest.importorskip("mcap.reader")
    monkeypatch.setattr("needleforce.cli.logs.simulated_log.simulate", _begin_run)
    monkeypatch.chdir(tmp_path)
    for command in (
        "simulate gel-25-constant -o insertion.mcap",
        "force insertion.mcap --no-tare -o forces.mcap",
        "identify forces.mcap --ignore-status -o layers.mcap",
    ):
        assert main(command.split()) == 0
    written = {}
    for path in tmp_path.glob("*.mcap"):
        with path.open("rb") as stream:
            summary = reader.make_reader(stream).get_summary()
        for channel in summary.channels.values():
            kind = summary.schemas[channel.schema_id].name
            written[channel.topic] = kind.rsplit("/", 1)[-1]
    topics = foxglove_topics(json.loads((FOLDER / "foxglove_bag.json").read_bytes()))

    assert {topic: written.get(topic) for topic in topics} == {
        topic: RVIZ_TYPES[use] for topic, use in topics.items()
    }
    assert "/tf" in written


def _begin_run(chosen, *, plant, seed):
    """Two seconds of an insertion."""
    run = short_run()
    rows = slice(2000)
    return replace(run, signals=cut(run.signals, rows), truth=cut(run.truth, rows))


class LaunchAction(dict):
    """An action of a launch file, with its arguments."""

    def __init__(self, *names, **arguments):
        super().__init__(arguments, names=names)


class GivenArgument(NamedTuple):
    """A substitution for an argument of `ros2 launch`."""

    name: str

    def perform(self, context):
        return context[self.name]


@pytest.fixture
def launched(monkeypatch):
    """What the launch file starts with arguments; the launch of ROS 2 is a fake."""
    modules = {
        "launch": {"LaunchDescription": list},
        "launch.actions": {
            "DeclareLaunchArgument": LaunchAction,
            "OpaqueFunction": LaunchAction,
        },
        "launch.substitutions": {"LaunchConfiguration": GivenArgument},
        "launch_ros.actions": {"Node": LaunchAction},
    }
    for name, contents in modules.items():
        monkeypatch.setitem(sys.modules, name, SimpleNamespace(**contents))

    def launch(**given):
        file = runpy.run_path(str(FOLDER / "needleforce.launch.py"))
        *declared, starting = file["generate_launch_description"]()
        context = {each["names"][0]: each["default_value"] for each in declared}
        assert given.keys() <= context.keys()
        [node] = starting["function"](context | given)
        return node

    return launch


def test_the_launch_file_starts_the_node_of_the_package(launched):
    node = launched(urdf="arm.urdf", joint_states="/arm/joint_states")

    assert (node["package"], node["executable"]) == ("needleforce", "node")
    assert node["arguments"] == ["--tool-frame", "needle_tip", "--urdf", "arm.urdf"]
    assert node["parameters"] == []
    assert ("joint_states", "/arm/joint_states") in node["remappings"]
    assert launched(parameters="mine.yaml")["parameters"] == ["mine.yaml"]


def test_the_ros_package_has_what_ros_looks_for(monkeypatch):
    setup = {}
    fake = SimpleNamespace(setup=lambda **arguments: setup.update(arguments))
    monkeypatch.setitem(sys.modules, "setuptools", fake)
    runpy.run_path(str(FOLDER / "setup.py"))
    package = ElementTree.parse(FOLDER / "package.xml").getroot()
    scripts = ConfigParser(interpolation=None)
    scripts.read(FOLDER / "setup.cfg")
    installed = dict(setup["data_files"])
    [(executable, where)] = [
        script.split(" = ") for script in setup["entry_points"]["console_scripts"]
    ]
    module, function = where.split(":")

    assert package.findtext("name") == "needleforce"
    assert package.findtext("export/build_type") == "ament_python"
    assert package.findtext("version") == setup["version"] == metadata_version()
    # ros2 run finds a package by its marker, and executables in lib/PACKAGE.
    marker = "share/ament_index/resource_index/packages"
    assert installed[marker] == ["resource/needleforce"]
    assert "package.xml" in installed["share/needleforce"]
    assert scripts["install"]["install_scripts"] == "$base/lib/needleforce"
    assert executable == "node"
    assert callable(getattr(import_module(module), function))
    for files in installed.values():
        assert all((FOLDER / file).is_file() for file in files)


def metadata_version():
    """Version of the Python package."""
    project = tomllib.loads((FOLDER.parents[1] / "pyproject.toml").read_text())
    return project["project"]["version"]
