"""`needleforce record` and `needleforce live`: an arm's joint signals into a file,
or watched.
"""

import signal
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from groundtruth import simulate
from needleforce.cli.live_options import LiveOptions, WatchOptions
from needleforce.cli.live_recorder import Recorder
from needleforce.cli.live_view import SessionTare, description, read_plan
from needleforce.cli.options import RobotOptions
from needleforce.cli.robot import robot_from_options
from needleforce.cli.terminal import (
    CommandError,
    progress_bar,
    say,
    stop_request,
    write_out,
)
from needleforce.devices import (
    ArmSample,
    FrankaArm,
    FriArm,
    NetFT,
    ReplayArm,
    UrArm,
    paced,
)
from needleforce.reference_force import ReferenceForce
from needleforce.session import InsertionSession, SessionEstimate
from urdf import Robot

PANEL_s = 0.1
LINE_s = 1.0
"""Between two pictures on a terminal, and two lines elsewhere."""
ROBOTS = {
    "fri": "lwr",
    "franka": "panda",
    "ur": "ur10e",
}  # Of a kind of arm, unless described
NO_TORQUES = (
    "a UR sends motor currents, no torques: give --motor-constants K1 ... K6 [Nm/A]; "
    "docs/panda.md has those of one arm, and its friction"
)


@contextmanager
def arm_named(
    text: str, options: RobotOptions, constants_Nm_A: tuple[float, ...] | None = None
) -> Iterator[tuple[Any, Robot]]:
    """Open the arm that a user names, with its model; it is closed in the end."""
    kind, _, rest = text.partition(":")
    if constants_Nm_A is not None and kind != "ur":
        raise CommandError(f"--motor-constants describes a ur:ADDRESS, not {text}")
    if kind == "sim":
        if options not in (RobotOptions(), RobotOptions(robot="lwr")):
            raise CommandError(
                f"{text} simulates an LWR 4+ with its needle; leave the options of the robot out"
            )
        with progress_bar("simulating"):
            run = simulate(rest or "stack-glove-constant", plant="clean")
        signals = run.signals
        dt_s = np.diff(signals.t_s, prepend=2.0 * signals.t_s[0] - signals.t_s[1])
        yield (
            ReplayArm(dt_s, signals.q_rad, signals.dq_rad_s, signals.tau_Nm),
            run.robot,
        )
        return
    is_port = rest.isdecimal() or not rest
    if kind not in ROBOTS or (not is_port if kind == "fri" else not rest):
        raise CommandError(
            f"{text}: expected an arm as fri, fri:PORT, franka:ADDRESS, ur:ADDRESS or sim:SCENARIO"
        )
    if options.robot is None and options.urdf is None:
        options = replace(options, robot=ROBOTS[kind])
        say(
            f"{text} is taken for the arm {options.robot!r}; --robot or --urdf names another"
        )
    robot = robot_from_options(options, None)
    if kind == "fri":
        arm: Any = FriArm(port=int(rest)) if rest else FriArm()
    else:
        is_ur = kind == "ur"
        arm = (
            UrArm(rest, torque_constant_Nm_A=constants_Nm_A)
            if is_ur
            else FrankaArm(rest)
        )
    with arm:
        if arm.joints != robot.nv:
            raise CommandError(
                f"{text} has {arm.joints} joints, the robot that describes it {robot.nv}: "
                "name another with --robot or --urdf"
            )
        yield arm, robot


def _until(arm: Any, options: LiveOptions) -> Iterator[ArmSample]:
    """Samples until the time is over, the arm stays away, or Ctrl-C, SIGTERM or
    SIGHUP.
    """
    if not options.seconds > 0.0:
        raise CommandError(f"--seconds {options.seconds}: expected a positive time")
    # What nohup has the process ignore does not end it; else a signal does while
    # nothing comes.
    others = [
        n
        for n in (signal.SIGTERM, signal.SIGHUP)
        if signal.getsignal(n) != signal.SIG_IGN
    ]
    passed_s = 0.0
    with stop_request(*others, then=arm.end) as is_asked:
        for sample in paced(arm) if isinstance(arm, ReplayArm) else arm:
            passed_s += sample.dt_s
            yield sample
            if passed_s >= options.seconds or is_asked():
                return


def _require_samples(arm_name: str, arm: Any) -> None:
    if not arm.report.used:
        raise CommandError(
            f"no sample came from {arm_name} ({arm.report}): expected one per cycle; does the arm "
            "run, and does it send to this machine and port?"
        )


def record(
    arm_name: str, output: Path, options: LiveOptions, robot: RobotOptions
) -> int:
    """Write the joint signals of an arm as they come; return the exit code."""
    has_torque = True
    with (
        arm_named(arm_name, robot, options.motor_constants) as (arm, model),
        Recorder(output, model.joint_names) as to,
    ):
        for sample in _until(arm, options):
            to.put(sample)
            has_torque = sample.tau_Nm is not None
    _require_samples(arm_name, arm)
    say(f"{to.rows} samples, {to.time_s:.3f} s in {output}; {arm.report}")
    if not has_torque:
        say(f"warning: {output} holds no joint torques: {NO_TORQUES}")
    return 0


