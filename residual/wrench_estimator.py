"""From external joint torque to the wrench at a named frame: equation (13) and more.

Of the components of a force, one is *along* the insertion direction, the others are
*across* it, that is, perpendicular to it. The residual here is always r - r0: that of
the momentum observer, less the offset. How much of the force acts at the tip, and how
much along the shaft, is left to `identification`.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector, WrittenVector
from foundation.jit import compile_waiting, compiled, compiled_inside
from foundation.linear_algebra import (
    dot,
    multiply,
    multiply_transposed,
    multiply_vector,
)
from residual.checks.input import check_joint_vector
from residual.config import DEFAULT, SensorConfig
from residual.errors import ConfigurationError, SampleError
from residual.estimate import (
    GOOD,
    UNSEEN_STD,
    Assessment,
    WrenchEstimate,
)
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

COMPONENTS = {"axial": 1, "point": 3, "full": 6}
"""Number of unknowns of every mode."""

EXPECTED_TORQUE_NM = 10.0
"""In the mode ``full``: for torques what ``expected_force_N`` is for forces."""

MAX_TURN_RAD = 1e-3
"""A gain is used until the joints together have moved so far: the force is then off by
a thousandth of itself."""

SMOOTHED_SIGMAS = 2.0
"""Distance to the smoothed force, in standard deviations of the noise, at which the
bandwidth of the smoothing has doubled."""

MAX_HIDDEN_SIGMAS = 6.0
"""Largest error by lag that is remembered, in standard deviations of the force: after a
rupture it is over soon."""

MIN_NOISE_N2 = 1e-12
"""Smallest variance of a sample's noise: it keeps quotients by the noise finite."""

MIN_UNSEEN_PART = 1e-18
"""An unknown counts as unseen if the squares of its components along the unseen
directions add up to more than this: far above rounding and far below what matters."""

MAX_ASYMMETRY = 1e-6
"""Sum of the differences across the diagonal of a covariance, relative to its trace:
rounding makes less, a wrong matrix more."""

UNSEEN_VARIANCE = UNSEEN_STD**2
"""Variance of what is not known at all [N^2, (Nm)^2]."""

_NOTHING = np.zeros(3)
_NOTHING.setflags(write=False)

_UNTURNED = np.eye(3)


class WrenchGain(NamedTuple):
    """The map from joint torque to force at one configuration; arrays are read-only.

    Attributes:
        configuration_rad: Joint positions for which it was computed, shape (n,).
        matrix: Map from joint torque to force (and torque) in the axes asked for, shape
            (3 or 6, n).
        direction: Insertion direction in the same axes, shape (3,).
        variances_N2: Variance of the force along the insertion direction, and across it
            in the direction that is known least, shape (2,).
        noises_N2: The part of both that is noise of a single sample, shape (2,).
        covariance: As of `WrenchEstimate`.
        damping_fraction: As of `WrenchEstimate`.
        smallest_singular_value_m: Joint torque per newton in the least observable of
            the directions that the mode asks for; in the mode ``full`` a newton metre
            counts as a newton.
        unexplained: Quadratic form of `WrenchEstimator.mismatch_squared`, shape (n, n).
    """

    configuration_rad: Vector
    matrix: Matrix
    direction: Vector
    variances_N2: Vector
    noises_N2: Vector
    covariance: Array
    damping_fraction: Array
    smallest_singular_value_m: float
    unexplained: Array


class WrenchFilterState(NamedTuple):
    """What the smoothing of the wrench remembers; every tick writes into the arrays.

    Attributes:
        smoothed: Smoothed force (and torque) [N, Nm], shape (3,) or (6,).
        follower: The same filtered once more: its error shows what a lag hides.
        hidden_N2: Squared error by lag along and across the needle, shape (2,).
    """

    smoothed: Array
    follower: Array
    hidden_N2: Array

    @classmethod
    def at_zero(cls, components: int) -> "WrenchFilterState":
        """Return the state before the first sample, for 3 or 6 components."""
        return cls(np.zeros(components), np.zeros(components), np.zeros(2))


