"""A real Franka Panda in free motion, and its identified model.

Gaz, Cognetti, Oliva, Robuffo Giordano, De Luca, "Dynamic identification of the Franka
Emika Panda robot with retrieval of feasible parameters using penalty-based
optimization", RA-L 2019.
"""

from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from benchmarks import DataError
from benchmarks.insertion.methods import (
    IDENTIFIERS,
    METHODS,
    joint_residual,
    run_session,
    wrench_metrics,
)
from benchmarks.insertion.recorded import add_link, read_arrays, read_table
from benchmarks.insertion.recorded.liver import (
    LiverInsertion,
    REST_s,
    friction_values,
    liver_estimates,
    liver_reference,
    read_liver,
    rupture_values,
)
from benchmarks.insertion.signals import ForceTruth, JointSignals, tool_jacobians
from benchmarks.jobs import Figure, Job, Method, make_figures
from foundation.arrays import Array
from residual import SigmoidFriction
from urdf import Robot, build_robot

FOLDER = "panda_gaz2019"


class Panda(NamedTuple):
    """The recording with its model.

    Attributes:
        robot: The arm, tool frame at the flange.
        friction: Friction left between torque sensor and link.
        signals: 21 s of free motion.
    """

    robot: Robot
    friction: SigmoidFriction
    signals: JointSignals


def read_panda(data: Path) -> Panda:
    """Read recording and model from the folder of recordings.

    Raises:
        DataError: A file is missing or lacks something.
    """
    folder = data / FOLDER
    t_s, q, dq, tau = read_arrays(
        folder / "free_motion.npz", ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    )
    table = read_table(folder / "model.json")
    try:
        robot = _robot(table)
        numbers = table["friction"]
        keys = ("A_Nm", "alpha_s_rad", "s_rad_s")
        amplitude, slope, shift = (np.array(numbers[key]) for key in keys)
    except KeyError as error:
        raise DataError(f"{folder / 'model.json'} lacks {error}") from error
    friction = SigmoidFriction(
        amplitude_Nm=amplitude, slope_s_rad=slope, shift_rad_s=shift
    )
    return Panda(
        robot, friction, JointSignals(t_s=t_s, q_rad=q, dq_rad_s=dq, tau_Nm=tau)
    )


def _robot(table: dict[str, Any]) -> Robot:
    """Return the arm of the recording's model."""
    model = pin.Model()
    model.name = "panda"
    for k, (alpha, a, d) in enumerate(
        zip(table["alpha_rad"], table["a_m"], table["d_m"], strict=True)
    ):
        about_x = pin.SE3(pin.utils.rotate("x", alpha), np.array([a, 0.0, 0.0]))
        placement = about_x * pin.SE3(np.eye(3), np.array([0.0, 0.0, d]))
        xx, xy, xz, yy, yz, zz = table["inertia_kg_m2"][k]
        about_com = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
        link = pin.Inertia(table["mass_kg"][k], np.array(table["com_m"][k]), about_com)
        add_link(model, f"joint_{k + 1}", placement, np.array([0.0, 0.0, 1.0]), link)
    # Of Franka's documentation; the tare takes the range of the torque sensors from it.
    model.upperEffortLimit = np.array((87.0, 87.0, 87.0, 87.0, 12.0, 12.0, 12.0))
    # From frame 7 to the flange, of Franka's documentation; the recording has no tool.
    flange = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.107]))
    # Identified parameters predict torque; not every link is a possible body.
    return build_robot(
        model, flange_frame="joint_7", tool_placement=flange, check_inertias=False
    )


def run(job: Job) -> list[Figure]:
    """Run ``panda-real``: noise floor of the residual without contact, per joint."""
    panda = read_panda(job.recordings)
    signals = panda.signals
    gain_per_s = 30.0  # that of the known-good figures
    residual = joint_residual(panda.robot, signals, gain_per_s, panda.friction)
    # After five lags the observer has forgotten its start to 1 %.
    settled = signals.t_s - signals.t_s[0] >= 5.0 / gain_per_s
    rms = np.sqrt(np.mean(residual[settled] ** 2, axis=0))
    values = {
        f"residual_rms_J{joint}_Nm": float(value) for joint, value in enumerate(rms, 1)
    }
    return make_figures(values)


def identification_values(
    insertion: LiverInsertion, truth: ForceTruth, forces_N: Mapping[Method, Array]
) -> Iterator[Figure]:
    """Yield friction and ruptures by both methods.

    They come from the force itself and from each method's own sensor.
    """
    felt = truth.t_s >= truth.zeroed_s
    course = truth.t_s[felt], truth.depth_m[felt]
    force_N = truth.axial_N[felt]
    reference = liver_reference(insertion, course[1], force_N)
    for method in IDENTIFIERS:
        sources = {"ft": force_N, "virtual": forces_N[method][felt]}
        for source, felt_N in sources.items():
            item = liver_estimates(*course, felt_N, method, reference)
            values = friction_values([item]) | rupture_values([item])
            del values["pullout_error_p90_pct"]  # of one insertion there is none
            yield from make_figures(values, source, method)


TARE_s = 4.0
"""Free motion before the tare."""
FREE_s = 1.0
"""Free motion between tare and insertion: about the rest at the start of every liver
recording, from which the identifiers learn the noise of the force. 16 s are left, 80 mm
at 5 mm/s."""


def run_with_liver(job: Job) -> Iterator[Figure]:
    """Run ``panda-liver``: a real tissue force on a real arm, by both methods.

    The recorded Panda has touched nothing, the recorded needle had no robot. Both are
    combined: a force F on the flange acts on the joints as ``J' F``, and reduces the
    measured torque by just that, ``tau = tau_free - J' F``. Tissue that resists with f
    pushes along minus the flange's z axis, so ``tau = tau_free + f J_z'``.

    The whole chain runs on it: joint signals in, enhanced force out, beside the same
    force as an F/T sensor would have read it. Only the depth is the recorded needle's:
    the Panda moves otherwise.
    """
    panda = read_panda(job.recordings)
    insertion = read_liver(job.recordings, job.seed)
    truth = _truth(panda, insertion)
    along = tool_jacobians(panda.robot, panda.signals.q_rad)[:, 2]
    loaded = panda.signals.tau_Nm + truth.axial_N[:, None] * along
    signals = replace(panda.signals, tau_Nm=loaded)
    forces_N = {}
    for method, config in METHODS.items():
        sensor = replace(config, friction=panda.friction)
        session = run_session(panda.robot, signals, method, TARE_s, sensor=sensor)
        forces_N[method] = session.unsmoothed_N
        for item in wrench_metrics(session.reading, truth):
            # The force changes less than this arm's noise: its lag would be a guess.
            if item.metric != "wrench_lag_ms":
                yield item
    yield from identification_values(insertion, truth, forces_N)


def _truth(panda: Panda, insertion: LiverInsertion) -> ForceTruth:
    """Return the liver's force at the Panda's time stamps.

    There is none before the insertion.
    """
    t_s = panda.signals.t_s
    since = t_s - TARE_s
    force_N = insertion.force_N - np.mean(insertion.force_N[insertion.t_s < REST_s])
    return ForceTruth(
        t_s=t_s,
        depth_m=np.interp(since, insertion.t_s, insertion.depth_m, left=0.0),
        axial_N=np.interp(since, insertion.t_s, force_N, left=0.0),
        zeroed_s=TARE_s,
        start_s=TARE_s + FREE_s,
        end_s=float(t_s[-1]),
    )
