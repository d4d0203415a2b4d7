"""Which joints of a URDF move: those of the log; ``--lock-others`` locks the rest."""

from collections.abc import Collection, Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from needleforce.cli.shared_options import RobotOptions
from needleforce.cli.terminal import OTHER_ROBOT, CommandError
from urdf import UnknownNameError
from urdf.joint_choice import joints_towards, movable_joints


def joints_to_keep(
    options: RobotOptions, locked: Mapping[str, float], joints: Sequence[str | None]
) -> tuple[str, ...]:
    """Return the joints that ``--lock-others`` leaves.

    They are those that the log names. Of a log that names none they are as many as it
    has on the way to the tool, the nearest to the tool: a torso or a rail comes first.

    Args:
        options: Options of the command, with ``--urdf``.
        locked: Positions of the joints of ``--lock``.
        joints: Joints of the log, None for one without a name; empty if not known.

    Raises:
        CommandError: The joints of the log are none of the robot's.
    """
    path = Path(str(options.urdf))
    movable = [
        name for name in movable_joints(path, options.without) if name not in locked
    ]
    kept = tuple(name for name in movable if name in joints)
    if kept:
        return kept
    if not any(joints):
        if len(joints) == len(movable):
            return tuple(movable)
        towards = joints_towards(path, options.tool_frame, options.without)
        route = tuple(name for name in towards if name not in locked)
        if len(joints) <= len(route):
            return route[-len(joints) :]
    named = ", ".join(map(str, filter(None, joints))) or f"{len(joints)} columns each"
    raise CommandError(
        f"--lock-others: the log has the joints {named}, the robot "
        f"{', '.join(movable)}: they do not fit; name the robot's in the order of the "
        "log with joints = [...] in the file of --mapping",
        OTHER_ROBOT,
    )


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
