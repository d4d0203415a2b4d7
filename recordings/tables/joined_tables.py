"""The first rows of a recording as one table."""

from collections.abc import Iterator

import numpy as np

from recordings.tables.table import Table


def joined_tables(tables: Iterator[Table], rows: int) -> Table:
    """Take tables until there are so many rows, and join them.

    Args:
        tables: consecutive rows with equal columns; at least one table.
        rows: how many rows are wanted.

    Returns:
        One table, with fewer rows if there are no more.
    """
    taken: list[Table] = []
    for table in tables:
        taken.append(table)
        if sum(map(_length, taken)) >= rows:
            break
    if len(taken) == 1:
        return taken[0]
    first, last = taken[0], taken[-1]
    return Table(
        columns={
            name: np.concatenate([table.columns[name] for table in taken if name in table.columns])
            for name in last.columns
        },
        constants=first.constants,
        warnings=tuple(warning for table in taken for warning in table.warnings),
        joint_names=first.joint_names,
        start_ns=first.start_ns,
        stamps=_joined_stamps([table for table in taken if _length(table)]),
        omitted=first.omitted,
    )


def _joined_stamps(tables: list[Table]) -> dict[str, np.ndarray]:
    """Join the stamps that every table with rows has."""
    if not tables:
        return {}
    everywhere = set.intersection(*(set(table.stamps) for table in tables))
    return {name: np.concatenate([table.stamps[name] for table in tables]) for name in everywhere}


def _length(table: Table) -> int:
    return max(map(len, table.columns.values()))
