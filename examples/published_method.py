"""The published method beside ours
=================================

Both identify the same recording online and take the friction of the layers traversed
away. What is left should be the force of the layer that the tip is in.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import insert_needle
from identification import MIXTURE, PUBLISHED, replay

run = insert_needle("stack-constant", rate_hz=200.0)
inserting = (run.depth_m > 0.0) & (run.speed_m_s > 1e-4)
depth_mm = 1e3 * run.depth_m[inserting]

# The true force, less the friction of all layers but the one the tip is in.
friction_N = run.truth.layer_friction_N.copy()
for layer in range(1, len(run.scenario.layers) + 1):
    friction_N[run.truth.layer == layer, layer - 1] = 0.0
true_N = (run.truth.axial_N - friction_N.sum(axis=1))[inserting]

plt.plot(depth_mm, run.force_N[inserting], color="lightgray", label="measured force")
for config, name in ((PUBLISHED, "published"), (MIXTURE, "ours")):
    result = replay(run.t_s, run.depth_m, run.force_N, run.speed_m_s, config)
    enhanced_N = np.array([estimate.enhanced_force_N for estimate in result.estimates])
    enhanced_N = enhanced_N[inserting]
    error_N = np.sqrt(np.mean((enhanced_N - true_N) ** 2))
    alarms = sum(estimate.rupture is not None for estimate in result.estimates)
    plt.plot(depth_mm, enhanced_N, lw=1, label=f"{name}: rms error {error_N:.2f} N")
    print(f"{name}: rms error {error_N:.2f} N, {alarms} alarms for 3 ruptures")
plt.plot(depth_mm, true_N, "k:", label="true")
plt.xlabel("depth [mm]")
plt.ylabel("enhanced force [N]")
plt.legend()
plt.show()
