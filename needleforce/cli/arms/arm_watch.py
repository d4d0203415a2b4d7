"""`needleforce live`: a session beside an arm, in words and in the scene."""

import math
from collections.abc import Iterable, Iterator
from contextlib import ExitStack, contextmanager
from functools import partial
from pathlib import Path

from foundation.jit import compile_waiting
from groundtruth.rig_arm import ArmSample, SimulatedArm
from needleforce.cli.arms.arm_connection import (
    NO_TORQUES,
    OpenedArm,
    ask_to_move,
    limits_of,
    open_arm,
    samples_until_stopped,
    say_silence,
)
from needleforce.cli.options import ArmOptions, Direction, RobotOptions
from needleforce.cli.robot import urdf_with_shapes
from needleforce.cli.session_parts import auto_tare, load_plan
from needleforce.cli.terminal import CHECK_ARM, CommandError, say, write_out
from needleforce.control.tare_stroke import tare_with_stroke
from needleforce.devices import ArmReading, LinkReport, NetFT
from needleforce.devices.rdt import describe_status
from needleforce.insertion_events import session_events
from needleforce.reference_force import ReferenceForce
from needleforce.scene import open_viewer
from needleforce.scene.nodes import EMPTY
from needleforce.scene.words import describe_state
from needleforce.session import InsertionSession, SessionEstimate
from needleforce.tare_run import AutoTare

MEAN_SPEED_m_s = 0.01
"""Mean speed of a stroke: slow, as an insertion is, since friction depends on it."""

MIN_LEG_S = 10.0
"""Time of a stroke each way, at least."""

M_TO_MM = 1e3


def watch_arm(
    arm_name: str,
    options: ArmOptions,
    robot: RobotOptions,
    *,
    plan_place: Path | None,
    reference_address: str | None,
    reference_axis: Direction,
    port: int | None,
    tare_s: float,
    stroke_m: float | None,
    is_confirmed: bool,
) -> int:
    """Watch force and layers of an arm.

    Args:
        arm_name: The arm as the command line names it.
        options: For how long the arm is listened to.
        robot: Options that describe the robot.
        plan_place: The plan that is followed, if any.
        reference_address: Of a force sensor between flange and tool, if any.
        reference_axis: Direction of insertion in its axes.
        port: Of the page with the scene; None for no page.
        tare_s: Motion without contact before the tare.
        stroke_m: That the arm makes, and is tared from, before; None for none.
        is_confirmed: Whether it may move without a question.

    Returns:
        The exit code.

    Raises:
        CommandError: The arm sends nothing, or no torques; the user says no.
        LinkError: The arm is lost.
        ControlError: The arm has not moved as it should.
        TareError: The motion of the stroke is no free motion.
    """
    tare = auto_tare(tare_s)
    plan = load_plan(plan_place)
    with ExitStack() as stack:
        opened = _open_tared_arm(
            arm_name, robot, options, stroke_m, is_confirmed=is_confirmed
        )
        (arm, described), session = stack.enter_context(opened)
        reference = page = None
        if reference_address is not None:
            sensor = _open_reference(reference_address, reference_axis)
            reference = stack.enter_context(sensor)
        if port is not None:
            say("opening the scene ...")
            scene = EMPTY if plan is None else plan.scene
            shapes = urdf_with_shapes(described)
            viewer = open_viewer(arm.robot, scene, urdf_path=shapes, port=port)
            page = stack.enter_context(viewer)
            say(f"{page.url} shows the scene")
        if plan is not None:
            plan.follow_with(session)
        samples = samples_until_stopped(arm, options)
        next_s = 0.0
        for sample, estimate in _estimates(samples, session, tare, reference):
            next_s = show(estimate, reference, next_s)
            if page is not None:
                page.put(estimate, sample.q_rad)
    if reference is not None:
        say(
            f"{describe_reference(reference)} of {reference.count} ticks since the tare"
        )
    say(f"{arm.report}; {session.rejected} samples rejected by the session")
    return 0


def _estimates(
    samples: Iterable[ArmReading],
    session: InsertionSession,
    tare: AutoTare,
    reference: ReferenceForce | None,
) -> Iterator[tuple[ArmReading, SessionEstimate]]:
    """Yield each sample with what the session makes of it.

    A reference is zeroed with the tare. Where the arm's own stroke has tared the
    session, it has read nothing yet: then half a second later.
    """
    # A sensor at 1 kHz gives in half a second all readings that make its zero.
    zero_due_s = 0.5 if session.tared else math.inf
    for sample in samples:
        if sample.tau_Nm is None:
            raise CommandError(NO_TORQUES, CHECK_ARM)
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        zero_due_s -= sample.dt_s
        if tare.after(session, estimate):
            zero_due_s = 0.0
        if reference is not None:
            reference.update(estimate.wrench)
            if zero_due_s <= 0.0:
                zero_due_s = math.inf
                if not reference.zero():
                    say("the reference had sent nothing at the tare: no reference")
        yield sample, estimate


