"""`needleforce view`: a session over a recording, in the scene."""

from pathlib import Path
from time import sleep

import numpy as np

from needleforce import recordings
from needleforce.cli.logs.columns import mapping_from_options, robot_of_log
from needleforce.cli.options import Columns, RobotOptions
from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.session_parts import auto_tare, load_plan
from needleforce.cli.terminal import (
    CommandError,
    progress_bar,
    stop_request,
    warn,
    write_out,
)
from needleforce.recordings import output
from needleforce.scene import Moment, Viewer, is_kept
from needleforce.scene.nodes import EMPTY
from needleforce.session import InsertionSession
from needleforce.session_replay import replay_session, require_joints


def view_recording(
    recording: Path,
    robot: RobotOptions,
    *,
    anatomy: Path | None,
    mapping_file: str | None,
    tare_s: float,
    export: Path | None,
    port: int,
) -> int:
    """Show a recording until Ctrl-C, or write it as one page.

    Args:
        recording: File of joint signals.
        robot: Options that describe the robot.
        anatomy: A plan.
        mapping_file: Which columns are which.
        tare_s: Motion without contact before the tare.
        export: The page; None to serve it.
        port: Where it is served.

    Returns:
        The exit code.

    Raises:
        CommandError: The name of the page does not end in .html.
    """
    if export is not None:
        if export.suffix.lower() != ".html":
            raise CommandError(f"--export {export}: its name must end in .html")
        output.require_place(export)
        output.check_outputs({"--export": export}, [recording])
    mapping = mapping_from_options(Columns(mapping=mapping_file))
    model = robot_of_log([str(recording)], mapping, robot, mapping_file)
    plan = load_plan(anatomy, is_past=True)
    log = recordings.read_log(
        recording,
        mapping,
        required=["q", "tau"],
        optional=["dq"],
        joints=model.joint_names,
    )
    warn(log.warnings)
    require_joints(log["q_rad"], model)
    session = InsertionSession(model)
    if plan is not None:
        plan.follow_with(session)
    moments = scene_moments(session, log, tare_s)
    scene = EMPTY if plan is None else plan.scene
    viewer = Viewer(model, scene, urdf_path=urdf_with_shapes(robot), port=port)
    if viewer.unread_shapes:
        warn([f"the arm is shown as a line: {viewer.unread_shapes}"])
    viewer.append(moments)
    viewer.open_recording()
    place = viewer.export(export) if export else f"{viewer.url}  (Ctrl-C ends it)"
    write_out(f"{place}\n")
    with stop_request() as is_asked:
        while export is None and not is_asked():
            sleep(0.2)
    viewer.stop()
    return 0


def scene_moments(
    session: InsertionSession, log: recordings.Log, tare_s: float
) -> list[Moment]:
    """Run a session over a recording; what is wrong with it is said on stderr.

    Args:
        session: The session, which has seen nothing.
        log: Joint signals.
        tare_s: Motion without contact before a tare [s].

    Returns:
        Moments of the scene, fifty a second and those with events.
    """
    progress_ticks = 1000  # samples between two updates of the progress bar
    moments: list[Moment] = []
    with progress_bar("estimating") as progress:
        replayed = replay_session(session, log, auto_tare(tare_s, at_once=True))
        for tick, (q_rad, estimate) in enumerate(replayed):
            latest_s = moments[-1].estimate.time_s if moments else -np.inf
            if is_kept(estimate, latest_s):
                moments.append(Moment(q_rad, estimate))
            if tick % progress_ticks == 0:
                progress(tick / len(log))
    if session.rejected:
        warn([f"samples rejected by the session: {session.rejected}"])
    if not session.tared:
        warn(
            [
                f"no tare (--tare {tare_s:g} asks for so many seconds of motion without"
                " contact): forces carry errors of the model and of the torque sensors"
            ]
        )
    return moments
