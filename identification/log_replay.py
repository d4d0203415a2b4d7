"""A whole recording through the online identifier."""

from collections import Counter
from dataclasses import dataclass
from itertools import repeat

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.errors import Suspicion
from identification.config import MIXTURE, MixtureConfig, PublishedConfig
from identification.estimate import Estimate, LayerEstimate, SampleStatus
from identification.identifier import Identifier
from identification.published.offline import read_column
from identification.sample_check import STEPS_OF_A_GAP

MIN_TRAVEL_M = 1e-3
"""A recording whose depth moves by less holds nothing to identify."""
MAX_DEPTH_M = 1.0
"""No needle goes deeper: such a depth is in millimetres."""
MIN_PULL_N = 0.02
"""A mean force of an insertion that pulls by more has the wrong sign."""
WITHDRAWN_FRACTION = 0.7
"""Part of its span of depths that a recording of the wrong sign goes back at least."""
FALLBACK_STEP_S = 1e-3
"""Usual time step of a recording whose time never advances."""
HEAD_ROWS = 200
"""The usual time step is the median over so many first rows."""
REPORTED_STATUSES = (
    SampleStatus.FORCE_RANGE,
    SampleStatus.MOTION_RANGE,
    SampleStatus.DEPTH_JUMP,
    SampleStatus.SPEED_SIGN,
    SampleStatus.TIME_RANGE,
)
"""What nobody has reported of a row before; who read the log has reported a NaN or a
late stamp."""


class SignCheck:
    """Search for a flipped sign or a wrong unit in a recording, piece by piece."""

    def __init__(self) -> None:
        self._last_m = np.empty(0)
        self._deepest_m = -np.inf
        self._shallowest_m = np.inf
        self._start_m: float | None = None
        self._insertion_work_J = 0.0
        self._insertion_m = 0.0
        self._agreement = 0.0
        self._smallest_N = np.inf
        self._largest_N = -np.inf

    def add_rows(self, depth_m: Array, speed_m_s: Array | None, force_N: Array) -> None:
        """Use further rows: columns of shape (n,), with gaps; a speed if recorded."""
        previous_m = self._last_m if self._last_m.size else depth_m[:1]
        change_m = np.diff(depth_m, prepend=previous_m)
        self._last_m = depth_m[-1:]
        is_good = np.isfinite(change_m) & np.isfinite(force_N)
        change_m = np.where(is_good, change_m, 0.0)
        force_N = np.where(is_good, force_N, 0.0)

        finite_m = depth_m[np.isfinite(depth_m)]
        if finite_m.size:
            if self._start_m is None:
                self._start_m = float(finite_m[0])
            self._shallowest_m = min(self._shallowest_m, float(finite_m.min()))
        depth_m = np.where(np.isfinite(depth_m), depth_m, -np.inf)
        deepest_m = np.maximum.accumulate(np.concatenate(([self._deepest_m], depth_m)))
        is_insertion = (change_m > 0.0) & (depth_m >= deepest_m[1:])
        insertion_m = change_m * is_insertion
        self._deepest_m = float(deepest_m[-1])
        self._insertion_work_J += float((force_N * insertion_m).sum())
        self._insertion_m += float(insertion_m.sum())
        self._smallest_N = min(self._smallest_N, float(force_N.min()))
        self._largest_N = max(self._largest_N, float(force_N.max()))
        if speed_m_s is not None:
            speed_m_s = np.where(np.isfinite(speed_m_s), speed_m_s, 0.0)
            self._agreement += float(change_m @ speed_m_s)

    def hints(self) -> tuple[Suspicion, ...]:
        """Return suspicions about signs and units; none where all looks right."""
        start_m = self._start_m
        span_m = 0.0 if start_m is None else self._deepest_m - self._shallowest_m
        hints: list[Suspicion] = []
        if span_m > MAX_DEPTH_M:
            hints.append(
                Suspicion(
                    f"depth spans {span_m:.3g} m; is it in millimetres?",
                    "Give `depth_m` in metres.",
                )
            )
        if start_m is None or span_m < MIN_TRAVEL_M:
            hints.append(
                Suspicion(
                    f"depth moves by {span_m * 1e3:.3g} mm only; there is nothing to "
                    "identify",
                    "Give `depth_m` in metres, of a recording that has an insertion.",
                )
            )
            return tuple(hints)
        is_pulled = (
            self._insertion_m > 0.0
            and self._insertion_work_J / self._insertion_m < -MIN_PULL_N
        )
        if is_pulled:
            hints.append(
                Suspicion(
                    "the force is negative while the needle goes in; it must be "
                    "positive when tissue pushes back",
                    "Negate `force_N`.",
                )
            )
        is_withdrawn = start_m - self._shallowest_m > WITHDRAWN_FRACTION * span_m
        if is_withdrawn and self._largest_N > self._smallest_N:
            hints.append(
                Suspicion(
                    "depth falls before it rises; it must grow into the tissue",
                    "Negate `depth_m`, unless the recording begins with a withdrawal.",
                )
            )
        if self._agreement < 0.0:
            hints.append(
                Suspicion(
                    "speed has the sign opposite to the change of depth",
                    "Negate `speed_m_s` or `depth_m`, or leave the speed out.",
                )
            )
        return tuple(hints)


