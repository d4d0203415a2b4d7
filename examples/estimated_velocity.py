"""Velocity, where the robot sends none
=====================================

Differences of positions are noisy. `VelocityEstimator` gives a velocity late by a known
time, and delays the torque by as much, so that motion does not read as force.
"""

import matplotlib.pyplot as plt
import numpy as np

from residual import VelocityEstimator

TICK_s = 1e-3
NOISE_rad = 1e-5  # of a motor encoder behind the gear
BANDWIDTH_per_s = 200.0
rng = np.random.default_rng(0)

times_s = np.arange(0.0, 1.0, TICK_s)
true_rad_s = 0.3 * np.sin(2.0 * np.pi * 2.0 * times_s)
true_rad = np.cumsum(true_rad_s) * TICK_s
measured_rad = true_rad + rng.normal(0.0, NOISE_rad, len(times_s))

estimator = VelocityEstimator(1, BANDWIDTH_per_s)
velocities_rad_s = []
for position_rad in measured_rad:
    sample = estimator.update([position_rad], [0.0], TICK_s)
    velocities_rad_s.append(sample.dq[0])

differences_rad_s = np.diff(measured_rad, prepend=measured_rad[0]) / TICK_s
delayed_s = times_s + estimator.delay_s
settled = times_s > 0.1
true_late_rad_s = np.interp(times_s, delayed_s, true_rad_s)
errors_rad_s = np.array(velocities_rad_s) - true_late_rad_s

plt.plot(times_s, differences_rad_s, color="lightgray", label="differences")
plt.plot(times_s, velocities_rad_s, label="VelocityEstimator")
plt.plot(times_s, true_rad_s, "k:", label="true")
plt.xlabel("time [s]")
plt.ylabel("joint velocity [rad/s]")
plt.legend()
plt.show()

noise_rad_s = np.std((differences_rad_s - true_rad_s)[settled])
error_rad_s = np.std(errors_rad_s[settled])
print(f"late by {1e3 * estimator.delay_s:.0f} ms; errors beside that:")
print(f"{error_rad_s:.4f} rad/s, of differences {noise_rad_s:.4f} rad/s")
