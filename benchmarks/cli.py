"""The commands of ``python -m benchmarks``, and what becomes of their errors.

Packages that only some commands need are imported inside them: `compare` needs no
simulator.
"""

import math
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Annotated, Literal

from cyclopts import App, Parameter
from cyclopts.validators import Number

from benchmarks import BenchmarkError, ResultsError
from benchmarks.campaign.workers import Workers
from needleforce.cli.terminal import progress_bar, run_command, say

if TYPE_CHECKING:
    from rich.console import Console

    from benchmarks.headline import HeadlineFile
    from benchmarks.jobs import Job, Outcome
    from benchmarks.judging import Comparison
    from benchmarks.results import Row

DATA_VARIABLE = "NEEDLEFORCE_DATA"
EXTRAS = dict.fromkeys(
    ("rich", "mujoco", "matplotlib", "pandas", "psutil"), "bench"
) | {"distributed": "cluster"}
"""Which extra brings a package that may be missing."""
FAILURE = 1
"""Exit code of a command that has done its work, and found what the help names."""
USAGE = 2
"""Exit code after one line that says what is wrong with options or files."""

app = App(
    name="python -m benchmarks",
    help="Estimators against ground truth: simulated insertions and real "
    "recordings.\n\nExit codes: 0 all well, 1 a target missed (--strict), a "
    "regression or a benchmark that failed, 2 wrong usage or unreadable files.",
    version_flags=[],
    suppress_keyboard_interrupt=False,
    default_parameter=Parameter(negative=""),
)
Positive = Annotated[int, Parameter(validator=Number(gte=1))]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run a command line, by default that of this process, and return its exit code."""
    tokens = sys.argv[1:] if arguments is None else list(arguments)

    def dispatch() -> int:
        if not tokens:
            app.help_print([])
            return USAGE
        try:
            code = app(
                tokens,
                exit_on_error=False,
                print_error=False,
                result_action="return_value",
            )
        except ModuleNotFoundError as error:
            extra = EXTRAS.get(error.name or "")
            if extra is None:
                raise
            raise BenchmarkError(
                f"{error.name} is not installed",
                f"Install it: pip install -e '.[{extra}]'",
            ) from error
        return code or 0

    return run_command(dispatch)


@contextmanager
def progress_of(jobs: int) -> Iterator[Callable[[int, float], None]]:
    """Show a bar for many jobs.

    Yields what takes the index of a job and the fraction of it that is done.
    """
    fractions = dict.fromkeys(range(jobs), 0.0)
    total = 0.0
    with progress_bar(f"{jobs} benchmarks") as show:

        def update(index: int, fraction: float) -> None:
            nonlocal total
            total += fraction - fractions[index]
            fractions[index] = fraction
            show(total / jobs)

        yield update


@app.command(name="list")
def list_benchmarks() -> None:
    """List what can be run."""
    from benchmarks.catalogue import BENCHMARKS, PLANTS
    from benchmarks.report.tables import ResultTable, new_console

    needs = {True: "recordings", False: "simulation"}
    table = ResultTable(
        title="Benchmarks",
        heads=("ID", "", "what", "needs"),
        align="LLlL",
        lines=tuple(
            (
                item.id,
                "*" if item.is_default else "",
                item.title,
                needs[item.is_recorded],
            )
            for item in BENCHMARKS.values()
        ),
        caption="* runs when nothing is named; 'tissue' names the scenarios with "
        "tissue, 'robustness' the worlds in which they are perturbed, 'control' and "
        "'anatomy' their parts, 'all' all others but faults and speed",
    )
    console = new_console()
    console.print(table.rich())
    console.print(f"Plants of a simulation: {', '.join(PLANTS)}")


@Parameter(name="*")
@dataclass(frozen=True, slots=True, kw_only=True)
class OutputOptions:
    """Where numbers are written.

    Attributes:
        json: Write the numbers there, as they come.
        resume: Go on with that file: runs whose numbers it has are not done again.
        report: Write a page into that folder: the published figures from these runs,
            and all tables. With no ID named, runs all that the figures need.
    """

    json: Path | None = None
    resume: bool = False
    report: Path | None = None


_OUTPUT = OutputOptions()
_WORKERS = Workers()


@app.command
def run(
    *ids: str,
    plant: Sequence[str] = (),
    seeds: Positive = 1,
    first_seed: Annotated[int | None, Parameter(validator=Number(gte=0))] = None,
    data: Annotated[Path | None, Parameter(env_var=DATA_VARIABLE)] = None,
    output: OutputOptions = _OUTPUT,
    workers: Workers = _WORKERS,
    targets: bool = False,
    strict: bool = False,
) -> int:
    """Run benchmarks and print their results as tables.

    Args:
        ids: Names of the list; or several at once: tissue, robustness, control
            (closed loop, 30 minutes a seed), anatomy, or all (but robustness, control,
            anatomy, faults and speed); default: a quick set.
        plant: ideal, clean, fri, degraded, or needle (no arm), with commas between
            several; may be given more than once. Default: clean; for drawn scenarios
            needle; for control clean and fri. Of robustness, names of perturbations
            (benchmarks/insertion/perturbations.toml); default: all.
        seeds: Run so many seeds.
        first_seed: The first of them; default: 0, for control and anatomy 1000.
            Methods are tuned on seeds below 1000.
        data: Folder of real recordings.
        output: Where numbers are written.
        workers: Who does the runs.
        targets: Show what the numbers should be too, and whether they are.
        strict: Exit with 1 if a target is missed.
    """
    from benchmarks.catalogue import Request, make_plan
    from benchmarks.report.page import write_report
    from benchmarks.report.tables import new_console
    from needleforce.plots import PAGE, whole_folder

    if output.resume and output.json is None:
        raise BenchmarkError("--resume goes on with the file of --json")
    if workers.cluster and output.report is not None:
        raise BenchmarkError("--report draws on this machine: use it without --cluster")
    plants = plant_names(plant)
    console = new_console()
    # The folder first: better before minutes of work than after.
    with whole_folder(output.report) as folder:
        plan = make_plan(Request(ids, plants, seeds, first_seed, data, folder))
        outcomes = run_jobs_shown(plan.jobs, workers, console, output)
        print_outcomes(console, outcomes, plan.skipped, with_targets=targets)
        if folder is not None:
            drawings = [drawing for outcome in outcomes for drawing in outcome.drawings]
            rows = [row for outcome in outcomes for row in outcome.rows]
            write_report(folder, rows, drawings, with_targets=targets)
    if output.report is not None:
        console.print(f"Figures and tables: {output.report / PAGE}", soft_wrap=True)
    return exit_code(outcomes, is_strict=strict)


def exit_code(outcomes: Sequence["Outcome"], *, is_strict: bool) -> int:
    """Return that of a failed job or, if strict, of a missed target; else 0."""
    from benchmarks.judging import evaluate

    has_failed = any(outcome.failure is not None for outcome in outcomes)
    rows = [row for outcome in outcomes for row in outcome.rows]
    has_missed = is_strict and not all(target.is_met for target in evaluate(rows))
    return FAILURE if has_failed or has_missed else 0


def plant_names(plant: Sequence[str]) -> list[str]:
    """Return the names of plants, which may be joined by commas."""
    names = [
        name.strip()
        for names_given in plant
        for name in names_given.split(",")
        if name.strip()
    ]
    if plant and not names:
        raise BenchmarkError("--plant: expected at least one name")
    return names


def run_jobs_shown(
    jobs: Sequence["Job"],
    workers: Workers,
    console: "Console",
    output: OutputOptions = _OUTPUT,
) -> list["Outcome"]:
    """Do all jobs beside a bar of progress; print how long it took."""
    from benchmarks.campaign.runs import run_jobs

    begin_s = perf_counter()
    with progress_of(len(jobs)) as update:
        outcomes = run_jobs(
            jobs, workers, update, output.json, is_resumed=output.resume
        )
    console.print(f"{len(jobs)} runs in {perf_counter() - begin_s:.0f} s")
    return outcomes


def print_rows(
    console: "Console", rows: Sequence["Row"], *, with_targets: bool
) -> None:
    """Print the answer, how to read the tables, and the tables."""
    from benchmarks.report.tables import answer, result_tables

    sentences = answer(rows)
    if sentences:
        console.print(
            f"{sentences}\nHow far estimates are from the truth, which a simulation "
            "knows. ours: this toolkit; published: the method of Ferro et al. on the "
            "same signals. Force ft: of a force sensor at the needle; virtual: "
            "estimated from joint torques.\n"
        )
    for table in result_tables(rows, with_targets=with_targets):
        console.print(table.rich())


def print_outcomes(
    console: "Console",
    outcomes: Sequence["Outcome"],
    skipped: Sequence[str] = (),
    *,
    with_targets: bool,
) -> None:
    """Print the tables of jobs, what failed and what was left out."""
    rows = [row for outcome in outcomes for row in outcome.rows]
    print_rows(console, rows, with_targets=with_targets)
    print_failures(console, outcomes)
    if skipped:
        reason = f"Skipped for want of recordings (--data DIR or {DATA_VARIABLE})"
        console.print(f"{reason}: {', '.join(skipped)}", style="yellow")


def print_failures(console: "Console", outcomes: Sequence["Outcome"]) -> None:
    """Print why jobs failed."""
    for outcome in outcomes:
        if outcome.failure is not None:
            line = f"failed: {outcome.job}: {outcome.failure}"
            console.print(line, style="red", markup=False)


@app.command
def compare(old: Path, new: Path) -> int:
    """Find what has become worse between two runs.

    A number that is missing or not finite in the later run is a failure.

    Args:
        old: Results of the earlier run.
        new: Results of the later run.
    """
    from benchmarks.judging import Change, compare_rows
    from benchmarks.report.tables import comparison_table, new_console
    from benchmarks.results import read_results

    comparisons = compare_rows(read_results(old), read_results(new))
    if not comparisons:
        raise ResultsError(f"{old} and {new} have no rows: nothing to compare")
    console = new_console()
    changed = [item for item in comparisons if item.change is not Change.SAME]
    if changed:
        console.print(comparison_table(changed).rich())
    console.print(count_changes(comparisons))
    return FAILURE if any(item.is_failure for item in comparisons) else 0


def count_changes(comparisons: Sequence["Comparison"]) -> str:
    """Return how many numbers are the same, better, worse and so on."""
    counts = Counter(item.change for item in comparisons)
    return ", ".join(f"{counts[change]} {change}" for change in sorted(counts))


@app.command(name="headline")
def keep_headline(
    write: bool = False, file: Path | None = None, workers: Workers = _WORKERS
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
        workers: Who does the insertions; the times are measured here.
    """
    from benchmarks import headline
    from benchmarks.performance import kdl
    from benchmarks.report.tables import new_console

    path = headline.HEADLINE_FILE if file is None else file
    # Before minutes of work: whether there is a file to compare with.
    old = None if write else headline.read_headline(path)
    library = None
    try:
        library = kdl.kdl_library()
    except kdl.KdlAbsentError as error:
        if write:
            raise
        say(f"skipped: {error}")
    console = new_console()
    outcomes = run_jobs_shown(headline.plan_insertions().jobs, workers, console)
    print_failures(console, outcomes)
    figures = headline.insertion_figures(
        row for outcome in outcomes for row in outcome.rows
    )
    absent = () if library is not None else (headline.OF_KDL,)
    known = () if old is None else old.figures
    with progress_bar("timing") as update:
        times = headline.measure_times(update, library)
    changes = headline.compare_figures(known, [*figures, *times], absent)
    names = {figure.name for figure in times}
    if any(item.is_failure and item.name in names for item in changes):
        with progress_bar("timing once more") as update:
            times = headline.keep_lesser(times, headline.measure_times(update, library))
    figures += times
    measured = headline.describe_code(figures)
    changes = headline.compare_figures(known, figures, absent)
    console.print(headline.headline_table(changes).rich())
    if old is None:
        headline.write_headline(path, measured)
        console.print(f"Written: {path}", soft_wrap=True)
        return FAILURE if any(figure.value is None for figure in figures) else 0
    print_changes(console, old, measured, changes)
    return FAILURE if any(item.is_failure for item in changes) else 0