@compiled_inside
def pseudo_inverse(symmetric: Matrix) -> tuple[Array, Array]:
    """Return the pseudo-inverse of a symmetric matrix without negative eigenvalues.

    Directions whose information is below its rounding stay at zero. With it comes the
    sum of the squares of each unknown's components along these, shape (k,).
    """
    min_ratio = 1e-12  # of the largest eigenvalue
    count = len(symmetric)
    values, vectors = np.linalg.eigh(symmetric)
    min_eigenvalue = values[count - 1] * min_ratio
    inverse = np.zeros((count, count))
    unseen_part = np.zeros(count)
    for m in range(count):
        is_seen = values[m] > min_eigenvalue
        for i in range(count):
            component = vectors[i, m]
            if is_seen:
                for j in range(count):
                    inverse[i, j] += component * vectors[j, m] / values[m]
            else:
                unseen_part[i] += component * component
    return inverse, unseen_part


def inverse_of(covariance: Array) -> Array | None:
    """Return the inverse of a covariance, shape (n, n), None if it is not valid.

    A valid covariance is symmetric, positive definite and finite.
    """
    asymmetry = np.abs(covariance - covariance.T).sum()
    # Written so that a NaN is not valid either.
    if not asymmetry <= MAX_ASYMMETRY * abs(np.trace(covariance)):
        return None
    values, vectors = np.linalg.eigh(covariance)
    if values[0] <= 0.0:
        return None
    return (vectors / values).dot(vectors.T)


@compiled_inside
def solution_covariance(
    matrix: Matrix,
    error_covariance: Matrix,
    inverse: Matrix,
    unseen_part: Vector,
    damping: Vector,
) -> Array:
    """Return the covariance of the unknowns of `gain_at`, shape (k, k).

    It has `UNSEEN_STD` squared on the diagonal where they cannot be observed.

    Args:
        matrix: Map from joint torque to the unknowns, shape (k, n).
        error_covariance: Covariance of the torque's error [Nm^2], shape (n, n).
        inverse: Inverse of their information, shape (k, k).
        unseen_part: As of `pseudo_inverse`.
        damping: As of `gain_at`.
    """
    count = len(matrix)
    covariance = multiply_transposed(multiply(matrix, error_covariance), matrix)
    for i in range(count):
        for j in range(count):
            for k in range(count):
                covariance[i, j] += inverse[i, k] * damping[k] * inverse[k, j]
    for i in range(count):
        if unseen_part[i] > MIN_UNSEEN_PART:
            covariance[i, i] = UNSEEN_VARIANCE
    return covariance


@compiled_inside
def smallest_singular_value(rows: Matrix) -> float:
    """Return the smallest of the min(k, n) singular values of a (k, n) matrix."""
    count, joints = rows.shape
    eigenvalues = np.linalg.eigvalsh(multiply_transposed(rows, rows))
    return math.sqrt(max(eigenvalues[max(count - joints, 0)], 0.0))


@compiled_inside
def unexplained_form(rows: Matrix, precision: Matrix) -> Array:
    """Return the quadratic form of the joint torque that no wrench explains.

    The unknowns of the wrench make torque by ``rows``, shape (k, n). For a torque t,
    ``t . form . t`` is the mean square of what they leave of it, in units of its
    covariance, ``precision`` inverted; zero for as many unknowns as joints. Shape (n,
    n).
    """
    count, joints = rows.shape
    if count >= joints:
        return np.zeros((joints, joints))
    weighted = multiply(rows, precision)
    information = multiply_transposed(weighted, rows)
    inverse, _ = pseudo_inverse(information)
    solution = multiply(inverse, weighted)
    explained = multiply(np.ascontiguousarray(weighted.T), solution)
    return (precision - explained) / (joints - count)


@compiled_inside
def axial_variances(direction: Vector, covariance: Matrix) -> Array:
    """Return the variances of a force along and across a direction [N^2], shape (2,).

    Across it, it is the variance in the direction that is known least; if a component
    is not observed, both are those of the unseen. The mode ``axial`` assumes that there
    is no lateral force: its variance is not known.

    Args:
        direction: The direction, shape (3,).
        covariance: Of the components that the mode estimates, in the same axes, shape
            (k, k), the force first.
    """
    variances = np.full(2, UNSEEN_VARIANCE)
    if len(covariance) == 1:
        variances[0] = covariance[0, 0]
        return variances
    for i in range(3):
        if covariance[i, i] >= UNSEEN_VARIANCE:
            return variances
    of_force = np.ascontiguousarray(covariance[:3, :3])
    across = np.eye(3) - np.outer(direction, direction)  # the projector across it
    covariance_across = multiply(multiply(across, of_force), across)
    variances[0] = dot(direction, multiply_vector(of_force, direction))
    variances[1] = np.linalg.eigvalsh(covariance_across)[2]
    return variances


