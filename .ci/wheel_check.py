"""What an installed wheel must do on its own, with the core dependencies only.

Run from another directory by an interpreter into which nothing but the wheel was
installed.
"""

import json
import subprocess
import sys
from importlib.metadata import files, metadata
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pinocchio

import foundation
import identification
import residual
import urdf
from needleforce import InsertionSession
from residual import Status
from urdf import NeedleTool, load_lwr

NAME = "needleforce"


def check_files() -> None:
    """The wheel holds the licence, the robot and the type markers, and no tests."""
    shipped = [str(path) for path in files(NAME) or ()]
    assert any(path.endswith("licenses/LICENSE") for path in shipped), (
        "no LICENSE in the wheel"
    )
    assert metadata(NAME)["License-Expression"] == "Apache-2.0"
    assert "urdf/data/lwr4plus.urdf" in shipped
    assert {f"needleforce/plots/{n}" for n in ("page.html", "chart.mplstyle")} <= set(
        shipped
    )
    for room in (
        "foundation",
        "urdf",
        "residual",
        "identification",
        "groundtruth",
        "needleforce",
    ):
        assert f"{room}/py.typed" in shipped, room
    assert not [path for path in shipped if path.startswith(("tests", "benchmarks"))]


def check_imported_from_the_wheel() -> None:
    """No package comes from the repository."""
    for package in (foundation, urdf, residual, identification):
        assert "site-packages" in Path(package.__file__ or "").parts, package.__file__


def check_a_force() -> None:
    """An arm at rest that carries its own weight reads no force."""
    robot = load_lwr(payload=NeedleTool())
    sensor = InsertionSession(robot)
    q = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0])
    nothing = np.zeros(robot.nv)
    weight = pinocchio.computeGeneralizedGravity(robot.model, robot.create_data(), q)
    for _ in range(1500):
        sensor.update(q, nothing, weight, 1e-3)
    sensor.tare()
    wrench = sensor.update(q, nothing, weight, 1e-3).wrench
    assert wrench.status is Status.OK, wrench.message
    assert abs(wrench.axial) < 1e-6, wrench.axial


def check_commands() -> None:
    """The command starts without the optional extras."""
    beside = Path(sys.executable).parent / "needleforce"
    for command in (
        [str(beside), "force", "--help"],
        [sys.executable, "-I", "-m", "needleforce", "identify", "--help"],
    ):
        said = subprocess.run(
            command, capture_output=True, text=True, check=True
        ).stdout
        assert "LOG" in said, command
    found = subprocess.run(
        [str(beside), "doctor", "--json"], capture_output=True, text=True, check=True
    ).stdout
    extras = [text for text in json.loads(found).values() if text.startswith("extra,")]
    assert extras
    assert all("not installed" in text for text in extras), extras
    refused = subprocess.run([str(beside), "demo"], capture_output=True, text=True)
    assert refused.returncode == 2, refused.stderr
    assert "pip install 'needleforce[demo]'" in refused.stderr, refused.stderr


def check_light() -> None:
    """The core brings nothing that only extras need."""
    heavy = ("trimesh", "shapely", "lxml", "PIL", "matplotlib", "yourdfpy", "mujoco")
    assert not [name for name in heavy if find_spec(name) is not None]


if __name__ == "__main__":
    check_files()
    check_imported_from_the_wheel()
    check_a_force()
    check_commands()
    check_light()
    sys.stdout.write(f"{NAME} works as installed from its wheel\n")
