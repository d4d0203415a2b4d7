"""Every code of an error, a warning or a status, with its meaning and its cures.

``python -m needleforce.codes`` prints them all, ``python -m needleforce.codes CODE``
one of them. `code_entries` is what the page of codes is made of.
"""

import ast
import inspect
import sys
import textwrap
from collections.abc import Iterable, Sequence
from enum import Enum
from itertools import pairwise
from typing import NamedTuple

from foundation.errors import ErrorCode, StateCode, fill_advice
from groundtruth.errors import SimulationCode
from identification.errors import IdentificationCode
from identification.estimate import SampleStatus, TissueWarning
from needleforce.anatomy.errors import AnatomyCode
from needleforce.cli.advice import COMMAND_ADVICE
from needleforce.cli.terminal import CommandCode
from needleforce.control.errors import ControlCode
from needleforce.devices.errors import DeviceCode
from needleforce.plots.errors import FigureCode
from needleforce.recordings.errors import RecordingCode
from needleforce.ros2.errors import Ros2Code
from needleforce.scene.state_ring import SceneCode
from needleforce.session import SessionCode
from residual.errors import SensorCode
from residual.estimate import SensorWarning, Status
from urdf.errors import UrdfCode

ERROR_CODES: tuple[type[ErrorCode], ...] = (
    CommandCode,
    RecordingCode,
    UrdfCode,
    SensorCode,
    IdentificationCode,
    SessionCode,
    StateCode,
    ControlCode,
    AnatomyCode,
    DeviceCode,
    Ros2Code,
    SceneCode,
    FigureCode,
    SimulationCode,
)
"""The errors of all packages, in the order in which a user meets them."""

REPORT_CURES = {
    "Status.NOT_TARED": "Move in free air, then `tare`.",
    "Status.INITIALIZING": "Wait: the filters settle within a second.",
    "Status.REJECTED": "Go on with the next sample; `message` has the reason.",
    "SensorWarning.SPIKE": "Go on; if it recurs, check the cables and the sensor.",
    "SensorWarning.FROZEN": "Check the sensors and the connection to the robot.",
    "SensorWarning.SATURATED": "Unload the arm, or correct the effort limits in the "
    "robot's description.",
    "SensorWarning.JOINT_LIMIT": "Move the joint away from its limit.",
    "SensorWarning.NEAR_SINGULAR": "Change the posture of the arm.",
    "SensorWarning.MODEL_MISMATCH": "Let nothing but the needle touch the tissue; "
    "correct the payload.",
    "SensorWarning.TARE_EXPIRED": "Withdraw, move in free air, `start_tare_recording`, "
    "then `tare`.",
    "SensorWarning.VELOCITY": "Correct units, signs, order or delay of `dq`.",
    "SensorWarning.ARM_PUSHED": "Take the hand off the arm; it ends by itself.",
    "SensorWarning.TORQUE_JUMP": "Take the hand off the arm; else withdraw, move in "
    "free air, `start_tare_recording`, then `tare`; if it recurs, check the torque "
    "sensors.",
    "TissueWarning.TISSUE_MOVES": "Insert while the breath is held; it ends 15 s after "
    "the last pull, layers met meanwhile keep wide deviations.",
    "TissueWarning.HARD_CONTACT": "Stop, withdraw, and choose another path; a stiff "
    "tissue that is no bone wants a larger `MultilayerConfig.hard_contact_N_per_m`.",
    "SampleStatus.TIME_GAP": "Nothing: the sample is used.",
    "SampleStatus.NOT_A_SCALAR": "Give one number each for depth, speed, force and "
    "`dt_s`.",
    "SampleStatus.NOT_FINITE": "Skip samples without a number.",
    "SampleStatus.TIME_NOT_FORWARD": "Give the positive time since the last sample.",
    "SampleStatus.DEPTH_JUMP": "Nothing, if the depth was set anew; else check its "
    "sensor.",
    "SampleStatus.SPEED_SIGN": "Negate speed or depth.",
    "SampleStatus.FORCE_RANGE": "Give the force in newtons.",
    "SampleStatus.TIME_RANGE": "Give `dt_s` in seconds.",
    "SampleStatus.MOTION_RANGE": "Give depth in metres and speed in metres per second.",
    "SampleStatus.NEEDLE_PULLED": "Take the hand off the hub; else stop, withdraw, and "
    "tare again.",
}
"""What may be done about a status or a warning of the online estimators."""

