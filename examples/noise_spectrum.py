"""The spectrum of the force's noise
==================================

The observer passes noise up to K/2π; beyond, it falls. The force in ``axial`` is
smoothed further, ``axial_unsmoothed`` is not.
"""

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin
from scipy.signal import welch

from residual import DEFAULT, VirtualForceSensor
from urdf import NeedleTool, load_lwr

TICK_s = 1e-3
NOISE_Nm = 0.05  # of a sample, each joint
q_rad = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 1.3, 0.0])
at_rest = np.zeros(7)

robot = load_lwr(payload=NeedleTool())
gravity_Nm = pin.computeGeneralizedGravity(robot.model, robot.create_data(), q_rad)
rng = np.random.default_rng(0)
sensor = VirtualForceSensor(robot)

forces_N = []
for _ in range(12_000):
    tau_Nm = gravity_Nm + rng.normal(0.0, NOISE_Nm, 7)
    estimate = sensor.update(q_rad, at_rest, tau_Nm, TICK_s)
    forces_N.append([estimate.axial_unsmoothed, estimate.axial])
settled_N = np.array(forces_N)[2000:]

frequency_Hz, density = welch(settled_N, 1.0 / TICK_s, nperseg=1024, axis=0)
corner_Hz = DEFAULT.gain_per_s / (2.0 * np.pi)
plt.loglog(frequency_Hz[1:], np.sqrt(density[1:, 0]), label="axial_unsmoothed")
plt.loglog(frequency_Hz[1:], np.sqrt(density[1:, 1]), label="axial")
plt.axvline(corner_Hz, color="gray", linestyle="dotted", label="K/2π")
plt.ylim(bottom=1e-6)
plt.xlabel("frequency [Hz]")
plt.ylabel("force noise [N/√Hz]")
plt.legend()
plt.show()

stds_N = settled_N.std(axis=0)
print(f"noise {stds_N[0]:.3f} N unsmoothed, {stds_N[1]:.3f} N smoothed")
