"""The momentum observer: joint signals in, external joint torque out.

Momentum ``p = M(q) dq`` obeys ``dp/dt = tau + C' dq - g - tau_f + tau_ext``. With ``u =
tau + C' dq - (g + tau_f)`` the residual ``dr/dt = K (dp/dt - u - r)`` is the
first-order low-pass of the external torque (paper, Section IV; Haddadin et al. 2017).

Neither M nor C is formed. With the twist v of every link and the spatial momentum h of
the subtree it carries, both from one pass over the links, ``p = S . h`` and ``C' dq =
(v x S) . h`` for a joint that moves along S: the gradient of the kinetic energy (in the
spirit of De Luca and Ferrajoli, ICRA 2009), in a third of the time of the matrices.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike
from scipy.linalg import block_diag

from foundation.arrays import Matrix, Vector, WrittenMatrix
from foundation.jit import compiled
from foundation.linear_algebra import dot
from residual.checks.input import (
    MOST_PLAUSIBLE,
    check_choice,
    check_interval,
    check_joint_vector,
    check_positive,
    check_rows,
    read_rows,
)
from residual.errors import Array, ConfigurationError
from residual.joint_friction import FrictionModel, check_friction
from urdf import Robot

Alignment = Literal["hold", "trapezoid"]
"""How torque fills a tick: ``hold``, the torque of the earlier sample acts until the
next one (a commanded torque); ``trapezoid``, the mean of both samples (a sampled
sensor)."""

BANDWIDTH_PER_S = 10.0
"""Bandwidth of the smoothed momentum at rest [1/s]: well below that of the torque,
which alone carries a rupture."""
NOISE_THRESHOLD_SIGMAS = (
    3.0  # Distance of the momentum at which the bandwidth has doubled
)
_LEAST_MOMENTUM_NOISE = 1e-9  # [kg m^2/s] Keeps the ratios of `momentum_step` finite
_NAMES = ("q", "dq", "tau")
_MOST_SQUARED = 3.0 * (1.0 + 1e-9) * MOST_PLAUSIBLE**2
"""Of three signals: beyond it `check_rows` refuses one of them, whatever rounding
does."""

RESIDUAL, MOMENTUM, CORIOLIS, GRAVITY, TORQUE = range(5)
"""Rows of a step at the start of a tick: r [Nm], p [kg m^2/s], C' dq, g + tau_f and
tau [Nm]."""
END = 4  # the last four at the end of the tick follow in the same order
# so many rows are known before the tick, and so many there are
BEFORE = 5
ROWS = 9
Motion = tuple[Matrix, Matrix]  # see `momentum_step`
Joints = tuple[Matrix, Matrix, Vector]  # likewise


@compiled
def set_step_weights(
    weights: WrittenMatrix, gains_per_s: Vector, dt_s: float, held: bool
) -> None:
    """Set the weights of the exact step ``r+ = a r + (1 - a) ((p+ - p)/dt - mean(u))``.

    With a = exp(-K dt) it is stable for every K dt, has no start-up spike, and is
    linear in the rows of `momentum_step`.

    One weight per row is written, shape (1, 9), or (n, 9) for one gain K [1/s] per
    joint; ``held`` says whether torque is held over the tick [s], see `Alignment`.
    """
    for k in range(len(gains_per_s)):
        gained = -math.expm1(-float(gains_per_s[k]) * dt_s)
        row = weights[k]
        half = 0.5 * gained
        row[RESIDUAL] = 1.0 - gained
        row[MOMENTUM] = -gained / dt_s
        row[MOMENTUM + END] = gained / dt_s
        row[CORIOLIS] = -half
        row[CORIOLIS + END] = -half
        row[GRAVITY] = half
        row[GRAVITY + END] = half
        row[TORQUE], row[TORQUE + END] = (-gained, 0.0) if held else (-half, -half)


@compiled
def set_momentum(
    motion: Motion, joints: Joints, velocity: Vector, rows: WrittenMatrix
) -> None:
    """Write momentum p and C' dq at the end of a tick; arguments as of
    `momentum_step`.
    """
    twists, momenta = motion
    directions, crossing, armature = joints
    for j in range(len(velocity)):
        along = armature[j] * velocity[j] if armature.size else 0.0
        turned = 0.0
        for a in range(6):
            along += directions[j, 6 * j + a] * momenta[j, a]
            for b in range(6):
                turned += momenta[j, a] * crossing[6 * j + a, 6 * j + b] * twists[j, b]
        rows[MOMENTUM + END, j] = along
        rows[CORIOLIS + END, j] = turned


@compiled
def momentum_step(
    rows: WrittenMatrix,
    motion: Motion,
    joints: Joints,
    load: Vector,
    sample: Matrix,
    weights: Matrix,
    noise_threshold: Vector,
    dt_s: float,
) -> bool:
    """One tick of the residual: the momentum is smoothed, then comes the exact step.

    During an insertion the arm's own inertial force is a few hundredths of a newton,
    but the noise of the velocity, differentiated, is the largest noise of the residual.
    The momentum therefore passes a lag whose bandwidth grows with the distance it has
    fallen behind, and which steps aside when the arm accelerates (compare the "one
    euro" filter, Casiez et al., CHI 2012). Its step is the implicit one, which never
    overshoots.

    Args:
        rows: See `RESIDUAL` and the others, shape (9, n); all are brought to the end of
            the tick.
        motion: Twist v of every link at its end, and momentum h of the subtree it
            carries, in the link's axes, shape (n, 6).
        joints: Direction S of every joint, times what is stacked, shape (n, 6 n); the
            matrix that maps the stacked twists to v x S, shape (6 n, 6 n); rotor
            inertia [kg m^2], shape (n,), of length 0 where there is none.
        load: g + tau_f there [Nm], shape (n,).
        sample: q [rad], dq [rad/s] and measured torque [Nm] there, shape (3, n).
        weights: See `set_step_weights`.
        noise_threshold: Distance at which the bandwidth has doubled, shape (n,); of
            length 0 where nothing is smoothed.
        dt_s: Length of the tick [s]; 0 at a first sample, which only sets the momentum.

    Returns whether the sample is finite and of plausible size; if not, nothing has
    happened.
    """
    numbers = sample.ravel()
    if not dot(numbers, numbers) < _MOST_SQUARED:  # a NaN is not either
        return False
    set_momentum(motion, joints, sample[1], rows)
    momentum = rows[MOMENTUM + END]
    if dt_s > 0.0 and noise_threshold.size:
        tick = BANDWIDTH_PER_S * dt_s
        behind = momentum - rows[MOMENTUM]
        ratio = behind / noise_threshold
        ratio *= ratio
        ratio *= ratio
        # behind / (1 + tick (1 + ratio^4)) remains.
        ratio *= tick
        ratio += 1.0 + tick
        behind /= ratio
        momentum -= behind
    rows[GRAVITY + END] = load
    rows[TORQUE + END] = sample[2]
    if dt_s > 0.0:
        if len(weights) == 1:
            rows[RESIDUAL] = weights.dot(rows)[0]
        else:
            rows[RESIDUAL] = (weights.T * rows).sum(axis=0)
    rows[MOMENTUM:BEFORE] = rows[BEFORE:]
    return True


@dataclass(slots=True, eq=False)
class MomentumState:
    """All that a `MomentumObserver` remembers.

    Attributes:
        rows: Of the last step, shape (ROWS, n).
        started: Whether there was one.
    """

    rows: Array
    started: bool = False
    noise: Array | None = (
        None  # Momentum noise per joint for smoothing, shape (n,); None without
    )


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
            residual.
        alignment: How torque fills a tick, see `Alignment`.
        friction: Joint friction between torque sensor and link, if any is modelled.
        max_gap_s: Longest time step that is still integrated [s].

    Attributes:
        memory: All that it remembers.

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
        check_choice("alignment", alignment, get_args(Alignment))
        check_positive("max_gap_s", max_gap_s)
        n = self._joints = robot.nv
        # One where it serves all: on an uneven clock its weights change every tick.
        is_fit = np.shape(gain_per_s) in ((), (n,))
        self._gains = np.array(
            gain_per_s if is_fit else np.nan, dtype=np.float64, ndmin=1
        )
        if not (np.isfinite(self._gains).all() and (self._gains > 0).all()):
            raise ConfigurationError(
                f"gain_per_s is {gain_per_s!r}, expected one positive number or {n} of them [1/s]"
            )
        if friction is not None:
            check_friction(friction, n)
        self._model = robot.model
        self._friction = friction
        axes = [joint_axis(joint) for joint in list(robot.model.joints)[1:]]
        # v x S = -(S x v)
        crossing = np.asarray(block_diag(*(-pin.Motion(axis).action for axis in axes)))
        armature = (
            np.array(robot.model.armature)
            if np.any(robot.model.armature)
            else np.zeros(0)
        )
        self._directions = np.asarray(block_diag(*axes)), crossing, armature
        self._data = robot.create_data()
        self._motion = _shared_rows(self._data.v), _shared_rows(self._data.h)
        self._held = alignment == "hold"
        self._max_gap_s = max_gap_s
        self._weights = np.zeros((len(self._gains), ROWS))
        self._dt_s = math.nan
        self.reset()

    @property
    def residual(self) -> Array:
        """Latest residual [Nm], shape (n,), a copy; zeros before the first sample."""
        return self.memory.rows[0].copy()

    @property
    def gain_per_s(self) -> Array:
        """K per joint [1/s], shape (n,), a copy."""
        return np.full(self._joints, self._gains)

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
        if self._friction is not None:  # Its model need not take what is not finite.
            check_rows(_NAMES, sample)
        dt_s = check_interval(dt_s) if self.memory.started else 0.0
        residual = self.step(sample, dt_s)
        residual.setflags(False)  # pyright: ignore[reportCallIssue]  # by name three times as long
        return residual

    def step(self, sample: Array, dt_s: float) -> Array:
        """As `update`, for a checked time step and one contiguous array of shape (3,
        n).
        """
        memory = self.memory
        q = sample[0]
        dq = sample[1]
        if not memory.started or dt_s > self._max_gap_s:
            dt_s = 0.0
        elif dt_s != self._dt_s:  # on an even clock that is once
            set_step_weights(self._weights, self._gains, dt_s, self._held)
            self._dt_s = dt_s
        rows = memory.rows
        weights = self._weights
        threshold = self._noise_threshold
        model = self._model
        data = self._data
        load = pin.computeGeneralizedGravity(model, data, q)
        if self._friction is not None:
            # A model that writes into its argument must not change the caller's sample.
            still = dq.view()
            still.setflags(write=False)
            load += self._friction.torque(still)
        pin.computeCentroidalMomentum(model, data, q, dq)
        motion = self._motion
        joints = self._directions
        if not momentum_step(
            rows, motion, joints, load, sample, weights, threshold, dt_s
        ):
            check_rows(_NAMES, sample)
        memory.started = True
        return rows[0].copy()

    def __getstate__(self) -> dict[str, Any]:
        return {name: kept for name, kept in vars(self).items() if name != "_motion"}

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state)  # A deep copy has a workspace of its own.
        self._motion = _shared_rows(self._data.v), _shared_rows(self._data.h)

    def smooth_momentum(self, velocity_noise_rad_s: Array, q: Array) -> None:
        """From now on smooth the momentum of an arm that hardly accelerates, see
        `momentum_step`.

        Args:
            velocity_noise_rad_s: Standard deviation of ``dq`` per joint [rad/s], shape
                (n,).
            q: Configuration about which the arm will move [rad], shape (n,): its
                inertia turns noise of velocity into noise of momentum.
        """
        noise = check_joint_vector(
            "velocity_noise_rad_s", velocity_noise_rad_s, self._joints
        )
        inertia = pin.crba(
            self._model, self._data, check_joint_vector("q", q, self._joints)
        )
        variance = np.square(inertia).dot(np.square(noise))
        self.memory.noise = np.sqrt(variance) + _LEAST_MOMENTUM_NOISE
        self.restore(self.memory)

    def restore(self, memory: MomentumState) -> None:
        """Go on from a `memory`, which is kept, of an observer of the same robot and
        settings.

        Raises:
            ConfigurationError: If it belongs to a robot with another number of joints,
                or is damaged; nothing has then changed.
        """
        rows = memory.rows
        noise = memory.noise
        n = self._joints
        if rows.shape != (ROWS, n):
            raise ConfigurationError(
                f"state has rows of shape {rows.shape}, expected {(ROWS, n)}"
            )
        if noise is not None and not (noise.shape == (n,) and (noise > 0.0).all()):
            raise ConfigurationError(
                f"state has noise {noise}, expected {n} positive numbers"
            )
        self.memory = memory
        self._noise_threshold = (
            np.zeros(0) if noise is None else NOISE_THRESHOLD_SIGMAS * noise
        )

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.restore(MomentumState(np.zeros((ROWS, self._joints))))


def joint_axis(joint: pin.JointModel) -> Array:
    """Twist of a link at unit rate of its joint of one number, in the link's axes,
    shape (6,).
    """
    data = joint.createData()
    joint.calc(data, np.zeros(joint.nq))
    return np.array(data.S).ravel()


def _shared_rows(vectors: Any) -> Array:
    """The spatial vectors of all joints of a Pinocchio workspace, in place, shape
    (n, 6).
    """
    first = vectors[1].vector
    last = vectors[len(vectors) - 1].vector
    step = 6 * 8
    rows = np.lib.stride_tricks.as_strided(first, (len(vectors) - 1, 6), (step, 8))
    if rows[-1].ctypes.data != last.ctypes.data:
        raise ConfigurationError(
            "this version of pinocchio lays out its workspace in another way"
        )
    return rows
