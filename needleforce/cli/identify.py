"""`needleforce identify`: layers and ruptures from depth and force, as table, figure and page."""

from collections import deque
from collections.abc import Iterator, Sequence
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from identification import MULTILAYER, PUBLISHED, PUBLISHED_KV, LayerEstimate
from identification.log_replay import ReplayedRows, ReplayStream
from needleforce.cli.log import (
    ChannelRequest,
    LogSession,
    RowOverview,
    in_window,
    mapping_from_options,
    open_output,
    result_page,
    run_log,
    time_axis,
)
from needleforce.cli.options import DepthColumns, IdentificationOptions, Output, Reading
from needleforce.cli.terminal import say, write_out
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
)
from needleforce.recordings.channels import FORCE_STATUS, WORTHLESS
from needleforce.recordings.log import LogChunk
from needleforce.recordings.open_recording import suggest_mapping
from needleforce.recordings.table import Labels

CHANNELS = ("depth", "speed", "force", "force_status", "force_warnings")
"""What is read of a log beside time."""

METHODS = {"multilayer": MULTILAYER, "published": PUBLISHED, "published-kv": PUBLISHED_KV}
"""What ``--method`` may be."""


def run(
    source: str,
    reading: Reading,
    output: Output,
    options: IdentificationOptions,
    columns: DepthColumns,
) -> int:
    """Run the command and return its exit code; what it raises is reported in one line."""
    known = mapping_from_options(columns)
    if columns.print_config:
        write_out(suggest_mapping(source, CHANNELS, mapping=known))
        return 0
    optional = ("speed", "force_status", "force_warnings")
    request = ChannelRequest(mapping=known, required=("depth", "force"), optional=optional)
    return run_log(
        source, reading, request, output, lambda log: identify_layers(log, options, output)
    )


# From a log to its result.

Rows = dict[str, NDArray[np.float64]]


class UsableForce:
    """Takes out forces that are marked: one from before the tare is off by a newton.

    These are the rows that `needleforce.InsertionSession` keeps from its identifier.

    Args:
        is_ignored: Take all forces as they are.
    """

    def __init__(self, *, is_ignored: bool) -> None:
        self._is_ignored, self._marked, self._warned = is_ignored, 0, 0

    def __call__(self, chunk: LogChunk) -> NDArray[np.float64]:
        """Return the force [N], NaN where it is not usable, shape (n,)."""
        channels, force_N = chunk.channels, chunk.channels["force_N"]
        if self._is_ignored:
            return force_N
        is_marked = channels.get("force_status", np.zeros(len(force_N))) != FORCE_STATUS.index("ok")
        warnings = np.nan_to_num(channels.get("force_warnings", np.zeros(len(force_N))))
        is_worthless = (warnings.astype(np.int64) & sum(WORTHLESS.values())) != 0
        self._marked += int(is_marked.sum())
        self._warned += int((is_worthless & ~is_marked).sum())
        return np.where(is_marked | is_worthless, np.nan, force_N)

    @property
    def warnings(self) -> tuple[str, ...]:
        """What was left out, if anything was."""
        reasons = {
            "whose status says that the force is not tared or not settled": self._marked,
            f"with a warning ({', '.join(WORTHLESS)})": self._warned,
        }
        return tuple(
            f"rows {reason} were left out: {count} (--ignore-status takes them)"
            for reason, count in reasons.items()
            if count
        )


_TRACKED = (
    "force_N",
    "predicted_force_N",
    "enhanced_force_N",
    "tip_force_N",
    "stiffness_N_per_m",
    "friction_Ns_per_m2",
    "cumulative_friction_Ns_per_m",
)
_MOST_EVENTS = 1000
_FLIP = "; a factor of -1 after the unit does, as in --force fz:N:-1"


def identify_layers(
    log: LogSession, options: IdentificationOptions, output: Output
) -> "IdentificationResult":
    """Run the identifier over a log and write its estimates."""
    stream = ReplayStream(METHODS[options.method])
    usable_force = UsableForce(is_ignored=options.ignore_status)
    result, overview = IdentificationResult(log.name, options.method), RowOverview(_TRACKED)
    with open_output(output, log, lambda: _labels(log)) as table:
        for rows, depth_m in _replayed(log, stream, usable_force):
            result.add(rows)
            columns = estimate_table(rows)
            overview.add({"depth_m": depth_m, "force_N": rows.force_N} | columns)
            if table is not None:
                table.append(columns)
    hints = (f"{hint.rstrip('?')}{_FLIP}" if "flip" in hint else hint for hint in stream.hints)
    result.warnings = (*usable_force.warnings, *hints)
    for warning in result.warnings:
        say(f"warning: {warning}")
    result.layers, result.rows = stream.layers, overview.columns()
    return result


