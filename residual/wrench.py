"""From external joint torque to the wrench at a named frame: equation (13) and better."""

import math
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike, NDArray

from residual.errors import ConfigurationError, SampleError
from residual.settings_check import check_choice
from residual.weighted_inverse import weighted_inverse
from residual.wrench_estimate import WrenchEstimate
from urdf import Robot

Mode = Literal["axial", "point", "full"]
"""What is assumed of the contact: a force along the needle axis, a force at the frame's origin,
or a force and a torque."""
Axes = Literal["base", "tool"]
Weighting = Literal["covariance", "none"]

COMPONENTS = {"axial": 1, "point": 3, "full": 6}
"""Unknowns of every mode."""
_NOTHING = np.zeros(3)
_NOTHING.setflags(write=False)


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
        weighting: ``covariance``, by the inverse covariance of the torque; ``none``, the plain
            pseudo-inverse of equation (13), which has no damping either.
        expected_force_N: Size of force beyond which an estimate is drawn to zero where the joints
            cannot see it (damping near singular poses); None for no damping.
        expected_torque_Nm: The same of torque, in the full mode.

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
        weighting: Weighting = "covariance",
        expected_force_N: float | None = 100.0,
        expected_torque_Nm: float = 10.0,
    ) -> None:
        check_choice("mode", mode, tuple(COMPONENTS))
        check_choice("weighting", weighting, ("covariance", "none"))
        check_choice("axes", axes, ("base", "tool"))
        self._axis_in_tool = _unit_axis(insertion_axis)
        self._model, self._data = robot.model, robot.create_data()
        self._frame_id = robot.frame_id(frame if frame is not None else robot.tool_frame)
        self._mode: Mode = mode
        self._in_base = axes == "base"
        self._shape = (robot.nv,)
        self._damping = _damping(mode, expected_force_N, expected_torque_Nm)
        if weighting == "none":
            self._damping[:] = 0.0
        self._weighted = weighting == "covariance"
        self._covariance = self._precision = np.eye(robot.nv)

    def set_torque_covariance(self, covariance_Nm2: NDArray[np.float64]) -> None:
        """Tell how far the residual may be trusted: it sets weights and standard deviations.

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
        if self._weighted:
            self._precision = root.T @ root

    def estimate(self, q: NDArray[np.float64], residual: NDArray[np.float64]) -> WrenchEstimate:
        """Wrench at a configuration [rad] from the external joint torque [Nm], both shape (n,).

        Raises:
            SampleError: For a wrong shape or numbers that are not finite.
        """
        q, residual = np.asarray(q, dtype=np.float64), np.asarray(residual, dtype=np.float64)
        if q.shape != self._shape or residual.shape != self._shape:
            raise SampleError(
                f"q and residual have shapes {q.shape} and {residual.shape}, expected {self._shape}"
            )
        pin.computeJointJacobians(self._model, self._data, q)
        jacobian = pin.getFrameJacobian(
            self._model, self._data, self._frame_id, pin.ReferenceFrame.LOCAL
        )
        if self._mode == "axial":
            return self._axial(jacobian, residual)
        return self._general(jacobian, residual)

    def _rotation(self) -> NDArray[np.float64]:
        return pin.updateFramePlacement(self._model, self._data, self._frame_id).rotation

    def _axial(
        self, jacobian: NDArray[np.float64], residual: NDArray[np.float64]
    ) -> WrenchEstimate:
        """One unknown along the needle: scalars instead of matrices, for the hot path."""
        resisting = -self._axis_in_tool.dot(jacobian[:3])
        weighted = self._precision.dot(resisting) if self._weighted else resisting
        information = float(weighted.dot(resisting))
        damping = float(self._damping[0])
        total = information + damping
        if total <= 0.0:
            total = math.inf
        axial = float(weighted.dot(residual)) / total
        noise = information if self._weighted else float(weighted @ self._covariance @ weighted)
        variance = (noise + damping) / total**2 if total < math.inf else math.inf
        if not math.isfinite(axial):
            raise SampleError("q and residual must be finite; skip this sample")
        force = self._axis_in_tool * -axial
        if self._in_base:
            force = self._rotation().dot(force)
        covariance, share = np.array([[variance]]), np.array([damping / total])
        for array in (force, covariance, share):
            array.setflags(write=False)
        conditioning = 1.0 if information > 0.0 else math.inf
        std = math.sqrt(variance)
        return WrenchEstimate(
            axial, std, force, _NOTHING, covariance, conditioning, share, residual
        )

    def _general(
        self, jacobian: NDArray[np.float64], residual: NDArray[np.float64]
    ) -> WrenchEstimate:
        """Three or six unknowns."""
        axis = self._axis_in_tool
        size = COMPONENTS[self._mode]
        rows = jacobian[:size]
        if self._in_base:
            rotation = self._rotation()
            axis = rotation.dot(axis)
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
        for array in (force, torque, solution.covariance, solution.damping_share):
            array.setflags(write=False)
        return WrenchEstimate(
            -float(axis.dot(force)),
            _std_along(axis, solution.covariance[:3, :3]),
            force,
            torque,
            solution.covariance,
            solution.conditioning,
            solution.damping_share,
            residual,
        )


def _unit_axis(insertion_axis: ArrayLike) -> NDArray[np.float64]:
    try:
        axis = np.asarray(insertion_axis, dtype=np.float64)
    except (TypeError, ValueError):
        axis = np.zeros(0)
    if axis.shape != (3,) or not np.isfinite(axis).all() or not axis.any():
        raise ConfigurationError(
            f"insertion_axis is {insertion_axis!r}, expected three numbers, not all zero"
        )
    axis = axis / np.abs(axis).max()
    return axis / np.linalg.norm(axis)


def _std_along(axis: NDArray[np.float64], covariance: NDArray[np.float64]) -> float:
    """Standard deviation along an axis; infinite if the axis has a share in an unseen direction."""
    unseen = np.isinf(np.diag(covariance))
    if unseen.any():
        return math.inf
    return float(np.sqrt(axis.dot(covariance).dot(axis)))


def _damping(
    mode: Mode, expected_force_N: float | None, expected_torque_Nm: float
) -> NDArray[np.float64]:
    """Diagonal of the damping: inverse variance of the wrench that is expected at most."""
    size = COMPONENTS[mode]
    if expected_force_N is None:
        return np.zeros(size)
    if not (expected_force_N > 0 and expected_torque_Nm > 0):
        raise ConfigurationError(
            f"expected_force_N and expected_torque_Nm are {expected_force_N!r} and "
            f"{expected_torque_Nm!r}, expected positive numbers (or None for no damping)"
        )
    expected = np.array([expected_force_N] * 3 + [expected_torque_Nm] * 3)[:size]
    return 1.0 / expected**2
