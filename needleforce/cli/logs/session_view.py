"""`needleforce view`: a recording in the scene, with anatomy and plan."""

import sys
from collections import Counter
from contextlib import redirect_stdout
from pathlib import Path
from time import sleep
from typing import NamedTuple

import numpy as np

from needleforce.cli.auto_tare import SessionTare
from needleforce.cli.logs.sensor_replay import require_joints
from needleforce.cli.logs.tare_schedule import rejections
from needleforce.cli.plan_file import Planned, read_plan
from needleforce.cli.robot import robot_from_options, urdf_with_shapes
from needleforce.cli.shared_options import TARE_S, RobotOptions
from needleforce.cli.terminal import (
    CommandError,
    progress_bar,
    say,
    stop_request,
    write_out,
)
from needleforce.recordings import load_mapping, read_log
from needleforce.recordings.errors import readable_path
from needleforce.recordings.output import check_outputs, require_place
from needleforce.scene import Viewer, view_row
from needleforce.scene.nodes import EMPTY
from needleforce.scene.viewer import check_address
from needleforce.session import InsertionSession
from residual import Status
from urdf import Robot


class ScenePage(NamedTuple):
    """Where the scene is shown: served until Ctrl-C, or written into a file.

    Attributes:
        host: Address on which the page is served.
        port: Port of the page; another is used if it is busy.
        export: HTML file that is written instead of waiting for Ctrl-C.
    """

    host: str
    port: int
    export: Path | None = None

    def check(self, recording: Path) -> None:
        """Refuse now what would fail, or harm the recording, after minutes of work."""
        check_address(self.host, self.port)
        if self.export is None:
            return
        if self.export.suffix.lower() != ".html":
            raise CommandError(f"--export {self.export}: its name must end in .html")
        require_place(self.export)
        check_outputs({"--export": self.export}, readable_path(recording))


def view_recording(
    recording: Path,
    robot: RobotOptions,
    page: ScenePage,
    *,
    tare_s: float,
    mapping: str | None,
    anatomy: Path | None,
) -> int:
    """Show a recording until Ctrl-C, or write it as one page.

    Args:
        recording: File of joint signals.
        robot: Options that describe the robot.
        page: Where the scene is shown.
        tare_s: Motion without contact before a tare [s].
        mapping: File that says which columns are which, if any.
        anatomy: Folder with plan and labels, if any.

    Returns:
        The exit code.
    """
    page.check(recording)
    model = robot_from_options(robot, mapping)
    plan = None if anatomy is None else read_plan(anatomy)
    rows = replay_session(recording, model, tare_s=tare_s, mapping=mapping, plan=plan)
    scene = EMPTY if plan is None else plan.scene
    shapes = urdf_with_shapes(robot)
    with redirect_stdout(sys.stderr):  # viser's banner is no result
        viewer = Viewer(model, scene, urdf_path=shapes, host=page.host, port=page.port)
    viewer.append(rows)
    viewer.show()
    if page.export is not None:
        write_out(f"{viewer.export(page.export)}\n")
    else:
        write_out(f"{viewer.url}  (Ctrl-C ends it)\n")
        with stop_request() as is_asked:
            while not is_asked():
                sleep(0.2)
    with redirect_stdout(sys.stderr):
        viewer.stop()
    return 0


def replay_session(
    recording: Path,
    model: Robot,
    *,
    tare_s: float = TARE_S,
    mapping: str | None = None,
    plan: Planned | None = None,
) -> np.ndarray:
    """Rows of the session over a recording of joint signals; says what is wrong with
    it.
    """
    tare = SessionTare(tare_s)
    session = InsertionSession(model)
    rows = []
    rejected = Counter[str]()
    columns = load_mapping(mapping) if mapping else None
    joints = model.joint_names
    known = (recording, columns)
    log = read_log(*known, required=["q", "tau"], optional=["dq"], joints=joints)
    require_joints(log["q_rad"], model)
    if plan is not None:
        session.follow(plan.match, plan.entry_in_base_m)
    q = log["q_rad"]
    tau = log["tau_Nm"]
    dq = log["dq_rad_s"] if "dq_rad_s" in log else [None] * len(q)
    steps = np.diff(log.t_s, prepend=2.0 * log.t_s[0] - log.t_s[1])
    with progress_bar("estimating") as progress:
        for k, dt_s in enumerate(steps.tolist()):
            now = session.update(q[k], dq[k], tau[k], dt_s)
            tare.after(session, now)
            if now.status is Status.REJECTED:
                rejected[now.wrench.message.split(";")[0]] += 1
            found = now.identification
            if k % 10 == 0 or found.rupture is not None or found.retracted is not None:
                rows.append(view_row(now, q[k]))
            if k % 1000 == 0:
                progress(k / len(q))
    warnings = [f"samples rejected, {rejections(rejected)}"] * bool(rejected)
    if not session.tared:
        warnings.append(
            f"no tare in {steps.sum():.4g} s (--tare {tare_s:g} asks for so many seconds of "
            "motion without contact): forces carry errors of the model and of the torque sensors"
        )
    for text in (*log.warnings, *warnings):
        say(f"warning: {text}")
    return np.array(rows)
