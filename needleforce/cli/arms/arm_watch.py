"""`needleforce live`: a session beside an arm, in words and in the scene."""

import math
import sys
import time
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

from needleforce.anatomy import PlanState
from needleforce.anatomy.plan_match import OFF_PLAN_LAYER
from needleforce.cli.arms.arm_connection import (
    NO_TORQUES,
    ROBOTS,
    samples_until_stopped,
    say_silence,
)
from needleforce.cli.arms.arm_stroke import TareOptions, open_tared_arm
from needleforce.cli.auto_tare import auto_tare
from needleforce.cli.plan_option import load_plan
from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.shared_options import ArmOptions, Direction, RobotOptions
from needleforce.cli.terminal import (
    CHECK_ARM,
    CommandError,
    say,
    write_out,
)
from needleforce.depth_zero import DepthZero, find_depth_zero
from needleforce.devices import ArmReading, NetFT
from needleforce.devices.rdt import describe_status
from needleforce.insertion_events import describe_hard_contact
from needleforce.needle_on_plan import describe_clearances, describe_deviation
from needleforce.plan_file import LoadedPlan
from needleforce.reference_force import ReferenceForce
from needleforce.session import InsertionSession, SessionEstimate
from urdf import Robot

PANEL_S = 0.1
"""Time between two pictures on a terminal [s]."""


M_TO_MM = 1e3


class Display:
    """What a session estimates: a panel on a terminal, a line a second elsewhere.

    Args:
        arm: The arm, which reports on its link.
        reference: Force sensor beside the session, if any.
        panel: The panel; None where standard output is no terminal.
    """

    def __init__(
        self, arm: Any, reference: ReferenceForce | None, panel: Any | None
    ) -> None:
        self._arm = arm
        self._reference = reference
        self._panel = panel
        self._next_s = 0.0
        self._events: list[str] = []
        self._values: list[str] = []

    def update(self, estimate: SessionEstimate) -> None:
        """Show events at once, and all the rest when it is time."""
        shown_events = 5  # Latest events that the panel shows
        line_s = 1.0  # Time between two lines where standard output is no terminal [s]
        for event in describe_events(estimate):
            self._events.append(event)
            if self._panel is None:
                write_out(f"{event}\n")
        if estimate.time_s < self._next_s:
            return
        self._values = self._describe_values(estimate)
        if self._panel is None:
            self._next_s = estimate.time_s + line_s
            write_out("  ".join(self._values) + "\n")
        else:
            self._next_s = estimate.time_s + PANEL_S
            self._values += self._events[-shown_events:]
            self._values += [str(estimate.warnings or ""), estimate.wrench.message]
            self._panel.update("\n".join([*self._values, f"link: {self._arm.report}"]))

    def show_silence(self, silent_s: float) -> None:
        """Show how long nothing has come, in place of a status that has gone stale."""
        if self._panel is None:
            say_silence(silent_s)
        else:
            lines = [f"silent {silent_s:.1f} s", *self._values[1:]]
            self._panel.update("\n".join([*lines, f"link: {self._arm.report}"]))

    def _describe_values(self, estimate: SessionEstimate) -> list[str]:
        """Return time, forces, depth and plan in words."""
        max_std_N = 99.0  # Largest standard deviation that is printed [N]
        wrench = estimate.wrench
        identification = estimate.identification
        std_N = min(wrench.axial_std, max_std_N)
        force = f"force {wrench.axial:6.2f} ± {std_N:.3f} N"
        if self._reference is not None:
            force += f" ({describe_reference(self._reference)})"
        zero = find_depth_zero(estimate)
        depth_mm = zero.shown_mm(estimate.depth_m)
        values = [
            f"{estimate.time_s:8.1f} s  {estimate.status}",
            force,
            f"tip {identification.tip_force_N:6.2f} N  "
            f"depth {depth_mm:6.1f} mm {zero.name}  layer {identification.layer}",
        ]
        if estimate.plan is not None:
            values.append(describe_plan(estimate.plan, zero))
        if estimate.deviation is not None:
            values.append(describe_deviation(estimate.deviation))
        if estimate.clearances:
            values.append(describe_clearances(estimate.clearances))
        return values


