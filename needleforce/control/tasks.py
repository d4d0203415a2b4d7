"""Tasks: what joint velocities should do to the needle, as rows J dq = v.

A task of the tip selects components S of its velocity and angular velocity, and returns
to a goal:

    J = S J_tip,    v = w + K S e,    e = (g - p, log(R_d R^T))

with p and R the tip's place and axes, g and R_d where they should be, w a wanted rate.
So an error fades with time constant 1/K where no limit and no task above it is in the
way. Errors are of *measured* positions; the loop is stable while K times the delay from
measurement to motion stays below about 0.6. A stack is a list of tasks, the first wins.
"""

from abc import abstractmethod
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled
from needleforce.control.errors import SettingError, require_positive
from needleforce.control.ports import Array
from urdf import Robot

GAIN_PER_S = 30.0
"""K of the constraints. 60 / s hold a pushed needle closer where positions are fine;
where they are rounded to an encoder's steps they make the command rough."""
LONGEST_STEP_s = 0.02  # A sample that comes later moves the arm no more than this one
_BASE_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
# Of w x r, the matrix on w, linear in r. On small arrays `dot` takes half the time of
# ``@``.
_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(2, 0, 1).reshape(9, 3)
_NO_TURN = np.zeros(3)


class ToolState:
    """Pose and Jacobian of the needle's tip, which all tasks of a tick read.

    Args:
        robot: The arm; the z axis of its tool frame is the needle, growing inwards.

    Attributes:
        q_rad: Joint positions of the last `update`, shape (n,).
        jacobian: Velocity of the tip (rows 0 to 2) and angular velocity (3 to 5) per
            joint velocity, both in base axes, shape (6, n).
        pose: Of the tip in the base, homogeneous, shape (4, 4).
    """

    def __init__(self, robot: Robot) -> None:
        self._data = robot.create_data()
        self._model = robot.model
        self._frame_id = robot.tool_frame_id
        self.update(pin.neutral(robot.model))

    def update(self, q_rad: Array) -> None:
        """Move to a configuration, shape (n,)."""
        model = self._model
        data = self._data
        frame = self._frame_id
        jacobian = pin.computeFrameJacobian(model, data, q_rad, frame, _BASE_AXES)
        self.jacobian: Array = jacobian.reshape(
            6, -1
        )  # of a single joint it comes as a vector
        self.pose: Array = pin.updateFramePlacement(model, data, frame).homogeneous
        self.q_rad = q_rad

    @property
    def tip_m(self) -> Array:
        """Where the tip is, shape (3,), a copy."""
        return self.pose[:3, 3].copy()

    @property
    def rotation(self) -> Array:
        """Axes of the tool in base axes, shape (3, 3), a copy."""
        return np.ascontiguousarray(self.pose[:3, :3])

    @property
    def axis(self) -> Array:
        """Direction of insertion in base axes, of length one, shape (3,), a copy."""
        return self.pose[:3, 2].copy()


class Task(Protocol):
    """Rows J dq = v of equal priority; J in m or 1 per joint, v in m/s or rad/s.

    Attributes:
        size: Number of rows m.
    """

    size: int

    @abstractmethod
    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """Write J into ``rows``, shape (m, n), and v into ``rates``, shape (m,)."""


def vector(value: ArrayLike, size: int, name: str) -> Array:
    """Numbers in an array of their own; `SettingError` if there are more, less or
    none.
    """
    try:
        given = np.array(value, dtype=np.float64)
    except (TypeError, ValueError):
        given = np.zeros(0)
    if given.shape != (size,) or not np.isfinite(given).all():
        raise SettingError(f"{name} is {value!r}, expected {size} finite numbers")
    return given


def _gain(gain_per_s: float) -> float:
    require_positive({"gain_per_s": gain_per_s}, or_zero=("gain_per_s",))
    return float(gain_per_s)


