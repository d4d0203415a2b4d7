"""One program, any arm
====================

The needle makes a stroke in free air, rests for the tare, and makes the stroke again.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import SimulatedArm
from needleforce import InsertionSession, control
from residual import Status

STROKE_s = 2.0  # down and up again
REST_s = 0.5  # before the tare
SPEED_m_s = 0.03  # at most

# A real arm is another line, with connect_arm of needleforce.devices:
# arm = connect_arm("fr3:ADDRESS", robot=load_urdf("fr3.urdf"), takes_commands=True)
arm = SimulatedArm(plant="clean", duration_s=8.0)
session = InsertionSession(arm.robot)
manager = control.Manager(session, control.SafetyLimits(axial_N=6.0))
limits = control.Limits.of_arm(arm.robot, arm.preset)
controller = control.Controller(arm.robot, limits)
stroke = control.AxialSpeed(0.0)
tasks = []
moved_s = rested_s = 0.0
rows = []
with arm:  # at its end a real arm is braked
    for tick in control.run(arm, controller, manager):
        sample, state = tick.sample, tick.situation.state
        estimate = tick.situation.estimate
        if not tasks:
            controller.tool.update(sample.q_rad)
            posture = control.Posture(sample.q_rad)
            tasks = [control.Fixture.here(controller.tool), stroke, posture]
        if state == "idle" and getattr(sample, "accepts_commands", True):
            manager.request("approach" if session.tared else "tare")
        is_moving = state == "approach" or (state == "tare" and moved_s < STROKE_s)
        moved_s += sample.dt_s * is_moving
        rested_s += sample.dt_s * (state == "tare" and not is_moving)
        swing = np.sin(2.0 * np.pi * moved_s / STROKE_s)
        stroke.speed_m_s = -SPEED_m_s * swing * is_moving
        if rested_s > REST_s and not session.tared:
            manager.request("arrived")  # tared beside the next 1000 ticks or so
        if estimate.status is Status.OK:
            rows.append((moved_s, estimate.wrench.axial))
        tick.tasks = tasks
        if moved_s > 2.0 * STROKE_s:
            break
plt.plot(*np.transpose(rows))
plt.show()
print(f"after the tare at most {max(abs(force_N) for _, force_N in rows):.2f} N")