NO_REPORTS = {
    Status.OK,
    SensorWarning.NONE,
    SampleStatus.OK,
    TissueWarning.NONE,
}
"""Members that report nothing."""


class CodeEntry(NamedTuple):
    """A code, as a page lists it.

    Attributes:
        label: The code.
        area: What it is about.
        meaning: What has happened.
        library_cure: What a caller of the library may do.
        command_cure: What a user of the command line may do.
    """

    label: str
    area: str
    meaning: str
    library_cure: str
    command_cure: str


def code_entries(
    kinds: Iterable[type[ErrorCode]] = ERROR_CODES,
) -> tuple[CodeEntry, ...]:
    """Return all errors by code, then all statuses and warnings by name.

    Args:
        kinds: Enumerations of errors; other than these where more are listed, such as
            those of the benchmarks.
    """
    errors = [_error_entry(code) for kind in kinds for code in kind]
    return (*errors, *_report_entries())


def _error_entry(code: ErrorCode) -> CodeEntry:
    return CodeEntry(
        label=code.label,
        area=code.area,
        meaning=code.meaning,
        library_cure=_as_sentence(code.cure),
        command_cure=_as_sentence(COMMAND_ADVICE.get(code.label, code.cure)),
    )


def _as_sentence(cure: str) -> str:
    """Return a cure with capitals for its places, and a full stop."""
    return f"{fill_advice(cure, {}).rstrip('.')}."


def _report_entries() -> list[CodeEntry]:
    """Return what online estimators report: the names of statuses and warnings."""
    meanings: dict[Enum, str] = {
        **_attribute_docs(Status),
        **_attribute_docs(SensorWarning),
        **_attribute_docs(TissueWarning),
        **{status: f"{status.value.capitalize()}." for status in SampleStatus},
    }
    entries: list[CodeEntry] = []
    for member, meaning in meanings.items():
        label = f"{type(member).__name__}.{member.name}"
        if member not in NO_REPORTS:
            area = (
                "warning"
                if isinstance(member, SensorWarning | TissueWarning)
                else "status"
            )
            cure = REPORT_CURES[label]
            entries.append(CodeEntry(label, area, meaning, cure, cure))
    return entries


def _attribute_docs(kind: type[Enum]) -> dict[Enum, str]:
    """Return the members of an enumeration with the text that stands below each."""
    tree = ast.parse(textwrap.dedent(inspect.getsource(kind)))
    [definition] = tree.body
    docs: dict[Enum, str] = {}
    body = definition.body if isinstance(definition, ast.ClassDef) else []
    for statement, following in pairwise(body):
        if isinstance(statement, ast.Assign) and isinstance(following, ast.Expr):
            name = ast.unparse(statement.targets[0])
            docs[kind[name]] = " ".join(str(ast.literal_eval(following.value)).split())
    return docs


def describe_entry(entry: CodeEntry) -> str:
    """Return an entry as lines of text."""
    cures = [("do", entry.command_cure)]
    if entry.library_cure != entry.command_cure:
        cures = [("library", entry.library_cure), ("command", entry.command_cure)]
    lines = [entry.label, f"  {entry.meaning}"]
    lines += [f"  {reader}: {cure}" for reader, cure in cures]
    return "\n".join(lines)


def main(arguments: Sequence[str] | None = None) -> int:
    """Print all entries, or those of the codes that are given.

    Returns:
        The exit code: 2 if no entry has such a code.
    """
    wanted = set(sys.argv[1:] if arguments is None else arguments)
    entries = [entry for entry in code_entries() if not wanted or entry.label in wanted]
    sys.stdout.writelines(f"{describe_entry(entry)}\n" for entry in entries)
    return 0 if entries else 2


if __name__ == "__main__":
    sys.exit(main())
