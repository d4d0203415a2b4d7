"""`needleforce demo`: an insertion through three gels, as tables and as a page."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth import Run, simulate
from needleforce import plots
from needleforce.cli.demos.insertion_run import (
    MULTILAYER_METHOD,
    ComparedInsertion,
    FoundRupture,
    begin_session,
    is_insertion,
    judge,
    published_method,
    run_session,
)
from needleforce.cli.demos.result_page import NOT_MEDICAL
from needleforce.cli.terminal import CommandError, aligned, staged_progress, write_out
from needleforce.plots import Chart, Curve, Instants, Panel, Shading, palette

SCENARIO = "stack-glove-constant"
"""What is inserted into: see `needleforce simulate --list`."""

PLANT = "fri"
"""Plant model whose errors are those measured on the real arm."""

PAGE_TITLE = "needleforce demo: a needle through three gels"
"""Title of the page, by which a later run knows the page as its own."""

DRAWN_TICKS = 20
"""Every so many samples are drawn."""

CHART_HEIGHT_IN = 4.6
LAYER_TINTS = ("#f3f0e6", "#e3e9f2", "#eaf3e6")
"""Colours of the layers behind the curves."""

TERMINAL_LETTERS = 80
"""Letters of a line of text on a terminal."""

M_TO_MM = 1e3
S_TO_MS = 1e3
NOTHING = "–"

LAYER_HEAD = (
    "layer",
    "ends at mm",
    "found",
    "friction N",
    "found",
    "stiffness N/m",
    "found",
    "alarm after",
)
"""Heads of the table of layers: a true value, then what was found of it."""

METHOD_HEAD = ("", "needleforce", "published")

LAYER_NOTE = (
    "Left, what the simulation knows; found: the estimate and its standard deviation. "
    "Alarm after: from the onset of the rupture to the sample that reported it."
)
METHOD_NOTE = (
    "Both get the same joint signals. Published: Ferro, Gaz, Anzidei, Vendittelli, "
    "with the settings of the paper, and told where the surface lies, as it assumes."
)

CAPTION = (
    "Above, the force on the needle; below, its part at the tip, which falls where a "
    "layer ruptures. Black: the ground truth, which no method sees. Bands: two "
    "standard deviations to either side. Marks on the lower edge: where each rupture "
    "was reported."
)

NEXT = (
    ("needleforce identify FILE.csv --png layers.png", "your CSV of depth and force"),
    ("needleforce report FILE.csv DIR", "your arm's log: q, dq, tau"),
    ("needleforce demo abdomen --report DIR", "watch a plan on a CT (extra patient)"),
    ("needleforce demo teleop --report DIR", "a hand feels the tip through the robot"),
    ("needleforce doctor", "what is installed here"),
)
"""Commands to try next, and what each is for."""


def run(folder: Path, seed: int, picture: Path | None) -> int:
    """Simulate an insertion, estimate, print the tables and write the page.

    Args:
        folder: Folder of the page.
        seed: Seed of everything that is drawn at random.
        picture: File for the figure alone, if any.

    Returns:
        The exit code.

    Raises:
        CommandError: The folder holds a page that is no demonstration's, or the seed is
            negative.
    """
    plots.require_matplotlib("demo", picture)
    if seed < 0:
        raise CommandError(f"--seed {seed}: expected a whole number from 0 up")
    _refuse_other_page(folder)
    with plots.whole_folder(folder) as place:
        compared = compare(seed)
        write_out(tables_text(compared))
        if place is not None:
            write_page(compared, place)
    if picture is not None:
        plots.save_figure(force_chart(compared), picture)
    write_out(f"\npicture: {folder / plots.PAGE}\n\n{next_text()}")
    return 0


def _refuse_other_page(folder: Path) -> None:
    """Refuse to replace a page that a user may have made otherwise."""
    page = folder / plots.PAGE
    if page.is_file() and PAGE_TITLE not in page.read_text("utf-8", errors="replace"):
        raise CommandError(
            f"{page} is a page of something else; name another folder with --report"
        )


def compare(seed: int) -> ComparedInsertion:
    """Simulate the insertion and run both methods on its signals.

    Args:
        seed: Seed of everything that is drawn at random.
    """
    with staged_progress("simulating arm, needle and gels") as progress:
        insertion = simulate(SCENARIO, PLANT, seed, progress)
    # Sessions begin outside of a bar: the compiler shows its own progress.
    session = begin_session(insertion, MULTILAYER_METHOD)
    with staged_progress("estimating from joint signals") as progress:
        multilayer = run_session(insertion, session, progress)
    motion = insertion.scenario.motion
    surface_m = -float(motion.position_m(insertion.tare_end_s))
    session = begin_session(insertion, published_method(surface_m))
    with staged_progress("the same by the published method") as progress:
        published = run_session(insertion, session, progress)
    return ComparedInsertion(
        run=insertion,
        multilayer=judge(insertion, multilayer),
        published=judge(insertion, published),
    )


def tables_text(compared: ComparedInsertion) -> str:
    """Return the tables of layers and of methods as lines of text."""
    layers = [LAYER_HEAD, *layer_rows(compared)]
    methods = [METHOD_HEAD, *method_rows(compared)]
    notes = "".join(map(_wrapped, (LAYER_NOTE, METHOD_NOTE, NOT_MEDICAL)))
    return (
        f"\n{_wrapped(answer(compared))}\n{_columns(layers)}\n{_columns(methods)}\n"
        f"{notes}"
    )


def _wrapped(text: str) -> str:
    """Return text in lines that a terminal shows without breaking them."""
    return f"{fill(text, TERMINAL_LETTERS)}\n"


def answer(compared: ComparedInsertion) -> str:
    """Return in one sentence what the insertion showed."""
    ours = compared.multilayer
    return (
        f"{ours.found} of {len(ours.ruptures)} ruptures found, {ours.false_alarms} "
        "false alarms; force on the needle within "
        f"{ours.force_error_N:.2f} N rms, by the published method within "
        f"{compared.published.force_error_N:.2f} N."
    )


def layer_rows(compared: ComparedInsertion) -> tuple[tuple[str, ...], ...]:
    """Return the cells of every layer: true values, and what was found of them."""
    run = compared.run
    ruptures = compared.multilayer.ruptures
    return tuple(
        _layer_cells(run, rupture) for rupture in ruptures if rupture.true.layer > 0
    )


def _layer_cells(run: Run, rupture: FoundRupture) -> tuple[str, ...]:
    """Return the cells of one layer, by the rupture that ended it."""
    true = rupture.true
    tissue = run.scenario.layers[true.layer - 1]
    found = rupture.layer
    depth = friction = stiffness = NOTHING
    if found is not None:
        travel_m = found.rupture.depth_m - found.rupture.contact_depth_m
        depth = f"{M_TO_MM * travel_m:.1f}"
        friction = _with_std(found.friction_N, found.friction_std_N, 2)
        stiffness = _with_std(found.stiffness_N_per_m, found.stiffness_std_N_per_m, 0)
    return (
        f"{true.layer} {tissue.name}",
        f"{M_TO_MM * true.onset_m:.1f}",
        depth,
        f"{true.layer_friction_N:.2f}",
        friction,
        f"{tissue.stiffness_N_per_m:.0f}",
        stiffness,
        _delay(run, rupture),
    )


def _delay(run: Run, rupture: FoundRupture) -> str:
    """Return how long after the true onset the alarm came."""
    if rupture.alarm is None:
        return "missed"
    delay_s = run.truth.t_s[rupture.alarm.sample] - rupture.true.onset_s
    return f"{S_TO_MS * delay_s:.0f} ms"


def _with_std(value: float, std: float | None, digits: int) -> str:
    """Return a value with its standard deviation, where there is one."""
    text = f"{value:.{digits}f}"
    return text if std is None else f"{text} ± {std:.{digits}f}"


def _unbroken(text: str) -> str:
    """Return the text of a cell that a narrow page does not break at its spaces."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def method_rows(compared: ComparedInsertion) -> tuple[tuple[str, ...], ...]:
    """Return label and numbers of both methods, line by line."""
    methods = (compared.multilayer, compared.published)
    force = [f"{method.force_error_N:.3f} N" for method in methods]
    tip = [f"{method.tip_error_N:.3f} N" for method in methods]
    found = [f"{method.found} of {len(method.ruptures)}" for method in methods]
    false = [str(method.false_alarms) for method in methods]
    return (
        ("force on the needle, rms error", *force),
        ("force at the tip, rms error", *tip),
        ("ruptures found", *found),
        ("false alarms", *false),
    )