def print_changes(
    console: "Console",
    old: "HeadlineFile",
    measured: "HeadlineFile",
    changes: Sequence["Comparison"],
) -> None:
    """Print which figures changed, the failures last, and what else is not the same."""
    from benchmarks.judging import Change
    from benchmarks.report.tables import show_value

    for name, version in measured.versions.items():
        if old.versions.get(name) != version:
            before = old.versions.get(name, "unknown")
            console.print(f"The file was measured with {name} {before}, now {version}")
    changed = [item for item in changes if item.change is not Change.SAME]
    for item in sorted(changed, key=lambda item: item.is_failure):
        values = f"{show_value(item.old)} -> {show_value(item.new)} {item.unit}"
        style = "red" if item.is_failure else "green"
        line = f"{item.change}: {item.name}: {values}"
        console.print(line, style=style, markup=False, soft_wrap=True)
    console.print(f"Against {old.commit}: {count_changes(changes)}")
    if {Change.BETTER, Change.NEW} & {item.change for item in changed}:
        console.print("Keep what is better: python -m benchmarks headline --write")


@app.command(name="results")
def show_results(
    *files: Annotated[Path, Parameter(required=True)],
    page: Path | None = None,
    targets: bool = False,
) -> None:
    """Print the tables of runs, as they were printed then; write them to a page.

    Of a scenario on a plant that several files hold, the last one counts.

    Args:
        files: Results from run --json.
        page: Write all tables there.
        targets: Show too, on that page as well, whether the targets are met.
    """
    from benchmarks.report.tables import new_console, results_page
    from benchmarks.results import read_merged

    rows = read_merged(files)
    # Folders of one machine mean nothing to a reader.
    command = " ".join(["python -m benchmarks results", *(path.name for path in files)])
    if page is not None:
        command += f" --page {page.name}{' --targets' if targets else ''}"
        text = results_page(rows, command, with_targets=targets)
        try:
            page.write_text(text, encoding="utf-8")
        except OSError as error:
            raise ResultsError(
                f"cannot write {error.filename}: {error.strerror}"
            ) from error
    print_rows(new_console(), rows, with_targets=targets)


