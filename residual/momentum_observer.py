"""The momentum observer: joint signals in, external joint torque out.

Momentum ``p = M(q) dq`` obeys ``dp/dt = tau + C' dq - g - tau_f + tau_ext``. With
``u = tau + C' dq - (g + tau_f)`` the residual ``dr/dt = K (dp/dt - u - r)`` is the first-order
low-pass of the external torque (paper, Section IV; Haddadin et al. 2017).
"""

import math
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from needleforce.jit import Matrix, Vector, WrittenMatrix, compiled
from residual.errors import ConfigurationError
from residual.input_validation import (
    MOST_PLAUSIBLE,
    all_fit,
    check_choice,
    check_interval,
    check_joint_vector,
    check_positive,
    read_joint_vector,
)
from residual.joint_friction import FrictionModel
from urdf import Robot

Array = NDArray[np.float64]
Alignment = Literal["hold", "trapezoid"]
"""How torque fills a tick: ``hold``, the torque of the earlier sample acts until the next one
(a commanded torque); ``trapezoid``, the mean of both samples (a sampled sensor)."""
ALIGNMENTS = ("hold", "trapezoid")

BANDWIDTH_PER_S = 10.0
"""Bandwidth of the smoothed momentum at rest [1/s]: well below that of the torque, which alone
carries a rupture."""
NOISE_THRESHOLD_SIGMAS = 3.0
"""Distance, in standard deviations of the momentum, at which the bandwidth has doubled."""
_LEAST_MOMENTUM_NOISE = 1e-9
"""Keeps the ratios of `momentum_step` finite for a signal without noise [kg m^2/s]."""
_NAMES = ("q", "dq", "tau")
_PACKED = {(8,)}
"""Distance in memory of the numbers of a contiguous array, as compiled code takes them."""


class StepRows(NamedTuple):
    """What one step of the residual is linear in, or the weights of these rows; arrays (n,)."""

    residual: Any  # r before the tick [Nm]
    momentum_before: Any  # p at its start [kg m^2/s]
    coriolis_before: Any  # C' dq there [Nm]
    gravity_before: Any  # g + tau_f there [Nm]
    torque_before: Any  # tau there [Nm]
    momentum: Any  # p at its end; the last four are in the same order
    coriolis: Any  # C' dq there
    gravity: Any  # g + tau_f there
    torque: Any  # tau there


BEFORE = 5
"""So many of them are known before the tick."""


def step_weights(gain_per_s: float | Array, dt_s: float, alignment: Alignment) -> Array:
    """Weights of the exact step ``r+ = a r + (1 - a) ((p+ - p)/dt - mean(u))``, a = exp(-K dt).

    It is stable for every K dt, has no start-up spike, and is linear in `StepRows`.

    Args:
        gain_per_s: K [1/s]: one for all joints, or an array of shape (n,).
        dt_s: Length of the tick [s].
        alignment: How torque fills the tick.

    Returns:
        One weight for each of `StepRows`, shape (1, 9), or (n, 9) for one gain per joint.
    """
    expm1 = math.expm1 if isinstance(gain_per_s, float) else np.expm1
    gained = -expm1(-gain_per_s * dt_s)
    per_second, half, zero = gained / dt_s, 0.5 * gained, 0.0 * gained
    held = alignment == "hold"
    weights = StepRows(
        residual=1.0 - gained,
        momentum_before=-per_second,
        coriolis_before=-half,
        gravity_before=half,
        torque_before=-gained if held else -half,
        momentum=per_second,
        coriolis=-half,
        gravity=half,
        torque=zero if held else -half,
    )
    array = np.array(weights)
    return array[None] if array.ndim == 1 else np.ascontiguousarray(array.T)


