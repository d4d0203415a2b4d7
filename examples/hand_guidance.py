"""Lead the arm by hand
=====================

The arm yields to a hand on the needle's hub, which it feels through its joint torques.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import HandOnArm, SimulatedArm
from needleforce import control
from residual import SensorConfig, Status, VirtualForceSensor

TARE_s = 3.0  # a stroke in free air until then
PUSH_s = TARE_s + 0.5
PUSH_N = 4.0
hand = HandOnArm(at="hub", force_N=lambda t_s: (PUSH_N * (t_s > PUSH_s), 0.0, 0.0))
arm = SimulatedArm(plant="clean", contacts=[hand], duration_s=TARE_s + 1.5)
limits = control.Limits.of_arm(arm.robot, arm.preset)
controller = control.Controller(arm.robot, limits)
controller.tool.update(arm.home_rad)
line = control.Fixture.here(controller.tool)
guidance = control.Guidance(arm.robot)
sensor = VirtualForceSensor(arm.robot, SensorConfig(smooth_momentum=False))
tips_m = []
for tick in control.run(arm, controller):
    sample = tick.sample
    wrench = sensor.update(sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s)
    if arm.time_s < TARE_s:  # move along the needle: the tare learns from it
        speed_m_s = -0.05 * np.sin(2.0 * np.pi * arm.time_s / TARE_s)
        tasks = [line, control.AxialSpeed(speed_m_s)]
    else:
        if not sensor.tared:
            sensor.tare()
        is_ok = wrench.status is Status.OK
        noise_Nm = sensor.residual_std_Nm
        lead = guidance.update(wrench.residual, noise_Nm, sample.dt_s, is_valid=is_ok)
        tasks = [lead]
    tick.tasks = tasks
    tips_m.append(arm.truth.tip_m)

moved_mm = 1e3 * (np.array(tips_m) - tips_m[0])
times_s = np.linspace(0.0, arm.time_s, len(moved_mm))
plt.plot(times_s, moved_mm, label=["x", "y", "z"])
plt.axvspan(PUSH_s, arm.time_s, alpha=0.15, label=f"the hand pushes by {PUSH_N:g} N")
plt.xlabel("time [s]")
plt.ylabel("motion of the tip [mm]")
plt.legend()
plt.show()
print(f"pushed for a second, the tip moved {np.linalg.norm(moved_mm[-1]):.0f} mm")
