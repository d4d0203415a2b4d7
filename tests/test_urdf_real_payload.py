"""A real UR10e with a known weight: what payload identification makes of motor currents."""

import json

import numpy as np
import pinocchio as pin
import pytest
from scipy.signal import butter, sosfiltfilt

from urdf import SerialJoint, build_serial_robot, identify_payload

DT_S = 0.01
LOW_PASS = butter(4, 5.0, fs=1.0 / DT_S, output="sos")


def smooth(x):
    return sosfiltfilt(LOW_PASS, x, axis=0)


@pytest.fixture(scope="module")
def table(recordings_dir):
    return json.loads((recordings_dir / "ur10e_mamedov2020" / "model.json").read_text())


@pytest.fixture(scope="module")
def ur10e(table):
    pinocchio_order = [9, 6, 7, 8, 0, 1, 3, 2, 4, 5]
    joints = [
        SerialJoint(
            name=row["name"],
            placement=pin.SE3(pin.rpy.rpyToMatrix(*row["rpy_rad"]), np.array(row["xyz_m"])),
            axis=np.array(row["axis"]),
            inertia=np.array(inertia)[pinocchio_order],
        )
        for row, inertia in zip(
            table["joints"][:6], table["inertial_parameters"]["rows"], strict=True
        )
    ]
    return build_serial_robot(
        joints, rotor_inertia_kg_m2=table["rotor_inertia_kg_m2"], check_inertias=False
    )


def identify(ur10e, table, recordings_dir, name):
    log = np.load(recordings_dir / "ur10e_mamedov2020" / f"{name}.npz")
    t = np.arange(log["t_s"][0], log["t_s"][-1], DT_S)
    q, dq, current = (
        np.column_stack([np.interp(t, log["t_s"], column) for column in log[key].T])
        for key in ("q_rad", "dq_rad_s", "current_A")
    )
    viscous, coulomb, offset = np.array(table["friction"]["rows"]).T
    friction = viscous * dq + coulomb * np.tanh(dq / 0.01) + offset
    tau = smooth(current * table["torque_constant_Nm_per_A"] - friction)
    dq = smooth(dq)
    return identify_payload(ur10e, smooth(q), dq, np.gradient(dq, DT_S, axis=0), tau)


def test_unloaded_arm_carries_nothing(ur10e, table, recordings_dir):
    estimate = identify(ur10e, table, recordings_dir, "unloaded")
    assert abs(estimate.unconstrained_parameters[0]) < 3.0 * estimate.mass_std_kg < 0.15
    assert estimate.payload.mass_kg < 0.1


def test_known_weight_is_found_up_to_the_scale_of_the_torque_constants(
    ur10e, table, recordings_dir
):
    """The constants read 12 to 16 % low, and so must the mass of 2.805 kg."""
    estimate = identify(ur10e, table, recordings_dir, "payload_2805g")
    assert estimate.is_identified
    assert 0.84 - 0.03 < estimate.payload.mass_kg / 2.805 < 0.88 + 0.03
    assert estimate.mass_std_kg < 0.1
    assert np.all(estimate.com_std_m < 0.01)
    # The centre of mass is a ratio of torques, so the scale cancels: it hangs beyond the wrist.
    assert 0.1 < estimate.payload.com_m[1] < 0.25
