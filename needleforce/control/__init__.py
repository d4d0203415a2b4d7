"""Moving the needle: tasks in strict priority, guidance, teleoperation, autonomy, the manager.

    control = Controller(robot, Limits(robot))
    for sample in arm:
        command = control.update(sample, [RemoteCentre(trocar_m), TipVelocity(wish_m_s)])
        arm.send(command.dq_rad_s)

Not a medical device: nothing here is claimed beyond the simulation it is measured on.

Reading order: `ports` (what lies outside), `tool_state`, `tasks`, `velocity_box`,
`priority_solver`, `controller` (one tick), `manager`, `passivity`, `teleoperation`.
"""

from needleforce.control.controller import Controller
from needleforce.control.errors import ControlError, SettingError
from needleforce.control.event_log import read_events, write_mcap
from needleforce.control.guidance import Guidance
from needleforce.control.insertion_profile import InsertionPlan, InsertionProfile, depth_of
from needleforce.control.manager import Manager, Situation, State, replay
from needleforce.control.monitors import Beside, SafetyLimits
from needleforce.control.tasks import (
    AxialSpeed,
    DecoupledMotion,
    Fixture,
    Posture,
    RemoteCentre,
    Task,
    TipVelocity,
)
from needleforce.control.teleoperation import Teleoperation
from needleforce.control.velocity_box import Limits

__all__ = [
    "AxialSpeed",
    "Beside",
    "ControlError",
    "Controller",
    "DecoupledMotion",
    "Fixture",
    "Guidance",
    "InsertionPlan",
    "InsertionProfile",
    "Limits",
    "Manager",
    "Posture",
    "RemoteCentre",
    "SafetyLimits",
    "SettingError",
    "Situation",
    "State",
    "Task",
    "Teleoperation",
    "TipVelocity",
    "depth_of",
    "read_events",
    "replay",
    "write_mcap",
]
