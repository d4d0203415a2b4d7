"""Layers of depths and forces: the identifier's replay, and what it says in words."""

from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from operator import attrgetter

import numpy as np
import pandas as pd
from scipy.ndimage import median_filter

from foundation.arrays import Array
from identification import (
    MIXTURE,
    PUBLISHED,
    PUBLISHED_KV,
    Estimate,
    LayerEstimate,
    SampleStatus,
    TissueWarning,
    replay,
)
from needleforce.cli.logs.columns import parse_window
from needleforce.cli.logs.figures import draw_layers
from needleforce.cli.logs.result import Result
from needleforce.cli.options import IdentificationOptions
from needleforce.cli.terminal import CommandError
from needleforce.depth_zero import FIRST_CONTACT, LOG_ZERO, DepthZero
from needleforce.recordings import Log
from needleforce.session import UNUSABLE
from needleforce.session_replay import STATUS_CODES, SensorReplay
from residual import Status

METHODS = {
    "mixture": MIXTURE,
    "published": PUBLISHED,
    "published-kv": PUBLISHED_KV,
}
"""What ``--method`` may be."""

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
    "status.is_used",
)
"""Fields of an estimate that are columns as they are."""

CAPTION = (
    "Above, the axial force as it was recorded, the force that the model predicts, the "
    "enhanced force (less the force in free air and the friction of the layers "
    "traversed) and the force at the tip. Below, stiffness and friction of the layer "
    "the tip is in, and the friction of all layers traversed; the band, where the "
    "method states one, is two standard deviations wide to either side. Marks below: "
    "estimated rupture times, and where friction was identified. In the table times "
    "are on the log's clock, and a ? marks what the data do not identify. Where a "
    "membrane is pushed in before it ruptures, layers overlap."
)


@dataclass(frozen=True, slots=True, eq=False)
class LayerReplay:
    """What the identifier has found in a log.

    Attributes:
        log: The log of depth and force.
        rows: The columns of `estimate_table`, and `depth_m` and `force_N` of the log.
        layers: Layers traversed, as known at the end.
        warnings: What seems wrong with signs and forces.
        zero: Where the depths that are shown count from.
        method: One of `METHODS`.
    """

    log: Log
    rows: pd.DataFrame
    layers: tuple[LayerEstimate, ...]
    warnings: tuple[str, ...]
    zero: DepthZero
    method: str


def identify_layers(
    log: Log,
    options: IdentificationOptions,
    progress: Callable[[float], None] = lambda fraction: None,
) -> LayerReplay:
    """Run the identifier over depths and forces.

    Args:
        log: With `depth_m` and `force_N`, perhaps `speed_m_s`, `force_std_N`, and
            status and warnings of the force.
        options: Method, and whether marked rows are used.
        progress: Takes the fraction of the rows that is done.

    Raises:
        CommandError: No row could be used, or rows lie too far apart in time.
    """
    if options.between is not None:
        log = _rows_between(log, options.between)
    ignored: dict[str, int] = {}
    force_N = log["force_N"]
    if not options.ignore_status:
        force_N, ignored = usable_force(log)
    found = replay(
        log.t_s,
        log["depth_m"],
        force_N,
        log.channels.get("speed_m_s"),
        METHODS[options.method],
        dt_s=log.dt_s,
        force_std_N=log.channels.get("force_std_N"),
        progress=progress,
    )
    statuses = Counter(estimate.status for estimate in found.estimates)
    _require_used_rows(statuses, ignored, log)
    contact_m = float(found.contact_depths_m[-1])
    zero = (
        DepthZero(contact_m, FIRST_CONTACT)
        if np.isfinite(contact_m)
        else DepthZero(0.0, LOG_ZERO)
    )
    counted = [
        f"rows {reason} were left out: {count} (--ignore-status takes them)"
        for reason, count in ignored.items()
    ]
    depth_in_tissue_m = log["depth_m"] - found.contact_depths_m
    table = estimate_table(log.t_s, depth_in_tissue_m, found.estimates)
    return LayerReplay(
        log=log,
        rows=table.assign(depth_m=log["depth_m"], force_N=force_N),
        layers=found.layers,
        warnings=(
            *counted,
            *(hint.text for hint in found.hints),
            *_describe_later_insertions(log, contact_m),
        ),
        zero=zero,
        method=options.method,
    )


