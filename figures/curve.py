"""One line of a panel."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from figures.errors import ChartError
from figures.line_style import LineStyle

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Curve:
    """One line of a panel; nothing is drawn where a value is not finite.

    Attributes:
        style: How it is drawn.
        x: Places, shape (n,), read-only.
        y: Values, shape (n,), read-only.
        label: In the legend; None for none there.
        std: Standard deviations, shape (n,): a band of two is shaded. None for no band.
        band_label: Of the band in the legend; None for none there.
    """

    style: LineStyle
    x: Array
    y: Array
    label: str | None = None
    std: Array | None = None
    band_label: str | None = None

    def __post_init__(self) -> None:
        """Keep read-only copies.

        Raises:
            ChartError: x, y and std do not go together.
        """
        for name in ("x", "y", "std"):
            value = getattr(self, name)
            if value is None:
                continue
            array = np.array(value, dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)
            if array.ndim != 1 or array.shape != self.x.shape:
                raise ChartError(
                    f"curve {self.label!r}: {name} has shape {array.shape} where x has "
                    f"{self.x.shape}; give one value per point"
                )
