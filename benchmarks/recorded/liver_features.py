"""What an insertion into liver shows by the time a depth is reached, for a regression."""

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from benchmarks.recorded.force_falls import force_falls
from benchmarks.recorded.pullout import mean_at_depth

Array = NDArray[np.float64]

STEP_m = 0.25e-3
FIRST_m = 1e-3
SMOOTHING = 41
FINE = 51
LEAST = 1e-2
"""Features of force enter as logarithms; below 10 mN they are noise."""
EARLY_mm = (5, 10, 20)
RECENT_mm = (5, 10, 20)


def liver_features(depth_m: Array, force_N: Array, at_m: float, told_N: float) -> dict[str, float]:
    """Features by name; forces as logarithms.

    Args:
        depth_m: Depth of the advancing needle, shape (n,).
        force_N: Axial force as recorded, shape (n,).
        at_m: Nothing deeper is looked at.
        told_N: Friction that our identification tells there.
    """
    depth = np.arange(FIRST_m, at_m + STEP_m / 2.0, STEP_m)
    smooth = uniform_filter1d(force_N, SMOOTHING)
    force = np.interp(depth, np.maximum.accumulate(depth_m), smooth)
    found = {
        "force": mean_at_depth(depth_m, force_N, at_m),
        "half": float(np.interp(at_m / 2.0, depth, force)),
        "mean": float(force.mean()),
        "most": float(force.max()),
        "friction told": told_N,
    }
    for mm in EARLY_mm:
        found[f"force at {mm} mm"] = float(np.interp(1e-3 * mm, depth, force))
    for mm in RECENT_mm:
        found[f"least of {mm} mm"] = float(force[depth > at_m - 1e-3 * mm].min())
    found = {name: float(np.log(max(value, LEAST))) for name, value in found.items()}
    return {"depth": at_m} | found | _shape(depth, force) | _falls(depth_m, force_N, at_m)


def _shape(depth_m: Array, force_N: Array) -> dict[str, float]:
    """Lines through the force and through its lower envelope, and what they leave."""
    envelope = np.minimum.accumulate(force_N[::-1])[::-1]
    slope, level = np.polyfit(depth_m, force_N, 1)
    low_slope, low_level = np.polyfit(depth_m, envelope, 1)
    end = depth_m[-1]
    return {
        "line": float(np.log(max(level + slope * end, LEAST))),
        "envelope line": float(np.log(max(low_level + low_slope * end, LEAST))),
        "envelope mean": float(np.log(max(envelope.mean(), LEAST))),
        "slope": float(slope),
        "envelope slope": float(low_slope),
        "usual slope": float(np.median(np.gradient(force_N, depth_m))),
        "roughness": float(np.std(force_N - level - slope * depth_m)),
    }


def _falls(depth_m: Array, force_N: Array, at_m: float) -> dict[str, float]:
    """Falls so far, and the vibration of cutting."""
    drops = [fall.drop_N for fall in force_falls(depth_m, force_N) if fall.to_m <= at_m]
    fine = force_N - uniform_filter1d(force_N, FINE)
    return {
        "falls": float(len(drops)),
        "fallen": float(sum(drops)),
        "largest fall": float(max(drops, default=0.0)),
        "vibration": float(np.std(fine[depth_m <= at_m])),
    }
