"""The needle's force in a control loop
=====================================

One call a tick, one tare, and what to check before the force is used.
"""

import matplotlib.pyplot as plt

from groundtruth import simulate
from needleforce import InsertionSession
from residual import Status

END_s = 34.0  # the needle is through the gel
arm = simulate("gel-25-constant", "clean")  # replace by your robot's interface
signals = arm.signals
session = InsertionSession(arm.robot)
rows = []
previous_s = 0.0
for t_s, q, dq, tau in zip(
    signals.t_s, signals.q_rad, signals.dq_rad_s, signals.tau_Nm, strict=True
):
    # A bad sample does not raise: the status reports it. dq may be None.
    estimate = session.update(q, dq, tau, t_s - previous_s)
    previous_s = t_s

    # Tare once, in free air: it is fitted beside the next 1000 ticks or so.
    if not session.tared and t_s > arm.tare_end_s - 1.0:
        session.start_tare()

    # Without a force of this tick, or with a doubtful one, hold the last command.
    if estimate.status is not Status.OK or estimate.warnings:
        continue
    rows.append((t_s, estimate.wrench.axial, estimate.identification.tip_force_N))
    if t_s > END_s:
        break
    rupture = estimate.identification.rupture
    if rupture is not None:
        plt.axvline(t_s, color="gray", label=f"layer {rupture.layer} ruptured")
        print(f"layer {rupture.layer} ruptured at {1e3 * rupture.depth_m:.1f} mm")

times_s, axial_N, tip_N = zip(*rows, strict=True)
plt.plot(times_s, axial_N, label="force on the needle")
plt.plot(times_s, tip_N, label="force at its tip")
plt.xlabel("time [s]")
plt.ylabel("force [N]")
plt.legend()
plt.show()
print(f"at most {max(tip_N):.2f} N at the tip; {session.rejected} samples rejected")
