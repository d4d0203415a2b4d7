"""From external joint torque to the wrench at a named frame: equation (13) and better."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.jit import Matrix, Vector, WrittenVector, compiled
from residual.errors import ConfigurationError, SampleError
from residual.estimate import MOST_CONDITIONING, UNSEEN_STD, WrenchEstimate
from residual.input_validation import check_choice, check_joint_vector, check_positive
from residual.tool_kinematics import ToolKinematics
from urdf import Robot

Array = NDArray[np.float64]
Mode = Literal["axial", "point", "full"]
"""What is assumed of the contact: a force along the needle axis, a force at the frame's origin,
or a force and a torque."""
Axes = Literal["base", "tool"]
Weighting = Literal["covariance", "none"]
COMPONENTS = {"axial": 1, "point": 3, "full": 6}
"""Unknowns of every mode."""
EXPECTED_TORQUE_NM = 10.0
"""Of the full mode: as `WrenchEstimator`'s ``expected_force_N``."""
_NOTHING = np.zeros(3)
_NOTHING.setflags(write=False)


MOST_TURN_RAD = 1e-3
"""A gain holds until a joint has moved so far: the force is then off by a thousandth of itself. A
needle at 10 mm/s takes longer than a renewal to turn the arm by as much."""


class WrenchGain(NamedTuple):
    """How the joints are weighed at one configuration; arrays are read-only."""

    # That configuration [rad], then what makes force (and torque), in the axes asked for, of joint
    # torque; shape (4 or 7, n)
    rows: Array
    # Insertion direction in the same axes, then the variance of the axial force and of a lateral
    # one, in the direction known least [N^2]; shape (5,)
    axis: Array
    # ``covariance``, ``conditioning`` and ``damping_fraction`` of `WrenchEstimate`
    reported: tuple[Array, float, Array]


def weighted_inverse(
    jacobian: Array, error_covariance: Array, precision: Array, damping: Array
) -> tuple[Array, Array, float, Array]:
    """Solve ``torque = J' x + error`` by weighted least squares; the paper's (13) generalised.

    ``x = (J W J' + D)^-1 J W torque``. With W the inverse covariance of the error this is the best
    linear estimate; W = 1 and D = 0 give the pseudo-inverse (J')# of equation (13). D is the
    inverse variance of what x is expected to be: it matters only where the joints cannot see x,
    there it draws the answer to zero, and the fraction that it removes is reported.

    Args:
        jacobian: J, shape (k, n), rows are directions of x.
        error_covariance: Of the error of that torque [Nm^2], shape (n, n).
        precision: W, shape (n, n).
        damping: Diagonal of D, shape (k,).

    Returns:
        The matrix that makes x of the torque, shape (k, n); the covariance of x, shape (k, k), with
        `UNSEEN_STD` squared on the diagonal where x cannot be seen; ``conditioning`` and
        ``damping_fraction`` of `WrenchEstimate`.
    """
    weighted = jacobian.dot(precision)
    information = weighted.dot(jacobian.T)
    eigenvalues, vectors = np.linalg.eigh(information + np.diag(damping))
    # Directions below rounding of the largest are unseen: the pseudo-inverse leaves them at zero.
    seen = eigenvalues > eigenvalues[-1] * 1e-12
    inverse = (vectors[:, seen] / eigenvalues[seen]) @ vectors[:, seen].T
    gain = inverse.dot(weighted)
    covariance = gain.dot(error_covariance).dot(gain.T) + inverse * damping @ inverse
    if not seen.all():
        blind = (np.abs(vectors[:, ~seen]) > 1e-9).any(axis=1)
        covariance[blind, blind] = UNSEEN_STD**2
    own = np.linalg.eigvalsh(information)
    sightless = own[0] <= own[-1] / MOST_CONDITIONING**2
    conditioning = MOST_CONDITIONING if sightless else float(np.sqrt(own[-1] / own[0]))
    return gain, covariance, conditioning, np.diag(inverse) * damping


