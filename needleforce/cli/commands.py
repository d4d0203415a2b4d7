"""The commands: what each says in its help, and what runs it."""

from functools import partial
from pathlib import Path
from typing import Annotated, Literal

from cyclopts import Parameter

from needleforce.cli.options import (
    ARMS,
    LIMITS,
    LIVE_OUTPUT,
    LOG,
    LOGS,
    MACHINE,
    OUTPUT,
    PATIENT,
    TARE,
    AllColumns,
    ArmName,
    ArmOptions,
    DepthColumns,
    Direction,
    IdentificationOptions,
    JointColumns,
    MovedArmName,
    Output,
    PathOptions,
    PointOptions,
    Port,
    RegistrationOptions,
    RobotOptions,
    Seed,
    SensorOptions,
    Source,
    Sources,
    TareSeconds,
    app,
    between,
)
from needleforce.cli.terminal import (
    CommandError,
    aligned,
    json_text,
    limit_library_threads,
    require_modules,
    say,
    write_out,
)


@app.command(name="force", group=LOGS)
def force_command(
    log: Sources,
    /,
    *,
    output: Output = Output(),
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    columns: JointColumns = JointColumns(),
) -> int:
    """Estimate the force on a needle from a robot's recorded joint signals.

    Read a log with time, q, tau and perhaps dq. The estimates are valid once the sensor
    has been tared on motion without contact. Without --tare and --no-tare, that is the
    first 2 s after the filters have settled; if contact is seen there, the command
    stops and says so.

    needleforce force insertion.csv --tare 0:4 -o forces.csv --figure forces.png
    """
    from needleforce.cli.logs.replay import force

    return force(log, output, robot, sensor, columns)


@app.command(name="check", group=LOGS)
def check_command(
    log: Sources,
    /,
    *,
    json: Annotated[bool, Parameter(group=OUTPUT, help="Print JSON.")] = False,
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    columns: JointColumns = JointColumns(),
) -> int:
    """Print what `force` says of a log and of its motion without contact.

    Robot, channels, samples, gaps, warnings, and from the tare the torques' scale and
    the missing mass. The exit code is 0 if nothing is doubtful, else 1.

    needleforce check insertion.csv --robot ur5e --tare +0:+4
    """
    from needleforce.cli.logs.replay import check

    return check(log, robot, sensor, columns, as_json=json)


