"""`needleforce live`: an arm is watched."""

import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

from needleforce.cli.arms.arm_connection import (
    NO_TORQUES,
    ROBOTS,
    open_arm,
    require_samples,
    samples_until_stopped,
)
from needleforce.cli.auto_tare import SessionTare
from needleforce.cli.plan_file import Planned, read_plan
from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.shared_options import ArmOptions, Direction, RobotOptions
from needleforce.cli.terminal import CommandError, say, write_out
from needleforce.devices import (
    NetFT,
)
from needleforce.reference_force import ReferenceForce
from needleforce.session import InsertionSession, SessionEstimate
from urdf import Robot

PANEL_s = 0.1


LINE_s = 1.0
"""Between two pictures on a terminal, and two lines elsewhere."""


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


class ReferenceSensor(NamedTuple):
    """A force sensor beside the session.

    Attributes:
        address: Host of the ATI Net F/T.
        axis: Direction of insertion in the sensor's axes.
    """

    address: str
    axis: Direction

    @contextmanager
    def opened(self) -> Iterator[ReferenceForce]:
        """Open the connection; its report is printed when it is closed."""
        with NetFT(self.address) as sensor:
            yield ReferenceForce(sensor, self.axis)
            say(f"reference: {sensor.report}")


@contextmanager
def _page(
    kind: str, port: int, model: Robot, plan: Planned | None, robot: RobotOptions
) -> Iterator[Any]:
    """The scene beside the session."""
    from needleforce.scene import SceneError, open_viewer
    from needleforce.scene.nodes import EMPTY

    if robot.robot is None and robot.urdf is None:
        robot = replace(robot, robot=ROBOTS.get(kind))
    scene = EMPTY if plan is None else plan.scene
    try:
        view = open_viewer(model, scene, urdf_path=urdf_with_shapes(robot), port=port)
    except SceneError as error:
        raise CommandError(str(error)) from error
    with view:
        say(f"{view.url} shows the scene")
        yield view


def watch_arm(
    arm_name: str,
    options: ArmOptions,
    robot: RobotOptions,
    *,
    tare_s: float,
    plan_path: Path | None = None,
    reference_sensor: ReferenceSensor | None = None,
    page_port: int | None = None,
) -> int:
    """Watch force and layers of an arm.

    Args:
        arm_name: The arm as a user names it.
        options: How long it is watched.
        robot: Options that describe the robot.
        tare_s: Motion without contact before a tare [s].
        plan_path: Plan to match ruptures with, if any.
        reference_sensor: Force sensor to compare with, if any.
        page_port: Port of the scene beside the session; None for no scene.

    Returns:
        The exit code.
    """
    tare = SessionTare(tare_s)
    kind = arm_name.partition(":")[0]
    plan = None if plan_path is None else read_plan(plan_path)
    with (
        open_arm(arm_name, robot, options.motor_constants) as (arm, model),
        nullcontext()
        if reference_sensor is None
        else reference_sensor.opened() as reference,
        nullcontext()
        if page_port is None
        else _page(kind, page_port, model, plan, robot) as page,
    ):
        session = InsertionSession(model)
        if plan is not None:
            session.follow(plan.match, plan.entry_in_base_m)
        view = _Watch(arm, reference)
        with _panel() if sys.stdout.isatty() else nullcontext() as panel:
            for sample in samples_until_stopped(arm, options):
                if sample.tau_Nm is None:
                    raise CommandError(f"{arm_name}: {NO_TORQUES}")
                now = session.update(
                    sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
                )
                if reference is not None:
                    reference.update(now.wrench)
                is_tared = tare.after(session, now)
                if is_tared and reference is not None and not reference.zero():
                    address = reference_sensor.address if reference_sensor else ""
                    say(f"{address} had sent nothing at the tare: no reference")
                view.show(now, panel)
                if page is not None:
                    page.put(now, sample.q_rad)
    require_samples(arm_name, arm)
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
