"""Tasks: what joint velocities should do to the needle, as rows J dq = v.

A task of the tip selects components S of its velocity and angular velocity, and returns
to a goal:

    J = S J_tip,    v = w + K S e,    e = (g - p, log(R_d R^T))

with p and R the tip's position and axes, g and R_d where they should be, w a wanted
rate. So an error decays with time constant 1/K where no limit and no task above it is
in the way. Errors are of *measured* positions; the loop is stable while K times the
delay from measurement to motion stays below about 0.6. A stack is a list of tasks in
order of priority, the most important first.
"""

from abc import ABC, abstractmethod
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array, Matrix, Vector, WrittenMatrix, WrittenVector
from foundation.jit import compiled
from needleforce.control.errors import SettingError, as_vector, require_positive
from urdf import Robot

GAIN_PER_S = 30.0
"""K of the constraints. 60 / s hold a pushed needle closer where positions are fine;
where they are rounded to an encoder's steps they make the command rough."""

MAX_STEP_s = 0.02
"""A sample that comes later than this moves the arm no further than this one."""

_BASE_AXES = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED

_CROSS = np.cross(np.eye(3)[:, None], np.eye(3)).transpose(2, 0, 1).reshape(9, 3)
"""The map from r to the matrix of w x r, which acts on w; linear in r."""


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
        # Of an arm with a single joint it comes as a vector.
        self.jacobian: Array = jacobian.reshape(6, -1)
        self.pose: Array = pin.updateFramePlacement(model, data, frame).homogeneous
        self.q_rad = q_rad

    @property
    def tip_m(self) -> Array:
        """Position of the tip, shape (3,), a copy."""
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


def _checked_gain(gain_per_s: float) -> float:
    """Return a gain that is finite and not negative; refuse any other."""
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
        self.gain_per_s = _checked_gain(gain_per_s)
        self.goal_m = np.zeros(3)
        self.rotation = np.eye(3)
        self.rate = np.zeros(self.size)
        self._has_rotation = bool(selection[:, 3:].any())

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """Write rows and rates, see `Task.write`."""
        rotation_rad = (
            pin.log3(self.rotation @ tool.pose[:3, :3].T)
            if self._has_rotation
            else np.zeros(3)
        )
        rates[:] = self.rate
        _write_tip_task(
            tool.pose,
            tool.jacobian,
            self.selection,
            self.goal_m,
            rotation_rad,
            self.gain_per_s,
            rows,
            rates,
        )


# On small arrays `np.dot` takes half the time of ``@``.


@compiled
def _write_tip_task(
    pose: Matrix,
    jacobian: Matrix,
    selection: Matrix,
    goal_m: Vector,
    rotation_rad: Vector,
    gain_per_s: float,
    rows: WrittenMatrix,
    rates: WrittenVector,
) -> None:
    """Write J = S J_tip, and add K S e to v; the rotation is log(R_d R^T)."""
    np.dot(selection, jacobian, rows)
    if gain_per_s != 0.0:
        error = np.zeros(6)
        error[:3] = goal_m - pose[:3, 3]
        error[3:] = rotation_rad
        rates += gain_per_s * np.dot(selection, error)


class Fixture(TipTask):
    """A line fixed in space, along which the needle moves without turning; five rows.

    Args:
        origin_m: A point g of the line, shape (3,).
        rotation: Axes R_d of the tool in the base, shape (3, 3); the third is the line.
        gain_per_s: K.
    """

    def __init__(
        self, origin_m: ArrayLike, rotation: ArrayLike, gain_per_s: float = GAIN_PER_S
    ) -> None:
        axes = np.array(rotation, dtype=np.float64)
        is_orthonormal = axes.shape == (3, 3) and np.allclose(
            axes.T @ axes,
            np.eye(3),
            atol=1e-6,  # written with few digits
        )
        if not (is_orthonormal and np.linalg.det(axes) > 0.0):
            raise SettingError(
                f"rotation is {rotation!r}, expected right-handed orthonormal axes in "
                "columns"
            )
        along_axes = np.zeros((6, 6))  # position and rotation along the three axes
        along_axes[:3, :3] = axes.T
        along_axes[3:, 3:] = axes.T
        # All rows but that of the position on the line, which is free.
        super().__init__(np.delete(along_axes, 2, axis=0), gain_per_s)
        self.goal_m = as_vector(origin_m, 3, "origin_m")
        self.rotation = axes

    @classmethod
    def here(cls, tool: ToolState, gain_per_s: float = GAIN_PER_S) -> "Fixture":
        """Return the fixture along the needle as it is now."""
        return cls(tool.tip_m, tool.rotation, gain_per_s)


