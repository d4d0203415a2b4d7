"""`needleforce view`: a session over a recording, in the scene."""

from collections import Counter
from functools import partial
from pathlib import Path
from time import sleep
from typing import NamedTuple

import numpy as np

from needleforce.cli.auto_tare import auto_tare
from needleforce.cli.logs.log_joints import find_log_joints
from needleforce.cli.plan_option import load_plan
from needleforce.cli.robot import robot_from_options, urdf_with_shapes
from needleforce.cli.shared_options import TARE_S, RobotOptions
from needleforce.cli.terminal import (
    CommandError,
    progress_bar,
    say,
    stop_request,
    write_out,
)
from needleforce.plan_file import LoadedPlan
from needleforce.recordings import ColumnMapping, load_mapping, read_log
from needleforce.recordings.errors import readable_path
from needleforce.recordings.output import check_outputs, require_place
from needleforce.scene import Moment, Viewer, is_kept
from needleforce.scene.nodes import EMPTY
from needleforce.sensor_replay import describe_rejections, require_joints
from needleforce.session import InsertionSession
from needleforce.session_replay import replay_session
from residual import Status
from urdf import Robot

POLL_S = 0.2
"""Time between two looks at whether Ctrl-C came [s]."""


class ScenePage(NamedTuple):
    """Where the scene is shown: served until Ctrl-C, or written into a file.

    Attributes:
        port: Port of the page; another is used if it is busy.
        export: HTML file that is written instead of waiting for Ctrl-C.
    """

    port: int
    export: Path | None = None

    def check(self, recording: Path) -> None:
        """Refuse now what would fail, or harm the recording, after minutes of work.

        Raises:
            CommandError: The name of the file does not end in .html.
        """
        if self.export is None:
            return
        if self.export.suffix.lower() != ".html":
            raise CommandError(f"--export {self.export}: its name must end in .html")
        require_place(self.export)
        check_outputs({"--export": self.export}, readable_path(recording))

    def show(self, viewer: Viewer) -> None:
        """Write the page into the file, or serve it until Ctrl-C."""
        if self.export is not None:
            write_out(f"{viewer.export(self.export)}\n")
            return
        write_out(f"{viewer.url}  (Ctrl-C ends it)\n")
        with stop_request() as is_asked:
            while not is_asked():
                sleep(POLL_S)


def view_recording(
    recording: Path,
    robot: RobotOptions,
    page: ScenePage,
    *,
    tare_s: float,
    mapping: str | None,
    anatomy: Path | None,
    situs_inversus: bool = False,
) -> int:
    """Show a recording until Ctrl-C, or write it as one page.

    Args:
        recording: File of joint signals.
        robot: Options that describe the robot.
        page: Where the scene is shown.
        tare_s: Motion without contact before a tare [s].
        mapping: File that says which columns are which, if any.
        anatomy: Folder with plan and labels, if any.
        situs_inversus: Liver and spleen of the patient are exchanged.

    Returns:
        The exit code.
    """
    page.check(recording)
    columns = load_mapping(mapping) if mapping else ColumnMapping()
    find_joints = partial(find_log_joints, str(recording), columns, "tau")
    model = robot_from_options(robot, mapping, find_joints)
    plan = load_plan(anatomy, is_past=True, situs_inversus=situs_inversus)
    moments = scene_moments(recording, model, tare_s=tare_s, mapping=mapping, plan=plan)
    scene = EMPTY if plan is None else plan.scene
    shapes = urdf_with_shapes(robot)
    viewer = Viewer(model, scene, urdf_path=shapes, port=page.port)
    for name in viewer.unread_meshes:
        say(f"warning: the arm is shown without {name}, which cannot be read")
    viewer.append(moments)
    viewer.open_recording()
    page.show(viewer)
    viewer.stop()
    return 0


def scene_moments(
    recording: Path,
    model: Robot,
    *,
    tare_s: float = TARE_S,
    mapping: str | None = None,
    plan: LoadedPlan | None = None,
) -> list[Moment]:
    """Run a session over a recording; what is wrong with it is said on stderr.

    Args:
        recording: File of joint signals.
        model: The robot.
        tare_s: Motion without contact before a tare [s].
        mapping: File that says which columns are which, if any.
        plan: Plan to match ruptures with, if any.

    Returns:
        Moments of the scene, fifty a second and those with events.
    """
    progress_ticks = 1000  # Samples between two updates of the progress bar
    tare = auto_tare(tare_s, at_once=True)
    session = InsertionSession(model)
    columns = load_mapping(mapping) if mapping else None
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
        replayed = replay_session(session, log, tare)
        for tick, (q_rad, estimate) in enumerate(replayed):
            if estimate.status is Status.REJECTED:
                rejected[estimate.wrench.message.split(";")[0]] += 1
            if is_kept(estimate, latest_s):
                latest_s = estimate.time_s
                moments.append(Moment(q_rad, estimate))
            if tick % progress_ticks == 0:
                progress(tick / len(log.t_s))
    for warning in log.warnings:
        say(f"warning: {warning}")
    _report_rejections(rejected)
    if not session.tared:
        # The first sample has the time step of the second.
        duration_s = log.t_s[-1] - 2.0 * log.t_s[0] + log.t_s[1]
        say(
            f"warning: no tare in {duration_s:.4g} s (--tare {tare_s:g} asks for so "
            "many seconds of motion without contact): forces carry errors of the model "
            "and of the torque sensors"
        )
    return moments


def _report_rejections(rejected: Counter[str]) -> None:
    """Say on stderr how many samples were rejected, if any were."""
    if rejected:
        say(f"warning: samples rejected, {describe_rejections(rejected)}")