class _Watch:
    """What a session knows, as a panel on a terminal or a line a second elsewhere."""

    def __init__(self, arm: Any, reference: ReferenceForce | None) -> None:
        self._arm = arm
        self._reference = reference
        self._next_s = 0.0
        self._events: list[str] = []

    def show(self, now: SessionEstimate, live: Any) -> None:
        for text in _events(now):
            self._events.append(text)
            if live is None:
                write_out(f"{text}\n")
        if now.time_s < self._next_s:
            return
        self._next_s = now.time_s + (LINE_s if live is None else PANEL_s)
        lines = self._lines(now)
        if live is None:
            write_out("  ".join(lines[: 3 if now.plan is None else 4]) + "\n")
        else:
            live.update("\n".join(lines))

    def _lines(self, now: SessionEstimate) -> list[str]:
        wrench = now.wrench
        found = now.identification
        depth = f"depth {1e3 * now.depth_m:6.1f} mm  layer {found.layer}"
        beside = (
            "" if self._reference is None else f" ({_reference_words(self._reference)})"
        )
        return [
            f"{now.time_s:8.1f} s  {now.status}",
            f"force {wrench.axial:6.2f} ± {min(wrench.axial_std, 99.0):.3f} N{beside}",
            f"tip {found.tip_force_N:6.2f} N  {depth}",
            *(() if now.plan is None else (_plan_words(now.plan),)),
            *self._events[-5:],
            str(now.warnings or ""),
            wrench.message,
            f"link: {self._arm.report}",
        ]


def _events(now: SessionEstimate) -> Iterator[str]:
    """What this tick has brought, in words."""
    found = now.identification
    plan = now.plan
    if (rupture := found.rupture) is not None:
        chance = f"{100.0 * rupture.probability:.0f} %"
        text = f"rupture of layer {rupture.layer} at {1e3 * rupture.depth_m:.1f} mm ({chance})"
        if plan is not None:
            where = (
                f"into {plan.matched_name}" if plan.matched >= 0 else plan.matched_name
            )
            text += f", by the plan {where} ({100.0 * plan.matched_probability:.0f} %)"
        yield text
    if found.retracted is not None:
        yield f"no rupture of layer {found.retracted.layer} after all: the force came back"


def _reference_words(reference: ReferenceForce) -> str:
    return (
        f"reference {reference.axial_N:.2f} N, rms difference {reference.rms_N:.3f} N"
    )


def _plan_words(plan: Any) -> str:
    text = f"in {plan.name} ({100.0 * plan.probability:.0f} %)"
    if plan.next_name:
        text += f", {plan.next_name} at {1e3 * plan.next_m:.1f} ± {1e3 * plan.next_std_m:.1f} mm"
    return (
        f"{text}, offset {1e3 * plan.offset_m:+.1f} ± {1e3 * plan.offset_std_m:.1f} mm"
    )


@contextmanager
def _reference(address: str, watched: WatchOptions) -> Iterator[ReferenceForce]:
    """The force sensor beside the session."""
    with NetFT(address) as sensor:
        yield ReferenceForce(sensor, watched.reference_axis)
        say(f"reference: {sensor.report}")


@contextmanager
def _page(
    kind: str, watched: WatchOptions, model: Robot, plan: Any, robot: RobotOptions
) -> Iterator[Any]:
    """The scene beside the session."""
    from needleforce.scene import SceneError, open_viewer
    from needleforce.scene.nodes import EMPTY

    if robot.robot is None and robot.urdf is None:
        robot = replace(robot, robot=ROBOTS.get(kind))
    scene = EMPTY if plan is None else plan.scene
    try:
        view = open_viewer(
            model, scene, urdf_path=description(robot), port=watched.port
        )
    except SceneError as error:
        raise CommandError(str(error)) from error
    with view:
        say(f"{view.url} shows the scene")
        yield view


def watch_arm(
    arm_name: str, options: LiveOptions, watched: WatchOptions, robot: RobotOptions
) -> int:
    """Watch force and layers of an arm; return the exit code."""
    tare = SessionTare(watched.tare)
    kind = arm_name.partition(":")[0]
    address = watched.reference
    plan = None if watched.plan is None else read_plan(watched.plan)
    with (
        arm_named(arm_name, robot, options.motor_constants) as (arm, model),
        _reference(address, watched)
        if address is not None
        else nullcontext() as reference,
        _page(kind, watched, model, plan, robot)
        if watched.view
        else nullcontext() as page,
    ):
        session = InsertionSession(model)
        if plan is not None:
            session.follow(plan.match, plan.entry_in_base_m)
        view = _Watch(arm, reference)
        with _panel() if sys.stdout.isatty() else nullcontext() as panel:
            for sample in _until(arm, options):
                if sample.tau_Nm is None:
                    raise CommandError(f"{arm_name}: {NO_TORQUES}")
                now = session.update(
                    sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
                )
                if reference is not None:
                    reference.update(now.wrench)
                if (
                    tare.after(session, now)
                    and reference is not None
                    and not reference.zero()
                ):
                    say(
                        f"{watched.reference} had sent nothing at the tare: no reference"
                    )
                view.show(now, panel)
                if page is not None:
                    page.put(now, sample.q_rad)
    _require_samples(arm_name, arm)
    if reference is not None:
        say(f"{_reference_words(reference)} of {reference.count} ticks since the tare")
    say(f"{arm.report}; {session.rejected} samples rejected by the session")
    return 0


@contextmanager
def _panel() -> Iterator[Any]:
    """A place on the terminal that is written over."""
    from rich.live import Live

    with Live("", refresh_per_second=1.0 / PANEL_s) as panel:
        yield panel
        time.sleep(PANEL_s)
