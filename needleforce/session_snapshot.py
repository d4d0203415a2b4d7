"""State of a session, and states in files: of a session, a sensor or an identifier.

`foundation.state` writes and reads them bit for bit, with a version and a hash.
"""

import os
from typing import NamedTuple

from foundation.errors import NeedleforceError
from foundation.state import SAME_KIND, StateError, read_sealed_state, seal_state
from identification import Snapshot as IdentifierSnapshot
from needleforce.files import whole_file
from needleforce.insertion_course import CourseState
from needleforce.plan_follower import PlanMemory
from needleforce.rewinding import Checkpoint
from needleforce.zero_watch import AirWatch
from residual.virtual_force_sensor import SensorState


class InsertionError(NeedleforceError, ValueError):
    """A setting, a plan or a snapshot that a session cannot take; nothing has changed.

    Errors of `residual` and `identification` pass through a session unchanged.
    """

    usual_advice = (
        "Give what the message expects; `load_lwr` and `load_urdf` make a robot, "
        "`SensorConfig` holds the settings of the sensor."
    )


SnapshotFileError = StateError
"""A file that is no snapshot, is damaged, or of a version that cannot be read."""


class SessionSnapshot(NamedTuple):
    """Complete state of an `InsertionSession`; immutable.

    Attributes:
        sensor: State of the virtual sensor.
        identifier: State of the identifier.
        checkpoints: States of the identification to rewind to, the older one first.
        unused_s: Time of valid samples that were not used for identification.
        course: Where the needle is in which insertion, and the channels it has cut.
        plan: State of the plan's follower.
        air: What shows that the force's zero has changed.
        speed_lag_s: Setting of the session.
    """

    sensor: SensorState
    identifier: IdentifierSnapshot
    checkpoints: tuple[Checkpoint, Checkpoint]
    unused_s: float
    course: CourseState
    plan: PlanMemory
    air: AirWatch
    speed_lag_s: float


AnySnapshot = SessionSnapshot | SensorState | IdentifierSnapshot

_KINDS = {
    "session": SessionSnapshot,
    "sensor": SensorState,
    "identifier": IdentifierSnapshot,
}
"""What a file may hold; it says which."""


def write_snapshot(snapshot: AnySnapshot, path: str | os.PathLike[str]) -> None:
    """Write the state of a session, of a virtual sensor or of an identifier.

    The file appears whole or not at all.

    Args:
        snapshot: What ``snapshot()`` of one of them returned.
        path: Where to; an older file of that name is replaced.

    Raises:
        SnapshotFileError: For anything but such a state.
        OSError: If the file cannot be written.
    """
    names = [name for name, kind in _KINDS.items() if type(snapshot) is kind]
    if not names:
        raise SnapshotFileError(
            "expected what snapshot() of a session, a sensor or an identifier returns, "
            f"got a {type(snapshot).__name__}",
            SAME_KIND,
        )
    content = seal_state(snapshot, names[0])
    with whole_file(path) as file:
        file.write(content)


def read_snapshot(path: str | os.PathLike[str]) -> AnySnapshot:
    """Read a file of `write_snapshot`.

    Args:
        path: The file.

    Returns:
        The state, for ``restore`` of its kind.

    Raises:
        SnapshotFileError: If it holds no state, is damaged, or of another version.
        OSError: If the file cannot be read.
    """
    return read_sealed_state(path, _KINDS)