@compiled
def momentum_step(
    rows: WrittenMatrix,
    dynamics: tuple[Matrix, Matrix, Vector],
    velocity: Vector,
    tau: Vector,
    weights: Matrix,
    noise_threshold: Vector,
    dt_s: float,
) -> None:
    """One tick of the residual: the momentum is smoothed, then comes the step of `step_weights`.

    During an insertion the arm's own inertial force is a few hundredths of a newton, but the noise
    of the velocity, differentiated, is the largest noise of the residual. The momentum therefore
    passes a lag whose bandwidth grows with the distance it has fallen behind, and which steps aside
    when the arm accelerates (compare the "one euro" filter, Casiez et al., CHI 2012). Its step is
    the implicit one, which never overshoots.

    Args:
        rows: `StepRows`, shape (9, n); all are brought to the end of the tick.
        dynamics: M, C and g + tau_f at its end.
        velocity: dq there [rad/s], shape (n,).
        tau: Measured torque there [Nm], shape (n,).
        weights: See `step_weights`, shape (1, 9), or (n, 9) for one gain per joint.
        noise_threshold: Distance at which the bandwidth has doubled, shape (n,); of length 0 where
            nothing is smoothed.
        dt_s: Length of the tick [s]; 0 at a first sample, which only sets the momentum.
    """
    inertia, coriolis_matrix, load = dynamics
    residual, last_momentum = rows[0], rows[1]
    momentum, coriolis, gravity, torque = rows[5], rows[6], rows[7], rows[8]
    np.dot(inertia, velocity, momentum)
    np.dot(velocity, coriolis_matrix, coriolis)
    gravity[:] = load
    torque[:] = tau
    if dt_s > 0.0:
        if noise_threshold.size:
            tick = BANDWIDTH_PER_S * dt_s
            behind = momentum - last_momentum
            ratio = behind / noise_threshold
            ratio *= ratio
            ratio *= ratio
            # behind / (1 + tick (1 + ratio^4)) remains.
            ratio *= tick
            ratio += 1.0 + tick
            behind /= ratio
            momentum -= behind
        if len(weights) == 1:
            residual[:] = weights[0].dot(rows)
        else:
            residual[:] = (weights.T * rows).sum(axis=0)
    rows[1:BEFORE] = rows[BEFORE:]


