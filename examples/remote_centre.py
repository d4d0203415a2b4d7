"""The needle turns about its entry point while the tip draws a circle.

The simulated arm stands in for yours; see `needleforce.control.ports.Arm`. Not a
medical device.
"""

import math

import numpy as np

from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import Trocar
from needleforce.control import Controller, Limits, Posture, RemoteCentre, TipVelocity

ENTRY_m = 0.08  # height of the entry above the tip
RADIUS_m = 0.01  # of the circle
TURN_s = 2.0  # time for one turn

trocar = Trocar(behind_tip_m=ENTRY_m)
arm = SimulatedArm(plant="clean", contacts=[trocar], duration_s=TURN_s + 0.5)

control = Controller(arm.robot, Limits(arm.robot))
tool = control.tool
tool.update(next(arm).q_rad)
start_m = tool.tip_m

# The first task has priority: whatever comes below, the entry holds.
entry = RemoteCentre(start_m - ENTRY_m * tool.axis)
tip = TipVelocity((0.0, 0.0, 0.0), start_m, gain_per_s=10.0)
tasks = [entry, tip, Posture(arm.home_rad)]

worst_m = 0.0
for sample in arm:
    angle = 2.0 * math.pi * min(arm.time_s / TURN_s, 1.0)
    x_m = RADIUS_m * (1.0 - math.cos(angle))
    y_m = RADIUS_m * math.sin(angle)
    tip.goal_m = start_m + np.array([x_m, y_m, 0.0])

    command = control.update(sample, tasks)  # never raises; within all limits
    arm.send(command.dq_rad_s)
    worst_m = max(worst_m, arm.distance_to_axis_m(trocar.point_m))

missed_m = math.dist(arm.truth.tip_m, start_m)
print(
    f"entry held within {1e3 * worst_m:.3f} mm; tip back within {1e3 * missed_m:.2f} mm"
)
