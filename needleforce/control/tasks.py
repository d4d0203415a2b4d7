"""Tasks: what joint velocities should do to the needle, as rows J dq = v.

A task with error e asks for e' = -K e, so that e fades with time constant 1/K where no limit and no
task above it is in the way. Errors are of *measured* positions; the loop is stable while K times
the delay from measurement to motion stays below about 0.6. A stack is a list of tasks, the first
wins.
"""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from needleforce.control.errors import SettingError
from needleforce.control.ports import Array
from needleforce.control.tool_state import ToolState
from needleforce.jit import Matrix, Vector, WrittenMatrix, WrittenVector, compiled

GAIN_PER_S = 30.0
"""K of the constraints. 60 / s hold a pushed needle closer where positions are fine; where they are
rounded to an encoder's steps they make the command rough."""


class Task:
    """Rows J dq = v of equal priority; J in m or 1 per joint, v in m/s or rad/s.

    Attributes:
        size: Number of rows m.
    """

    size = 0

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """Write J into ``rows``, shape (>= m, n), and v into ``rates``, from row ``first`` on."""
        raise NotImplementedError

    def rows(self, tool: ToolState) -> tuple[Array, Array]:
        """J, shape (m, n), and v, shape (m,), in arrays of their own."""
        rows, rates = np.zeros((self.size, tool.q_rad.size)), np.zeros(self.size)
        self.write(tool, rows, rates, 0)
        return rows, rates


def vector(value: ArrayLike, size: int, name: str) -> Array:
    """Numbers in an array of their own; `SettingError` if there are more or less of them."""
    given = np.array(value, dtype=np.float64)
    if given.shape != (size,):
        raise SettingError(f"{name} is {value!r}, expected {size} numbers")
    return given


def rotation_matrix(value: ArrayLike) -> Array:
    """Orthonormal axes, shape (3, 3), in an array of their own; `SettingError` if they are not."""
    given = np.array(value, dtype=np.float64)
    if given.shape != (3, 3) or not np.allclose(given.T @ given, np.eye(3), atol=1e-6):
        raise SettingError(f"rotation is {value!r}, expected three orthonormal axes in columns")
    return given


class RemoteCentre(Task):
    """The needle's axis passes through a fixed point, the entry; two rows.

        e = N^T (c - p),   J = N^T (J_v - [c - p]_x J_w),   v = K e

    with N the tool's x and y axes, p the tip, c the point: what the tool has there moves across
    the needle towards it (after Aghakhani et al., ICRA 2013, without their extra unknown, the
    place of the point along the needle).

    Args:
        point_m: The point c in the base, shape (3,).
        gain_per_s: K.
    """

    size = 2

    def __init__(self, point_m: ArrayLike, gain_per_s: float = GAIN_PER_S) -> None:
        self.point_m, self.gain_per_s = vector(point_m, 3, "point_m"), float(gain_per_s)

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """See `Task.write`."""
        goal = (self.point_m, self.gain_per_s)
        _remote_centre(tool.pose, tool.jacobian, goal, rows, rates, first)


@compiled
def _remote_centre(
    pose: Matrix,
    jacobian: Matrix,
    goal: tuple[Vector, float],
    rows: WrittenMatrix,
    rates: WrittenVector,
    first: int,
) -> None:
    point, gain = goal
    arm = point - pose[:3, 3]
    x, y, z = arm
    swing = np.array([[0.0, z, -y], [-z, 0.0, x], [y, -x, 0.0]])  # w x arm, as a matrix on w
    across = np.ascontiguousarray(pose[:3, :2].T)
    rows[first : first + 2] = across @ (jacobian[:3] + swing @ jacobian[3:])
    rates[first : first + 2] = gain * (across @ arm)


class Fixture(Task):
    """The needle moves along a line fixed in space and keeps its direction; four or five rows.

        e = B^T (o - p, log(R_d R^T)),   J = B^T (J_v, J_w),   v = K e

    where B takes the components along two directions across the line, of the rotation also the
    third, about the line, unless the needle may turn about itself.

    Args:
        origin_m: A point o of the line, shape (3,).
        rotation: Axes R_d of the tool in the base, shape (3, 3); the third is the line.
        gain_per_s: K.
        turn_free: Whether the needle may turn about itself.
    """

    def __init__(
        self,
        origin_m: ArrayLike,
        rotation: ArrayLike,
        gain_per_s: float = GAIN_PER_S,
        *,
        turn_free: bool = False,
    ) -> None:
        self.origin_m, self.gain_per_s = vector(origin_m, 3, "origin_m"), float(gain_per_s)
        self.rotation = rotation_matrix(rotation)
        self.size = 4 if turn_free else 5

    @classmethod
    def here(
        cls, tool: ToolState, gain_per_s: float = GAIN_PER_S, *, turn_free: bool = False
    ) -> "Fixture":
        """The fixture along the needle as it is now."""
        return cls(tool.tip_m, tool.rotation, gain_per_s, turn_free=turn_free)

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """See `Task.write`."""
        goal = (self.origin_m, self.rotation, self.gain_per_s, self.size)
        _fixture(tool.pose, tool.jacobian, goal, rows, rates, first)


