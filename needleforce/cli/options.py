"""The application `needleforce`, and the options that several commands take.

Frozen dataclasses from which cyclopts builds the parser; the text of a field in its
class's `Attributes:` is its help.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal

from cyclopts import App, Group, Parameter

LOGS = Group("A log: force, layers, pages", sort_key=1)
ARMS = Group("An arm", sort_key=2)
PATIENT = Group("A patient: from a CT to a registered plan", sort_key=3)
MACHINE = Group("This machine", sort_key=4)

LOG = Group("Input", sort_key=1)
OUTPUT = Group(
    "Output", help="What is written; without any, a summary alone.", sort_key=2
)
LIVE_OUTPUT = Group("Output", sort_key=2)
"""Output of the commands that do not print a summary alone."""
ROBOT = Group("Robot", sort_key=3)
SENSOR = Group("Sensor", sort_key=4)
TARE = Group("Tare", sort_key=5)
LIMITS = Group("Limits of the path", sort_key=3)
COLUMNS = Group(
    "Columns",
    help="COLUMNS is a column name, a pattern such as q{1..7} or q_*, or names "
    "separated by commas; a unit and a factor may follow, as in z:mm or fz:N:-1. What "
    "is not given is found by its usual names.",
    sort_key=6,
)


app = App(
    name="needleforce",
    help="Needle-tip force from a robot's joint torques, and the layers that the "
    "needle passes.\n\nBegin with `needleforce demo` (a simulated insertion), "
    "`needleforce force LOG` (an arm's log) or `needleforce identify LOG` (depth and "
    "force).",
    default_parameter=Parameter(negative=(), show_default=False),
    help_format="markdown",
    version_flags=["--version"],
    group_parameters=LOG,
    group_arguments=LOG,
)
app.register_install_completion_command(
    help="Install completion for bash, zsh or fish."
)

Direction = tuple[float, float, float]
"""A vector along x, y, z."""


def between(low: float, high: float) -> Callable[[Any, float | None], None]:
    """Return a validator of an option's number; no number (nan) is between none."""

    def check(_kind: Any, value: float | None) -> None:
        if value is not None and not low <= value <= high:
            raise ValueError(f"expected {low:g} to {high:g}")

    return check


Seed = Annotated[
    int,
    Parameter(
        metavar="N",
        validator=between(0, 2**63),
        help="Of everything that is drawn at random (default: 0).",
    ),
]

_LOG = Parameter(
    name="LOG",
    group=LOG,
    allow_leading_hyphen=True,
    help="Recording: .csv, .csv.gz, .txt, .lvm, .npz, .parquet, .h5, .mat, .tdms, or a "
    "ROS bag (.mcap, .db3, .bag); a folder with one file for each signal; - for "
    "standard input.",
)

Source = Annotated[str, _LOG]

Sources = Annotated[
    tuple[str, ...], _LOG, Parameter(help=f"{_LOG.help} Several files are one log.")
]
"""A recording, perhaps of several files."""

TareSeconds = Annotated[
    float, Parameter(metavar="S", group=TARE, validator=between(1e-3, 1e6))
]
"""Motion without contact before the tare of a session [s]."""

Port = Annotated[int, Parameter(metavar="N", group=LIVE_OUTPUT)]
"""Port of the scene's page."""

_COLUMN = Parameter(metavar="COLUMNS")


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class PointOptions:
    """What a file of points or a matrix may leave unsaid.

    Attributes:
        unit: Unit of places in a file that does not say it.
        frame: Frame of points of the CT in a file that does not say it.
    """

    unit: Literal["mm", "cm", "m"] | None = None
    frame: Literal["lps", "ras"] | None = None


