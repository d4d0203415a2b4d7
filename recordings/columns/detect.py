"""Finding a channel's columns by their usual names, when no mapping names them."""

from collections.abc import Mapping

from recordings.columns.channel import Channel
from recordings.columns.find import FoundColumn, require_no_gap
from recordings.columns.name import ColumnName, parse_column_name
from recordings.errors import ColumnError
from recordings.tables.table import Table


def detect_columns(table: Table, channel: Channel) -> tuple[FoundColumn, ...]:
    """Return the columns whose names say that they are this channel.

    Args:
        table: where to look.
        channel: what to look for.

    Returns:
        The columns in joint order; empty if there is none.

    Raises:
        ColumnError: several would fit, or a joint's column is missing.
    """
    candidates = _candidates(table, channel)
    if not candidates:
        return ()
    if len(candidates) > 1:
        names = ", ".join(candidates)
        raise ColumnError(
            f"{channel.name}: several columns would fit ({names}); say which one with "
            f"--{channel.name}, or under {channel.name} in the mapping"
        )
    return next(iter(candidates.values()))


def _candidates(table: Table, channel: Channel) -> Mapping[str, tuple[FoundColumn, ...]]:
    named = {name: parse_column_name(name, channel.units) for name in table.columns}
    named = {name: parts for name, parts in named.items() if parts.stem in channel.spellings}
    if channel.per_joint:
        return _joint_candidates(table, named)
    fitting = [name for name in named if _is_single(table, name)]
    plain = [name for name in fitting if named[name].number is None]
    return {name: (_column(table, name),) for name in plain or fitting}


def _joint_candidates(
    table: Table, named: Mapping[str, ColumnName]
) -> Mapping[str, tuple[FoundColumn, ...]]:
    candidates: dict[str, tuple[FoundColumn, ...]] = {}
    families: dict[str, dict[int, str]] = {}
    for name, parts in named.items():
        if parts.number is None or table.columns[name].ndim == 2:
            candidates[name] = (_column(table, name),)
        else:
            families.setdefault(parts.family, {})[parts.number] = name
    for family, members in families.items():
        require_no_gap(sorted(members), family)
        candidates[family] = tuple(_column(table, members[number]) for number in sorted(members))
    return candidates


def _is_single(table: Table, name: str) -> bool:
    values = table.columns[name]
    return values.ndim == 1 or values.shape[1] == 1


def _column(table: Table, name: str) -> FoundColumn:
    return FoundColumn(name=name, values=table.columns[name])
