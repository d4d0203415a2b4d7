"""`needleforce identify`: layers and ruptures from depth and force, as table, figure
and page.
"""

from collections import Counter
from collections.abc import Iterable
from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from foundation.advice import Advice, Message
from identification import MULTILAYER, PUBLISHED, PUBLISHED_KV, Estimate, LayerEstimate
from identification.advice import SignAdvice
from identification.log_replay import ReplayStream
from needleforce import plots
from needleforce.cli.logs.log_session import LogSession, mapping_from_options
from needleforce.cli.logs.outputs import open_output, run_log
from needleforce.cli.logs.row_overview import RowOverview, span, time_axis
from needleforce.cli.shared_options import (
    DepthColumns,
    IdentificationOptions,
    Output,
    Over,
)
from needleforce.cli.terminal import say, write_out
from needleforce.plots import Chart, Curve, Panel, palette
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channels import FORCE_STATUS, WORTHLESS
from needleforce.recordings.log_stream import LogChunk
from needleforce.recordings.mapping_suggestion import suggest_mapping
from needleforce.recordings.output import OpenTable
from needleforce.recordings.table import TableLabels

REQUIRED = ("depth", "force")


OPTIONAL = ("speed", "force_std", "force_status", "force_warnings")  # Read beside time


METHODS = {
    "multilayer": MULTILAYER,
    "published": PUBLISHED,
    "published-kv": PUBLISHED_KV,
}
"""What ``--method`` may be."""


def run(
    source: str,
    output: Output,
    options: IdentificationOptions,
    columns: DepthColumns,
) -> int:
    """Run the command and return its exit code; what it raises is reported in one
    line.
    """
    known = mapping_from_options(columns)
    force = known.channels.get("force")
    optional = OPTIONAL
    if force is not None and "axial" not in force.patterns[0].lower():
        # What `needleforce force` states of the axial force holds for no other.
        optional = tuple(
            name for name in OPTIONAL if name == "speed" or name in known.channels
        )
    if columns.print_config:
        write_out(suggest_mapping(source, (*REQUIRED, *optional), mapping=known))
        return 0
    request = ChannelRequest(mapping=known, required=REQUIRED, optional=optional)

    def estimate(log: LogSession) -> IdentificationResult:
        with open_output(
            output, log, TableLabels(prefix="/needleforce/identification")
        ) as table:
            return identify_layers(log, log.name, options, table)

    return run_log(source, output, request, estimate)


Rows = dict[str, NDArray[np.float64]]


_UNTARED = "whose status says that the force is not tared or not settled"


_DOUBTFUL = f"with a warning ({', '.join(WORTHLESS)})"


def usable_force(chunk: LogChunk, left_out: Counter[str]) -> NDArray[np.float64]:
    """Return the force [N], NaN and counted where it is marked: untared it is off by a
    newton.

    The others are those that `needleforce.InsertionSession` gives to its identifier.
    """
    channels = chunk.channels
    nothing = np.zeros(len(chunk.t_s))
    is_marked = channels.get("force_status", nothing) != FORCE_STATUS.index("ok")
    warnings = np.nan_to_num(channels.get("force_warnings", nothing)).astype(np.int64)
    is_worthless = (warnings & sum(WORTHLESS.values())) != 0
    left_out[_UNTARED] += int(is_marked.sum())
    left_out[_DOUBTFUL] += int((is_worthless & ~is_marked).sum())
    return np.where(is_marked | is_worthless, np.nan, channels["force_N"])


def identify_layers(
    chunks: Iterable[LogChunk],
    name: str,
    options: IdentificationOptions,
    table: OpenTable | None = None,
) -> "IdentificationResult":
    """Run the identifier over a log and write its estimates into a table, if there
    is one.
    """
    stream = ReplayStream(METHODS[options.method])
    left_out = Counter[str]()
    drawn = (*(force for force, _, _ in _FORCES), *_PARAMETERS, "identified_layer")
    overview = RowOverview(drawn)
    for chunk in chunks:
        t_s = chunk.t_s
        depth_m = chunk.channels["depth_m"]
        force_N = chunk.channels["force_N"]
        if not options.ignore_status:
            force_N = usable_force(chunk, left_out)
        speed_m_s = chunk.channels.get("speed_m_s")
        std_N = chunk.channels.get("force_std_N")
        estimates = stream.run(t_s, chunk.dt_s, depth_m, force_N, speed_m_s, std_N)
        columns = estimate_table(t_s, estimates)
        overview.add({"depth_m": depth_m, "force_N": force_N} | columns)
        if table is not None:
            table.append(columns)
    counted = (
        f"rows {reason} were left out: {count} (--ignore-status takes them)"
        for reason, count in (+left_out).items()
    )
    hints = (Message(hint).in_words(_ADVICES) for hint in stream.hints)
    warnings = (*counted, *hints)
    layers = stream.layers
    for warning in warnings:
        say(f"warning: {warning}")
    return IdentificationResult(
        name, options.method, layers, warnings, overview.columns()
    )


