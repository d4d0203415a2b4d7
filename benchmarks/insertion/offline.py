"""What the models can explain of an insertion when it is over."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import median_filter

from benchmarks.insertion.signals import InsertionTruth, NeedleSignal
from identification import LayerSpan, OfflineIdentification, identify_offline
from identification.config import Model

SPEED_WINDOW_s = 0.2
"""Over which the median of the speed is taken, centred, as one may offline: the models
are judged, not the noise of an arm's velocity, which B Δz would turn into force."""


def offline_metrics(signal: NeedleSignal, truth: InsertionTruth) -> dict[str, float]:
    """Return the rms residual of each model [N], as in Figures 2 and 3."""
    models: tuple[Model, ...] = ("ml", "kv")
    return {f"offline_rmse_{m}_N": offline_fit(signal, truth, m).rmse_N for m in models}


def offline_fit(
    signal: NeedleSignal, truth: InsertionTruth, model: Model = "ml"
) -> OfflineIdentification:
    """Fit equation (6) to the insertion, from contact to the deepest point."""
    inside = truth.is_insertion
    depth_m = signal.depth_m - np.interp(truth.contact_s, truth.t_s, signal.depth_m)
    return identify_offline(
        truth.t_s[inside],
        depth_m[inside],
        quiet_speed_m_s(signal)[inside],
        signal.force_N[inside],
        layer_spans(truth),
        model,
    )


def quiet_speed_m_s(signal: NeedleSignal) -> NDArray[np.float64]:
    """Return the speed without its noise, its steps as they are, shape (n,)."""
    samples = max(round(SPEED_WINDOW_s / float(np.median(np.diff(signal.t_s)))), 1)
    assert signal.speed_m_s is not None, "an arm or a motion gives the speed"
    return median_filter(signal.speed_m_s, samples + 1 - samples % 2, mode="nearest")


def layer_spans(truth: InsertionTruth) -> list[LayerSpan]:
    """Return the spans from contact to the first rupture, and from each to the next.

    A membrane on the surface thus has a span of its own, the fictitious layer of
    Section III-B. A layer that the tip is still in at the deepest point ends there.
    """
    inside = truth.is_insertion
    last_sample = int(np.flatnonzero(inside)[-1])
    # An arm that lags may break through after its path has ended: that is not in the
    # data.
    inside_ruptures = [
        rupture
        for rupture in truth.ruptures
        if rupture.onset_s < truth.t_s[last_sample]
    ]
    ends = [(rupture.onset_s, rupture.onset_m) for rupture in inside_ruptures]
    if truth.layer[last_sample] <= truth.layer_friction_N.shape[1]:
        ends.append((float(truth.t_s[last_sample]), float(truth.depth_m[inside].max())))
    starts = [(truth.contact_s, 0.0), *ends[:-1]]
    return [
        LayerSpan(
            start_s=start_s,
            start_depth_m=start_m,
            thickness_m=end_m - start_m,
            rupture_s=end_s,
        )
        for (start_s, start_m), (end_s, end_m) in zip(starts, ends, strict=True)
    ]
