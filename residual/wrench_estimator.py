"""From external joint torque to the wrench at a named frame: equation (13) and better."""

import math
from typing import Any, Literal, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from needleforce.jit import StridedVector, Vector, WrittenVector, compiled
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


class AxialWeights(NamedTuple):
    """How the axial mode weighs the joints, until `WrenchEstimator.weigh` weighs them anew.

    Attributes:
        weighted: W a, a the torque per newton; shape (n,).
        variance_N2: Of the axial force.
        damping_share: Fraction of it that damping removes.
        conditioning: See `WrenchEstimate`.
    """

    weighted: Array
    variance_N2: float
    damping_share: float
    conditioning: float


@compiled
def axial_force(
    residual: Vector,
    offset: Vector,
    weighted: Vector,
    axial_jacobian: Vector,
    axis: StridedVector,
    damping: float,
    corrected: WrittenVector,
    force: WrittenVector,
) -> float:
    """Axial force from external joint torque.

    Args:
        residual: External joint torque with its offset [Nm], shape (n,).
        offset: What it reads without contact [Nm], shape (n,).
        weighted: See `AxialWeights`.
        axial_jacobian: See `residual.tool_kinematics.ToolKinematics`.
        axis: Insertion direction, shape (3,).
        damping: Inverse variance of the force that is expected at most [1/N^2].
        corrected: Where the residual less its offset is written [Nm], shape (n,).
        force: Where the force on the tool is written [N], in the axes of ``axis``, shape (3,).

    Returns:
        Resistance to insertion [N]; 0 where nothing is seen.
    """
    information = float(weighted.dot(axial_jacobian)) + damping
    corrected[:] = residual - offset
    along = float(weighted.dot(corrected)) / information if information > 0.0 else 0.0
    force[:] = axis * along
    return -along


class WeightedSolution(NamedTuple):
    """Solution of ``torque = map' x`` for x.

    Attributes:
        value: x, shape (k,).
        covariance: Of x, shape (k, k); `UNSEEN_STD` squared on the diagonal where x cannot be seen.
        conditioning: Ratio of the largest to the smallest standard deviation over directions.
        damping_share: Fraction of each true component that damping removes, shape (k,).
    """

    value: Array
    covariance: Array
    conditioning: float
    damping_share: Array


