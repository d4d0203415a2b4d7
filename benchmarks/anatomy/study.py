"""The patient's anatomy against analytic shapes and a real CT: one table, misses first.

A part is a module ``benchmarks.anatomy.<part>`` with ``measure(seed, data, progress)``,
which yields `Figure`s; ``data`` is the folder of recordings, or None.
"""

from collections.abc import Iterable, Sequence
from importlib import import_module
from importlib.util import find_spec
from pathlib import Path

from benchmarks import UnknownIdError
from benchmarks.control.study import (
    FIRST_SEED,
    JUDGED,
    ControlRow,
    Figure,
    write_control,
)
from benchmarks.jobs import Progress
from benchmarks.report.tables import ResultTable, new_console

PREFIX = "anatomy"
PARTS = ("surface", "path", "registration", "match", "abdomen")
"""What ``anatomy`` alone runs; ``fullsize`` takes a minute and 1.5 GB and is asked
for by name."""
CT_FOLDER = "torso_ct_totalsegmentator"


def run_anatomy(
    ids: Iterable[str], first_seed: int | None, data: Path | None, progress: Progress
) -> list[ControlRow]:
    """Measure the parts that are asked for: ``anatomy`` for all, ``anatomy-<part>`` for
    one.

    Raises:
        UnknownIdError: There is no such part.
    """
    there = [
        part for part in (*PARTS, "fullsize") if find_spec(f"benchmarks.anatomy.{part}")
    ]
    known = {PREFIX, *(f"{PREFIX}-{part}" for part in there)}
    wanted = set(ids)
    if unknown := wanted - known:
        raise UnknownIdError(
            f"no part {min(unknown)!r}; choose from: {', '.join(sorted(known))}"
        )
    whole = {f"{PREFIX}-{part}" for part in PARTS} if PREFIX in wanted else set()
    asked = [part for part in there if f"{PREFIX}-{part}" in wanted | whole]
    seed = FIRST_SEED if first_seed is None else first_seed
    rows = []
    for number, part in enumerate(asked):

        def update(fraction: float, begun: int = number) -> None:
            progress((begun + fraction) / len(asked))

        module = import_module(f"benchmarks.anatomy.{part}")
        for figure in module.measure(seed, data, update):
            value = float(figure.value)
            target = figure.target
            row = (
                part,
                figure.what,
                "",
                JUDGED,
                value,
                figure.unit,
                target,
                figure.at_least,
                1,
            )
            rows.append(ControlRow(*row))
    return rows


def anatomy_table(rows: Iterable[ControlRow]) -> ResultTable:
    """All rows, those that miss their target most at the top."""
    return ResultTable(
        title="The patient's anatomy",
        heads=("part", "what", "", "target", "unit", ""),
        align="LlrrlL",
        lines=tuple(
            (
                row.part,
                row.what,
                f"{row.value:.4g}",
                ""
                if row.target is None
                else f"{'≥' if row.at_least else '≤'} {row.target:g}",
                row.unit,
                "" if row.target is None else "met" if row.is_met else "missed",
            )
            for row in sorted(rows, key=lambda row: -row.badness)
        ),
        caption="Analytic shapes and public data. Not a medical device.",
    )


def show_anatomy(rows: Sequence[ControlRow], to: Path | None) -> Sequence[ControlRow]:
    """Print the table, write rows to a file if one is named, and return them."""
    new_console().print(anatomy_table(rows).rich())
    if to is not None:
        write_control(to, rows)
    return rows


__all__ = ["CT_FOLDER", "Figure", "run_anatomy", "show_anatomy"]
