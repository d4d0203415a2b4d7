"""What a metric means, and which change of it is a change for the worse."""

import math
from dataclasses import KW_ONLY, dataclass

UNITS = {
    "_Ns_per_m": "Ns/m",
    "_Nm": "Nm",
    "_N": "N",
    "_mm": "mm",
    "_ms": "ms",
    "_pct": "%",
}
"""By the end of a metric's name; a name that ends otherwise is that of a share or a number."""


@dataclass(frozen=True, slots=True)
class Metric:
    """One kind of number.

    Attributes:
        name: As in the results; ends with its unit where it has one, see `UNITS`.
        meaning: One line.
        best: The value wished for: 0 for an error, 1 for a recall, 0.95 for a coverage.
        tolerance: Absolute worsening that is not called a regression, in the metric's unit.
        relative_tolerance: The same as a share of the old distance from ``best``; the larger of
            the two counts.
    """

    name: str
    meaning: str
    _: KW_ONLY
    best: float = 0.0
    tolerance: float = 0.0
    relative_tolerance: float = 0.05

    @property
    def unit(self) -> str:
        """As in the results; ``1`` for none."""
        return next((unit for end, unit in UNITS.items() if self.name.endswith(end)), "1")

    def worsening(self, old: float, new: float) -> float:
        """How much farther from ``best`` the new value is; negative when it is nearer."""
        return abs(new - self.best) - abs(old - self.best)

    def is_regression(self, old: float, new: float) -> bool:
        """Whether the new value is worse beyond tolerance; a number that is not finite always."""
        if not (math.isfinite(old) and math.isfinite(new)):
            return not math.isfinite(new)
        allowed = max(self.tolerance, self.relative_tolerance * abs(old - self.best))
        return self.worsening(old, new) > allowed


def yardstick(name: str, meaning: str) -> Metric:
    """A number to lay beside others, by which nothing is judged: it may double unnoticed."""
    return Metric(name, meaning, relative_tolerance=1.0)
