"""`needleforce view`: a recording in the scene, with anatomy and plan."""

import math
import sys
from collections import Counter
from contextlib import redirect_stdout
from importlib.resources import files
from pathlib import Path
from time import sleep
from typing import NamedTuple

import msgspec
import numpy as np

from needleforce.anatomy import AnatomyError, Layer, PlanMatch, read_labels
from needleforce.cli.force_replay import rejections, require_joints
from needleforce.cli.live_options import ViewOptions
from needleforce.cli.options import RobotOptions
from needleforce.cli.robot import robot_from_options
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
from needleforce.scene import PlanScene, Viewer, view_row
from needleforce.scene.nodes import EMPTY
from needleforce.scene.viewer import check_address
from needleforce.session import InsertionSession, SessionEstimate
from residual import Status, TareError
from urdf import Robot, example_robot_path

LEAST_VOXELS = 500
PLAN = "plan.json"
MOST_m = 10.0  # Of a coordinate; beyond it the unit is not the metre
_WITHOUT_OPTIONS = {
    ", or ignore_contact=True if you know better": "",
    "set torque_is_gravity_compensated=True": "give needleforce force --gravity-compensated",
}
"""What a refused tare advises in code, where there is no option for it."""
Point = tuple[float, float, float]


class Planned(NamedTuple):
    """What a plan's file says.

    Attributes:
        entry_in_base_m: None: depths count as the session's.
    """

    scene: PlanScene
    match: PlanMatch
    entry_in_base_m: np.ndarray | None


class _LayerOfFile(msgspec.Struct, forbid_unknown_fields=True):
    name: str
    exit_m: float
    exit_std_m: float = 0.5e-3
    is_obstacle: bool = False


class _PlanFile(msgspec.Struct, forbid_unknown_fields=True):
    """See docs/scene.md."""

    rotation: tuple[Point, Point, Point] = (
        (1.0, 0.0, 0.0),
        (0.0, 1.0, 0.0),
        (0.0, 0.0, 1.0),
    )
    translation_m: Point = (0.0, 0.0, 0.0)
    entry_m: Point | None = None
    target_m: Point | None = None
    offset_std_m: float = 3e-3
    start_m: float = 0.0
    layers: tuple[_LayerOfFile, ...] = ()


class SessionTare:
    """Tares a session after so much motion without contact, and again where that is
    refused.
    """

    def __init__(self, every_s: float) -> None:
        if not 0.0 < every_s < math.inf:
            raise CommandError(f"--tare {every_s:g}: expected seconds of free motion")
        self._every_s = self._next_s = every_s

    def after(self, session: InsertionSession, now: SessionEstimate) -> bool:
        """Tare if it is time, after an update; whether it has."""
        if (
            session.tared
            or now.status is not Status.NOT_TARED
            or now.time_s <= self._next_s
        ):
            return False
        self._next_s = now.time_s + self._every_s
        try:
            session.tare()
        except TareError as error:
            reason = str(error)
            for words, here in _WITHOUT_OPTIONS.items():
                reason = reason.replace(words, here)
            say(f"no tare at {now.time_s:.1f} s: {reason}")
        return session.tared


def run(recording: Path, options: ViewOptions, robot: RobotOptions) -> int:
    """Show a recording until Ctrl-C, or write it as one page; return the exit code."""
    check_address(
        options.host, options.port
    )  # better before minutes of work than after
    if options.export is not None:
        if options.export.suffix.lower() != ".html":
            raise CommandError(f"--export {options.export}: its name must end in .html")
        require_place(options.export)
        check_outputs({"--export": options.export}, readable_path(recording))
    model = robot_from_options(robot, options.mapping)
    plan = None if options.anatomy is None else read_plan(options.anatomy)
    rows = replayed(recording, model, options, plan)
    scene = EMPTY if plan is None else plan.scene
    shapes = description(robot)
    with redirect_stdout(sys.stderr):  # viser's banner is no result
        viewer = Viewer(
            model, scene, urdf_path=shapes, host=options.host, port=options.port
        )
    viewer.append(rows)
    viewer.show()
    if options.export is not None:
        write_out(f"{viewer.export(options.export)}\n")
    else:
        write_out(f"{viewer.url}  (Ctrl-C ends it)\n")
        with stop_request() as is_asked:
            while not is_asked():
                sleep(0.2)
    with redirect_stdout(sys.stderr):
        viewer.stop()
    return 0


