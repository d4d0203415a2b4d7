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
    """Yield the signals of every tick.

    They are time [s], positions [rad], velocities [rad/s] (or None) and torques [Nm].
    """
    signals = arm.signals
    yield from zip(
        signals.t_s.tolist(),
        signals.q_rad,
        signals.dq_rad_s,
        signals.tau_Nm,
        strict=True,
    )


session = InsertionSession(arm.robot)
previous_s = 0.0
worst_N = 0.0

for t_s, q, dq, tau in read_arm():
    # A bad sample does not raise: the status reports it.
    estimate = session.update(q, dq, tau, t_s - previous_s)
    previous_s = t_s

    # Tare once, while the needle is still in free air.
    if not session.tared and t_s > arm.tare_end_s:
        session.tare()
        gc.freeze()  # what lives until now lives on: the garbage collector may skip it

    # Without a force of this tick, or with a doubtful one, hold the last command.
    if estimate.status is not Status.OK or estimate.warnings:
        continue

    wrench = estimate.wrench
    if wrench.axial + 2.0 * wrench.axial_std > LIMIT_N:
        pass  # slow down or stop
    worst_N = max(worst_N, estimate.identification.tip_force_N)

    rupture = estimate.identification.rupture
    if rupture is not None:
        depth_mm = 1e3 * rupture.depth_m
        print(f"{t_s:6.2f} s: layer {rupture.layer} ruptured at {depth_mm:.1f} mm")

print(f"at most {worst_N:.2f} N at the tip; {session.rejected} samples rejected")
