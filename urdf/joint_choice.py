"""Which joints of a description move: those of the log; all others are welded.

A joint that is welded becomes a fixed one at a position, before there is a model. So
its kind does not matter, nor a name that a link has too, nor how many there are.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement

import numpy as np
import pinocchio as pin

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
    joints = read_description(path, without).findall("joint")
    return tuple(joint.get("name", "") for joint in joints if _is_movable(joint))


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
    links = {name: name for link in root.findall("link") if (name := link.get("name"))}
    children = {joint.get("name", ""): link_of(joint, "child") for joint in joints}
    link = (children | links).get(frame)
    if link is None:
        raise UnknownNameError(f"{path}: no frame {frame!r}; links: {', '.join(links)}")
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
    chosen = {*locked, *(kept or ())}
    # A fixed joint may be locked where it is.
    unknown = chosen - moving.keys()
    unknown -= {name for name in joints if locked.get(name) == 0.0}
    if unknown:
        wish = "lock" if unknown & locked.keys() else "keep"
        raise UnknownNameError(
            f"{source}: cannot {wish} {', '.join(map(repr, sorted(unknown)))}, there "
            f"is no such joint that moves; joints: {', '.join(moving)}"
        )
    if kept is not None and (both := set(kept) & locked.keys()):
        raise InputError(f"joints {sorted(both)} are to be locked and to be kept")
    positions = {name: locked[name] for name in moving.keys() & locked.keys()}
    if kept is not None:
        positions = dict.fromkeys(moving.keys() - set(kept), 0.0) | positions
    followers = {name: joint for name, joint in moving.items() if name not in chosen}
    _lead_followers(followers, positions, source)
    for name, position in positions.items():
        _weld(moving.pop(name), position, source)
    odd = [
        f"joint {name!r} is of type {joint.get('type')!r}"
        for name, joint in moving.items()
        if not _is_movable(joint)
    ]
    if odd:
        raise UnsupportedJointError(
            f"{source}: {'; '.join(odd)}, or mimics another; expected joints of type "
            f"{', '.join(_ONE_NUMBER_KINDS)} that move on their own, or fixed"
        )
    if len(moving) > MAX_MOVING_JOINTS:
        raise UnsupportedJointError(
            f"{source}: {len(moving)} joints move, expected {MAX_MOVING_JOINTS} at "
            "most: those that the log has",
            KEEP_JOINTS,
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
        link = link_of(joint, "parent")
    return tuple(reversed(route))


def last_link(root: Element, source: str) -> str:
    """Return the only link that joints move and that carries no other.

    Of several, the message lists those that about as many joints move as any: not the
    sensors of a base.
    """
    joints = root.findall("joint")
    parents = {link_of(joint, "parent") for joint in joints}
    ends = {link.get("name", "") for link in root.findall("link")} - parents
    counts = {link: len(_route_to(joints, link)) for link in sorted(ends)}
    moved = [link for link, count in counts.items() if count]
    if len(moved) == 1:
        return moved[0]
    limit = max(counts.values(), default=0) / 2.0
    likely = [link for link in moved if counts[link] >= limit]
    raise UnknownNameError(
        f"{source}: there is no single last link that could carry the tool; it ends "
        f"in: {', '.join(likely) or 'none'}",
        "Give `tool_frame`, the frame at the needle's tip.",
    )


def _lead_followers(
    followers: Mapping[str, Element], positions: dict[str, float], source: str
) -> None:
    """Add the positions of joints that mimic one of those with a position."""
    for _ in followers:  # a follower may be followed
        for name, joint in followers.items():
            mimic = joint.find("mimic")
            leader = "" if mimic is None else mimic.get("joint", "")
            if mimic is None or leader not in positions:
                continue
            owner = f"{source}: joint {name!r}"
            factors = {"multiplier": 1.0, "offset": 0.0}
            for key in factors.keys() & mimic.attrib.keys():
                factors[key] = read_numbers(joint, "mimic", key, owner)[0]
            led = factors["multiplier"] * positions[leader]
            positions[name] = led + factors["offset"]


def _weld(joint: Element, position: float, source: str) -> None:
    """Make a joint fixed at a position [rad, m]."""
    kind = joint.get("type")
    joint.set("type", "fixed")
    if position == 0.0:
        return
    owner = f"{source}: joint {joint.get('name')!r}"
    axis = np.array([1.0, 0.0, 0.0])
    if kind in _ONE_NUMBER_KINDS and joint.find("axis") is not None:
        axis = np.array(read_numbers(joint, "axis", "xyz", owner, count=3))
        axis /= np.linalg.norm(axis) or 1.0
    motion = pin.SE3(np.eye(3), position * axis)
    if kind in ("revolute", "continuous"):
        motion = pin.SE3(pin.exp3(position * axis), np.zeros(3))
    origin = joint.find("origin")
    if origin is None:
        origin = SubElement(joint, "origin")
    for key in {"xyz", "rpy"} - origin.attrib.keys():
        origin.set(key, "0 0 0")
    translation_m, angles_rad = (
        read_numbers(joint, "origin", key, owner, count=3) for key in ("xyz", "rpy")
    )
    placement = pin.SE3(pin.rpy.rpyToMatrix(*angles_rad), np.array(translation_m))
    placement = placement * motion
    angles_rad = pin.rpy.matrixToRpy(placement.rotation)
    for key, vector in (("xyz", placement.translation), ("rpy", angles_rad)):
        origin.set(key, " ".join(map(repr, vector.tolist())))