@Parameter(name="*", group=LIMITS)
@dataclass(frozen=True, kw_only=True)
class PathOptions:
    """What a planned path may be.

    Attributes:
        radius: Radius of the needle in millimetres (default: 0.8, of 18 G with its
            sheath).
        margin: Distance in millimetres that stays free around the needle (default: 5).
        max_length: Longest path in millimetres (default: 120).
        cone: Largest angle in degrees between the path and the skin's normal (default:
            35).
    """

    radius: Annotated[float, Parameter(metavar="MM", validator=between(0.1, 5.0))] = 0.8
    margin: Annotated[float, Parameter(metavar="MM", validator=between(0.0, 100.0))] = (
        5.0
    )
    max_length: Annotated[
        float, Parameter(metavar="MM", validator=between(1.0, 500.0))
    ] = 120.0
    cone: Annotated[float, Parameter(metavar="DEG", validator=between(0.1, 90.0))] = (
        35.0
    )


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class RegistrationOptions:
    """Errors of what registers a patient.

    Attributes:
        landmark_std: Standard deviation of a landmark along each axis in millimetres,
            localisation in the CT included (default: 1.5).
        touch_std: Standard deviation of a touch of the skin, likewise (default: 0.5).
        softness: By up to so many millimetres touches press the skin in (default: 3);
            how far they do is estimated.
        motion: Standard deviation of what organs move against the skin, in millimetres
            (default: 3).
    """

    landmark_std: Annotated[
        float, Parameter(metavar="MM", validator=between(1e-3, 50.0))
    ] = 1.5
    touch_std: Annotated[
        float, Parameter(metavar="MM", validator=between(1e-3, 50.0))
    ] = 0.5
    softness: Annotated[
        float, Parameter(metavar="MM", validator=between(0.0, 50.0))
    ] = 3.0
    motion: Annotated[float, Parameter(metavar="MM", validator=between(0.0, 50.0))] = (
        3.0
    )


@Parameter(name="*", group=COLUMNS)
@dataclass(frozen=True, kw_only=True)
class Columns:
    """Which columns are which channels; a field with a channel's name has its columns.

    Attributes:
        time: Time stamp (s, ms, us, ns, min).
        rate: Sample rate, when there is no time.
        mapping: TOML file that says all this.
        layout: TOML file with names of columns, units and layouts to know beside ours;
            several, by giving it again.
        print_config: Print a mapping of this log, to be edited, and stop.
    """

    time: Annotated[str | None, _COLUMN] = None
    rate: Annotated[float | None, Parameter(metavar="HZ")] = None
    mapping: Annotated[str | None, Parameter(metavar="FILE")] = None
    layout: Annotated[tuple[str, ...], Parameter(metavar="FILE")] = ()
    print_config: bool = False


@dataclass(frozen=True, kw_only=True)
class JointColumns(Columns):
    """Channels of `force`.

    Attributes:
        joints: Names of the robot's joints in the log, in its order, separated by
            commas; or, of two arms, a pattern that those of one fit, such as 'left_*'.
        q: Joint position (rad, deg).
        dq: Joint velocity (rad/s, deg/s, rpm); none to estimate it from the positions.
        tau: Measured joint torque (Nm, mNm, Nmm, Ncm, kNm, in-lbf, ft-lbf).
        tau_ext: External joint torque as the robot estimates it (units as of tau).
        force: Axial force of a sensor to compare with (units as of identify --force).
    """

    joints: Annotated[str | None, Parameter(metavar="NAMES")] = None
    q: Annotated[str | None, _COLUMN] = None
    dq: Annotated[str | None, _COLUMN] = None
    tau: Annotated[str | None, _COLUMN] = None
    tau_ext: Annotated[str | None, _COLUMN] = None
    force: Annotated[str | None, _COLUMN] = None


@dataclass(frozen=True, kw_only=True)
class DepthColumns(Columns):
    """Channels of `identify`.

    Attributes:
        depth: Travel of the needle tip along its axis, growing into the tissue (m, cm,
            mm, um, inch).
        speed: Rate of depth (m/s, cm/s, mm/s, um/s, m/min, mm/min, inch/s, inch/min).
        force: Axial force, positive when tissue pushes back (N, mN, cN, kN, gf, kgf,
            lbf, ozf).
        constant_speed: Speed of the needle with its unit, 2.3mm/s, in place of a depth
            that the log lacks.
    """

    depth: Annotated[str | None, _COLUMN] = None
    speed: Annotated[str | None, _COLUMN] = None
    force: Annotated[str | None, _COLUMN] = None
    constant_speed: Annotated[str | None, Parameter(metavar="SPEED")] = None


