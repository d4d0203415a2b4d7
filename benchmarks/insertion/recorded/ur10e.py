"""A real UR10e: motor currents with and without a known payload.

Its model is identified. Mamedov, Mikhel, "Practical aspects of model-based collision
detection", Front. Robot. AI 7:571574, 2020.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks import DataError
from benchmarks.insertion.methods import joint_residual
from benchmarks.insertion.recorded import add_link, read_arrays, read_table
from benchmarks.insertion.signals import JointSignals, tool_jacobians
from benchmarks.jobs import Figure, Job, make_figures
from foundation.arrays import Array
from residual import PUBLISHED, JointFriction, WrenchEstimator
from urdf import Robot, build_robot, identify_payload_static

FOLDER = "ur10e_mamedov2020"


class Ur10e(NamedTuple):
    """The recordings with their model.

    Attributes:
        robot: The arm with its rotors, tool frame at the end link.
        friction: Friction of its joints: torque comes from currents, so all of it is in
            there.
        unloaded: Signals without payload; torque is torque constant times current.
        loaded: Signals of the same motion with the payload.
    """

    robot: Robot
    friction: JointFriction
    unloaded: JointSignals
    loaded: JointSignals


def read_ur10e(data: Path) -> Ur10e:
    """Read recordings and model from the folder of recordings.

    Raises:
        DataError: A file is missing or lacks something.
    """
    folder = data / FOLDER
    table = read_table(folder / "model.json")
    try:
        constant = np.array(table["torque_constant_Nm_per_A"])
        viscous, coulomb, offset = np.array(table["friction"]["rows"]).T
        robot = _robot(table)
    except KeyError as error:
        raise DataError(f"{folder / 'model.json'} lacks {error}") from error
    friction = JointFriction(viscous_Nms=viscous, coulomb_Nm=coulomb, offset_Nm=offset)
    names = ("unloaded.npz", "payload_2805g.npz")
    return Ur10e(
        robot, friction, *(_signals(folder / name, constant) for name in names)
    )


def _signals(path: Path, torque_constant: np.ndarray) -> JointSignals:
    """Read signals; torque is torque constant times current."""
    t_s, q, dq, current = read_arrays(path, ("t_s", "q_rad", "dq_rad_s", "current_A"))
    return JointSignals(t_s=t_s, q_rad=q, dq_rad_s=dq, tau_Nm=current * torque_constant)


def _robot(table: dict[str, Any]) -> Robot:
    """Return the arm of the recording's model, with its rotors."""
    joints_count = 6
    pinocchio_order = (9, 6, 7, 8, 0, 1, 3, 2, 4, 5)  # of the ten inertial parameters
    inertias = np.array(table["inertial_parameters"]["rows"])[:, pinocchio_order]
    model = pin.Model()
    model.name = "ur10e"
    for row, inertia in zip(table["joints"][:joints_count], inertias, strict=True):
        link = pin.Inertia.FromDynamicParameters(inertia)
        add_link(model, row["name"], _placement(row), np.array(row["axis"]), link)
    # Identified parameters predict torque; not every link is a possible body.
    arm = build_robot(
        model,
        flange_frame=model.names[-1],
        tool_placement=_placement(table["joints"][joints_count]),
        check_inertias=False,
    )
    return arm.with_armature(table["rotor_inertia_kg_m2"])


def _placement(row: dict[str, Any]) -> pin.SE3:
    """Return the placement of a joint from a row of the model."""
    return pin.SE3(pin.rpy.rpyToMatrix(*row["rpy_rad"]), np.array(row["xyz_m"]))


GAIN_per_s = 20.0
"""That of the known-good figures."""


def run(job: Job) -> list[Figure]:
    """Run ``ur10e-payload``: the weight of a known payload from motor currents.

    Torque is torque constant times current, and the constants read 12 to 16 % low. The
    arm's own model was identified with the same constants, so model and measurement
    agree without payload whatever their common scale; only a known weight shows it. One
    factor on all joint torques (measured, model and friction alike, hence on the
    residual) is therefore all there is to fit.
    """
    arm = read_ur10e(job.recordings)
    residual_unloaded, residual_loaded = (
        joint_residual(arm.robot, signals, GAIN_per_s, arm.friction)
        for signals in (arm.unloaded, arm.loaded)
    )
    values = _force_up(arm.robot, arm.unloaded, residual_unloaded, "force_up_unloaded")
    values |= _force_up(arm.robot, arm.loaded, residual_loaded, "force_up_loaded")
    # What the model misses at each joint without payload: the weights of the fit.
    noise = residual_unloaded[_settled(arm.unloaded)].std(axis=0)
    middle = len(residual_loaded) // 2
    settled = np.flatnonzero(_settled(arm.loaded))
    first, second = (
        _payload_kg(arm.robot, arm.loaded.q_rad[half], residual_loaded[half], noise)
        for half in (settled[settled < middle], settled[settled >= middle])
    )
    payload_kg = 2.805
    scale = payload_kg / first
    values["torque_scale"] = scale
    values["weight_error_pct"] = 100.0 * (scale * second / payload_kg - 1.0)
    return make_figures(values)


def _settled(signals: JointSignals) -> NDArray[np.bool_]:
    """Return which samples the observer has settled at, shape (n,)."""
    return signals.t_s - signals.t_s[0] >= 5.0 / GAIN_per_s  # five lags


def _force_up(
    robot: Robot, signals: JointSignals, residual: Array, name: str
) -> dict[str, float]:
    """Return mean and scatter of the vertical force in base axes.

    By equation (13), with a torque scale of 1.
    """
    wrench = WrenchEstimator(robot, PUBLISHED)
    jacobians = tool_jacobians(robot, signals.q_rad)
    # Nearer to a singular pose an undamped inverse only amplifies noise.
    regular = np.linalg.svd(jacobians, compute_uv=False)[:, -1] > 0.1
    used = _settled(signals) & regular
    samples = zip(signals.q_rad[used], residual[used], strict=True)
    force = np.array([wrench.estimate(q, r).force[2] for q, r in samples])
    return {f"{name}_N": float(force.mean()), f"{name}_std_N": float(force.std())}


def _payload_kg(robot: Robot, q_rad: Array, residual: Array, noise_Nm: Array) -> float:
    """Return the mass whose weight explains the residuals of many poses together.

    Singular poses are included. The residual is what an arm at rest would feel more
    than its own gravity, with opposite sign.
    """
    data = robot.create_data()
    gravity = np.array(
        [pin.computeGeneralizedGravity(robot.model, data, q) for q in q_rad]
    )
    payload = identify_payload_static(
        robot, q_rad, gravity - residual, torque_noise_std_Nm=noise_Nm
    )
    return float(payload.parameters[0])
