"""What the columns of a message are called, and where its source time stamp stands."""

from typing import NamedTuple

from recordings.bag_storage.raw_message import BagTopic
from recordings.bags.cdr_layout import CdrLayout, Path, Place

_STAMP = (("header", "stamp", "sec"), ("header", "stamp", "nanosec"))
_VECTORS = (("x", "y", "z", "w"), ("x", "y", "z"), ("x", "y"))
_DATA = ("data",)


class MessageColumns(NamedTuple):
    """The columns of messages of one layout.

    Attributes:
        places: column name to where its numbers stand.
        stamp: where `header.stamp` stands, seconds and nanoseconds; None for a message without.
        names: joint names of the message, empty if it has none.
        named: columns with one number for each of these names.
    """

    places: dict[str, Place]
    stamp: tuple[Place, Place] | None
    names: tuple[str, ...]
    named: frozenset[str]


def message_columns(topic: BagTopic, layout: CdrLayout) -> MessageColumns:
    """Name the columns of a topic's messages.

    A column is called by its topic and the fields that lead to it: `/joint_states/position`.
    Vectors are one column of several numbers: `/ft/wrench/force_xyz`. In a `...Stamped` message
    the one field beside the header goes unnamed, and so does `data`: `/depth_mm`.

    Args:
        topic: where the messages were published.
        layout: their layout.
    """
    by_path = {place.path: place for place in layout.places}
    stamp = None
    if all(path in by_path for path in _STAMP):
        stamp = (by_path.pop(_STAMP[0]), by_path.pop(_STAMP[1]))
    places = _with_vectors(list(by_path.values()))
    if topic.kind.endswith("Stamped"):
        places = [place._replace(path=place.path[1:] or place.path) for place in places]
    columns = {_column_name(topic.name, place.path): place for place in places}
    named = frozenset(
        name
        for name, place in columns.items()
        if len(place.path) == 1 and layout.names and place.length == len(layout.names)
    )
    return MessageColumns(columns, stamp, layout.names, named)


def _with_vectors(places: list[Place]) -> list[Place]:
    """Make one place of the components of a vector."""
    joined: list[Place] = []
    at = 0
    while at < len(places):
        first = places[at]
        width = next((len(v) for v in _VECTORS if _is_vector(places[at : at + len(v)], v)), 0)
        if width:
            components = "".join(place.path[-1] for place in places[at : at + width])
            path = _vector_path(first.path, components)
            joined.append(first._replace(path=path, length=width))
        else:
            joined.append(first)
        at += width or 1
    return joined


def _is_vector(places: list[Place], components: tuple[str, ...]) -> bool:
    return (
        tuple(place.path[-1] for place in places) == components
        and len({place.path[:-1] for place in places}) == 1
        and len({place.dtype for place in places}) == 1
        and all(place.length is None for place in places)
    )


def _vector_path(path: Path, components: str) -> Path:
    *parents, _ = path
    if not parents:
        return (components,)
    return (*parents[:-1], f"{parents[-1]}_{components}")


def _column_name(topic: str, path: Path) -> str:
    return topic if path == _DATA else "/".join((topic, *path))
