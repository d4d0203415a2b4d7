"""The commands of ``python -m benchmarks``.

Packages that only some commands need are imported inside them: `compare` needs no
simulator.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from cyclopts import App, Parameter
from cyclopts.validators import Number
from rich.console import Console

from benchmarks import BenchmarkError, ResultsError
from needleforce.cli.terminal import run_command

if TYPE_CHECKING:
    import pandas as pd

app = App(
    name="python -m benchmarks",
    help="Estimators against ground truth: simulated insertions and real "
    "recordings.\n\nExit codes: 0 all well, 1 a target missed (--strict), a "
    "regression or a benchmark that failed, 2 wrong usage or unreadable files.",
    version_flags=[],
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative=""),
)
Data = Annotated[Path | None, Parameter(env_var="NEEDLEFORCE_DATA")]
Positive = Annotated[int, Parameter(validator=Number(gte=1))]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, by default that of this process, and return its exit code."""

    def dispatch() -> int:
        code = app(
            arguments,
            exit_on_error=False,
            print_error=False,
            result_action="return_value",
        )
        return code or 0

    return run_command(dispatch)


def show(text: str) -> None:
    """Print a text as it is."""
    console = Console(soft_wrap=True, highlight=False, markup=False, emoji=False)
    console.print(text)


def show_table(title: str, table: "pd.DataFrame") -> None:
    """Print a table, whole."""
    text = table.to_string(na_rep="–", float_format="{:.4g}".format, max_colwidth=90)
    show(f"\n{title}\n{text}")


def show_results(results: "pd.DataFrame", *, with_targets: bool) -> int:
    """Print results, a table for each kind of metric; return how many targets missed.

    Of several seeds the medians are shown.
    """
    from benchmarks.judging import TABLES, evaluate

    for name, metrics in TABLES.items():
        chosen = results[results["metric"].isin(metrics)]
        if len(chosen):
            rows = ["scenario", "plant", "source", "method"]
            table = chosen.pivot_table("value", rows, "metric", "median", sort=False)
            show_table(name, table)
    targets = evaluate(results)
    if with_targets:
        show_table("targets", targets)
    return int((~targets["met"].astype(bool)).sum())


@app.command(name="list")
def list_benchmarks() -> None:
    """List what can be run, and the names of several at once."""
    from benchmarks.catalogue import BENCHMARKS, GROUPS, PLANTS

    width = max(map(len, BENCHMARKS))
    show("\n".join(f"{name:{width}}  {b.title}" for name, b in BENCHMARKS.items()))
    show(f"Several at once: {', '.join(GROUPS)}")
    show(f"Plants of a simulation: {', '.join(PLANTS)}")


@app.command
def run(
    *ids: str,
    plant: Sequence[str] = (),
    seeds: Positive = 1,
    first_seed: Annotated[int | None, Parameter(validator=Number(gte=0))] = None,
    data: Data = None,
    out: Path | None = None,
    resume: bool = False,
    report: Path | None = None,
    workers: int = -1,
    cluster: str = "",
    targets: bool = False,
    strict: bool = False,
) -> int:
    """Run benchmarks and print their results as tables.

    Args:
        ids: Names of the list, or of several at once; default: a quick set.
        plant: ideal, clean, fri, degraded, or needle (no arm), with commas between
            several. Default: clean; for drawn scenarios needle; for control clean and
            fri. Of robustness, names of perturbations
            (benchmarks/insertion/perturbations.toml); default: all.
        seeds: Run so many seeds.
        first_seed: The first of them; default: 0, for control and anatomy 1000.
            Methods are tuned on seeds below 1000.
        data: Folder of real recordings.
        out: Parquet file for the numbers.
        resume: Go on with that file: jobs whose numbers it has are not done again.
        report: Write the figures of the paper from these runs into that folder. With no
            ID named, runs all that they need.
        workers: Processes; -1 for one per processor.
        cluster: Instead of them, address of a Dask scheduler.
        targets: Show what the numbers should be too, and whether they are.
        strict: Exit with 1 if a target is missed.
    """
    from benchmarks.campaign import run_jobs
    from benchmarks.catalogue import make_jobs
    from benchmarks.report import write_report

    if resume and out is None:
        raise BenchmarkError("--resume goes on with the file of --out")
    if report is not None:
        report.mkdir(parents=True, exist_ok=True)
    plants = [name for names in plant for name in names.split(",")]
    jobs = make_jobs(
        ids, plants, seeds=seeds, first_seed=first_seed, data=data, report=report
    )
    results, failed = run_jobs(
        jobs, out, resume=resume, workers=workers, cluster=cluster
    )
    missed = show_results(results, with_targets=targets)
    if report is not None:
        write_report(report, results)
        show(f"Figures and tables: {report / 'index.html'}")
    for item in failed:
        show(f"failed: {item.job}: {item.failure}")
    return int(bool(failed) or (strict and missed > 0))


