"""The force on the needle, without a force sensor
================================================

The force computed from joint torques, beside the true one.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import simulate
from residual import VirtualForceSensor

arm = simulate("gel-25-constant", "clean")  # stands in for your robot
signals = arm.signals
sensor = VirtualForceSensor(arm.robot)

ticks = np.flatnonzero(signals.t_s < 32.0)  # until the needle is through the gel

forces_N = []
stds_N = []
for k in ticks:
    if not sensor.tared and signals.t_s[k] > arm.tare_end_s:
        sensor.tare()  # once, while the needle is still in free air
    q = signals.q_rad[k]
    dq = signals.dq_rad_s[k]
    estimate = sensor.update(q, dq, signals.tau_Nm[k], 1e-3)
    forces_N.append(estimate.axial)
    stds_N.append(estimate.axial_std)

inserting = ticks[signals.t_s[ticks] > arm.tare_end_s]
t_s = signals.t_s[inserting]
true_N = arm.truth.axial_N[inserting]
force_N = np.array(forces_N)[inserting]
two_sigma_N = 2.0 * np.array(stds_N)[inserting]

plt.fill_between(t_s, force_N - two_sigma_N, force_N + two_sigma_N, alpha=0.3)
plt.plot(t_s, force_N, label="from joint torques, ± 2 σ")
plt.plot(t_s, true_N, "k:", label="true force")
plt.xlabel("time [s]")
plt.ylabel("axial force [N]")
plt.legend()
plt.show()

rms_N = np.sqrt(np.mean((force_N - true_N) ** 2))
print(f"rms error {rms_N:.3f} N")
