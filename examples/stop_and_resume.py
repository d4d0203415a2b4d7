"""Stop in the middle of an insertion and resume in another process, bit for bit."""

import tempfile
from pathlib import Path

from groundtruth import simulate
from needleforce import InsertionSession, read_snapshot, write_snapshot

arm = simulate("gel-25-constant", "clean")
sent = arm.signals
ticks = list(
    zip(sent.t_s.tolist(), sent.q_rad, sent.dq_rad_s, sent.tau_Nm, strict=True)
)
middle = len(ticks) // 2


def feed(session, part):
    for t_s, q, dq, tau in part:
        if not session.tared and t_s > arm.tare_end_s:
            session.tare()
        now = session.update(q, dq, tau, 1e-3)
    return now


with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "insertion.json"
    one = InsertionSession(arm.robot)
    feed(one, ticks[:middle])
    write_snapshot(one.snapshot(), file)

    other = InsertionSession(arm.robot)  # the same robot and settings, another process
    other.restore(read_snapshot(file))

rest = ticks[middle : middle + 5000]
here = feed(one, rest)
there = feed(other, rest)
assert here.wrench.axial == there.wrench.axial
assert here.identification == there.identification
print(f"both read {here.wrench.axial:.6f} N five seconds later")
