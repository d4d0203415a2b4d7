"""The report: chart, layers, warnings and settings of a log in one page."""

from bisect import bisect_right
from collections.abc import Mapping
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification.estimate import LayerEstimate
from identification.log_replay import ReplayedRows
from identification.multilayer_config import MULTILAYER
from identification.published_config import PUBLISHED, PUBLISHED_KV
from needleforce import plots
from needleforce.plots import (
    Chart,
    Curve,
    Instants,
    Page,
    PageTable,
    Panel,
    Section,
    palette,
    save_page_figure,
    settings_table,
    write_page,
)
from needleforce.plots.chart import WIDTH_IN
from needleforce.plots.page import PAGE
from recordings.columns.force_codes import FORCE_STATUS, WORTHLESS
from recordings.log_stream import LogChunk

METHODS = {"default": MULTILAYER, "published": PUBLISHED, "published-kv": PUBLISHED_KV}
"""What ``--method`` may be."""


_SET_S = 1e-3
"""A smaller difference is rounding."""


class LogClock:
    """Tells when on the log's clock something was, though that clock was set in between."""

    def __init__(self) -> None:
        self._from_s: list[float] = []
        self._zeros_s: list[float] = []

    def add(self, stamps_s: NDArray[np.float64], times_s: NDArray[np.float64]) -> None:
        """Take further rows whose time was counted.

        Args:
            stamps_s: Their stamps [s], shape (n,).
            times_s: Their times on the identifier's clock [s], shape (n,), ascending.
        """
        zeros_s = stamps_s - times_s
        before_s = self._zeros_s[-1:] or [np.inf]
        for k in np.flatnonzero(np.abs(np.diff(zeros_s, prepend=before_s)) > _SET_S):
            self._from_s.append(float(times_s[k]))
            self._zeros_s.append(float(zeros_s[k]))

    def at(self, time_s: float) -> float:
        """Return the stamp [s] of an instant on the identifier's clock [s]."""
        if not self._zeros_s:
            return time_s
        return time_s + self._zeros_s[max(bisect_right(self._from_s, time_s) - 1, 0)]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentificationResult:
    """The outcome of a whole log, of bounded size however long the log.

    Attributes:
        log: What the log is called.
        method: One of ``--method``.
        layers: Layers left, as known at the end.
        clock: From times of `layers` to the log's clock.
        ruptures_s: Times of the ruptures on the log's clock, as dated [s]; the latest ones.
        compensations_s: Times on that clock at which a layer's friction was identified [s].
        warnings: What was told about the log and its signs.
        overview: So many rows as a picture needs, with `force_N` and the columns of
            `estimate_table`; all rows of a short log, of a long one those in which a value is
            least or largest for a while. Empty if it was not asked for.
    """

    log: str
    method: str
    layers: tuple[LayerEstimate, ...]
    clock: LogClock
    ruptures_s: tuple[float, ...]
    compensations_s: tuple[float, ...]
    warnings: tuple[str, ...]
    overview: Mapping[str, NDArray[np.float64]]


# The chart after the paper's Figure 8.


Columns = Mapping[str, NDArray[np.float64]]

_FORCES = (
    ("force_N", "axial force, as recorded", palette.READING),
    ("predicted_force_N", "predicted", palette.PREDICTED),
    ("tip_force_N", "tip force", palette.TIP),
    ("enhanced_force_N", "enhanced force", palette.OURS),
)
_PANELS = (
    ("stiffness_N_per_m", "stiffness_std_N_per_m", palette.STIFFNESS),
    ("friction_Ns_per_m2", "friction_std_Ns_per_m2", palette.FRICTION),
    (
        "cumulative_friction_Ns_per_m",
        "cumulative_friction_std_Ns_per_m",
        palette.CUMULATIVE_FRICTION,
    ),
)
_OF_KELVIN_VOIGT = "friction B\n[Ns/m]"
_MOST_OF, _ROOM = 97.0, 1.5
"""Per cent of a parameter's values that its panel must hold, and how much more it shows."""
_PICTURE_IN = 8.0
_LATE_CLOCK_S = 1e5


def save_figure(path: str | Path, result: IdentificationResult) -> None:
    """Write the chart as PNG, SVG or PDF.

    Args:
        path: File to write.
        result: With an overview.

    Raises:
        figures.FiguresError: It cannot be drawn or written.
    """
    plots.save_figure(identification_chart(result, _PICTURE_IN), path)


