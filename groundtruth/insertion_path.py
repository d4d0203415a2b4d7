"""Joint positions along the straight line of the needle, as a smooth function of travel."""

from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from scipy.interpolate import BSpline, make_interp_spline

from groundtruth.errors import PathError
from urdf import Robot

LWR_POSTURE_rad = (0.2, 0.4, 0.3, -1.5, -0.2, 1.2, 0.1)
"""Where every run of the LWR starts, once `needle_down` has made it exactly vertical: elbow
bent and out of the vertical plane, tip 0.29 m above the base. Condition number of the Jacobian
8 to 10 over 0.24 m of travel, no joint within 25 degrees of a limit."""

_KNOT_SPACING_m = 5e-3
_TOLERANCE = 1e-12
_ITERATIONS = 50
_MAX_CONDITION = 30.0


@dataclass(frozen=True, slots=True, kw_only=True)
class InsertionPath:
    """A straight line of the tool frame along its own z axis, in joint space.

    Quintic spline through knots solved to rounding every 5 mm; between knots the tip leaves the
    line by less than a nanometre.
    """

    spline: BSpline
    """Joint positions (7,) as a function of travel in m."""

    transform_start_to_base: pin.SE3
    """Pose of the tool frame at travel zero; the insertion axis is its z axis."""

    @property
    def axis_in_base(self) -> NDArray[np.float64]:
        """Unit vector along the insertion, shape (3,)."""
        return self.transform_start_to_base.rotation[:, 2].copy()


def needle_down(robot: Robot, posture_rad: NDArray[np.float64]) -> NDArray[np.float64]:
    """Turn a posture, tip kept in place, until the tool's z axis points straight down.

    Args:
        robot: Robot with a tool frame.
        posture_rad: Shape (n,), tool within 90 degrees of vertical.

    Returns:
        Joint positions, shape (n,).

    Raises:
        PathError: The posture cannot be reached, or lies outside the limits or near a singularity.
    """
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, posture_rad)
    tool = data.oMf[robot.tool_frame_id]
    down = np.array([0.0, 0.0, -1.0])
    turn = pin.Quaternion.FromTwoVectors(tool.rotation[:, 2], down).matrix()
    turned = _solve(robot, data, posture_rad, pin.SE3(turn @ tool.rotation, tool.translation))
    _check(robot, data, turned[None])
    return turned


def insertion_path(
    robot: Robot, start_rad: NDArray[np.float64], travel_m: tuple[float, float]
) -> InsertionPath:
    """Plan the straight line along the tool's z axis, orientation kept.

    Each knot takes the smallest joint step from its neighbour, so the redundancy is resolved by
    least motion.

    Args:
        robot: Robot with a tool frame.
        start_rad: Posture at travel zero, shape (n,).
        travel_m: Smallest and largest travel needed, positive along the tool's z axis.

    Returns:
        The path, valid over that range and one knot beyond.

    Raises:
        PathError: The line leaves the workspace, the joint limits or comes near a singularity.
    """
    data = robot.create_data()
    pin.framesForwardKinematics(robot.model, data, start_rad)
    start = data.oMf[robot.tool_frame_id].copy()
    first = int(np.floor(travel_m[0] / _KNOT_SPACING_m)) - 1
    last = int(np.ceil(travel_m[1] / _KNOT_SPACING_m)) + 1
    knots = {0: start_rad}
    for indices in (range(1, max(last, 5) + 1), range(-1, first - 1, -1)):
        posture = start_rad
        for index in indices:
            offset = pin.SE3(np.eye(3), np.array([0.0, 0.0, index * _KNOT_SPACING_m]))
            posture = knots[index] = _solve(robot, data, posture, start * offset)
    indices = sorted(knots)
    postures = np.array([knots[index] for index in indices])
    _check(robot, data, postures)
    spline = make_interp_spline(np.array(indices) * _KNOT_SPACING_m, postures, k=5)
    return InsertionPath(spline=spline, transform_start_to_base=start)


def _solve(
    robot: Robot, data: pin.Data, posture_rad: NDArray[np.float64], target: pin.SE3
) -> NDArray[np.float64]:
    """Inverse kinematics by Newton steps of least norm."""
    posture = np.array(posture_rad)
    for _ in range(_ITERATIONS):
        pin.framesForwardKinematics(robot.model, data, posture)
        error = pin.log6(data.oMf[robot.tool_frame_id].actInv(target)).vector
        if np.abs(error).max() < _TOLERANCE:
            return posture
        jacobian = pin.computeFrameJacobian(robot.model, data, posture, robot.tool_frame_id)
        posture = posture + np.linalg.pinv(jacobian) @ error
    raise PathError(
        f"no posture reaches {target.translation.round(4)} m; start elsewhere or travel less"
    )


def _check(robot: Robot, data: pin.Data, postures: NDArray[np.float64]) -> None:
    outside = (postures < robot.position_lower_rad) | (postures > robot.position_upper_rad)
    if outside.any():
        joints = [robot.joint_names[j] for j in np.flatnonzero(outside.any(axis=0))]
        raise PathError(f"the limits of {', '.join(joints)} are exceeded; start elsewhere")
    for posture in postures:
        jacobian = pin.computeFrameJacobian(robot.model, data, posture, robot.tool_frame_id)
        if np.linalg.cond(jacobian) > _MAX_CONDITION:
            raise PathError(
                f"the arm is nearly singular at {posture.round(2)} rad; start elsewhere"
            )