def describe_events(estimate: SessionEstimate) -> Iterator[str]:
    """Yield in words what was detected or retracted at this sample."""
    for event in estimate.plan_events:
        yield event.text
    rupture = estimate.identification.rupture
    if rupture is not None:
        zero = find_depth_zero(estimate)
        text = (
            f"rupture of layer {rupture.layer} at {zero.shown_mm(rupture.depth_m):.1f} "
            f"mm {zero.name} "
            f"({_percent(rupture.probability)})"
        )
        plan = estimate.plan
        if plan is not None and plan.layer == OFF_PLAN_LAYER:
            text += ", off plan"
        elif plan is not None:
            match = plan.matched_name
            if plan.matched >= 0:
                match = f"into {match}"
            text += f", by the plan {match} ({_percent(plan.matched_probability)})"
        yield text
    retracted = estimate.identification.retracted
    if retracted is not None:
        yield f"no rupture of layer {retracted.layer} after all: the force came back"
    contact = estimate.identification.hard_contact
    if contact is not None:
        yield describe_hard_contact(contact)


def describe_reference(reference: ReferenceForce) -> str:
    """Return the force of a reference sensor and its difference from the estimate."""
    return (
        f"reference {reference.axial_N:.2f} N, rms difference {reference.rms_N:.3f} N"
    )


def describe_plan(plan: PlanState, zero: DepthZero) -> str:
    """Return where the tip is by the plan, what comes next, and the plan's offset."""
    if plan.layer == OFF_PLAN_LAYER:
        return "no layer is named off the plan"
    text = f"in {plan.name} ({_percent(plan.probability)})"
    if plan.next_name:
        next_mm = zero.shown_mm(plan.next_m)
        next_std_mm = M_TO_MM * plan.next_std_m
        text += f", {plan.next_name} at {next_mm:.1f} ± {next_std_mm:.1f} mm"
    offset_mm = M_TO_MM * plan.offset_m
    offset_std_mm = M_TO_MM * plan.offset_std_m
    return f"{text}, offset {offset_mm:+.1f} ± {offset_std_mm:.1f} mm"


def _percent(probability: float) -> str:
    return f"{100.0 * probability:.0f} %"


class ReferenceSensor:
    """A force sensor beside the session.

    Where the arm's own stroke has tared the session, the sensor has read nothing yet:
    it is zeroed once it has had half a second to do so.

    Args:
        address: Host of the ATI Net F/T.
        axis: Direction of insertion in the sensor's axes.
    """

    def __init__(self, address: str, axis: Direction) -> None:
        self._address = address
        self._axis = axis
        self._zero_due_s = math.inf

    @contextmanager
    def opened(self, *, is_tared: bool) -> Iterator[ReferenceForce]:
        """Open the connection; its report is printed when it is closed."""
        # A sensor at 1 kHz gives in this time all readings that make its zero.
        zero_s = 0.5
        self._zero_due_s = zero_s if is_tared else math.inf
        with NetFT(self._address) as sensor:
            sensor.on_silence = partial(say_silence, what="reference: ")
            yield ReferenceForce(sensor, self._axis)
            faults = f"; {describe_status(sensor.faults)}" if sensor.faults else ""
            say(f"reference: {sensor.report}{faults}")

    def update(
        self,
        reference: ReferenceForce,
        estimate: SessionEstimate,
        dt_s: float,
        *,
        is_tared_now: bool,
    ) -> None:
        """Read the sensor beside an update of the session; zero it if it is time."""
        reference.update(estimate.wrench)
        self._zero_due_s -= dt_s
        if is_tared_now or self._zero_due_s <= 0.0:
            self._zero_due_s = math.inf
            if not reference.zero():
                say(f"{self._address} had sent nothing at the tare: no reference")


