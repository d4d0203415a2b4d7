"""A known push on an arm at rest
=================================

The momentum observer reports the torque that the environment exerts on each joint,
late by 1/K.
"""

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from residual import MomentumObserver
from urdf import NeedleTool, load_lwr

TICK_s = 1e-3
GAIN_per_s = 70.0
PUSH_N = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])  # up, against the needle's tip
PUSH_START_s = 0.1
q_rad = np.array([0.0, 0.6, 0.0, -1.2, 0.0, 1.3, 0.0])
at_rest = np.zeros(7)

robot = load_lwr(payload=NeedleTool())
data = robot.create_data()
gravity_Nm = pin.computeGeneralizedGravity(robot.model, data, q_rad)
jacobian = pin.computeFrameJacobian(
    robot.model, data, q_rad, robot.tool_frame_id, pin.LOCAL_WORLD_ALIGNED
)
push_Nm = jacobian.T @ PUSH_N

times_s = np.arange(0.0, 0.3, TICK_s)
observer = MomentumObserver(robot, GAIN_per_s)
residuals_Nm = []
for t_s in times_s:
    external_Nm = push_Nm if t_s > PUSH_START_s else at_rest
    measured_Nm = gravity_Nm - external_Nm  # the motors hold against both
    residuals_Nm.append(observer.update(q_rad, at_rest, measured_Nm, TICK_s))

for joint in (1, 3, 5):
    (line,) = plt.plot(times_s, np.array(residuals_Nm)[:, joint], label=f"J{joint + 1}")
    plt.hlines(push_Nm[joint], PUSH_START_s, times_s[-1], line.get_color(), "dotted")
plt.axvline(PUSH_START_s + 1.0 / GAIN_per_s, color="gray", lw=1, label="1/K later")
plt.xlabel("time [s]")
plt.ylabel("external torque [Nm]")
plt.legend(title="dotted: true")
plt.show()

error_Nm = np.abs(residuals_Nm[-1] - push_Nm).max()
print(f"after {times_s[-1] - PUSH_START_s:.1f} s within {error_Nm:.5f} Nm")