@compiled
def wrench_step(
    q: Vector,
    residual: Vector,
    offset: Vector,
    rows: Matrix,
    axis: Vector,
    fraction: float,
    followed_N: WrittenVector,
    found: WrittenVector,
) -> tuple[float, float, float, float]:
    """Force from external joint torque, with what its lag may hide.

    One more lag of the same length follows the force: what it still misses is about what the
    estimate has missed. Only what stands out of the noise counts as a change.

    Args:
        q: Configuration [rad], shape (n,).
        residual: External joint torque with its offset [Nm], shape (n,).
        offset: What it reads without contact [Nm], shape (n,).
        rows: See `WrenchGain`, like ``axis``.
        axis: Insertion direction and variances, shape (5,).
        fraction: Of the way that the follower goes in this tick; 1 where there is no lag.
        followed_N: The follower [N], shape (3,), brought to the end of the tick.
        found: Where force, torque if it is asked for, and the residual less its offset are written
            [N, Nm], shape (3 + n,) or (6 + n,).

    Returns:
        Resistance to insertion, its standard deviation, size of the lateral force, and the standard
        deviation of one of its components [N]; NaN, and nothing else has happened, where the arm
        has turned too far for the gain.
    """
    if not np.abs(q - rows[0]).max() <= MOST_TURN_RAD:
        return math.nan, math.nan, math.nan, math.nan
    size = len(rows) - 1
    corrected = residual - offset
    found[size:] = corrected
    found[:size] = rows[1:].dot(corrected)
    force, along_needle = found[:3], axis[:3]
    axial = float(along_needle.dot(force))
    across = force - axial * along_needle
    behind = force - followed_N
    followed_N += fraction * behind
    missed = float(along_needle.dot(behind))
    missed_across = float(behind.dot(behind)) - missed * missed
    if fraction >= 1.0:
        missed = missed_across = 0.0
    variance, lateral_variance = axis[3], axis[4]
    # Of the lateral force two components are noisy.
    hidden = max(missed * missed - 4.0 * variance, 0.0)
    hidden_across = max(missed_across - 8.0 * lateral_variance, 0.0)
    return (
        -axial,
        math.sqrt(variance + hidden),
        math.sqrt(float(across.dot(across))),
        math.sqrt(lateral_variance + hidden_across),
    )