@compiled
def gain_at(
    q: Vector,
    jacobian: Matrix,
    rotation: Matrix,
    axis: Vector,
    covariance_Nm2: Matrix,
    noise_Nm2: Matrix,
    precision: Matrix,
    precision_of_error: Matrix,
    damping: Vector,
) -> WrenchGain:
    """Solve ``torque = J' x + error`` by weighted least squares: (13) generalised.

    ``x = (J W J' + D)^-1 J W torque``. With W the inverse covariance of the error this
    is the best linear estimate; W = 1 and D = 0 give the pseudo-inverse (J')# of the
    paper's equation (13). D is the inverse of the variance expected of x. It matters
    only where the joints hardly observe x: there it draws the estimate to zero, and the
    fraction that it removes is reported.

    W need not be the inverse of the error's covariance. `WrenchEstimator.compute_gain`
    takes W, where it weights, from the error of a single sample, but the error's
    covariance without the noise that the smoothing of the force removes later.

    Args:
        q: Joint positions [rad], shape (n,).
        jacobian: Of the tip, in the tool's axes, shape (6, n).
        rotation: From the tool's axes to those asked for, shape (3, 3).
        axis: Insertion direction in the tool's axes, shape (3,).
        covariance_Nm2: Covariance of the torque's error that is stated, shape (n, n),
            without noise that the smoothing removes.
        noise_Nm2: Noise of a single sample, shape (n, n).
        precision: W, shape (n, n).
        precision_of_error: Unit of what no wrench explains, shape (n, n).
        damping: Diagonal of D; one number per unknown: 1, 3 or 6.
    """
    count = len(damping)
    direction = multiply_vector(rotation, axis)
    force_rows = multiply(rotation, jacobian[:3])
    if count == 1:
        rows = multiply(direction.reshape((1, 3)), force_rows)
    elif count == 3:
        rows = force_rows
    else:
        rows = np.concatenate((force_rows, multiply(rotation, jacobian[3:])))
    weighted = multiply(rows, precision)
    information = multiply_transposed(weighted, rows)
    for i in range(count):
        information[i, i] += damping[i]
    inverse, unseen_part = pseudo_inverse(information)
    solution = multiply(inverse, weighted)
    matrix = solution
    if count == 1:
        matrix = multiply(direction.reshape((3, 1)), solution)
    covariance = solution_covariance(
        solution, covariance_Nm2, inverse, unseen_part, damping
    )
    noise = multiply_transposed(multiply(solution, noise_Nm2), solution)
    for i in range(count):
        noise[i, i] += MIN_NOISE_N2
    return WrenchGain(
        q.copy(),
        matrix,
        direction,
        axial_variances(direction, covariance),
        axial_variances(direction, noise),
        covariance,
        np.diag(inverse) * damping,
        smallest_singular_value(rows),
        unexplained_form(rows, precision_of_error),
    )


@compiled
def has_turned(q: Vector, configuration_rad: Vector) -> bool:
    """Return whether the arm has turned too far for the gain of a configuration.

    Both are joint positions [rad], shape (n,); a NaN is too far.
    """
    total = 0.0
    for j in range(len(q)):
        turn_rad = q[j] - configuration_rad[j]
        total += turn_rad * turn_rad
    return not total <= MAX_TURN_RAD**2


@compiled_inside
def split_force(direction: Vector, force: Vector) -> tuple[float, float]:
    """Return the force along a direction [N], and the square of that across [N^2].

    Of a wrench the first three components are the force.
    """
    along = direction[0] * force[0] + direction[1] * force[1] + direction[2] * force[2]
    square = force[0] * force[0] + force[1] * force[1] + force[2] * force[2]
    return along, square - along * along


