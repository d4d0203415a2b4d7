"""What a metric means, and which change of it is a change for the worse."""

import math
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Metric:
    """One kind of number.

    Attributes:
        name: As in the results; ends with its unit where it has one.
        unit: As in the results.
        meaning: One line.
        best: The value wished for: 0 for an error, 1 for a recall, 0.95 for a coverage.
        tolerance: Absolute worsening that is not called a regression, in the metric's unit.
        relative_tolerance: The same as a share of the old distance from ``best``; the larger of
            the two counts.
    """

    name: str
    unit: str
    meaning: str
    best: float = 0.0
    tolerance: float = 0.0
    relative_tolerance: float = 0.05

    def worsening(self, old: float, new: float) -> float:
        """How much farther from ``best`` the new value is; negative when it is nearer."""
        return abs(new - self.best) - abs(old - self.best)

    def is_regression(self, old: float, new: float) -> bool:
        """Whether the new value is worse beyond tolerance; a number that is not finite always."""
        if not (math.isfinite(old) and math.isfinite(new)):
            return not math.isfinite(new)
        allowed = max(self.tolerance, self.relative_tolerance * abs(old - self.best))
        return self.worsening(old, new) > allowed
