"""Contacts of the arm in closed loop: a trocar, a wall, a person's hand.

Each contact is a law, motion of one point of the arm in, force out. It acts at every
physics step of `ArmPlant`; between the arm's ticks its point moves by the Jacobian of
the tick's start. Plain numbers instead of arrays: there are several of these calls in
each tick.
"""

# MuJoCo's names live in a compiled module without stubs.
# pyright: reportAttributeAccessIssue=false, reportOptionalMemberAccess=false

import math
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from groundtruth.errors import PlantError

try:
    import mujoco
except ModuleNotFoundError:  # The laws do not need it.
    mujoco = None

Vector3 = tuple[float, float, float]
NO_FORCE: Vector3 = (0.0, 0.0, 0.0)

Place = Literal["tip", "hub", "wrist", "elbow"]
GRIPS: dict[str, tuple[str, str]] = {
    "tip": ("tip", "needle"),
    "hub": ("sensor", "sensor"),
    "wrist": ("link_6", "link_6"),
    "elbow": ("link_4", "link_4"),
}
"""Places that can be touched: the body whose origin it is, and the body that takes the
force. The hub is the housing between flange and F/T sensor: this does not feel the
hand."""


class PointMotion(NamedTuple):
    """Motion of a point of the arm and of the body it belongs to, in base axes.

    Attributes:
        position_m: Of the point.
        axis: Direction of the body's z axis; of the needle at the tip.
        velocity_m_s: Of the point.
        angular_velocity_rad_s: Of the body.
    """

    position_m: Vector3
    axis: Vector3
    velocity_m_s: Vector3
    angular_velocity_rad_s: Vector3


class Contact(Protocol):
    """A law of force at one point of the arm."""

    @property
    def at(self) -> str:
        """Point at which it acts, one of `GRIPS`."""
        ...

    def begin(self, motion: PointMotion) -> None:
        """Set the contact's reference where the arm is placed; each time anew."""
        ...

    def force(self, t_s: float, motion: PointMotion) -> tuple[Vector3, Vector3]:
        """Return the force on the arm [N] and where it acts [m], in base axes."""
        ...


def _vector3(numbers: Sequence[float]) -> Vector3:
    x, y, z = numbers
    return x, y, z


def dot(a: Vector3, b: Vector3) -> float:
    """Return the scalar product."""
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def add(a: Vector3, b: Vector3, scale: float = 1.0) -> Vector3:
    """Return a + scale b."""
    return a[0] + scale * b[0], a[1] + scale * b[1], a[2] + scale * b[2]


def cross(a: Vector3, b: Vector3) -> Vector3:
    """Return the vector product."""
    return (
        a[1] * b[2] - a[2] * b[1],
        a[2] * b[0] - a[0] * b[2],
        a[0] * b[1] - a[1] * b[0],
    )


def distance_to_axis_m(point_m: ArrayLike, on_axis_m: ArrayLike, axis: Array) -> float:
    """Return the distance of a point from a line.

    Args:
        point_m: The point, shape (3,).
        on_axis_m: A point of the line, shape (3,).
        axis: Direction of the line, length one, shape (3,).
    """
    apart = np.subtract(point_m, on_axis_m)
    return float(np.linalg.norm(apart - np.dot(apart, axis) * axis))


@dataclass(slots=True, kw_only=True)
class Trocar:
    """An elastic support of the needle at a point, across its axis.

    The needle slides and turns in it.

    Attributes:
        behind_tip_m: Distance of the trocar from the tip, along the needle, when the
            arm is placed.
        stiffness_N_per_m: Stiffness across the needle.
        damping_Ns_per_m: Damping across the needle.
        point_m: Position of the trocar, base axes; set when the arm is placed.
        at: Point at which it acts, one of `GRIPS`.
    """

    behind_tip_m: float
    stiffness_N_per_m: float = 1000.0
    damping_Ns_per_m: float = 5.0
    point_m: Vector3 = field(default=NO_FORCE, init=False)
    at: str = field(default="tip", init=False)

    def begin(self, motion: PointMotion) -> None:
        """Put the trocar where the needle is now."""
        self.point_m = add(motion.position_m, motion.axis, -self.behind_tip_m)

    def force(self, t_s: float, motion: PointMotion) -> tuple[Vector3, Vector3]:
        """Return the force of spring and damper across the needle.

        It acts at the point of the needle's axis nearest to the trocar.
        """
        tip = motion.position_m
        axis = motion.axis
        along = dot(add(self.point_m, tip, -1.0), axis)
        nearest = add(tip, axis, along)
        lever = (along * axis[0], along * axis[1], along * axis[2])
        speed = add(motion.velocity_m_s, cross(motion.angular_velocity_rad_s, lever))
        across = add(speed, axis, -dot(speed, axis))
        pull = add(NO_FORCE, add(self.point_m, nearest, -1.0), self.stiffness_N_per_m)
        return add(pull, across, -self.damping_Ns_per_m), nearest