@compiled_inside
def smoothing_step(
    smoothed: WrittenVector,
    wrench: Vector,
    direction: Vector,
    noises_N2: Vector,
    adaptive_lag: float,
    fixed_lag: float,
) -> tuple[float, float]:
    """Bring a smoothed wrench [N, Nm], shape (3,) or (6,), to the end of a tick.

    While the force stays within its noise it passes a low-pass. Its bandwidth grows
    with the fourth power of the distance to the smoothed force, in standard deviations
    of the noise: a rupture passes as it is. The step is implicit, as in
    `residual.momentum_observer.momentum_smoothing_step`.

    Args:
        smoothed: The smoothed wrench, which is written.
        wrench: The wrench of this tick.
        direction: See `WrenchGain`.
        noises_N2: See `WrenchGain`.
        adaptive_lag: The lag that shrinks with the distance [time steps].
        fixed_lag: A constant lag [time steps].

    Returns:
        How far the smoothed force is behind afterwards, as `split_force` does.
    """
    behind = np.zeros(len(wrench))
    for k in range(len(wrench)):
        behind[k] = wrench[k] - smoothed[k]
    along, across_squared = split_force(direction, behind)
    # Half the square across: two components of the lateral force are noisy.
    distance_squared = (
        max(along * along / noises_N2[0], 0.5 * across_squared / noises_N2[1])
        / SMOOTHED_SIGMAS**2
    )
    # One plus the lag in time steps: the divisor of an implicit step.
    divisor = (
        1.0 + fixed_lag + adaptive_lag / (1.0 + distance_squared * distance_squared)
    )
    for k in range(len(wrench)):
        smoothed[k] += behind[k] / divisor
    remaining = 1.0 - 1.0 / divisor
    return along * remaining, across_squared * remaining * remaining


@compiled
def widen_by_scale(covariance: Matrix, unknowns: Vector, scale_std: float) -> Array:
    """Return the covariance of a wrench with that of an unknown scale, shape (k, k).

    Args:
        covariance: Without it, shape (k, k).
        unknowns: The wrench, shape (k,).
        scale_std: Standard deviation of the scale, a part of 1.
    """
    std = scale_std * unknowns
    return covariance + np.outer(std, std)


@compiled
def wrench_step(
    residual: Vector,
    matrix: Matrix,
    direction: Vector,
    variances_N2: Vector,
    noises_N2: Vector,
    smoothing_lag: float,
    observer_lag: float,
    smoothed: WrittenVector,
    follower: WrittenVector,
    hidden_N2: WrittenVector,
) -> tuple[float, ...]:
    """Estimate the force of one tick, smoothed, with what its lag may hide.

    A follower filters the smoothed force once more, with the lags of the observer and
    of the smoothing: it is behind the smoothed force by about as much as that is behind
    the true one. The square of this distance, less the variance of the force, is the
    squared error by lag, which is added to the variance. The follower is late itself:
    when the force oscillates, the distance is small just when the error is large. The
    squared error therefore does not drop at once but fades with twice these lags.
    `MAX_HIDDEN_SIGMAS` limits it, so that it is soon over after a rupture.

    Args:
        residual: External joint torque after offset removal [Nm], shape (n,).
        matrix: See `WrenchGain`, like the next three.
        direction: Insertion direction.
        variances_N2: Variances along and across it.
        noises_N2: Noise of a sample along and across it.
        smoothing_lag: Lag of `smoothing_step` while the force stays within its noise
            [time steps]; 0 for none.
        observer_lag: Lag of the momentum observer [time steps]; 0 for none.
        smoothed: See `WrenchFilterState`; brought to the end of the tick, like the next
            two.
        follower: The smoothed wrench, filtered once more.
        hidden_N2: What the lag hid.

    Returns:
        Resistance to insertion, its standard deviation, size of the lateral force, the
        standard deviation of one of its components, and resistance before it is
        smoothed [N].
    """
    wrench = multiply_vector(matrix, residual)
    unsmoothed, _ = split_force(direction, wrench)
    smoothing_step(smoothed, wrench, direction, noises_N2, smoothing_lag, 0.0)
    along, across_squared = split_force(direction, smoothed)
    missed, missed_across_squared = smoothing_step(
        follower, smoothed, direction, noises_N2, smoothing_lag, observer_lag
    )
    fading = 1.0 - 1.0 / (1.0 + 2.0 * (smoothing_lag + observer_lag))
    variance = variances_N2[0]
    variance_across = variances_N2[1]
    hidden = max(missed * missed - variance, fading * hidden_N2[0])
    # Twice the variance: two components of the lateral force are noisy.
    hidden_across = max(
        missed_across_squared - 2.0 * variance_across, fading * hidden_N2[1]
    )
    hidden_N2[0] = min(hidden, MAX_HIDDEN_SIGMAS**2 * variance)
    hidden_N2[1] = min(hidden_across, MAX_HIDDEN_SIGMAS**2 * variance_across)
    std = math.sqrt(variance + hidden)
    std_across = math.sqrt(variance_across + hidden_across)
    lateral = math.sqrt(max(across_squared, 0.0))
    # Resistance is minus the force along the insertion direction: positive when tissue
    # pushes back.
    return -along, std, lateral, std_across, -unsmoothed


