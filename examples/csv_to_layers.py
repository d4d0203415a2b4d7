"""From a CSV of depth and force to layers
========================================

Time, depth and force of a needle insertion in; each layer's thickness, stiffness and
friction out. No robot is needed.
"""

import tempfile
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import insert_needle
from identification import replay
from needleforce.recordings import read_log, write_table

# A recording stands in for yours: three gels, 200 samples a second.
run = insert_needle("stack-glove-constant", rate_hz=200.0)
columns = {"t_s": run.t_s, "depth_mm": 1e3 * run.depth_m, "force_N": run.force_N}

with tempfile.TemporaryDirectory() as folder:
    file = Path(folder) / "insertion.csv"
    write_table(file, columns)
    log = read_log(file, required=["depth", "force"])  # in SI units

result = replay(log.t_s, log["depth_m"], log["force_N"])
for layer in result.layers:
    thickness = f"{1e3 * layer.thickness_m:.1f} mm"
    stiffness = f"{layer.stiffness_N_per_m:.0f} N/m"
    friction = f"{layer.friction_N:.2f} ± {layer.friction_std_N:.2f} N"
    print(f"layer {layer.layer}: {thickness}, {stiffness}, friction {friction}")

inserting = np.flatnonzero(log.t_s > run.tare_end_s)
inserting = inserting[: np.argmax(log["depth_m"][inserting])]
depth_mm = 1e3 * log["depth_m"][inserting]
tip_N = [result.estimates[row].tip_force_N for row in inserting]
plt.plot(depth_mm, log["force_N"][inserting], label="force at the base")
plt.plot(depth_mm, tip_N, label="force at the tip")
for layer in result.layers:
    plt.axvline(1e3 * layer.rupture.depth_m, color="gray", lw=1)
plt.xlabel("depth [mm]; lines: ruptures")
plt.ylabel("axial force [N]")
plt.legend()
plt.show()
