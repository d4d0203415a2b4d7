"""Writing rows of a table as a ROS 2 bag."""

import shutil
import tempfile
from pathlib import Path
from typing import Any, BinaryIO, Literal

import numpy as np

from recordings.bags.events import DIAGNOSTICS, KIND, EventEncoder
from recordings.bags.layout import TIME, bag_layout
from recordings.bags.message_types import standard_types
from recordings.bags.topic_encoder import TopicEncoder
from recordings.clock.nanoseconds import to_nanoseconds
from recordings.errors import LogError
from recordings.optional_library import optional_library
from recordings.tables.checked_columns import Columns
from recordings.tables.labels import PLAIN, Labels

_VERSION = 8
"""Of the metadata: the latest that ROS 2 Humble reads."""
_FOREVER = (9223372036, 854775807)
_DEPTH = 10


class BagWriter:
    """Writes each row as one message on each topic, stamped with the row's time.

    Args:
        folder: the bag's folder, which must not exist.
        storage: kind of the file in it.
        labels: names of joints, frame and topics, and the start of the clock.

    Raises:
        FileAccessError: rosbags is not installed.
    """

    def __init__(
        self, folder: Path, storage: Literal["mcap", "sqlite3"], labels: Labels = PLAIN
    ) -> None:
        self._library = optional_library("rosbags.rosbag2", "ROS 2 bags")
        self._types, self._labels = standard_types(), labels
        plugin = self._library.StoragePlugin[storage.upper()]
        self._bag = self._library.Writer(folder, version=_VERSION, storage_plugin=plugin)
        if storage == "mcap":
            zstd = self._library.CompressionFormat.ZSTD
            self._bag.set_compression(self._library.CompressionMode.STORAGE, zstd)
        self._topics: list[tuple[Any, TopicEncoder]] = []
        self._events = EventEncoder(labels, self._types)
        self._diagnostics: Any = None

    def append(self, columns: Columns) -> None:
        """Write rows.

        Args:
            columns: checked columns, the same in every call; with `t_s`.

        Raises:
            LogError: there is no time stamp, or one that no message can carry.
        """
        stamps_ns = self._stamps(columns)
        if not self._topics:
            self._begin(columns)
        series = [
            (connection, encoder.encode(columns, stamps_ns)) for connection, encoder in self._topics
        ]
        events = self._events.encode(columns, stamps_ns)
        write, at = self._bag.write, 0
        for row, stamp_ns in enumerate(stamps_ns.tolist()):
            for connection, messages in series:
                write(connection, stamp_ns, messages[row])
            while at < len(events) and events[at].row == row:
                write(self._diagnostics, stamp_ns, events[at].data)
                at += 1

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def finish(self) -> None:
        """Write the index and the metadata."""
        self._bag.close()

    def _begin(self, columns: Columns) -> None:
        self._bag.open()
        for topic in bag_layout(columns, self._labels):
            self._topics.append(
                (self._connection(topic.name, topic.kind), TopicEncoder(topic, self._types))
            )
        if any(name in columns for name in self._labels.events):
            self._diagnostics = self._connection(DIAGNOSTICS, KIND)

    def _connection(self, name: str, kind: str) -> Any:
        return self._bag.add_connection(
            name, kind, typestore=self._types, offered_qos_profiles=[_quality_of_service()]
        )

    def _stamps(self, columns: Columns) -> np.ndarray:
        t_s = columns.get(TIME)
        if t_s is None or t_s.ndim != 1:
            raise LogError(f"a bag needs time stamps: a column {TIME}; there is {list(columns)}")
        if not np.isfinite(t_s).all():
            raise LogError("a bag needs a time stamp in every row; one is not finite")
        stamps_ns = to_nanoseconds(t_s, self._labels.start_ns)
        if stamps_ns.size and stamps_ns.min() < 0:
            raise LogError(f"a bag cannot hold time stamps before zero; t_s reaches {t_s.min()} s")
        return stamps_ns


class McapWriter:
    """Writes a bag as one MCAP file, which needs no folder: it holds the metadata itself.

    Args:
        stream: where the bytes go.
        labels: see `BagWriter`.

    Raises:
        FileAccessError: rosbags is not installed.
    """

    def __init__(self, stream: BinaryIO, labels: Labels = PLAIN) -> None:
        self._stream = stream
        self._folder = tempfile.TemporaryDirectory(ignore_cleanup_errors=True)
        self._path = Path(self._folder.name) / "needleforce"
        self._writer = BagWriter(self._path, "mcap", labels)

    def append(self, columns: Columns) -> None:
        """Write rows, see `BagWriter`.

        Raises:
            LogError: see `BagWriter`.
        """
        self._writer.append(columns)

    def flush(self) -> None:
        """Nothing can be read before the end."""

    def finish(self) -> None:
        """Write the index, then the file."""
        with self._folder:
            self._writer.finish()
            with (self._path / f"{self._path.name}.mcap").open("rb") as written:
                shutil.copyfileobj(written, self._stream)


def _quality_of_service() -> Any:
    """What ROS offers by default: reliable, the last ten messages kept."""
    ros = optional_library("rosbags.interfaces", "ROS 2 bags")
    forever = ros.QosTime(*_FOREVER)
    return ros.Qos(
        history=ros.QosHistory.KEEP_LAST,
        depth=_DEPTH,
        reliability=ros.QosReliability.RELIABLE,
        durability=ros.QosDurability.VOLATILE,
        deadline=forever,
        lifespan=forever,
        liveliness=ros.QosLiveliness.AUTOMATIC,
        liveliness_lease_duration=forever,
        avoid_ros_namespace_conventions=False,
    )
