"""Values that suggest that a file is not in SI units although nothing in it says so."""

from collections.abc import Mapping

import numpy as np

from recordings.tables.table import FloatArray

# Beyond these an SI value is implausible for a robot or a needle: two turns of a joint,
# a needle of a metre, a force that buckles any needle. For time it is the median step: ten
# samples a second are not a force log.
_LIMITS = {
    "t_s": ("time", 0.1, "ms"),
    "q_rad": ("q", 4.0 * np.pi, "deg"),
    "depth_m": ("depth", 1.0, "mm"),
    "speed_m_s": ("speed", 1.0, "mm/s"),
    "force_N": ("force", 200.0, "mN"),
}
# Steps of so many units belong to logs between 10 Hz and 10 kHz.
_STEPS = ((1e5, "ns"), (200.0, "us"))


class UnitWatch:
    """Looks at channels whose unit was assumed, however many rows come at a time."""

    def __init__(self) -> None:
        self._sizes: dict[str, float] = {}
        self._told: set[str] = set()

    def update(self, channels: Mapping[str, FloatArray]) -> None:
        """Take rows; the step of time is that of the first ones.

        Args:
            channels: by their key in a `Log`, converted as assumed.
        """
        for key, values in channels.items():
            if key == "t_s":
                self._sizes.setdefault(key, _median_step(values))
            elif key in _LIMITS:
                largest = float(np.max(np.abs(values[np.isfinite(values)]), initial=0.0))
                self._sizes[key] = max(largest, self._sizes.get(key, 0.0))

    def news(self) -> tuple[str, ...]:
        """Return a warning for each channel that looks as if it were not in SI units; each once."""
        warnings = []
        for key, size in self._sizes.items():
            name, limit, unit = _LIMITS[key]
            if key == "t_s":
                unit = next((u for least, u in _STEPS if size >= least), unit)
            if size > limit and key not in self._told:
                self._told.add(key)
                what = "its median step" if key == "t_s" else "it"
                warnings.append(
                    f"{name}: {what} reaches {size:.4g} in SI; if the file is in {unit}, "
                    f"say unit = {unit!r}, or --{name} COLUMN:{unit}"
                )
        return tuple(warnings)


def unit_hints(channels: Mapping[str, FloatArray]) -> tuple[str, ...]:
    """Return a warning for each channel of a whole log that hardly is in SI units.

    Args:
        channels: channels whose unit was assumed, by their key in a `Log`, converted as assumed.

    Returns:
        The warnings; empty if all is plausible.
    """
    watch = UnitWatch()
    watch.update(channels)
    return watch.news()


def _median_step(t_s: FloatArray) -> float:
    steps = np.diff(t_s[np.isfinite(t_s)])
    return float(np.median(np.abs(steps))) if steps.size else 0.0