@dataclass(slots=True, kw_only=True)
class Wall:
    """A stiff plane across the needle's way, such as bone.

    It pushes only, and has no friction.

    Attributes:
        distance_m: Distance from the tip, along the needle, when the arm is placed.
        stiffness_N_per_m: Stiffness along the needle.
        damping_Ns_per_m: Damping while in contact. At 20 kN/m and the 3 kg that the arm
            has along its needle, 50 is a tenth of critical.
        penetration_m: Penetration of the tip, negative in front of the wall.
        at: Point at which it acts, one of `GRIPS`.
    """

    distance_m: float
    stiffness_N_per_m: float = 20e3
    damping_Ns_per_m: float = 50.0
    penetration_m: float = field(default=-math.inf, init=False)
    at: str = field(default="tip", init=False)
    _surface: tuple[Vector3, Vector3] = field(default=(NO_FORCE, NO_FORCE), init=False)

    def begin(self, motion: PointMotion) -> None:
        """Put the wall across the needle's present direction."""
        self._surface = (
            add(motion.position_m, motion.axis, self.distance_m),
            motion.axis,
        )

    def force(self, t_s: float, motion: PointMotion) -> tuple[Vector3, Vector3]:
        """Return the push along the wall's normal; it never pulls."""
        point, normal = self._surface
        tip = motion.position_m
        self.penetration_m = dot(add(tip, point, -1.0), normal)
        if self.penetration_m <= 0.0:
            return NO_FORCE, tip
        push = self.stiffness_N_per_m * self.penetration_m
        push += self.damping_Ns_per_m * dot(motion.velocity_m_s, normal)
        return add(NO_FORCE, normal, -max(push, 0.0)), tip


@dataclass(slots=True, kw_only=True)
class HandOnArm:
    """A person's hand on the arm.

    It exerts a force over time, or leads the arm along a path by a spring and damper.

    Attributes:
        at: Point that it holds, one of `GRIPS`.
        force_N: Force over time [s], base axes; None for none.
        path_m: Path of the hand over time, relative to where it took hold, base axes;
            None if it holds nothing.
        stiffness_N_per_m: Stiffness of the hand along a path.
        damping_Ns_per_m: Damping of the hand, against the motion of the arm.
        stretch_m: How far the arm is from where the hand wants it, base axes.
    """

    at: Place
    force_N: Callable[[float], Iterable[float]] | None = None
    path_m: Callable[[float], Iterable[float]] | None = None
    stiffness_N_per_m: float = 500.0
    damping_Ns_per_m: float = 8.0
    stretch_m: Vector3 = field(default=NO_FORCE, init=False)
    _hold_m: Vector3 = field(default=NO_FORCE, init=False)

    def __post_init__(self) -> None:
        """Raise `PlantError` for an unknown place."""
        if self.at not in GRIPS:
            raise PlantError(
                f"no place {self.at!r} to hold; expected one of {', '.join(GRIPS)}"
            )

    def begin(self, motion: PointMotion) -> None:
        """Take hold of the arm where it is now."""
        self._hold_m = motion.position_m

    def force(self, t_s: float, motion: PointMotion) -> tuple[Vector3, Vector3]:
        """Return the force over time and that of spring and damper, together."""
        push = NO_FORCE
        if self.force_N is not None:
            fx, fy, fz = self.force_N(t_s)
            push = fx, fy, fz
        if self.path_m is not None:
            px, py, pz = self.path_m(t_s)
            self.stretch_m = add(
                add(self._hold_m, (px, py, pz)), motion.position_m, -1.0
            )
            push = add(push, self.stretch_m, self.stiffness_N_per_m)
            push = add(push, motion.velocity_m_s, -self.damping_Ns_per_m)
        return push, motion.position_m


class TouchedPoint:
    """A point of the arm with the contacts that act on it, in a MuJoCo model.

    Between ticks the point is moved by the Jacobian of the tick's start: the arm turns
    by less than 1e-3 rad meanwhile, which leaves 0.1 um at a lever of 0.2 m.
    """

    def __init__(self, model: Any, data: Any, contacts: Sequence[Contact]) -> None:
        """Bind contacts that all act at the same of `GRIPS`.

        `locate` must be called before anything else.
        """
        point, body = GRIPS[contacts[0].at]
        self._model = model
        self._data = data
        self._contacts = contacts
        self._point = model.body(point).id
        self._body = model.body(body).id
        self._jacobian = np.zeros((6, model.nv))
        self._wrench: Array = data.xfrc_applied[self._body]
        self._now = PointMotion(NO_FORCE, NO_FORCE, NO_FORCE, NO_FORCE)
        self._from_com_m: Vector3 = NO_FORCE

    def locate(self) -> None:
        """Update the point from the posture at the start of a tick."""
        data = self._data
        jacobian = self._jacobian
        place = data.xpos[self._point]
        mujoco.mj_jac(self._model, data, jacobian[:3], jacobian[3:], place, self._body)
        x, y, z = place.tolist()
        ax, ay, az = data.xmat[self._point][2::3].tolist()  # third column
        cx, cy, cz = data.xipos[self._body].tolist()
        self._now = PointMotion((x, y, z), (ax, ay, az), NO_FORCE, NO_FORCE)
        self._from_com_m = x - cx, y - cy, z - cz

    def begin(self) -> None:
        """Let the contacts take hold of the arm as it stands."""
        for contact in self._contacts:
            contact.begin(self._now)

    def act(self, t_s: float, dq_rad_s: Array, step_s: float) -> None:
        """Apply the contacts' forces for one physics step, and move the point along."""
        twist = self._jacobian.dot(dq_rad_s).tolist()
        speed = _vector3(twist[:3])
        turning = _vector3(twist[3:])
        change = cross(turning, self._now.axis)
        # At the middle of the step: a force held from its start would feed energy into
        # a spring.
        position = add(self._now.position_m, speed, 0.5 * step_s)
        axis = add(self._now.axis, change, 0.5 * step_s)
        motion = PointMotion(position, axis, speed, turning)
        force = NO_FORCE
        torque = NO_FORCE
        for contact in self._contacts:
            contact_force, point = contact.force(t_s, motion)
            force = add(force, contact_force)
            lever = add(add(point, position, -1.0), self._from_com_m)
            torque = add(torque, cross(lever, contact_force))
        self._wrench[:] = force + torque
        end = add(position, speed, 0.5 * step_s)
        self._now = PointMotion(end, add(axis, change, 0.5 * step_s), speed, turning)
