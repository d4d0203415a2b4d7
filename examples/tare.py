"""Tare: remove what the sensor reads without contact
===================================================

Move in free air, call ``tare()``, and the errors of model and torque sensors are gone.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import simulate
from residual import VirtualForceSensor

arm = simulate("gel-25-constant", "clean")  # stands in for your robot
signals = arm.signals
sensor = VirtualForceSensor(arm.robot)
before_contact = np.flatnonzero(signals.t_s < arm.tare_end_s)
tare_s = 5.0

forces_N = []
for k in before_contact:
    if not sensor.tared and signals.t_s[k] > tare_s:
        sensor.tare()
    q = signals.q_rad[k]
    dq = signals.dq_rad_s[k]
    tau = signals.tau_Nm[k]
    estimate = sensor.update(q, dq, tau, 1e-3)
    forces_N.append(estimate.axial)

t_s = signals.t_s[before_contact]
force_N = np.array(forces_N)
plt.plot(t_s, force_N, label="axial force")
plt.axvline(tare_s, color="black", linestyle="dotted", label="tare()")
plt.axhline(0.0, color="gray", lw=0.8, label="true force: none")
plt.xlabel("time [s]")
plt.ylabel("axial force [N]")
plt.legend()
plt.show()

before_N = np.abs(force_N[(t_s > 1.0) & (t_s < tare_s)]).max()
after_N = np.abs(force_N[t_s > tare_s]).max()
print(f"in free air at most {before_N:.2f} N before the tare, {after_N:.2f} N after it")
