"""Bags that grow while they are read, for tests."""

import threading
import time
from itertools import pairwise
from struct import pack

import numpy as np
from mcap.data_stream import RecordBuilder
from mcap.records import Channel, DataEnd, Message, Schema
from mcap.stream_reader import StreamReader
from bag_samples import data_file, write_bag

from needleforce.recordings import ColumnMapping
from needleforce.recordings.bag_storage import MAGIC
from needleforce.recordings.mapping import ChannelRequest
from needleforce.recordings.log import LogStream
from needleforce.recordings.follow import FollowOptions
from needleforce.recordings.open_recording import stream_tables

ASKED = {"required": ("q", "tau", "depth")}
LONGEST_S = 20.0
"""So long nothing comes before a test gives up."""
HEADER = b"\x01" + pack("<QII", 8, 0, 0)
END = b"\x0f" + pack("<QI", 4, 0)


def recorded(folder, rows, compression=None):
    """The bytes of a bag."""
    return data_file(write_bag(folder, rows, compression=compression)).read_bytes()


def without_chunks(path):
    """The same messages as a recorder writes them that makes no chunks."""
    builder = RecordBuilder()
    with path.open("rb") as stream:
        for record in StreamReader(stream).records:
            if isinstance(record, Schema | Channel | Message):
                record.write(builder)
            if isinstance(record, DataEnd):
                break
    return MAGIC + HEADER + builder.end() + END


def grow(path, pieces, pause_s=0.01, go_on=None):
    """Append to a file from another thread; after the first piece only when told to go on."""
    path.write_bytes(pieces[0])

    def write():
        if go_on is not None:
            assert go_on.wait(LONGEST_S)
        for piece in pieces[1:]:
            time.sleep(pause_s)
            with path.open("ab") as stream:
                stream.write(piece)

    writer = threading.Thread(target=write)
    writer.start()
    return writer


def in_pieces(data, count):
    cuts = [len(data) * k // count for k in range(count + 1)]
    return [data[a:b] for a, b in pairwise(cuts)]


def followed(path, patience=None, mapping=None, **asked):
    """The chunks of a log that is followed, and its warnings."""
    tables = stream_tables(
        path,
        patience or FollowOptions(follow=True, idle_s=LONGEST_S),
        ChannelRequest(mapping=mapping or ColumnMapping(), **(asked or ASKED)),
    )
    stream = LogStream(tables, mapping, **(asked or ASKED))
    return list(stream), stream.take_warnings()


def assert_same(chunks, log):
    np.testing.assert_array_equal(np.concatenate([chunk.t_s for chunk in chunks]), log.t_s)
    for key, values in log.channels.items():
        found = np.concatenate([chunk.channels[key] for chunk in chunks])
        np.testing.assert_array_equal(found, values)
