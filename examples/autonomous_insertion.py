"""The needle stops by itself once it has left the first layer.

A simulated arm stands in for yours; see `needleforce.control.ports`. Not a medical
device.
"""

from groundtruth.rig_arm import SimulatedArm
from needleforce import InsertionSession
from needleforce.control import (
    AxialSpeed,
    Beside,
    Controller,
    Fixture,
    InsertionPlan,
    InsertionProfile,
    Limits,
    Manager,
    Posture,
    SafetyLimits,
)

arm = SimulatedArm("stack-glove-constant", standoff_m=5e-3, duration_s=25.0)
manager = Manager(InsertionSession(arm.robot), SafetyLimits(axial_N=6.0))
control = Controller(arm.robot, Limits(arm.robot))
beside = Beside()
control.tool.update(arm.home_rad)
shaft = Fixture.here(control.tool, 20.0)
posture = Posture(arm.home_rad)
program = InsertionProfile(InsertionPlan(speed_m_s=5e-3, depth_m=0.06, layer=1))

for sample in arm:
    manager.heartbeat()  # this program is alive
    now = manager.update(sample, beside)
    step = program.update(now)
    if step.event and (refusal := manager.request(step.event)):
        print("refused:", refusal)
    command = control.update(
        sample, [shaft, AxialSpeed(step.speed_m_s), posture]
    ).dq_rad_s
    beside = Beside(arm.send(command), command)
    if now.state == "dwell" and now.state_s > 0.3:
        break

print(f"rests {1e3 * arm.truth.depth_m:.1f} mm deep, in state {now.state}")
