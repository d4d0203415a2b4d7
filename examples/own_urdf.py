"""Your own arm from its URDF
===========================

Load a URDF, say which frame is the flange and what hangs there, and check the model
first: its gravity torque at rest should be what your torque sensors read.
"""

from importlib.resources import as_file, files

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from urdf import NeedleTool, load_urdf

JOINT = 1  # the shoulder, which carries the arm

# A file that ships with the package stands in for yours.
with as_file(files("urdf.data") / "lwr4plus.urdf") as path:
    bare = load_urdf(path, tool_frame="flange")
    arm = load_urdf(path, tool_frame="flange", payload=NeedleTool())

print(f"{arm.nv} joints: {', '.join(arm.joint_names)}")
print(f"flange {arm.flange_frame}, tool frame {arm.tool_frame}")

angles_deg = np.linspace(-110.0, 110.0, 100)
for robot, name in ((bare, "bare arm"), (arm, "with force sensor and needle")):
    data = robot.create_data()
    torques_Nm = []
    for angle_deg in angles_deg:
        q_rad = np.zeros(robot.nv)
        q_rad[JOINT] = np.radians(angle_deg)
        gravity_Nm = pin.computeGeneralizedGravity(robot.model, data, q_rad)
        torques_Nm.append(gravity_Nm[JOINT])
    plt.plot(angles_deg, torques_Nm, label=name)
plt.xlabel(f"angle of {arm.joint_names[JOINT]} [deg]")
plt.ylabel("gravity torque [Nm]")
plt.legend()
plt.show()
