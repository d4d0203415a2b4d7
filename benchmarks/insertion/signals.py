"""Signals that estimators get, and the ground truth that judges their estimates."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.jobs import Source
from foundation.arrays import Array, Vector
from foundation.jit import compiled
from foundation.linear_algebra import dot
from groundtruth import NeedleRun, Run, Rupture
from needleforce.tip_travel import Needle, place_tip, tip_speed
from residual import VelocityEstimator
from residual.tool_kinematics import ToolKinematics
from urdf import Robot


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class InsertionTruth:
    """Ground truth at the n samples of a run through L layers.

    Attributes:
        t_s: True instants, shape (n,).
        depth_m: Depth of the tip in the tissue, shape (n,).
        speed_m_s: Speed of the tip, shape (n,).
        axial_N: Axial force, shape (n,), positive when tissue pushes back.
        tip_N: Its part at the tip, shape (n,).
        layer_friction_N: Friction of each layer on the shaft, shape (n, L).
        layer: Where the tip is: 0 above, i in layer i, L + 1 beyond, shape (n,).
        ruptures: In the order they happened.
        tare_end_s: Nothing has been touched before.
        contact_s: First contact.
        insertion_end_s: The needle is at its deepest.
    """

    t_s: Array
    depth_m: Array
    speed_m_s: Array
    axial_N: Array
    tip_N: Array
    layer_friction_N: Array
    layer: NDArray[np.int64]
    ruptures: tuple[Rupture, ...]
    tare_end_s: float
    contact_s: float
    insertion_end_s: float

    @property
    def enhanced_N(self) -> Array:
        """Axial force without the friction of the layers traversed, shape (n,)."""
        number = np.arange(1, self.layer_friction_N.shape[1] + 1)
        is_traversed = number[None, :] < self.layer[:, None]
        return self.axial_N - np.sum(self.layer_friction_N * is_traversed, axis=1)

    @property
    def is_insertion(self) -> NDArray[np.bool_]:
        """Samples from first contact to the deepest point, shape (n,)."""
        return (self.t_s >= self.contact_s) & (self.t_s <= self.insertion_end_s)


def insertion_truth(run: Run | NeedleRun) -> InsertionTruth:
    """Return the ground truth of an insertion, by the arm or by a needle alone."""
    true = run.truth
    motion = run if isinstance(run, NeedleRun) else run.truth
    depth_m = motion.depth_m
    organ = run.scenario.tissue_motion
    if organ is not None and isinstance(run, NeedleRun):
        depth_m = depth_m - organ.at(run.t_s)[0]
    return InsertionTruth(
        t_s=motion.t_s,
        depth_m=depth_m,
        speed_m_s=motion.speed_m_s,
        axial_N=true.axial_N,
        tip_N=true.tip_N,
        layer_friction_N=true.layer_friction_N,
        layer=true.layer,
        ruptures=true.ruptures,
        tare_end_s=run.tare_end_s,
        contact_s=true.contact_s,
        insertion_end_s=run.scenario.motion.insertion_end_s,
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceTruth:
    """True axial force over a run, and the part of it that is judged.

    Attributes:
        t_s: time, shape (n,), increasing.
        depth_m: Travel of the tip since first contact, shape (n,).
        axial_N: True axial force, shape (n,).
        zeroed_s: When the sensors were zeroed; readings before mean nothing.
        start_s: First contact.
        end_s: End of the withdrawal.
    """

    t_s: Array
    depth_m: Array
    axial_N: Array
    zeroed_s: float
    start_s: float
    end_s: float

    @property
    def judged(self) -> NDArray[np.bool_]:
        """The samples that count, shape (n,)."""
        return (self.t_s >= self.start_s) & (self.t_s <= self.end_s)


CLOCK_DIGITS = 9
"""Time stamps are whole nanoseconds; differences of their floats are not, and a period
that differs in its last bit looks like a clock that jitters."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointSignals:
    """n samples of an arm with j joints: all that the virtual sensor gets.

    Attributes:
        t_s: Time stamps, shape (n,), increasing.
        q_rad: positions, shape (n, j).
        dq_rad_s: velocities, shape (n, j), or None where the arm sends none.
        tau_Nm: torques, shape (n, j).
    """

    t_s: Array
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array

    @classmethod
    def of_run(cls, run: Run) -> "JointSignals":
        """Return what the arm of a simulated insertion sent."""
        sent = run.signals
        return cls(
            t_s=sent.t_s, q_rad=sent.q_rad, dq_rad_s=sent.dq_rad_s, tau_Nm=sent.tau_Nm
        )

    @property
    def dt_s(self) -> Array:
        """Time since the previous sample, shape (n,).

        The first sample has no previous one: its entry is 1, and nobody reads it.
        """
        return np.round(np.diff(self.t_s, prepend=self.t_s[0] - 1.0), CLOCK_DIGITS)

    def samples(self) -> list["JointSample"]:
        """Return the arguments of an estimator's `update`, sample by sample."""
        # Lists: a controller has its sample at hand and need not cut it out of an
        # array.
        velocities = (
            [None] * len(self.t_s) if self.dq_rad_s is None else list(self.dq_rad_s)
        )
        rows = zip(self.q_rad, velocities, self.tau_Nm, self.dt_s.tolist(), strict=True)
        return list(rows)


