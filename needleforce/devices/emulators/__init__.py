"""Emulated devices to rehearse with: each in a process of its own, over loopback.

    with Emulator(emulate_fri, FriSettings(port=49938, q_rad=q, tau_Nm=tau)):
        ...

They speak the devices' own protocols in real time, over a wire that breaks on demand.

Reading order: `process` (of an emulator), `wire`, `fri`, `rdt`.
"""

from needleforce.devices.emulators.fri import (
    FriSettings as FriSettings,
)
from needleforce.devices.emulators.fri import (
    emulate_fri as emulate_fri,
)
from needleforce.devices.emulators.process import Emulator as Emulator
from needleforce.devices.emulators.rdt import (
    RdtSettings as RdtSettings,
)
from needleforce.devices.emulators.rdt import (
    emulate_rdt as emulate_rdt,
)
from needleforce.devices.emulators.wire import WireFaults as WireFaults
