"""Franka arms through libfranka at 1 kHz: FR3 and FER (Panda).

Both through the client library franky, which is built for one version of the arm's
interface at a time: the one of its package index speaks with an FR3. Its own thread in
C++ answers every cycle of the arm; velocities pass through Ruckig there.
"""

from typing import Any

import numpy as np

from foundation.arrays import Array
from needleforce.devices.client_arm import ClientArm, StampedReading
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.errors import import_client
from needleforce.devices.link import GIVE_UP_S, ArmReading

JOINTS = 7
PERIOD_S = 1e-3

HOLD_MS = 5
"""So long franky holds a velocity without a new one; then it brakes the arm."""


class FrankaArm(ClientArm):
    """A Franka FER (Panda) through a franky that is built for it (libfranka 0.9).

    `external_Nm` of a reading is the arm's own filtered estimate. With
    ``takes_commands`` velocities given to `send` move the arm, under its impedance
    control; a program that is busy or hangs makes the arm brake, not stop.

    Args:
        host: Address of the arm.
        takes_commands: Whether it shall move; otherwise it is only listened to.
        give_up_s: After so long a silence the arm is lost.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        client: franky's own ``Robot``, for what this driver does not offer, such as
            collision thresholds, the load, or ``model_urdf``, the arm's description of
            itself; None after `close`.
        preset: Name of its limits, see `needleforce.control.Limits.of_arm`.

    Raises:
        MissingClientError: franky is not installed.
        LinkError: The arm does not answer, or speaks another version.
    """

    preset = "fer"

    def __init__(
        self,
        host: str = LOOPBACK,
        *,
        takes_commands: bool = False,
        give_up_s: float = GIVE_UP_S,
        robot: Any = None,
    ) -> None:
        self._library = import_client("franky", "franky-control")
        self.client: Any = None
        self._state_ms = -1  # time of the latest state
        super().__init__(
            host,
            JOINTS,
            PERIOD_S,
            (RuntimeError, self._library.Exception),
            takes_commands=takes_commands,
            give_up_s=give_up_s,
            robot=robot,
        )

    def _connect(self) -> None:
        self.client = None  # an arm serves one connection at a time
        real_time = self._library.RealtimeConfig.Ignore
        self.client = self._library.Robot(self._host, realtime_config=real_time)

    def _read_client(self) -> StampedReading | None:
        state = self.client.state
        state_ms = state.time.to_msec()
        if state_ms == self._state_ms:
            return None
        self._state_ms = state_ms
        reading = ArmReading(
            dt_s=PERIOD_S,
            q_rad=np.array(state.q),
            dq_rad_s=np.array(state.dq),
            tau_Nm=np.array(state.tau_J),
            external_Nm=np.array(state.tau_ext_hat_filtered),
            missed=0,
            accepts_commands=False,
            is_real=True,
        )
        return 1e-3 * state_ms, reading

    def _move(self, velocity_rad_s: Array | None) -> None:
        if velocity_rad_s is None:
            return
        library = self._library
        held = library.JointVelocityWaypoint(
            velocity_rad_s, hold_target_duration=library.Duration(HOLD_MS)
        )
        rest = library.JointVelocityWaypoint(np.zeros(JOINTS))
        motion = library.JointVelocityWaypointMotion([held, rest])
        self.client.move(motion, asynchronous=True)

    def _release(self) -> None:
        self.client = None


class Fr3Arm(FrankaArm):
    """A Franka FR3: as `FrankaArm`, with the franky of the package index."""

    preset = "fr3"
