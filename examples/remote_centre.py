"""The needle turns about its entry point while the tip draws a circle.

The simulated arm stands in for yours; see `needleforce.control.ports.Arm`. Not a
medical device.
"""

import math

from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import Trocar
from needleforce.control import Controller, Limits, Posture, RemoteCentre, TipVelocity

# entry above the tip, circle, time for one turn
ENTRY_m = 0.08
RADIUS_m = 0.01
TURN_s = 2.0
trocar = Trocar(behind_tip_m=ENTRY_m)
arm = SimulatedArm(plant="clean", contacts=[trocar], duration_s=TURN_s + 0.5)
control = Controller(arm.robot, Limits(arm.robot))
tool = control.tool
tool.update(next(arm).q_rad)
start_m = tool.tip_m

entry = RemoteCentre(
    start_m - ENTRY_m * tool.axis
)  # first: whatever comes below, it holds
tip = TipVelocity((0.0, 0.0, 0.0), start_m, gain_per_s=10.0)
stack = [entry, tip, Posture(arm.home_rad)]

worst_m = 0.0
for sample in arm:
    angle = 2.0 * math.pi * min(arm.time_s / TURN_s, 1.0)
    offset = RADIUS_m * (1.0 - math.cos(angle)), RADIUS_m * math.sin(angle), 0.0
    tip.goal_m = start_m + offset
    command = control.update(sample, stack)  # never raises; within all limits
    arm.send(command.dq_rad_s)
    worst_m = max(worst_m, arm.distance_to_axis_m(trocar.point_m))

back_m = math.dist(arm.truth.tip_m, start_m)
print(
    f"entry held within {1e3 * worst_m:.3f} mm; tip back within {1e3 * back_m:.2f} mm"
)