@dataclass(frozen=True, kw_only=True)
class AllColumns(JointColumns, DepthColumns):
    """Channels of `report`."""


Over = Literal["time", "depth"]


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class Output:
    """Which files are written.

    Attributes:
        output: Table of the estimates, row by row: .csv, .npz, .parquet, .mcap (a ROS 2
            bag), or - for CSV on standard output.
        figure: Figure: .png, .svg or .pdf.
        over: Draw the figure over time (default), or over the depth of the needle.
    """

    output: Annotated[
        str | None,
        Parameter(name=("--output", "-o"), metavar="FILE", allow_leading_hyphen=True),
    ] = None
    figure: Annotated[
        Path | None, Parameter(name=("--figure", "--png"), metavar="FILE")
    ] = None
    over: Over = "time"


@Parameter(name="*", group=ROBOT)
@dataclass(frozen=True, kw_only=True)
class RobotOptions:
    """The robot on which the log was recorded.

    Attributes:
        robot: A known arm: lwr (KUKA LWR 4+, default), panda, ur3, ur5, ur5e, ur10,
            ur10e, xarm7.
        urdf: URDF of any other robot.
        tool_frame: Link that carries the payload and whose z axis is the insertion
            direction (default: that of the known arm; of a URDF the last link, if there
            is one only).
        tip_offset: Where the tool is mounted in that frame [m], without editing the
            URDF.
        without: Links to leave out with all that they carry, such as panda_hand where
            the hand is off.
        lock: With --urdf: joints that are not in the log, held at a position in rad or
            m (default: 0).
        lock_others: With --urdf: lock every joint that the log does not have; where it
            names none, all but as many as it has, on the way to the tool.
        accept_inertia: With --urdf: go on although moving links have no inertia, or one
            that no rigid body has, with a warning in every result.
        gravity: Gravity in the axes of the robot's base [m/s^2] (default: 0 0 -9.80665,
            a base that stands upright; 0 0 9.81 for one on the ceiling, 9.81 0 0 for
            one on a wall, its x axis down).
        payload: What is on the flange: a TOML file; the published 304 g force sensor
            and needle (default of the LWR); or nothing (default of other robots). It
            overrides the mapping.
    """

    robot: Annotated[str | None, Parameter(metavar="NAME")] = None
    urdf: Annotated[str | None, Parameter(metavar="FILE")] = None
    tool_frame: Annotated[str | None, Parameter(metavar="NAME")] = None
    tip_offset: Annotated[Direction | None, Parameter(metavar="X Y Z")] = None
    without: Annotated[
        tuple[str, ...], Parameter(metavar="LINK", consume_multiple=True)
    ] = ()
    lock: Annotated[
        tuple[str, ...], Parameter(metavar="JOINT[=POSITION]", consume_multiple=True)
    ] = ()
    lock_others: Annotated[bool, Parameter(negative="")] = False
    accept_inertia: Annotated[bool, Parameter(negative="")] = False
    gravity: Annotated[Direction | None, Parameter(metavar="X Y Z")] = None
    payload: Annotated[str | None, Parameter(metavar="FILE|needle|none")] = None

    @property
    def is_named(self) -> bool:
        """Whether the options name a robot."""
        return self.robot is not None or self.urdf is not None

    @property
    def known_robot(self) -> str:
        """The known arm that is meant without ``--urdf``, by its name in `urdf`."""
        return "lwr4plus" if self.robot in (None, "lwr") else self.robot

    @property
    def is_lwr(self) -> bool:
        """Whether the robot is the known LWR 4+, as without a name."""
        return self.urdf is None and self.known_robot == "lwr4plus"


