"""The robot and its sensor from options and TOML files.

Arm, payload, friction and settings.
"""

from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import contextmanager, nullcontext, suppress
from dataclasses import fields, is_dataclass, replace
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any, TypeVar

import msgspec
import numpy as np
import pinocchio as pin

import residual
import urdf
from needleforce.cli.options import RobotOptions, SensorOptions
from needleforce.cli.terminal import OTHER_ROBOT, CommandError, warn
from needleforce.recordings.channels import read_toml
from needleforce.recordings.table import LinkTransforms, TableLabels
from urdf import NeedleTool, Payload, Robot
from urdf.errors import finite_array
from urdf.joint_choice import joints_towards, movable_joints
from urdf.robot import STANDARD_GRAVITY_M_S2

T = TypeVar("T")

NOTHING = "none"
"""How a file says None, for which TOML has no word."""

NEEDLE = "needle"
"""Name of the payload that a known LWR has without options."""


def robot_from_options(
    options: RobotOptions,
    mapping: str | None,
    joints: Sequence[str | None] = (),
) -> Robot:
    """Return the robot that the options describe; what is odd in it is said on stderr.

    Args:
        options: Options of the command.
        mapping: File of the mapping, which may name the payload.
        joints: Joints of the log for ``--lock-others``, None for one without a name;
            empty if nothing is known.

    Raises:
        CommandError: Options contradict each other, or the robot cannot be loaded.
    """
    _check_robot_options(options)
    load: dict[str, Any] = {
        "payload": payload_from_options(options, mapping),
        "gravity_m_s2": np.array(options.gravity or STANDARD_GRAVITY_M_S2),
        "tool_frame": options.tool_frame,
        "tool_placement": options.tip_offset,
        "without": options.without,
    }
    if options.urdf is None:
        robot = urdf.load_example(options.known_robot, **load)
        warn(robot.warnings)
        return robot
    locked_joints = dict(map(_parse_lock, options.lock))
    kept_joints = None
    assumed: tuple[str, ...] = ()
    if options.lock_others:
        kept_joints, assumed = _keep_joints(options, locked_joints, joints)
    robot = urdf.load_urdf(
        options.urdf,
        locked_joints=locked_joints,
        keep_joints=kept_joints,
        check_inertias=not options.accept_inertia,
        **load,
    )
    robot = replace(robot, warnings=robot.warnings + assumed)
    warn(robot.warnings)
    return robot