def description(options: RobotOptions) -> Path | None:
    """The file whose shapes are shown."""
    if options.urdf is not None:
        return Path(options.urdf)
    if options.robot in (None, "lwr"):
        return Path(str(files("urdf.data") / "lwr4plus.urdf"))
    return Path(example_robot_path(options.robot))


def replayed(
    recording: Path, model: Robot, options: ViewOptions, plan: Planned | None = None
) -> np.ndarray:
    """Rows of the session over a recording of joint signals; says what is wrong with
    it.
    """
    tare = SessionTare(options.tare)
    session = InsertionSession(model)
    rows = []
    rejected = Counter[str]()
    mapping = load_mapping(options.mapping) if options.mapping else None
    joints = model.joint_names
    known = (recording, mapping)
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
            f"no tare in {steps.sum():.4g} s (--tare {options.tare:g} asks for so many seconds of "
            "motion without contact): forces carry errors of the model and of the torque sensors"
        )
    for text in (*log.warnings, *warnings):
        say(f"warning: {text}")
    return np.array(rows)


def read_plan(place: Path) -> Planned:
    """A plan from its file, or from a folder with `plan.json`; labels may lie beside
    it.
    """
    path = place / PLAN if place.is_dir() else place
    try:
        plan = msgspec.json.decode(path.read_bytes(), type=_PlanFile)
        _require_places(plan)
        scene, layers = _segmented(plan, path.parent)
        match = PlanMatch(_given(plan) or layers, plan.offset_std_m)
    except (OSError, ValueError, msgspec.MsgspecError, AnatomyError) as error:
        raise CommandError(
            f"{path}: {error}; docs/scene.md says what a plan holds"
        ) from error
    entry_m = None if scene.entry_m is None else scene.to_robot(scene.entry_m)
    return Planned(scene._replace(layers=match.layers), match, entry_m)


def _require_places(plan: _PlanFile) -> None:
    """Refuse half of a way, and millimetres."""
    if (plan.entry_m is None) != (plan.target_m is None):
        raise ValueError("one of entry_m and target_m in it: expected both, or neither")
    places = (plan.translation_m, plan.entry_m or (), plan.target_m or ())
    if not all(abs(part) < MOST_m for place in places for part in place):
        raise ValueError(
            f"a place beyond {MOST_m:g} m in it: expected metres, not millimetres"
        )


def _segmented(plan: _PlanFile, folder: Path) -> tuple[PlanScene, list[Layer]]:
    """Surfaces, and the layers between entry and target, of the labels in a folder."""
    files = [*sorted(folder.glob("labels*.n*")), *sorted(folder.glob("*.seg.nrrd"))]
    turn = np.array(plan.rotation)
    shift = np.array(plan.translation_m)
    if (
        not np.allclose(turn @ turn.T, np.eye(3), atol=1e-3)
        or np.linalg.det(turn) < 0.0
    ):
        raise ValueError(
            f"rotation is {turn.tolist()}: expected orthonormal rows, no mirror image"
        )
    if plan.entry_m is None or plan.target_m is None:
        if not plan.layers:
            raise ValueError("neither layers nor entry_m and target_m in it")
        return PlanScene(rotation=turn, translation_m=shift), []
    way = np.array(plan.entry_m), np.array(plan.target_m)
    if np.array_equal(*way):
        raise ValueError(
            f"entry_m and target_m are the same point {list(plan.entry_m)}"
        )
    if not files:
        if not plan.layers:
            raise ValueError(
                "no layers in it, nor labels.nii.gz, .nrrd or a .seg.nrrd beside it"
            )
        return PlanScene((), (), *way, turn, shift), []
    labels = read_labels(files[0])
    with progress_bar("surfaces") as progress:
        large = [item.name for item in labels.structures if item.voxels >= LEAST_VOXELS]
        made = tuple(labels.surfaces(large, progress).values())
    layers = [] if plan.layers else labels.layers_along(*way)
    return PlanScene(made, (), *way, turn, shift), layers


def _given(plan: _PlanFile) -> list[Layer]:
    """The layers that stand in the file itself."""
    found = []
    depth_m = plan.start_m
    std_m = 0.0
    for one in plan.layers:
        if not one.exit_m > depth_m:
            raise ValueError(
                f"{one.name!r} ends at {one.exit_m} m, not below where it begins"
            )
        found.append(
            Layer(one.name, depth_m, one.exit_m, std_m, one.exit_std_m, one.is_obstacle)
        )
        depth_m = one.exit_m
        std_m = one.exit_std_m
    return found
