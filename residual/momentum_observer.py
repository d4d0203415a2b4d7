"""The momentum observer: joint signals in, external joint torque out.

Momentum ``p = M(q) dq`` obeys ``dp/dt = tau + C' dq - g - tau_f + tau_ext``. With
``u = tau + C' dq - (g + tau_f)`` the residual ``dr/dt = K (dp/dt - u - r)`` is the first-order
low-pass of the external torque (paper, Section IV; Haddadin et al. 2017).
"""

import math
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from needleforce.jit import Matrix, Vector, WrittenMatrix, compiled
from residual.errors import Array, ConfigurationError
from residual.input_validation import (
    MOST_PLAUSIBLE,
    all_fit,
    check_choice,
    check_interval,
    check_joint_vector,
    check_positive,
    check_rows,
    read_rows,
)
from urdf import Robot

Alignment = Literal["hold", "trapezoid"]
"""How torque fills a tick: ``hold``, the torque of the earlier sample acts until the next one
(a commanded torque); ``trapezoid``, the mean of both samples (a sampled sensor)."""

BANDWIDTH_PER_S = 10.0
"""Bandwidth of the smoothed momentum at rest [1/s]: well below that of the torque, which alone
carries a rupture."""
NOISE_THRESHOLD_SIGMAS = 3.0  # Distance of the momentum at which the bandwidth has doubled
_LEAST_MOMENTUM_NOISE = 1e-9  # [kg m^2/s] Keeps the ratios of `momentum_step` finite
_NAMES = ("q", "dq", "tau")
_PACKED = {(8,)}  # distance in memory of the numbers of a contiguous array

RESIDUAL, MOMENTUM, CORIOLIS, GRAVITY, TORQUE = range(5)
"""Rows of a step at the start of a tick: r [Nm], p [kg m^2/s], C' dq, g + tau_f and tau [Nm]."""
END = 4  # the last four at the end of the tick follow in the same order
BEFORE, ROWS = 5, 9  # so many rows are known before the tick, and so many there are


@compiled
def set_step_weights(weights: WrittenMatrix, gains_per_s: Vector, dt_s: float, held: bool) -> None:
    """Set the weights of the exact step ``r+ = a r + (1 - a) ((p+ - p)/dt - mean(u))``.

    With a = exp(-K dt) it is stable for every K dt, has no start-up spike, and is linear in the
    rows of `momentum_step`.

    One weight per row is written, shape (1, 9), or (n, 9) for one gain K [1/s] per joint; ``held``
    says whether torque is held over the tick [s], see `Alignment`.
    """
    for k in range(len(gains_per_s)):
        gained = -math.expm1(-float(gains_per_s[k]) * dt_s)
        row, half = weights[k], 0.5 * gained
        row[RESIDUAL] = 1.0 - gained
        row[MOMENTUM], row[MOMENTUM + END] = -gained / dt_s, gained / dt_s
        row[CORIOLIS], row[CORIOLIS + END] = -half, -half
        row[GRAVITY], row[GRAVITY + END] = half, half
        row[TORQUE], row[TORQUE + END] = (-gained, 0.0) if held else (-half, -half)


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
    """One tick of the residual: the momentum is smoothed, then comes the exact step.

    During an insertion the arm's own inertial force is a few hundredths of a newton, but the noise
    of the velocity, differentiated, is the largest noise of the residual. The momentum therefore
    passes a lag whose bandwidth grows with the distance it has fallen behind, and which steps aside
    when the arm accelerates (compare the "one euro" filter, Casiez et al., CHI 2012). Its step is
    the implicit one, which never overshoots.

    Args:
        rows: See `RESIDUAL` and the others, shape (9, n); all are brought to the end of the tick.
        dynamics: M, C and g + tau_f at its end.
        velocity: dq there [rad/s], shape (n,).
        tau: Measured torque there [Nm], shape (n,).
        weights: See `set_step_weights`.
        noise_threshold: Distance at which the bandwidth has doubled, shape (n,); of length 0 where
            nothing is smoothed.
        dt_s: Length of the tick [s]; 0 at a first sample, which only sets the momentum.
    """
    inertia, coriolis_matrix, load = dynamics
    momentum = inertia.dot(velocity)
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
    rows[MOMENTUM + END] = momentum
    rows[CORIOLIS + END] = velocity.dot(coriolis_matrix)
    rows[GRAVITY + END] = load
    rows[TORQUE + END] = tau
    if dt_s > 0.0:
        if len(weights) == 1:
            rows[RESIDUAL] = weights[0].dot(rows)
        else:
            rows[RESIDUAL] = (weights.T * rows).sum(axis=0)
    rows[MOMENTUM:BEFORE] = rows[BEFORE:]


