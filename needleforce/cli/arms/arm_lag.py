"""The delay of an arm, measured by moving it: `needleforce lag`."""

from foundation.jit import compile_waiting
from needleforce.cli.arms.arm_connection import ask_to_move, limits_of, open_arm
from needleforce.cli.options import RobotOptions
from needleforce.cli.terminal import aligned, json_text, say, write_out
from needleforce.control.lag import PHASE_MARGIN_deg, find_safe_gain, measure_lag
from needleforce.control.tasks import GAIN_PER_S

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
    with open_arm(arm_name, options, takes_commands=True) as (arm, _):
        delays = measure_lag(arm, arm.robot, limits_of(arm))
    slowest = max(delays, key=lambda delay: delay.delay_s + delay.std_s)
    gain = find_safe_gain(slowest)
    joints = [
        {
            "joint": name,
            "delay_ms": S_TO_MS * delay.delay_s,
            "std_ms": S_TO_MS * delay.std_s,
            "followed": delay.followed,
        }
        for name, delay in zip(arm.robot.joint_names, delays, strict=True)
    ]
    numbers = {
        "cycle_ms": S_TO_MS * slowest.cycle_s,
        "safe_gain_per_s": gain.safe_per_s,
        "unstable_gain_per_s": gain.unstable_per_s,
        "phase_margin_deg": PHASE_MARGIN_deg,
        "usual_gain_per_s": GAIN_PER_S,
    }
    if as_json:
        write_out(json_text({"joints": joints, **numbers}))
        return 0
    rows = {
        str(one["joint"]): f"{one['delay_ms']:.2f} ± {one['std_ms']:.2f} ms"
        for one in joints
    }
    write_out(aligned([*rows.items(), *((k, f"{v:.4g}") for k, v in numbers.items())]))
    if gain.safe_per_s < GAIN_PER_S:
        say("warning: the usual gain is too high for this arm: pass gain_per_s")
    return 0
