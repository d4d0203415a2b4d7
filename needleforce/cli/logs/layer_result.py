"""Layers of a whole log: their table, their lines of text, and the rows behind them."""

from collections import Counter
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from operator import attrgetter

import numpy as np

from foundation.arrays import Array
from identification import (
    MIXTURE,
    PUBLISHED,
    PUBLISHED_KV,
    Estimate,
    LayerEstimate,
    SampleStatus,
    TissueWarning,
)
from identification.log_replay import ReplayStream
from needleforce.cli.advice import describe_suspicion
from needleforce.cli.logs.row_overview import RowOverview
from needleforce.cli.shared_options import IdentificationOptions
from needleforce.cli.terminal import CommandError, say
from needleforce.depth_zero import FIRST_CONTACT, LOG_ZERO, DepthZero
from needleforce.recordings.channels import FORCE_STATUS, WORTHLESS
from needleforce.recordings.log import LogRows
from needleforce.recordings.output import OpenTable

METHODS = {
    "mixture": MIXTURE,
    "published": PUBLISHED,
    "published-kv": PUBLISHED_KV,
}
"""What ``--method`` may be."""

LayerRows = dict[str, Array]
"""Columns of the estimates, each of shape (n,); see `estimate_table`."""

DRAWN_COLUMNS = (
    "force_N",
    "predicted_force_N",
    "tip_force_N",
    "enhanced_force_N",
    "stiffness_N_per_m",
    "friction_Ns_per_m2",
    "cumulative_friction_Ns_per_m",
    "identified_layer",
    "hard_contact",
    "tissue_moves",
)
"""Columns whose extremes a figure must show."""

_UNTARED = "whose status says that the force is not tared or not settled"
_DOUBTFUL = f"with a warning ({', '.join(WORTHLESS)})"


def usable_force(chunk: LogRows, ignored: Counter[str]) -> Array:
    """Return the force [N], NaN where it is marked; untared it is off by a newton.

    The others are those that `needleforce.InsertionSession` gives to its identifier.

    Args:
        chunk: Rows of a log.
        ignored: How many rows were ignored for which reason; counted here.
    """
    channels = chunk.channels
    zeros = np.zeros(len(chunk.t_s))
    is_marked = channels.get("force_status", zeros) != FORCE_STATUS.index("ok")
    warnings = np.nan_to_num(channels.get("force_warnings", zeros)).astype(np.int64)
    is_worthless = (warnings & sum(WORTHLESS.values())) != 0
    ignored[_UNTARED] += int(is_marked.sum())
    ignored[_DOUBTFUL] += int((is_worthless & ~is_marked).sum())
    return np.where(is_marked | is_worthless, np.nan, channels["force_N"])


@dataclass(frozen=True, slots=True, eq=False)
class IdentificationResult:
    """The layers of a whole log, of bounded size however long the log.

    Attributes:
        log: Name of the log.
        method: One of `METHODS`.
        layers: Layers traversed, as known at the end.
        warnings: What seems wrong with signs and forces.
        rows: For a figure: `depth_m`, `force_N` and the columns of `estimate_table`.
        zero: Where the depths that are shown count from.
    """

    log: str
    method: str
    layers: tuple[LayerEstimate, ...]
    warnings: tuple[str, ...]
    rows: LayerRows
    zero: DepthZero


def identify_layers(
    chunks: Iterable[LogRows],
    name: str,
    options: IdentificationOptions,
    table: OpenTable | None = None,
) -> IdentificationResult:
    """Run the identifier over a log, and write its estimates into a table if given.

    Args:
        chunks: Rows of the log.
        name: Name of the log.
        options: Method, and whether marked rows are used.
        table: Table of the estimates.
    """
    stream = ReplayStream(METHODS[options.method])
    ignored = Counter[str]()
    statuses = Counter[SampleStatus]()
    steps_s: list[Array] = []
    overview = RowOverview(DRAWN_COLUMNS)
    for chunk in chunks:
        depth_m = chunk.channels["depth_m"]
        force_N = chunk.channels["force_N"]
        if not options.ignore_status:
            force_N = usable_force(chunk, ignored)
        estimates = stream.run(
            chunk.t_s,
            chunk.dt_s,
            depth_m,
            force_N,
            chunk.channels.get("speed_m_s"),
            chunk.channels.get("force_std_N"),
        )
        statuses.update(estimate.status for estimate in estimates)
        steps_s.append(chunk.dt_s[np.isfinite(chunk.dt_s)])
        below_m = depth_m - stream.contact_depths_m
        columns = estimate_table(chunk.t_s, below_m, estimates)
        overview.add({"depth_m": depth_m, "force_N": force_N} | columns)
        if table is not None:
            table.append(columns)
    _require_used_rows(statuses, ignored, np.concatenate(steps_s))
    warnings = (*_count_ignored(ignored), *map(describe_suspicion, stream.hints))
    layers = stream.layers
    for warning in warnings:
        say(f"warning: {warning}")
    return IdentificationResult(
        name,
        options.method,
        layers,
        warnings,
        overview.columns(),
        _zero_at(stream.contact_depth_m),
    )


