"""``python -m benchmarks.readme_table RESULTS.json... README.md``: the README's table, from runs.

Of a scenario on a plant that several files hold, the last one counts.
"""

import argparse
import math
import sys
from collections.abc import Iterable, Iterator, Sequence
from pathlib import Path

from benchmarks.errors import BenchmarkError, ResultsError
from benchmarks.rows import Row, read_merged
from benchmarks.tables import BAD, NOTHING, limits_text, summary
from benchmarks.targets import PUBLISHED_RMSE_N, verdicts

BEGIN = "<!-- results:begin -->"
END = "<!-- results:end -->"
USAGE = 2


def main(arguments: Sequence[str] | None = None) -> int:
    """Write the tables of runs between the marks of a page.

    Args:
        arguments: The command line after the program's name; default: that of this process.

    Returns:
        0, or 2 after one line on stderr.
    """
    parser = argparse.ArgumentParser(prog="python -m benchmarks.readme_table", description=__doc__)
    parser.add_argument("results", type=Path, nargs="+", metavar="RESULTS", help="from run --json")
    parser.add_argument("page", type=Path, metavar="PAGE", help="the README")
    chosen = parser.parse_args(arguments)
    try:
        text = chosen.page.read_text(encoding="utf-8")
        filled = fill(text, results_block(read_merged(chosen.results)))
        chosen.page.write_text(filled, encoding="utf-8")
    except (BenchmarkError, OSError) as error:
        sys.stderr.write(f"readme_table: {error}\n")
        return USAGE
    return 0


def fill(text: str, block: str) -> str:
    """The page with the block between its marks.

    Raises:
        ResultsError: The page does not have each mark once, in order.
    """
    before, begin, rest = text.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end or BEGIN in after or END in after or END in before:
        raise ResultsError(f"expected one {BEGIN} and, after it, one {END} in the page")
    return f"{before}{BEGIN}\n{block}{END}{after}"


def results_block(rows: Iterable[Row]) -> str:
    """Axial force per scenario, then every target with what was reached, as Markdown."""
    rows = list(rows)
    return "\n".join([*_forces(rows), "", *_targets(rows)]) + "\n"


def _forces(rows: Sequence[Row]) -> Iterator[str]:
    wanted = [row for row in rows if (row.metric, row.source) == ("wrench_rmse_N", "virtual")]
    plants = list(dict.fromkeys(row.plant for row in wanted))
    yield (
        "RMSE of the axial force against the true one, in N, from first contact to the end of "
        "withdrawal: the paper's method and ours on the same signals; of several seeds the median "
        "and, in brackets, the worst. *real arm*: what the paper measured on its LWR 4+ (Figure 5)."
    )
    yield ""
    heads = [f"{plant}, {method}" for plant in plants for method in ("published", "ours")]
    yield _line("scenario", *heads, "real arm")
    yield _line("---", *("---:" for _ in (*heads, "")))
    for scenario in dict.fromkeys(row.scenario for row in wanted):
        cells = [
            _summary([row.value for row in wanted if _key(row) == (scenario, plant, method)])
            for plant in plants
            for method in ("published", "default")
        ]
        published = PUBLISHED_RMSE_N.get(scenario)
        yield _line(f"`{scenario}`", *cells, NOTHING if published is None else f"{published:g}")


def _key(row: Row) -> tuple[str, str, str]:
    return row.scenario, row.plant, row.method


def _summary(values: Sequence[float]) -> str:
    return summary(values, ".3f").replace(BAD, "not finite")


def _targets(rows: Sequence[Row]) -> Iterator[str]:
    yield _line("target", "limits", "reached", "runs", "")
    yield _line("---", "---:", "---:", "---:", "---")
    for verdict in verdicts(rows):
        reached = f"{verdict.value:.3g}" if math.isfinite(verdict.value) else "not finite"
        mark = "met" if verdict.is_met else "**missed**"
        limits = limits_text(verdict.target)
        yield _line(verdict.target.what, limits, reached, str(verdict.runs), mark)


def _line(*cells: str) -> str:
    return f"| {' | '.join(cells)} |"


if __name__ == "__main__":
    sys.exit(main())
