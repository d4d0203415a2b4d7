"""An arm by a name of one line, such as ``ur:arm.example``, and its connection.

A program that runs on one arm runs on another by changing this line.
"""

from typing import Any, NamedTuple

from numpy.typing import ArrayLike

from needleforce.devices import fri, sunrise
from needleforce.devices.datagram_link import LOOPBACK, MAX_PORT
from needleforce.devices.errors import DeviceSettingError
from needleforce.devices.franka import Fr3Arm, FrankaArm
from needleforce.devices.fri import FriArm
from needleforce.devices.sunrise import IiwaArm
from needleforce.devices.ur import UrArm

LISTENING_KINDS = ("fri", "iiwa")
"""Arms whose controller sends to this machine."""

CALLED_KINDS = ("fr3", "franka", "ur")
"""Arms that are connected to at their own address."""

EXPECTED_NAMES = (
    "fri or iiwa, with [:LOCAL_ADDRESS][:PORT][@CONTROLLER], fr3:ADDRESS, "
    "franka:ADDRESS, ur:ADDRESS"
)
"""How arms are named, for messages."""


class ArmAddress(NamedTuple):
    """An arm that a user has named.

    Attributes:
        kind: Its interface, such as ``fri``.
        address: What follows the kind, such as ``arm.example``; empty for none.
    """

    kind: str
    address: str


class ListeningAddress(NamedTuple):
    """Where a controller's packets are expected.

    Attributes:
        host: Address of this machine.
        port: To which the controller sends; None for the usual one.
        peer: The controller; None: the first that sends something valid.
    """

    host: str
    port: int | None
    peer: str | None


def parse_arm_name(name: str) -> ArmAddress:
    """Split the name of an arm into its kind and its address.

    Args:
        name: Such as ``fri``, ``fri:pc.example:30200@kuka.example`` or
            ``ur:arm.example``.

    Raises:
        DeviceSettingError: No such kind of arm, or no address where one is needed.
    """
    kind_length = next((i for i, c in enumerate(name) if c in ":@"), len(name))
    kind = name[:kind_length]
    address = name[kind_length:].removeprefix(":")
    is_complete = kind in LISTENING_KINDS or (kind in CALLED_KINDS and address)
    if not is_complete:
        raise DeviceSettingError(f"{name}: expected an arm as {EXPECTED_NAMES}")

    return ArmAddress(kind, address)


def parse_listening_address(text: str) -> ListeningAddress:
    """Split ``[LOCAL_ADDRESS][:PORT][@CONTROLLER]``, or ``PORT[@CONTROLLER]``.

    Args:
        text: What a user wrote; empty for loopback and the usual port.

    Raises:
        DeviceSettingError: The port is no number from 0 to 65535, an address is
            missing where a sign announces it, or a controller elsewhere could not
            reach loopback.
    """
    local, at_sign, peer = text.partition("@")
    host_and_port = f":{local}" if local.isdecimal() else local
    host, colon, port_text = host_and_port.partition(":")
    if at_sign and not peer:
        raise DeviceSettingError(f"{text!r}: expected the controller's address after @")

    if colon and not (port_text.isdecimal() and int(port_text) <= MAX_PORT):
        raise DeviceSettingError(
            f"{text!r}: expected a port from 0 to {MAX_PORT} after the colon, got "
            f"{port_text!r}"
        )

    if not host and peer and not peer.startswith("127."):
        raise DeviceSettingError(
            f"{text!r}: {peer} cannot send to {LOOPBACK}; name the address of this "
            f"machine that it sends to, as LOCAL_ADDRESS@{peer}"
        )

    port = int(port_text) if colon else None
    return ListeningAddress(host or LOOPBACK, port, peer or None)


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
    kind, address = parse_arm_name(name)
    if kind in LISTENING_KINDS:
        local = parse_listening_address(address)
        usual_port = fri.PORT if kind == "fri" else sunrise.PORT
        port = usual_port if local.port is None else local.port
        arm_type = FriArm if kind == "fri" else IiwaArm
        return arm_type(host=local.host, port=port, peer=local.peer, robot=robot)
    if kind == "ur":
        return UrArm(
            address,
            takes_commands=takes_commands,
            torque_constant_Nm_A=torque_constant_Nm_A,
            robot=robot,
        )

    arm_type = Fr3Arm if kind == "fr3" else FrankaArm
    return arm_type(address, takes_commands=takes_commands, robot=robot)
