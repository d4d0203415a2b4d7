"""Forces of a log in words, in charts, and as sections of a page."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from needleforce import plots
from needleforce.cli.logs.force_result import NO_WARNING, ForceResult, vectors_of
from needleforce.cli.logs.outputs import Answer
from needleforce.cli.logs.row_overview import axis_span, time_axis
from needleforce.cli.shared_options import Over
from needleforce.cli.terminal import aligned
from needleforce.depth_zero import FIRST_ROW, LOG_ZERO, DepthZero
from needleforce.plots import Chart, Curve, LineStyle, Panel, palette
from needleforce.plots.chart import limits_of
from needleforce.sensor_replay import ForceRows, has_status
from residual import Status

if TYPE_CHECKING:
    from needleforce.cli.logs.layer_page import LayerPage
    from needleforce.cli.logs.plan_found import PlanFound

MIN_TRAVEL_M = 1e-3
"""A chart over travel has nothing to show where the tool hardly moves [m]."""


M_TO_MM = 1e3

CAPTIONS: dict[Over, str] = {
    "time": "The force of the environment on the tool; the axial force is positive "
    "when tissue pushes back. The band is two standard deviations wide to either side. "
    "Grey lines are not tared: they carry the errors of the model and of the torque "
    "sensors.",
    "depth": "The same over the travel of the tool along the needle: in tissue the "
    "upper branch is the insertion, the lower the withdrawal.",
}
"""Caption of the chart over time, and of that over travel."""

PLAN_STATE = "needle_on_plan.json"
"""File of a report: the needle on its plan, for programs."""


class Component(NamedTuple):
    """One component of force or torque, to be drawn.

    Attributes:
        name: Its name in the legend.
        style: Its line.
        values: Its values, shape (n,).
        std: Its standard deviations, shape (n,).
    """

    name: str
    style: LineStyle
    values: Array
    std: Array


@dataclass(frozen=True, slots=True, eq=False)
class ForcePage:
    """What is shown of the forces of a log.

    Attributes:
        result: The forces.
        layers: What is shown of the layers in them, if they were asked for.
        plan: The plan against what was found, if there is one.
    """

    result: ForceResult
    layers: "LayerPage | None" = None
    plan: "PlanFound | None" = None

    def text(self) -> str:
        """Return the lines of the summary, and of the layers if asked for."""
        summary = aligned(self._summary())
        layers = "" if self.layers is None else f"\n{self.layers.text()}"
        return f"{summary}{layers}{'' if self.plan is None else self.plan.text()}"

    def _summary(self) -> Iterator[tuple[str, str]]:
        """Yield the lines of the summary, with the zero of the layers' depths."""
        if self.layers is None:
            return self.result.summary()
        zero_name = self.layers.result.zero.name
        return self.result.summary(f"depths of layers count {zero_name}")

    def chart(self, over: Over = "time") -> Chart:
        """Return every estimated component with its band of two standard deviations."""
        frame_height_in = 0.8  # Height of title and axis [in]
        panel_height_in = 2.2
        result = self.result
        rows = result.rows
        if over == "depth":
            zero = self._depth_zero()
            x = M_TO_MM * (rows["travel_m"] - zero.depth_m)
            x_label = f"travel along the needle, {zero.name} [mm]"
            marks: dict[str, Any] = {}
        else:
            start_s, x_label = time_axis(rows["t_s"])
            x = rows["t_s"] - start_s
            marks = self._marks(x, start_s)
        panels = tuple(
            panel_of(label, rows, x, components)
            for label, components in self._panels().items()
        )
        return Chart(
            title=f"Force on the needle\n{result.log}: {result.replay.description}",
            x_label=x_label,
            panels=panels,
            height_in=frame_height_in + panel_height_in * len(panels),
            x_limits=axis_span(x),
            **marks,
        )

    def _depth_zero(self) -> DepthZero:
        """Return where travel counts from: as the layers, where there are any."""
        if self.layers is None or self.layers.result.zero.name == LOG_ZERO:
            return DepthZero(0.0, FIRST_ROW)
        return self.layers.result.zero

    @property
    def title(self) -> str:
        """What the page of a report shows."""
        return "Forces" if self.layers is None else "Forces and layers"

    def answer(self) -> Answer:
        """Return what was found: layers, then the plan against them, then forces."""
        layers = Answer(()) if self.layers is None else self.layers.answer()
        plan = Answer(()) if self.plan is None else self.plan.answer()
        forces = Answer((self.result.answer(),), self._force_warnings())
        return Answer(
            layers.sentences + plan.sentences + forces.sentences,
            plan.warnings + layers.warnings + forces.warnings,
            layers.tables + plan.tables,
        )

    def sections(self, folder: Path) -> tuple[plots.Section, ...]:
        """Save the charts of a report in a folder, and the needle on its plan.

        Returns:
            The sections of its page.
        """
        if self.plan is not None:
            (folder / PLAN_STATE).write_bytes(self.plan.state_json())
        origin = self.result.replay.description
        forces = plots.Section(
            heading="Forces",
            anchor="forces",
            paragraphs=(f"Made by `needleforce force`: {origin}.",),
            figures=self._save_figures(folder),
        )
        lines = tuple(self._summary())
        caption = "What was used, done and found"
        table = plots.PageTable(caption=caption, head=("", ""), rows=lines)
        summary = plots.Section(heading="Summary", anchor="summary", tables=(table,))
        layers = () if self.layers is None else self.layers.sections(folder)
        return *layers, forces, summary

    def _force_warnings(self) -> tuple[str, ...]:
        """Return what is odd in the robot's description, and in the forces."""
        model = self.result.replay.robot.warnings
        flags = self.result.describe_warnings()
        return model if flags == NO_WARNING else (*model, f"samples with {flags}")

    def settings(self) -> tuple[plots.Section, ...]:
        """Return the settings of the sensor, and of the identification."""
        settings = plots.settings_table(
            self.result.replay.config, "As in a file for --config, SI units"
        )
        heading = "Settings of the sensor"
        sensor = plots.Section(heading=heading, anchor="sensor", tables=(settings,))
        return (sensor, *(() if self.layers is None else self.layers.settings()))

    def _marks(self, x: Array, start_s: float) -> dict[str, Any]:
        """Return the tare and the rejected rows as marks of a chart over time."""
        tare = self.result.replay.tare
        spans: tuple[tuple[float, float], ...] = ()
        if tare is not None:
            spans = ((tare.start_s - start_s, tare.end_s - start_s),)
        rejected = x[has_status(self.result.rows, Status.REJECTED)]
        return {
            "shadings": (plots.Shading(label="tare", color=palette.TARE, spans=spans),),
            "instants": (
                plots.Instants("rejected", palette.REJECTED, tuple(rejected.tolist())),
            ),
        }

    def _panels(self) -> dict[str, list[Component]]:
        """Return the components of every panel, by the label of its y axis."""
        rows = self.result.rows
        config = self.result.replay.config
        axial = Component(
            "axial force", palette.OURS, rows["axial_N"], rows["axial_std_N"]
        )
        panels = {palette.FORCE: [axial]}
        for vector in vectors_of(rows, config):
            if vector.std is None:
                continue
            label = f"{vector.name},\n{config.axes} axes [{vector.unit}]"
            panels[label] = [
                Component(f"{vector.name} {axis}", style, values, std)
                for axis, style, values, std in zip(
                    "xyz",
                    palette.COMPONENTS,
                    vector.values.T,
                    vector.std.T,
                    strict=True,
                )
            ]
        return panels

    def _save_figures(self, folder: Path) -> tuple[plots.PageFigure, ...]:
        """Save the chart over time and, where the tool moves, that over travel."""
        rows = self.result.rows
        travel_m = rows["travel_m"][has_status(rows, Status.OK)]
        is_moving = len(travel_m) and np.ptp(travel_m) >= MIN_TRAVEL_M
        figures: list[plots.PageFigure] = []
        for over, caption in CAPTIONS.items():
            if over == "time" or is_moving:
                figure = plots.save_page_figure(
                    self.chart(over),
                    folder / f"forces-over-{over}.svg",
                    alt=f"Estimated forces of {self.result.log} over {over}",
                    caption=caption,
                    is_alone=True,
                )
                figures.append(figure)
        return tuple(figures)


