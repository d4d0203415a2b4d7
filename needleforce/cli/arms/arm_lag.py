"""The delay of an arm, measured by moving it: `needleforce lag`."""

import json

from foundation.jit import compile_waiting
from needleforce.cli.arms.arm_connection import ask_to_move, limits_of, open_arm
from needleforce.cli.shared_options import RobotOptions
from needleforce.cli.terminal import write_out
from needleforce.control.lag import (
    Delay,
    PHASE_MARGIN_deg,
    SafeGain,
    find_safe_gain,
    measure_lag,
)
from needleforce.control.tasks import GAIN_PER_S
from urdf import Robot

S_TO_MS = 1e3


def measure_arm(
    arm_name: str, options: RobotOptions, *, is_confirmed: bool, as_json: bool
) -> int:
    """Measure the delay of an arm and print it, with the largest safe gain.

    Args:
        arm_name: The arm as the command line names it.
        options: Options that describe the robot.
        is_confirmed: Whether the arm may move without a question.
        as_json: Whether JSON is printed.

    Returns:
        The exit code.

    Raises:
        CommandError: The user says no.
        ControlError: It cannot be measured: see the message.
    """
    if not is_confirmed:
        ask_to_move(
            arm_name,
            f"All joints of {arm_name} will move for 4 s, the tip by at most 5 mm "
            "either way.",
        )
    compile_waiting()  # before the arm is open: a UR stops after 0.1 s of silence
    with open_arm(arm_name, options, takes_commands=True) as connected:
        arm, robot = connected
        delays = measure_lag(arm, robot, limits_of(connected))
    slowest = max(delays, key=lambda delay: delay.delay_s + delay.std_s)
    gain = find_safe_gain(slowest)
    describe = _as_json if as_json else _as_text
    write_out(describe(robot, delays, gain, slowest.cycle_s) + "\n")
    return 0


def _as_json(robot: Robot, delays: list[Delay], gain: SafeGain, cycle_s: float) -> str:
    """Return the result as JSON; times in ms, gains in 1/s."""
    joints = [
        {
            "joint": name,
            "delay_ms": S_TO_MS * delay.delay_s,
            "std_ms": S_TO_MS * delay.std_s,
            "followed": delay.followed,
        }
        for name, delay in zip(robot.joint_names, delays, strict=True)
    ]
    result = {
        "joints": joints,
        "cycle_ms": S_TO_MS * cycle_s,
        "safe_gain_per_s": gain.safe_per_s,
        "unstable_gain_per_s": gain.unstable_per_s,
        "phase_margin_deg": PHASE_MARGIN_deg,
        "usual_gain_per_s": GAIN_PER_S,
    }
    return json.dumps(result, indent=2)


def _as_text(robot: Robot, delays: list[Delay], gain: SafeGain, cycle_s: float) -> str:
    """Return the result in lines to be read."""
    lines = [
        f"{name}: {S_TO_MS * delay.delay_s:.2f} ± {S_TO_MS * delay.std_s:.2f} ms"
        for name, delay in zip(robot.joint_names, delays, strict=True)
    ]
    usual = (
        "is safe" if gain.safe_per_s >= GAIN_PER_S else "is too high: pass gain_per_s"
    )
    lines += [
        f"cycle {S_TO_MS * cycle_s:.2f} ms",
        f"largest safe gain {gain.safe_per_s:.1f} / s (phase margin "
        f"{PHASE_MARGIN_deg:.0f} degrees); unstable from {gain.unstable_per_s:.0f} / s",
        f"the usual gain of {GAIN_PER_S:g} / s {usual}",
    ]
    return "\n".join(lines)
