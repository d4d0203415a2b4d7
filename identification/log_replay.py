"""A whole recording through the online identifier."""

from collections import Counter
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from numpy.typing import ArrayLike

from foundation.advice import Message
from identification.advice import SignAdvice
from identification.config import MULTILAYER, MultilayerConfig, PublishedConfig
from identification.estimate import Array, Estimate, LayerEstimate, SampleStatus
from identification.identifier import Identifier
from identification.published.offline import read_column

_LEAST_TRAVEL_M = 1e-3
_LARGEST_DEPTH_M = 1.0
_LEAST_FORCE_N = 0.02
_LEAST_GAP_S = 0.25


class SignCheck:
    """Checks for a flipped sign or a wrong unit in a recording, any number of rows
    at a time.
    """

    def __init__(self) -> None:
        self._last_m = np.empty(0)
        self._deepest_m = -np.inf
        self._least_m = np.inf
        self._start_m: float | None = None
        self._pushed_Nm = self._fresh_m = self._agreement = 0.0
        self._least_N = np.inf
        self._largest_N = -np.inf

    def update(self, depth_m: Array, speed_m_s: Array | None, force_N: Array) -> None:
        """Take further rows: columns of shape (n,), with gaps; a speed if one was
        recorded.
        """
        before = self._last_m if self._last_m.size else depth_m[:1]
        change = np.diff(depth_m, prepend=before)
        self._last_m = depth_m[-1:]
        good = np.isfinite(change) & np.isfinite(force_N)
        change = np.where(good, change, 0.0)
        force = np.where(good, force_N, 0.0)
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
            self._agreement += float(
                change @ np.where(np.isfinite(speed_m_s), speed_m_s, 0.0)
            )

    def hints(self) -> tuple[str, ...]:
        """One sentence per suspicion; none for a recording that looks right."""
        hints: list[str] = []
        start = self._start_m
        span = 0.0 if start is None else self._deepest_m - self._least_m
        if span > _LARGEST_DEPTH_M:
            hints.append(f"depth spans {span:.3g} m; is it in millimetres?")
        if start is None or span < _LEAST_TRAVEL_M:
            still = (
                f"depth moves by {span * 1e3:.3g} mm only; there is nothing to identify"
            )
            return (*hints, still)
        if self._fresh_m > 0.0 and self._pushed_Nm / self._fresh_m < -_LEAST_FORCE_N:
            hints.append(
                Message(
                    "the force is negative while the needle goes in; it must be positive "
                    "when tissue pushes back: ",
                    SignAdvice.FLIP_FORCE,
                )
            )
        if start - self._least_m > 0.7 * span and self._largest_N > self._least_N:
            hints.append(
                Message(
                    "depth falls before it rises; it must grow into the tissue: ",
                    SignAdvice.FLIP_DEPTH,
                )
            )
        if self._agreement < 0.0:
            hints.append(
                Message(
                    "speed has the sign opposite to the change of depth: ",
                    SignAdvice.FLIP_SPEED,
                )
            )
        return tuple(hints)


_REPORTED = (
    SampleStatus.FORCE_RANGE,
    SampleStatus.MOTION_RANGE,
    SampleStatus.DEPTH_JUMP,
    SampleStatus.SPEED_SIGN,
    SampleStatus.TIME_RANGE,
)
"""What nobody has reported of a row before; who read the log has reported a NaN or a
late stamp."""

HEAD_ROWS = 200  # the usual time step is the median over so many first rows


