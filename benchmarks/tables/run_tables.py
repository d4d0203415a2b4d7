"""All tables of a run, in order. A new kind of number gets its table here."""

from collections.abc import Sequence

from rich.table import Table

from benchmarks.row import Row
from benchmarks.tables.bound_table import bound_table
from benchmarks.tables.force_table import force_table
from benchmarks.tables.identification_table import friction_table, rupture_table, table_one_table
from benchmarks.tables.number_table import number_table
from benchmarks.tables.offline_table import offline_table
from benchmarks.tables.tissue_table import tissue_table
from benchmarks.tables.verdict_table import verdict_table
from benchmarks.verdict.target_verdict import verdicts


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
