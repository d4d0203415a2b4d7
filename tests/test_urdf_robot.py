"""Robot and the package's names: checked, nothing changes behind one's back, copies as asked."""

from dataclasses import FrozenInstanceError

import numpy as np
import pinocchio as pin
import pytest

import urdf
from urdf import InputError, NeedleTool, Payload, Robot, UnknownNameError, load_lwr

ROTOR = np.array([3.19, 3.05, 1.98, 2.05, 0.787, 0.391, 0.394])


def test_public_names_are_documented_and_errors_have_one_base():
    assert len(set(urdf.__all__)) == len(urdf.__all__)
    for name in urdf.__all__:
        assert getattr(urdf, name).__doc__
        assert not name.endswith("Error") or issubclass(getattr(urdf, name), urdf.UrdfError)


def test_unknown_frame_lists_the_valid_ones(lwr):
    with pytest.raises(UnknownNameError, match=r"no frame 'tip' .*flange, ft_sensor, needle_tip"):
        lwr.frame_id("tip")
    for which in ("tool_frame", "flange_frame"):
        names = {"tool_frame": "flange", "flange_frame": "flange"} | {which: "nowhere"}
        with pytest.raises(UnknownNameError, match="'nowhere'"):
            Robot(bare_model=lwr.bare_model, **names)


def test_robot_is_frozen_and_its_arrays_read_only(lwr):
    with pytest.raises(FrozenInstanceError):
        lwr.tool_frame = "flange"
    ranges = [f"position_{end}_rad" for end in ("lower", "upper")]
    for name in (*ranges, "velocity_limit_rad_s", "effort_limit_Nm", "gravity_m_s2"):
        with pytest.raises(ValueError, match="read-only"):
            getattr(lwr, name)[0] = 1.0


def test_robot_keeps_a_copy_of_the_model_it_was_given(lwr):
    given = pin.Model(lwr.bare_model)
    robot = Robot(bare_model=given, tool_frame="flange", flange_frame="flange")
    given.inertias[7] = pin.Inertia.Zero()
    given.gravity = pin.Motion.Zero()
    assert robot.model.inertias[7].mass == pytest.approx(0.2806)
    assert robot.gravity_m_s2[2] == pytest.approx(-9.80665)


def test_tool_frame_id_points_at_the_tool_frame(lwr):
    assert lwr.model.frames[lwr.tool_frame_id].name == lwr.tool_frame == "needle_tip"


def test_create_data_is_fresh_each_time(lwr):
    first, second = lwr.create_data(), lwr.create_data()
    pin.crba(lwr.model, first, np.zeros(7))
    assert np.all(second.M == 0.0)


def test_with_payload_replaces_and_leaves_the_original_alone(lwr):
    heavy = Payload(mass_kg=2.0, com_m=np.zeros(3), inertia_kg_m2=0.01 * np.eye(3))
    before = pin.computeTotalMass(lwr.model)
    loaded = lwr.with_payload(heavy)
    assert pin.computeTotalMass(loaded.model) == pytest.approx(14.0503 + 2.0)
    assert pin.computeTotalMass(lwr.model) == before
    assert loaded.payload is heavy
    assert loaded.tool_frame == "needle_tip"
    bare = loaded.with_payload(None)
    assert bare.model.inertias[7].isApprox(load_lwr().model.inertias[7])
    with pytest.raises(InputError, match=r"NeedleTool .*\.payload"):
        lwr.with_payload(NeedleTool())


def test_armature_is_added_to_the_diagonal_of_the_mass_matrix_only(lwr):
    q = np.array([0.3, -0.4, 0.5, 1.2, -0.7, 0.9, 0.2])
    robots = (lwr, lwr.with_armature(ROTOR))
    matrices = [pin.crba(r.model, r.create_data(), q) for r in robots]
    assert matrices[1] - matrices[0] == pytest.approx(np.diag(ROTOR), abs=1e-12)
    gravity = [pin.computeGeneralizedGravity(r.model, r.create_data(), q) for r in robots]
    assert gravity[0] == pytest.approx(gravity[1])


def test_armature_and_payload_do_not_undo_each_other(lwr):
    assert lwr.with_armature(ROTOR).with_payload(None).model.armature == pytest.approx(ROTOR)
    assert lwr.with_payload(None).with_armature(ROTOR).payload is None


@pytest.mark.parametrize("rotor", [[1.0] * 6, [1.0] * 6 + [np.nan], [1.0] * 6 + [-1.0], "seven"])
def test_bad_armature_is_refused(lwr, rotor):
    with pytest.raises(InputError, match="rotor_inertia_kg_m2"):
        lwr.with_armature(rotor)
