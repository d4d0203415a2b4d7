"""The momentum observer: joint signals in, external joint torque out.

Momentum ``p = M(q) dq`` obeys ``dp/dt = tau + C' dq - g - tau_f + tau_ext``. With ``u =
tau + C' dq - (g + tau_f)`` the residual ``dr/dt = K (dp/dt - u - r)`` is the
first-order low-pass of the external torque (paper, Section IV; Haddadin et al. 2017).

Neither M nor C is formed. With the twist v of every link and the spatial momentum h of
the subtree it carries, both from one pass over the links, ``p = S . h`` and ``C' dq =
(v x S) . h`` for a joint that moves along S: the gradient of the kinetic energy (in the
spirit of De Luca and Ferrajoli, ICRA 2009), in a third of the time of the matrices.

What the residual reads without contact is left to `bias`, the force that it shows to
`wrench_estimator`.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from foundation.arrays import (
    Array,
    Matrix,
    Vector,
    WrittenMatrix,
)
from foundation.jit import compile_waiting, compiled, compiled_inside
from residual.checks.input import (
    check_choice,
    check_interval,
    check_positive,
    check_rows,
    read_rows,
    round_step,
)
from residual.errors import ConfigurationError
from residual.joint_friction import FrictionModel, check_friction
from urdf import Robot

Alignment = Literal["hold", "trapezoid"]
"""How torque fills a tick: ``hold`` (zero-order hold), the torque of the earlier sample
acts until the next one (a commanded torque); ``trapezoid``, the mean of both samples (a
sampled sensor)."""

BANDWIDTH_PER_S = 10.0
"""Bandwidth of the smoothed momentum at rest [1/s]: well below that of the torque,
which alone carries a rupture."""

NOISE_THRESHOLD_SIGMAS = 3.0
"""Distance of the momentum, in standard deviations of its noise, at which the bandwidth
has doubled."""

MIN_MOMENTUM_NOISE = 1e-9
"""Smallest noise of the momentum [kg m^2/s]: it keeps the ratios of
`momentum_smoothing_step` finite."""

_NAMES = ("q", "dq", "tau")

# State of the observer after a tick: rows of a matrix, a column per joint.

RESIDUAL = 0
"""Row of the residual r [Nm]."""

MOMENTUM = 1
"""Row of the momentum p, smoothed where the observer smooths it [kg m^2/s]."""

CORIOLIS = 2
"""Row of C' dq [Nm]."""

GRAVITY = 3
"""Row of gravity and joint friction together, g + tau_f [Nm]."""

TORQUE = 4
"""Row of the measured torque [Nm]."""

ROWS = 5
"""Number of rows."""


@compiled_inside
def momentum_smoothing_step(
    momentum: float, smoothed: float, noise_threshold: float, dt_s: float
) -> float:
    """Smooth the momentum of a joint that hardly accelerates, by one implicit step.

    During an insertion the arm's own inertial force is a few hundredths of a newton,
    but the noise of the velocity, differentiated, is the largest noise of the residual.
    The momentum therefore passes a lag whose bandwidth grows with the distance it has
    fallen behind, and which steps aside when the arm accelerates (compare the "one
    euro" filter, Casiez et al., CHI 2012). The implicit step never overshoots.

    Args:
        momentum: Momentum at the end of the tick.
        smoothed: The smoothed momentum at the start of the tick.
        noise_threshold: Distance at which the bandwidth has doubled.
        dt_s: Length of the tick.

    Returns:
        The smoothed momentum at the end of the tick.
    """
    # With s the length of the tick in time constants at rest, and x the distance in
    # thresholds, behind / (1 + s (1 + x^4)) remains.
    rest_step = BANDWIDTH_PER_S * dt_s  # s
    behind = momentum - smoothed
    x = behind / noise_threshold
    return momentum - behind / (1.0 + rest_step * (1.0 + x * x * x * x))