def _require_used_rows(
    statuses: Counter[SampleStatus], ignored: Counter[str], steps_s: Array
) -> None:
    """Refuse a log of which no row was used, or whose rows lie too far apart.

    Args:
        statuses: What became of the rows.
        ignored: How many rows were ignored for which reason.
        steps_s: Time steps [s], shape (n,).

    Raises:
        CommandError: The log holds nothing to identify; the message says why.
    """
    max_step_s = 0.5  # a rupture lasts less; nobody records a needle more slowly
    if not any(status.is_used for status in statuses):
        reasons = [f"{count} x {status.value}" for status, count in statuses.items()]
        reasons += [f"{count} of them {reason}" for reason, count in (+ignored).items()]
        raise CommandError(
            f"none of {statuses.total()} rows could be used: {', '.join(reasons)}; "
            "expected depth and force in the same row"
        )
    step_s = float(np.median(steps_s)) if steps_s.size else 0.0
    if step_s > max_step_s:
        raise CommandError(
            f"{step_s:.4g} s lie between two rows, expected at most {max_step_s:g} s: "
            "name the unit of time if it is another one, as in --time t:ms"
        )


def _zero_at(contact_m: float | None) -> DepthZero:
    """Return the zero of depths at the first contact; the log's own without one."""
    if contact_m is None:
        return DepthZero(0.0, LOG_ZERO)
    return DepthZero(contact_m, FIRST_CONTACT)


def _count_ignored(ignored: Counter[str]) -> list[str]:
    """Return a warning for every reason for which rows were ignored."""
    return [
        f"rows {reason} were left out: {count} (--ignore-status takes them)"
        for reason, count in (+ignored).items()
    ]


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
"""Fields of an estimate that are columns as they are."""

_EVENTS = ("rupture", "identified_layer", "retracted")
"""Fields of an estimate that are None but on the rows of events."""

_read_numbers = attrgetter(*_NUMBERS, "status.is_used")
_read_events = attrgetter(*_EVENTS)


def estimate_table(
    t_s: Array, depth_in_tissue_m: Array, estimates: Sequence[Estimate]
) -> LayerRows:
    """Return the columns of the estimates of at least one row; names carry the unit.

    `used` is 0 for rows that were rejected. On the rows of events stands the number of
    a layer, else 0: `rupture` on the row of the alarm, `identified_layer` where its
    friction was identified, provisionally or, with `is_final`, finally, `retracted`
    where the alarm proved false. `hard_contact` is 1 on the row that showed one, and
    `tissue_moves` on every row with that warning. Standard deviations that a method
    does not state are nan.

    Args:
        t_s: Time stamps [s], shape (n,).
        depth_in_tissue_m: Depth of the tip below first contact, as known then; nan
            before, shape (n,).
        estimates: One estimate per row.
    """
    table: LayerRows = {"t_s": t_s}
    numbers = zip(*map(_read_numbers, estimates), strict=True)
    for name, values in zip((*_NUMBERS, "used"), numbers, strict=True):
        table[name] = np.array(values, dtype=np.float64)  # None becomes nan
    events = zip(*map(_read_events, estimates), strict=True)
    for name, of_rows in zip(_EVENTS, events, strict=True):
        table[name] = np.array(
            [0.0 if event is None else float(event.layer) for event in of_rows]
        )
    identified = [estimate.identified_layer for estimate in estimates]
    table["is_final"] = np.array(
        [float(layer is not None and layer.is_final) for layer in identified]
    )
    table["hard_contact"] = np.array(
        [float(estimate.hard_contact is not None) for estimate in estimates]
    )
    table["tissue_moves"] = np.array(
        [
            float(TissueWarning.TISSUE_MOVES in estimate.warnings)
            for estimate in estimates
        ]
    )
    table["depth_in_tissue_m"] = depth_in_tissue_m
    return table


HEADER = (
    "layer",
    "from mm",
    "to mm",
    "rupture s",
    "alarm s",
    "drop N",
    "K N/m",
    "friction N",
    "B Ns/m2",
)
"""Heads of the columns of `layer_cells`."""


def layer_text(layers: Sequence[LayerEstimate], zero: DepthZero) -> str:
    """Return a text table, one line per layer; `?` marks what is not identified.

    Args:
        layers: The layers.
        zero: Where depths count from.
    """
    if not layers:
        return "no rupture detected\n"
    lines = [HEADER, *(layer_cells(layer, zero) for layer in layers)]
    widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
    cells = [map(str.rjust, line, widths) for line in lines]
    table = "".join("  ".join(line) + "\n" for line in cells)
    return f"{table}{describe_zero(zero)}\n"


def describe_zero(zero: DepthZero) -> str:
    """Return in a sentence where depths count from."""
    if zero.name == LOG_ZERO:
        return f"Depths count {LOG_ZERO}."
    return (
        f"Depths are {zero.name}, {1e3 * zero.depth_m:z.1f} mm from the log's own zero."
    )


def layer_cells(layer: LayerEstimate, zero: DepthZero) -> tuple[str, ...]:
    """Return the line of a layer, its times on the log's clock."""
    rupture = layer.rupture
    end_depth_m = layer.start_depth_m + layer.thickness_m
    stiffness = _with_std(layer.stiffness_N_per_m, layer.stiffness_std_N_per_m, 1)
    stiffness_mark = "" if layer.stiffness_identified else "?"
    friction = _with_std(layer.friction_N, layer.friction_std_N, 3)
    friction_mark = "" if layer.friction_identified else "?"
    return (
        str(layer.layer),
        f"{zero.shown_mm(layer.start_depth_m):.1f}",
        _with_std(zero.shown_mm(end_depth_m), zero.end_std_mm(layer), 1),
        f"{rupture.time_s:.2f}",
        f"{rupture.alarm_s:.2f}",
        _with_std(layer.force_drop_N, layer.force_drop_std_N, 2),
        f"{stiffness}{stiffness_mark}",
        f"{friction}{friction_mark}",
        f"{layer.friction_Ns_per_m2:.0f}{friction_mark}",
    )


def _with_std(value: float, std: float | None, digits: int) -> str:
    text = f"{value:.{digits}f}"
    return text if std is None else f"{text}±{std:.{digits}f}"