JointSample = tuple[Array, Array | None, Array, float]
"""One sample of an arm with j joints, the arguments of an estimator's `update`:
positions [rad], velocities [rad/s] or None where the arm sends none, torques [Nm],
shape (j,) each, and the time since the sample before [s]."""


@dataclass(frozen=True, slots=True, eq=False)
class NeedleSignal:
    """n samples of depth, speed and force: what an identifier gets.

    Attributes:
        source: Where the force comes from.
        t_s: Time stamps, shape (n,).
        depth_m: Travel along the needle's axis, shape (n,); where its zero lies is not
            known.
        speed_m_s: Its rate, shape (n,); None where nothing measures it.
        force_N: Axial force, zeroed in free air, shape (n,).
    """

    source: Source
    t_s: Array
    depth_m: Array
    speed_m_s: Array | None
    force_N: Array


@compiled
def tip_motion(axis: Vector, needle: Needle, dq: Vector) -> tuple[float, float]:
    """Return the tip's position along an axis [m] and its speed along the needle [m/s].

    Args:
        axis: Direction in base axes, length one, shape (3,).
        needle: `residual.ToolKinematics.needle`.
        dq: Joint velocities [rad/s], shape (n,).
    """
    tip = place_tip(needle)
    return dot(axis, tip.position_m), tip_speed(tip, needle, dq)


def measured_travel(
    robot: Robot, signals: JointSignals, zero_s: float
) -> tuple[Array, Array]:
    """Return travel of the tip along the needle and its rate, shape (n,) each.

    Forward kinematics of measured positions, Jacobian of measured velocities. Where the
    arm sends no velocity, velocity and the position that belongs to it are estimated as
    the virtual sensor does it. The tip's place and axis at `zero_s` are the zero and
    the direction of depth.
    """
    q_rad = signals.q_rad
    dq_rad_s = signals.dq_rad_s
    if dq_rad_s is None:
        estimator = VelocityEstimator(q_rad.shape[1])
        samples = zip(signals.q_rad, signals.tau_Nm, signals.dt_s.tolist(), strict=True)
        matched = [estimator.update(*sample) for sample in samples]
        q_rad = np.array([sample[0] for sample in matched])
        dq_rad_s = np.array([sample[1] for sample in matched])
    kinematics = ToolKinematics(robot)
    kinematics.update(q_rad[int(np.searchsorted(signals.t_s, zero_s))])
    axis = kinematics.axis_in_base.copy()
    start_m = kinematics.pose[:3, 3].copy()
    place_and_speed = np.zeros((len(signals.t_s), 2))
    for k, (q, dq) in enumerate(zip(q_rad, dq_rad_s, strict=True)):
        kinematics.update(q)
        place_and_speed[k] = tip_motion(axis, kinematics.needle, dq)
    depth_m = place_and_speed[:, 0] - float(axis.dot(start_m))
    return depth_m, place_and_speed[:, 1].copy()


def tool_jacobians(
    robot: Robot, q_rad: Array, axes: pin.ReferenceFrame = pin.ReferenceFrame.LOCAL
) -> Array:
    """Return Jacobians of the tool frame in its own axes, shape (n, 6, j).

    Row 2 is along the needle.
    """
    data = robot.create_data()
    return np.array(
        [
            pin.computeFrameJacobian(robot.model, data, q, robot.tool_frame_id, axes)
            for q in q_rad
        ]
    )
