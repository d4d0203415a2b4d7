"""The whole chain in one object: joint signals in; force, depth, layers and tip force out.

    session = InsertionSession(robot)
    estimate = session.update(q, dq, tau, dt_s)     # every tick
    session.tare()                                  # once, in free air

Reading order: `session`, `tip_travel`; what a run is stored as in `snapshot_file`.
"""

from insertion.errors import InsertionError, SnapshotFileError
from insertion.session import InsertionSession
from insertion.session_estimate import SessionEstimate, SessionSnapshot
from insertion.snapshot_file import SNAPSHOT_VERSION, read_snapshot, write_snapshot
from insertion.tip_travel import TipTravel, Travel

__all__ = [
    "SNAPSHOT_VERSION",
    "InsertionError",
    "InsertionSession",
    "SessionEstimate",
    "SessionSnapshot",
    "SnapshotFileError",
    "TipTravel",
    "Travel",
    "read_snapshot",
    "write_snapshot",
]
