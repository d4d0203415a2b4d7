"""`needleforce demo`: an insertion through three gels, as tables and as a page."""

from collections.abc import Iterator
from pathlib import Path
from textwrap import fill
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
import pandas as pd

from groundtruth import Run, simulate
from needleforce import plots
from needleforce.cli.terminal import CommandError, aligned, staged_progress, write_out
from needleforce.depth_zero import FIRST_CONTACT, DepthZero
from needleforce.plots import palette
from needleforce.session import InsertionSession
from needleforce.simulation.insertion import (
    FoundRupture,
    JudgedSession,
    is_insertion,
    judge,
    published_session,
    run_session,
)

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENARIO = "stack-glove-constant"
"""What is inserted into: see `needleforce simulate --list`."""

PAGE_TITLE = "needleforce demo: a needle through three gels"
"""Title of the page, by which a later run knows the page as its own."""

NOT_MEDICAL = "Simulation only: not a medical device."

M_TO_MM = 1e3
NOTHING = "–"

LAYER_HEAD = (
    "layer",
    "end [mm]",
    "found",
    "friction [N]",
    "found",
    "stiffness [N/m]",
    "found",
    "alarm",
)
"""Heads of the table of layers; what was found stands behind the truth."""

METHOD_HEAD = ("", "needleforce", "published")

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
    ("python examples/teleoperation.py", "a hand feels the tip through the robot"),
    ("needleforce doctor", "what is installed here"),
)
"""Commands to try next, and what each is for."""


class ComparedInsertion(NamedTuple):
    """A simulated insertion, and what two methods made of it.

    Attributes:
        run: The insertion.
        mixture: What `InsertionSession` does when nothing is set.
        published: The published method.
    """

    run: Run
    mixture: JudgedSession
    published: JudgedSession


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
        from matplotlib import rc_context

        with rc_context(fname=plots.STYLE):
            plots.save_figure(draw_forces(compared, plots.WIDTH_IN), picture)
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
        # The errors of this plant model are those measured on the real arm.
        insertion = simulate(SCENARIO, "fri", seed, progress)
    # Sessions begin outside of a bar: the compiler shows its own progress.
    session = InsertionSession(insertion.robot)
    with staged_progress("estimating from joint signals") as progress:
        mixture = run_session(insertion, session, progress)
    session = published_session(insertion)
    with staged_progress("the same by the published method") as progress:
        published = run_session(insertion, session, progress)
    return ComparedInsertion(
        insertion, judge(insertion, mixture), judge(insertion, published)
    )


def tables_text(compared: ComparedInsertion) -> str:
    """Return the tables of layers and of methods as lines of text."""
    layers = pd.DataFrame(layer_rows(compared), columns=LAYER_HEAD)
    layers.iloc[:, 1:] = " " + layers.iloc[:, 1:]  # two spaces between columns
    methods = pd.DataFrame(method_rows(compared), columns=METHOD_HEAD)
    notes = (layer_note(compared), friction_note(compared), METHOD_NOTE, NOT_MEDICAL)
    parts = [
        fill(answer(compared), 80),
        layers.to_string(index=False),
        methods.to_string(index=False),
        "\n".join(fill(note, 80) for note in notes if note),
    ]
    return "\n" + "\n\n".join(parts) + "\n"


def answer(compared: ComparedInsertion) -> str:
    """Return in one sentence what the insertion showed."""
    ours = compared.mixture
    return (
        f"{ours.found} of {len(ours.ruptures)} ruptures found, {ours.false_alarms} "
        "false alarms; force on the needle within "
        f"{ours.force_error_N:.2f} N rms, by the published method within "
        f"{compared.published.force_error_N:.2f} N."
    )


def layer_note(compared: ComparedInsertion) -> str:
    """Return what the table of layers means, and what looks odd in the figure."""
    run = compared.run
    ours = compared.mixture
    behind = is_insertion(run) & (run.truth.t_s > run.truth.ruptures[-1].end_s)
    note = (
        "True: what the simulation knows. ±: the standard deviation that the method "
        "states of its estimate; that of a depth is mostly of the first contact, which "
        "is found by force alone. Alarm after: from the onset of the rupture to the "
        "sample that reported it."
    )
    if not behind.any():
        return note
    tip_N = float(np.mean(ours.result.tip_N[behind]))
    std_N = float(np.mean(ours.result.tip_std_N[behind]))
    return (
        f"{note} Behind the last layer the tip is free, and its estimated force is "
        f"{tip_N:.2f} ± {std_N:.2f} N, not zero: an error of the shaft's friction, or "
        "of the torque sensors, that the method cannot tell from a force at the tip."
    )


def friction_note(compared: ComparedInsertion) -> str:
    """Return why frictions err more here than in the README's headline; or nothing.

    Single gels err by 0 to 10 % on this plant model, these stacks by 3 to 37 %: behind
    the first layer a friction is the difference of two forces.
    """
    found = [
        (rupture.layer.friction_N, rupture.true.layer_friction_N)
        for rupture in compared.mixture.ruptures
        if rupture.layer is not None and rupture.true.layer > 0
    ]
    if not found:
        return ""
    errors_N = [abs(friction_N - true_N) for friction_N, true_N in found]
    errors = [
        error_N / true_N for error_N, (_, true_N) in zip(errors_N, found, strict=True)
    ]
    return (
        f"Frictions differ here by {100.0 * min(errors):.0f} to "
        f"{100.0 * max(errors):.0f} % ({min(errors_N):.2f} to {max(errors_N):.2f} N) "
        "from the truth, more than the headline's 7.9 %: that is a median over "
        "insertions of which half go into one gel, while in a stack each friction is "
        "what remains of the force without that of the layers before, and takes over "
        "their errors."
    )