class ReplayStream:
    """Runs the identifier over a recording; results do not depend on how the rows come.

    Estimates, ruptures and layers are on the clock of the recording.

    Args:
        config: `MULTILAYER`, `PUBLISHED` or a variant.
    """

    def __init__(self, config: MultilayerConfig | PublishedConfig = MULTILAYER) -> None:
        self._identifier = Identifier(config)
        self._signs = SignCheck()
        # 0 s until rows have come
        self._gap_s = 0.0
        self._gaps = 0
        self._rejected: Counter[SampleStatus] = Counter()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        return self._identifier.layers

    @property
    def hints(self) -> tuple[str, ...]:
        """Suspicions about signs and units of all rows so far, how many were
        rejected, and gaps.
        """
        rejected = (
            f"rows that were rejected: {self._rejected[status]} ({status.value})"
            for status in _REPORTED
            if self._rejected[status]
        )
        gaps = f"gaps in time longer than {self._gap_s:.3g} s: {self._gaps}; predictions restart"
        return (*self._signs.hints(), *rejected, *[gaps] * (self._gaps > 0))

    def run(
        self,
        t_s: Array,
        dt_s: Array,
        depth_m: Array,
        force_N: Array,
        speed_m_s: Array | None = None,
        force_std_N: Array | None = None,
    ) -> list[Estimate]:
        """Estimates of further rows, columns as `replay` takes them, shape (n,).

        The first call must bring `HEAD_ROWS` rows, or all that there are. The very
        first ``dt_s`` is not read.
        """
        dt_s = np.array(dt_s)
        if not self._gap_s:
            steps_s = dt_s[1:HEAD_ROWS]
            forward = steps_s[steps_s > 0.0]
            begin = int(np.argmax(np.isfinite(t_s)))
            usual_s = float(np.median(forward)) if forward.size else 1e-3
            self._gap_s = max(_LEAST_GAP_S, 10.0 * usual_s)
            dt_s[: begin + 1] = usual_s
        self._gaps += int((dt_s > self._gap_s).sum())
        self._signs.update(depth_m, speed_m_s, force_N)
        speeds = repeat(None) if speed_m_s is None else speed_m_s.tolist()
        depths, forces, steps, times = (
            each.tolist() for each in (depth_m, force_N, dt_s, t_s)
        )
        stds = repeat(0.0) if force_std_N is None else force_std_N.tolist()
        estimates = list(
            map(self._identifier.update, depths, speeds, forces, steps, times, stds)
        )
        self._rejected.update(estimate.status for estimate in estimates)
        return estimates


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """Online estimates of a recording.

    Attributes:
        t_s: Time stamps of the recording, shape (n,), read-only.
        estimates: One per row.
        layers: Layers traversed, as known at the end.
        hints: Suspicions about signs and units.
    """

    t_s: Array
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

    Rows that cannot be used (gaps, time running backwards) are reported in their
    estimate's status, not dropped. Where a clock may have been set, give ``dt_s``.
    Estimates, ruptures and layers are on the clock of ``t_s`` and count depth from the
    zero of ``depth_m``.

    Args:
        t_s: Time stamps [s], shape (n,).
        depth_m: Tip depth, growing into the tissue [m], shape (n,).
        force_N: Axial force, positive when tissue pushes back [N], shape (n,).
        speed_m_s: Rate of depth [m/s]; estimated from depth, see `Identifier.update`,
            if None.
        config: `MULTILAYER`, `PUBLISHED` or a variant.
        dt_s: Time since the latest row that advanced [s], shape (n,), not positive for
            a row that does not; None to count from the latest stamp.

    Raises:
        InvalidLogError: Empty or ragged columns.
    """
    t = read_column("t_s", t_s)
    z = read_column("depth_m", depth_m, len(t))
    f = read_column("force_N", force_N, len(t))
    v = None if speed_m_s is None else read_column("speed_m_s", speed_m_s, len(t))
    # A stamp that is no number spoils its own row only.
    latest_s = np.fmax.accumulate(np.concatenate((t[:1], t[:-1])))
    steps = t - latest_s if dt_s is None else read_column("dt_s", dt_s, len(t))
    stream = ReplayStream(config)
    estimates = stream.run(t, steps, z, f, v)
    t.setflags(write=False)
    return Replay(
        t_s=t, estimates=tuple(estimates), layers=stream.layers, hints=stream.hints
    )