_MOST_EXPONENT = 700.0  # Its exponential is a float still, and the sigmoid is zero there


class FrictionModel(Protocol):
    """Anything that gives the friction torque of every joint at a velocity."""

    def torque(self, dq: Array) -> Array:
        """Torque that opposes the motion [Nm], shape (n,), at velocity ``dq`` [rad/s]."""
        ...


def _frozen_vectors(owner: object, names: tuple[str, ...]) -> None:
    """Store each named field as a read-only float copy; all of one length."""
    sizes = set()
    for name in names:
        given = getattr(owner, name)
        try:
            array = np.full(0, np.nan) if np.iscomplexobj(given) else np.array(given, dtype=float)
        except (TypeError, ValueError, OverflowError):
            array = np.full(0, np.nan)
        array = np.atleast_1d(array)
        if array.ndim != 1 or array.size == 0 or not np.isfinite(array).all():
            raise ConfigurationError(f"{name} must be one finite number per joint, got {given!r}")
        array.setflags(write=False)
        object.__setattr__(owner, name, array)
        sizes.add(array.size)
    if len(sizes) > 1:
        raise ConfigurationError(f"{', '.join(names)} differ in length: {sorted(sizes)}")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointFriction:
    """Viscous and Coulomb friction with a smooth reversal, plus a constant offset.

    ``tau_f = viscous * dq + coulomb * tanh(dq / reversal_speed) + offset``

    Attributes:
        viscous_Nms: Viscous coefficient per joint [Nm s/rad].
        coulomb_Nm: Coulomb level per joint [Nm].
        offset_Nm: Constant per joint [Nm].
        reversal_speed_rad_s: Speed over which Coulomb friction changes sign [rad/s].

    Raises:
        ConfigurationError: If lengths differ, a number is not finite, a viscous or Coulomb
            coefficient is negative, or the reversal speed is not positive.
    """

    viscous_Nms: Array
    coulomb_Nm: Array
    offset_Nm: Array
    reversal_speed_rad_s: float = 0.01

    def __post_init__(self) -> None:
        _frozen_vectors(self, ("viscous_Nms", "coulomb_Nm", "offset_Nm"))
        if (self.viscous_Nms < 0).any() or (self.coulomb_Nm < 0).any():
            raise ConfigurationError("viscous_Nms and coulomb_Nm must not be negative")
        check_positive("reversal_speed_rad_s", self.reversal_speed_rad_s)

    def torque(self, dq: Array) -> Array:
        """Friction torque opposing the motion [Nm], shape (n,)."""
        smooth_sign = np.tanh(dq / self.reversal_speed_rad_s)
        return self.viscous_Nms * dq + self.coulomb_Nm * smooth_sign + self.offset_Nm


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SigmoidFriction:
    """The Franka Panda's friction as identified by Gaz et al., RA-L 2019.

    ``tau_f = A / (1 + exp(-alpha (dq + s))) - A / (1 + exp(-alpha s))``: zero at rest, with a
    level that may differ between the two directions.

    Attributes:
        amplitude_Nm: A per joint [Nm].
        slope_s_rad: alpha per joint [s/rad].
        shift_rad_s: s per joint [rad/s].

    Raises:
        ConfigurationError: If lengths differ or a number is not finite.
    """

    amplitude_Nm: Array
    slope_s_rad: Array
    shift_rad_s: Array
    _level_at_rest: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        _frozen_vectors(self, ("amplitude_Nm", "slope_s_rad", "shift_rad_s"))
        object.__setattr__(self, "_level_at_rest", self._sigmoid(self.shift_rad_s))

    def torque(self, dq: Array) -> Array:
        """Friction torque opposing the motion [Nm], shape (n,)."""
        return self.amplitude_Nm * (self._sigmoid(dq + self.shift_rad_s) - self._level_at_rest)

    def _sigmoid(self, speed: Array) -> Array:
        return 1.0 / (1.0 + np.exp(np.minimum(-self.slope_s_rad * speed, _MOST_EXPONENT)))