def identification_chart(result: IdentificationResult, width_in: float = WIDTH_IN) -> Chart:
    """Forces above; stiffness, friction and cumulative friction below.

    Continuous upright lines mark the dated ruptures, dashed ones the compensations.

    Args:
        result: With an overview.
        width_in: Of the chart.
    """
    # Seconds since 1970 would leave the axis no digits for what happened.
    is_late = abs(float(result.overview["t_s"][0])) > _LATE_CLOCK_S
    start_s = float(result.overview["t_s"][0]) if is_late else 0.0
    rows = _drawn(result.overview, start_s)
    forces = tuple(
        Curve(style=style, x=rows["t_s"], y=rows[name], label=label)
        for name, label, style in _FORCES
    )
    return Chart(
        title=f"{result.log}, method {result.method}",
        x_label="time since the first sample [s]" if is_late else palette.TIME,
        panels=(
            Panel(y_label=palette.FORCE, curves=forces, height=2.0),
            *(_parameter(result.method, rows, *panel) for panel in _PANELS),
        ),
        instants=(
            Instants(
                label="rupture, as dated",
                style=palette.RUPTURE,
                places=tuple(t_s - start_s for t_s in result.ruptures_s),
            ),
            Instants(
                label="friction compensated",
                style=palette.COMPENSATION,
                places=tuple(t_s - start_s for t_s in result.compensations_s),
            ),
        ),
        x_limits=(float(rows["t_s"].min()), float(rows["t_s"].max())),
        width_in=width_in,
        height_in=6.4,
    )


def _drawn(rows: Columns, start_s: float) -> dict[str, NDArray[np.float64]]:
    """Return the rows in time from `start_s`; nothing is known before the first absorbed one."""
    is_unknown = np.cumsum(rows["absorbed"]) == 0
    recorded = {"t_s": rows["t_s"] - start_s, "force_N": rows["force_N"]}
    return {name: np.where(is_unknown, np.nan, values) for name, values in rows.items()} | recorded


def _parameter(method: str, rows: Columns, name: str, spread: str, label: str) -> Panel:
    values, std = rows[name], rows[spread]
    is_stated = bool(np.isfinite(std).any())
    curve = Curve(
        style=palette.OURS,
        x=rows["t_s"],
        y=values,
        std=std if is_stated else None,
        band_label="± 2 std" if is_stated else None,
    )
    is_kv = name == "friction_Ns_per_m2" and method.endswith("kv")
    return Panel(
        y_label=_OF_KELVIN_VOIGT if is_kv else label, curves=(curve,), limits=_limits(values)
    )


def _limits(values: NDArray[np.float64]) -> tuple[float, float]:
    """Return room for nearly all values that are not zero; transients may leave the panel."""
    told = values[np.isfinite(values) & (values != 0.0)]
    if not told.size:
        return -0.1, 1.0
    low, high = np.percentile(told, (100.0 - _MOST_OF, _MOST_OF)).tolist()
    top = max(_ROOM * high, 1e-9)
    return min(_ROOM * low, -0.08 * top), top


# Layers as a table for people, in millimetres.


HEADER = (
    "layer",
    "from mm",
    "thick mm",
    "rupture s",
    "alarm s",
    "drop N",
    "K N/m",
    "friction N",
    "B d Ns/m",
    "B Ns/m2",
)
"""Of the columns."""


def layer_table(result: IdentificationResult) -> str:
    """Text table, one line per layer; `?` marks what the data do not identify."""
    if not result.layers:
        return "no layer was left: no rupture found\n"
    lines = [HEADER, *(layer_cells(layer, result.clock) for layer in result.layers)]
    widths = [max(len(line[i]) for line in lines) for i in range(len(HEADER))]
    return "".join(
        "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) + "\n"
        for line in lines
    )


def layer_cells(layer: LayerEstimate, clock: LogClock) -> tuple[str, ...]:
    """The line of a layer.

    Args:
        layer: As known at the end.
        clock: From the layer's times to the log's clock.
    """
    rupture = layer.rupture
    product = layer.friction_N / max(rupture.speed_m_s, 1e-9)
    unsure = "" if layer.friction_identified else "?"
    return (
        str(layer.layer),
        f"{1e3 * layer.start_depth_m:.1f}",
        f"{1e3 * layer.thickness_m:.1f}",
        f"{clock.at(rupture.time_s):.2f}",
        f"{clock.at(rupture.alarm_s):.2f}",
        _with_std(layer.force_drop_N, layer.force_drop_std_N, 2),
        _with_std(layer.stiffness_N_per_m, layer.stiffness_std_N_per_m, 1)
        + ("" if layer.stiffness_identified else "?"),
        _with_std(layer.friction_N, layer.friction_std_N, 3) + unsure,
        f"{product:.0f}{unsure}",
        f"{layer.friction_Ns_per_m2:.0f}{unsure}",
    )


