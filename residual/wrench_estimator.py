"""From external joint torque to the wrench at a named frame: equation (13) and
better.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled
from residual.checks.input import check_joint_vector
from residual.config import DEFAULT, SensorConfig
from residual.errors import Array, ConfigurationError, SampleError
from residual.estimate import MOST_CONDITIONING, UNSEEN_STD, WrenchEstimate
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

COMPONENTS = {"axial": 1, "point": 3, "full": 6}  # unknowns of every mode
EXPECTED_TORQUE_NM = (
    10.0  # mode ``full``: for torques what ``expected_force_N`` is for forces
)
_NOTHING = np.zeros(3)
_NOTHING.setflags(write=False)
# Compiled code uses constants of its own file only.
_UNSEEN = UNSEEN_STD**2
_CONDITIONING = MOST_CONDITIONING
_LEAST_NOISE_N2 = 1e-12  # Keeps quotients by the noise finite
MOST_TURN_RAD = 1e-3
"""A gain is used until the joints together have moved so far: the force is then off by
a thousandth of itself."""
SMOOTHED_SIGMAS = (
    2.0  # Distance, in deviations of the noise, at which the bandwidth has doubled
)
KEPT_SIGMAS = (
    6.0  # Most that is remembered of what a lag hid, in deviations of the force
)


class WrenchGain(NamedTuple):
    """How the joints are weighed at one configuration; arrays are read-only.

    Attributes:
        rows: That configuration [rad], then the matrix from joint torque to force (and
            torque) in the axes asked for; shape (4 or 7, n).
        axis: Insertion direction in the same axes; variance of the axial force, and of
            a lateral force in the direction known least; the part of both that is noise
            of a sample [N^2]; shape (7,).
        reported: ``covariance``, ``conditioning`` and ``damping_fraction`` of
            `WrenchEstimate`.
        weakest_m: Joint torque per newton in the least observable of the directions
            that the mode asks for [m]; in the full mode a newton metre counts as a
            newton.
    """

    rows: Array
    axis: Array
    reported: tuple[Array, float, Array]
    weakest_m: float
    unexplained: (
        Array  # Quadratic form of `WrenchEstimator.mismatch_squared`, shape (n, n)
    )


@compiled
def pseudo_inverse(symmetric: Matrix, least: float) -> tuple[Array, NDArray[np.bool_]]:
    """Pseudo-inverse of a symmetric matrix without negative eigenvalues, shape (k, k).

    Directions whose eigenvalue is below ``least`` times the largest stay at zero. Also
    returned: which unknowns have a part in such a direction, shape (k,).
    """
    values, vectors = np.linalg.eigh(symmetric)
    seen = values > values[-1] * least
    scale = seen / np.where(seen, values, 1.0)
    unseen = (vectors * vectors).dot(1.0 - seen)
    return (vectors * scale).dot(vectors.T), unseen > 1e-18


@compiled
def inverse_of(covariance: Matrix) -> tuple[Array, bool]:
    """Inverse of a covariance, shape (n, n), and whether it is one: symmetric,
    positive, finite.
    """
    # Written so that a NaN is none either.
    if not np.abs(covariance - covariance.T).sum() <= 1e-6 * abs(np.trace(covariance)):
        return covariance.copy(), False
    values, vectors = np.linalg.eigh(covariance)
    return (vectors / values).dot(vectors.T), bool(values[0] > 0.0)


@compiled
def weighted_inverse(
    jacobian: Matrix, error_covariance: Matrix, precision: Matrix, damping: Vector
) -> tuple[Array, Array, float, Array]:
    """Solve ``torque = J' x + error`` by weighted least squares; the paper's (13)
    generalised.

    ``x = (J W J' + D)^-1 J W torque``. With W the inverse covariance of the error this
    is the best linear estimate; W = 1 and D = 0 give the pseudo-inverse (J')# of
    equation (13). D is the inverse of the variance expected of x. It matters only where
    the joints cannot observe x: there it draws the answer to zero, and the fraction
    that it removes is reported.

    Rows of J, shape (k, n), are directions of x; the covariance is that of the error of
    the torque [Nm^2], like W of shape (n, n); the damping is the diagonal of D, shape
    (k,).

    Returns the matrix from torque to x, shape (k, n); the covariance of x, shape (k,
    k), with `UNSEEN_STD` squared on the diagonal where x cannot be observed;
    ``conditioning`` and ``damping_fraction`` of `WrenchEstimate`.
    """
    weighted = jacobian.dot(precision)
    information = weighted.dot(jacobian.T)
    # Directions below rounding of the largest are unseen: the pseudo-inverse leaves
    # them at zero.
    inverse, blind = pseudo_inverse(information + np.diag(damping), 1e-12)
    gain = inverse.dot(weighted)
    covariance = gain.dot(error_covariance).dot(gain.T) + (inverse * damping).dot(
        inverse
    )
    for i in range(len(blind)):
        if blind[i]:
            covariance[i, i] = _UNSEEN
    own = np.linalg.eigvalsh(information)
    conditioning = _CONDITIONING
    if own[0] > own[-1] / conditioning**2:
        conditioning = math.sqrt(own[-1] / own[0])
    return gain, covariance, conditioning, np.diag(inverse) * damping


@compiled
def split_force(axis: Vector, x: float, y: float, z: float) -> tuple[float, float]:
    """Part of a force along the insertion direction [N], and square of that across
    it [N^2].
    """
    along = axis[0] * x + axis[1] * y + axis[2] * z
    return along, x * x + y * y + z * z - along * along


@compiled
def smoothing_step(
    smoothed: WrittenVector, wrench: Vector, axis: Vector, slow: float, fast: float
) -> tuple[float, float]:
    """Bring a smoothed wrench [N, Nm], shape (3,) or (6,), to the end of a tick.

    While the force stays within its noise it passes a low-pass. Its bandwidth grows
    with the fourth power of the distance to the smoothed force, in deviations of the
    noise: a rupture passes as it is. The step is implicit, as in
    `residual.momentum_observer.momentum_step`.

    `axis` is that of `WrenchGain`; `slow` is the lag that shrinks, `fast` a constant
    one [steps].

    Returns how far the smoothed force is behind afterwards, as `split_force` does.
    """
    # Python's own floats where nothing compiles: those of numpy take twice as long.
    x = float(wrench[0] - smoothed[0])
    y = float(wrench[1] - smoothed[1])
    z = float(wrench[2] - smoothed[2])
    along, across_squared = split_force(axis, x, y, z)
    # Two components of the lateral force are noisy.
    ratio = (
        max(along * along / axis[5], 0.5 * across_squared / axis[6])
        / SMOOTHED_SIGMAS**2
    )
    lag = 1.0 + fast + slow / (1.0 + ratio * ratio)
    for k in range(len(smoothed)):
        smoothed[k] += float(wrench[k] - smoothed[k]) / lag
    left = 1.0 - 1.0 / lag
    return along * left, across_squared * left * left


@compiled
def wrench_step(
    q: Vector,
    residual: Vector,
    rows: Matrix,
    axis: Vector,
    lags: tuple[float, float],
    memory: WrittenMatrix,
    found: WrittenVector,
) -> tuple[float, float, float, float, float]:
    """Force from external joint torque, smoothed, with what its lag may hide.

    A follower filters the force once more with the same lags, the observer's and the
    smoothing's: it misses about what the estimate has missed. The variance of the noise
    is subtracted from its squared error. As it is late itself, its error is small when
    an oscillating force hides most. So this error fades with twice these lags;
    `KEPT_SIGMAS` limits it, so a rupture is over soon.

    Args:
        q: Configuration [rad], shape (n,).
        residual: External joint torque after offset removal [Nm], shape (n,).
        rows: See `WrenchGain`, like ``axis``.
        axis: Insertion direction and variances, shape (7,).
        lags: Of `smoothing_step`, and of the observer [time steps], 0 for none.
        memory: Smoothed force (and torque), the follower [N, Nm], and what the lag hid,
            along and across [N^2]; updated to the end of the tick; shape (3, 3) or (3,
            6).
        found: Output: force, and torque if it is asked for [N, Nm], shape (3,) or (6,).

    Returns resistance to insertion, its standard deviation, size of the lateral force,
    the standard deviation of one of its components, and resistance before it is
    smoothed [N]; NaN, and no change of memory, if the arm has turned too far for the
    gain.
    """
    turned = q - rows[0]
    if not (turned * turned).sum() <= MOST_TURN_RAD**2:
        return math.nan, math.nan, math.nan, math.nan, math.nan
    wrench = rows[1:].dot(residual)
    unsmoothed, _ = split_force(
        axis, float(wrench[0]), float(wrench[1]), float(wrench[2])
    )
    smoothed = memory[0]
    followed = memory[1]
    hidden = memory[2]
    smoothing_step(smoothed, wrench, axis, lags[0], 0.0)
    for k in range(len(found)):
        found[k] = smoothed[k]
    along, across_squared = split_force(axis, smoothed[0], smoothed[1], smoothed[2])
    missed, missed_across = smoothing_step(followed, smoothed, axis, lags[0], lags[1])
    variance = axis[3]
    variance_across = axis[4]
    kept = 1.0 - 1.0 / (1.0 + 2.0 * (lags[0] + lags[1]))
    square = max(missed * missed - variance, kept * hidden[0])
    # Two components of the lateral force are noisy.
    square_across = max(missed_across - 2.0 * variance_across, kept * hidden[1])
    hidden[0] = min(square, KEPT_SIGMAS**2 * variance)
    hidden[1] = min(square_across, KEPT_SIGMAS**2 * variance_across)
    stds = math.sqrt(variance + square), math.sqrt(variance_across + square_across)
    return -along, stds[0], math.sqrt(max(across_squared, 0.0)), stds[1], -unsmoothed


@compiled
def unexplained(rows: Matrix, precision: Matrix) -> tuple[float, Array]:
    """Joint torque that no wrench explains, whose unknowns make torque by ``rows``, (k,
    n).

    Returns the smallest singular value of the rows, and the quadratic form of a torque
    that gives the mean square of this part, in units of its covariance, ``precision``
    inverted; shape (n, n).
    """
    count, joints = rows.shape
    gram = rows.dot(rows.T) if count < joints else rows.T.dot(rows)
    weakest_m = math.sqrt(max(np.linalg.eigvalsh(gram)[0], 0.0))
    if count >= joints:
        return weakest_m, np.zeros((joints, joints))
    weighted = rows.dot(precision)
    inverse = pseudo_inverse(weighted.dot(rows.T), 1e-12)[0]
    left = precision - weighted.T.dot(inverse).dot(weighted)
    return weakest_m, left / (joints - count)


@compiled
def _variances(axis: Vector, covariance: Matrix) -> tuple[float, float]:
    """Variances of the axial force, and of the lateral force in the direction known
    least.

    Force and axis in the same axes; if a component is not observed, both are those of
    the unseen.
    """
    if np.diag(covariance).max() >= _UNSEEN:
        return _UNSEEN, _UNSEEN
    across = np.eye(3) - np.outer(axis, axis)
    lateral = np.linalg.eigvalsh(across.dot(covariance).dot(across))[-1]
    return axis.dot(covariance).dot(axis), lateral


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
        gain: Gain of the last `weigh`.
        torque_covariance: Last one of `set_torque_covariance`, else 1 [Nm^2], shape (n,
            n).

    Raises:
        urdf.UrdfError: For an unknown frame.
    """

    def __init__(self, robot: Robot, config: SensorConfig = DEFAULT) -> None:
        self.kinematics = ToolKinematics(
            robot, config.frame, config.insertion_axis, config.tool_offset_m
        )
        self._in_base = config.axes == "base"
        self._joints = robot.nv
        size = COMPONENTS[config.mode]
        self.size = max(size, 3)
        # Components of force and torque, in the frame's axes, that each unknown stands
        # for.
        self._directions = np.eye(6)[:size]
        if size == 1:
            self._directions = np.concatenate((self.kinematics.axis_in_tool, _NOTHING))[
                None
            ]
        self._weighted = config.weighting == "covariance"
        # Diagonal of the damping: inverse square of the largest wrench that is
        # expected.
        self._damping = np.zeros(size)
        if self._weighted and config.expected_force_N is not None:
            expected = [config.expected_force_N] * 3 + [EXPECTED_TORQUE_NM] * 3
            self._damping = np.array(expected[:size]) ** -2.0
        self.torque_covariance = self._inverse = self._noise = np.eye(robot.nv)
        self._smoothed: Array | float = 0.0
        self.weigh(np.zeros(robot.nv))

    def set_torque_covariance(
        self,
        covariance_Nm2: Array,
        noise_Nm2: Array | None = None,
        smoothed: Array | float = 0.0,
    ) -> None:
        """Set how far the residual may be trusted, for the next `weigh`.

        Args:
            covariance_Nm2: Covariance of the residual's error [Nm^2], (n, n), positive
                definite.
            noise_Nm2: The part of it that is noise of a sample, of the same shape; None
                for all.
            smoothed: What `smoothing_step` removes of that while nothing changes
                [Nm^2].

        Raises:
            ConfigurationError: If it has another shape or is not positive definite.
        """
        shape = self.torque_covariance.shape
        if covariance_Nm2.shape != shape:
            raise ConfigurationError(
                f"covariance has shape {covariance_Nm2.shape}, expected {shape}"
            )
        covariance = np.array(covariance_Nm2, order="C")
        inverse, is_valid = inverse_of(covariance)
        if not is_valid:
            raise ConfigurationError(
                "covariance_Nm2 is not finite, symmetric, positive definite"
            )
        self.torque_covariance = covariance
        self._inverse = inverse
        self._noise = covariance if noise_Nm2 is None else noise_Nm2
        self._smoothed = smoothed

    def estimate(self, q: Array, residual: Array) -> WrenchEstimate:
        """Wrench at a configuration [rad] from the external joint torque [Nm], both
        shape (n,).

        Raises:
            SampleError: For a wrong shape, or for numbers that are not real or not
                finite.
        """
        q = np.ascontiguousarray(check_joint_vector("q", q, self._joints))
        residual = np.ascontiguousarray(
            check_joint_vector("residual", residual, self._joints)
        )
        self.weigh(q)
        memory = np.zeros((3, self.size))
        return WrenchEstimate(
            *self.solve(q, residual, np.zeros(self._joints), memory, (0.0, 0.0))
        )

    def weigh(self, q: Array) -> None:
        """Compute the gain at a configuration [rad], shape (n,); `solve` uses it
        until the next.
        """
        tool = self.kinematics
        directions = self._directions
        tool.update(q)
        jacobian = tool.jacobian
        axis = tool.axis_in_tool
        size = self.size
        if self._in_base:
            turn = tool.pose[:3, :3]
            jacobian = np.concatenate((turn.dot(jacobian[:3]), turn.dot(jacobian[3:])))
            axis = turn.dot(axis)
        if len(directions) == 1:
            directions = np.concatenate((axis, _NOTHING))[None]
        rows = directions.dot(jacobian)
        inverse = self._inverse
        precision = inverse if self._weighted else np.eye(self._joints)
        error = self.torque_covariance - self._smoothed
        gain, covariance, conditioning, removed = weighted_inverse(
            rows, error, precision, self._damping
        )
        noise = gain.dot(self._noise).dot(gain.T) + _LEAST_NOISE_N2 * np.eye(len(gain))
        variances = [covariance[0, 0], UNSEEN_STD**2, noise[0, 0], UNSEEN_STD**2]
        if len(directions) > 1:
            parts = (np.ascontiguousarray(each[:3, :3]) for each in (covariance, noise))
            variances = np.ravel([_variances(axis, part) for part in parts])
        self.gain = WrenchGain(
            np.vstack((q, directions[:, :size].T.dot(gain))),
            np.append(axis, variances),
            (covariance, conditioning, removed),
            *unexplained(rows, inverse),
        )
        for array in (covariance, removed):
            array.setflags(write=False)

    def solve(
        self,
        q: Array,
        residual: Array,
        offset: Array,
        memory: Array,
        lags: tuple[float, float],
    ) -> tuple[Any, ...]:
        """Wrench at a configuration [rad], shape (n,), from an external joint torque.

        The offset [Nm], shape (n,), is what the residual reads here without contact;
        the last two arguments are those of `wrench_step`.

        Returns the numbers of a `WrenchEstimate`, from ``axial`` to ``residual``;
        `SampleError` for numbers that are not finite.
        """
        rows, axis, reported, _, _ = self.gain
        left = residual - offset
        found = np.empty(self.size)
        numbers = wrench_step(q, left, rows, axis, lags, memory, found)
        if not math.isfinite(numbers[0]):
            self.weigh(q)
            rows, axis, reported, _, _ = self.gain
            numbers = wrench_step(q, left, rows, axis, lags, memory, found)
            if not math.isfinite(numbers[0]):
                raise SampleError("q and residual must be finite; skip this sample")
        # By position: by name this takes thrice as long, in every tick.
        left.setflags(False)  # pyright: ignore[reportCallIssue]
        found.setflags(False)  # pyright: ignore[reportCallIssue]
        force, torque = (found, _NOTHING) if self.size == 3 else (found[:3], found[3:])
        axial, std, lateral, across_std, raw = (
            numbers  # unpacked twice with stars it takes longer
        )
        seen, ratio, removed = reported
        return (
            axial,
            std,
            lateral,
            across_std,
            force,
            torque,
            seen,
            ratio,
            removed,
            raw,
            left,
        )

    @property
    def rows(self) -> Array:
        """Joint torque per unit of each unknown, where the tool was moved last,
        shape (k, n).
        """
        return self._directions.dot(self.kinematics.jacobian)

    def mismatch_squared(self, residual: Array) -> float:
        """Mean square of the joint torque [Nm] that no wrench of the mode explains.

        It is in units of the covariance at the last `weigh`: about 1 when the model
        holds, 0 if the mode has as many unknowns as there are joints. The residual is
        that after offset removal.
        """
        return max(float(residual.dot(self.gain.unexplained).dot(residual)), 0.0)
