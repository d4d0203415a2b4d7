"""The observer's gain: lag against noise
=======================================

A larger K answers sooner and lets more of the torque noise through.
"""

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from residual import SensorConfig, VirtualForceSensor
from urdf import NeedleTool, load_lwr

TICK_s = 1e-3
NOISE_Nm = 0.05  # of a sample, each joint
q_rad = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 1.3, 0.0])
at_rest = np.zeros(7)

robot = load_lwr(payload=NeedleTool())
gravity_Nm = pin.computeGeneralizedGravity(robot.model, robot.create_data(), q_rad)
rng = np.random.default_rng(0)
measured_Nm = gravity_Nm + rng.normal(0.0, NOISE_Nm, (3000, 7))

gains_per_s = (20.0, 40.0, 70.0, 120.0, 200.0)
for gain_per_s in gains_per_s:
    sensor = VirtualForceSensor(robot, SensorConfig(gain_per_s=gain_per_s))
    forces_N = []
    for tau_Nm in measured_Nm:
        estimate = sensor.update(q_rad, at_rest, tau_Nm, TICK_s)
        forces_N.append(estimate.axial_unsmoothed)
    noise_N = np.std(forces_N[500:])
    lag_ms = 1e3 / gain_per_s
    plt.plot(lag_ms, noise_N, "o", color="black")
    plt.annotate(f" K = {gain_per_s:.0f}/s", (lag_ms, noise_N))
    print(f"K = {gain_per_s:3.0f}/s: lag {lag_ms:4.1f} ms, noise {noise_N:.3f} N")
plt.xlabel("lag 1/K [ms]")
plt.ylabel("noise of the axial force [N]")
plt.xlim(0.0, 60.0)
plt.ylim(bottom=0.0)
plt.show()
