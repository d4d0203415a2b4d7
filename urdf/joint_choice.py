"""Which joints of a description move: those of the log; all others are welded.

A joint that is welded becomes a fixed one at a position, before there is a model. So
its kind does not matter, nor a name that a link has too, nor how many there are.
"""

from collections.abc import Collection, Iterable, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from urdf.description import link_of, read_description, read_numbers
from urdf.errors import (
    KEEP_JOINTS,
    InputError,
    UnknownNameError,
    UnsupportedJointError,
)

MAX_MOVING_JOINTS = 200
"""Most joints that may move: the workspace that Pinocchio allocates grows with their
third power, to 256 MB here."""

_ONE_NUMBER_KINDS = ("revolute", "continuous", "prismatic")


def movable_joints(path: Path, without: Iterable[str] = ()) -> tuple[str, ...]:
    """Return the names of the joints that have one position, in the file's order.

    Fixed joints and those that mimic another are not among them. Errors are those of
    `urdf.load_urdf`.
    """
    root = read_description(path, without)
    return tuple(
        joint.get("name", "") for joint in root.findall("joint") if _is_movable(joint)
    )


def joints_towards(
    path: Path, frame: str | None, without: Iterable[str] = ()
) -> tuple[str, ...]:
    """Return the joints of `movable_joints` that move a link, from the root to it.

    Args:
        path: The file.
        frame: Link or joint; None for the last link, if there is one only.
        without: Links to leave out.

    Raises:
        UnknownNameError: There is no such link or joint, or no single last link.
    """
    root = read_description(path, without)
    joints = root.findall("joint")
    if frame is None:
        return _route_to(joints, last_link(root, str(path)))
    links = [link.get("name", "") for link in root.findall("link")]
    child_of_joint = {joint.get("name"): link_of(joint, "child") for joint in joints}
    link = frame if frame in links else child_of_joint.get(frame)
    if link is None:
        raise UnknownNameError(
            f"{path}: there is no frame {frame!r}; links: {', '.join(links)}"
        )
    return _route_to(joints, link)


def weld_joints(
    root: Element,
    source: str,
    *,
    locked: Mapping[str, float],
    kept: Iterable[str] | None,
) -> None:
    """Make joints fixed: the locked ones, and all that are not kept.

    A joint that mimics a welded one is welded with it.

    Args:
        root: The description, which is changed.
        source: Name of the file, for messages.
        locked: Positions by joint [rad, m].
        kept: Joints that move; None for all that are not locked.

    Raises:
        UnknownNameError: There is no such joint.
        InputError: A joint is locked and kept.
        UnsupportedJointError: Joints that are left do not have one number each, or are
            too many.
    """
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    moving = {
        name: joint for name, joint in joints.items() if joint.get("type") != "fixed"
    }
    kept = None if kept is None else tuple(kept)
    for name, position in locked.items():
        if name not in joints or (name not in moving and position != 0.0):
            raise _unknown_joint(f"lock {name!r}", moving, source)
    for name in kept or ():
        if name not in moving:
            raise _unknown_joint(f"keep {name!r}", moving, source)
        if name in locked:
            raise InputError(
                f"joint {name!r} is in locked_joints and in keep_joints, expected one "
                "of them"
            )
    positions = {name: locked[name] for name in locked if name in moving}
    if kept is not None:
        positions = {name: 0.0 for name in moving if name not in kept} | positions
    chosen = {*locked, *(kept or ())}
    for name, position in _with_followers(moving, positions, chosen, source).items():
        _weld(moving.pop(name), position, source)
    _require_one_number(moving.values(), source)


def _unknown_joint(
    wish: str, moving: Mapping[str, Element], source: str
) -> UnknownNameError:
    return UnknownNameError(
        f"{source}: cannot {wish}, there is no such joint; joints: {', '.join(moving)}"
    )


def _is_movable(joint: Element) -> bool:
    return joint.get("type") in _ONE_NUMBER_KINDS and joint.find("mimic") is None


def _route_to(joints: Iterable[Element], link: str) -> tuple[str, ...]:
    """Return the movable joints from the root to a link."""
    by_child = {link_of(joint, "child"): joint for joint in joints}
    route: list[str] = []
    while link in by_child:
        joint = by_child.pop(link)  # so that a loop of links ends
        if _is_movable(joint):
            route.append(joint.get("name", ""))
        link = link_of(joint, "parent") or ""
    return tuple(reversed(route))