@Parameter(name="*", group=SENSOR)
@dataclass(frozen=True, kw_only=True)
class SensorOptions:
    """How joint signals become a force.

    Attributes:
        gain: Observer gain K in 1/s (lag 1/K; default: 70).
        alignment: Torques are commands held until the next sample (hold), or a sensor's
            samples (trapezoid, default).
        mode: Contact: force along the needle (axial), 3-D force at the tip (point,
            default), 6-D wrench (full).
        insertion_axis: Insertion direction in the tool frame (default: its z axis, 0 0
            1).
        published: Use the settings of the published method.
        config: TOML file of further settings.
        friction: TOML file of joint friction and rotor inertia.
        gravity_compensated: Gravity is already subtracted from the measured torque, as
            some drivers do.
        external_torque: Read the external torque that the robot estimates itself
            (tau_ext) instead of tau.
        tare: Motion without contact, in seconds of the log's clock, or (+0:+4) from its
            first stamp.
        no_tare: Do not tare: the forces keep the errors of model and torque sensors.
        force_tare: Tare even where contact is seen.
    """

    gain: Annotated[float | None, Parameter(metavar="K")] = None
    alignment: Literal["hold", "trapezoid"] | None = None
    mode: Literal["axial", "point", "full"] | None = None
    insertion_axis: Annotated[Direction | None, Parameter(metavar="X Y Z")] = None
    published: bool = False
    config: Annotated[str | None, Parameter(metavar="FILE")] = None
    friction: Annotated[str | None, Parameter(metavar="FILE")] = None
    gravity_compensated: bool = False
    external_torque: bool = False
    tare: Annotated[
        str | None,
        Parameter(metavar="START:END", allow_leading_hyphen=True, group=TARE),
    ] = None
    no_tare: Annotated[bool, Parameter(group=TARE)] = False
    force_tare: Annotated[bool, Parameter(group=TARE)] = False

    @property
    def torque_channel(self) -> str:
        """The channel of the torques that the sensor takes."""
        return "tau_ext" if self.external_torque else "tau"


Method = Literal["mixture", "published", "published-kv"]


@Parameter(name="*", group=SENSOR)
@dataclass(frozen=True, kw_only=True)
class IdentificationOptions:
    """How forces become layers.

    Attributes:
        method: Ours (mixture, default), or as published with the multi-layer or
            Kelvin-Voigt model.
        ignore_status: Also use rows that `needleforce force` has marked as not tared,
            initializing or doubtful.
        between: Seconds of the log that are read, as of --tare: one insertion of
            several.
    """

    method: Method = "mixture"
    ignore_status: bool = False
    between: Annotated[
        str | None, Parameter(metavar="START:END", allow_leading_hyphen=True)
    ] = None


_CONNECTED_ARMS = (
    "fri or iiwa, with [:LOCAL_ADDRESS][:PORT][@CONTROLLER] (KUKA LWR 4+, LBR iiwa: "
    "the controller sends to this address of this machine; by default only programs "
    "of this machine are heard), fr3:ADDRESS, franka:ADDRESS (FER), ur:ADDRESS"
)

_MODELS_OF_ARMS = (
    "An fr3 describes itself, a franka is taken for a panda and a ur for a ur10e "
    "unless --robot or --urdf names another"
)

ArmName = Annotated[
    str,
    Parameter(
        name="ARM",
        group=LOG,
        help=f"{_CONNECTED_ARMS}, ros2:TOPIC (joint states), or sim:SCENARIO for a "
        f"simulated LWR 4+. {_MODELS_OF_ARMS}; iiwa and ros2 need one.",
    ),
]
"""An arm that is listened to."""

MovedArmName = Annotated[
    str,
    Parameter(
        name="ARM",
        group=LOG,
        help=f"{_CONNECTED_ARMS}, ros2:TOPIC (moved by ros2_control), or sim for a "
        f"simulated LWR 4+ in free air. {_MODELS_OF_ARMS}; iiwa and ros2 need one.",
    ),
]
"""An arm that is moved."""


MotorConstants = tuple[float, float, float, float, float, float]
"""Joint torque per motor current of the six joints of a UR [Nm/A]."""


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class ArmOptions:
    """How long an arm is listened to.

    Attributes:
        seconds: Stop after this time [s]; else at Ctrl-C or when the arm stops sending.
        motor_constants: For ur: joint torque per motor current of each joint [Nm/A]; a
            UR sends no torques (docs/how-to/arm-ur.md).
    """

    seconds: Annotated[
        float, Parameter(metavar="S", validator=between(1e-3, math.inf))
    ] = math.inf
    motor_constants: Annotated[
        MotorConstants | None, Parameter(metavar="K1 ... K6")
    ] = None
