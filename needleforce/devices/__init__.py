"""Real arms, force sensors and haptic devices, and emulators of them.

Whoever has no arm runs the same program against an emulator, which speaks the device's
own protocol from a process of its own, or on the simulated arm. Links bind and connect
to loopback unless an address is named. What is malformed, old or foreign is counted in
a `LinkReport`, never handed on.

Reading order: `link` (what a device offers, readings, reports), `errors`,
`datagram_link` (UDP), `arm_limits` and `guard` (the last thing before every arm),
`controller_link` (controllers that send a packet a cycle), `fri`
(KUKA LWR 4+), `sunrise_messages` and `sunrise` (KUKA LBR iiwa), `client_arm` (arms
behind a vendor's client library), `franka` (FER, FR3), `ur` (UR e-Series), `rdt` (ATI
Net F/T), `haply`, `arm_names` (any arm by a name of one line).

Emulators: `emulators`.
"""

from needleforce.devices.arm_limits import (
    ARM_LIMITS as ARM_LIMITS,
    ArmLimits as ArmLimits,
)
from needleforce.devices.arm_names import (
    connect_arm as connect_arm,
    parse_arm_name as parse_arm_name,
)
from needleforce.devices.emulators import (
    Emulator as Emulator,
    FriSettings as FriSettings,
    emulate_fri as emulate_fri,
)
from needleforce.devices.errors import (
    DeviceError as DeviceError,
    DeviceSettingError as DeviceSettingError,
    LinkError as LinkError,
    MissingClientError as MissingClientError,
)
from needleforce.devices.franka import Fr3Arm as Fr3Arm, FrankaArm as FrankaArm
from needleforce.devices.fri import FriArm as FriArm
from needleforce.devices.haply import HaplyMaster as HaplyMaster
from needleforce.devices.link import (
    ArmReading as ArmReading,
    Link as Link,
    LinkReport as LinkReport,
    MasterReading as MasterReading,
    ReplayArm as ReplayArm,
    pace as pace,
)
from needleforce.devices.rdt import (
    NetFT as NetFT,
    Scale as Scale,
    describe_status as describe_status,
)
from needleforce.devices.sunrise import IiwaArm as IiwaArm
from needleforce.devices.ur import UrArm as UrArm