@app.command(name="figures")
def publish_figures(*files: Annotated[Path, Parameter(required=True)]) -> None:
    """Fill the tables of README.md and docs/reference/results.md.

    They show one campaign of one commit. Of a scenario on a plant that several files
    hold, the last one counts.

    Args:
        files: Results from run --json, all of one commit without changes.
    """
    from benchmarks.report.figures import fill_figures, write_figures
    from benchmarks.results import read_file, read_merged

    commits = {read_file(path)[1].commit or "unknown" for path in files}
    if len(commits) > 1 or commits & {"unknown"} or "-dirty" in "".join(commits):
        raise ResultsError(
            f"the files are of commit {', '.join(sorted(commits))}; expected one, "
            "without changed files: run the campaign on a clean clone"
        )
    write_figures(fill_figures(read_merged(files), commits.pop()))


@app.command(name="speed")
def time_updates(
    soak: bool = False,
    control: bool = False,
    loop: float | None = None,
    scene: bool = False,
    kdl: bool = False,
    ticks: Positive = 1_000_000,
    targets: bool = False,
    strict: bool = False,
) -> int:
    """Time the estimators beside their bare dynamics. Takes about 75 s.

    The same as running the benchmarks speed-ticks and so on, one by one, here.

    Args:
        soak: Instead, many ticks of the chain (four minutes): growth of memory, cost at
            the end.
        control: Instead, ticks of control, and of session and control together.
        loop: Instead, so many seconds of a 1 kHz loop against an emulated FRI.
        scene: With --loop: the same again beside the scene, and a recorder.
        kdl: Instead, error and time beside orocos KDL's estimator, if that is
            installed.
        ticks: How many, with --soak.
        targets: Show what the numbers should be too, and whether they are.
        strict: Exit with 1 if a target is missed.
    """
    from benchmarks.performance.kdl import KdlAbsentError, kdl_library

    if loop is not None and not 0.0 < loop < math.inf:
        raise BenchmarkError(f"--loop {loop:g}: expected a positive number of seconds")
    if soak:
        return run_alone("speed-soak", [f"{ticks} ticks"], targets, strict)
    if loop is not None:
        beside = ("alone", "with the scene", "with a recorder")
        cases = [f"{loop:g} s {kind}" for kind in (beside if scene else beside[:1])]
        return run_alone("speed-loop", cases, targets, strict)
    if kdl:
        try:
            kdl_library()
        except KdlAbsentError as error:
            say(f"skipped: {error}")
            return 0
        return run_alone("speed-kdl", [""], targets, strict)
    name = "speed-control" if control else "speed-ticks"
    return run_alone(name, [""], targets, strict)