def _open_page(
    kind: str, port: int, model: Robot, plan: LoadedPlan | None, robot: RobotOptions
) -> Any:
    """Return the page of the scene beside the session."""
    from needleforce.scene import open_viewer
    from needleforce.scene.nodes import EMPTY

    if robot.robot is None and robot.urdf is None:
        robot = replace(robot, robot=ROBOTS.get(kind))
    scene = EMPTY if plan is None else plan.scene
    say("opening the scene ...")
    return open_viewer(model, scene, urdf_path=urdf_with_shapes(robot), port=port)


@contextmanager
def _open_panel() -> Iterator[Any]:
    """Open a place on the terminal that is written over; None where there is none."""
    if not sys.stdout.isatty():
        yield None
        return
    from rich.live import Live

    with Live("", refresh_per_second=1.0 / PANEL_S) as panel:
        yield panel
        time.sleep(PANEL_S)


def watch_arm(
    arm_name: str,
    options: ArmOptions,
    robot: RobotOptions,
    *,
    taring: TareOptions,
    plan_path: Path | None = None,
    situs_inversus: bool = False,
    reference_sensor: ReferenceSensor | None = None,
    page_port: int | None = None,
) -> int:
    """Watch force and layers of an arm.

    Args:
        arm_name: The arm as the command line names it.
        options: For how long the arm is listened to.
        robot: Options that describe the robot.
        taring: When, and from what motion, the session is tared.
        plan_path: Plan to match ruptures with, if any.
        situs_inversus: Liver and spleen of the patient are exchanged.
        reference_sensor: Force sensor to compare with, if any.
        page_port: Port of the scene beside the session; None for no scene.

    Returns:
        The exit code.

    Raises:
        CommandError: The arm sends nothing, or no torques.
        LinkError: The arm is lost.
    """
    tare = auto_tare(taring.after_s)
    constants_Nm_A = options.motor_constants
    plan = load_plan(plan_path, situs_inversus=situs_inversus)
    with ExitStack() as stack:
        connected, session = stack.enter_context(
            open_tared_arm(arm_name, robot, constants_Nm_A, taring)
        )
        arm = connected.arm
        reference = page = None
        if reference_sensor is not None:
            opened = reference_sensor.opened(is_tared=session.tared)
            reference = stack.enter_context(opened)
        if page_port is not None:
            kind = arm_name.partition(":")[0]
            page = stack.enter_context(
                _open_page(kind, page_port, connected.robot, plan, robot)
            )
            say(f"{page.url} shows the scene")
        if plan is not None:
            plan.follow_with(session)
        display = Display(arm, reference, stack.enter_context(_open_panel()))
        samples = samples_until_stopped(arm, options, show_silence=display.show_silence)
        for sample, estimate in _estimates(arm_name, samples, session):
            is_tared_now = tare.after(session, estimate)
            if reference_sensor is not None and reference is not None:
                reference_sensor.update(
                    reference, estimate, sample.dt_s, is_tared_now=is_tared_now
                )
            display.update(estimate)
            if page is not None:
                page.put(estimate, sample.q_rad)
    if reference is not None:
        say(
            f"{describe_reference(reference)} of {reference.count} ticks since the tare"
        )
    say(f"{arm.report}; {session.rejected} samples rejected by the session")
    return 0


def _estimates(
    arm_name: str, samples: Iterable[ArmReading], session: InsertionSession
) -> Iterator[tuple[ArmReading, SessionEstimate]]:
    """Yield each sample with what the session makes of it."""
    for sample in samples:
        if sample.tau_Nm is None:
            raise CommandError(f"{arm_name}: {NO_TORQUES}", CHECK_ARM)
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        yield sample, estimate
