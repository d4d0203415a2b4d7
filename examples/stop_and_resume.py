"""Stop in the middle of an insertion and resume in another process, bit for bit."""

import tempfile
from pathlib import Path

from groundtruth import simulate
from needleforce import InsertionSession, read_snapshot, write_snapshot

TICK_s = 1e-3
FIVE_SECONDS = 5000  # ticks

arm = simulate("gel-25-constant", "clean")
signals = arm.signals
ticks = list(
    zip(
        signals.t_s.tolist(),
        signals.q_rad,
        signals.dq_rad_s,
        signals.tau_Nm,
        strict=True,
    )
)
middle = len(ticks) // 2


def feed(session, ticks):
    """Update a session with some ticks, and return the last estimate."""
    for t_s, q, dq, tau in ticks:
        if not session.tared and t_s > arm.tare_end_s:
            session.tare()
        estimate = session.update(q, dq, tau, TICK_s)
    return estimate


with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "insertion.snapshot"

    stopped = InsertionSession(arm.robot)
    feed(stopped, ticks[:middle])
    write_snapshot(stopped.snapshot(), file)

    # In another process: the same robot and the same settings.
    resumed = InsertionSession(arm.robot)
    resumed.restore(read_snapshot(file))

following = ticks[middle : middle + FIVE_SECONDS]
here = feed(stopped, following)
there = feed(resumed, following)
assert here.wrench.axial == there.wrench.axial
assert here.identification == there.identification
print(f"both read {here.wrench.axial:.6f} N five seconds later")
