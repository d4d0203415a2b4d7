"""Rows of results as a pandas frame, and what several runs are summed up to."""

from collections.abc import Iterable, Mapping
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from benchmarks.campaign.intervals import INTERVAL_SEED, interval
from benchmarks.results import METRICS, NAMES, Row

NOTHING = "–"
"""In a cell: there is no such number."""
NOT_FINITE = "not finite"
"""In a cell: a number that should be one is none."""
CUMULATIVE = "cumulative_friction_{}_Ns_per_m"
"""Metric of the cumulative friction of a gel, by how it was identified."""
Frame = Any
"""A pandas.DataFrame with the columns of `Row`; its annotations leave open what a
selection is."""
KEYS = NAMES[:6]
"""Columns of a frame that tell one number from another."""
FORCE_ERROR = "wrench_rmse_N"


def frame_of(rows: Iterable[Row]) -> Frame:
    """Return rows as a frame, with the ratios that tables show as further metrics."""
    rows = list(rows)
    columns = {name: [getattr(row, name) for row in rows] for name in NAMES}
    frame = pd.DataFrame(columns, dtype=None if rows else object)
    ours = {"metric": FORCE_ERROR, "source": "virtual", "method": "ours"}
    published = ours | {"method": "published-one-setting"}
    best_gain = ours | {"method": "published-best-gain"}
    online = {"metric": CUMULATIVE.format("online")}
    offline = {"metric": CUMULATIVE.format("offline")}
    change = ratio_of(frame, "online_change", online, offline)
    return pd.concat(
        [
            frame,
            ratio_of(frame, "wrench_rmse_ratio", ours, published),
            ratio_of(frame, "wrench_best_K_ratio", ours, best_gain),
            change.assign(value=change["value"] - 1.0),
        ]
    )


def ratio_of(
    frame: Frame,
    name: str,
    numerator: Mapping[str, str],
    denominator: Mapping[str, str],
) -> Frame:
    """Return rows of a new metric: one selection over another, run by run."""
    keys = [key for key in KEYS if key not in numerator]
    values = {
        place: select(frame, **selection).set_index(keys)["value"]
        for place, selection in (("top", numerator), ("bottom", denominator))
    }
    pairs: Frame = pd.concat(values, axis=1, join="inner")
    pairs = pairs[pairs["bottom"] != 0.0].copy()
    pairs["value"] = pairs["top"] / pairs["bottom"]
    fixed = dict(numerator) | {"metric": name}
    return pairs.reset_index().assign(**fixed)[[*KEYS, "value"]]


def select(frame: Frame, **wanted: str | None) -> Frame:
    """Return the rows whose columns have these values; None for any."""
    for name, value in wanted.items():
        if value is not None:
            frame = frame[frame[name] == value]
    return frame


class Format(NamedTuple):
    """How several runs are summed up in a cell.

    Attributes:
        form: Format of a number, such as ``.3f``.
        scale: Factor on the values.
        is_fraction: Show mean and least, not median and worst.
        has_interval: Show how well the middle is known too.
    """

    form: str = ""
    scale: float = 1.0
    is_fraction: bool = False
    has_interval: bool = False


def summarize(rows: Frame, shown: Format) -> str:
    """Return one value as it is; of several the middle, and in brackets the worst.

    The middle is the median and the worst the farthest from the best value; of
    fractions it is the mean, and the worst the least.
    """
    known = METRICS.get(rows["metric"].iloc[0]) if len(rows) else None
    if known is not None and known.may_be_undefined:
        rows = rows.dropna(subset="value")
    values = rows["value"] * shown.scale
    if values.empty:
        return NOTHING
    if not np.isfinite(values).all():
        return NOT_FINITE
    form = shown.form
    if len(values) == 1:
        return format(values.iloc[0], form)
    if shown.is_fraction:
        middle = values.mean()
        worst = values.min()
    else:
        best = 0.0 if known is None else known.best
        middle = values.median()
        worst = values.iloc[int((values - best).abs().argmax())]
    bounds = ""
    if shown.has_interval and values.nunique() > 1:
        rng = np.random.default_rng(INTERVAL_SEED)
        low, high = interval(values, rows["seed"], rng, is_mean=shown.is_fraction)
        bounds = f"[{low:{form}}, {high:{form}}] "
    return f"{middle:{form}} {bounds}({worst:{form}})"
