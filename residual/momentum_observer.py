"""The momentum observer: joint signals in, external joint torque out."""

import math
from typing import Literal, NamedTuple, NoReturn

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from needleforce.jit import COMPILER, Matrix, Vector, WrittenMatrix, compiled
from residual.errors import ConfigurationError, SampleError
from residual.input_validation import (
    MOST_PLAUSIBLE,
    check_alignment,
    check_gap,
    check_interval,
    check_joint_vector,
    read_rows,
)
from residual.joint_friction import FrictionModel
from urdf import Robot

# The exact step of the momentum residual, as pure functions of rows.
#
# Momentum ``p = M(q) dq`` obeys ``dp/dt = tau + C' dq - g - tau_f + tau_ext``. With
# ``u = tau + C' dq - (g + tau_f)`` the residual ``dr/dt = K (dp/dt - u - r)`` is the first-order
# low-pass of the external torque (paper, Section IV; Haddadin et al. 2017). Its exact solution over
# a tick of length dt is
#
#     r+ = a r + (1 - a) ((p+ - p)/dt - mean(u)),      a = exp(-K dt),
#
# stable for every K dt, free of a start-up spike, and linear in what was known before the tick and
# what is known after it: one row of coefficients per joint.


Alignment = Literal["hold", "trapezoid"]
"""How torque fills a tick: ``hold``, the torque of the earlier sample acts until the next one
(a commanded torque); ``trapezoid``, the mean of both samples (a sampled sensor)."""

ROWS = 5
"""Rows of a sample: residual, momentum, C' dq, g + tau_f, torque."""


