"""Turn the needle about its entry point
======================================

The entry is a remote centre of motion; the tip draws a circle below it.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import SimulatedArm, Trocar
from needleforce import control

ENTRY_m = 0.08  # height of the entry above the tip
RADIUS_m = 0.01  # of the circle
TURN_s = 2.0  # time for one turn


def draw_circle(holds_entry):
    """Return x, y of the tip and the needle's distance from the entry, (3, n) [mm]."""
    trocar = Trocar(behind_tip_m=ENTRY_m)
    arm = SimulatedArm(plant="clean", contacts=[trocar], duration_s=TURN_s + 0.5)
    limits = control.Limits.of_arm(arm.robot, arm.preset)
    controller = control.Controller(arm.robot, limits)
    tool = controller.tool
    tool.update(next(arm).q_rad)
    start_m = tool.tip_m

    # The first task has priority: whatever comes below, the entry holds.
    entry = control.RemoteCentre(start_m - ENTRY_m * tool.axis)
    tip = control.TipVelocity((0.0, 0.0, 0.0), start_m, gain_per_s=10.0)
    tasks = [tip, control.Posture(arm.home_rad)]
    if holds_entry:
        tasks.insert(0, entry)
    path_m = []
    for tick in control.run(arm, controller):
        angle = 2.0 * np.pi * min(arm.time_s / TURN_s, 1.0)
        circle_m = RADIUS_m * np.array([1.0 - np.cos(angle), np.sin(angle), 0.0])
        tip.goal_m = start_m + circle_m
        tick.tasks = tasks
        miss_m = arm.distance_to_axis_m(trocar.point_m)
        path_m.append([*(arm.truth.tip_m - start_m)[:2], miss_m])
    return 1e3 * np.array(path_m).T


x_mm, y_mm, miss_mm = draw_circle(holds_entry=True)
plt.scatter(x_mm, y_mm, 4, c=1e3 * miss_mm)
plt.colorbar(label="distance of the needle from the entry [µm]")
plt.axis("equal")
plt.xlabel("tip, x [mm]")
plt.ylabel("tip, y [mm]")
plt.show()
missed_mm = np.hypot(x_mm[-1], y_mm[-1])
print(f"entry held within {miss_mm.max():.3f} mm; tip back within {missed_mm:.2f} mm")
_, _, miss_mm = draw_circle(holds_entry=False)
print(f"without the remote centre the needle leaves it by {miss_mm.max():.0f} mm")
