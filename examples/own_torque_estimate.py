"""A robot that estimates the external torque itself
==================================================

Panda and others send it. Wrench and layers follow from it as from measured torques.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import simulate
from needleforce import InsertionSession

OFFSET_Nm = 0.2
NOISE_Nm = 0.02
TICK_s = 1e-3

# What such a robot sends: the external torque, with an offset and some noise.
arm = simulate("gel-25-constant", "clean")
true_Nm = arm.truth.external_torque_Nm
noise = np.random.default_rng(0).standard_normal(true_Nm.shape)
external_torque_Nm = true_Nm + OFFSET_Nm + NOISE_Nm * noise

session = InsertionSession(arm.robot)
forces_N = []
for t_s, q, torque in zip(
    arm.signals.t_s, arm.signals.q_rad, external_torque_Nm, strict=True
):
    # This robot sends no velocities: None.
    estimate = session.update_external_torque(q, None, torque, TICK_s)
    if not session.tared and t_s > arm.tare_end_s:
        session.tare()
    forces_N.append(estimate.wrench.axial)
    if estimate.identification.identified_layer is not None:
        break

count = len(forces_N)
plt.plot(arm.signals.t_s[:count], forces_N, label="from the robot's own torques")
plt.plot(arm.signals.t_s[:count], arm.truth.axial_N[:count], "k:", label="true force")
plt.axvline(arm.tare_end_s, color="gray", linestyle="dotted", label="tare()")
plt.xlabel("time [s]")
plt.ylabel("axial force [N]")
plt.legend()
plt.show()

gel = session.layers[0]
print(f"at most {max(forces_N):.2f} N; the gel is {1e3 * gel.thickness_m:.1f} mm thick")