class IdentificationResult:
    """The outcome of a whole log, of bounded size however long the log.

    Args:
        log: What the log is called.
        method: One of `METHODS`.

    Attributes:
        layers: Layers traversed, as known at the end.
        ruptures_s: Estimated rupture times on the log's clock [s]; the latest ones.
        identified_s: Times on that clock at which a layer's friction was identified [s].
        warnings: What was found wrong with signs and forces.
        rows: As many as a figure needs, with `depth_m`, `force_N` and the columns of
            `estimate_table`; of a long log those in which a value is least or largest for a while.
    """

    def __init__(self, log: str, method: str) -> None:
        self.log, self.method = log, method
        self.layers: tuple[LayerEstimate, ...] = ()
        self.warnings: tuple[str, ...] = ()
        self.rows: Rows = {}
        self.ruptures_s: deque[float] = deque(maxlen=_MOST_EVENTS)
        self.identified_s: deque[float] = deque(maxlen=_MOST_EVENTS)

    def add(self, rows: ReplayedRows) -> None:
        """Remember the events of further rows."""
        for estimate in rows.estimates:
            if estimate.rupture is not None:
                self.ruptures_s.append(estimate.rupture.time_s)
            if estimate.identified_layer is not None:
                self.identified_s.append(estimate.time_s)

    def text(self) -> str:
        """Return a text table, one line per layer; `?` marks what the data do not identify."""
        if not self.layers:
            return f"{NO_LAYER}\n"
        lines = [HEADER, *map(layer_cells, self.layers)]
        widths = [max(len(line[i]) for line in lines) for i in range(len(HEADER))]
        return "".join(
            "  ".join(cell.rjust(width) for cell, width in zip(line, widths, strict=True)) + "\n"
            for line in lines
        )

    def figure(self, output: Output) -> Chart:
        """Return the chart that the options ask for."""
        rows = in_window(self.rows, output)
        return depth_chart(self, rows) if output.over == "depth" else layer_chart(self, rows)

    def page(self, folder: Path, warnings: Sequence[str]) -> Page:
        """Save the chart of a report in a folder and return the page that shows it."""
        figure = save_page_figure(
            layer_chart(self, self.rows),
            folder / "layers.svg",
            alt=f"Forces and identified parameters of {self.log} over time",
            caption=_CAPTION,
            is_alone=True,
        )
        layers = PageTable(
            caption="Layers traversed" if self.layers else f"{NO_LAYER.capitalize()}.",
            head=HEADER,
            rows=tuple(map(layer_cells, self.layers)),
            numeric=frozenset(range(len(HEADER))),
            note="Times on the log's clock. A ? marks what the data do not identify.",
        )
        return result_page(
            f"Layers in {self.log}",
            f"Made by `needleforce identify`, method {self.method}.",
            (*warnings, *self.warnings),
            (figure,),
            Section(heading="Layers", anchor="layers", tables=(layers,)),
            settings_table(METHODS[self.method], f"Method {self.method}, SI units"),
        )


def _replayed(
    log: LogSession, stream: ReplayStream, usable_force: UsableForce
) -> Iterator[tuple[ReplayedRows, NDArray[np.float64]]]:
    """Yield rows with estimates, and their depths; where speed is derived they come later."""
    waiting_m = np.empty(0)
    for chunk in log:
        depth_m, speed_m_s = chunk.channels["depth_m"], chunk.channels.get("speed_m_s")
        waiting_m = np.concatenate((waiting_m, depth_m))
        rows = stream.run(chunk.t_s, depth_m, usable_force(chunk), speed_m_s, chunk.dt_s)
        if rows.estimates:
            yield rows, waiting_m[: len(rows.t_s)]
            waiting_m = waiting_m[len(rows.t_s) :]
    rows = stream.finish()
    if rows.estimates:
        yield rows, waiting_m


def _labels(log: LogSession) -> Labels:
    """Return what a bag of estimates says beside the numbers."""
    events = {
        "rupture": ("", "layer {} ruptured"),
        "identified_layer": ("", "friction of layer {} identified"),
        "retracted": ("", "rupture of layer {} retracted"),
    }
    return Labels(start_ns=log.start_ns, prefix="/needleforce/identification", events=events)


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
_read = attrgetter(*_NUMBERS, "status.is_used", "rupture", "identified_layer", "retracted")


