"""A control loop that reads the needle force: one call a tick, one tare, what to check.

The simulated arm stands in for yours; replace `read_arm` by your robot's interface.
"""

import gc

from groundtruth import simulate
from needleforce import InsertionSession
from residual import Status

LIMIT_N = 2.0
arm = simulate("gel-25-constant", "clean")  # one gel, a well-kept LWR 4+


def read_arm():
    """Time [s], positions [rad], velocities [rad/s] (or None) and torques [Nm] of
    every tick."""
    sent = arm.signals
    yield from zip(
        sent.t_s.tolist(), sent.q_rad, sent.dq_rad_s, sent.tau_Nm, strict=True
    )


session = InsertionSession(arm.robot)
last_s = 0.0
worst_N = 0.0
for t_s, q, dq, tau in read_arm():
    now = session.update(q, dq, tau, t_s - last_s)  # never raises for a bad sample
    last_s = t_s
    if not session.tared and t_s > arm.tare_end_s:  # the needle is still in free air
        session.tare()
        gc.freeze()  # what lives until now lives on: the garbage collector may skip it
    if now.status is not Status.OK or now.warnings:
        continue  # no force of this tick, or an uncertain one: hold the last command
    if now.wrench.axial + 2.0 * now.wrench.axial_std > LIMIT_N:
        pass  # slow down or stop
    worst_N = max(worst_N, now.identification.tip_force_N)
    if (rupture := now.identification.rupture) is not None:
        print(
            f"{t_s:6.2f} s: layer {rupture.layer} ruptured at "
            f"{1e3 * rupture.depth_m:.1f} mm"
        )

print(f"at most {worst_N:.2f} N at the tip; {session.rejected} samples rejected")
