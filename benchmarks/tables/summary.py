"""Several runs in one cell of a table."""

import math
import statistics
from collections.abc import Sequence

NOTHING = "–"
BAD = "[red]not finite[/red]"


def summary(values: Sequence[float], form: str, best: float = 0.0) -> str:
    """One value as it is; of more the median, and in brackets the one farthest from the best.

    Args:
        values: Of the runs.
        form: Format of a number, such as ``.3f``.
        best: The value wished for.
    """
    if not values:
        return NOTHING
    if not all(map(math.isfinite, values)):
        return BAD
    middle = format(statistics.median(values), form)
    if len(values) == 1:
        return middle
    worst = max(values, key=lambda value: abs(value - best))
    return f"{middle} ({worst:{form}})"