def _with_std(value: float, std: float | None, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text if std is None else f"{text}±{std:.{digits}f}"


_CAPTION = (
    "Above, the axial force as it was recorded, what the model expected, the enhanced force (less "
    "what was read in free air and the friction of the layers left) and the force at the tip. "
    "Below, stiffness and friction of the layer the tip is in, and the friction of all layers "
    "left; the band, where the method states one, is two standard deviations wide to either side. "
    "Continuous upright lines: ruptures as dated; dashed: friction identified and taken off from "
    "there on. Transients may leave the lower panels."
)


def write_report(folder: Path, result: IdentificationResult) -> Path:
    """Write ``index.html``, which needs no other file, and beside it the chart.

    Args:
        folder: Exists.
        result: With an overview.

    Returns:
        The page.

    Raises:
        figures.FiguresError: A file cannot be written.
    """
    figure = save_page_figure(
        identification_chart(result),
        folder / "layers.svg",
        is_alone=True,
        alt=f"Forces and identified parameters of {result.log} over time",
        caption=_CAPTION,
    )
    page = Page(
        title=f"Layers in {result.log}",
        lead=(f"Made by `python -m identification`, method {result.method}.",),
        sections=(
            Section(
                heading="Forces and parameters",
                anchor="forces",
                notices=tuple(f"Warning: {text}" for text in result.warnings),
                figures=(figure,),
            ),
            _layers(result),
            Section(
                heading="Settings",
                anchor="settings",
                paragraphs=("SI units.",),
                tables=(settings_table(METHODS[result.method], f"Method {result.method}"),),
            ),
        ),
    )
    return write_page(folder / PAGE, page)


def _layers(result: IdentificationResult) -> Section:
    if not result.layers:
        nothing = "No layer was left: no rupture was found."
        return Section(heading="Layers", anchor="layers", paragraphs=(nothing,))
    table = PageTable(
        caption="Layers left",
        head=HEADER,
        rows=tuple(layer_cells(layer, result.clock) for layer in result.layers),
        numeric=frozenset(range(len(HEADER))),
        note="Times on the log's clock. A ? marks what the data do not identify.",
    )
    return Section(heading="Layers", anchor="layers", tables=(table,))


# Online estimates as columns of a table.


_NUMBERS = (
    "enhanced_force_N",
    "tip_force_N",
    "shaft_friction_N",
    "shaft_friction_std_N",
    "predicted_force_N",
    "stiffness_N_per_m",
    "stiffness_std_N_per_m",
    "friction_Ns_per_m2",
    "friction_std_Ns_per_m2",
    "cumulative_friction_Ns_per_m",
    "cumulative_friction_std_Ns_per_m",
    "in_contact",
    "layer",
    "stiffness_identified",
    "friction_identified",
)
_EVENTS = ("rupture", "compensated")

_read = attrgetter(*_NUMBERS, "status.is_absorbed", *_EVENTS)


def estimate_table(rows: ReplayedRows) -> dict[str, NDArray[np.float64]]:
    """Columns named with their units, one row per row of the recording, of which there is one.

    `absorbed` is 0 for rows that could not be used; `rupture` is the number of the layer left on
    the row of its alarm, `compensated` on the row its friction was identified, else 0. Standard
    deviations that a method does not state are nan.
    """
    *numbers, absorbed, ruptures, compensated = zip(*map(_read, rows.estimates), strict=True)
    table = {"t_s": rows.t_s}
    for name, values in zip(_NUMBERS, numbers, strict=True):
        # None becomes nan.
        table[name] = np.array(values, dtype=np.float64)
    table["absorbed"] = np.array(absorbed, dtype=np.float64)
    for name, events in zip(_EVENTS, (ruptures, compensated), strict=True):
        table[name] = np.array([0.0 if e is None else float(e.layer) for e in events])
    return table


# Rows whose force an estimator has marked as not usable.


_USABLE = FORCE_STATUS.index("ok")
_WORTHLESS = sum(WORTHLESS.values())


class ForceStatus:
    """Takes out forces that are marked: one from before the tare is off by a newton.

    These are the rows that `insertion.InsertionSession` keeps from its identifier.

    Args:
        is_ignored: Take all forces as they are.
    """

    def __init__(self, *, is_ignored: bool) -> None:
        self._is_ignored, self._marked, self._warned = is_ignored, 0, 0

    def force_N(self, chunk: LogChunk) -> NDArray[np.float64]:
        """Return the force, NaN where it is not usable, shape (n,).

        Args:
            chunk: Rows with `force_N`, perhaps `force_status` and `force_warnings`.
        """
        force_N = chunk.channels["force_N"]
        if self._is_ignored:
            return force_N
        usable = np.full(len(force_N), float(_USABLE))
        is_marked = chunk.channels.get("force_status", usable) != _USABLE
        warnings = np.nan_to_num(chunk.channels.get("force_warnings", np.zeros(len(force_N))))
        is_worthless = (warnings.astype(np.int64) & _WORTHLESS) != 0
        self._marked += int(is_marked.sum())
        self._warned += int((is_worthless & ~is_marked).sum())
        return np.where(is_marked | is_worthless, np.nan, force_N)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out, if anything was."""
        reasons = {
            "whose status says that the force is not tared or not settled": self._marked,
            f"with a caution ({', '.join(WORTHLESS)})": self._warned,
        }
        return tuple(
            f"rows {reason} were left out: {count} (--ignore-status takes them)"
            for reason, count in reasons.items()
            if count
        )