def weighted_inverse(
    jacobian: Array,
    torque: Array,
    error_covariance: Array,
    *,
    precision: Array | None = None,
    damping: Array | None = None,
) -> WeightedSolution:
    """Solve ``torque = J' x + error`` by weighted least squares; the paper's (13) generalised.

    ``x = (J W J' + D)^-1 J W torque``. With W the inverse covariance of the error this is the best
    linear estimate; W = 1 and D = 0 give the pseudo-inverse (J')# of equation (13). D is the
    inverse variance of what x is expected to be: it matters only where the joints cannot see x,
    there it draws the answer to zero, and the fraction that it removes is reported.

    Args:
        jacobian: J, shape (k, n), rows are directions of x.
        torque: External joint torque [Nm], shape (n,).
        error_covariance: Of the error of that torque [Nm^2], shape (n, n).
        precision: W, shape (n, n); None for 1.
        damping: Diagonal of D, shape (k,); None for none.

    Returns:
        The solution with its covariance, conditioning and damping.
    """
    weighted = jacobian if precision is None else jacobian.dot(precision)
    information = weighted.dot(jacobian.T)
    prior = np.zeros(len(information)) if damping is None else damping
    eigenvalues, vectors = np.linalg.eigh(information + np.diag(prior))
    # Directions below rounding of the largest are unseen: the pseudo-inverse leaves them at zero.
    seen = eigenvalues > eigenvalues[-1] * 1e-12
    inverse = (vectors[:, seen] / eigenvalues[seen]) @ vectors[:, seen].T
    gain = inverse.dot(weighted)
    covariance = gain.dot(error_covariance).dot(gain.T) + inverse * prior @ inverse
    if not seen.all():
        blind = (np.abs(vectors[:, ~seen]) > 1e-9).any(axis=1)
        covariance[blind, blind] = UNSEEN_STD**2
    own = np.linalg.eigvalsh(information)
    sightless = own[0] <= own[-1] / MOST_CONDITIONING**2
    return WeightedSolution(
        value=gain.dot(torque),
        covariance=covariance,
        conditioning=MOST_CONDITIONING if sightless else float(np.sqrt(own[-1] / own[0])),
        damping_share=np.diag(inverse) * prior,
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
        mode: Mode = "axial",
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
        self._mode: Mode = mode
        self._in_base = axes == "base"
        self._joints = robot.nv
        check_expected("expected_force_N", expected_force_N)
        self._damping = _damping(mode, expected_force_N)
        if weighting == "none":
            self._damping[:] = 0.0
        self._axial_damping = float(self._damping[0])
        self._weighted = weighting == "covariance"
        self._covariance = self._inverse = self._precision = np.eye(robot.nv)
        self.restore(AxialWeights(np.zeros(robot.nv), UNSEEN_STD**2, 0.0, MOST_CONDITIONING))

    def set_torque_covariance(self, covariance_Nm2: Array) -> None:
        """Set how far the residual may be trusted: it sets weights and standard deviations.

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
        if self._weighted:
            self._precision = self._inverse

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
        residual = np.ascontiguousarray(residual)
        self.kinematics.update(q)
        self.weigh()
        return WrenchEstimate(*self.solve(residual, np.zeros(self._joints)))

    def weigh(self) -> None:
        """Weigh the joints anew where `kinematics` stands; `solve` keeps the weights until then.

        Only the axial mode does; the others weigh with every sample. The force of older weights is
        no less true, it is only not quite as quiet as it could be.
        """
        if self._mode != "axial":
            return
        axial_jacobian = self.kinematics.axial_jacobian
        weighted = self._precision.dot(axial_jacobian) if self._weighted else axial_jacobian.copy()
        information = float(weighted.dot(axial_jacobian))
        damping = self._axial_damping
        total = information + damping
        noise = information if self._weighted else float(weighted @ self._covariance @ weighted)
        variance = (noise + damping) / total**2 if total > 0.0 else UNSEEN_STD**2
        removed = damping / total if total > 0.0 else 0.0
        sees = information > 0.0
        self.restore(AxialWeights(weighted, variance, removed, 1.0 if sees else MOST_CONDITIONING))

    @property
    def weights(self) -> AxialWeights:
        """The weights in force."""
        return self._weights

    def restore(self, weights: AxialWeights) -> None:
        """Go on with weights of an earlier time."""
        self._weights = weights
        self._std = math.sqrt(weights.variance_N2)
        numbers = np.array((weights.variance_N2, weights.damping_share))
        numbers.setflags(write=False)
        self._spread, self._removed = numbers[:1, None], numbers[1:]

    def solve(self, residual: Array, offset: Array) -> tuple[Any, ...]:
        """Wrench where `kinematics` stands, from an external joint torque.

        Args:
            residual: External joint torque [Nm], shape (n,).
            offset: What it reads here without contact [Nm], shape (n,); it is subtracted.

        Returns:
            The numbers of a `WrenchEstimate`, from ``axial`` to ``residual``.

        Raises:
            SampleError: For numbers that are not finite.
        """
        if self._mode != "axial":
            return self._general(residual - offset)
        kinematics, weights = self.kinematics, self._weights
        axis = kinematics.axis_in_base if self._in_base else kinematics.axis_in_tool
        corrected, force = np.empty(self._joints), np.empty(3)
        axial = axial_force(
            residual,
            offset,
            weights.weighted,
            kinematics.axial_jacobian,
            axis,
            self._axial_damping,
            corrected,
            force,
        )
        if not math.isfinite(axial):
            raise SampleError("q and residual must be finite; skip this sample")
        # By name it takes thrice as long, in every tick.
        force.setflags(False)  # pyright: ignore[reportCallIssue]
        corrected.setflags(False)  # pyright: ignore[reportCallIssue]
        spread, removed = self._spread, self._removed
        return axial, self._std, force, _NOTHING, spread, weights.conditioning, removed, corrected

    def _general(self, residual: Array) -> tuple[Any, ...]:
        """Three or six unknowns."""
        axis = self.kinematics.axis_in_tool
        size = COMPONENTS[self._mode]
        rows = self.kinematics.jacobian[:size]
        if self._in_base:
            axis, rotation = self.kinematics.axis_in_base, self.kinematics.rotation_tool_to_base
            rows = np.concatenate([rotation.dot(rows[k : k + 3]) for k in range(0, size, 3)])
        solution = weighted_inverse(
            rows,
            residual,
            self._covariance,
            precision=self._precision if self._weighted else None,
            damping=self._damping,
        )
        if not np.isfinite(solution.value).all():
            raise SampleError("q and residual must be finite; skip this sample")
        force, torque = solution.value[:3], solution.value[3:] if size == 6 else _NOTHING
        for array in (force, torque, solution.covariance, solution.damping_share, residual):
            array.setflags(write=False)
        return (
            -float(axis.dot(force)),
            _std_along(axis, solution.covariance[:3, :3]),
            force,
            torque,
            solution.covariance,
            solution.conditioning,
            solution.damping_share,
            residual,
        )

    def smallest_singular_value(self) -> float:
        """How much the joints feel of a newton in the direction they feel least [m].

        Of the directions that the mode asks for (in the full mode a newton metre counts as a
        newton), at the last configuration.
        """
        if self._mode == "axial":
            return math.sqrt(self.kinematics.axial_jacobian.dot(self.kinematics.axial_jacobian))
        rows = self.kinematics.jacobian[: COMPONENTS[self._mode]]
        return float(np.linalg.svd(rows, compute_uv=False)[-1])

    def mismatch_squared(self, residual: Array) -> float:
        """Mean square of the joint torque [Nm] that no wrench of the mode explains.

        In units of its covariance, at the last configuration: about 1 when the model holds, 0 where
        the mode has as many unknowns as there are joints.

        Args:
            residual: External joint torque after offset removal [Nm], shape (n,).
        """
        rows = self.kinematics.jacobian[: COMPONENTS[self._mode]]
        if self._mode == "axial":
            rows = self.kinematics.axial_jacobian[None]
        spare = rows.shape[1] - len(rows)
        if spare <= 0:
            return 0.0
        weighted = rows.dot(self._inverse)
        known, seen = weighted.dot(rows.T), weighted.dot(residual)
        wrench = seen / max(known[0, 0], 1e-300) if len(rows) == 1 else _least(known, seen)
        left = float(residual.dot(self._inverse).dot(residual) - seen.dot(wrench))
        return max(left, 0.0) / spare


def _least(matrix: Array, right: Array) -> Array:
    """Smallest solution of a symmetric system: nothing where it sees nothing."""
    return np.asarray(np.linalg.lstsq(matrix, right, rcond=1e-12)[0], dtype=np.float64)


def _std_along(axis: Array, covariance: Array) -> float:
    """Standard deviation along an axis; that of the unseen if the axis has a component there."""
    if (np.diag(covariance) >= UNSEEN_STD**2).any():
        return UNSEEN_STD
    return float(np.sqrt(axis.dot(covariance).dot(axis)))


def _damping(mode: Mode, expected_force_N: float | None) -> Array:
    """Diagonal of the damping: inverse variance of the wrench that is expected at most."""
    size = COMPONENTS[mode]
    if expected_force_N is None:
        return np.zeros(size)
    expected = np.array([expected_force_N] * 3 + [EXPECTED_TORQUE_NM] * 3)[:size]
    return 1.0 / expected**2


def check_expected(name: str, value: float | None) -> None:
    """Refuse an expected size of force or torque whose inverse square overflows; None is none.

    Raises:
        ConfigurationError: With the name and what came.
    """
    if value is not None:
        check_positive(name, value, least=1e-6, most=1e9)