def _columns(rows: Sequence[Sequence[str]]) -> str:
    """Return rows as lines of text, the first column on the left, others right."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines: list[str] = []
    for first, *others in rows:
        cells = [first.ljust(widths[0])]
        cells += map(str.rjust, others, widths[1:])
        lines.append("  ".join(cells).rstrip() + "\n")
    return "".join(lines)


def next_text() -> str:
    """Return the commands to try next, one a line."""
    lines = [(f"  {command}", f"# {purpose}") for command, purpose in NEXT]
    return "next:\n" + aligned(lines)


class DrawnForce(NamedTuple):
    """A force of both methods and the ground truth, at every sample, shape (n,) each.

    Attributes:
        y_label: Label of the y axis.
        true_N: The ground truth.
        ours_N: Of the multi-layer method.
        ours_std_N: Its standard deviation.
        published_N: Of the published method.
    """

    y_label: str
    true_N: Array
    ours_N: Array
    ours_std_N: Array
    published_N: Array


def force_chart(compared: ComparedInsertion) -> Chart:
    """Return the forces on the needle and at its tip over the depth."""
    run = compared.run
    ours = compared.multilayer.result
    published = compared.published.result
    needle = DrawnForce(
        "force on the needle [N]",
        run.truth.axial_N,
        ours.force_N,
        ours.force_std_N,
        published.force_N,
    )
    tip = DrawnForce(
        "force at the tip [N]",
        run.truth.tip_N,
        ours.tip_N,
        ours.tip_std_N,
        published.tip_N,
    )
    drawn = np.flatnonzero(is_insertion(run))[::DRAWN_TICKS]
    return Chart(
        title="A needle through three gels\n"
        f"simulated LWR 4+, plant model {run.plant}, seed {run.seed}",
        x_label="depth of the tip below the surface [mm]",
        panels=(_panel(run, needle, drawn), _panel(run, tip, drawn)),
        shadings=_layer_shadings(compared),
        instants=_alarm_marks(compared),
        height_in=CHART_HEIGHT_IN,
    )


def _panel(run: Run, force: DrawnForce, drawn: NDArray[np.intp]) -> Panel:
    """Return one force of both methods and the ground truth, over depth."""
    depth_mm = M_TO_MM * run.truth.depth_m[drawn]
    published = Curve(
        style=palette.PUBLISHED,
        x=depth_mm,
        y=force.published_N[drawn],
        label="published method",
    )
    ours = Curve(
        style=palette.OURS,
        x=depth_mm,
        y=force.ours_N[drawn],
        std=force.ours_std_N[drawn],
        label="needleforce",
        band_label="± 2 std",
    )
    true = Curve(
        style=palette.TRUE, x=depth_mm, y=force.true_N[drawn], label="ground truth"
    )
    return Panel(y_label=force.y_label, curves=(published, ours, true))


def _layer_shadings(compared: ComparedInsertion) -> tuple[Shading, ...]:
    """Return where the tip is in each layer, by the true ruptures."""
    run = compared.run
    start_mm = 0.0
    shadings: list[Shading] = []
    for rupture in run.truth.ruptures:
        end_mm = M_TO_MM * rupture.onset_m
        if rupture.layer > 0:
            name = run.scenario.layers[rupture.layer - 1].name
            tint = LAYER_TINTS[(rupture.layer - 1) % len(LAYER_TINTS)]
            shadings.append(Shading(name, tint, ((start_mm, end_mm),)))
            start_mm = end_mm
    return tuple(shadings)


def _alarm_marks(compared: ComparedInsertion) -> tuple[Instants, ...]:
    """Return where the needle was when needleforce reported each rupture."""
    depth_mm = M_TO_MM * compared.run.truth.depth_m
    alarms = compared.multilayer.result.alarms
    places = tuple(float(depth_mm[alarm.sample]) for alarm in alarms)
    return (Instants("rupture reported by needleforce", palette.RUPTURE, places),)


def write_page(compared: ComparedInsertion, folder: Path) -> Path:
    """Write the page with the figure and both tables into a folder.

    Returns:
        Its path.
    """
    figure = plots.save_page_figure(
        force_chart(compared),
        folder / "insertion.svg",
        alt="Forces on the needle and at its tip over depth, with the ground truth",
        caption=CAPTION,
        is_alone=True,
    )
    layers = plots.PageTable(
        caption="Layers: true value, and what was found",
        head=LAYER_HEAD,
        rows=tuple(tuple(map(_unbroken, row)) for row in layer_rows(compared)),
        numeric=frozenset(range(1, len(LAYER_HEAD))),
        note=LAYER_NOTE,
    )
    methods = plots.PageTable(
        caption="Beside the published method",
        head=METHOD_HEAD,
        rows=method_rows(compared),
        numeric=frozenset({1, 2}),
        note=METHOD_NOTE,
    )
    commands = plots.PageTable(
        caption="Commands",
        head=("command", "for"),
        rows=tuple((f"`{command}`", purpose) for command, purpose in NEXT),
    )
    page = plots.Page(
        title=PAGE_TITLE,
        lead=(answer(compared), _describe_simulation(compared.run), NOT_MEDICAL),
        sections=(
            plots.Section(
                heading="The insertion",
                anchor="insertion",
                figures=(figure,),
                tables=(layers, methods),
            ),
            plots.Section(heading="Next", anchor="next", tables=(commands,)),
        ),
    )
    return plots.write_page(folder / plots.PAGE, page)


def _describe_simulation(run: Run) -> str:
    """Return what was simulated, and where the truth comes from."""
    return (
        f"A simulated KUKA LWR 4+ pushes a needle through {run.scenario.title}, and "
        "back out. Forces and layers are estimated from its joint positions, "
        "velocities and torques alone, with the errors of a real arm (plant model "
        f"`{run.plant}`, seed {run.seed}); the simulation knows the ground truth."
    )