def _keep_joints(
    options: RobotOptions, locked: Mapping[str, float], joints: Sequence[str | None]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Return the joints that ``--lock-others`` leaves, and a warning of assumed ones.

    Those that the log names stay. Of a log that names none as many stay as it has on
    the way to the tool, the nearest to the tool: a torso or a rail comes first. Other
    joints on that way are assumed to be at zero.

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
    way: tuple[str, ...] = ()
    # Only names tell the joints where there is no single last link.
    with suppress(urdf.UnknownNameError) if kept else nullcontext():
        way = joints_towards(path, options.tool_frame, options.without)
    if not any(joints):
        is_whole = len(joints) == len(movable)
        free = movable if is_whole else [name for name in way if name not in locked]
        # Without a log the whole way stays.
        kept = tuple(free[-len(joints) :]) if len(joints) <= len(free) else ()
    if not kept:
        named = ", ".join(filter(None, joints)) or f"{len(joints)} columns each"
        raise CommandError(
            f"--lock-others: the log has the joints {named}, the robot "
            f"{', '.join(movable)}: they do not fit; name the robot's in the order of "
            "the log with joints = [...] in the file of --mapping",
            OTHER_ROBOT,
        )
    assumed = ", ".join(name for name in way if name not in {*kept, *locked})
    if not assumed:
        return kept, ()
    return kept, (
        f"{path}: joints on the way to the tool that the log does not have are locked "
        f"at 0: {assumed}; --lock JOINT=POSITION where one stands elsewhere",
    )


@contextmanager
def file_of_description(text: str, name: str) -> Iterator[str]:
    """Keep a description that no file has in one, for the options of a robot.

    Args:
        text: URDF.
        name: Name of the file, by which errors call it.
    """
    with TemporaryDirectory() as folder:
        path = Path(folder, name)
        path.write_text(text, encoding="utf-8")
        yield str(path)


def robot_from_topic(
    options: RobotOptions, wait_for_description: Callable[[], str]
) -> Robot:
    """Return the robot of the options; if they name none, that of a description.

    Args:
        options: Options of the command.
        wait_for_description: Returns the URDF, as the topic ``robot_description`` has
            it.
    """
    if options.is_named:
        return robot_from_options(options, None)
    with file_of_description(wait_for_description(), "robot_description") as path:
        return robot_from_options(replace(options, urdf=path), None)


def _check_robot_options(options: RobotOptions) -> None:
    """Refuse options of the robot that contradict each other, or are in other units."""
    if options.urdf is not None and options.robot is not None:
        raise CommandError("--robot and --urdf name two robots, expected one of them")
    is_for_urdf = options.lock or options.lock_others or options.accept_inertia
    if is_for_urdf and options.urdf is None:
        raise CommandError(
            "--lock, --lock-others and --accept-inertia are for a robot of --urdf "
            "FILE; known robots have no joints to lock and all their inertia"
        )
    is_for_tool = options.tool_frame or options.tip_offset or options.without
    if is_for_tool and options.is_lwr:
        raise CommandError(
            "--tool-frame, --tip-offset and --without describe a robot of --robot "
            "NAME or --urdf FILE; the LWR 4+ takes a [needle] in --payload FILE"
        )
    # Weaker and stronger than anywhere on Earth: a unit vector, or another unit
    if options.gravity and not 9.7 <= np.linalg.norm(options.gravity) <= 9.9:
        raise CommandError(
            f"--gravity {' '.join(f'{value:g}' for value in options.gravity)}: "
            "expected about 9.81 m/s^2, as in 0 0 9.81 for a robot that hangs from the "
            "ceiling"
        )


def _parse_lock(text: str) -> tuple[str, float]:
    """Return name and position [rad, m] of a joint that ``--lock`` holds."""
    name, equals, position = text.partition("=")
    try:
        return name, float(position) if equals else 0.0
    except ValueError as error:
        raise CommandError(
            f"--lock {text}: expected JOINT or JOINT=POSITION"
        ) from error


def urdf_with_shapes(options: RobotOptions) -> Path:
    """Return the file whose shapes the scene shows."""
    if options.urdf is not None:
        return Path(options.urdf)
    return urdf.example_robot_path(options.known_robot)


def payload_from_options(
    options: RobotOptions, mapping: str | None
) -> Payload | NeedleTool | None:
    """Return the payload of the option, else of the mapping, else the usual one.

    A table holds either ``mass_kg``, ``com_m`` and ``inertia_kg_m2`` (about the centre
    of mass; a point mass without it) in flange axes, or a table ``[needle]`` with
    fields of `urdf.NeedleTool`.

    Args:
        options: Options of the command.
        mapping: File of the mapping, if any.

    Raises:
        CommandError: The table or file describes no payload.
    """
    value: Any = options.payload
    folder = Path()
    where = "--payload"
    if value is None and mapping is not None:
        value = read_toml(mapping, "mapping").get("payload")
        folder = Path(mapping).parent
        where = f"{mapping}: [payload]"
    if value is None:
        value = NEEDLE if options.is_lwr else NOTHING
    if value == NOTHING:
        return None
    if value == NEEDLE:
        return NeedleTool()
    if isinstance(value, str):
        where = str(folder / value)
        value = read_toml(where, "payload file")
    if isinstance(value, dict) and value.keys() == {"needle"}:
        return convert_table(NeedleTool, value["needle"], f"{where}: [needle]")
    if isinstance(value, dict):
        value = {"inertia_kg_m2": [[0.0] * 3] * 3} | value
    return convert_table(Payload, value, where)


def payload_lines(payload: Payload | NeedleTool | None) -> list[str]:
    """Return a payload as lines of a mapping."""
    if payload is None:
        return ['payload = "none"  # or "needle", a file, or a table [payload]']
    title = "[payload]  # in flange axes; inertia about the centre of mass"
    if isinstance(payload, NeedleTool):
        page = "docs/how-to/tool-and-payload.md"
        title = f"[payload.needle]  # force sensor and needle; see {page}"
    values = {item.name: getattr(payload, item.name) for item in fields(payload)}
    return [
        title,
        *(f"{name} = {np.asarray(v).tolist()!r}" for name, v in values.items()),
    ]


def with_friction(
    robot: Robot, path: str | None
) -> tuple[Robot, residual.FrictionModel | None]:
    """Return the robot with rotors and friction of the file of ``--friction``.

    It holds one table, ``[viscous_coulomb]`` with the fields of
    `residual.JointFriction` or ``[sigmoid]`` with those of `residual.SigmoidFriction`,
    and may hold ``rotor_inertia_kg_m2``.

    Args:
        robot: The robot without them.
        path: The file, if any.

    Raises:
        CommandError: The file has other tables, or a key that is unknown.
    """
    if path is None:
        return robot, None
    models = {
        "viscous_coulomb": residual.JointFriction,
        "sigmoid": residual.SigmoidFriction,
    }
    tables = read_toml(path, "friction file")
    rotor_inertia = tables.pop("rotor_inertia_kg_m2", None)
    if len(tables) > 1 or not tables.keys() <= models.keys():
        raise CommandError(
            f"{path} has {', '.join(tables)}; expected one table of "
            f"{' or '.join(models)}, and rotor_inertia_kg_m2 if it counts"
        )
    if rotor_inertia is not None:
        where = f"{path}: rotor_inertia_kg_m2, one number per joint,"
        robot = robot.with_armature(finite_array(rotor_inertia, (robot.nv,), where))
    if not tables:
        return robot, None
    ((name, table),) = tables.items()
    friction = convert_table(models[name], table, f"{path}: [{name}]")
    for item in fields(friction):
        values = getattr(friction, item.name)
        if isinstance(values, np.ndarray):
            where = f"{path}: [{name}]: {item.name}, one number per joint,"
            finite_array(values, (robot.nv,), where)
    return robot, friction


def sensor_config(
    options: SensorOptions, friction: residual.FrictionModel | None
) -> residual.SensorConfig:
    """Return the preset with the file's settings, then the options', in their place.

    Args:
        options: Options of the command.
        friction: Friction of the joints; None for that of the preset.

    Raises:
        CommandError: The file of ``--config`` has friction, or an unknown key.
    """
    config = residual.PUBLISHED if options.published else residual.DEFAULT
    if options.config is not None:
        table = read_toml(options.config, "config file")
        if "friction" in table:
            raise CommandError(
                f"{options.config}: unknown key 'friction'; joint friction stands in "
                "the file of --friction",
            )
        config = convert_table(residual.SensorConfig, table, options.config, config)
    settings = {
        "gain_per_s": options.gain,
        "friction": friction,
        "alignment": options.alignment,
        "mode": options.mode,
        "insertion_axis": options.insertion_axis,
        "torque_is_gravity_compensated": options.gravity_compensated or None,
    }
    chosen = {name: value for name, value in settings.items() if value is not None}
    return replace(config, **chosen)


def convert_table(kind: type[T], table: Any, where: str, preset: Any = None) -> T:
    """Return a dataclass with the values of a table.

    Args:
        kind: A dataclass of numbers, text, choices, arrays and further dataclasses.
        table: What TOML gives.
        where: File and table, as messages name them.
        preset: Instance with the values that the table does not give.

    Raises:
        CommandError: A key is unknown or missing, or its value does not fit.
    """
    if not isinstance(table, dict):
        raise CommandError(f"{where} is {type(table).__name__}, expected a table")
    declared: Any = kind
    known = [item.name for item in fields(declared) if item.init]
    if unknown := sorted(table.keys() - set(known)):
        raise CommandError(
            f"{where}: unknown key {unknown[0]!r}; known are: {', '.join(known)}"
        )
    values = {name: getattr(preset, name) for name in known if preset is not None}
    for name, value in table.items():
        nested = values.get(name)
        values[name] = None if value == NOTHING else value
        if is_dataclass(nested) and isinstance(value, dict):
            here = f"{where}: {name}"
            values[name] = convert_table(type(nested), value, here, nested)
    try:
        return msgspec.convert(
            values, kind, dec_hook=lambda _kind, numbers: np.array(numbers, np.float64)
        )
    except (msgspec.ValidationError, OverflowError) as error:
        raise CommandError(f"{where}: {error}") from error


def link_poses(robot: Robot, q_rad: np.ndarray) -> LinkTransforms:
    """Return where the links and the tool frame of an arm are, in its root link's axes.

    Args:
        robot: The arm.
        q_rad: Joint positions [rad or m], shape (n,).
    """
    model = robot.model
    data = model.createData()
    pin.framesForwardKinematics(model, data, q_rad)
    # Frame 0 is Pinocchio's own "universe"; the first of the URDF is its root link.
    root = robot.frame_names[1]
    poses = {
        frame.name: data.oMf[index]
        for index, frame in enumerate(model.frames)
        if (frame.type == pin.BODY or index == robot.tool_frame_id)
        and frame.name not in (root, "universe")
    }
    rows = np.array([pin.SE3ToXYZQUAT(pose) for pose in poses.values()])
    return LinkTransforms(
        parent=root,
        children=tuple(poses),
        translation_m=rows[:, :3],
        rotation_xyzw=rows[:, 3:],
    )


def labels_of_arm(options: RobotOptions, robot: Robot) -> TableLabels:
    """Return what lets a bag show an arm.

    Args:
        options: Options that describe the robot.
        robot: The arm.
    """
    return TableLabels(
        joint_names=robot.joint_names,
        robot_description=urdf_with_shapes(options).read_text("utf-8", "replace"),
        link_poses=partial(link_poses, robot),
    )