class MomentumTerms:
    """Dynamics of one robot, straight from Pinocchio.

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

    def at(self, q: Array, dq: Array) -> tuple[Array, Array, Array]:
        """M [kg m^2] and C, both (n, n), and g + tau_f [Nm], (n,), at (q, dq), both (n,)."""
        model, data = self._model, self.data
        inertia = pin.crba(model, data, q)
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq)
        gravity = pin.computeGeneralizedGravity(model, data, q)
        if self._friction is not None:
            # A model that writes into its argument must not change the caller's sample.
            still = dq.view()
            still.setflags(write=False)
            gravity += self._friction.torque(still)
        return inertia, coriolis, gravity

    def momentum_variance(self, velocity_noise_rad_s: Array, q: Array) -> Array:
        """Variance of M(q) dq for a velocity noise per joint [rad/s], shape (n,)."""
        inertia = pin.crba(self._model, self.data, q)
        return np.square(inertia).dot(np.square(velocity_noise_rad_s))


def _check_length(friction: FrictionModel, joints: int) -> None:
    try:
        shape = np.shape(friction.torque(np.zeros(joints)))
    except ValueError as error:
        raise ConfigurationError(
            f"friction does not fit a robot of {joints} joints: {error}"
        ) from error
    if shape != (joints,):
        raise ConfigurationError(f"friction gives torques of shape {shape}, expected ({joints},)")


class MomentumState(NamedTuple):
    """All that a `MomentumObserver` remembers."""

    rows: Array | None  # The first five of `StepRows`, shape (BEFORE, n); None before a sample
    noise: Array | None = None  # Momentum noise per joint for smoothing, shape (n,); None without


class MomentumObserver:
    """Residual of the generalised momentum, by the exact step of `momentum_step`.

    The first sample only sets the momentum, so a start on a moving arm makes no spike; after a
    gap in time longer than ``max_gap_s`` the momentum is set anew and the residual goes on from
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
        check_choice("alignment", alignment, ALIGNMENTS)
        check_positive("max_gap_s", max_gap_s)
        n = self._joints = robot.nv
        gains = _gain_vector(gain_per_s, n)
        # Plain floats where one gain serves all: on an uneven clock its weights change every tick.
        self._gain = float(gains[0]) if np.ndim(gain_per_s) == 0 else gains
        self._terms = MomentumTerms(robot, friction)
        self._alignment: Alignment = alignment
        self._max_gap_s = max_gap_s
        self._rows = np.zeros((len(StepRows._fields), n))
        self._weights = np.zeros((1 if isinstance(self._gain, float) else n, len(self._rows)))
        self._dt_s = math.nan
        self.reset()

    @property
    def residual(self) -> Array:
        """Latest residual [Nm], shape (n,), a copy; zeros before the first sample."""
        return self._rows[0].copy()

    @property
    def data(self) -> pin.Data:
        """Workspace in which joint placements and Jacobians of the latest sample stand."""
        return self._terms.data

    @property
    def gain_per_s(self) -> Array:
        """K per joint [1/s], shape (n,), a copy."""
        return np.full(self._joints, self._gain)

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
        sample: Any = (q, dq, tau)
        if not all_fit(sample, self._joints) or {sample[1].strides, sample[2].strides} != _PACKED:
            sample = [
                np.ascontiguousarray(read_joint_vector(name, value, self._joints))
                for name, value in zip(_NAMES, sample, strict=True)
            ]
        position, velocity, torque = sample
        # One number stands for all; a NaN fails.
        numbers = (*position.tolist(), *velocity.tolist(), *torque.tolist())
        if not math.hypot(*numbers) < MOST_PLAUSIBLE:
            for name, value in zip(_NAMES, sample, strict=True):
                check_joint_vector(name, value, self._joints)
        dt_s = check_interval(dt_s) if self._initialized else 0.0
        residual = self.absorb(position, velocity, torque, dt_s)
        residual.setflags(False)  # pyright: ignore[reportCallIssue]  # thrice as long by name
        return residual

    def absorb(self, q: Array, dq: Array, tau: Array, dt_s: float) -> Array:
        """As `update`, for finite, contiguous arrays of the right shape and a checked time step."""
        if not self._initialized or dt_s > self._max_gap_s:
            self._initialized, dt_s = True, 0.0
        elif dt_s != self._dt_s:  # on an even clock that is once
            self._weights = step_weights(self._gain, dt_s, self._alignment)
            self._dt_s = dt_s
        rows, threshold = self._rows, self._noise_threshold
        momentum_step(rows, self._terms.at(q, dq), dq, tau, self._weights, threshold, dt_s)
        return rows[0].copy()

    def smooth_momentum(self, velocity_noise_rad_s: Array, q: Array) -> None:
        """From now on quieten the momentum of an arm that hardly accelerates, see `momentum_step`.

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
        self._set_noise(np.sqrt(variance) + _LEAST_MOMENTUM_NOISE)

    def _set_noise(self, noise: Array | None) -> None:
        self._noise = noise
        self._noise_threshold = np.zeros(0) if noise is None else NOISE_THRESHOLD_SIGMAS * noise

    @property
    def state(self) -> MomentumState:
        """All that the observer remembers, as copies."""
        return MomentumState(self._rows[:BEFORE].copy() if self._initialized else None, self._noise)

    def restore(self, state: MomentumState) -> None:
        """Go on from a `state` taken earlier.

        Raises:
            ConfigurationError: If it belongs to a robot with another number of joints, or is
                damaged; nothing has then changed.
        """
        rows, noise, n = state.rows, state.noise, self._joints
        if rows is not None and rows.shape != (BEFORE, n):
            raise ConfigurationError(
                f"state has rows of shape {rows.shape}, expected {(BEFORE, n)}"
            )
        if noise is not None and not (noise.shape == (n,) and (noise > 0.0).all()):
            raise ConfigurationError(f"state has noise {noise}, expected {n} positive numbers")
        self._initialized = rows is not None
        self._set_noise(noise)
        self._rows[:BEFORE] = 0.0 if rows is None else rows

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.restore(MomentumState(None))


def _gain_vector(gain_per_s: float | ArrayLike, joints: int) -> Array:
    """Observer gains as one positive number per joint, shape (n,) [1/s]."""
    if np.shape(gain_per_s) in ((), (joints,)):
        gain = np.array(np.broadcast_to(np.asarray(gain_per_s, dtype=np.float64), joints))
        if np.isfinite(gain).all() and (gain > 0).all():
            return gain
    raise ConfigurationError(
        f"gain_per_s is {gain_per_s!r}, expected one positive number or {joints} of them [1/s]"
    )
