"""Real arms, force sensors and haptic devices, and emulators of them.

Whoever has no arm runs the same program against an emulator, which speaks the device's
own protocol from a process of its own, or on the simulated arm. Links bind and connect
to loopback unless an address is named. What is malformed, old or foreign is counted in
a `LinkReport`, never handed on.

Reading order: `proxy` (what a device offers, samples, reports), `fri` (KUKA LWR 4+),
`rdt` (ATI Net F/T), `research_arms` (Franka, UR), `haptic`, `emulators`.
"""

from needleforce.devices.fri import FriArm as FriArm
from needleforce.devices.haptic import HaplyMaster as HaplyMaster
from needleforce.devices.proxy import (
    ArmSample as ArmSample,
    DeviceError as DeviceError,
    DeviceSettingError as DeviceSettingError,
    LinkError as LinkError,
    LinkReport as LinkReport,
    MasterSample as MasterSample,
    MissingClientError as MissingClientError,
    ReplayArm as ReplayArm,
    paced as paced,
)
from needleforce.devices.rdt import NetFT as NetFT, Scale as Scale
from needleforce.devices.research_arms import FrankaArm as FrankaArm, UrArm as UrArm