@compiled
def momentum_step(
    rows: WrittenMatrix,
    twists: Matrix,
    momenta: Matrix,
    directions: Matrix,
    crossing: Matrix,
    armature: Vector,
    load: Vector,
    sample: Matrix,
    gains_per_s: Vector,
    noise_threshold: Vector,
    dt_s: float,
    is_held: bool,
) -> None:
    """Bring the residual to the end of a tick, smoothing its momentum if asked to.

    The step ``r+ = a r + (1 - a) ((p+ - p)/dt - mean(u))`` with a = exp(-K dt) is
    exact: it is stable for every K dt and has no start-up spike.

    Args:
        rows: See `RESIDUAL` and the others, shape (5, n); all are brought to the end of
            the tick.
        twists: Twist v of every link at the end of the tick, in the link's axes, shape
            (n, 6).
        momenta: Momentum h there of the subtree that the link carries, likewise.
        directions: Direction S of every joint, to be multiplied with the stacked
            momenta, shape (n, 6 n).
        crossing: Maps the stacked twists to v x S, shape (6 n, 6 n).
        armature: Rotor inertia [kg m^2], shape (n,).
        load: g + tau_f at the end of the tick [Nm], shape (n,).
        sample: q [rad], dq [rad/s] and measured torque [Nm] there, finite numbers,
            shape (3, n).
        gains_per_s: K of every joint, shape (n,).
        noise_threshold: See `momentum_smoothing_step`, shape (n,); of length 0 where
            nothing is smoothed.
        dt_s: Length of the tick; 0 at a first sample, which only sets the momentum.
        is_held: Whether torque is held over the tick, see `Alignment`.
    """
    step_s = round_step(dt_s)
    for j in range(len(load)):
        momentum = armature[j] * sample[1, j]
        coriolis = 0.0
        for a in range(6):
            momentum += directions[j, 6 * j + a] * momenta[j, a]
            for b in range(6):
                coriolis += (
                    momenta[j, a] * crossing[6 * j + a, 6 * j + b] * twists[j, b]
                )
        if dt_s > 0.0:
            if noise_threshold.size:
                momentum = momentum_smoothing_step(
                    momentum, rows[MOMENTUM, j], noise_threshold[j], dt_s
                )
            gained = -math.expm1(-gains_per_s[j] * step_s)
            half = 0.5 * gained
            gained_before = gained if is_held else half
            gained_after = 0.0 if is_held else half
            rows[RESIDUAL, j] = (
                (1.0 - gained) * rows[RESIDUAL, j]
                - gained / step_s * rows[MOMENTUM, j]
                - half * rows[CORIOLIS, j]
                + half * rows[GRAVITY, j]
                - gained_before * rows[TORQUE, j]
                + gained / step_s * momentum
                - half * coriolis
                + half * load[j]
                - gained_after * sample[2, j]
            )
        rows[MOMENTUM, j] = momentum
        rows[CORIOLIS, j] = coriolis
        rows[GRAVITY, j] = load[j]
        rows[TORQUE, j] = sample[2, j]


@dataclass(slots=True, eq=False)
class MomentumState:
    """State of a `MomentumObserver`.

    Attributes:
        rows: State after the last tick, see `RESIDUAL` and the others, shape (ROWS, n).
        started: Whether there was a sample.
        noise_threshold: As of `momentum_step`.
    """

    rows: Array
    noise_threshold: Array
    started: bool = False


