"""A hand on a haptic device drives the needle and feels the force at its tip.

Emulated arm, hand and device stand in for yours; see `needleforce.control.ports`. Not a
medical device.
"""

from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_operator import HapticMaster, Operator
from needleforce import InsertionSession
from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    Limits,
    Posture,
    Teleoperation,
)

HAND_SPEED_m_s = 12e-3
STROKE_s = 2.0  # a free stroke before the tare
TARE_s = 2.4  # after a rest

arm = SimulatedArm("stack-glove-constant", standoff_m=0.045, duration_s=9.0)
operator = Operator(wish_m=lambda t_s: (0.0, 0.0, HAND_SPEED_m_s * t_s))
device = HapticMaster(operator)

session = InsertionSession(arm.robot)
control = Controller(arm.robot, Limits(arm.robot))
control.tool.update(arm.home_rad)
shaft = Fixture.here(control.tool)
posture = Posture(arm.home_rad)
teleoperation = Teleoperation(motion_scale=0.4, shown="tip")

for sample in arm:
    estimate = session.update(sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s)

    if not session.tared:
        speed_m_s = 0.02 if arm.time_s < STROKE_s else 0.0
        if arm.time_s > TARE_s:
            session.tare()
    else:
        move = teleoperation.update(device.read(), estimate, sample.dt_s)
        device.render(move.force_N)  # passive at the hand, whatever the line does
        speed_m_s = move.speed_m_s

    command = control.update(sample, [shaft, AxialSpeed(speed_m_s), posture])
    arm.send(command.dq_rad_s)

print(f"{1e3 * arm.truth.depth_m:.1f} mm deep, {teleoperation.shown_N:.2f} N shown")
print(f"least energy at the hand's port: {1e3 * device.least_energy_J:.3f} mJ")