def step_coefficients(
    gain_per_s: float | NDArray[np.float64], dt_s: float, alignment: Alignment
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Coefficients of the exact step on the rows before and after the tick.

    Args:
        gain_per_s: K [1/s]: one for all joints, or an array of shape (n,).
        dt_s: Length of the tick [s].
        alignment: How torque fills the tick.

    Returns:
        Factors of the earlier and of the later rows, each of shape (ROWS,), or (n, ROWS) for one
        gain per joint.
    """
    # Plain floats where one gain serves all: on an uneven clock this runs every tick.
    share = (
        -math.expm1(-gain_per_s * dt_s)
        if isinstance(gain_per_s, float)
        else -np.expm1(-gain_per_s * dt_s)
    )
    decay, per_second, half, zero = 1.0 - share, share / dt_s, 0.5 * share, 0.0 * share
    held = alignment == "hold"
    before = (decay, -per_second, -half, half, -share if held else -half)
    after = (zero, per_second, -half, half, zero if held else -half)
    return np.array(before).T, np.array(after).T


def momentum_step(
    before: NDArray[np.float64],
    after: NDArray[np.float64],
    gain_per_s: float | NDArray[np.float64],
    dt_s: float,
    alignment: Alignment = "trapezoid",
) -> NDArray[np.float64]:
    """One exact step of the residual.

    Args:
        before: Rows at the start of the tick, shape (ROWS, n): residual [Nm], momentum
            [kg m^2/s], C' dq [Nm], g + tau_f [Nm], torque [Nm].
        after: Rows at its end; the residual row is not read.
        gain_per_s: K [1/s], one for all joints or shape (n,).
        dt_s: Length of the tick [s].
        alignment: How torque fills the tick.

    Returns:
        Residual at the end of the tick [Nm], shape (n,).
    """
    factors_before, factors_after = step_coefficients(gain_per_s, dt_s, alignment)
    return np.vecdot(factors_before, before.T) + np.vecdot(factors_after, after.T)


@compiled
def momentum_tick(
    rows: WrittenMatrix,
    slot: int,
    dynamics: tuple[Matrix, Matrix, Vector],
    velocity: Vector,
    torque: Vector,
    dt_s: float,
    settings: tuple[Vector, Vector, float, bool],
) -> float:
    """A whole tick of `MomentumObserver` in loops, as a compiler likes it and Python does not.

    The observer does the same with `step_coefficients` and `smoothing_step` where nothing compiles.

    Args:
        rows: Rows of the sample before and of this one, which are written; shape (2 ROWS, n).
        slot: 0 if this sample stands first, else 1.
        dynamics: M, C and g + tau_f.
        velocity: dq [rad/s], shape (n,).
        torque: Measured torque [Nm], shape (n,).
        dt_s: Length of the tick [s]; 0 to keep the residual: of a first sample.
        settings: K [1/s] and the distance at which the bandwidth of the momentum doubles, both
            shape (n,); that bandwidth at rest [1/s]; whether the torque is held.

    Returns:
        Sum of the squares of the rows written.
    """
    inertia, coriolis, gravity = dynamics
    gain, noise_threshold, bandwidth, held = settings
    before, after = ROWS * (1 - slot), ROWS * slot
    size = 0.0
    for i in range(len(velocity)):
        momentum = transported = 0.0
        for j in range(len(velocity)):
            momentum += inertia[i, j] * velocity[j]
            transported += coriolis[j, i] * velocity[j]
        residual = rows[before, i]
        if dt_s > 0.0:
            at_rest = 1.0 / (bandwidth * dt_s)
            behind = momentum - rows[before + 1, i]
            ratio = behind / noise_threshold[i]
            momentum -= behind / (1.0 + at_rest + ratio * ratio * ratio * ratio) * at_rest
            motion = transported - gravity[i] + rows[before + 2, i] - rows[before + 3, i]
            acting = 2.0 * rows[before + 4, i] if held else rows[before + 4, i] + torque[i]
            rate = (momentum - rows[before + 1, i]) / dt_s - 0.5 * (motion + acting)
            residual += math.expm1(-gain[i] * dt_s) * (residual - rate)
        rows[after, i] = residual
        rows[after + 1, i] = momentum
        rows[after + 2, i] = transported
        rows[after + 3, i] = gravity[i]
        rows[after + 4, i] = torque[i]
        for k in range(after, after + ROWS):
            size += rows[k, i] * rows[k, i]
    return size


# What the residual needs of the robot's dynamics, straight from Pinocchio.


Dynamics = tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]
"""M [kg m^2] and C, both of shape (n, n), and g + tau_f [Nm], shape (n,)."""


def _check_length(friction: FrictionModel, joints: int) -> None:
    try:
        shape = np.shape(friction.torque(np.zeros(joints)))
    except ValueError as error:
        raise ConfigurationError(
            f"friction does not fit a robot of {joints} joints: {error}"
        ) from error
    if shape != (joints,):
        raise ConfigurationError(f"friction gives torques of shape {shape}, expected ({joints},)")


class MomentumTerms:
    """Dynamics of one robot, as matrices or as rows of the caller.

    Rotor inertia, where an arm needs it (motor-current torque), is part of the robot's model
    (`Robot.with_armature`); on the LWR, whose torque is measured behind the gear, it is zero.

    Attributes:
        data: Workspace; joint placements and Jacobians of the latest call stand in it.

    Raises:
        ConfigurationError: If the friction model is of another number of joints.
    """

    def __init__(self, robot: Robot, friction: FrictionModel | None = None) -> None:
        if friction is not None:
            _check_length(friction, robot.nv)
        self._model = robot.model
        self.data = robot.create_data()
        self._friction = friction

    def at(self, q: NDArray[np.float64], dq: NDArray[np.float64]) -> Dynamics:
        """M, C and g + tau_f at (q, dq), both of shape (n,)."""
        model, data = self._model, self.data
        inertia = pin.crba(model, data, q)
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq)
        gravity = pin.computeGeneralizedGravity(model, data, q)
        if self._friction is not None:
            gravity += self._friction.torque(dq)
        return inertia, coriolis, gravity

    def write(
        self,
        q: NDArray[np.float64],
        dq: NDArray[np.float64],
        momentum: NDArray[np.float64],
        coriolis: NDArray[np.float64],
        gravity: NDArray[np.float64],
    ) -> None:
        """Write p = M dq, C' dq and g + tau_f at (q, dq) into the last three arrays, each (n,)."""
        inertia, coriolis_matrix, gravity[:] = self.at(q, dq)
        inertia.dot(dq, momentum)
        dq.dot(coriolis_matrix, coriolis)

    def momentum_variance(
        self, velocity_noise_rad_s: NDArray[np.float64], q: NDArray[np.float64]
    ) -> NDArray[np.float64]:
        """Variance of M(q) dq for a velocity noise per joint [rad/s], shape (n,)."""
        inertia = pin.crba(self._model, self.data, q)
        return np.square(inertia).dot(np.square(velocity_noise_rad_s))


# Quietens the momentum of an arm that hardly accelerates, and steps aside when it does.
#
# During an insertion the arm's own inertial force is a few hundredths of a newton, but the noise of
# the velocity, differentiated, is the largest noise of the residual. The momentum therefore passes
# a lag whose bandwidth grows with the distance it has fallen behind, measured in the noise of the
# momentum itself: within the noise it smooths, beyond it it lets through (compare the "one euro"
# filter, Casiez et al., CHI 2012). Where no noise is known the momentum passes untouched.


BANDWIDTH_PER_S = 10.0
"""Bandwidth at rest [1/s]: well below that of the torque, which alone carries a rupture."""
NOISE_THRESHOLD_SIGMAS = 3.0
"""Distance, in standard deviations of the momentum, at which the bandwidth has doubled."""

# Arrays without dimensions here and below: numpy is twice as fast with them as with floats.
_PER_KNEE = np.array(NOISE_THRESHOLD_SIGMAS**-4)


class SmoothingTick(NamedTuple):
    """What a step takes from the length of its tick, as arrays of shape ().

    Attributes:
        at_rest: 1 / (bandwidth at rest times tick).
        slack: 1 more than that.
    """

    at_rest: NDArray[np.float64]
    slack: NDArray[np.float64]


def smoothing_tick(dt_s: float) -> SmoothingTick:
    """For ticks of a length [s]."""
    slack = 1.0 + 1.0 / (BANDWIDTH_PER_S * dt_s)
    return SmoothingTick(np.array(slack - 1.0), np.array(slack))


def smoothing_step(
    smooth: NDArray[np.float64],
    momentum: NDArray[np.float64],
    noise: NDArray[np.float64],
    tick: SmoothingTick,
) -> NDArray[np.float64]:
    """One step of the adaptive lag.

    Args:
        smooth: Smoothed momentum before the tick, shape (n,).
        momentum: Momentum at its end, shape (n,).
        noise: Standard deviation of the momentum, shape (n,), positive.
        tick: Of its length.

    Returns:
        By how much the smoothed momentum is behind at the end of the tick, shape (n,).
    """
    # The bandwidth grows with the fourth power of distance / knee. The step is the implicit one,
    # which never overshoots: of what it is behind, 1 / (1 + rate) remains.
    behind = momentum - smooth
    rate = behind / noise
    rate *= rate
    rate *= rate
    rate *= _PER_KNEE
    rate += tick.slack
    behind /= rate
    behind *= tick.at_rest
    return behind


Array = NDArray[np.float64]

_NAMES = ("q", "dq", "tau")
_LEAST_MOMENTUM_NOISE = 1e-9
"""Keeps the smoother's ratios finite for a signal without noise [kg m^2/s]."""
_NO_NOISE_THRESHOLD = 1e-300
"""So near that every distance is beyond: the momentum passes untouched [kg m^2/s]."""


class MomentumState(NamedTuple):
    """All that a `MomentumObserver` remembers.

    Attributes:
        rows: Its rows, shape (ROWS, n); None before a sample.
        slot: Which of its two slots they stand in; sums are then formed in the same order, so
            that a resumed observer is bit-equal.
        noise: Momentum noise per joint for smoothing, shape (n,); None without.
    """

    rows: Array | None
    slot: int = 0
    noise: Array | None = None


def gain_vector(gain_per_s: float | ArrayLike, joints: int) -> Array:
    """Observer gains as one positive number per joint.

    Args:
        gain_per_s: One gain for all joints, or one each [1/s].
        joints: Number of joints.

    Raises:
        ConfigurationError: If a gain is not finite and positive, or their number is wrong.
    """
    gain = (
        np.array(np.broadcast_to(np.asarray(gain_per_s, dtype=np.float64), joints))
        if (np.ndim(gain_per_s) == 0 or np.shape(gain_per_s) == (joints,))
        else None
    )
    if gain is None or not (np.isfinite(gain).all() and (gain > 0).all()):
        raise ConfigurationError(
            f"gain_per_s is {gain_per_s!r}, expected one positive number or {joints} of them [1/s]"
        )
    return gain


class MomentumObserver:
    """Residual of the generalised momentum, by the exact step of `momentum_step`.

    The first sample only seats the momentum, so a start on a moving arm makes no spike; after a
    gap in time longer than ``max_gap_s`` the momentum is seated anew and the residual goes on from
    its last value, rather than integrating across the hole.

    Args:
        robot: The arm with its payload.
        gain_per_s: K, one for all joints or one each [1/s]; 1/K is the lag of the residual.
        alignment: How torque fills a tick, see `Alignment`.
        friction: Joint friction between torque sensor and link, if any is modelled.
        max_gap_s: Longest time step that is still integrated [s].

    Raises:
        ConfigurationError: For a gain, alignment or gap that cannot work.
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
        check_alignment(alignment)
        check_gap(max_gap_s)
        self._gain = gain_vector(gain_per_s, robot.nv)
        self._gain_of_all = float(self._gain[0]) if np.ndim(gain_per_s) == 0 else None
        self._terms = MomentumTerms(robot, friction)
        self._alignment: Alignment = alignment
        self._max_gap_s = max_gap_s
        self._joints = robot.nv
        # Two sample slots take turns as "before" and "after": a refused sample has only written
        # into the spare one, so the state stays as it was.
        self._rows = np.zeros((2 * ROWS, robot.nv))
        self._joint_rows = self._rows.T
        self._slots = tuple(tuple(self._rows[k * ROWS + i] for i in range(ROWS)) for k in (0, 1))
        self._flat_slots = tuple(self._rows[k * ROWS : (k + 1) * ROWS].reshape(-1) for k in (0, 1))
        self._spare = 0
        self._seated = False
        self._learn(None)
        self._change_tick(max_gap_s)

    @property
    def residual(self) -> Array:
        """Latest residual [Nm], shape (n,), a copy; zeros before the first sample."""
        return self._slots[1 - self._spare][0].copy()

    @property
    def data(self) -> pin.Data:
        """Workspace in which joint placements and Jacobians of the latest sample stand."""
        return self._terms.data

    @property
    def gain_per_s(self) -> Array:
        """K per joint [1/s], shape (n,), a copy."""
        return self._gain.copy()

    def update(self, q: ArrayLike, dq: ArrayLike, tau: ArrayLike, dt_s: float) -> Array:
        """Take one sample and return the residual.

        Args:
            q: Joint positions [rad], shape (n,).
            dq: Joint velocities [rad/s], shape (n,).
            tau: Measured link-side joint torques [Nm], shape (n,).
            dt_s: Time since the previous sample [s]; not read on the first one.

        Returns:
            Estimate of the external joint torque, environment on robot [Nm], shape (n,), a new
            read-only array.

        Raises:
            SampleError: For a wrong shape, a number that is not finite or a time step that does
                not advance; the state is then unchanged.
        """
        rows = read_rows(_NAMES, (q, dq, tau), self._joints)
        position = rows[0]
        # The dynamics tell whether dq and tau are plausible, but not how large q is.
        if not math.hypot(*position.tolist()) < MOST_PLAUSIBLE:
            check_joint_vector("q", position, self._joints)
        dt_s = check_interval(dt_s) if self._seated else 0.0
        residual = self.absorb(position, rows[1], rows[2], dt_s).copy()
        residual.setflags(False)  # pyright: ignore[reportCallIssue]  # thrice as long by name
        return residual

    def absorb(self, q: Array, dq: Array, tau: Array, dt_s: float) -> Array:
        """As `update`, for arrays of the right shape and a time step that somebody has checked.

        The array returned is the observer's own: the next call but one writes it anew.

        Raises:
            SampleError: For numbers that are not finite; the state is then unchanged.
        """
        is_next = self._seated and dt_s <= self._max_gap_s
        spare, lasts_s = self._spare, dt_s if is_next else 0.0
        if COMPILER:
            dynamics = self._terms.at(q, dq)
            size = momentum_tick(self._rows, spare, dynamics, dq, tau, lasts_s, self._settings)
        else:
            size = self._array_tick(q, dq, tau, lasts_s)
        residual_row = self._slots[spare][0]
        # Written so that a NaN is refused too.
        if not size < MOST_PLAUSIBLE**2:
            # This row is read with a factor of zero, which would not silence a NaN.
            residual_row[:] = 0.0
            self._refuse(q, dq, tau)
        self._spare = 1 - spare
        self._seated = True
        return residual_row

    def _array_tick(self, q: Array, dq: Array, tau: Array, dt_s: float) -> float:
        """As `momentum_tick`, in arrays: without a compiler they are faster than loops."""
        if dt_s != self._dt_s and dt_s > 0.0:
            self._change_tick(dt_s)
        spare = self._spare
        residual, momentum, coriolis, gravity, torque = self._slots[spare]
        self._terms.write(q, dq, momentum, coriolis, gravity)
        torque[:] = tau
        if dt_s > 0.0:
            if self._noise is not None:
                before = self._slots[1 - spare][1]
                momentum -= smoothing_step(before, momentum, self._noise, self._smoothing_tick)
            residual[:] = self._combine(self._coefficients[spare])
        else:
            residual[:] = self._slots[1 - spare][0]
        written = self._flat_slots[spare]
        return float(written.dot(written))

    def smooth_momentum(self, velocity_noise_rad_s: Array, q: Array) -> None:
        """From now on quieten the momentum of an arm that hardly accelerates.

        See `residual.momentum_observer`. Joints whose velocity has no noise pass untouched.

        Args:
            velocity_noise_rad_s: Standard deviation of ``dq`` per joint [rad/s], shape (n,).
            q: Configuration about which the arm will move [rad], shape (n,): its inertia turns
                noise of velocity into noise of momentum.

        Raises:
            SampleError: For a wrong shape or a number that is not finite.
        """
        noise = check_joint_vector("velocity_noise_rad_s", velocity_noise_rad_s, self._joints)
        q = check_joint_vector("q", q, self._joints)
        variance = self._terms.momentum_variance(noise, q)
        self._learn(np.sqrt(variance) + _LEAST_MOMENTUM_NOISE)

    def _change_tick(self, dt_s: float) -> None:
        """Renew what depends on the length of the tick: on an even clock that is once."""
        gain = self._gain if self._gain_of_all is None else self._gain_of_all
        before, after = step_coefficients(gain, dt_s, self._alignment)
        self._coefficients = (
            np.concatenate((after, before), axis=-1),
            np.concatenate((before, after), axis=-1),
        )
        self._smoothing_tick = smoothing_tick(dt_s)
        self._dt_s = dt_s

    def _learn(self, noise: Array | None) -> None:
        """Take over the noise of the momentum; None where it passes untouched."""
        self._noise = noise
        noise_threshold = (
            NOISE_THRESHOLD_SIGMAS * noise
            if noise is not None
            else np.full(self._joints, _NO_NOISE_THRESHOLD)
        )
        self._settings = (self._gain, noise_threshold, BANDWIDTH_PER_S, self._alignment == "hold")

    def _combine(self, coefficients: Array) -> Array:
        """Residual after the tick, from the rows in place."""
        if self._gain_of_all is not None:
            return coefficients.dot(self._rows)
        return np.vecdot(coefficients, self._joint_rows)

    def _refuse(self, *sample: ArrayLike) -> NoReturn:
        for name, value in zip(("q", "dq", "tau"), sample, strict=True):
            check_joint_vector(name, value, self._joints)
        raise SampleError(
            "q, dq and tau are finite but the dynamics are not plausible; check their units"
        )

    @property
    def state(self) -> MomentumState:
        """All that the observer remembers, as copies."""
        if not self._seated:
            return MomentumState(None, noise=self._noise)
        slot = 1 - self._spare
        return MomentumState(self._rows[slot * ROWS : (slot + 1) * ROWS].copy(), slot, self._noise)

    def restore(self, state: MomentumState) -> None:
        """Go on from a `state` taken earlier.

        Raises:
            ConfigurationError: If it belongs to a robot with another number of joints, or is
                damaged; nothing has then changed.
        """
        rows, noise, n = state.rows, state.noise, self._joints
        if rows is not None and rows.shape != (ROWS, n):
            raise ConfigurationError(f"state has rows of shape {rows.shape}, expected {(ROWS, n)}")
        if noise is not None and not (noise.shape == (n,) and (noise > 0.0).all()):
            raise ConfigurationError(f"state has noise {noise}, expected {n} positive numbers")
        self._seated = rows is not None
        self._learn(noise)
        if rows is None:
            self._rows[:] = 0.0
            self._spare = 0
            return
        self._spare = 1 - state.slot
        self._rows[state.slot * ROWS : (state.slot + 1) * ROWS] = rows

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.restore(MomentumState(None))