class ReplayStream:
    """An identifier run over a recording; results do not depend on how the rows come.

    Estimates, ruptures and layers are on the clock of the recording.

    Args:
        config: `MIXTURE`, `PUBLISHED` or a variant.
    """

    def __init__(self, config: MixtureConfig | PublishedConfig = MIXTURE) -> None:
        self._identifier = Identifier(config)
        self._signs = SignCheck()
        self._min_gap_s = float(config.check.gap_s)
        self._gap_s = 0.0  # until rows have come
        self._gaps = 0
        self._rejected: Counter[SampleStatus] = Counter()
        # The published method is told where the contact is.
        is_published = isinstance(config, PublishedConfig)
        self._known_contact_m = config.contact_depth_m if is_published else None
        self._contacts_m: list[float | None] = []

    @property
    def contact_depth_m(self) -> float | None:
        """Depth of the first contact, as known now; None before."""
        if self._known_contact_m is not None:
            return self._known_contact_m
        return self._identifier.contact_depth_m

    @property
    def contact_depths_m(self) -> Array:
        """The same as known at each row of the last `run`, nan before, shape (n,)."""
        return np.array(self._contacts_m, dtype=np.float64)  # None becomes nan

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        return self._identifier.layers

    @property
    def hints(self) -> tuple[Suspicion, ...]:
        """Suspicions about signs and units of all rows so far; rejected rows; gaps."""
        hints = list(self._signs.hints())
        counts = {status: self._rejected[status] for status in REPORTED_STATUSES}
        hints += [
            Suspicion(f"rows that were rejected: {count} ({status.value})")
            for status, count in counts.items()
            if count
        ]
        if self._gaps > 0:
            hints.append(
                Suspicion(
                    f"gaps in time longer than {self._gap_s:.3g} s: {self._gaps}; "
                    "predictions restart"
                )
            )
        return tuple(hints)

    def run(
        self,
        t_s: Array,
        dt_s: Array,
        depth_m: Array,
        force_N: Array,
        speed_m_s: Array | None = None,
        force_std_N: Array | None = None,
    ) -> list[Estimate]:
        """Return estimates of further rows, columns as `replay` takes them, shape (n,).

        The first call must bring `HEAD_ROWS` rows, or all that there are. The very
        first ``dt_s`` is not read.
        """
        dt_s = np.array(dt_s)
        if not self._gap_s:
            head_s = dt_s[1:HEAD_ROWS]
            forward_s = head_s[head_s > 0.0]
            usual_s = float(np.median(forward_s)) if forward_s.size else FALLBACK_STEP_S
            self._gap_s = max(self._min_gap_s, STEPS_OF_A_GAP * usual_s)
            first = int(np.argmax(np.isfinite(t_s)))
            dt_s[: first + 1] = usual_s
        self._gaps += int((dt_s > self._gap_s).sum())
        self._signs.add_rows(depth_m, speed_m_s, force_N)
        estimates: list[Estimate] = []
        self._contacts_m = []
        for row in zip(
            depth_m.tolist(),
            repeat(None) if speed_m_s is None else speed_m_s.tolist(),
            force_N.tolist(),
            dt_s.tolist(),
            t_s.tolist(),
            repeat(0.0) if force_std_N is None else force_std_N.tolist(),
            strict=False,
        ):
            estimates.append(self._identifier.update(*row))
            self._contacts_m.append(self.contact_depth_m)
        self._rejected.update(estimate.status for estimate in estimates)
        return estimates


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Replay:
    """Online estimates of a recording.

    Attributes:
        t_s: Time stamps of the recording, shape (n,), read-only.
        estimates: One per row.
        layers: Layers traversed, as known at the end.
        hints: Suspicions about signs and units, as text with advice.
    """

    t_s: Array
    estimates: tuple[Estimate, ...]
    layers: tuple[LayerEstimate, ...]
    hints: tuple[Suspicion, ...]


def replay(
    t_s: ArrayLike,
    depth_m: ArrayLike,
    force_N: ArrayLike,
    speed_m_s: ArrayLike | None = None,
    config: MixtureConfig | PublishedConfig = MIXTURE,
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
        config: `MIXTURE`, `PUBLISHED` or a variant.
        dt_s: Time since the latest row that advanced [s], shape (n,), not positive for
            a row that does not; None to count from the latest stamp.

    Raises:
        InvalidLogError: Empty or ragged columns.
    """
    times_s = read_column("t_s", t_s)
    rows = len(times_s)
    depths_m = read_column("depth_m", depth_m, rows)
    forces_N = read_column("force_N", force_N, rows)
    speeds_m_s = None
    if speed_m_s is not None:
        speeds_m_s = read_column("speed_m_s", speed_m_s, rows)
    if dt_s is None:
        # A stamp that is no number spoils its own row only.
        latest_s = np.fmax.accumulate(np.concatenate((times_s[:1], times_s[:-1])))
        steps_s = times_s - latest_s
    else:
        steps_s = read_column("dt_s", dt_s, rows)
    stream = ReplayStream(config)
    estimates = stream.run(times_s, steps_s, depths_m, forces_N, speeds_m_s)
    times_s.setflags(write=False)
    return Replay(
        t_s=times_s,
        estimates=tuple(estimates),
        layers=stream.layers,
        hints=stream.hints,
    )
