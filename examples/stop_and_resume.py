"""Stop an insertion and resume it in another process
==================================================

A snapshot holds all that a session knows: the numbers go on bit for bit.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt

from groundtruth import simulate
from needleforce import InsertionSession, read_snapshot, write_snapshot

arm = simulate("gel-25-constant", "clean")
signals = arm.signals


def feed(session, ticks):
    """Update a session with some ticks, and return its tip forces."""
    forces_N = []
    for k in ticks:
        if not session.tared and signals.t_s[k] > arm.tare_end_s:
            session.tare()
        sample = (signals.q_rad[k], signals.dq_rad_s[k], signals.tau_Nm[k])
        estimate = session.update(*sample, 1e-3)
        forces_N.append(estimate.identification.tip_force_N)
    return forces_N


before = range(18_000)
after = range(18_000, 21_000)
stopped = InsertionSession(arm.robot)
before_N = feed(stopped, before)
resumed = InsertionSession(arm.robot)  # the same robot, the same settings
with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "insertion.snapshot"
    write_snapshot(stopped.snapshot(), file)
    resumed.restore(read_snapshot(file))

resumed_N = feed(resumed, after)
assert resumed_N == feed(stopped, after)
plt.plot(signals.t_s[before], before_N, label="until the stop")
plt.plot(signals.t_s[after], resumed_N, label="resumed")
plt.xlabel("time [s]")
plt.ylabel("tip force [N]")
plt.legend()
plt.show()
print(f"both read {resumed_N[-1]:.6f} N three seconds later")
