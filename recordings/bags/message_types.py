"""Types of ROS 2 messages: those of a bag's own definitions, else those of ROS itself."""

from collections.abc import Mapping
from typing import Any

from recordings.bag_storage.raw_message import BagTopic
from recordings.errors import FormatError
from recordings.optional_library import optional_library

STANDARD = "ROS2_HUMBLE"
"""Whose standard messages are meant where a bag holds no definitions."""


class MessageTypes:
    """Looks up the fields of message types.

    Raises:
        FileAccessError: rosbags is not installed.
    """

    def __init__(self) -> None:
        self._library = optional_library("rosbags.typesys", "ROS 2 bags")
        self._standard = standard_types()
        self._fields: dict[str, Mapping[str, Any]] = {}

    def register(self, topic: BagTopic) -> None:
        """Learn the definition that a bag holds of a topic's type; one that is broken is ignored.

        Args:
            topic: the topic.
        """
        if not topic.definition or topic.kind in self._fields:
            return
        parse = (
            self._library.get_types_from_idl if topic.is_idl else self._library.get_types_from_msg
        )
        arguments = (topic.definition,) if topic.is_idl else (topic.definition, topic.kind)
        try:
            found = parse(*arguments)
        except self._library.TypesysError:
            return
        for kind, (_, fields) in found.items():
            self._fields.setdefault(kind, dict(fields))

    def fields(self, kind: str) -> Mapping[str, Any]:
        """Return the fields of a type: name to description as in `rosbags.interfaces`.

        Args:
            kind: such as `sensor_msgs/msg/JointState`.

        Raises:
            FormatError: nothing is known of it.
        """
        if kind not in self._fields:
            try:
                self._fields[kind] = dict(self._standard.fielddefs[kind][1])
            except KeyError as error:
                raise FormatError(
                    f"holds messages of the type {kind}, without its definition"
                ) from error
        return self._fields[kind]


def standard_types() -> Any:
    """Return the type store of ROS's own messages.

    Raises:
        FileAccessError: rosbags is not installed.
    """
    library = optional_library("rosbags.typesys", "ROS 2 bags")
    return library.get_typestore(getattr(library.Stores, STANDARD))