@compiled
def rotation_error(goal: Matrix, pose: Matrix) -> tuple[float, float, float]:
    """Rotation log(R_d R^T) [rad] that is missing from R to R_d, in the axes both are given in."""
    x = y = z = trace = 0.0
    for i in range(3):  # half the sum of r_i x r_d,i is the axis times the sine
        a, b, c = pose[0, i], pose[1, i], pose[2, i]
        d, e, f = goal[0, i], goal[1, i], goal[2, i]
        x, y, z = x + 0.5 * (b * f - c * e), y + 0.5 * (c * d - a * f), z + 0.5 * (a * e - b * d)
        trace += a * d + b * e + c * f
    sine, cosine = math.sqrt(x * x + y * y + z * z), 0.5 * (trace - 1.0)
    if sine < 1e-9:  # nothing missing, or half a turn, for which any direction will do
        return (x, y, z) if cosine > 0.0 else (math.pi, 0.0, 0.0)
    scale = math.atan2(sine, cosine) / sine
    return scale * x, scale * y, scale * z


@compiled
def _fixture(
    pose: Matrix,
    jacobian: Matrix,
    goal: tuple[Vector, Matrix, float, int],
    rows: WrittenMatrix,
    rates: WrittenVector,
    first: int,
) -> None:
    origin, rotation, gain, size = goal
    error = np.zeros(6)
    error[:3] = origin - pose[:3, 3]
    error[3], error[4], error[5] = rotation_error(rotation, pose)
    for i in range(size):
        across, part = (i, 0) if i < 2 else (i - 2, 3)
        rows[first + i], rates[first + i] = 0.0, 0.0
        for k in range(3):
            rows[first + i] += rotation[k, across] * jacobian[part + k]
            rates[first + i] += gain * rotation[k, across] * error[part + k]


class TipVelocity(Task):
    """A velocity of the tip, J_v dq = v + K (g - p), three rows; without K the velocity alone.

    Args:
        velocity_m_s: v in base axes, shape (3,).
        goal_m: Place g that the tip follows, shape (3,); needs a gain.
        gain_per_s: K.
    """

    size = 3

    def __init__(
        self, velocity_m_s: ArrayLike, goal_m: ArrayLike | None = None, gain_per_s: float = 0.0
    ) -> None:
        self.velocity_m_s = vector(velocity_m_s, 3, "velocity_m_s")
        self.goal_m = vector((0.0, 0.0, 0.0) if goal_m is None else goal_m, 3, "goal_m")
        self.gain_per_s = 0.0 if goal_m is None else float(gain_per_s)

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """See `Task.write`."""
        goal = (self.velocity_m_s, self.goal_m, self.gain_per_s)
        _tip_velocity(tool.pose, tool.jacobian, goal, rows, rates, first)


@compiled
def _tip_velocity(
    pose: Matrix,
    jacobian: Matrix,
    goal: tuple[Vector, Vector, float],
    rows: WrittenMatrix,
    rates: WrittenVector,
    first: int,
) -> None:
    velocity, place, gain = goal
    rows[first : first + 3] = jacobian[:3]
    rates[first : first + 3] = velocity + gain * (place - pose[:3, 3])


class Orientation(Task):
    """An orientation of the tool, J_w dq = w + K log(R_d R^T), three rows.

    Args:
        rotation: Axes R_d of the tool in the base, shape (3, 3).
        angular_rad_s: Angular velocity w of the goal in base axes, shape (3,).
        gain_per_s: K; with 0 the angular velocity alone.
    """

    size = 3

    def __init__(
        self,
        rotation: ArrayLike,
        angular_rad_s: ArrayLike = (0.0, 0.0, 0.0),
        gain_per_s: float = GAIN_PER_S,
    ) -> None:
        self.rotation = rotation_matrix(rotation)
        self.angular_rad_s = vector(angular_rad_s, 3, "angular_rad_s")
        self.gain_per_s = float(gain_per_s)

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """See `Task.write`."""
        x, y, z = rotation_error(self.rotation, tool.pose)
        rows[first : first + 3] = tool.jacobian[3:]
        rates[first : first + 3] = self.angular_rad_s + self.gain_per_s * np.array((x, y, z))