@app.command(name="identify", group=LOGS)
def identify_command(
    log: Sources,
    /,
    *,
    output: Output = Output(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: DepthColumns = DepthColumns(),
) -> int:
    """Identify ruptures, layers, stiffness and friction from depth and axial force.

    Read a log with time, depth, force and perhaps speed. Depth grows into the tissue;
    force is positive when tissue pushes back. Times are on the log's clock. A ? marks
    values that the data do not identify.

    needleforce identify forces.csv -o layers.csv --figure layers.png
    """
    from needleforce.cli.logs.replay import identify

    return identify(log, output, options, columns)


@app.command(name="report", group=LOGS)
def report_command(
    log: Source,
    folder: Annotated[
        Path, Parameter(name="DIR", group=LOG, help="Created if missing.")
    ],
    /,
    *,
    robot: RobotOptions = RobotOptions(),
    sensor: SensorOptions = SensorOptions(),
    options: IdentificationOptions = IdentificationOptions(),
    columns: AllColumns = AllColumns(),
    plan: Annotated[
        Path | None,
        Parameter(
            metavar="FILE",
            group=LOG,
            help="Plan to compare with what was found (plan.json, or its folder); the "
            "log needs joint positions.",
        ),
    ] = None,
) -> int:
    """Write a page with charts, results, warnings and settings of a log into a folder.

    From a log with joint positions and torques: the forces, as by `needleforce force`,
    and the layers found in them, as by `needleforce identify`. From a log with depth
    and force: the layers. DIR/index.html needs no other file.

    needleforce report insertion.csv report
    """
    from needleforce.cli.logs.replay import report

    return report((log,), folder, robot, sensor, columns, options, plan)


@app.command(name="view", group=LOGS)
def view_command(
    recording: Annotated[Path, Parameter(name="RECORDING", group=LOG)],
    /,
    *,
    anatomy: Annotated[
        Path | None,
        Parameter(name=("--anatomy", "--plan"), metavar="DIR|FILE", group=LOG),
    ] = None,
    mapping: Annotated[str | None, Parameter(metavar="FILE", group=LOG)] = None,
    tare: TareSeconds = 4.0,
    export: Annotated[Path | None, Parameter(metavar="FILE", group=LIVE_OUTPUT)] = None,
    port: Port = 8080,
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Show a recording of joint signals in a 3-D scene in the browser, until Ctrl-C.

    needleforce view insertion.csv --tare 13

    Args:
        recording: A file of joint signals.
        anatomy: Plan (plan.json, or its folder) with labels.nii.gz (or .nrrd,
            .seg.nrrd): see docs/how-to/scene.md.
        mapping: TOML file that says which columns are which, as `needleforce force
            --print-config` writes.
        tare: Tare after so many seconds of motion without contact (default: 4); if it
            is refused, again after as many.
        export: Write the scene as one page (.html) with the insertion as a film, and
            end.
        port: Port of the page, on this machine alone (default: 8080); another is used
            if it is busy.
        robot: The robot on which the log was recorded.
    """
    from needleforce.cli.logs.session_view import view_recording

    return view_recording(
        recording,
        robot,
        anatomy=anatomy,
        mapping_file=mapping,
        tare_s=tare,
        export=export,
        port=port,
    )


@app.command(name="simulate", group=LOGS)
def simulate_command(
    scenario: Annotated[str | None, Parameter(name="SCENARIO", group=OUTPUT)] = None,
    /,
    *,
    output: Annotated[
        Path | None,
        Parameter(name=("--output", "-o"), metavar="FILE", group=OUTPUT),
    ] = None,
    truth: Annotated[Path | None, Parameter(metavar="FILE", group=OUTPUT)] = None,
    plant: Annotated[
        Literal["ideal", "clean", "fri", "degraded", "needle"], Parameter(group=OUTPUT)
    ] = "clean",
    seed: Annotated[Seed, Parameter(group=OUTPUT)] = 0,
    overwrite: Annotated[bool, Parameter(group=OUTPUT)] = False,
    list: Annotated[bool, Parameter(group=OUTPUT)] = False,
) -> int:
    """Simulate an insertion and write it as a recording.

    Joint positions, velocities and torques of a KUKA LWR 4+, and the wrench of a force
    sensor at the needle, as a robot would have recorded them; or, with --plant needle,
    depth and force alone.

    needleforce simulate gel-25-constant -o insertion.mcap --truth truth.csv

    A patient to plan on, a torso's CT with labels and landmarks in a folder:

    needleforce simulate torso -o patient

    and the insertion of a plan: needleforce simulate plan/plan.json -o insertion.csv

    Args:
        scenario: What is simulated; see --list.
        output: Recording: .csv, .npz, .parquet, or .mcap, a ROS 2 bag.
        truth: Ground truth, which the robot does not know: forces, depth, layers,
            ruptures.
        plant: Plant model: how good arm and sensors are (default: clean); or needle, a
            needle on a linear stage with its force sensor, without an arm.
        seed: Seed of everything that is drawn at random (default: 0).
        overwrite: Replace files that are there.
        list: Print the scenarios and stop.
    """
    from needleforce.cli.logs import simulated_log

    if list:
        return simulated_log.print_scenarios()
    return simulated_log.write_simulation(
        scenario, output, truth, plant=plant, seed=seed, overwrites=overwrite
    )


@app.command(name="record", group=ARMS)
def record_command(
    arm: ArmName,
    /,
    *,
    output: Annotated[
        Path,
        Parameter(
            name=("--output", "-o"),
            metavar="FILE",
            group=LIVE_OUTPUT,
            help="Recording: .csv, .npz, .parquet, or .mcap, a ROS 2 bag.",
        ),
    ],
    overwrite: Annotated[
        bool, Parameter(group=LIVE_OUTPUT, help="Replace a file that is there.")
    ] = False,
    options: ArmOptions = ArmOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Write an arm's joint signals into a recording as they come, until Ctrl-C.

    needleforce record fri -o insertion.mcap
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_connection import record_signals

    return record_signals(arm, output, options, robot, overwrites=overwrite)


@app.command(name="live", group=ARMS)
def live_command(
    arm: ArmName,
    /,
    *,
    options: ArmOptions = ArmOptions(),
    robot: RobotOptions = RobotOptions(),
    plan: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None,
    reference: Annotated[str | None, Parameter(metavar="ADDRESS", group=LOG)] = None,
    reference_axis: Annotated[Direction, Parameter(metavar="X Y Z", group=LOG)] = (
        0.0,
        0.0,
        1.0,
    ),
    view: Annotated[bool, Parameter(group=LIVE_OUTPUT)] = False,
    port: Port = 8080,
    tare: TareSeconds = 4.0,
    tare_stroke: Annotated[
        float | None, Parameter(metavar="MM", group=TARE, validator=between(0.1, 1e3))
    ] = None,
    yes: Annotated[bool, Parameter(group=TARE)] = False,
) -> int:
    """Watch an arm until Ctrl-C: forces, depth, ruptures, warnings.

    Move the needle in free air first: the tare is taken after --tare seconds. Or let
    the arm make that stroke itself: --tare-stroke MM.

    needleforce live sim:stack-glove-constant --view

    Args:
        arm: The arm that is watched.
        options: How long it is listened to.
        robot: The model of the arm.
        plan: Plan to match ruptures with (plan.json, or its folder): see
            docs/how-to/scene.md.
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
    limit_library_threads()
    from needleforce.cli.arms import arm_watch

    return arm_watch.watch_arm(
        arm,
        options,
        robot,
        plan_place=plan,
        reference_address=reference,
        reference_axis=reference_axis,
        port=port if view else None,
        tare_s=tare,
        stroke_m=None if tare_stroke is None else 1e-3 * tare_stroke,
        is_confirmed=yes,
    )


@app.command(name="lag", group=ARMS)
def lag_command(
    arm: MovedArmName,
    /,
    *,
    yes: Annotated[
        bool, Parameter(group=LIVE_OUTPUT, help="Move the arm without asking.")
    ] = False,
    json: Annotated[bool, Parameter(group=LIVE_OUTPUT, help="Print JSON.")] = False,
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Measure the delay from command to motion, and print the largest safe gain.

    All joints move for 4 s by a chirp of 1 to 6 Hz, the tip by at most 5 mm either way:
    keep the needle in free air. A gain K is stable while K (T + h/2) < pi/2, with T the
    delay and h the cycle; the safe one keeps a phase margin of 55 degrees.

    needleforce lag sim --yes
    """
    limit_library_threads()
    from needleforce.cli.arms.arm_lag import measure_arm

    return measure_arm(arm, robot, is_confirmed=yes, as_json=json)


@app.command(name="ros2", group=ARMS)
def ros2_command(
    *ros_arguments: Annotated[
        str,
        Parameter(
            name="ROS",
            group=LOG,
            allow_leading_hyphen=True,
            help="Arguments of ROS, after --ros-args: parameters (-p NAME:=VALUE, "
            "--params-file FILE), other names of topics (-r OLD:=NEW).",
        ),
    ],
    robot: RobotOptions = RobotOptions(),
    plan: Annotated[
        Path | None,
        Parameter(
            metavar="FILE",
            group=LOG,
            help="Plan to follow (plan.json, or its folder): the needle on it is in "
            "/diagnostics, what happens on it in ~/events.",
        ),
    ] = None,
) -> int:
    """Run a ROS 2 node: joint_states in; wrench, tip force, layers, events out.

    It needs your own ROS 2, sourced: see docs/how-to/ros2.md. Without --urdf and
    --robot the arm is the one on the topic robot_description.

    needleforce ros2 --urdf arm.urdf --ros-args -r joint_states:=/arm/joint_states
    """
    from needleforce.cli.robot import robot_from_topic
    from needleforce.cli.session_parts import load_plan
    from needleforce.ros2 import require_ros

    require_ros()
    from needleforce.ros2.node import run_node

    loaded = load_plan(plan)
    run_node(
        ros_arguments,
        partial(robot_from_topic, robot),
        (lambda session: None) if loaded is None else loaded.follow_with,
    )
    return 0


@app.command(name="plan", group=PATIENT)
def plan_command(
    *,
    ct: Annotated[Path, Parameter(metavar="DIR|FILE", group=LOG)],
    labels: Annotated[Path, Parameter(metavar="FILE", group=LOG)],
    target: Annotated[str, Parameter(metavar="STRUCTURE|FILE", group=LOG)],
    structures: Annotated[
        str | None, Parameter(metavar="NAME=KIND,...|FILE", group=LOG)
    ] = None,
    situs_inversus: Annotated[bool, Parameter(group=LOG)] = False,
    avoid: Annotated[
        tuple[str, ...],
        Parameter(metavar="STRUCTURE", consume_multiple=True, group=LIMITS),
    ] = (),
    passable: Annotated[
        tuple[str, ...],
        Parameter(metavar="STRUCTURE", consume_multiple=True, group=LIMITS),
    ] = (),
    choose: Annotated[
        int, Parameter(metavar="N", group=LIMITS, validator=between(1, 1000))
    ] = 1,
    output: Annotated[
        Path, Parameter(name=("--output", "-o"), metavar="DIR", group=LIVE_OUTPUT)
    ] = Path("plan"),
    limits: PathOptions = PathOptions(),
    points: PointOptions = PointOptions(),
) -> int:
    """Find straight paths from the skin to a target in a CT, ranked.

    The table has length, angle to the skin, clearance of structures at risk, and the
    layers crossed. Not a medical device.

    needleforce plan --ct ct/ --labels segmentation.nii.gz --target lesion -o plan

    Args:
        ct: CT: folder with one DICOM series, .nii.gz, .nrrd or .mha.
        labels: Segmentation of that CT: .nii.gz, .nrrd, .seg.nrrd, .mha, or DICOM SEG.
        target: Name of a structure, whose innermost point is the target; or points or a
            line of 3D Slicer (.mrk.json, .fcsv, .csv): the first point is the target, a
            line is the path.
        structures: What structures are that the segmentation does not name:
            label_5=liver,Segment_2=rib; or a JSON file ({"5": "liver"}).
        situs_inversus: Liver and spleen of this patient are exchanged.
        avoid: Structures that must stay clear of the path, beside bone, cartilage,
            lungs, vessels, bowel and others at risk by their names.
        passable: Structures that the needle may pass: at risk by their names, or with
            names that say nothing; dense_as_bone for what is dense in the CT and not
            labelled. No bone.
        choose: Number of the path, in the table, that becomes the plan (default: 1).
        output: Folder for plan.json, path.mrk.json for 3D Slicer and a page (default:
            plan).
        limits: What a path may be.
        points: What a file of points may leave unsaid.
    """
    from needleforce.cli.patient.plan_run import plan_paths

    return plan_paths(
        ct,
        labels,
        target,
        points=points,
        structures_text=structures,
        situs_inversus=situs_inversus,
        avoid=avoid,
        passable=passable,
        limits=limits,
        choice=choose,
        folder=output,
    )


@app.command(name="touch", group=PATIENT)
def touch_command(
    arm: ArmName,
    /,
    *,
    output: Annotated[
        Path, Parameter(name=("--output", "-o"), metavar="FILE", group=LIVE_OUTPUT)
    ] = Path("touches.json"),
    landmarks: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None,
    count: Annotated[
        int, Parameter(metavar="N", group=LOG, validator=between(0, 10**6))
    ] = 40,
    contact: Annotated[
        float, Parameter(metavar="N", group=LOG, validator=between(1e-3, 1e3))
    ] = 0.5,
    points: PointOptions = PointOptions(),
    options: ArmOptions = ArmOptions(),
    robot: RobotOptions = RobotOptions(),
) -> int:
    """Record what the needle's tip touches: landmarks, then the skin.

    Rest in contact for a second, or press Enter; u and Enter undoes the last one, q and
    Enter ends. sim:PLAN.json is a simulated arm that touches the patient of a plan.

    needleforce touch fri --landmarks landmarks.mrk.json -o touches.json

    Args:
        arm: The arm that holds the needle.
        output: What was touched (default: touches.json).
        landmarks: Points of the CT (.mrk.json, .fcsv, .csv): they are touched first, in
            the file's order; what is touched after them counts as skin.
        count: End after so many touches of the skin (default: 40).
        contact: Least force of a contact, in newtons, over that of the free needle
            (default: 0.5).
        points: What a file of points may leave unsaid.
        options: How long the arm is listened to.
        robot: The model of the arm.
    """
    from needleforce.cli.patient.touch_run import record_touches

    return record_touches(
        arm,
        output,
        options,
        robot,
        landmarks=landmarks,
        points=points,
        count=count,
        contact_N=contact,
    )


@app.command(name="register", group=PATIENT)
def register_command(
    *,
    plan: Annotated[Path, Parameter(metavar="FILE", group=LOG)],
    output: Annotated[
        Path, Parameter(name=("--output", "-o"), metavar="FILE", group=LIVE_OUTPUT)
    ],
    landmarks: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None,
    touches: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None,
    transform: Annotated[Path | None, Parameter(metavar="FILE", group=LOG)] = None,
    transform_from: Annotated[
        Literal["slicer", "itk"] | None, Parameter(group=LOG)
    ] = None,
    transform_std: Annotated[
        float | None, Parameter(metavar="MM", group=LOG, validator=between(1e-3, 50.0))
    ] = None,
    landmarks_only: Annotated[bool, Parameter(group=LOG)] = False,
    negate_xy: Annotated[bool, Parameter(group=LOG)] = False,
    points: PointOptions = PointOptions(),
    errors: RegistrationOptions = RegistrationOptions(),
) -> int:
    """Find where the patient of a plan lies in the robot's base.

    By landmarks and touches of the skin together. What does not fit is refused, with
    the reason: a patient who moved, too. Not a medical device.

    needleforce register --plan plan/plan.json --landmarks landmarks.mrk.json --touches
    touches.json -o plan/plan.json

    Args:
        plan: Plan that `needleforce plan` wrote.
        output: The plan with its registration; the same file is replaced.
        landmarks: Points of the CT (.mrk.json, .fcsv, .csv), with the names of those
            touched.
        touches: What `needleforce touch` recorded; or a .csv of places in the robot's
            base: those with a name are landmarks, the others the skin.
        transform: In place of landmarks: a rigid transform from the CT to the robot's
            base (.h5, .tfm, .mat of ANTs, a 4 x 4 matrix in .txt or .json), which
            touches of the skin check.
        transform_from: Who wrote it: slicer (a matrix: as it shows it), or itk
            (TransformPoint, or the matrix, carries points of the CT to the base).
        transform_std: Its standard deviation at the patient along each axis, in
            millimetres.
        landmarks_only: Leave the touches of the skin out.
        negate_xy: Negate x and y of the landmarks: their file says LPS and holds RAS,
            or the reverse.
        points: What a file of points or a matrix may leave unsaid.
        errors: Errors of landmarks and touches.
    """
    from needleforce.cli.patient.register_run import register_plan

    return register_plan(
        plan,
        output,
        landmark_file=landmarks,
        touch_file=touches,
        transform=transform,
        transform_from=transform_from,
        transform_std_mm=transform_std,
        points=points,
        errors=errors,
        landmarks_only=landmarks_only,
        negate_xy=negate_xy,
    )


@app.command(name="demo", group=MACHINE)
def demo_command(
    kind: Annotated[
        Literal["insertion", "abdomen"], Parameter(name="KIND", group=LOG)
    ] = "insertion",
    /,
    *,
    report: Annotated[Path | None, Parameter(metavar="DIR", group=LIVE_OUTPUT)] = None,
    data: Annotated[Path | None, Parameter(metavar="DIR", group=LOG)] = None,
    seed: Seed = 0,
) -> int:
    """Show what the toolkit does, on a simulated arm; with no name: an insertion.

    insertion: layers and tip force from joint torques, beside the truth; a page in
    demo/. abdomen: planned on a CT, ruptures correct the plan. Both print a table.
    The needle in closed loop (led by hand, about its entry, by itself, from afar) is in
    examples/. Simulation only: not a medical device.

    needleforce demo

    needleforce demo abdomen --report abdomen

    Args:
        kind: What is shown.
        report: Folder for a page (insertion: demo; abdomen: no page).
        data: For abdomen: folder with ct.nii.gz and labels.nii.gz; else an analytic
            torso.
        seed: Of everything that is drawn at random (default: 0).
    """
    if kind == "abdomen":
        from needleforce.cli.demos import abdomen

        return abdomen.run(data, seed, report)
    if data is not None:
        raise CommandError(
            f"--data {data}: only the abdomen is read from files, expected "
            "needleforce demo abdomen"
        )
    require_modules("demo", ("mujoco", "matplotlib", "jinja2"))
    # Said before anything is compiled.
    say(
        "A simulated arm pushes a needle through three gels; the force at its tip is "
        "estimated from joint torques alone. Takes about 40 s, the first time a minute."
    )
    from needleforce.cli.demos import insertion

    return insertion.run(report or Path("demo"), seed)


@app.command(name="doctor", group=MACHINE)
def doctor_command(
    *,
    compile: Annotated[
        bool,
        Parameter(
            group=LIVE_OUTPUT,
            help="First compile what is not kept yet, so that no later start has to.",
        ),
    ] = False,
    json: Annotated[bool, Parameter(group=LIVE_OUTPUT, help="Print JSON.")] = False,
) -> int:
    """Print versions, extras, the compiler's cache, and what is in the way of use.

    Unless told to it compiles nothing; it needs no network. For a bug report.

    needleforce doctor --json
    """
    from needleforce.cli.checkup import examine

    found = examine(compiles=compile)
    write_out(json_text(found) if json else aligned(found.items()))
    return 0