class WrenchEstimator:
    """Wrench of the environment on the tool, by covariance-weighted least squares.

    Sign and frames: the wrench acts on the tool at the origin of ``frame``, in ``axes`` axes; a
    weight hung there reads as a force down. The axial force is minus the force along the insertion
    direction, so that tissue pushing back is positive.

    Args:
        robot: The arm with its payload.
        mode: What is assumed of the contact, see `Mode`.
        frame: Name of the frame; the robot's tool frame when None.
        axes: Axes in which force and torque are expressed.
        insertion_axis: Insertion direction in the frame's axes, normalised here.
        tool_offset_m: Where the tip, at which the wrench acts, is in the frame [m].
        weighting: ``covariance``, by the inverse covariance of the torque; ``none``, the plain
            pseudo-inverse of equation (13), which has no damping either.
        expected_force_N: Size of force beyond which an estimate is drawn to zero where the joints
            cannot see it (damping near singular poses); None for no damping.

    Raises:
        ConfigurationError: For an unknown mode or axes, or a zero axis.
        urdf.UrdfError: For an unknown frame.
    """

    def __init__(
        self,
        robot: Robot,
        mode: Mode = "point",
        *,
        frame: str | None = None,
        axes: Axes = "base",
        insertion_axis: ArrayLike = (0.0, 0.0, 1.0),
        tool_offset_m: ArrayLike = (0.0, 0.0, 0.0),
        weighting: Weighting = "covariance",
        expected_force_N: float | None = 100.0,
    ) -> None:
        check_choice("mode", mode, tuple(COMPONENTS))
        check_choice("weighting", weighting, ("covariance", "none"))
        check_choice("axes", axes, ("base", "tool"))
        self.kinematics = ToolKinematics(robot, frame, insertion_axis, tool_offset_m)
        self._in_base = axes == "base"
        self._joints = robot.nv
        check_expected("expected_force_N", expected_force_N)
        # Which components of force and torque, in the frame's axes, an unknown stands for.
        self._directions = np.eye(6)[: COMPONENTS[mode]]
        if mode == "axial":
            self._directions = np.concatenate((self.kinematics.axis_in_tool, _NOTHING))[None]
        self._damping = _damping(mode, None if weighting == "none" else expected_force_N)
        self._weighted = weighting == "covariance"
        self._covariance = self._inverse = np.eye(robot.nv)
        self.weigh(np.zeros(robot.nv))

    def set_torque_covariance(self, covariance_Nm2: Array) -> None:
        """Set how far the residual may be trusted, for the next `weigh`.

        Args:
            covariance_Nm2: Of the residual's error [Nm^2], shape (n, n), positive definite.

        Raises:
            ConfigurationError: If it has another shape or is not positive definite.
        """
        if covariance_Nm2.shape != self._covariance.shape:
            raise ConfigurationError(
                f"covariance has shape {covariance_Nm2.shape}, expected {self._covariance.shape}"
            )
        asymmetry = np.abs(covariance_Nm2 - covariance_Nm2.T).max()
        # Written so that a NaN is refused too.
        if not asymmetry <= 1e-6 * abs(np.trace(covariance_Nm2)):
            raise ConfigurationError("covariance_Nm2 must be finite and symmetric")
        try:
            root = np.linalg.inv(np.linalg.cholesky(covariance_Nm2))
        except np.linalg.LinAlgError as error:
            raise ConfigurationError("covariance_Nm2 is not positive definite") from error
        self._covariance = covariance_Nm2.copy()
        self._inverse = root.T @ root

    @property
    def torque_covariance(self) -> Array:
        """What `set_torque_covariance` was given last, or 1 [Nm^2], shape (n, n), a copy."""
        return self._covariance.copy()

    def estimate(self, q: Array, residual: Array) -> WrenchEstimate:
        """Wrench at a configuration [rad] from the external joint torque [Nm], both shape (n,).

        Raises:
            SampleError: For a wrong shape, or for numbers that are not real or not finite.
        """
        q = check_joint_vector("q", q, self._joints)
        residual = check_joint_vector("residual", residual, self._joints)
        q, residual = np.ascontiguousarray(q), np.ascontiguousarray(residual)
        self.weigh(q)
        return WrenchEstimate(
            *self.solve(q, residual, np.zeros(self._joints), np.zeros(3), fraction=1.0)
        )

    def weigh(self, q: Array) -> None:
        """Weigh the joints at a configuration [rad], shape (n,); `solve` does so until the next."""
        tool, k, size = self.kinematics, len(self._directions), max(len(self._directions), 3)
        tool.update(q)
        jacobian, axis, directions = tool.jacobian, tool.axis_in_tool, self._directions
        if self._in_base:
            turn = np.kron(np.eye(2), tool.rotation_tool_to_base)
            jacobian, axis = turn.dot(jacobian), turn[:3, :3].dot(axis)
        if k == 1:
            directions = np.concatenate((axis, _NOTHING))[None]
        precision = self._inverse if self._weighted else np.eye(self._joints)
        gain, covariance, conditioning, removed = weighted_inverse(
            directions.dot(jacobian), self._covariance, precision, self._damping
        )
        variances = (covariance[0, 0], UNSEEN_STD**2)
        if k > 1:
            variances = _variances(axis, covariance[:3, :3])
        self._gain = WrenchGain(
            rows=np.vstack((q, directions[:, :size].T.dot(gain))),
            axis=np.append(axis, variances),
            reported=(covariance, conditioning, removed),
        )
        for array in (covariance, removed):
            array.setflags(write=False)

    def solve(
        self, q: Array, residual: Array, offset: Array, followed_N: Array, fraction: float
    ) -> tuple[Any, ...]:
        """Wrench at a configuration [rad], shape (n,), from an external joint torque.

        The offset [Nm], shape (n,), is what the residual reads here without contact; the last two
        arguments are those of `wrench_step`.

        Returns:
            The numbers of a `WrenchEstimate`, from ``axial`` to ``residual``.

        Raises:
            SampleError: For numbers that are not finite.
        """
        rows, axis, reported = self._gain
        size = len(rows) - 1
        found = np.empty(size + self._joints)
        scalars = wrench_step(q, residual, offset, rows, axis, fraction, followed_N, found)
        if not math.isfinite(scalars[0]):
            self.weigh(q)
            rows, axis, reported = self._gain
            scalars = wrench_step(q, residual, offset, rows, axis, fraction, followed_N, found)
            if not math.isfinite(scalars[0]):
                raise SampleError("q and residual must be finite; skip this sample")
        # By name it takes thrice as long, in every tick.
        found.setflags(False)  # pyright: ignore[reportCallIssue]
        torque = _NOTHING if size == 3 else found[3:6]
        return *scalars, found[:3], torque, *reported, found[size:]

    @property
    def weighed_at(self) -> Array:
        """Configuration of the last `weigh` [rad], shape (n,): with it `weigh` gives the same."""
        return self._gain.rows[0]

    @property
    def _rows(self) -> Array:
        """Joint torque of each unknown where the arm stands, in the tool's axes, shape (k, n)."""
        return self._directions.dot(self.kinematics.jacobian)

    def smallest_singular_value(self) -> float:
        """How much the joints feel of a newton in the direction they feel least [m].

        Of the directions that the mode asks for (in the full mode a newton metre counts as a
        newton), at the last configuration.
        """
        return float(np.linalg.svd(self._rows, compute_uv=False)[-1])

    def mismatch_squared(self, residual: Array) -> float:
        """Mean square of the joint torque [Nm] that no wrench of the mode explains.

        In units of its covariance, at the last configuration: about 1 when the model holds, 0 where
        the mode has as many unknowns as there are joints. The residual is that without offset.
        """
        rows = self._rows
        spare = rows.shape[1] - len(rows)
        if spare <= 0:
            return 0.0
        weighted = rows.dot(self._inverse)
        seen = weighted.dot(residual)
        # The smallest solution: nothing where it sees nothing.
        wrench = np.linalg.lstsq(weighted.dot(rows.T), seen, rcond=1e-12)[0]
        left = float(residual.dot(self._inverse).dot(residual) - seen.dot(wrench))
        return max(left, 0.0) / spare


def _variances(axis: Array, covariance: Array) -> tuple[float, float]:
    """Of the axial force, and of the lateral in the direction known least; those of the unseen.

    Force and axis in the same axes; where a component is not seen, neither is.
    """
    if (np.diag(covariance) >= UNSEEN_STD**2).any():
        return UNSEEN_STD**2, UNSEEN_STD**2
    across = np.eye(3) - np.outer(axis, axis)
    lateral = np.linalg.eigvalsh(across.dot(covariance).dot(across))[-1]
    return float(axis.dot(covariance).dot(axis)), float(lateral)


def _damping(mode: Mode, expected_force_N: float | None) -> Array:
    """Diagonal of the damping: inverse variance of the wrench that is expected at most."""
    size = COMPONENTS[mode]
    if expected_force_N is None:
        return np.zeros(size)
    expected = np.array([expected_force_N] * 3 + [EXPECTED_TORQUE_NM] * 3)[:size]
    return 1.0 / expected**2


def check_expected(name: str, value: float | None) -> None:
    """Refuse an expected size of force or torque whose inverse square overflows; None is none."""
    if value is not None:
        check_positive(name, value, least=1e-6, most=1e9)