class TipVelocity(TipTask):
    """A velocity of the tip, J_v dq = w + K (g - p); three rows.

    Args:
        velocity_m_s: w in base axes, shape (3,).
        goal_m: Position g that the tip follows, shape (3,); needs a gain. None for the
            velocity alone.
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
        self.rate = as_vector(velocity_m_s, 3, "velocity_m_s")
        self.goal_m = as_vector(np.zeros(3) if goal_m is None else goal_m, 3, "goal_m")


class RemoteCentre:
    """A fixed point, the entry, through which the needle's axis passes; two rows.

        e = N^T (c - p),   J = N^T (J_v - l [a]_x J_w),   l = a^T (c - p),   v = K e

    with N the tool's x and y axes, a its z axis (the needle) and c the point: the place
    on the axis that is nearest to c moves across the needle towards it (after Aghakhani
    et al., ICRA 2013, without their unknown l). A turn of the needle about itself moves
    no axis, and so no row.

    Args:
        point_m: The point c in the base, shape (3,).
        gain_per_s: K.
    """

    size = 2

    def __init__(self, point_m: ArrayLike, gain_per_s: float = GAIN_PER_S) -> None:
        self.point_m = as_vector(point_m, 3, "point_m")
        self.gain_per_s = _checked_gain(gain_per_s)

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """Write rows and rates, see `Task.write`."""
        _write_remote_centre(
            tool.pose, tool.jacobian, self.point_m, self.gain_per_s, rows, rates
        )


@compiled
def _write_remote_centre(
    pose: Matrix,
    jacobian: Matrix,
    point_m: Vector,
    gain_per_s: float,
    rows: WrittenMatrix,
    rates: WrittenVector,
) -> None:
    """Write J = N^T (J_v - l [a]_x J_w) and v = K N^T (c - p)."""
    lever_m = point_m - pose[:3, 3]
    across = np.ascontiguousarray(pose[:3, :2].T)
    axis = np.ascontiguousarray(pose[:3, 2])
    place_m = np.dot(axis, lever_m) * axis  # on the axis, from the tip
    cross_lever = np.dot(_CROSS, place_m).reshape(3, 3)  # w x place, acting on w
    np.dot(across, jacobian[:3] + np.dot(cross_lever, jacobian[3:]), rows)
    rates[:] = gain_per_s * np.dot(across, lever_m)


class AxialSpeed:
    """Speed of the tip along the needle, positive inwards, one row: a^T J_v dq = w.

    Args:
        speed_m_s: w.
    """

    size = 1

    def __init__(self, speed_m_s: float) -> None:
        self.speed_m_s = float(speed_m_s)

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """Write row and rate, see `Task.write`."""
        rows[0] = tool.pose[:3, 2] @ tool.jacobian[:3]
        rates[0] = self.speed_m_s


class JointTask(ABC):
    """A velocity of every joint, n rows; cheapest as the last of a stack.

    Attributes:
        size: Number n of joints.
    """

    size: int

    @abstractmethod
    def velocity_at(self, q_rad: Array) -> Array:
        """Return the velocity asked for at joint positions, shape (n,)."""

    def write(self, tool: ToolState, rows: Array, rates: Array) -> None:
        """Write rows and rates, see `Task.write`."""
        rates[:] = self.velocity_at(tool.q_rad)
        rows[:] = np.eye(self.size)


class JointVelocity(JointTask):
    """A velocity of every joint that does not depend on the posture.

    Args:
        velocity_rad_s: Of the joints, shape (n,).

    Attributes:
        velocity_rad_s: The same, in an array of its own.
    """

    def __init__(self, velocity_rad_s: ArrayLike) -> None:
        self.size = np.size(velocity_rad_s)
        self.velocity_rad_s = as_vector(velocity_rad_s, self.size, "velocity_rad_s")

    def velocity_at(self, q_rad: Array) -> Array:
        """Return the velocity, shape (n,)."""
        return self.velocity_rad_s


class Posture(JointTask):
    """A posture that joints left free return to, slowly: dq = K (q_d - q). Put it last.

    Args:
        q_rad: The posture q_d, shape (n,).
        gain_per_s: K.

    Attributes:
        goal_rad: q_d, in an array of its own.
        gain_per_s: K.
    """

    def __init__(self, q_rad: ArrayLike, gain_per_s: float = 1.0) -> None:
        self.size = np.size(q_rad)
        self.goal_rad = as_vector(q_rad, self.size, "q_rad")
        self.gain_per_s = _checked_gain(gain_per_s)

    def velocity_at(self, q_rad: Array) -> Array:
        """Return K (q_d - q), shape (n,)."""
        return self.gain_per_s * (self.goal_rad - q_rad)
