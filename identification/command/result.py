"""What the command found out, for the table of layers, pictures and reports."""

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from identification.command.log_clock import LogClock
from identification.estimate import LayerEstimate


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class IdentificationResult:
    """The outcome of a whole log, of bounded size however long the log.

    Attributes:
        log: What the log is called.
        method: One of ``--method``.
        layers: Layers left, as known at the end.
        clock: From times of `layers` to the log's clock.
        ruptures_s: Times of the ruptures on the log's clock, as dated [s]; the latest ones.
        compensations_s: Times on that clock at which a layer's friction was identified [s].
        warnings: What was told about the log and its signs.
        overview: So many rows as a picture needs, with `force_N` and the columns of
            `estimate_table`; all rows of a short log, of a long one those in which a value is
            least or largest for a while. Empty if it was not asked for.
    """

    log: str
    method: str
    layers: tuple[LayerEstimate, ...]
    clock: LogClock
    ruptures_s: tuple[float, ...]
    compensations_s: tuple[float, ...]
    warnings: tuple[str, ...]
    overview: Mapping[str, NDArray[np.float64]]