def estimate_table(rows: ReplayedRows) -> Rows:
    """Return the columns of the estimates of at least one row; names carry the unit.

    `used` is 0 for rows that were rejected. On the rows of events stands the number of a layer,
    else 0: `rupture` on the row of the alarm, `identified_layer` where its friction was identified,
    provisionally or, with `is_final`, finally, `retracted` where the alarm proved false. Standard
    deviations that a method does not state are nan.
    """
    *numbers, used, ruptures, layers, retracted = zip(*map(_read, rows.estimates), strict=True)
    table = {"t_s": rows.t_s}
    for name, values in zip(_NUMBERS, numbers, strict=True):
        # None becomes nan.
        table[name] = np.array(values, dtype=np.float64)
    table["used"] = np.array(used, dtype=np.float64)
    events = {"rupture": ruptures, "identified_layer": layers, "retracted": retracted}
    for name, found in events.items():
        table[name] = np.array([0.0 if event is None else float(event.layer) for event in found])
    table["is_final"] = np.array([float(one is not None and one.is_final) for one in layers])
    return table


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
NO_LAYER = "no rupture detected"


def layer_cells(layer: LayerEstimate) -> tuple[str, ...]:
    """Return the line of a layer, its times on the log's clock."""
    rupture = layer.rupture
    product = layer.friction_N / max(rupture.speed_m_s, 1e-9)
    unsure = "" if layer.friction_identified else "?"
    return (
        str(layer.layer),
        f"{1e3 * layer.start_depth_m:.1f}",
        f"{1e3 * layer.thickness_m:.1f}",
        f"{rupture.time_s:.2f}",
        f"{rupture.alarm_s:.2f}",
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


# Charts after the paper's Figure 8.

_FORCES = (
    ("force_N", "axial force, as recorded", palette.READING),
    ("predicted_force_N", "predicted", palette.PREDICTED),
    ("tip_force_N", "tip force", palette.TIP),
    ("enhanced_force_N", "enhanced force", palette.OURS),
)
_PARAMETERS = {
    "stiffness_N_per_m": palette.STIFFNESS,
    "friction_Ns_per_m2": palette.FRICTION,
    "cumulative_friction_Ns_per_m": palette.CUMULATIVE_FRICTION,
}
_OF_KELVIN_VOIGT = "friction B\n[Ns/m]"


def layer_chart(result: IdentificationResult, rows: Rows) -> Chart:
    """Return forces over time above; stiffness, friction and cumulative friction below."""
    rows = _known(rows)
    start_s, time = time_axis(rows["t_s"])
    x = rows["t_s"] - start_s
    panels = [Panel(y_label=palette.FORCE, curves=_forces(rows, x), height=2.0)]
    for name, label in _PARAMETERS.items():
        std = rows[name.replace("_N", "_std_N", 1)]
        is_stated = bool(np.isfinite(std).any())
        curve = Curve(
            style=palette.OURS,
            x=x,
            y=rows[name],
            std=std if is_stated else None,
            band_label="± 2 std" if is_stated else None,
        )
        is_kv = name == "friction_Ns_per_m2" and result.method.endswith("kv")
        panels.append(Panel(y_label=_OF_KELVIN_VOIGT if is_kv else label, curves=(curve,)))
    events = (
        ("estimated rupture time", palette.RUPTURE, result.ruptures_s),
        ("friction identified", palette.COMPENSATION, result.identified_s),
    )
    return Chart(
        title=f"Forces and identified parameters\n{result.log}, method {result.method}",
        x_label=time,
        panels=tuple(panels),
        instants=tuple(
            Instants(label=label, style=style, places=tuple(t_s - start_s for t_s in times_s))
            for label, style, times_s in events
        ),
        x_limits=(float(x.min()), float(x.max())),
        height_in=6.4,
    )


def depth_chart(result: IdentificationResult, rows: Rows) -> Chart:
    """Return the forces over depth."""
    rows = _known(rows)
    return Chart(
        title=f"Forces over depth\n{result.log}, method {result.method}",
        x_label="depth [mm]",
        panels=(Panel(y_label=palette.FORCE, curves=_forces(rows, 1e3 * rows["depth_m"])),),
    )


def _known(rows: Rows) -> Rows:
    """Return the rows; nothing is estimated before the first one that was used."""
    is_unknown = np.cumsum(rows["used"]) == 0
    recorded = {name: rows[name] for name in ("t_s", "depth_m", "force_N")}
    return {name: np.where(is_unknown, np.nan, values) for name, values in rows.items()} | recorded


def _forces(rows: Rows, x: NDArray[np.float64]) -> tuple[Curve, ...]:
    return tuple(
        Curve(style=style, x=x, y=rows[name], label=label) for name, label, style in _FORCES
    )


_CAPTION = (
    "Above, the axial force as it was recorded, the force that the model predicts, the enhanced "
    "force (less the force in free air and the friction of the layers traversed) and the force at "
    "the tip. Below, stiffness and friction of the layer the tip is in, and the friction of all "
    "layers traversed; the band, where the method states one, is two standard deviations wide to "
    "either side. Marks below: estimated rupture times, and where friction was identified."
)