_FACTOR = "; a factor of -1 after the unit does, as in"
_ADVICES: dict[Advice, str] = {
    SignAdvice.FLIP_FORCE: f"flip its sign{_FACTOR} --force fz:N:-1",
    SignAdvice.FLIP_DEPTH: f"flip its sign{_FACTOR} --depth z:m:-1",
    SignAdvice.FLIP_SPEED: f"flip one of them{_FACTOR} --speed v:m/s:-1",
}
"""Options for what hints about signs advise."""


_EVENTS = ("rupture", "identified_layer", "retracted")


_NUMBERS = (
    *("enhanced_force_N", "tip_force_N", "shaft_friction_N", "shaft_friction_std_N"),
    *("predicted_force_N", "stiffness_N_per_m", "stiffness_std_N_per_m"),
    *("friction_Ns_per_m2", "friction_std_Ns_per_m2"),
    *("cumulative_friction_Ns_per_m", "cumulative_friction_std_Ns_per_m"),
    *("in_contact", "layer", "stiffness_identified", "friction_identified"),
)


_read = attrgetter(*_NUMBERS, "status.is_used", *_EVENTS)


def estimate_table(t_s: NDArray[np.float64], estimates: list[Estimate]) -> Rows:
    """Return the columns of the estimates of at least one row; names carry the unit.

    `used` is 0 for rows that were rejected. On the rows of events stands the number of
    a layer, else 0: `rupture` on the row of the alarm, `identified_layer` where its
    friction was identified, provisionally or, with `is_final`, finally, `retracted`
    where the alarm proved false. Standard deviations that a method does not state are
    nan.
    """
    *numbers, ruptures, layers, retracted = zip(*map(_read, estimates), strict=True)
    table = {"t_s": t_s}
    cells = zip((*_NUMBERS, "used"), numbers, strict=True)
    table |= {
        name: np.array(v, dtype=np.float64) for name, v in cells
    }  # None becomes nan
    for name, found in zip(_EVENTS, (ruptures, layers, retracted), strict=True):
        table[name] = np.array(
            [0.0 if event is None else float(event.layer) for event in found]
        )
    table["is_final"] = np.array(
        [float(one is not None and one.is_final) for one in layers]
    )
    return table


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationResult:
    """The outcome of a whole log, of bounded size however long the log.

    Attributes:
        method: One of `METHODS`.
        layers: traversed, as known at the end.
        warnings: What was found wrong with signs and forces.
        rows: For a figure: `depth_m`, `force_N` and the columns of `estimate_table`.
    """

    log: str
    method: str
    layers: tuple[LayerEstimate, ...]
    warnings: tuple[str, ...]
    rows: Rows

    def text(self) -> str:
        """Return a text table, one line per layer; `?` marks what the data do not
        identify.
        """
        if not self.layers:
            return "no rupture detected\n"
        lines = [HEADER, *map(layer_cells, self.layers)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        cells = [map(str.rjust, line, widths) for line in lines]
        return "".join("  ".join(line) + "\n" for line in cells)

    def chart(self, over: Over = "time") -> Chart:
        """Return forces above, the identified parameters below, as in the paper's
        Figure 8.
        """
        start_s, x_label = time_axis(self.rows["t_s"])
        # Nothing is estimated before the first row that was used.
        is_unknown = np.cumsum(self.rows["used"]) == 0
        rows = {
            name: np.where(is_unknown, np.nan, each) for name, each in self.rows.items()
        }
        rows |= {name: self.rows[name] for name in ("t_s", "depth_m", "force_N")}
        x = rows["t_s"] - start_s
        if over == "depth":
            x = 1e3 * rows["depth_m"]
            x_label = "depth [mm]"
        forces = [
            Curve(style=style, x=x, y=rows[n], label=text) for n, text, style in _FORCES
        ]
        panels = [Panel(y_label=palette.FORCE, curves=tuple(forces), height=2.0)]
        for name, label in _PARAMETERS.items():
            std = rows[name.replace("_N", "_std_N", 1)]
            band = (
                {"std": std, "band_label": "± 2 std"} if np.isfinite(std).any() else {}
            )
            curve = Curve(style=palette.OURS, x=x, y=rows[name], **band)
            is_kv = name == "friction_Ns_per_m2" and self.method.endswith("kv")
            panels.append(
                Panel(y_label=_OF_KELVIN_VOIGT if is_kv else label, curves=(curve,))
            )
        ruptures = tuple(layer.rupture.time_s - start_s for layer in self.layers)
        identified = tuple(rows["t_s"][self.rows["identified_layer"] > 0] - start_s)
        events = (
            plots.Instants("estimated rupture time", palette.RUPTURE, ruptures),
            plots.Instants("friction identified", palette.COMPENSATION, identified),
        )
        return Chart(
            title=f"Forces and identified parameters\n{self.log}, method {self.method}",
            x_label=x_label,
            panels=tuple(panels),
            instants=events if over == "time" else (),
            x_limits=span(x),
            height_in=6.4,
        )

    def sections(self, folder: Path) -> tuple[plots.Section, ...]:
        """Save the chart of a report in a folder and return the sections of its
        page.
        """
        place = folder / "layers.svg"
        alt = f"Forces and identified parameters of {self.log} over time"
        figure = plots.save_page_figure(
            self.chart(), place, alt=alt, caption=_CAPTION, is_alone=True
        )
        table = plots.PageTable(
            caption="Layers traversed" if self.layers else "No rupture detected.",
            head=HEADER,
            rows=tuple(map(layer_cells, self.layers)),
            numeric=frozenset(range(len(HEADER))),
            note="Times on the log's clock. A ? marks what the data do not identify. Where a "
            "membrane is pushed in before it ruptures, layers overlap.",
        )
        layers = plots.Section(
            heading="Layers",
            anchor="layers",
            paragraphs=(f"Made by `needleforce identify`, method {self.method}.",),
            notices=tuple(f"Warning: {text}" for text in self.warnings),
            figures=(figure,),
            tables=(table,),
        )
        settings = plots.settings_table(
            METHODS[self.method], f"Method {self.method}, SI units"
        )
        heading = "Settings of the identification"
        return layers, plots.Section(
            heading=heading, anchor="identification", tables=(settings,)
        )


HEADER = (
    *("layer", "from mm", "to mm", "rupture s", "alarm s", "drop N"),
    *("K N/m", "friction N", "B Ns/m2"),
)


def layer_cells(layer: LayerEstimate) -> tuple[str, ...]:
    """Return the line of a layer, its times on the log's clock."""
    rupture = layer.rupture
    unsure = "" if layer.friction_identified else "?"
    stiffness = _with_std(layer.stiffness_N_per_m, layer.stiffness_std_N_per_m, 1)
    return (
        str(layer.layer),
        f"{1e3 * layer.start_depth_m:.1f}",
        f"{1e3 * (layer.start_depth_m + layer.thickness_m):.1f}",
        f"{rupture.time_s:.2f}",
        f"{rupture.alarm_s:.2f}",
        _with_std(layer.force_drop_N, layer.force_drop_std_N, 2),
        stiffness + ("" if layer.stiffness_identified else "?"),
        _with_std(layer.friction_N, layer.friction_std_N, 3) + unsure,
        f"{layer.friction_Ns_per_m2:.0f}{unsure}",
    )


def _with_std(value: float, std: float | None, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text if std is None else f"{text}±{std:.{digits}f}"


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


_CAPTION = (
    "Above, the axial force as it was recorded, the force that the model predicts, the enhanced "
    "force (less the force in free air and the friction of the layers traversed) and the force at "
    "the tip. Below, stiffness and friction of the layer the tip is in, and the friction of all "
    "layers traversed; the band, where the method states one, is two standard deviations wide to "
    "either side. Marks below: estimated rupture times, and where friction was identified."
)
