"""Moving the needle: tasks in priority, guidance, teleoperation, autonomy, the manager.

    for tick in run(arm, Controller(robot, arm.limits), manager):
        tick.tasks = [RemoteCentre(trocar_m), TipVelocity(wish_m_s)]

Not a medical device: nothing here is claimed beyond the simulation it is measured on.

Reading order: `ports` (what lies outside), `tasks`, `joint_limits`, `priority_solver`,
`controller` (one tick), `state_machine`, `handle_watch`, `monitors`, `manager`, `run`,
`lag` (delay and gain), `tare_stroke`, `insertion_profile`, `guidance`, `passivity`,
`teleoperation`.
"""

from needleforce.control.controller import (
    Controller as Controller,
    DelayPrediction as DelayPrediction,
)
from needleforce.control.errors import (
    ControlError as ControlError,
    SettingError as SettingError,
)
from needleforce.control.guidance import Guidance as Guidance
from needleforce.control.handle_watch import (
    HandleReading as HandleReading,
    HandleReport as HandleReport,
    HandleWatch as HandleWatch,
)
from needleforce.control.insertion_profile import (
    InsertionPlan as InsertionPlan,
    InsertionProfile as InsertionProfile,
)
from needleforce.control.joint_limits import Limits as Limits
from needleforce.control.lag import (
    Delay as Delay,
    find_safe_gain as find_safe_gain,
    measure_lag as measure_lag,
)
from needleforce.control.manager import Manager as Manager, Situation as Situation
from needleforce.control.monitors import Beside as Beside, SafetyLimits as SafetyLimits
from needleforce.control.run import Tick as Tick, run as run
from needleforce.control.state_machine import State as State
from needleforce.control.tare_stroke import tare_with_stroke as tare_with_stroke
from needleforce.control.tasks import (
    AxialSpeed as AxialSpeed,
    Fixture as Fixture,
    JointVelocity as JointVelocity,
    Posture as Posture,
    RemoteCentre as RemoteCentre,
    Task as Task,
    TipVelocity as TipVelocity,
    ToolState as ToolState,
)
from needleforce.control.teleoperation import Teleoperation as Teleoperation
from needleforce.devices.arm_limits import (
    ARM_LIMITS as ARM_LIMITS,
    ArmLimits as ArmLimits,
)
