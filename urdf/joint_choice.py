"""Which joints of a description move: those of the log; all others are locked."""

from collections.abc import Iterable, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import pinocchio as pin

from urdf.description import build_model, parent_of, read_attribute, read_description
from urdf.errors import (
    KEEP_JOINTS,
    InputError,
    UnknownNameError,
    UnsupportedJointError,
)

MAX_MOVING_JOINTS = 200
"""Most joints that may move: the workspace that Pinocchio allocates grows with their
third power, to 256 MB here."""


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
    model = build_model(root, str(path))
    frame = frame or last_link(root, model, str(path))
    if not model.existFrame(frame):
        raise UnknownNameError(
            f"{path}: no frame {frame!r}; frames: "
            f"{', '.join(one.name for one in model.frames)}"
        )
    joints = {joint.get("name", ""): joint for joint in root.findall("joint")}
    parent = model.frames[[one.name for one in model.frames].index(frame)].parentJoint
    route = [model.names[k] for k in list(model.supports[parent])[1:]]
    return tuple(name for name in route if _is_movable(joints[name]))


def lock_joints(
    root: Element,
    model: pin.Model,
    source: str,
    *,
    locked: Mapping[str, float],
    kept: Iterable[str] | None,
) -> pin.Model:
    """Return a model with joints locked: those asked for, and all that are not kept.

    A joint that mimics a locked one is locked with it.

    Args:
        root: The description.
        model: Its model, all of whose joints move.
        source: Name of the file, for messages.
        locked: Positions by joint [rad, m].
        kept: Joints that move; None for all that are not locked.

    Raises:
        UnknownNameError: There is no such joint.
        InputError: A joint is locked and kept.
        UnsupportedJointError: Joints that are left do not have one number each, or are
            too many.
    """
    moving = {
        joint.get("name", ""): joint
        for joint in root.findall("joint")
        if joint.get("type") != "fixed"
    }
    kept = None if kept is None else set(kept)
    chosen = locked.keys() | (kept or set())
    both = locked.keys() & (kept or set())
    if unknown := chosen - moving.keys():
        raise UnknownNameError(
            f"{source}: cannot lock or keep {', '.join(map(repr, sorted(unknown)))}, "
            f"there is no such joint that moves; joints: {', '.join(moving)}"
        )
    if both:
        raise InputError(f"joints {sorted(both)} are to be locked and to be kept")
    welded = locked.keys() if kept is None else moving.keys() - kept
    positions = {name: locked.get(name, 0.0) for name in welded}
    followers = {name: moving[name] for name in moving.keys() - chosen}
    positions |= _follow(followers, positions)
    left = moving.keys() - positions.keys()
    if odd := sorted(name for name in left if not _is_movable(moving[name])):
        raise UnsupportedJointError(
            f"{source}: joints {', '.join(odd)} move in more than one number, or mimic "
            "another; expected joints that turn or slide on their own, or fixed"
        )
    if len(left) > MAX_MOVING_JOINTS:
        raise UnsupportedJointError(
            f"{source}: {len(left)} joints move, expected {MAX_MOVING_JOINTS} at "
            "most: those that the log has",
            KEEP_JOINTS,
        )
    return _reduce(model, positions)


def _reduce(model: pin.Model, positions: Mapping[str, float]) -> pin.Model:
    """Return a model whose joints with a position stand there."""
    indices = [model.getJointId(name) for name in positions]
    locked_at = pin.neutral(model)
    for index, position in zip(indices, positions.values(), strict=True):
        locked_at[model.joints[index].idx_q] = position
    # Pinocchio finds no frame here whose name a joint and a link share. Both are the
    # same frame; the link keeps the name.
    links = {frame.name for frame in model.frames if frame.type == pin.FrameType.BODY}
    for frame in model.frames:
        if frame.type != pin.FrameType.BODY and frame.name in links:
            frame.name += " (joint)"
    return pin.buildReducedModel(model, indices, locked_at)


def _follow(
    followers: Mapping[str, Element], positions: Mapping[str, float]
) -> dict[str, float]:
    """Return the positions of those joints that mimic one with a position."""
    followed: dict[str, float] = {}
    for name, joint in followers.items():
        leader = read_attribute(joint, "mimic", "joint")
        if leader in positions:
            # Numbers, or the reader of the URDF would have refused the file.
            factor = float(read_attribute(joint, "mimic", "multiplier") or "1")
            offset = float(read_attribute(joint, "mimic", "offset") or "0")
            followed[name] = factor * positions[leader] + offset
    return followed


def last_link(root: Element, model: pin.Model, source: str) -> str:
    """Return the only link that joints of a model move and that carries no other.

    Of several, the message lists those that about as many joints move as any: not the
    sensors of a base.
    """
    parents = {parent_of(joint) for joint in root.findall("joint")}
    counts = {
        frame.name: len(model.supports[frame.parentJoint]) - 1
        for frame in model.frames
        if frame.type == pin.FrameType.BODY and frame.name not in parents
    }
    moved = [link for link, count in counts.items() if count]
    if len(moved) == 1:
        return moved[0]
    limit = max(counts.values(), default=0) / 2.0
    likely = sorted(link for link in moved if counts[link] >= limit)
    raise UnknownNameError(
        f"{source}: there is no single last link that could carry the tool; it ends "
        f"in: {', '.join(likely) or 'none'}",
        "Give `tool_frame`, the frame at the needle's tip.",
    )


def _is_movable(joint: Element) -> bool:
    is_simple = joint.get("type") in ("revolute", "continuous", "prismatic")
    return is_simple and joint.find("mimic") is None
