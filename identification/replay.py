"""A whole recording through the online identifier."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.default_config import DEFAULT, DefaultConfig
from identification.estimate import Estimate, LayerEstimate
from identification.log_column import read_column
from identification.paper_config import PaperConfig
from identification.replay_stream import ReplayStream

_ROWS = 1000


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """Online estimates of a recording.

    Attributes:
        t_s: Time stamps of the recording, shape (n,), read-only.
        estimates: One per row.
        layers: Layers left, as known at the end.
        hints: Suspicions about signs and units.
    """

    t_s: NDArray[np.float64]
    estimates: tuple[Estimate, ...]
    layers: tuple[LayerEstimate, ...]
    hints: tuple[str, ...]


def replay(
    t_s: ArrayLike,
    depth_m: ArrayLike,
    force_N: ArrayLike,
    speed_m_s: ArrayLike | None = None,
    config: DefaultConfig | PaperConfig = DEFAULT,
    *,
    dt_s: ArrayLike | None = None,
) -> Replay:
    """Run the identifier over a recording, sample by sample.

    Rows that cannot be used (gaps, time running backwards) are reported in their estimate's
    status, not dropped. Where a clock may have been set, let
    `recordings.clock.row_clock.RowClock` tell ``dt_s``.

    Args:
        t_s: Time stamps [s], shape (n,).
        depth_m: Tip depth, growing into the tissue [m], shape (n,).
        force_N: Axial force, positive when tissue pushes back [N], shape (n,).
        speed_m_s: Rate of depth [m/s]; differentiated from depth if None.
        config: `DEFAULT`, `PAPER` or a variant.
        dt_s: Time since the latest row that advanced [s], shape (n,), not positive for a row that
            does not; None to count from the latest stamp.

    Raises:
        InvalidLogError: Empty or ragged columns.
    """
    t = read_column("t_s", t_s)
    z, f = read_column("depth_m", depth_m, len(t)), read_column("force_N", force_N, len(t))
    v = None if speed_m_s is None else read_column("speed_m_s", speed_m_s, len(t))
    steps = None if dt_s is None else read_column("dt_s", dt_s, len(t))
    stream, estimates = ReplayStream(config), []
    for start in range(0, len(t), _ROWS):
        part = slice(start, start + _ROWS)
        rows = (None if column is None else column[part] for column in (v, steps))
        estimates += stream.run(t[part], z[part], f[part], *rows).estimates
    estimates += stream.finish().estimates
    t.setflags(write=False)
    return Replay(t_s=t, estimates=tuple(estimates), layers=stream.layers, hints=stream.hints)