class DecoupledMotion(Task):
    """Linear and angular velocity set apart: neither moves what the other has not asked for.

    Feedback holds the place and the orientation that the wishes of `move` add up to; six rows.

    Args:
        tool: Where to begin.
        gain_per_s: K of both.
    """

    size = 6
    MOST_LAG_m, MOST_LAG_rad = 5e-3, 0.05
    """A wish waits for an arm that limits hold this far behind it."""

    def __init__(self, tool: ToolState, gain_per_s: float = GAIN_PER_S) -> None:
        self.place = TipVelocity((0.0, 0.0, 0.0), tool.tip_m, gain_per_s)
        self.direction = Orientation(tool.rotation, gain_per_s=gain_per_s)

    def move(
        self, tool: ToolState, linear_m_s: ArrayLike, angular_rad_s: ArrayLike, dt_s: float
    ) -> None:
        """Wish velocities in base axes, shape (3,) each, for the coming tick."""
        place, turn = self.place, self.direction
        behind_m = np.linalg.norm(place.goal_m - tool.tip_m)
        behind_rad = math.hypot(*rotation_error(turn.rotation, tool.pose))
        place.velocity_m_s = vector(linear_m_s, 3, "linear_m_s") * (behind_m < self.MOST_LAG_m)
        turn.angular_rad_s = vector(angular_rad_s, 3, "angular_rad_s")
        turn.angular_rad_s *= behind_rad < self.MOST_LAG_rad
        place.goal_m = place.goal_m + dt_s * place.velocity_m_s
        turn.rotation = np.ascontiguousarray(pin.exp3(dt_s * turn.angular_rad_s) @ turn.rotation)

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """See `Task.write`."""
        self.place.write(tool, rows, rates, first)
        self.direction.write(tool, rows, rates, first + 3)


class AxialSpeed(Task):
    """Speed of the tip along a direction, one row: a^T J_v dq = v.

    Args:
        speed_m_s: v, positive inwards.
        axis: Direction a in the base, of length one, shape (3,); the needle's own where None.
    """

    size = 1

    def __init__(self, speed_m_s: float, axis: ArrayLike | None = None) -> None:
        self.speed_m_s = float(speed_m_s)
        self.axis = None if axis is None else vector(axis, 3, "axis")

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """See `Task.write`."""
        axis = tool.pose[:3, 2] if self.axis is None else self.axis
        rows[first] = axis @ tool.jacobian[:3]
        rates[first] = self.speed_m_s


class JointVelocity(Task):
    """A velocity of every joint, dq = w + K (q_d - q), n rows.

    Args:
        velocity_rad_s: w, shape (n,).
        goal_rad: Positions q_d that the joints follow, shape (n,); needs a gain.
        gain_per_s: K.
    """

    def __init__(
        self, velocity_rad_s: ArrayLike, goal_rad: ArrayLike | None = None, gain_per_s: float = 0.0
    ) -> None:
        self.size = np.size(velocity_rad_s)
        self.velocity_rad_s = vector(velocity_rad_s, self.size, "velocity_rad_s")
        goal = np.zeros(self.size) if goal_rad is None else goal_rad
        self.goal_rad = vector(goal, self.size, "goal_rad")
        self.gain_per_s = 0.0 if goal_rad is None else float(gain_per_s)

    def write_velocity(self, q_rad: Array, velocity: Array) -> None:
        """Write what it asks for at joint positions, shape (n,); `SettingError` for another n."""
        if q_rad.size != self.size:
            raise SettingError(f"a task of {self.size} joints, the robot has {q_rad.size}")
        _joint_velocity(q_rad, self.velocity_rad_s, self.goal_rad, self.gain_per_s, velocity)

    def write(self, tool: ToolState, rows: Array, rates: Array, first: int) -> None:
        """See `Task.write`."""
        self.write_velocity(tool.q_rad, rates[first : first + self.size])
        rows[first : first + self.size] = np.eye(self.size)


@compiled
def _joint_velocity(
    q: Vector, velocity: Vector, goal: Vector, gain: float, result: WrittenVector
) -> None:
    result[:] = velocity + gain * (goal - q)


class Posture(JointVelocity):
    """A posture that joints left free return to, slowly; n rows. Put it last.

    Args:
        q_rad: The posture, shape (n,).
        gain_per_s: K.
    """

    def __init__(self, q_rad: ArrayLike, gain_per_s: float = 1.0) -> None:
        super().__init__(np.zeros(np.size(q_rad)), q_rad, gain_per_s)
