"""docs/panda.md runs as it stands, and what it measures is what it hung there."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import urdf
from residual import TareError
from urdf import MissingPackageError, example_robot_path

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "panda.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def names():
    """What the page's blocks leave behind, run one after another."""
    try:
        example_robot_path("panda")
    except MissingPackageError as error:
        pytest.skip(str(error))
    names = {}
    for code in re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE):
        exec(compile(code, "panda.md", "exec"), names)
    return names


def test_the_arms_are_what_the_page_says(names):
    arm, bent = names["arm"], names["bent"]
    assert (arm.flange_frame, arm.tool_frame) == ("panda_link8", "needle_tip")
    bare = urdf.load_example("panda", without=["panda_hand"])
    added = pin.computeTotalMass(arm.model) - pin.computeTotalMass(bare.model)
    assert added == pytest.approx(0.040)
    flange = bent.model.frames[bent.frame_id("panda_link8")].placement
    tip = flange.actInv(bent.model.frames[bent.tool_frame_id].placement)
    assert tip.translation == pytest.approx([0.150, 0, 0.05])
    assert tip.rotation @ [0, 0, 1] == pytest.approx([1, 0, 0])
    data = arm.create_data()
    pin.framesForwardKinematics(arm.model, data, names["READY"])
    assert data.oMf[arm.tool_frame_id].rotation[2, 2] == pytest.approx(-1.0, abs=0.01)


def test_torque_at_rest_is_gravity(names):
    assert names["tau"] == pytest.approx(names["gravity"](names["arm"], names["q"]), abs=0.2)


@pytest.mark.parametrize(
    ("force", "weight_N", "tolerance_N"),
    [("force", 1.961, 0.1), ("force_compensated", 1.961, 0.1), ("force_ur", 19.61, 1.0)],
)
def test_a_hung_weight_reads_as_its_weight(names, force, weight_N, tolerance_N):
    assert names[force] == pytest.approx(np.array([0.0, 0.0, -weight_N]), abs=tolerance_N)


def test_a_stream_without_gravity_needs_the_option(names):
    with pytest.raises(TareError, match="set torque_is_gravity_compensated=True"):
        names["weigh"](names["arm"], names["compensated"], names["three"])


def test_names_and_links_of_the_page_exist(names):
    for name in re.findall(r"names: ([\w, ]+) \|", PAGE)[0].split(", "):
        assert urdf.load_example(name).nv >= 6
    assert callable(urdf.identify_payload_static)