def panel_of(
    label: str, rows: ForceRows, x: Array, components: Sequence[Component]
) -> Panel:
    """Return a panel with the tared part of each component, and its band.

    What was not tared is drawn in grey below it. The scale is that of the tared rows,
    if there are any. A rejected row leaves no hole, a gap in time does. Before a tare
    the band is the prior's, wider than any chart: the line alone shows more.

    Args:
        label: Label of the y axis.
        rows: The rows of the log.
        x: Their places on the x axis, shape (n,).
        components: What is drawn.
    """
    is_valid = ~has_status(rows, Status.REJECTED)
    is_tared = has_status(rows, Status.OK)[is_valid]
    x = x[is_valid]
    curves: list[Curve] = []
    for component in components:
        y = np.where(rows["after_gap"], np.nan, component.values)[is_valid]
        if not is_tared.all():
            curves.append(_untared_curve(component, x, y, is_tared))
        if is_tared.any():
            std = np.where(is_tared, component.std[is_valid], np.nan)
            curve = Curve(
                style=component.style,
                x=x,
                y=np.where(is_tared, y, np.nan),
                label=component.name,
                std=std,
                band_label=f"{component.name}, ± 2 std",
            )
            curves.append(curve)
    with_bands = [curve for curve in curves if curve.std is not None]
    limits = limits_of(with_bands, None) if with_bands else None
    return Panel(y_label=label, curves=tuple(curves), limits=limits)


def _untared_curve(
    component: Component, x: Array, y: Array, is_tared: NDArray[np.bool_]
) -> Curve:
    """Return the part of a component that was not tared, without a band."""
    style = palette.UNTARED
    label = "not tared"
    if not is_tared.any():  # then the colour must say which component it is
        style = replace(style, color=component.style.color)
        label = f"{component.name}, not tared"
    return Curve(style=style, x=x, y=np.where(is_tared, np.nan, y), label=label)