def _check_friction(friction: FrictionModel, joints: int) -> None:
    try:
        torques = [friction.torque(np.full(joints, speed)) for speed in (0.0, 0.1, -0.1)]
    except ValueError as error:
        raise ConfigurationError(f"friction does not fit {joints} joints: {error}") from error
    for torque in torques:
        if np.shape(torque) != (joints,) or not np.isfinite(torque).all():
            raise ConfigurationError(f"friction gives {torque!r}, expected {joints} finite numbers")


@dataclass(slots=True, eq=False)
class MomentumState:
    """All that a `MomentumObserver` remembers."""

    rows: Array  # Of the last step, shape (ROWS, n)
    started: bool = False  # Whether there was one
    noise: Array | None = None  # Momentum noise per joint for smoothing, shape (n,); None without


class MomentumObserver:
    """Residual of the generalised momentum, by the exact step of `momentum_step`.

    The first sample only sets the momentum, so a start on a moving arm makes no spike; after a
    gap in time longer than ``max_gap_s`` the momentum is set anew and the residual goes on from
    its last value, rather than integrating across the hole.

    Rotor inertia, where an arm needs it (motor-current torque), is part of the robot's model
    (`Robot.with_armature`); on the LWR, whose torque is measured behind the gear, it is zero.

    Args:
        robot: The arm with its payload.
        gain_per_s: K, one for all joints or one each [1/s]; 1/K is the lag of the residual.
        alignment: How torque fills a tick, see `Alignment`.
        friction: Joint friction between torque sensor and link, if any is modelled.
        max_gap_s: Longest time step that is still integrated [s].

    Attributes:
        data: Workspace; joint placements and Jacobians of the latest sample stand in it.
        memory: All that it remembers.

    Raises:
        ConfigurationError: For a gain, alignment or gap that cannot work, or friction of another
            number of joints.
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
        gains = _gain_vector(gain_per_s, n)
        # One where it serves all: on an uneven clock its weights change every tick.
        self._gains = gains[:1].copy() if np.ndim(gain_per_s) == 0 else gains
        if friction is not None:
            _check_friction(friction, n)
        self._model, self._friction = robot.model, friction
        self.data = robot.create_data()
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
            Estimate of the external joint torque, environment on robot [Nm], shape (n,), a new
            read-only array.

        Raises:
            SampleError: For a wrong shape, a number that is not finite or a time step that does
                not advance; the state is then unchanged.
        """
        sample: Any = (q, dq, tau)
        # Compiled code takes contiguous arrays.
        if not all_fit(sample, self._joints) or {sample[1].strides, sample[2].strides} != _PACKED:
            sample = tuple(read_rows(_NAMES, sample, self._joints))
        position, velocity, torque = sample
        numbers = (*position.tolist(), *velocity.tolist(), *torque.tolist())
        if not math.hypot(*numbers) < MOST_PLAUSIBLE:
            check_rows(_NAMES, np.stack(sample))
        dt_s = check_interval(dt_s) if self.memory.started else 0.0
        residual = self.absorb(position, velocity, torque, dt_s)
        residual.setflags(False)  # pyright: ignore[reportCallIssue]  # thrice as long by name
        return residual

    def absorb(self, q: Array, dq: Array, tau: Array, dt_s: float) -> Array:
        """As `update`, for finite, contiguous arrays of the right shape and a checked time step."""
        memory = self.memory
        if not memory.started or dt_s > self._max_gap_s:
            memory.started, dt_s = True, 0.0
        elif dt_s != self._dt_s:  # on an even clock that is once
            set_step_weights(self._weights, self._gains, dt_s, self._held)
            self._dt_s = dt_s
        rows, weights, threshold = memory.rows, self._weights, self._noise_threshold
        momentum_step(rows, self._dynamics(q, dq), dq, tau, weights, threshold, dt_s)
        return rows[0].copy()

    def _dynamics(self, q: Array, dq: Array) -> tuple[Array, Array, Array]:
        """M [kg m^2] and C, both (n, n), and g + tau_f [Nm], (n,), at (q, dq), both (n,)."""
        model, data = self._model, self.data
        inertia = pin.crba(model, data, q)
        coriolis = pin.computeCoriolisMatrix(model, data, q, dq)
        load = pin.computeGeneralizedGravity(model, data, q)
        if self._friction is not None:
            # A model that writes into its argument must not change the caller's sample.
            still = dq.view()
            still.setflags(write=False)
            load += self._friction.torque(still)
        return inertia, coriolis, load

    def smooth_momentum(self, velocity_noise_rad_s: Array, q: Array) -> None:
        """From now on smooth the momentum of an arm that hardly accelerates, see `momentum_step`.

        Args:
            velocity_noise_rad_s: Standard deviation of ``dq`` per joint [rad/s], shape (n,).
            q: Configuration about which the arm will move [rad], shape (n,): its inertia turns
                noise of velocity into noise of momentum.
        """
        noise = check_joint_vector("velocity_noise_rad_s", velocity_noise_rad_s, self._joints)
        inertia = pin.crba(self._model, self.data, check_joint_vector("q", q, self._joints))
        variance = np.square(inertia).dot(np.square(noise))
        self.memory.noise = np.sqrt(variance) + _LEAST_MOMENTUM_NOISE
        self.restore(self.memory)

    def restore(self, memory: MomentumState) -> None:
        """Go on from a `memory`, which is kept, of an observer of the same robot and settings.

        Raises:
            ConfigurationError: If it belongs to a robot with another number of joints, or is
                damaged; nothing has then changed.
        """
        rows, noise, n = memory.rows, memory.noise, self._joints
        if rows.shape != (ROWS, n):
            raise ConfigurationError(f"state has rows of shape {rows.shape}, expected {(ROWS, n)}")
        if noise is not None and not (noise.shape == (n,) and (noise > 0.0).all()):
            raise ConfigurationError(f"state has noise {noise}, expected {n} positive numbers")
        self.memory = memory
        self._noise_threshold = np.zeros(0) if noise is None else NOISE_THRESHOLD_SIGMAS * noise

    def reset(self) -> None:
        """Forget everything; the next sample is a first one."""
        self.restore(MomentumState(np.zeros((ROWS, self._joints))))


def _gain_vector(gain_per_s: float | ArrayLike, joints: int) -> Array:
    """Observer gains as one positive number per joint, shape (n,) [1/s]."""
    if np.shape(gain_per_s) in ((), (joints,)):
        gain = np.array(np.broadcast_to(np.asarray(gain_per_s, dtype=np.float64), joints))
        if np.isfinite(gain).all() and (gain > 0).all():
            return gain
    raise ConfigurationError(
        f"gain_per_s is {gain_per_s!r}, expected one positive number or {joints} of them [1/s]"
    )
