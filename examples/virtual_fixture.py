"""A virtual fixture keeps the needle on its line
===============================================

A joystick asks for a velocity that points partly aside. With the fixture above it in
the stack of tasks, only the part along the needle is followed.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import SimulatedArm
from needleforce import control

JOYSTICK_m_s = (0.01, 0.005, -0.02)  # aside, and down along the needle


def drive(with_fixture):
    """Return the path of the tip, shape (3, n) [mm]."""
    arm = SimulatedArm(plant="clean", duration_s=2.0)
    limits = control.Limits.of_arm(arm.robot, arm.preset)
    controller = control.Controller(arm.robot, limits)
    controller.tool.update(arm.home_rad)
    fixture = control.Fixture.here(controller.tool)
    joystick = control.TipVelocity(JOYSTICK_m_s)
    posture = control.Posture(arm.home_rad)

    # The first task has priority; what it leaves free is the next one's.
    tasks = [joystick, posture]
    if with_fixture:
        tasks = [fixture, joystick, posture]
    start_m = arm.truth.tip_m
    path_mm = []
    for tick in control.run(arm, controller):
        tick.tasks = tasks
        path_mm.append(1e3 * (arm.truth.tip_m - start_m))
    return np.array(path_mm).T


for with_fixture, name in ((False, "joystick alone"), (True, "below a fixture")):
    x_mm, y_mm, z_mm = drive(with_fixture)
    aside_mm = np.hypot(x_mm, y_mm)
    plt.plot(aside_mm, z_mm, label=name)
    print(f"{name}: {aside_mm[-1]:.2f} mm aside, {-z_mm[-1]:.1f} mm down")
plt.xlabel("tip, aside [mm]")
plt.ylabel("tip, along the needle [mm]")
plt.axis("equal")
plt.legend()
plt.show()
