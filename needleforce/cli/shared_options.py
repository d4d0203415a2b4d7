"""Options that several commands take, or that what they call takes whole.

Frozen dataclasses from which cyclopts builds the parser; the text of a field in its
class's `Attributes:` is its help.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.application import (
    COLUMNS,
    LIVE_OUTPUT,
    LOG,
    OUTPUT,
    ROBOT,
    SENSOR,
    TARE,
)

Source = Annotated[
    str,
    Parameter(
        name="LOG",
        group=LOG,
        allow_leading_hyphen=True,
        help="Recording: .csv, .csv.gz, .txt, .lvm, .npz, .parquet, or a ROS bag "
        "(.mcap, .db3, .bag); - for standard input.",
    ),
]


_COLUMN = Parameter(metavar="COLUMNS")


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
    """

    joints: Annotated[str | None, Parameter(metavar="NAMES")] = None
    q: Annotated[str | None, _COLUMN] = None
    dq: Annotated[str | None, _COLUMN] = None
    tau: Annotated[str | None, _COLUMN] = None
    tau_ext: Annotated[str | None, _COLUMN] = None


@dataclass(frozen=True, kw_only=True)
class DepthColumns(Columns):
    """Channels of `identify`.

    Attributes:
        depth: Travel of the needle tip along its axis, growing into the tissue (m, cm,
            mm, um, inch).
        speed: Rate of depth (m/s, cm/s, mm/s, um/s, m/min, mm/min, inch/s, inch/min).
        force: Axial force, positive when tissue pushes back (N, mN, cN, kN, gf, kgf,
            lbf, ozf).
    """

    depth: Annotated[str | None, _COLUMN] = None
    speed: Annotated[str | None, _COLUMN] = None
    force: Annotated[str | None, _COLUMN] = None


@dataclass(frozen=True, kw_only=True)
class AllColumns(JointColumns, DepthColumns):
    """Channels of `report`."""


TARE_S = 4.0
"""Motion without contact before the tare of a session, without ``--tare`` [s]."""

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


Direction = tuple[float, float, float]
"""A vector along x, y, z."""


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
            a base that stands upright).
        mount: How the base is mounted, instead of --gravity: wall (its x axis points
            down) or ceiling.
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
    mount: Literal["wall", "ceiling"] | None = None
    payload: Annotated[str | None, Parameter(metavar="FILE|needle|none")] = None

    def __post_init__(self) -> None:
        # In `urdf` the arm is called lwr4plus, where it has nothing on the flange.
        if self.robot == "lwr4plus":
            object.__setattr__(self, "robot", "lwr")


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
    """

    method: Method = "mixture"
    ignore_status: bool = False


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
            UR sends no torques (docs/how-to/your-robot.md).
    """

    seconds: Annotated[float, Parameter(metavar="S")] = float("inf")
    motor_constants: Annotated[
        MotorConstants | None, Parameter(metavar="K1 ... K6")
    ] = None


@Parameter(name="*", group=LOG)
@dataclass(frozen=True, kw_only=True)
class ViewOptions:
    """What is shown beside a recording, and where.

    Attributes:
        anatomy: Plan (plan.json, or its folder) with labels.nii.gz (or .nrrd,
            .seg.nrrd): see docs/how-to/scene.md.
        situs_inversus: Liver and spleen of this patient are exchanged.
        mapping: TOML file that says which columns are which, as `needleforce force
            --print-config` writes.
        tare: Tare after so many seconds of motion without contact (default: 4); if it
            is refused, again after as many.
        export: Write the scene as one page (.html) with the insertion as a film, and
            end.
        port: Port of the page, on this machine alone (default: 8080); another is used
            if it is busy.
    """

    anatomy: Annotated[
        Path | None, Parameter(name=("--anatomy", "--plan"), metavar="DIR|FILE")
    ] = None
    situs_inversus: Annotated[bool, Parameter(negative="")] = False
    mapping: Annotated[str | None, Parameter(metavar="FILE")] = None
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = TARE_S
    export: Annotated[Path | None, Parameter(metavar="FILE", group=LIVE_OUTPUT)] = None
    port: Annotated[int, Parameter(metavar="N", group=LIVE_OUTPUT)] = 8080


@Parameter(name="*", group=LIVE_OUTPUT)
@dataclass(frozen=True, kw_only=True)
class WatchOptions:
    """What an arm is watched with.

    Attributes:
        plan: Plan to match ruptures with (plan.json, or its folder): see
            docs/how-to/scene.md.
        situs_inversus: Liver and spleen of the plan's patient are exchanged.
        reference: ATI Net F/T between flange and tool: its axial force, and the rms
            difference since the tare, are shown next to the estimate.
        reference_axis: Direction of insertion in that sensor's axes (default: 0 0 1).
        view: Serve the scene as a browser page beside the session.
        port: Port of that page (default: 8080); another is used if it is busy.
        tare: Tare after so many seconds of motion without contact (default: 4); if it
            is refused, again after as many.
        tare_stroke: Move the arm and tare from that, before anything else: it draws the
            needle back by so many mm and returns. It asks first.
        yes: Move the arm without asking.
    """

    plan: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None
    situs_inversus: Annotated[bool, Parameter(negative="", group=LOG)] = False
    reference: Annotated[str | None, Parameter(metavar="ADDRESS", group=LOG)] = None
    reference_axis: Annotated[Direction, Parameter(metavar="X Y Z", group=LOG)] = (
        0.0,
        0.0,
        1.0,
    )
    view: Annotated[bool, Parameter(negative="")] = False
    port: Annotated[int, Parameter(metavar="N")] = 8080
    tare: Annotated[float, Parameter(metavar="S", group=TARE)] = TARE_S
    tare_stroke: Annotated[float | None, Parameter(metavar="MM", group=TARE)] = None
    yes: Annotated[bool, Parameter(negative="", group=TARE)] = False


@Parameter(name="*", group=OUTPUT)
@dataclass(frozen=True, kw_only=True)
class SimulationOptions:
    """What is simulated, and where it goes.

    Attributes:
        output: Recording: .csv, .npz, .parquet, or .mcap, a ROS 2 bag.
        truth: Ground truth, which the robot does not know: forces, depth, layers,
            ruptures.
        plant: Plant model: how good arm and sensors are (default: clean); or needle, a
            needle on a linear stage with its force sensor, without an arm.
        seed: Seed of everything that is drawn at random (default: 0).
        overwrite: Replace files that are there.
        list: Print the scenarios and stop.
    """

    output: Annotated[
        Path | None, Parameter(name=("--output", "-o"), metavar="FILE")
    ] = None
    truth: Annotated[Path | None, Parameter(metavar="FILE")] = None
    plant: Literal["ideal", "clean", "fri", "degraded", "needle"] = "clean"
    seed: Annotated[int, Parameter(metavar="N")] = 0
    overwrite: Annotated[bool, Parameter(negative="")] = False
    list: bool = False
