"""An insertion that stops by itself
==================================

The needle is to stop once it has left the first layer. Not a medical device.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import SimulatedArm
from needleforce import InsertionSession, control

arm = SimulatedArm("stack-glove-constant", standoff_m=5e-3, duration_s=25.0)

# The manager holds the session and decides in which state the insertion is.
session = InsertionSession(arm.robot)
manager = control.Manager(session, control.SafetyLimits(axial_N=6.0))
# The controller turns a stack of tasks into joint velocities within the arm's limits.
limits = control.Limits.of_arm(arm.robot, arm.preset)
controller = control.Controller(arm.robot, limits)
controller.tool.update(arm.home_rad)
shaft = control.Fixture.here(controller.tool, 20.0)
posture = control.Posture(arm.home_rad)
# The program asks for a speed along the needle in each state.
plan = control.InsertionPlan(speed_m_s=5e-3, depth_m=0.06, layer=1)
program = control.InsertionProfile(plan)
rows = []
for tick in control.run(arm, controller, manager):
    state = tick.situation
    step = program.update(state)
    if step.event:
        manager.request(step.event)
    tick.tasks = [shaft, control.AxialSpeed(step.speed_m_s), posture]
    rows.append((arm.time_s, arm.truth.depth_m, str(state.state)))
    if state.state == "dwell" and state.state_s > 0.3:
        break

times_s, depths_m, states = map(np.array, zip(*rows, strict=True))
for name in dict.fromkeys(states):
    plt.plot(times_s[states == name], 1e3 * depths_m[states == name], ".", label=name)
plt.xlabel("time [s]")
plt.ylabel("depth [mm]")
plt.legend()
plt.show()
print(f"rests {1e3 * arm.truth.depth_m:.1f} mm deep, in state {state.state}")
rupture = next(one for one in arm.tissue_truth().ruptures if one.layer == 1)
past_mm = 1e3 * (depths_m.max() - rupture.onset_m)
print(f"went {past_mm:.2f} mm past the rupture that it stops for")
