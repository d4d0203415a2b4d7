"""Moving the needle: tasks in strict priority, guidance, teleoperation, autonomy, the manager.

    control = Controller(robot, Limits(robot))
    for sample in arm:
        command = control.update(sample, [RemoteCentre(trocar_m), TipVelocity(wish_m_s)])
        arm.send(command.dq_rad_s)

Not a medical device: nothing here is claimed beyond the simulation it is measured on.

Reading order: `ports` (what lies outside), `errors`.
"""

from needleforce.control.errors import ControlError, RefusedError, SettingError
from needleforce.control.event_log import LoggedEvent, read_events
from needleforce.control.insertion_profile import InsertionPlan, InsertionProfile, depth_of
from needleforce.control.manager import Manager, Situation, State, replay
from needleforce.control.monitors import Beside, SafetyLimits
from needleforce.control.ports import Arm, ArmSample, ForceSensor, HapticDevice, MasterSample

__all__ = [
    "Arm",
    "ArmSample",
    "Beside",
    "ControlError",
    "ForceSensor",
    "HapticDevice",
    "InsertionPlan",
    "InsertionProfile",
    "LoggedEvent",
    "Manager",
    "MasterSample",
    "RefusedError",
    "SafetyLimits",
    "SettingError",
    "Situation",
    "State",
    "depth_of",
    "read_events",
    "replay",
]