def _rows_between(log: Log, text: str) -> Log:
    """Return the rows of a log that ``--between`` names; `CommandError` without any."""
    window = parse_window("--between", text, float(log.t_s[0]))
    rows = (log.t_s >= window.start_s) & (log.t_s <= window.end_s)
    if not rows.any():
        raise CommandError(
            f"--between {text}: expected seconds of the log, which runs from "
            f"{log.t_s[0]:.12g} to {log.t_s[-1]:.12g} s"
        )
    channels = {name: values[rows] for name, values in log.channels.items()}
    return replace(log, t_s=log.t_s[rows], channels=channels)


def _describe_later_insertions(log: Log, contact_m: float) -> list[str]:
    """Return when the needle entered again after it had left the tissue.

    Layers are those of one insertion: what a needle has cut does not rupture again.

    Args:
        log: Of depth and force.
        contact_m: Depth of the first contact [m]; NaN without one.
    """
    out_m = 2e-3  # above the contact: the surface follows a needle that is drawn back
    in_m = 5e-3  # below it: deeper than a surface is dented
    held_s = 0.5  # a depth that jumps for a moment is no way of the needle
    known = np.isfinite(log["depth_m"])
    t_s = log.t_s[known]
    if len(t_s) < 2 or not np.isfinite(contact_m):
        return []
    held_rows = max(1, round(held_s / float(np.median(np.diff(t_s)))))
    below_m = median_filter(log["depth_m"][known] - contact_m, held_rows)
    is_sure = (below_m < -out_m) | (below_m > in_m)
    is_in = below_m[is_sure] > 0.0
    # The needle leaves and enters in turns; the first entry is no later one.
    turns_s = t_s[is_sure][1:][np.diff(is_in)]
    turns_s = turns_s[1:] if not is_in[:1].all() else turns_s
    return [
        f"the needle enters again at {entry_s:.6g} s, and layers are of the first "
        f"insertion; --between {exit_s:.12g}: reads the later one"
        for exit_s, entry_s in zip(turns_s[::2], turns_s[1::2], strict=False)
    ]


def usable_force(log: Log) -> tuple[Array, dict[str, int]]:
    """Return the force [N], NaN where it is marked; untared it is off by a newton.

    The others are those that `needleforce.InsertionSession` gives to its identifier.

    Returns:
        The force, shape (n,), and how many rows were left out, by the reason.
    """
    zeros = np.zeros(len(log))
    is_marked = log.channels.get("force_status", zeros) != STATUS_CODES[Status.OK]
    flags = np.nan_to_num(log.channels.get("force_warnings", zeros)).astype(np.int64)
    is_doubtful = (flags & UNUSABLE) != 0
    counts = {
        "whose status says that the force is not tared or not settled": is_marked,
        f"with a warning ({UNUSABLE})": is_doubtful & ~is_marked,
    }
    ignored = {reason: int(rows.sum()) for reason, rows in counts.items() if rows.any()}
    return np.where(is_marked | is_doubtful, np.nan, log["force_N"]), ignored


def _require_used_rows(
    statuses: Counter[SampleStatus], ignored: dict[str, int], log: Log
) -> None:
    """Refuse a log of which no row was used, or whose rows lie too far apart.

    Args:
        statuses: What became of the rows.
        ignored: How many rows were ignored for which reason.
        log: The log.

    Raises:
        CommandError: The log holds nothing to identify; the message says why.
    """
    max_step_s = 0.5  # a rupture lasts less; nobody records a needle more slowly
    if not any(status.is_used for status in statuses):
        reasons = [f"{count} x {status.value}" for status, count in statuses.items()]
        reasons += [f"{count} of them {reason}" for reason, count in ignored.items()]
        raise CommandError(
            f"none of {statuses.total()} rows could be used: {', '.join(reasons)}; "
            "expected depth and force in the same row"
        )
    step_s = float(np.median(np.diff(log.t_s))) if len(log) > 1 else 0.0
    if step_s > max_step_s:
        raise CommandError(
            f"{step_s:.4g} s lie between two rows, expected at most {max_step_s:g} s: "
            "name the unit of time if it is another one, as in --time t:ms"
        )


def estimate_table(
    t_s: Array, depth_in_tissue_m: Array, estimates: Sequence[Estimate]
) -> pd.DataFrame:
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
    numbers = np.array(list(map(attrgetter(*_NUMBERS), estimates)), dtype=np.float64)
    table = pd.DataFrame(numbers, columns=_NUMBERS)  # None has become nan
    table.insert(0, "t_s", t_s)
    events = {
        name: [float(getattr(getattr(e, name), "layer", 0)) for e in estimates]
        for name in ("rupture", "identified_layer", "retracted")
    }
    identified = [estimate.identified_layer for estimate in estimates]
    return table.rename(columns={"status.is_used": "used"}).assign(
        **events,
        is_final=[float(getattr(layer, "is_final", 0)) for layer in identified],
        hard_contact=[float(each.hard_contact is not None) for each in estimates],
        tissue_moves=[
            float(TissueWarning.TISSUE_MOVES in each.warnings) for each in estimates
        ],
        depth_in_tissue_m=depth_in_tissue_m,
    )