class _RestingArm:
    """A simulated arm that has moved, to be listened to like a connected one.

    Args:
        arm: The arm; it holds its place without commands.

    Attributes:
        robot: Its model.
        report: Of its samples.
        end: Ends them.
    """

    def __init__(self, arm: SimulatedArm) -> None:
        self.robot = arm.robot
        self.report = LinkReport()
        self.end = arm.close
        self._arm = arm

    def __iter__(self) -> Iterator[ArmSample]:
        for sample in self._arm:
            self.report.used += 1
            yield sample


@contextmanager
def _open_tared_arm(
    name: str,
    robot: RobotOptions,
    options: ArmOptions,
    stroke_m: float | None,
    *,
    is_confirmed: bool,
) -> Iterator[tuple[OpenedArm, InsertionSession]]:
    """Open an arm to be listened to; before, if asked, move it and tare.

    Yields the arm, and the session, which is not tared without a stroke. A simulated
    arm stays the one that has moved; any other is given back and opened anew, so that
    its user may move it.

    Args:
        name: The arm as the command line names it.
        robot: Options that describe the robot.
        options: Motor constants of a UR.
        stroke_m: That the arm makes, and is tared from; None for none.
        is_confirmed: Whether it may move without a question.

    Raises:
        CommandError: The user says no, or the arm sends no torques.
    """
    constants_Nm_A = options.motor_constants
    session = None
    if stroke_m is not None:
        if name.startswith("ur:") and constants_Nm_A is None:
            raise CommandError(f"{name}: {NO_TORQUES}", CHECK_ARM)
        leg_s = max(stroke_m / MEAN_SPEED_m_s, MIN_LEG_S)
        text = (
            f"{name} will draw the needle back by {M_TO_MM * stroke_m:.0f} mm and "
            f"return in {2.0 * leg_s:.0f} s."
        )
        if not is_confirmed:
            ask_to_move(name, f"{text} Leave room for the elbow beside the arm.")
        compile_waiting()  # before the arm is open: a UR stops after 0.1 s of silence
        opened = open_arm(name, robot, constants_Nm_A, takes_commands=True)
        with opened as (arm, described):
            session = InsertionSession(arm.robot)
            say(text)
            tare_with_stroke(
                arm,
                session,
                limits_of(arm),
                stroke_m=stroke_m,
                leg_s=leg_s,
                robot=arm.robot,
            )
            say("tared")
            if isinstance(arm, SimulatedArm):
                yield OpenedArm(_RestingArm(arm), described), session
                return
    with open_arm(name, robot, constants_Nm_A) as opened_arm:
        yield opened_arm, session or InsertionSession(opened_arm.arm.robot)


@contextmanager
def _open_reference(address: str, axis: Direction) -> Iterator[ReferenceForce]:
    """Open a force sensor beside the session; its report is printed at the end."""
    with NetFT(address) as sensor:
        sensor.on_silence = partial(say_silence, what="reference: ")
        yield ReferenceForce(sensor, axis)
        faults = f"; {describe_status(sensor.faults)}" if sensor.faults else ""
        say(f"reference: {sensor.report}{faults}")


def show(
    estimate: SessionEstimate, reference: ReferenceForce | None, next_s: float
) -> float:
    """Print what happened with a sample, and the state once a second.

    Returns:
        The time of the session at which the next line is due.
    """
    for event in session_events(estimate):
        if event.kind != "layer":
            write_out(f"{event.text}\n")
    if estimate.time_s < next_s:
        return next_s
    state = [*describe_state(estimate)]
    if reference is not None:
        state.append(describe_reference(reference))
    state += [str(estimate.warnings or ""), estimate.wrench.message]
    write_out("  ".join(filter(None, state)) + "\n")
    return estimate.time_s + 1.0


def describe_reference(reference: ReferenceForce) -> str:
    """Return the force of a reference sensor and its difference from the estimate."""
    return (
        f"reference {reference.axial_N:.2f} N, rms difference {reference.rms_N:.3f} N"
    )
