"""Teleoperation: feel the force at the tip
=========================================

A hand on a haptic device drives the needle. It is shown the force at the tip, without
the friction of the shaft.
"""

import matplotlib.pyplot as plt

from groundtruth import HapticMaster, Operator, SimulatedArm
from needleforce import InsertionSession, control

HAND_SPEED_m_s = 12e-3
STROKE_s = 2.0  # a free stroke before the tare
TARE_s = 2.4  # after a rest

# Emulated arm, hand and device stand in for yours.
arm = SimulatedArm("stack-glove-constant", standoff_m=0.045, duration_s=9.0)
device = HapticMaster(Operator(wish_m=lambda t_s: (0.0, 0.0, HAND_SPEED_m_s * t_s)))
session = InsertionSession(arm.robot)
manager = control.Manager(session, control.SafetyLimits(axial_N=6.0))
limits = control.Limits.of_arm(arm.robot, arm.preset)
controller = control.Controller(arm.robot, limits)
controller.tool.update(arm.home_rad)
shaft = control.Fixture.here(controller.tool)
posture = control.Posture(arm.home_rad)
teleoperation = control.Teleoperation(motion_scale=0.4, shown="tip")
rows = []
for tick in control.run(arm, controller, manager):
    state, estimate = tick.situation.state, tick.situation.estimate
    handle = tick.check_handle(device.read())
    speed_m_s = 0.0
    if state == "idle":
        manager.request("teleoperate" if session.tared else "tare")
    elif state == "tare":
        speed_m_s = 0.02 if arm.time_s < STROKE_s else 0.0
        if arm.time_s > TARE_s:
            manager.request("arrived")  # it rests for about a second
    elif state == "teleop":
        move = teleoperation.update(handle, estimate, tick.sample.dt_s)
        device.render(move.force_N)  # passive at the hand, whatever the line does
        speed_m_s = move.speed_m_s
        rows.append((arm.time_s, estimate.wrench.axial, teleoperation.shown_N))
    tick.tasks = [shaft, control.AxialSpeed(speed_m_s), posture]

times_s, axial_N, shown_N = zip(*rows, strict=True)
plt.plot(times_s, axial_N, label="force on the needle")
plt.plot(times_s, shown_N, label="force shown to the hand")
plt.xlabel("time [s]")
plt.ylabel("force [N]")
plt.legend()
plt.show()
print(f"{1e3 * arm.truth.depth_m:.1f} mm deep, {teleoperation.shown_N:.2f} N shown")
print(f"least energy that the hand had given: {1e3 * device.least_energy_J:.3f} mJ")
