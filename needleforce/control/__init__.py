"""Moving the needle: tasks in strict priority, guidance, teleoperation, autonomy, the manager.

    control = Controller(robot, Limits(robot))
    for sample in arm:
        command = control.update(sample, [RemoteCentre(trocar_m), TipVelocity(wish_m_s)])
        arm.send(command.dq_rad_s)

Not a medical device: nothing here is claimed beyond the simulation it is measured on.

Reading order: `ports` (what lies outside), `errors`.
"""

from needleforce.control.errors import ControlError, RefusedError, SettingError
from needleforce.control.ports import Arm, ArmSample, ForceSensor, HapticDevice, MasterSample

__all__ = [
    "Arm",
    "ArmSample",
    "ControlError",
    "ForceSensor",
    "HapticDevice",
    "MasterSample",
    "RefusedError",
    "SettingError",
]
