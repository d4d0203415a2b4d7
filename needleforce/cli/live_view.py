"""`needleforce view`: a recording in the scene, with anatomy and plan."""

import json
from importlib.resources import files
from pathlib import Path
from time import sleep

import numpy as np

from needleforce.anatomy import read_labels
from needleforce.cli.live_commands import ViewOptions
from needleforce.cli.options import RobotOptions
from needleforce.cli.robot import robot_from_options
from needleforce.cli.terminal import CommandError, progress_bar, say, stop_request, write_out
from needleforce.recordings import read_log
from needleforce.scene import PlanScene, Viewer, view_row
from needleforce.scene.nodes import EMPTY
from needleforce.session import InsertionSession
from residual import Status, TareError
from urdf import Robot, example_robot_path

LEAST_VOXELS = 500
PLAN = "plan.json"
EXPECTED = (
    'a JSON object with "rotation" (3 rows of 3), "translation_m" (from the scan, LPS, to the '
    'robot\'s base), "entry_m" and "target_m" (in the scan)'
)


def run(recording: Path, options: ViewOptions, robot: RobotOptions) -> int:
    """Show a recording until Ctrl-C, or write it as one page; return the exit code."""
    model = robot_from_options(robot, None)
    plan = EMPTY if options.anatomy is None else read_plan(options.anatomy)
    rows = replayed(recording, model, options.tare)
    viewer = Viewer(model, plan, urdf_path=description(robot), host=options.host, port=options.port)
    viewer.append(rows)
    viewer.show()
    if options.export is not None:
        write_out(f"{viewer.export(options.export)}\n")
        viewer.stop()
        return 0
    write_out(f"{viewer.url}  (Ctrl-C ends it)\n")
    with stop_request() as is_asked:
        while not is_asked():
            sleep(0.2)
    viewer.stop()
    return 0


def description(options: RobotOptions) -> Path | None:
    """The file whose shapes are shown."""
    if options.urdf is not None:
        return Path(options.urdf)
    if options.robot in (None, "lwr"):
        return Path(str(files("urdf.data") / "lwr4plus.urdf"))
    return Path(example_robot_path(options.robot))


def replayed(recording: Path, model: Robot, tare_s: float) -> np.ndarray:
    """Rows of the session over a recording of joint signals."""
    log = read_log(recording, required=["q", "tau"], optional=["dq"])
    session, rows, tare_at_s = InsertionSession(model), [], tare_s
    q, tau = log["q_rad"], log["tau_Nm"]
    dq = log["dq_rad_s"] if "dq_rad_s" in log else [None] * len(q)
    steps = np.diff(log.t_s, prepend=2.0 * log.t_s[0] - log.t_s[1])
    with progress_bar("estimating") as progress:
        for k, dt_s in enumerate(steps.tolist()):
            now = session.update(q[k], dq[k], tau[k], dt_s)
            if not session.tared and now.status is Status.NOT_TARED and now.time_s > tare_at_s:
                tare_at_s = now.time_s + tare_s
                try:
                    session.tare()
                except TareError as error:
                    say(f"no tare at {now.time_s:.1f} s: {error}")
            if k % 10 == 0 or now.identification.rupture is not None:
                row = view_row(now, q[k])
                rows.append((*row.values, *row.q_rad))
            if k % 1000 == 0:
                progress(k / len(q))
    return np.array(rows)


def read_plan(folder: Path) -> PlanScene:
    """Anatomy and plan of a folder: labels, and `plan.json`."""
    found = [*sorted(folder.glob("labels*.n*")), *sorted(folder.glob("*.seg.nrrd"))]
    if not found:
        raise CommandError(f"{folder}: expected labels.nii.gz, labels.nrrd or a .seg.nrrd there")
    labels = read_labels(found[0])
    try:
        plan = json.loads((folder / PLAN).read_text(encoding="utf-8"))
        rotation, shift, entry, target = (
            np.array(plan[name], dtype=float)
            for name in ("rotation", "translation_m", "entry_m", "target_m")
        )
        if (rotation.shape, shift.shape, entry.shape, target.shape) != ((3, 3), (3,), (3,), (3,)):
            raise ValueError("wrong shapes")
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise CommandError(f"{folder / PLAN}: {error}; expected {EXPECTED}") from error
    with progress_bar("surfaces") as progress:
        large = [item.name for item in labels.structures if item.voxels >= LEAST_VOXELS]
        made = list(labels.surfaces(large, progress).values())
    return PlanScene(made, labels.layers_along(entry, target), entry, target, rotation, shift)
