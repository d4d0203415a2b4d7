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

SETTLED_s = 0.3

arm = SimulatedArm("stack-glove-constant", standoff_m=5e-3, duration_s=25.0)

# The manager holds the session and decides in which state the insertion is.
manager = Manager(InsertionSession(arm.robot), SafetyLimits(axial_N=6.0))

# The controller turns a stack of tasks into joint velocities within the arm's limits.
control = Controller(arm.robot, Limits(arm.robot))
control.tool.update(arm.home_rad)
shaft = Fixture.here(control.tool, 20.0)
posture = Posture(arm.home_rad)

# The program asks for a speed along the needle in each state.
plan = InsertionPlan(speed_m_s=5e-3, depth_m=0.06, layer=1)
program = InsertionProfile(plan)

beside = Beside()
for sample in arm:
    manager.heartbeat()  # this program is alive
    state = manager.update(sample, beside)

    step = program.update(state)
    if step.event:
        refusal = manager.request(step.event)
        if refusal:
            print("refused:", refusal)

    tasks = [shaft, AxialSpeed(step.speed_m_s), posture]
    command = control.update(sample, tasks)
    is_accepted = arm.send(command.dq_rad_s)
    beside = Beside(is_accepted, command.dq_rad_s)

    if state.state == "dwell" and state.state_s > SETTLED_s:
        break

print(f"rests {1e3 * arm.truth.depth_m:.1f} mm deep, in state {state.state}")