def run_alone(
    benchmark: str,
    cases: Sequence[str],
    with_targets: bool,
    is_strict: bool,
    data: Path | None = None,
) -> int:
    """Run cases one by one in this process, print their tables, return the exit code.

    Args:
        benchmark: Its name.
        cases: Its cases.
        with_targets: Whether what the numbers should be is shown too.
        is_strict: Whether a missed target is a failure.
        data: Folder for it.
    """
    from benchmarks.jobs import NO_PLANT, Job
    from benchmarks.report.tables import new_console

    console = new_console()
    jobs = [
        Job(benchmark=benchmark, case=case, plant=NO_PLANT, data=data) for case in cases
    ]
    outcomes = run_jobs_shown(jobs, Workers(workers=1), console)
    print_outcomes(console, outcomes, with_targets=with_targets)
    return exit_code(outcomes, is_strict=is_strict)


@app.command(name="faults")
def inject_faults(
    without_velocity: bool = False, markdown: bool = False, strict: bool = False
) -> int:
    """Break the signals of a running insertion, and print what is reported.

    Takes about 45 s; `run faults` gives the numbers alone.

    Args:
        without_velocity: The arm sends no velocities, they are estimated.
        markdown: Print the table in Markdown.
        strict: Exit with 1 if a fault is not recovered from, or a number is not finite.
    """
    from benchmarks.faults.study import fault_table, measure_faults
    from benchmarks.report.tables import new_console

    with progress_bar("faults") as update:
        faults = measure_faults(update, with_velocity=not without_velocity)
    console = new_console()
    table = fault_table(faults)
    if markdown:
        console.print("\n".join(table.markdown()), soft_wrap=True, markup=False)
    else:
        console.print(table.rich())
    is_bad = any(
        not fault.is_finite or math.isinf(fault.recovery_s) for fault in faults
    )
    return FAILURE if strict and is_bad else 0


@app.command(name="stream")
def stream_recordings(
    seconds: Positive = 60,
    format: Sequence[Literal[".csv", ".npz", ".parquet", ".mcap"]] = (),
    folder: Path | None = None,
    targets: bool = False,
    strict: bool = False,
) -> int:
    """Send a long recording through the commands.

    Args:
        seconds: Length of the recording; 3600 needs 3 GB on the disk and ten minutes.
        format: Of the recording; may be given more than once (default .csv).
        folder: Where the files lie meanwhile.
        targets: Show what the numbers should be too, and whether they are.
        strict: Exit with 1 if a target is missed.
    """
    from benchmarks.performance.stream import name_cases

    cases = name_cases(seconds, format)
    if folder is not None and not folder.is_dir():
        raise BenchmarkError(f"--folder {folder}: expected a folder that there is")
    return run_alone("speed-stream", cases, targets, strict, folder)
