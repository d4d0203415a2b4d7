"""All tables of a run, in order. A new kind of number gets its table here."""

from collections.abc import Sequence

from rich.table import Table

from benchmarks.bound_table import bound_table
from benchmarks.force_table import force_table
from benchmarks.identification_table import friction_table, rupture_table, table_one_table
from benchmarks.number_table import number_table
from benchmarks.offline_table import offline_table
from benchmarks.row import Row
from benchmarks.tissue_table import tissue_table
from benchmarks.verdict import verdicts
from benchmarks.verdict_table import verdict_table


def run_tables(rows: Sequence[Row]) -> list[Table]:
    """The tables that these rows have something for."""
    tables = (
        force_table(rows),
        rupture_table(rows),
        friction_table(rows),
        bound_table(rows),
        table_one_table(rows),
        offline_table(rows),
        tissue_table(rows),
        number_table(rows),
        verdict_table(verdicts(rows)),
    )
    return [table for table in tables if table is not None]