def depth_log(replay: SensorReplay) -> Log:
    """Return forces as `needleforce identify` would read them from their table."""
    columns = {
        "depth_m": "travel_m",
        "force_N": "axial_unsmoothed_N",
        "force_std_N": "axial_unsmoothed_std_N",
        "force_status": "force_status",
        "force_warnings": "force_warnings",
    }
    channels = {
        name: replay.rows[column].to_numpy() for name, column in columns.items()
    }
    return Log(t_s=replay.log.t_s, channels=channels)


def add_layers(result: Result, found: LayerReplay) -> None:
    """Add what is said of layers, and of the log that they were read from."""
    if found.layers:
        caption = "Layers traversed"
        cells = [_layer_cells(layer, found.zero) for layer in found.layers]
        result.tables[caption] = pd.DataFrame(cells)
        result.notes[caption] = _describe_zero(found.zero)
    result.sentences.append(_describe_layers(found))
    doubts = _find_tissue_doubts(found)
    result.warnings += [*doubts, *found.log.warnings, *found.warnings]
    result.units |= {unit.channel: str(unit) for unit in found.log.units}
    result.figures["layers"] = partial(draw_layers, found, result.log, "time")
    result.notes["layers"] = CAPTION
    result.settings["identification"] = METHODS[found.method]


def _layer_cells(layer: LayerEstimate, zero: DepthZero) -> dict[str, str]:
    """Return the line of a layer; ``?`` marks what is not identified.

    Times are on the log's clock.
    """
    end_mm = zero.shown_mm(layer.start_depth_m + layer.thickness_m)
    stiffness = with_std(layer.stiffness_N_per_m, layer.stiffness_std_N_per_m, 1)
    friction = with_std(layer.friction_N, layer.friction_std_N, 3)
    friction_mark = "" if layer.friction_identified else "?"
    return {
        "layer": str(layer.layer),
        "from mm": f"{zero.shown_mm(layer.start_depth_m):.1f}",
        "to mm": with_std(end_mm, zero.end_std_mm(layer), 1),
        "rupture s": f"{layer.rupture.time_s:.2f}",
        "alarm s": f"{layer.rupture.alarm_s:.2f}",
        "drop N": with_std(layer.force_drop_N, layer.force_drop_std_N, 2),
        "K N/m": stiffness + ("" if layer.stiffness_identified else "?"),
        "friction N": friction + friction_mark,
        "B Ns/m2": f"{layer.friction_Ns_per_m2:.0f}{friction_mark}",
    }


def with_std(value: float, std: float | None, digits: int) -> str:
    """Return a value with its standard deviation, where there is one."""
    text = f"{value:.{digits}f}"
    return text if std is None else f"{text}±{std:.{digits}f}"


def _describe_zero(zero: DepthZero) -> str:
    """Return in a sentence where depths count from."""
    if zero.name == LOG_ZERO:
        return f"Depths count {LOG_ZERO}."
    return (
        f"Depths are {zero.name}, {1e3 * zero.depth_m:z.1f} mm from the log's own zero."
    )


def _describe_layers(found: LayerReplay) -> str:
    """Return the ruptures found in a sentence."""
    if not found.layers:
        return "No rupture was detected."
    depths = _shown(found, [layer.rupture.depth_m for layer in found.layers])
    plural = "s" if len(found.layers) > 1 else ""
    return f"{len(found.layers)} rupture{plural} detected, {depths}."


def _find_tissue_doubts(found: LayerReplay) -> list[str]:
    """Return where something hard was met, and whether the tissue moved."""
    depths_m = found.rows.loc[found.rows["hard_contact"] > 0, "depth_m"]
    doubts = {
        f"Hard contact, as with bone, {_shown(found, depths_m)}.": len(depths_m) > 0,
        "The tissue moved and pulled at the needle: ruptures of that time are doubtful,"
        " and no layer became final.": (found.rows["tissue_moves"] > 0).any(),
    }
    return [text for text, is_seen in doubts.items() if is_seen]


def _shown(found: LayerReplay, depths_m: Iterable[float]) -> str:
    """Return depths in words, with where they count from."""
    depths = [f"{found.zero.shown_mm(depth_m):.1f} mm" for depth_m in depths_m]
    return f"{', '.join(depths)} {found.zero.name}"
