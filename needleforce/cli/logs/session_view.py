"""`needleforce view`: a session over a recording, in the scene."""

from collections import Counter
from functools import partial
from pathlib import Path
from time import sleep

import numpy as np

from needleforce.cli.auto_tare import auto_tare
from needleforce.cli.logs.columns import find_log_joints
from needleforce.cli.plan_option import load_plan
from needleforce.cli.robot import robot_from_options, urdf_with_shapes
from needleforce.cli.shared_options import TARE_S, RobotOptions
from needleforce.cli.terminal import (
    CommandError,
    progress_bar,
    stop_request,
    warn,
    write_out,
)
from needleforce.plan_file import LoadedPlan
from needleforce.recordings import ColumnMapping, load_mapping, read_log
from needleforce.recordings.output import check_outputs, require_place
from needleforce.scene import Moment, Viewer, is_kept
from needleforce.scene.nodes import EMPTY
from needleforce.sensor_replay import describe_rejections, require_joints
from needleforce.session import InsertionSession
from needleforce.session_replay import replay_session
from residual import Status
from urdf import Robot


def view_recording(
    recording: Path,
    robot: RobotOptions,
    *,
    port: int,
    export: Path | None,
    tare_s: float,
    mapping: str | None,
    anatomy: Path | None,
    situs_inversus: bool = False,
) -> int:
    """Show a recording until Ctrl-C, or write it as one page.

    Args:
        recording: File of joint signals.
        robot: Options that describe the robot.
        port: Port of the page; another is used if it is busy.
        export: HTML file that is written instead of waiting for Ctrl-C.
        tare_s: Motion without contact before a tare [s].
        mapping: File that says which columns are which, if any.
        anatomy: Folder with plan and labels, if any.
        situs_inversus: Liver and spleen of the patient are exchanged.

    Returns:
        The exit code.

    Raises:
        CommandError: The name of the page does not end in .html.
    """
    if export is not None:
        if export.suffix.lower() != ".html":
            raise CommandError(f"--export {export}: its name must end in .html")
        require_place(export)
        check_outputs({"--export": export}, recording)
    columns = load_mapping(mapping) if mapping else ColumnMapping()
    find_joints = partial(find_log_joints, str(recording), columns)
    model = robot_from_options(robot, mapping, find_joints)
    plan = load_plan(anatomy, is_past=True, situs_inversus=situs_inversus)
    moments = scene_moments(recording, model, tare_s=tare_s, columns=columns, plan=plan)
    scene = EMPTY if plan is None else plan.scene
    viewer = Viewer(model, scene, urdf_path=urdf_with_shapes(robot), port=port)
    if viewer.unread_shapes:
        warn([f"the arm is shown as a line: {viewer.unread_shapes}"])
    viewer.append(moments)
    viewer.open_recording()
    if export is not None:
        write_out(f"{viewer.export(export)}\n")
    else:
        write_out(f"{viewer.url}  (Ctrl-C ends it)\n")
        with stop_request() as is_asked:
            while not is_asked():
                sleep(0.2)
    viewer.stop()
    return 0


def scene_moments(
    recording: Path,
    model: Robot,
    *,
    tare_s: float = TARE_S,
    columns: ColumnMapping | None = None,
    plan: LoadedPlan | None = None,
) -> list[Moment]:
    """Run a session over a recording; what is wrong with it is said on stderr.

    Args:
        recording: File of joint signals.
        model: The robot.
        tare_s: Motion without contact before a tare [s].
        columns: Which columns are which channels.
        plan: Plan to match ruptures with, if any.

    Returns:
        Moments of the scene, fifty a second and those with events.
    """
    progress_ticks = 1000  # samples between two updates of the progress bar
    session = InsertionSession(model)
    log = read_log(
        recording,
        columns,
        required=["q", "tau"],
        optional=["dq"],
        joints=model.joint_names,
    )
    require_joints(log["q_rad"], model)
    if plan is not None:
        plan.follow_with(session)
    moments: list[Moment] = []
    latest_s = -np.inf
    rejected = Counter[str]()
    with progress_bar("estimating") as progress:
        replayed = replay_session(session, log, auto_tare(tare_s, at_once=True))
        for tick, (q_rad, estimate) in enumerate(replayed):
            if estimate.status is Status.REJECTED:
                rejected[estimate.wrench.message.split(";")[0]] += 1
            if is_kept(estimate, latest_s):
                latest_s = estimate.time_s
                moments.append(Moment(q_rad, estimate))
            if tick % progress_ticks == 0:
                progress(tick / len(log))
    warn(log.warnings)
    if rejected:
        warn([f"samples rejected, {describe_rejections(rejected)}"])
    if not session.tared:
        text = (
            f"no tare (--tare {tare_s:g} asks for so many seconds of motion without "
            "contact): forces carry errors of the model and of the torque sensors"
        )
        warn([text])
    return moments
