"""A whole recording through the online identifier."""

from collections import Counter
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from identification.config import MULTILAYER, MultilayerConfig, PublishedConfig
from identification.estimate import Estimate, LayerEstimate
from identification.identifier import Identifier
from identification.input_validation import SampleStatus
from identification.offline import read_column

Array = NDArray[np.float64]

_WINDOW_S = 0.05
_MOST_ROWS = 5000
_GAP_S = 0.25
"""What happened in a longer step says little about the rows beside it."""
_LITTLE_S = 1e-9


class DerivedSpeed:
    """Change of depth over time, centred over 50 ms; rows wait for the half window after them.

    Only rows whose stamps advance count: where several rows have one stamp, the first of them.
    The others get the speed of the row that advanced before them. However many rows come at a
    time, the numbers are the same, bit for bit.

    Args:
        step_s: Usual step of the stamps that advance [s], > 0; at most 100 kHz are smoothed so
            long.
    """

    def __init__(self, step_s: float) -> None:
        self._width = min(max(round(_WINDOW_S / step_s), 1), _MOST_ROWS)
        self._depth_m = np.empty(0)
        self._is_padded = False
        # Steps of time and changes of depth up to rows that advance.
        self._steps = np.empty((2, 0))
        # Of every row that waits, which one advanced last, counted from the first unknown speed.
        self._owners = np.empty(0, dtype=np.int64)
        self._advanced = 0
        self._speed_m_s = 0.0

    def update(self, dt_s: Array, depth_m: Array) -> Array:
        """Take further rows.

        Args:
            dt_s: Time since the latest row that advanced [s], shape (n,), n > 0; not positive for
                rows that do not advance. That of the very first row is not read.
            depth_m: Depth [m], shape (n,).

        Returns:
            Speeds [m/s] of the rows that need wait no longer, beginning with the first that has
            not been returned, shape (m,).
        """
        advances = dt_s > 0.0
        is_first = not self._depth_m.size
        advances[0] |= is_first
        self._owners = np.concatenate((self._owners, self._advanced - 1 + np.cumsum(advances)))
        self._advanced += int(np.count_nonzero(advances))
        depths = np.concatenate((self._depth_m, depth_m[advances]))
        steps = np.stack((dt_s[advances][1:] if is_first else dt_s[advances], np.diff(depths)))
        self._depth_m = depths[-1:]
        if steps.size and not self._is_padded:
            # The first row has no step before it: it takes the second's, as do those before it.
            self._is_padded = True
            steps = np.hstack((np.repeat(steps[:, :1], self._width // 2 + 1, axis=1), steps))
        self._steps = np.hstack((self._steps, steps))
        return self._known(self._means())

    def finish(self) -> Array:
        """Return the speeds of the rows that still waited [m/s], shape (m,)."""
        if not self._is_padded:
            return np.zeros(len(self._owners))
        after = self._width - 1 - self._width // 2
        last = np.repeat(self._steps[:, -1:], after, axis=1)
        self._steps = np.hstack((self._steps, last))
        return self._known(self._means())

    def _known(self, means: Array) -> Array:
        """Speeds of the rows whose last advancing row is among those of the means, or before."""
        speeds = np.concatenate(([self._speed_m_s], means))
        is_known = self._owners < len(means)
        known = speeds[self._owners[is_known] + 1]
        self._owners = self._owners[~is_known] - len(means)
        self._advanced -= len(means)
        self._speed_m_s = float(speeds[-1])
        return known

    def _means(self) -> Array:
        """Known changes of depth over their time, in every whole window."""
        rows = self._steps.shape[1] - self._width + 1
        if rows <= 0:
            return np.empty(0)
        dt_s, change_m = self._steps
        weights = np.where(np.isfinite(change_m), np.where(dt_s > _GAP_S, _LITTLE_S, dt_s), 0.0)
        changes = np.where(weights > 0.0, change_m * (weights / dt_s), 0.0)
        total, time_s = np.zeros(rows), np.zeros(rows)
        # In this order for every row, so that rounding does not depend on how rows came.
        for k in range(self._width):
            total += changes[k : k + rows]
            time_s += weights[k : k + rows]
        self._steps = self._steps[:, rows:]
        return np.divide(total, time_s, out=np.full(rows, np.nan), where=time_s > 0.0)


_LEAST_TRAVEL_M = 1e-3
_LARGEST_DEPTH_M = 1.0
_LEAST_FORCE_N = 0.02


class SignCheck:
    """Looks for a flipped sign or a wrong unit in a recording, any number of rows at a time."""

    def __init__(self) -> None:
        self._last_m = np.empty(0)
        self._deepest_m, self._least_m = -np.inf, np.inf
        self._start_m: float | None = None
        self._pushed_Nm = self._fresh_m = self._agreement = 0.0
        self._least_N, self._largest_N = np.inf, -np.inf

    def update(self, depth_m: Array, speed_m_s: Array | None, force_N: Array) -> None:
        """Take further rows: columns of shape (n,), with gaps; a speed if one was recorded."""
        before = self._last_m if self._last_m.size else depth_m[:1]
        change = np.diff(depth_m, prepend=before)
        self._last_m = depth_m[-1:]
        good = np.isfinite(change) & np.isfinite(force_N)
        change, force = np.where(good, change, 0.0), np.where(good, force_N, 0.0)
        known = depth_m[np.isfinite(depth_m)]
        if known.size:
            self._start_m = float(known[0]) if self._start_m is None else self._start_m
            self._least_m = min(self._least_m, float(known.min()))
        depth = np.where(np.isfinite(depth_m), depth_m, -np.inf)
        deepest = np.maximum.accumulate(np.concatenate(([self._deepest_m], depth)))
        fresh = change * ((change > 0.0) & (depth >= deepest[1:]))
        self._deepest_m = float(deepest[-1])
        self._pushed_Nm += float((force * fresh).sum())
        self._fresh_m += float(fresh.sum())
        self._least_N = min(self._least_N, float(force.min()))
        self._largest_N = max(self._largest_N, float(force.max()))
        if speed_m_s is not None:
            self._agreement += float(np.nansum(change * speed_m_s))

    def hints(self) -> tuple[str, ...]:
        """One sentence per suspicion; none for a recording that looks right."""
        hints = []
        start = self._start_m
        span = 0.0 if start is None else self._deepest_m - self._least_m
        if span > _LARGEST_DEPTH_M:
            hints.append(f"depth spans {span:.3g} m; is it in millimetres?")
        if start is None or span < _LEAST_TRAVEL_M:
            still = f"depth moves by {span * 1e3:.3g} mm only; there is nothing to identify"
            return (*hints, still)
        if self._fresh_m > 0.0 and self._pushed_Nm / self._fresh_m < -_LEAST_FORCE_N:
            hints.append(
                "the force is negative while the needle goes in; it must be positive when tissue "
                "pushes back: flip its sign"
            )
        if start - self._least_m > 0.7 * span and self._largest_N > self._least_N:
            hints.append(
                "depth falls before it rises; it must grow into the tissue: flip its sign?"
            )
        if self._agreement < 0.0:
            hints.append("speed has the sign opposite to the change of depth: flip one of them")
        return tuple(hints)


_REPORTED = (
    SampleStatus.FORCE_RANGE,
    SampleStatus.MOTION_RANGE,
    SampleStatus.DEPTH_JUMP,
    SampleStatus.SPEED_SIGN,
)
"""What nobody has reported of a row before; who read the log has reported a NaN or a late stamp."""

HEAD_ROWS = 200
"""The usual time step is the median over so many first rows."""


class ReplayedRows(NamedTuple):
    """Consecutive rows with their estimates."""

    t_s: Array  # Time stamps [s], shape (n,)
    force_N: Array  # Axial force as recorded [N], shape (n,)
    estimates: list[Estimate]  # One per row


class ReplayStream:
    """Runs the identifier over a recording; results do not depend on how the rows come.

    Estimates, ruptures and layers are on the clock of the recording.

    Args:
        config: `MULTILAYER`, `PUBLISHED` or a variant.
    """

    def __init__(self, config: MultilayerConfig | PublishedConfig = MULTILAYER) -> None:
        self._identifier = Identifier(config)
        self._signs = SignCheck()
        self._speed: DerivedSpeed | None = None
        self._first_step_s = 0.0
        self._latest_s: float | None = None
        self._waiting = np.empty((4, 0))
        self._rejected: Counter[SampleStatus] = Counter()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers left so far, in order, as known now."""
        return self._identifier.layers

    @property
    def hints(self) -> tuple[str, ...]:
        """Suspicions about signs and units of all rows so far, and how many were rejected."""
        rejected = (
            f"rows that were rejected: {self._rejected[status]} ({status.value})"
            for status in _REPORTED
            if self._rejected[status]
        )
        return (*self._signs.hints(), *rejected)

    def run(
        self,
        t_s: Array,
        depth_m: Array,
        force_N: Array,
        speed_m_s: Array | None = None,
        dt_s: Array | None = None,
    ) -> ReplayedRows:
        """Take further rows, as `replay` takes them all.

        The first call must bring `HEAD_ROWS` rows, or all that there are. Without speed, always or
        never, rows wait 25 ms for it. The very first ``dt_s`` is not read.

        Returns:
            The rows whose speed is known, beginning with the first that has not been returned.
        """
        dt_s = self._since_latest(t_s) if dt_s is None else np.array(dt_s)
        if not self._first_step_s:
            self._begin(dt_s[1:HEAD_ROWS], is_derived=speed_m_s is None)
            dt_s[0] = self._first_step_s
        self._signs.update(depth_m, speed_m_s, force_N)
        self._waiting = np.hstack((self._waiting, np.stack((t_s, depth_m, force_N, dt_s))))
        if self._speed is None:
            assert speed_m_s is not None
            return self._replayed(speed_m_s)
        return self._replayed(self._speed.update(dt_s, depth_m))

    def finish(self) -> ReplayedRows:
        """Return the rows that still waited for what would come after them."""
        return self._replayed(np.empty(0) if self._speed is None else self._speed.finish())

    def _since_latest(self, t_s: Array) -> Array:
        """Time since the latest stamp before each row, not positive where time does not advance."""
        latest_s = t_s[0] if self._latest_s is None else self._latest_s
        # A stamp that is no number spoils its own row only.
        latest_s = np.fmax.accumulate(np.concatenate(([latest_s], t_s)))
        self._latest_s = float(latest_s[-1])
        return t_s - latest_s[:-1]

    def _begin(self, steps_s: Array, *, is_derived: bool) -> None:
        forward = steps_s[steps_s > 0.0]
        self._first_step_s = float(np.median(forward)) if forward.size else 1e-3
        if is_derived:
            self._speed = DerivedSpeed(self._first_step_s)

    def _replayed(self, speed_m_s: Array) -> ReplayedRows:
        rows = len(speed_m_s)
        t_s, depth_m, force_N, dt_s = self._waiting[:, :rows]
        self._waiting = self._waiting[:, rows:]
        columns = (depth_m, speed_m_s, force_N, dt_s, t_s)
        estimates = list(map(self._identifier.update, *(column.tolist() for column in columns)))
        self._rejected.update(estimate.status for estimate in estimates)
        return ReplayedRows(t_s, force_N, estimates)


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
    config: MultilayerConfig | PublishedConfig = MULTILAYER,
    *,
    dt_s: ArrayLike | None = None,
) -> Replay:
    """Run the identifier over a recording, sample by sample.

    Rows that cannot be used (gaps, time running backwards) are reported in their estimate's
    status, not dropped. Where a clock may have been set, give ``dt_s``. Estimates, ruptures and
    layers are on the clock of ``t_s`` and count depth from the zero of ``depth_m``.

    Args:
        t_s: Time stamps [s], shape (n,).
        depth_m: Tip depth, growing into the tissue [m], shape (n,).
        force_N: Axial force, positive when tissue pushes back [N], shape (n,).
        speed_m_s: Rate of depth [m/s]; differentiated from depth if None.
        config: `MULTILAYER`, `PUBLISHED` or a variant.
        dt_s: Time since the latest row that advanced [s], shape (n,), not positive for a row that
            does not; None to count from the latest stamp.

    Raises:
        InvalidLogError: Empty or ragged columns.
    """
    t = read_column("t_s", t_s)
    z, f = read_column("depth_m", depth_m, len(t)), read_column("force_N", force_N, len(t))
    v = None if speed_m_s is None else read_column("speed_m_s", speed_m_s, len(t))
    steps = None if dt_s is None else read_column("dt_s", dt_s, len(t))
    stream = ReplayStream(config)
    estimates = stream.run(t, z, f, v, steps).estimates + stream.finish().estimates
    t.setflags(write=False)
    return Replay(t_s=t, estimates=tuple(estimates), layers=stream.layers, hints=stream.hints)
