"""Layers of a log in words, in a chart, and as sections of a page."""

from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from foundation.arrays import Array
from needleforce import plots
from needleforce.cli.logs.layer_result import (
    HEADER,
    METHODS,
    IdentificationResult,
    LayerRows,
    describe_zero,
    layer_cells,
    layer_text,
)
from needleforce.cli.logs.outputs import Answer
from needleforce.cli.logs.row_overview import axis_span, time_axis
from needleforce.cli.shared_options import Over
from needleforce.plots import Chart, Curve, LineStyle, Panel, palette

M_TO_MM = 1e3

_FORCE_LABELS = {
    "force_N": "axial force, as recorded",
    "predicted_force_N": "predicted",
    "tip_force_N": "tip force",
    "enhanced_force_N": "enhanced force",
}
_FORCE_STYLES: dict[str, LineStyle] = {
    "force_N": palette.READING,
    "predicted_force_N": palette.PREDICTED,
    "tip_force_N": palette.TIP,
    "enhanced_force_N": palette.OURS,
}
_PARAMETERS = {
    "stiffness_N_per_m": palette.STIFFNESS,
    "friction_Ns_per_m2": palette.FRICTION,
    "cumulative_friction_Ns_per_m": palette.CUMULATIVE_FRICTION,
}
"""Labels of the y axes of the parameters' panels, by column."""

_KELVIN_VOIGT_FRICTION = "friction B\n[Ns/m]"
"""Label of the friction of the Kelvin-Voigt model, which is not one per depth."""

_CAPTION = (
    "Above, the axial force as it was recorded, the force that the model predicts, the "
    "enhanced force (less the force in free air and the friction of the layers "
    "traversed) and the force at the tip. Below, stiffness and friction of the layer "
    "the tip is in, and the friction of all layers traversed; the band, where the "
    "method states one, is two standard deviations wide to either side. Marks below: "
    "estimated rupture times, and where friction was identified."
)

_TABLE_NOTE = (
    "Times on the log's clock. A ? marks what the data do not identify. Where a "
    "membrane is pushed in before it ruptures, layers overlap."
)