class MomentumObserver:
    """Residual of the generalised momentum, by the exact step of `momentum_step`.

    The first sample only sets the momentum, so a start on a moving arm makes no spike;
    after a gap in time longer than ``max_gap_s`` the momentum is set anew and the
    residual goes on from its last value, rather than integrating across the hole.

    Rotor inertia, where an arm needs it (motor-current torque), is part of the robot's
    model (`Robot.with_armature`); on the LWR, whose torque is measured behind the gear,
    it is zero.

    Args:
        robot: The arm with its payload.
        gain_per_s: K, one for all joints or one each [1/s]; 1/K is the lag of the
            residual. The default, 50/s, is for an observer used alone: the virtual
            sensor passes `SensorConfig.gain_per_s`, 70/s by default.
        alignment: How torque fills a tick, see `Alignment`.
        friction: Joint friction between torque sensor and link, if any is modelled.
        max_gap_s: Longest time step that is still integrated [s].

    Attributes:
        memory: Its state; one of the same robot and settings may replace it.

    Raises:
        ConfigurationError: For a gain, alignment or gap that cannot work, or friction
            of another number of joints.
    """

    def __init__(
        self,
        robot: Robot,
        gain_per_s: float | ArrayLike = 50.0,
        *,
        alignment: Alignment = "trapezoid",
        friction: FrictionModel | None = None,
        max_gap_s: float = 0.1,
    ) -> None:
        compile_waiting()
        check_choice("alignment", alignment, get_args(Alignment))
        check_positive("max_gap_s", max_gap_s)
        self._joints = robot.nv
        self._gains = read_gains(gain_per_s, robot.nv)
        if friction is not None:
            check_friction(friction, robot.nv)
        self._model = robot.model
        self._friction = friction
        axes = [joint_axis(joint) for joint in list(robot.model.joints)[1:]]
        # v x S = -(S x v)
        crossing = np.asarray(block_diag(*(-pin.Motion(axis).action for axis in axes)))
        self._directions = np.asarray(block_diag(*axes))
        self._crossing = crossing
        self._armature = np.array(robot.model.armature)
        self._data = robot.create_data()
        self._share_workspace()
        self._is_held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self.reset()

    @property
    def residual(self) -> Array:
        """Latest residual [Nm], shape (n,), a copy; zeros before the first sample."""
        return self.memory.rows[RESIDUAL].copy()

    def update(self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, dt_s: float) -> Array:
        """Take one sample and return the residual.

        Args:
            q: Joint positions [rad], shape (n,).
            dq: Joint velocities [rad/s], shape (n,).
            tau: Measured link-side joint torques [Nm], shape (n,).
            dt_s: Time since the previous sample [s]; not read on the first one.

        Returns:
            Estimate of the external joint torque, environment on robot [Nm], shape
            (n,), a new read-only array.

        Raises:
            SampleError: For a wrong shape, a number that is not finite or a time step
                that does not advance; the state is then unchanged.
        """
        sample = read_rows(_NAMES, (q, dq, tau), self._joints)
        check_rows(_NAMES, sample)
        dt_s = check_interval(dt_s) if self.memory.started else 0.0
        residual = self.step(sample, dt_s)
        residual.setflags(write=False)
        return residual

    def step(self, sample: Array, dt_s: float) -> Array:
        """Take a sample as one contiguous array, shape (3, n), and a checked time step.

        Like `update` but for these checks; the result may be written.
        """
        memory = self.memory
        q = sample[0]
        dq = sample[1]
        load = pin.computeGeneralizedGravity(self._model, self._data, q)
        if self._friction is not None:
            load += self._friction.torque(dq)
        pin.computeCentroidalMomentum(self._model, self._data, q, dq)
        momentum_step(
            memory.rows,
            self._twists,
            self._momenta,
            self._directions,
            self._crossing,
            self._armature,
            load,
            sample,
            self._gains,
            memory.noise_threshold,
            dt_s if memory.started and dt_s <= self._max_gap_s else 0.0,
            self._is_held,
        )
        memory.started = True
        return memory.rows[RESIDUAL].copy()

    def _share_workspace(self) -> None:
        """Read twists and momenta in place from the workspace that Pinocchio fills."""
        self._twists = _shared_rows(self._data.v)
        self._momenta = _shared_rows(self._data.h)

    def __getstate__(self) -> dict[str, Any]:
        state = vars(self).copy()
        del state["_twists"], state["_momenta"]
        return state

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)
        self._share_workspace()  # A deep copy has a workspace of its own.

    def smooth_momentum(self, velocity_noise_rad_s: Array, q: Array) -> None:
        """Smooth the momentum from now on while the arm hardly accelerates.

        See `momentum_smoothing_step`.

        Args:
            velocity_noise_rad_s: Standard deviation of ``dq`` per joint [rad/s], shape
                (n,).
            q: Configuration about which the arm will move [rad], shape (n,): its
                inertia turns noise of velocity into noise of momentum.
        """
        inertia = pin.crba(self._model, self._data, q)
        variance = np.square(inertia).dot(np.square(velocity_noise_rad_s))
        noise = np.sqrt(variance) + MIN_MOMENTUM_NOISE
        self.memory.noise_threshold = NOISE_THRESHOLD_SIGMAS * noise

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.memory = MomentumState(np.zeros((ROWS, self._joints)), np.zeros(0))


def read_gains(gain_per_s: float | ArrayLike, joints: int) -> Array:
    """Read a gain for all joints, or one each, as shape (joints,) [1/s]."""
    is_fit = np.shape(gain_per_s) in ((), (joints,))
    gains = np.array(gain_per_s if is_fit else np.nan, dtype=np.float64)
    if not (np.isfinite(gains).all() and (gains > 0).all()):
        raise ConfigurationError(
            f"gain_per_s is {gain_per_s!r}, expected one positive number or {joints} "
            "of them [1/s]"
        )
    return np.array(np.broadcast_to(gains, (joints,)))


def joint_axis(joint: pin.JointModel) -> Array:
    """Return the twist of a link at unit rate of its joint, in its axes, shape (6,).

    The joint must have one degree of freedom.
    """
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq))
    return np.array(data.S).ravel()


def _shared_rows(vectors: Any) -> Array:
    """Return the spatial vectors of all joints of a workspace in place, shape (n, 6).

    Pinocchio lays them out one after the other.
    """
    first = vectors[1].vector
    final = vectors[len(vectors) - 1].vector
    number_bytes = first.itemsize
    rows = np.lib.stride_tricks.as_strided(
        first, (len(vectors) - 1, 6), (6 * number_bytes, number_bytes)
    )
    if rows[-1].ctypes.data != final.ctypes.data:
        raise ConfigurationError(
            "this version of pinocchio lays out its workspace in another way",
            "Install a version of Pinocchio that the package's requirements name.",
        )
    return rows
