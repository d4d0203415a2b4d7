"""`needleforce demo`: an insertion through three gels, as tables and as a page."""

from collections.abc import Sequence
from pathlib import Path
from textwrap import fill
from typing import NamedTuple

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from groundtruth import Run, simulate
from needleforce import plots
from needleforce.cli.terminal import CommandError, aligned, staged_progress, write_out
from needleforce.depth_zero import FIRST_CONTACT, DepthZero
from needleforce.plots import Chart, Curve, Instants, Panel, Shading, palette
from needleforce.plots.chart import WIDTH_IN
from needleforce.session import InsertionSession
from needleforce.simulation.insertion import (
    FoundRupture,
    JudgedSession,
    is_insertion,
    judge,
    published_session,
    run_session,
)

SCENARIO = "stack-glove-constant"
"""What is inserted into: see `needleforce simulate --list`."""

PAGE_TITLE = "needleforce demo: a needle through three gels"
"""Title of the page, by which a later run knows the page as its own."""

NOT_MEDICAL = "Simulation only: not a medical device."

M_TO_MM = 1e3
NOTHING = "–"

LAYER_HEAD = (
    "\nlayer",
    "end [mm]\ntrue",
    "\nestimated",
    "friction [N]\ntrue",
    "\nestimated",
    "stiffness [N/m]\ntrue",
    "\nestimated",
    "alarm\nafter",
)
"""Heads of the table of layers; the quantity above, what is known of it below."""

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
    heads = zip(*(head.split("\n") for head in LAYER_HEAD), strict=True)
    layers = [*heads, *layer_rows(compared)]
    methods = [METHOD_HEAD, *method_rows(compared)]
    notes = (layer_note(compared), friction_note(compared), METHOD_NOTE, NOT_MEDICAL)
    return (
        f"\n{_wrapped(answer(compared))}\n{_columns(layers)}\n{_columns(methods)}\n"
        f"{''.join(map(_wrapped, notes))}"
    )


def _wrapped(text: str) -> str:
    """Return text in lines that a terminal shows without breaking them."""
    return f"{fill(text, 80)}\n"


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


def force_chart(compared: ComparedInsertion) -> Chart:
    """Return the forces on the needle and at its tip over the depth."""
    run = compared.run
    ours = compared.mixture.result
    published = compared.published.result
    drawn = np.flatnonzero(is_insertion(run))[::20]
    panels = (
        _panel(
            "force on the needle [N]",
            M_TO_MM * run.truth.depth_m[drawn],
            run.truth.axial_N[drawn],
            (ours.force_N[drawn], ours.force_std_N[drawn]),
            published.force_N[drawn],
        ),
        _panel(
            "force at the tip [N]",
            M_TO_MM * run.truth.depth_m[drawn],
            run.truth.tip_N[drawn],
            (ours.tip_N[drawn], ours.tip_std_N[drawn]),
            published.tip_N[drawn],
        ),
    )
    depth_mm = M_TO_MM * run.truth.depth_m
    places = tuple(float(depth_mm[sample]) for sample in ours.alarm_samples.values())
    alarms = Instants("rupture reported by needleforce", palette.RUPTURE, places)
    return Chart(
        title="A needle through three gels\n"
        f"simulated LWR 4+, plant model {run.plant}, seed {run.seed}",
        x_label="depth of the tip below the surface [mm]",
        panels=panels,
        shadings=_layer_shadings(run),
        instants=(alarms,),
        height_in=4.6,
    )


def _panel(
    y_label: str,
    depth_mm: Array,
    true_N: Array,
    ours_N: tuple[Array, Array],
    published_N: Array,
) -> Panel:
    """Return one force of both methods, ours with its deviation, and the truth."""
    published = Curve(
        style=palette.PUBLISHED, x=depth_mm, y=published_N, label="published method"
    )
    ours = Curve(
        style=palette.OURS,
        x=depth_mm,
        y=ours_N[0],
        std=ours_N[1],
        label="needleforce",
        band_label="± 2 std",
    )
    true = Curve(style=palette.TRUE, x=depth_mm, y=true_N, label="ground truth")
    return Panel(y_label=y_label, curves=(published, ours, true))


LAYER_TINTS = ("#f3f0e6", "#e3e9f2", "#eaf3e6")
"""Colours of the layers behind the curves, and in the drawing of the arm."""


def _layer_shadings(run: Run) -> tuple[Shading, ...]:
    """Return where the tip is in each layer, by the true ruptures."""
    ends_mm = [0.0]
    shadings: list[Shading] = []
    for rupture in run.truth.ruptures:
        if rupture.layer > 0:
            ends_mm.append(M_TO_MM * rupture.onset_m)
            name = run.scenario.layers[rupture.layer - 1].name
            tint = LAYER_TINTS[(rupture.layer - 1) % len(LAYER_TINTS)]
            shadings.append(Shading(name, tint, ((ends_mm[-2], ends_mm[-1]),)))
    return tuple(shadings)


def draw_arm(run: Run, path: Path) -> Path:
    """Draw arm, needle and gels to scale from the side, at the deepest point."""
    import matplotlib.pyplot as plt
    from matplotlib.patches import Rectangle

    robot = run.robot
    data = robot.create_data()
    deepest = int(np.argmax(run.truth.depth_m))
    pin.framesForwardKinematics(robot.model, data, run.signals.q_rad[deepest])
    tool = data.oMf[robot.tool_frame_id]
    joints_m = np.array([placement.translation for placement in data.oMi])
    tip_m = tool.translation
    surface_m = tip_m - run.truth.depth_m[deepest] * tool.rotation[:, 2]
    # The side of the arm: its reach along the floor, and its height.
    reach = np.array([tip_m[0], tip_m[1], 0.0])
    reach /= np.linalg.norm(reach)
    arm_m = joints_m @ np.stack((reach, [0.0, 0.0, 1.0]), axis=1)
    needle_m = np.stack((joints_m[-1], tip_m)) @ np.stack((reach, [0, 0, 1]), axis=1)
    figure, axes = plt.subplots(figsize=(WIDTH_IN, 3.6))
    top_m = float(surface_m[2])
    for number, layer in enumerate(run.scenario.layers):
        tint = LAYER_TINTS[number % len(LAYER_TINTS)]
        left_m = float(surface_m @ reach) - 0.1
        axes.add_patch(
            Rectangle(
                (left_m, top_m - layer.thickness_m),
                0.2,
                layer.thickness_m,
                facecolor=tint,
                edgecolor=palette.GREY,
            )
        )
        middle_m = top_m - layer.thickness_m / 2
        axes.text(left_m - 0.01, middle_m, layer.name, ha="right", va="center")
        top_m -= layer.thickness_m
    axes.plot(*arm_m.T, "o-", color=palette.GREY, linewidth=9, solid_capstyle="round")
    axes.plot(*needle_m.T, color=palette.BLUE, linewidth=1.6)
    x_m, height_m = (needle_m[0] - (0.03, 0.04)).tolist()
    axes.text(x_m, height_m, "needle", color=palette.BLUE, ha="right")
    axes.set(aspect="equal", xlabel="reach [m]", ylabel="height above the base [m]")
    figure.savefig(path, bbox_inches="tight")
    plt.close(figure)
    return path


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
    arm_caption = (
        "Arm, needle and gels from the side, to scale, where the needle is deepest. "
        "The robot has no force sensor at the needle: it knows its joints alone."
    )
    arm = plots.PageFigure(
        path=draw_arm(compared.run, folder / "arm.svg"),
        alt="The arm with its needle through three gels",
        caption=arm_caption,
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
                figures=(figure, arm),
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
