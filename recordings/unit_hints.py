"""Values that suggest that a file is not in SI units although nothing in it says so."""

from collections.abc import Mapping

import numpy as np

from recordings.table import FloatArray

# Beyond these an SI value is implausible for a robot or a needle: two turns of a joint,
# a needle of a metre. For time it is the median step: ten samples a second are not a force log.
_LIMITS = {
    "t_s": ("time", 0.1, "ms"),
    "q_rad": ("q", 4.0 * np.pi, "deg"),
    "depth_m": ("depth", 1.0, "mm"),
    "speed_m_s": ("speed", 1.0, "mm/s"),
}


def unit_hints(channels: Mapping[str, FloatArray]) -> tuple[str, ...]:
    """Return a warning for each channel that looks as if it were not in SI units.

    Args:
        channels: channels whose unit was assumed, by their key in a `Log`, converted as assumed.

    Returns:
        The warnings; empty if all is plausible.
    """
    warnings = []
    for key, values in channels.items():
        if key not in _LIMITS:
            continue
        name, limit, unit = _LIMITS[key]
        size = _size(key, values)
        if size > limit:
            what = "its median step" if key == "t_s" else "it"
            warnings.append(
                f"{name}: {what} reaches {size:.4g} in SI; if the file is in {unit}, "
                f"say unit = {unit!r}"
            )
    return tuple(warnings)


def _size(key: str, values: FloatArray) -> float:
    finite = values[np.isfinite(values)]
    if key == "t_s":
        finite = np.diff(finite)
        return float(np.median(np.abs(finite))) if finite.size else 0.0
    return float(np.max(np.abs(finite), initial=0.0))