class TipTask:
    """Components of the tip's velocity and angular velocity, see the module.

    Attributes:
        selection: S, shape (m, 6).
        goal_m: g, base axes, shape (3,).
        rotation: R_d, axes of the tool in the base, shape (3, 3).
        rate: w of each row, shape (m,).
        gain_per_s: K; with 0 the rate alone.
    """

    def __init__(self, selection: Array, gain_per_s: float) -> None:
        self.size = len(selection)
        self.selection = selection
        self.gain_per_s = _gain(gain_per_s)
        self.goal_m = np.zeros(3)
        self.rotation = np.eye(3)
        self.rate = np.zeros(self.size)
        self._turns = bool(selection[:, 3:].any())

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """See `Task.write`."""
        turn = (
            pin.log3(self.rotation @ tool.pose[:3, :3].T) if self._turns else _NO_TURN
        )
        goal = self.goal_m, turn, self.rate, self.gain_per_s
        _tip_task(tool.pose, tool.jacobian, self.selection, goal, rows, rates)


@compiled
def _tip_task(
    pose: Matrix,
    jacobian: Matrix,
    selection: Matrix,
    goal: tuple[Vector, Vector, Vector, float],
    rows: WrittenMatrix,
    rates: WrittenVector,
) -> None:
    place, turn, rate, gain_per_s = goal
    np.dot(selection, jacobian, rows)
    rates[:] = rate
    if gain_per_s != 0.0:
        error = np.zeros(6)
        error[:3] = place - pose[:3, 3]
        error[3:] = turn
        rates += gain_per_s * np.dot(selection, error)


class Fixture(TipTask):
    """The needle moves along a line fixed in space and keeps its orientation; five
    rows.

    Args:
        origin_m: A point g of the line, shape (3,).
        rotation: Axes R_d of the tool in the base, shape (3, 3); the third is the line.
        gain_per_s: K.
    """

    def __init__(
        self, origin_m: ArrayLike, rotation: ArrayLike, gain_per_s: float = GAIN_PER_S
    ) -> None:
        axes = np.array(rotation, dtype=np.float64)
        is_turn = axes.shape == (3, 3) and np.allclose(
            axes.T @ axes, np.eye(3), atol=1e-6
        )
        if not (is_turn and np.linalg.det(axes) > 0.0):
            what = "right-handed orthonormal axes in columns"
            raise SettingError(f"rotation is {rotation!r}, expected {what}")
        along = np.zeros((6, 6))  # place and direction, each along the three axes
        along[:3, :3] = along[3:, 3:] = axes.T
        super().__init__(
            np.delete(along, 2, axis=0), gain_per_s
        )  # all but the place on the line
        self.goal_m = vector(origin_m, 3, "origin_m")
        self.rotation = axes

    @classmethod
    def here(cls, tool: ToolState, gain_per_s: float = GAIN_PER_S) -> "Fixture":
        """The fixture along the needle as it is now."""
        return cls(tool.tip_m, tool.rotation, gain_per_s)


class TipVelocity(TipTask):
    """A velocity of the tip, J_v dq = w + K (g - p), three rows; without g the velocity
    alone.

    Args:
        velocity_m_s: w in base axes, shape (3,).
        goal_m: Place g that the tip follows, shape (3,); needs a gain.
        gain_per_s: K.
    """

    def __init__(
        self,
        velocity_m_s: ArrayLike,
        goal_m: ArrayLike | None = None,
        gain_per_s: float = 0.0,
    ) -> None:
        if goal_m is not None and gain_per_s == 0.0:
            raise SettingError(
                "goal_m needs a gain_per_s, or nothing draws the tip there"
            )
        super().__init__(np.eye(6)[:3], gain_per_s if goal_m is not None else 0.0)
        self.rate = vector(velocity_m_s, 3, "velocity_m_s")
        if goal_m is not None:
            self.goal_m = vector(goal_m, 3, "goal_m")


