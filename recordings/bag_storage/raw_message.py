"""What storage yields before anything is decoded."""

from typing import NamedTuple


class BagTopic(NamedTuple):
    """A topic of a bag.

    Attributes:
        name: such as `/joint_states`.
        kind: its message type, such as `sensor_msgs/msg/JointState`.
        encoding: how messages are serialised; `cdr` for ROS 2.
        definition: the text of the type's definition if the bag holds it, else empty.
        is_idl: whether that text is IDL rather than a `.msg` file.
    """

    name: str
    kind: str
    encoding: str
    definition: str = ""
    is_idl: bool = False


class RawMessage(NamedTuple):
    """A serialised message.

    Attributes:
        topic: where it was published.
        log_ns: when it was recorded, on the recorder's clock.
        data: its bytes.
    """

    topic: BagTopic
    log_ns: int
    data: bytes


NONE_YET = RawMessage(BagTopic("", "", ""), 0, b"")
"""Stands in place of a message wherever a bag that still grows has been read as far as it goes."""