def last_link(root: Element, source: str) -> str:
    """Return the only link that joints move and that carries no other.

    Of several, the message lists those that about as many joints move as any: not the
    sensors of a base.
    """
    joints = root.findall("joint")
    links = [link.get("name", "") for link in root.findall("link")]
    parents = {link_of(joint, "parent") for joint in joints}
    ends = {link: len(_route_to(joints, link)) for link in links if link not in parents}
    moved_by = {link: count for link, count in ends.items() if count}
    if len(moved_by) == 1:
        return next(iter(moved_by))
    limit = max(moved_by.values(), default=0) / 2.0
    likely = [link for link, count in moved_by.items() if count >= limit]
    raise UnknownNameError(
        f"{source}: there is no single last link that could carry the tool; it ends "
        f"in: {', '.join(likely) or 'none'}",
        "Give `tool_frame`, the frame at the needle's tip.",
    )


def _with_followers(
    moving: Mapping[str, Element],
    positions: Mapping[str, float],
    chosen: Collection[str],
    source: str,
) -> dict[str, float]:
    """Return the positions with those of all joints that mimic one of them.

    Joints that were chosen to be locked or kept stay as they are.
    """
    positions = dict(positions)
    followers = {
        name: mimic
        for name, joint in moving.items()
        if (mimic := joint.find("mimic")) is not None and name not in chosen
    }
    for _ in followers:  # a follower may be followed
        for name, mimic in followers.items():
            leader = mimic.get("joint", "")
            if leader not in positions:
                continue
            owner = f"{source}: joint {name!r}"
            factor = {"multiplier": 1.0, "offset": 0.0}
            for key in factor.keys() & mimic.attrib.keys():
                factor[key] = read_numbers(moving[name], "mimic", key, owner)[0]
            position = factor["multiplier"] * positions[leader] + factor["offset"]
            positions[name] = position
    return positions


def _weld(joint: Element, position: float, source: str) -> None:
    """Make a joint fixed at a position [rad, m]."""
    kind = joint.get("type")
    joint.set("type", "fixed")
    if position == 0.0:
        return
    owner = f"{source}: joint {joint.get('name')!r}"
    axis = np.array([1.0, 0.0, 0.0])
    is_axial = kind in _ONE_NUMBER_KINDS
    if is_axial and joint.find("axis") is not None:
        axis = np.array(read_numbers(joint, "axis", "xyz", owner, count=3))
        axis /= np.linalg.norm(axis) or 1.0
    motion = pin.SE3(np.eye(3), position * axis)
    if kind in ("revolute", "continuous"):
        motion = pin.SE3(pin.exp3(position * axis), np.zeros(3))
    _set_origin(joint, _origin_of(joint, owner) * motion)


def _origin_of(joint: Element, owner: str) -> pin.SE3:
    """Return where a joint stands in its parent link."""
    origin = joint.find("origin")
    vectors: dict[str, Array] = {}
    for key in ("xyz", "rpy"):
        is_given = origin is not None and key in origin.attrib
        numbers = (
            read_numbers(joint, "origin", key, owner, count=3)
            if is_given
            else [0.0, 0.0, 0.0]
        )
        vectors[key] = np.array(numbers)
    return pin.SE3(pin.rpy.rpyToMatrix(*vectors["rpy"].tolist()), vectors["xyz"])


def _set_origin(joint: Element, placement: pin.SE3) -> None:
    """Write where a joint stands in its parent link."""
    origin = joint.find("origin")
    if origin is None:
        origin = Element("origin")
        joint.append(origin)
    angles_rad = pin.rpy.matrixToRpy(placement.rotation)
    for key, vector in (("xyz", placement.translation), ("rpy", angles_rad)):
        origin.set(key, " ".join(map(repr, vector.tolist())))


def _require_one_number(joints: Iterable[Element], source: str) -> None:
    """Refuse joints whose position and velocity do not have one number each.

    All of them are named at once.
    """
    joints = list(joints)
    faults = [fault for joint in joints if (fault := _fault_of(joint))]
    if faults:
        raise UnsupportedJointError(
            f"{source}: {'; '.join(faults)}; expected joints that move on their own, "
            f"of type {', '.join(_ONE_NUMBER_KINDS)}, or fixed"
        )
    if len(joints) > MAX_MOVING_JOINTS:
        raise UnsupportedJointError(
            f"{source}: {len(joints)} joints move, expected {MAX_MOVING_JOINTS} at "
            "most: those that the log has",
            KEEP_JOINTS,
        )


def _fault_of(joint: Element) -> str:
    """Return in words why a joint cannot move; empty if it can."""
    name = joint.get("name", "")
    kind = joint.get("type")
    mimic = joint.find("mimic")
    if kind not in _ONE_NUMBER_KINDS:
        return f"joint {name!r} is of type {kind!r}"
    if mimic is not None:
        return f"joint {name!r} mimics {mimic.get('joint')!r}"
    return ""