class DecoupledMotion(TipTask):
    """Linear and angular velocity set apart: neither moves what the other has not asked
    for.

    Feedback holds the place and the orientation that the wishes of `move` add up to;
    six rows.

    Args:
        tool: Where to begin.
        gain_per_s: K of both.
    """

    # A wish waits for an arm that limits hold so far back
    MOST_LAG_m = 5e-3
    MOST_LAG_rad = 0.05

    def __init__(self, tool: ToolState, gain_per_s: float = GAIN_PER_S) -> None:
        super().__init__(np.eye(6), gain_per_s)
        self.goal_m = tool.tip_m
        self.rotation = tool.rotation

    def move(
        self,
        tool: ToolState,
        linear_m_s: ArrayLike,
        angular_rad_s: ArrayLike,
        dt_s: float,
    ) -> None:
        """Wish velocities in base axes, shape (3,) each, for the coming tick.

        A longer time than `LONGEST_STEP_s` counts as that, one that is no positive
        number as none.
        """
        behind_m = np.linalg.norm(self.goal_m - tool.tip_m)
        behind_rad = np.linalg.norm(pin.log3(self.rotation @ tool.pose[:3, :3].T))
        linear = vector(linear_m_s, 3, "linear_m_s") * (behind_m < self.MOST_LAG_m)
        angular = vector(angular_rad_s, 3, "angular_rad_s") * (
            behind_rad < self.MOST_LAG_rad
        )
        self.rate = np.concatenate((linear, angular))
        dt_s = min(dt_s, LONGEST_STEP_s) if dt_s > 0.0 else 0.0
        self.goal_m = self.goal_m + dt_s * linear
        self.rotation = np.ascontiguousarray(pin.exp3(dt_s * angular) @ self.rotation)


class RemoteCentre:
    """The needle's axis passes through a fixed point, the entry; two rows.

        e = N^T (c - p),   J = N^T (J_v - [c - p]_x J_w),   v = K e

    with N the tool's x and y axes, c the point: what the tool has there moves across
    the needle towards it (after Aghakhani et al., ICRA 2013, without their unknown, its
    place on the needle).

    Args:
        point_m: The point c in the base, shape (3,).
        gain_per_s: K.
    """

    size = 2

    def __init__(self, point_m: ArrayLike, gain_per_s: float = GAIN_PER_S) -> None:
        self.point_m = vector(point_m, 3, "point_m")
        self.gain_per_s = _gain(gain_per_s)

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """See `Task.write`."""
        _remote_centre(
            tool.pose, tool.jacobian, self.point_m, self.gain_per_s, rows, rates
        )


@compiled
def _remote_centre(
    pose: Matrix,
    jacobian: Matrix,
    point: Vector,
    gain_per_s: float,
    rows: WrittenMatrix,
    rates: WrittenVector,
) -> None:
    arm = point - pose[:3, 3]
    across = np.ascontiguousarray(pose[:3, :2].T)
    swing = np.dot(_CROSS, arm).reshape(3, 3)  # w x arm, as a matrix on w
    np.dot(across, jacobian[:3] + np.dot(swing, jacobian[3:]), rows)
    rates[:] = gain_per_s * np.dot(across, arm)


class AxialSpeed:
    """Speed of the tip along the needle, positive inwards, one row: a^T J_v dq = w."""

    size = 1

    def __init__(self, speed_m_s: float) -> None:
        self.speed_m_s = float(speed_m_s)

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """See `Task.write`."""
        rows[0] = tool.pose[:3, 2] @ tool.jacobian[:3]
        rates[0] = self.speed_m_s


class JointVelocity:
    """A velocity of every joint [rad/s], n rows; cheapest as the last of a stack."""

    def __init__(self, velocity_rad_s: ArrayLike) -> None:
        self.size = np.size(velocity_rad_s)
        self.wish = vector(velocity_rad_s, self.size, "velocity_rad_s")

    def velocity(self, q_rad: Array) -> Array:
        """What it asks for at joint positions, shape (n,)."""
        return self.wish

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """See `Task.write`."""
        rates[:] = self.velocity(tool.q_rad)
        rows[:] = np.eye(self.size)


class Posture(JointVelocity):
    """A posture that joints left free return to, slowly: dq = K (q_d - q). Put it last.

    Args:
        q_rad: The posture q_d, shape (n,).
        gain_per_s: K.
    """

    def __init__(self, q_rad: ArrayLike, gain_per_s: float = 1.0) -> None:
        super().__init__(q_rad)
        self.gain_per_s = _gain(gain_per_s)

    def velocity(self, q_rad: Array) -> Array:
        """See `JointVelocity.velocity`."""
        return self.gain_per_s * (self.wish - q_rad)
