"""`needleforce touch`: landmarks and touches with the needle's tip, into a file."""

import select
import sys
from collections.abc import Iterator, Sequence
from contextlib import AbstractContextManager, nullcontext
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from needleforce.anatomy.markups import Markup, read_markup
from needleforce.anatomy.touch_detector import TipTouch, TouchDetector
from needleforce.cli.arms.arm_connection import (
    NO_TORQUES,
    OpenedArm,
    open_arm,
    samples_until_stopped,
)
from needleforce.cli.options import ArmOptions, PointOptions, RobotOptions
from needleforce.cli.patient import case_files
from needleforce.cli.terminal import CHECK_ARM, CommandError, progress_bar, say
from needleforce.recordings.output import require_place
from needleforce.simulation.patient import touch_patient
from residual import VirtualForceSensor
from urdf import Robot


def record_touches(
    arm_name: str,
    output: Path,
    options: ArmOptions,
    robot: RobotOptions,
    *,
    landmarks: Path | None,
    points: PointOptions,
    count: int,
    contact_N: float,
) -> int:
    """Write what the needle's tip touches into a file.

    Args:
        arm_name: The arm as the command line names it.
        output: The file.
        options: For how long the arm is listened to.
        robot: Options that describe the robot.
        landmarks: Points of the CT, which are touched first.
        points: What their file may leave unsaid.
        count: Of the touches of the skin after them.
        contact_N: Least force of a contact.

    Returns:
        The exit code.

    Raises:
        CommandError: Nothing was touched, or the arm sends no torques.
    """
    require_place(output)
    wanted = Markup((), np.zeros((0, 3)))
    if landmarks is not None:
        wanted = read_markup(landmarks, points.unit, points.frame)
    names = wanted.names
    places_m: list[Array] = []
    with _open_touching_arm(arm_name, robot, options, wanted.points_m) as (arm, _):
        say(f"rest in contact for a second, or press Enter{_next(names, places_m)}")
        try:
            for touch in _touches(arm, options, contact_N):
                if touch is None:
                    del places_m[-1:]
                    said = "undone"
                else:
                    places_m.append(touch.place_m)
                    place_mm = ", ".join(
                        f"{1e3 * value:.1f}" for value in touch.place_m
                    )
                    said = (
                        f"touch {len(places_m)} at {place_mm} mm, {touch.force_N:.1f} N"
                    )
                say(f"{said}{_next(names, places_m)}")
                if len(places_m) >= len(names) + count:
                    break
        finally:  # of an arm that was lost, too
            if places_m:
                _write_touches(output, names, places_m)
    if not places_m:
        raise CommandError(
            f"nothing was touched: the force never rose by {contact_N:g} N while the "
            "tip rested for a second",
            CHECK_ARM,
        )
    return 0


def _write_touches(
    output: Path, names: tuple[str, ...], places_m: Sequence[Array]
) -> None:
    """Write what was touched: landmarks of these names first, then the skin."""
    places = [tuple(place_m.tolist()) for place_m in places_m]
    touched = case_files.TouchFile(
        version=1,
        landmarks=tuple(map(case_files.LandmarkTouch, names, places)),
        touches_m=tuple(places[len(names) :]),
    )
    case_files.write_plan_fields(output, touched)
    say(
        f"{len(touched.landmarks)} of {len(names)} landmarks and "
        f"{len(touched.touches_m)} touches of the skin in {output}"
    )


def _next(names: tuple[str, ...], places_m: Sequence[Array]) -> str:
    """Return in words what is wanted next."""
    if len(places_m) < len(names):
        return f"; next: landmark {names[len(places_m)]!r}"
    return "; next: the skin, anywhere around the entry"


def _open_touching_arm(
    name: str, robot: RobotOptions, options: ArmOptions, landmarks_m: Array
) -> AbstractContextManager[OpenedArm]:
    """Open the arm that a user names, or a simulated one that touches a plan's patient.

    Args:
        name: The arm as the command line names it; sim:PLAN.json for the latter.
        robot: Options that describe the robot.
        options: Motor constants of a UR.
        landmarks_m: Points that the simulated arm touches first, shape (n, 3).
    """
    kind, _, plan = name.partition(":")
    if kind != "sim" or not plan.endswith(".json"):
        return open_arm(name, robot, options.motor_constants)
    fields = case_files.read_plan_fields(Path(plan))
    labels = case_files.case_of_plan(fields, Path(plan).parent).labels
    with progress_bar("simulating"):
        return nullcontext(OpenedArm(touch_patient(fields, labels, landmarks_m), robot))


def _touches(
    arm: Any, options: ArmOptions, contact_N: float
) -> Iterator[TipTouch | None]:
    """Yield touches as they come, None where the last one is undone."""
    robot: Robot = arm.robot
    sensor = VirtualForceSensor(robot)
    detector = TouchDetector(contact_N)
    data = robot.create_data()
    for sample in samples_until_stopped(arm, options, is_paced=False):
        if sample.tau_Nm is None:
            raise CommandError(NO_TORQUES, CHECK_ARM)
        wrench = sensor.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        pin.framesForwardKinematics(robot.model, data, np.asarray(sample.q_rad))
        tip_m = data.oMf[robot.tool_frame_id].translation.copy()
        touch = detector.update(sample.dt_s, tip_m, wrench.force)
        if touch is not None:
            yield touch
        key = _read_key()
        if key == "q":
            return
        if key == "u":
            yield None
        elif key is not None and (touch := detector.take_now()) is not None:
            yield touch


def _read_key() -> str | None:
    """Return the line that was typed, without its end; None for none."""
    if sys.stdin is None or not sys.stdin.isatty():
        return None
    if not select.select([sys.stdin], [], [], 0.0)[0]:
        return None
    return sys.stdin.readline().strip().lower()