@dataclass(frozen=True, slots=True, eq=False)
class LayerPage:
    """What is shown of the layers of a log.

    Attributes:
        result: The layers.
    """

    result: IdentificationResult

    def text(self) -> str:
        """Return a text table, one line per layer."""
        return layer_text(self.result.layers, self.result.zero)

    def chart(self, over: Over = "time") -> Chart:
        """Return forces above, parameters below, as in Figure 8 of Ferro et al."""
        chart_height_in = 6.4
        result = self.result
        rows = _drawn_rows(result.rows)
        start_s, x_label = time_axis(rows["t_s"])
        x = rows["t_s"] - start_s
        events = self._events(rows, start_s)
        if over == "depth":
            zero = self.result.zero
            x = M_TO_MM * (rows["depth_m"] - zero.depth_m)
            x_label = f"depth {zero.name} [mm]"
            events = ()
        panels = [_force_panel(rows, x)]
        panels += [self._parameter_panel(name, rows, x) for name in _PARAMETERS]
        return Chart(
            title="Forces and identified parameters\n"
            f"{result.log}, method {result.method}",
            x_label=x_label,
            panels=tuple(panels),
            instants=events,
            x_limits=axis_span(x),
            height_in=chart_height_in,
        )

    @property
    def title(self) -> str:
        """What the page of a report shows."""
        return "Layers"

    def answer(self) -> Answer:
        """Return what was found: ruptures, friction, and the table of the layers."""
        return Answer(
            sentences=(self._describe_layers(),),
            warnings=(*self._describe_events(), *self.result.warnings),
            tables=(self._layer_table(),) if self.result.layers else (),
        )

    def _layer_table(self) -> plots.PageTable:
        """Return the table of the layers traversed."""
        return plots.PageTable(
            caption="Layers traversed",
            head=HEADER,
            rows=tuple(
                layer_cells(layer, self.result.zero) for layer in self.result.layers
            ),
            numeric=frozenset(range(len(HEADER))),
            note=f"{describe_zero(self.result.zero)} {_TABLE_NOTE}",
        )

    def _describe_events(self) -> tuple[str, ...]:
        """Return where something hard was met, and whether the tissue moved."""
        rows = self.result.rows
        sentences: list[str] = []
        depths_m = rows["depth_m"][rows["hard_contact"] > 0].tolist()
        if depths_m:
            zero = self.result.zero
            depths = _join(f"{zero.shown_mm(depth_m):.1f} mm" for depth_m in depths_m)
            sentences.append(f"Hard contact, as with bone, {depths} {zero.name}.")
        if (rows["tissue_moves"] > 0).any():
            sentences.append(
                "The tissue moved and pulled at the needle: ruptures of that time are "
                "doubtful, and no layer became final."
            )
        return tuple(sentences)

    def _describe_layers(self) -> str:
        """Return the ruptures found and the friction of their layers, in sentences."""
        layers = self.result.layers
        if not layers:
            return "No rupture was detected."
        zero = self.result.zero
        depths_mm = [zero.shown_mm(layer.rupture.depth_m) for layer in layers]
        depths = _join(f"{depth_mm:.1f} mm" for depth_mm in depths_mm)
        plural = "s" if len(layers) > 1 else ""
        sentences = [f"{len(layers)} rupture{plural} detected, {depths} {zero.name}."]
        known = [layer for layer in layers if layer.friction_identified]
        if known:
            frictions = _join(
                f"{layer.friction_N:.2f} N (layer {layer.layer})" for layer in known
            )
            sentences.append(f"Friction of the layers traversed: {frictions}.")
        return " ".join(sentences)

    def sections(self, folder: Path) -> tuple[plots.Section, ...]:
        """Save the chart of a report in a folder.

        Returns:
            The sections of its page.
        """
        result = self.result
        figure = plots.save_page_figure(
            self.chart(),
            folder / "layers.svg",
            alt=f"Forces and identified parameters of {result.log} over time",
            caption=_CAPTION,
            is_alone=True,
        )
        layers = plots.Section(
            heading="Layers",
            anchor="layers",
            paragraphs=(f"Made by `needleforce identify`, method {result.method}.",),
            figures=(figure,),
        )
        return (layers,)

    def settings(self) -> tuple[plots.Section, ...]:
        """Return the settings of the identification."""
        result = self.result
        settings = plots.settings_table(
            METHODS[result.method], f"Method {result.method}, SI units"
        )
        identification = plots.Section(
            heading="Settings of the identification",
            anchor="identification",
            tables=(settings,),
        )
        return (identification,)

    def _parameter_panel(self, name: str, rows: LayerRows, x: Array) -> Panel:
        """Return a parameter with its band, where the method states one."""
        std = rows[name.replace("_N", "_std_N", 1)]
        has_band = bool(np.isfinite(std).any())
        curve = Curve(
            style=palette.OURS,
            x=x,
            y=rows[name],
            std=std if has_band else None,
            band_label="± 2 std" if has_band else None,
        )
        label = _PARAMETERS[name]
        if name == "friction_Ns_per_m2" and self.result.method.endswith("kv"):
            label = _KELVIN_VOIGT_FRICTION
        return Panel(y_label=label, curves=(curve,))

    def _events(self, rows: LayerRows, start_s: float) -> tuple[plots.Instants, ...]:
        """Return when layers ruptured and when their friction was identified."""
        ruptures = tuple(layer.rupture.time_s - start_s for layer in self.result.layers)
        identified = tuple(
            rows["t_s"][self.result.rows["identified_layer"] > 0] - start_s
        )
        hard = tuple(rows["t_s"][self.result.rows["hard_contact"] > 0] - start_s)
        instants = (
            plots.Instants("estimated rupture time", palette.RUPTURE, ruptures),
            plots.Instants("friction identified", palette.COMPENSATION, identified),
            plots.Instants("hard contact", palette.HARD_CONTACT, hard),
        )
        return instants if hard else instants[:2]


def _join(texts: Iterable[str]) -> str:
    """Return texts as a list in a sentence."""
    *others, last = texts
    return f"{', '.join(others)} and {last}" if others else last


def _drawn_rows(rows: LayerRows) -> LayerRows:
    """Return the rows without estimates before the first row that was used."""
    is_unknown = np.cumsum(rows["used"]) == 0
    drawn = {
        name: np.where(is_unknown, np.nan, column) for name, column in rows.items()
    }
    return drawn | {name: rows[name] for name in ("t_s", "depth_m", "force_N")}


def _force_panel(rows: LayerRows, x: Array) -> Panel:
    """Return the recorded force and its parts."""
    # Height of the panel of the forces, in heights of the other panels
    forces_height = 2.0
    curves = tuple(
        Curve(style=_FORCE_STYLES[name], x=x, y=rows[name], label=_FORCE_LABELS[name])
        for name in _FORCE_LABELS
    )
    return Panel(y_label=palette.FORCE, curves=curves, height=forces_height)