def layer_rows(compared: ComparedInsertion) -> tuple[tuple[str, ...], ...]:
    """Return the cells of every layer: true values, and what was found of them."""
    run = compared.run
    ruptures = compared.mixture.ruptures
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
        zero = DepthZero(found.rupture.contact_depth_m, FIRST_CONTACT)
        end_mm = zero.shown_mm(found.start_depth_m + found.thickness_m)
        depth = _with_std(end_mm, zero.end_std_mm(found), 1)
        friction = _with_std(found.friction_N, found.friction_std_N, 2)
        stiffness = _with_std(found.stiffness_N_per_m, found.stiffness_std_N_per_m, 0)
    delay = "missed"
    if rupture.alarm_sample is not None:
        delay_s = run.truth.t_s[rupture.alarm_sample] - true.onset_s
        delay = f"{1e3 * delay_s:.0f} ms"
    return (
        f"{true.layer} {tissue.name}",
        f"{M_TO_MM * true.onset_m:.1f}",
        depth,
        f"{true.layer_friction_N:.2f}",
        friction,
        f"{tissue.stiffness_N_per_m:.0f}",
        stiffness,
        delay,
    )


def _with_std(value: float, std: float | None, digits: int) -> str:
    """Return a value with its standard deviation, where there is one."""
    text = f"{value:.{digits}f}"
    return text if std is None else f"{text} ± {std:.{digits}f}"


def _unbroken(text: str) -> str:
    """Return the text of a cell that a narrow page does not break at its spaces."""
    return text.replace(" ", "\N{NO-BREAK SPACE}")


def method_rows(compared: ComparedInsertion) -> tuple[tuple[str, ...], ...]:
    """Return label and numbers of both methods, line by line."""
    methods = (compared.mixture, compared.published)
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


def next_text() -> str:
    """Return the commands to try next, one a line."""
    lines = [(f"  {command}", f"# {purpose}") for command, purpose in NEXT]
    return "next:\n" + aligned(lines)


def draw_forces(compared: ComparedInsertion, width_in: float) -> "Figure":
    """Return the forces on the needle and at its tip over the depth."""
    run = compared.run
    truth = run.truth
    ours = compared.mixture.result
    published = compared.published.result
    figure, panels = plots.make_panels(
        2,
        width_in,
        4.6,
        "A needle through three gels\n"
        f"simulated LWR 4+, plant model {run.plant}, seed {run.seed}",
    )
    drawn = np.flatnonzero(is_insertion(run))[::20]
    depth_mm = M_TO_MM * truth.depth_m
    forces = (
        (truth.axial_N, ours.force_N, ours.force_std_N, published.force_N),
        (truth.tip_N, ours.tip_N, ours.tip_std_N, published.tip_N),
    )
    dashed: dict[str, Any] = {"color": palette.VERMILION, "ls": "--"}
    alarms = list(ours.alarm_samples.values())
    for axes, (true_N, ours_N, std_N, published_N) in zip(panels, forces, strict=True):
        for name, tint, start_mm, end_mm in _layers_of(run):
            axes.axvspan(start_mm, end_mm, color=tint, label=name, zorder=0.4)
        x = depth_mm[drawn]
        plots.draw_line(axes, x, published_N[drawn], label="published method", **dashed)
        plots.draw_line(
            axes,
            x,
            ours_N[drawn],
            std_N[drawn],
            color=palette.BLUE,
            label="needleforce ± 2 std",
        )
        plots.draw_line(
            axes, x, true_N[drawn], color=palette.BLACK, lw=0.9, label="ground truth"
        )
        plots.mark_instants(
            axes, depth_mm[alarms], "rupture reported", color="k", marker="|", ms=13
        )
        # The published method's false forces would flatten all others.
        shown_N = np.concatenate([true_N[drawn], ours_N[drawn]])
        axes.set_ylim(1.3 * min(shown_N.min(), -0.2), 1.3 * shown_N.max())
    panels[0].set(ylabel="force on the needle [N]")
    panels[1].set(
        ylabel="force at the tip [N]", xlabel="depth of the tip below the surface [mm]"
    )
    plots.add_legend(figure)
    return figure


LAYER_TINTS = ("#f3f0e6", "#e3e9f2", "#eaf3e6")
"""Colours of the layers behind the curves."""


def _layers_of(run: Run) -> Iterator[tuple[str, str, float, float]]:
    """Yield name, tint, and where the tip enters and leaves each layer [mm]."""
    start_mm = 0.0
    for rupture in run.truth.ruptures:
        if rupture.layer > 0:
            end_mm = M_TO_MM * rupture.onset_m
            name = run.scenario.layers[rupture.layer - 1].name
            yield name, LAYER_TINTS[(rupture.layer - 1) % 3], start_mm, end_mm
            start_mm = end_mm


def write_page(compared: ComparedInsertion, folder: Path) -> Path:
    """Write the page with the figure and both tables into a folder.

    Returns:
        Its path.
    """
    from matplotlib import rc_context

    with rc_context(fname=plots.STYLE):
        narrow = draw_forces(compared, plots.WIDTH_IN)
        wide = draw_forces(compared, plots.WIDE_IN)
        figure = plots.PageFigure(
            path=plots.save_figure(narrow, folder / "insertion.svg"),
            alt="Forces on the needle and at its tip over depth, with the truth",
            caption=CAPTION,
            wide=plots.save_figure(wide, folder / "insertion-wide.svg"),
        )
    layers = plots.PageTable(
        caption="Layers: true and estimated",
        head=LAYER_HEAD,
        rows=tuple(tuple(map(_unbroken, row)) for row in layer_rows(compared)),
        numeric=frozenset(range(1, len(LAYER_HEAD))),
        note=f"{layer_note(compared)} {friction_note(compared)}",
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
