"""An arm by a name of one line, such as ``ur:arm.example``, and its connection.

A program that runs on one arm runs on another by changing this line.
"""

import re
from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from needleforce.devices import fri, sunrise
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.errors import DeviceSettingError
from needleforce.devices.franka import Fr3Arm, FrankaArm
from needleforce.devices.fri import FriArm
from needleforce.devices.sunrise import IiwaArm
from needleforce.devices.ur import UrArm

LISTENING_NAME = re.compile(
    r"(?P<kind>fri|iiwa)(:(?P<host>[^:@]*[^:@\d][^:@]*))?(:(?P<port>\d+))?"
    r"(@(?P<peer>.+))?"
)
"""``fri[:LOCAL_ADDRESS][:PORT][@CONTROLLER]``; a local address is not all digits."""

CALLED_NAME = re.compile(r"(?P<kind>fr3|franka|ur):(?P<host>.+)")


class ArmAddress(NamedTuple):
    """An arm that a user has named.

    Attributes:
        kind: Its interface, such as ``fri``.
        host: Its address; of this machine where its controller sends to that.
        port: To which a controller sends; None for the usual one.
        peer: The controller; None: the first that sends something valid.
    """

    kind: str
    host: str
    port: int | None = None
    peer: str | None = None


def parse_arm_name(name: str) -> ArmAddress:
    """Split the name of an arm into its kind and its addresses.

    Args:
        name: Such as ``fri``, ``fri:pc.example:30200@kuka.example`` or
            ``ur:arm.example``.

    Raises:
        DeviceSettingError: No such arm, or a controller elsewhere that could not reach
            loopback.
    """
    if called := CALLED_NAME.fullmatch(name):
        return ArmAddress(called["kind"], called["host"])
    listening = LISTENING_NAME.fullmatch(name)
    if listening is None:
        raise DeviceSettingError(
            f"{name!r}: expected an arm as fri or iiwa, with "
            "[:LOCAL_ADDRESS][:PORT][@CONTROLLER], fr3:ADDRESS, franka:ADDRESS, "
            "ur:ADDRESS"
        )

    peer = listening["peer"]
    if peer and not listening["host"] and not peer.startswith("127."):
        raise DeviceSettingError(
            f"{name!r}: {peer} cannot send to {LOOPBACK}; name the address of this "
            f"machine that it sends to, as {listening['kind']}:LOCAL_ADDRESS@{peer}"
        )
    port = int(listening["port"]) if listening["port"] else None
    return ArmAddress(listening["kind"], listening["host"] or LOOPBACK, port, peer)


def connect_arm(
    name: str,
    *,
    takes_commands: bool = False,
    robot: Any = None,
    torque_constant_Nm_A: ArrayLike | None = None,
) -> Any:
    """Open the connection to an arm.

    Args:
        name: As `parse_arm_name` takes it.
        takes_commands: Whether the arm shall move. A controller that sends to this
            machine decides itself, and is always ready.
        robot: The model of the arm, kept for those who need both.
        torque_constant_Nm_A: Joint torque per motor current of a UR, shape (6,).

    Returns:
        One of `needleforce.devices`: iterate over its readings, `send` joint
        velocities, `close` it or use it in a ``with`` statement. Its `limits` are for a
        `needleforce.control.Controller`, if its model is given.

    Raises:
        DeviceError: No such arm, no client library, or no answer.
    """
    kind, host, port, peer = parse_arm_name(name)
    if kind == "fri":
        return FriArm(host, fri.PORT if port is None else port, peer=peer, robot=robot)
    if kind == "iiwa":
        port = sunrise.PORT if port is None else port
        return IiwaArm(host, port, peer=peer, robot=robot)
    if kind == "ur":
        return UrArm(
            host,
            takes_commands=takes_commands,
            torque_constant_Nm_A=torque_constant_Nm_A,
            robot=robot,
        )

    arm_type = Fr3Arm if kind == "fr3" else FrankaArm
    return arm_type(host, takes_commands=takes_commands, robot=robot)
