"""Which joints of a URDF move: those of the log; ``--lock-others`` locks the rest."""

from collections.abc import Collection, Mapping
from contextlib import suppress
from pathlib import Path
from typing import NamedTuple

from needleforce.cli.shared_options import RobotOptions
from needleforce.cli.terminal import OTHER_ROBOT, CommandError
from urdf import UnknownNameError
from urdf.joint_choice import joints_towards, movable_joints


class LogJoints(NamedTuple):
    """What a log says about its joints.

    Attributes:
        names: Their names; empty if it names none.
        number: How many there are; None if that is not known.
    """

    names: tuple[str, ...] = ()
    number: int | None = None


def joints_to_keep(
    options: RobotOptions, locked: Mapping[str, float], joints: LogJoints
) -> tuple[str, ...]:
    """Return the joints that ``--lock-others`` leaves.

    They are those that the log names. Of a log that names none they are as many as it
    has on the way to the tool, the nearest to the tool: a torso or a rail comes first.

    Args:
        options: Options of the command, with ``--urdf``.
        locked: Positions of the joints of ``--lock``.
        joints: What the log says about its joints.

    Raises:
        CommandError: The joints of the log are none of the robot's.
    """
    path = Path(str(options.urdf))
    movable = [
        name for name in movable_joints(path, options.without) if name not in locked
    ]
    if joints.names:
        kept = tuple(name for name in movable if name in joints.names)
        if kept:
            return kept
        raise CommandError(
            f"--lock-others: the log has the joints {', '.join(joints.names)}, the "
            f"robot {', '.join(movable)}: none of one name; name the robot's in the "
            "order of the log with joints = [...] in the file of --mapping",
            OTHER_ROBOT,
        )
    if joints.number == len(movable):
        return tuple(movable)
    route = tuple(
        name
        for name in joints_towards(path, options.tool_frame, options.without)
        if name not in locked
    )
    if joints.number is None:
        return route
    if joints.number > len(route):
        raise CommandError(
            f"--lock-others: the log has {joints.number} columns per joint signal and "
            f"names no joints, on the way to the tool move {len(route)}: "
            f"{', '.join(route)}",
            OTHER_ROBOT,
        )
    return route[len(route) - joints.number :]


def assumed_positions(
    options: RobotOptions, chosen: Collection[str]
) -> tuple[str, ...]:
    """Return a warning of joints that carry the tool and are locked at zero unasked.

    Args:
        options: Options of the command, with ``--urdf``.
        chosen: Joints that the log or ``--lock`` names.
    """
    path = Path(str(options.urdf))
    route: tuple[str, ...] = ()
    with suppress(UnknownNameError):  # several last links: none is surely the tool's
        route = joints_towards(path, options.tool_frame, options.without)
    assumed = [name for name in route if name not in chosen]
    if not assumed:
        return ()
    return (
        f"{path}: joints on the way to the tool that the log does not have are locked "
        f"at 0: {', '.join(assumed)}; --lock JOINT=POSITION where one stands elsewhere",
    )