class WrenchEstimator:
    """Wrench of the environment on the tool, by covariance-weighted least squares.

    Sign and frames: the wrench acts on the tool at the tip, in the axes asked for; a
    weight hung there reads as a force down. The axial force is minus the force along
    the insertion direction, so that tissue pushing back is positive.

    Args:
        robot: The arm with its payload.
        config: Of it ``mode``, ``weighting`` (``none`` has no damping either),
            ``expected_force_N``, ``frame``, ``axes``, ``insertion_axis`` and
            ``tool_offset_m``.

    Attributes:
        kinematics: Pose and Jacobian of the tool.
        size: Number of components, of force and of torque if the mode has one: 3 or 6.
        gain: Gain of the last `compute_gain`.
        torque_covariance: Last one of `set_torque_covariance`, else 1 [Nm^2], shape (n,
            n).
        scale_std: Standard deviation of the torques' scale, relative to it: it adds to
            the deviation of a force in proportion to the force.

    Raises:
        urdf.UrdfError: For an unknown frame.
    """

    def __init__(self, robot: Robot, config: SensorConfig = DEFAULT) -> None:
        compile_waiting()
        self.kinematics = ToolKinematics(
            robot, config.frame, config.insertion_axis, config.tool_offset_m
        )
        self._in_base = config.axes == "base"
        self._joints = robot.nv
        unknowns = COMPONENTS[config.mode]
        self.size = max(unknowns, 3)
        self._is_weighted = config.weighting == "covariance"
        # Diagonal of the damping: inverse square of the largest wrench that is
        # expected.
        self._damping = np.zeros(unknowns)
        if self._is_weighted and config.expected_force_N is not None:
            expected = [config.expected_force_N] * 3 + [EXPECTED_TORQUE_NM] * 3
            self._damping = np.array(expected[:unknowns]) ** -2.0
        self.scale_std = 0.0
        self.set_torque_covariance(np.eye(robot.nv))
        self.compute_gain(np.zeros(robot.nv))

    def set_torque_covariance(
        self,
        covariance_Nm2: Array,
        noise_Nm2: Array | None = None,
        smoothed_noise_Nm2: Array | float = 0.0,
        jump_Nm2: Array | float = 0.0,
    ) -> None:
        """Set how far the residual may be trusted, for the next `compute_gain`.

        Args:
            covariance_Nm2: Covariance of the residual's error, shape (n, n), positive
                definite.
            noise_Nm2: The part of it that is noise of a sample, of the same shape; None
                for all.
            smoothed_noise_Nm2: What `smoothing_step` removes of that while nothing
                changes.
            jump_Nm2: Covariance by jumps of torque sensors, shape (n, n). It widens
                what is stated, and leaves the gain as it is: a constant error is better
                than other weights from one sample to the next.

        Raises:
            ConfigurationError: If it has another shape or is not positive definite.
        """
        shape = (self._joints, self._joints)
        covariance = np.array(covariance_Nm2, order="C")
        inverse = inverse_of(covariance)
        if covariance.shape != shape or inverse is None:
            raise ConfigurationError(
                f"covariance_Nm2 has shape {covariance.shape}, expected {shape}, "
                "finite, symmetric and positive definite"
            )
        self.torque_covariance = covariance
        self._inverse = inverse
        self._jump_Nm2 = jump_Nm2
        self._inverse_with_jump = inverse
        if np.any(jump_Nm2):
            self._inverse_with_jump = np.linalg.inv(covariance + jump_Nm2).astype(
                np.float64
            )
        self._noise = covariance if noise_Nm2 is None else noise_Nm2
        self._smoothed_noise = smoothed_noise_Nm2

    def estimate(self, q: Array, residual: Array) -> WrenchEstimate:
        """Estimate the wrench at a configuration from the external joint torque.

        Args:
            q: Joint positions [rad], shape (n,).
            residual: External joint torque after offset removal [Nm], shape (n,).

        Raises:
            SampleError: For a wrong shape, or for numbers that are not real or not
                finite.
        """
        q = np.ascontiguousarray(check_joint_vector("q", q, self._joints))
        # A copy, since the residual of an estimate is read-only.
        own_residual = np.array(check_joint_vector("residual", residual, self._joints))
        self.compute_gain(q)
        state = WrenchFilterState.at_zero(self.size)
        return self.solve(own_residual, state)

    def compute_gain(self, q: Array) -> None:
        """Compute the gain at a configuration [rad], shape (n,), for `solve`."""
        tool = self.kinematics
        tool.update(q)
        self.gain = gain_at(
            q,
            np.ascontiguousarray(tool.jacobian),
            tool.rotation if self._in_base else _UNTURNED,
            tool.axis_in_tool,
            self.torque_covariance + self._jump_Nm2 - self._smoothed_noise,
            self._noise,
            # The weights are those of a single sample.
            self._inverse if self._is_weighted else np.eye(self._joints),
            self._inverse_with_jump,
            self._damping,
        )
        self.gain.covariance.setflags(write=False)
        self.gain.damping_fraction.setflags(write=False)

    def renew_gain(self, q: Array) -> None:
        """Compute the gain anew if the arm has turned too far for the last one.

        The configuration [rad] has shape (n,).
        """
        if has_turned(q, self.gain.configuration_rad):
            self.compute_gain(q)

    def solve(
        self,
        residual: Array,
        state: WrenchFilterState,
        smoothing_lag: float = 0.0,
        observer_lag: float = 0.0,
        assessment: Assessment = GOOD,
    ) -> WrenchEstimate:
        """Estimate the wrench from an external joint torque, by the last gain.

        Args:
            residual: External joint torque after offset removal, r - r0 [Nm], shape
                (n,); it becomes part of the estimate and read-only.
            state: Of the smoothing; brought to the end of the tick.
            smoothing_lag: As of `wrench_step`; 0 for a first sample: the filters begin
                where the force is.
            observer_lag: As of `wrench_step`.
            assessment: What the estimate says of itself.

        Raises:
            SampleError: For numbers that are not finite.
        """
        gain = self.gain
        smoothed, follower, hidden_N2 = state
        axial, axial_std, lateral, lateral_std, axial_unsmoothed = wrench_step(
            residual,
            gain.matrix,
            gain.direction,
            gain.variances_N2,
            gain.noises_N2,
            smoothing_lag,
            observer_lag,
            smoothed,
            follower,
            hidden_N2,
        )
        if not math.isfinite(axial):
            raise SampleError("q and residual must be finite")
        if self.scale_std:
            axial_std = math.hypot(axial_std, self.scale_std * axial)
            lateral_std = math.hypot(lateral_std, self.scale_std * lateral)
        wrench = smoothed.copy()
        residual.setflags(write=False)
        wrench.setflags(write=False)
        covariance = gain.covariance
        status, message, model_mismatch, warnings = assessment
        if self.scale_std:
            unknowns = wrench if len(covariance) > 1 else np.array([axial])
            covariance = widen_by_scale(covariance, unknowns, self.scale_std)
            covariance.setflags(write=False)
        has_torque = self.size > 3
        # All fields in order: by name it takes 0.5 us more in every tick.
        return WrenchEstimate(
            axial,
            axial_std,
            lateral,
            lateral_std,
            wrench[:3] if has_torque else wrench,
            wrench[3:] if has_torque else _NOTHING,
            covariance,
            gain.damping_fraction,
            axial_unsmoothed,
            residual,
            status,
            message,
            model_mismatch,
            warnings,
        )

    def mismatch_squared(self, residual: Array) -> float:
        """Return the mean square of the joint torque that no wrench explains.

        It is in units of the covariance at the last `compute_gain`: about 1 when the
        model holds, 0 if the mode has as many unknowns as there are joints. The
        residual [Nm] is that after offset removal, shape (n,).
        """
        form = self.gain.unexplained
        return max(float(residual.dot(form).dot(residual)), 0.0)
