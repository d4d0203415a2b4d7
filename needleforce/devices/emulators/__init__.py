"""Emulated devices to rehearse with: each in a process of its own, over loopback.

    with Emulator(emulate_fri, FriSettings(port=49938, q_rad=q, tau_Nm=tau)):
        ...

They speak the devices' own protocols in real time, and fall silent on demand.

Reading order: `process` (of an emulator), `fri`.
"""

from needleforce.devices.emulators.fri import (
    FriSettings as FriSettings,
)
from needleforce.devices.emulators.fri import (
    emulate_fri as emulate_fri,
)
from needleforce.devices.emulators.process import Emulator as Emulator
