"""What a user of the command line may do about an error, by the error's code.

An error of a package brings advice for callers of the library. Here stands what the
command says in its place. A code without an entry has advice that names nothing of the
library, and serves both.
"""

from collections.abc import Iterable

from foundation.errors import Alternative, CodedError, Suspicion, fill_advice

_KEEP_TARE = "--force-tare keeps this tare, --no-tare goes without"

COMMAND_ADVICE: dict[str, str] = {
    "NF-SENSOR-SETTING": "Correct the value in the file of --config, or the option of "
    "that name",
    "NF-SENSOR-FRICTION": "Give one finite number for each joint in the file of "
    "--friction",
    "NF-SENSOR-MIXED": "Give a log in which every row has the same channels",
    "NF-SENSOR-CONTACT": "Choose where the needle is free with --tare START:END; "
    + _KEEP_TARE,
    "NF-SENSOR-GRAVITY-MISSING": f"Give --gravity-compensated; {_KEEP_TARE}",
    "NF-SENSOR-GRAVITY-TWICE": f"Leave --gravity-compensated out; {_KEEP_TARE}",
    "NF-SENSOR-TORQUE-SIGN": "Give --tau {tau_option}; " + _KEEP_TARE,
    "NF-SENSOR-TORQUE-SCALE": "Give --tau {tau_option}; " + _KEEP_TARE,
    "NF-SENSOR-GRAVITY-DIRECTION": "Give --gravity {gravity} alone, without --mount; "
    + _KEEP_TARE,
    "NF-SENSOR-TORQUE-KIND": "Leave --external-torque out and read the torques with "
    f"--tau; {_KEEP_TARE}",
    "NF-SENSOR-TORQUE-KIND-SIGN": "Leave --external-torque out and negate the torques, "
    f"as in --tau tau_*:Nm:-1; {_KEEP_TARE}",
    "NF-SENSOR-JOINT-ORDER": "List the columns in the robot's order: --tau "
    f"{{tau_option}}; {_KEEP_TARE}",
    "NF-SENSOR-POSITIONS": "Name the columns of all joints with --q; choose where the "
    f"needle is free with --tare START:END; {_KEEP_TARE}",
    "NF-SENSOR-PAYLOAD": "Describe hand and tool with --payload FILE: {payload}; "
    f"choose where the needle is free with --tare START:END; {_KEEP_TARE}",
    "NF-SENSOR-NO-FREE-MOTION": "Choose a longer window with --tare START:END, without "
    "gaps in time; --no-tare goes without",
    "NF-SENSOR-TARED-ALREADY": "Give one --tare",
    "NF-SENSOR-VELOCITY": "Give unit and factor of the columns, as in --q q_*:deg or "
    "--dq dq_*:rad/s:-1, or leave velocities out with --dq none, which estimates them "
    f"from q; {_KEEP_TARE}",
    "NF-SENSOR-VELOCITY-MISSING": "Give --dq none, which estimates velocities from q; "
    + _KEEP_TARE,
    "NF-IDENTIFICATION-SETTING": "Choose another --method",
    "NF-IDENTIFICATION-SPANS": "Choose another --method",
    "NF-IDENTIFICATION-DEPTH-UNIT": "Give the unit, as in --depth z:mm",
    "NF-IDENTIFICATION-NO-TRAVEL": "Give the unit, as in --depth z:m, or another "
    "recording",
    "NF-IDENTIFICATION-FORCE-SIGN": "Negate it, as in --force fz:N:-1",
    "NF-IDENTIFICATION-DEPTH-SIGN": "Negate it, as in --depth z:m:-1, unless the "
    "recording begins with a withdrawal",
    "NF-IDENTIFICATION-SPEED-SIGN": "Negate it, as in --speed v:m/s:-1, or the depth",
    "NF-URDF-FORMAT": "Correct the file; check_urdf of ROS names further mistakes",
    "NF-URDF-SIZE": "Give the description of a single robot with --urdf FILE; "
    "--lock-others locks every joint that the log does not have",
    "NF-URDF-ROBOT": "Give one of these names to --robot; --urdf FILE loads any other",
    "NF-URDF-TOOL-FRAME": "Name the frame at the needle's tip with --tool-frame",
    "NF-URDF-JOINT": "--lock-others locks every joint that the log does not have, "
    "--lock JOINT a single one",
    "NF-URDF-INERTIA": "Correct the numbers in the file; --accept-inertia goes on, "
    "with a warning",
    "NF-URDF-MASSLESS": "Give the links mass, centre and inertia; --lock-others locks "
    "every joint that the log does not have; --accept-inertia goes on without their "
    "weight, with a warning",
    "NF-SIMULATION-SCENARIO": "needleforce simulate --list prints the scenarios",
    "NF-SIMULATION-PLANT-MODEL": "Give one of these names to --plant",
    "NF-RECORDING-EXISTS": "Give another name, or replace the file with --overwrite",
    "NF-RECORDING-SIZE": "Read a part of the recording",
    "NF-RECORDING-COLUMN": "Name it with {option}, or under {channel} in the file of "
    "--mapping; --print-config prints such a file",
    "NF-RECORDING-PARTIAL": "Leave the channel out with {option} none, or name its "
    "columns with {option}",
    "NF-RECORDING-HEADERLESS": "Name columns by their number, with their units, as in "
    "{options}",
    "NF-RECORDING-UNIT": "Give it with the column, as in {option} {value}",
    "NF-RECORDING-TIME-COLUMN": "Name it with --time, or give the sample rate with "
    "--rate",
    "NF-RECORDING-TIME": "Name column and unit, as in --time stamp:ms, or give the "
    "sample rate with --rate",
    "NF-RECORDING-MAPPING": "Correct the options, or the file of --mapping, where a "
    "channel has columns, unit and scale",
    "NF-RECORDING-JOINTS": "Name the columns of all joints, as in --q q_* --tau tau_*",
    "NF-RECORDING-ARMS": "Choose one with --joints, as in --joints '{pattern}'",
    "NF-RECORDING-WRITE": "Give another place and form with -o FILE",
    "NF-CONTROL-LIMITS": "Correct the joint limits in the robot's description",
    "NF-CONTROL-FRAME": "Name a frame whose z axis is the needle with --tool-frame",
    "NF-CONTROL-EVENT-LOG": "Give a log of events that the control wrote",
    "NF-DEVICE-UNITS": "Set the sensor to N and Nm on its own page",
    "NF-ANATOMY-LANDMARKS-MISFIT": "Check the order and the place of the landmarks and "
    "touch them again",
    "NF-ANATOMY-TRANSFORM-MISFIT": "Try the other --transform-from; check that the "
    "transform belongs to this CT and that the patient has not moved, or register with "
    "--landmarks",
    "NF-FIGURE-CHART": "Widen the window of --from and --to",
    "NF-STATE-FILE": "Give a file that holds a snapshot",
    "NF-STATE-KIND": "Give the snapshot of such an object",
    "NF-STATE-OTHER": "Give the robot and the settings of the snapshot",
    "NF-SESSION-SETTING": "Correct the options of the robot",
    "NF-SESSION-PLAN": "Give the plan of the snapshot",
}
"""Advice of the commands, by the label of the code; ``{place}`` as in the error's."""

