"""Moving the needle: tasks in strict priority, guidance, teleoperation, autonomy, the manager.

    control = Controller(robot, Limits(robot))
    for sample in arm:
        command = control.update(sample, [RemoteCentre(trocar_m), TipVelocity(wish_m_s)])
        arm.send(command.dq_rad_s)

Not a medical device: nothing here is claimed beyond the simulation it is measured on.

Reading order: `ports` (what lies outside), `tool_state`, `tasks`, `velocity_box`,
`priority_solver`, `controller` (one tick), `manager`, `passivity`, `teleoperation`.
"""

from needleforce.control.controller import Command, CommandStatus, Controller
from needleforce.control.errors import ControlError, RefusedError, SettingError
from needleforce.control.event_log import LoggedEvent, read_events
from needleforce.control.guidance import Guidance
from needleforce.control.insertion_profile import InsertionPlan, InsertionProfile, depth_of
from needleforce.control.manager import Manager, Situation, State, replay
from needleforce.control.monitors import Beside, SafetyLimits
from needleforce.control.ports import (
    Arm,
    ArmReading,
    ArmSample,
    ForceSensor,
    HapticDevice,
    MasterReading,
    MasterSample,
)
from needleforce.control.tasks import (
    AxialSpeed,
    DecoupledMotion,
    Fixture,
    JointVelocity,
    Orientation,
    Posture,
    RemoteCentre,
    Task,
    TipVelocity,
)
from needleforce.control.teleoperation import DelayLine, TeleopCommand, Teleoperation, shown_force
from needleforce.control.tool_state import ToolState
from needleforce.control.velocity_box import Limits

__all__ = [
    "Arm",
    "ArmReading",
    "ArmSample",
    "AxialSpeed",
    "Beside",
    "Command",
    "CommandStatus",
    "ControlError",
    "Controller",
    "DecoupledMotion",
    "DelayLine",
    "Fixture",
    "ForceSensor",
    "Guidance",
    "HapticDevice",
    "InsertionPlan",
    "InsertionProfile",
    "JointVelocity",
    "Limits",
    "LoggedEvent",
    "Manager",
    "MasterReading",
    "MasterSample",
    "Orientation",
    "Posture",
    "RefusedError",
    "RemoteCentre",
    "SafetyLimits",
    "SettingError",
    "Situation",
    "State",
    "Task",
    "TeleopCommand",
    "Teleoperation",
    "TipVelocity",
    "ToolState",
    "depth_of",
    "read_events",
    "replay",
    "shown_force",
]
