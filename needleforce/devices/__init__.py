"""Real arms, force sensors and haptic devices, and emulators of them.

Whoever has no arm runs the same program against an emulator, which speaks the device's own protocol
from a process of its own, or on the simulated arm. Links bind and connect to loopback unless an
address is named. What is malformed, old or from elsewhere is counted in a `LinkReport` and never
handed on.

Reading order: `proxy` (what a device offers, samples, reports), `fri` (KUKA LWR 4+), `rdt` (ATI Net
F/T), `research_arms` (Franka, UR), `haptic`, `emulators`.
"""

from needleforce.devices.fri import FriArm
from needleforce.devices.haptic import HaplyMaster
from needleforce.devices.proxy import (
    ArmSample,
    DeviceError,
    DeviceSettingError,
    LinkError,
    LinkReport,
    MasterSample,
    MissingClientError,
    ReplayArm,
    paced,
)
from needleforce.devices.rdt import NetFT, Scale
from needleforce.devices.research_arms import FrankaArm, UrArm

__all__ = [
    "ArmSample",
    "DeviceError",
    "DeviceSettingError",
    "FrankaArm",
    "FriArm",
    "HaplyMaster",
    "LinkError",
    "LinkReport",
    "MasterSample",
    "MissingClientError",
    "NetFT",
    "ReplayArm",
    "Scale",
    "UrArm",
    "paced",
]