WATCH_ADVICE: dict[str, str] = {
    "NF-SENSOR-CONTACT": "Keep the needle free; the next attempt follows by itself",
    "NF-SENSOR-GRAVITY-MISSING": "Record it, and use needleforce force "
    "--gravity-compensated",
    "NF-SENSOR-GRAVITY-TWICE": "Check which torques the robot sends",
    "NF-SENSOR-TORQUE-SIGN": "Record it, and use needleforce force --tau "
    "COLUMNS:Nm:{factors}",
    "NF-SENSOR-TORQUE-SCALE": "Check the unit that the robot sends; record it, and use "
    "needleforce force --tau COLUMNS:Nm:{factors}",
    "NF-SENSOR-GRAVITY-DIRECTION": "Give --gravity {gravity}",
    "NF-SENSOR-JOINT-ORDER": "Check the order in which the robot sends its joints",
    "NF-SENSOR-POSITIONS": "Check that positions of every joint are sent",
    "NF-SENSOR-PAYLOAD": "Describe hand and tool with --payload FILE",
    "NF-SENSOR-NO-FREE-MOTION": "Move without contact; the next attempt follows by "
    "itself",
    "NF-SENSOR-VELOCITY": "Check the units and signs that the robot sends",
    "NF-SENSOR-VELOCITY-MISSING": "Check that the robot sends velocities; of a "
    'recording, write dq = "none" in the file of --mapping, and they are estimated',
}
"""What `view` and `live` say instead: they tare by themselves, and have no option to
override it."""


def advise(error: CodedError, overrides: dict[str, str] | None = None) -> str:
    """Return what a user of the command may do about an error.

    Args:
        error: The error.
        overrides: Advice that a command has in place of `COMMAND_ADVICE`.
    """
    causes = [Alternative(error.code, error.places), *error.alternatives]
    return advise_causes(causes, overrides)


def advise_causes(
    causes: Iterable[Alternative],
    overrides: dict[str, str] | None = None,
    *,
    keeps_tare: bool = False,
) -> str:
    """Return what a user may do about one cause or another.

    Args:
        causes: Any of them may be the one.
        overrides: Advice that a command has in place of `COMMAND_ADVICE`.
        keeps_tare: Whether the tare was taken, so that nothing is said of keeping it.
    """
    known = COMMAND_ADVICE | (overrides or {})
    advices = [
        fill_advice(known.get(code.label, code.cure), places).rstrip(".")
        for code, places in causes
    ]
    # What keeps the tare is said once.
    *others, last = dict.fromkeys(advices)
    ending = f"; {_KEEP_TARE}"
    if keeps_tare:
        last = last.removesuffix(ending)
    shortened = [one.removesuffix(ending) for one in others]
    return "; or ".join(
        one if k == 0 else one[0].lower() + one[1:]
        for k, one in enumerate([*shortened, last])
    )


def describe_error(error: CodedError, overrides: dict[str, str] | None = None) -> str:
    """Return an error in one line: code, what came and was expected, what to do."""
    text = _as_sentence(str(error))
    return f"{error.code}: {text} {advise(error, overrides)}"


def describe_suspicion(suspicion: Suspicion) -> str:
    """Return a suspicion in one line, with what a user of the command may do."""
    if suspicion.code is None:
        return suspicion.text
    label = suspicion.code.label
    advice = COMMAND_ADVICE.get(label, suspicion.code.cure)
    return f"{label}: {_as_sentence(suspicion.text)} {advice.rstrip('.')}"


def _as_sentence(text: str) -> str:
    """Return a text that ends as a sentence does."""
    text = text.rstrip()
    return text if text.endswith((".", "?", "!")) else f"{text}."