@app.command
def compare(old: Path, new: Path) -> int:
    """Find what has become worse between two runs.

    A number that is missing or not finite in the later run is a failure.

    Args:
        old: Results of the earlier run.
        new: Results of the later run.
    """
    from benchmarks.campaign import read_results
    from benchmarks.judging import compare_results

    return show_changes(compare_results(read_results(old), read_results(new)))


def show_changes(changes: "pd.DataFrame") -> int:
    """Print what is not the same; return 1 where something has become worse, else 0."""
    from benchmarks.judging import FAILURES

    changed = changes[changes["change"] != "same"]
    if len(changed):
        show_table("changes", changed.sort_values("change"))
    counts = changes["change"].value_counts()
    show(", ".join(f"{count} {change}" for change, count in counts.items()))
    return int(changes["change"].isin(FAILURES).any())


@app.command(name="headline")
def keep_headline(
    write: bool = False, file: Path | None = None, workers: int = -1
) -> int:
    """Measure the figures that may not become worse, and compare them with their file.

    Takes three minutes on two cores; nothing else should run meanwhile, or the ratios
    of time mean nothing. Insertions into gels and a stack (seed 1000) on the plants
    clean and fri, then time beside Pinocchio's calls and, where g++ and
    liborocos-kdl-dev are installed, beside orocos KDL.

    Exits with 1 where a figure is missing, or worse by more than the tolerance that the
    file states.

    Args:
        write: Write the file instead; needs KDL.
        file: Instead of benchmarks/headline.json.
        workers: Processes that do the insertions; the times are measured here.
    """
    import pandas as pd

    from benchmarks import headline
    from benchmarks.campaign import run_jobs
    from benchmarks.judging import FAILURES
    from benchmarks.performance.kdl import KdlAbsentError, kdl_library

    path = headline.HEADLINE_FILE if file is None else file
    # Before minutes of work: whether there is a file to compare with.
    known, about = (None, {}) if write else headline.read_headline(path)
    library = None
    try:
        library = kdl_library()
    except KdlAbsentError as error:
        if write:
            raise
        show(f"skipped: {error}")
    results, failed = run_jobs(headline.plan_insertions(), workers=workers)
    for item in failed:
        show(f"failed: {item.job}: {item.failure}")
    figures = headline.insertion_figures(results)
    times = headline.measure_times(library)
    if known is None:
        headline.write_headline(path, pd.concat([figures, times]))
        return 0
    absent = "" if library is not None else headline.OF_KDL
    known_times = known[known.index.isin(times.index)]
    slower = headline.compare_figures(known_times, times, absent)
    if slower["change"].isin(FAILURES).any():  # what else ran may be over by now
        times = headline.keep_lesser(times, headline.measure_times(library))
    changes = headline.compare_figures(known, pd.concat([figures, times]), absent)
    show_table("headline", changes)
    show(f"The file: {about}; now: {headline.describe_code()}")
    return show_changes(changes)


@app.command(name="results")
def print_results(
    *files: Annotated[Path, Parameter(required=True)], targets: bool = False
) -> None:
    """Print the tables of runs, as they were printed then.

    Of a scenario on a plant that several files hold, the last one counts.

    Args:
        files: Results from run --out.
        targets: Show too whether the targets are met.
    """
    from benchmarks.campaign import read_merged

    show_results(read_merged(files), with_targets=targets)


@app.command(name="figures")
def publish_figures(*files: Annotated[Path, Parameter(required=True)]) -> None:
    """Fill the tables of README.md and docs/reference/results.md.

    They show one campaign of one commit. Of a scenario on a plant that several files
    hold, the last one counts.

    Args:
        files: Results from run --out, all of one commit without changes.
    """
    from benchmarks.campaign import read_merged, read_results
    from benchmarks.figures import fill_figures, write_figures

    commits = {read_results(path).attrs.get("commit") or "unknown" for path in files}
    if len(commits) > 1 or commits & {"unknown"} or "-dirty" in "".join(commits):
        raise ResultsError(
            f"the files are of commit {', '.join(sorted(commits))}; expected one, "
            "without changed files: run the campaign on a clean clone"
        )
    write_figures(fill_figures(read_merged(files), commits.pop()))
