"""A recording through the online identifier, any number of rows at a time."""

from collections import Counter
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from identification.default_config import DEFAULT, DefaultConfig
from identification.derived_speed import DerivedSpeed
from identification.estimate import Estimate, LayerEstimate
from identification.identifier import Identifier
from identification.paper_config import PaperConfig
from identification.sample_check import SampleStatus
from identification.sign_hints import SignWatch

Array = NDArray[np.float64]

_REFUSED = (SampleStatus.FORCE_RANGE, SampleStatus.DEPTH_JUMP, SampleStatus.SPEED_SIGN)
"""What nobody has told of a row before; a NaN or a late stamp has been told by who read the log."""

HEAD_ROWS = 200
"""The usual time step is the median over so many first rows."""


class ReplayedRows(NamedTuple):
    """Consecutive rows with their estimates.

    Attributes:
        t_s: Time stamps [s], shape (n,).
        force_N: Axial force as recorded [N], shape (n,).
        estimates: One per row.
    """

    t_s: Array
    force_N: Array
    estimates: list[Estimate]


class ReplayStream:
    """Runs the identifier over a recording; results do not depend on how the rows come.

    Args:
        config: `DEFAULT`, `PAPER` or a variant.
    """

    def __init__(self, config: DefaultConfig | PaperConfig = DEFAULT) -> None:
        self._identifier = Identifier(config)
        self._signs = SignWatch()
        self._speed: DerivedSpeed | None = None
        self._first_step_s = 0.0
        self._latest_s: float | None = None
        self._waiting = np.empty((4, 0))
        self._refused: Counter[SampleStatus] = Counter()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers left so far, in order, as known now."""
        return self._identifier.layers

    @property
    def hints(self) -> tuple[str, ...]:
        """Suspicions about signs and units of all rows so far, and how many were refused."""
        refused = (
            f"rows that were refused: {self._refused[status]} ({status.value})"
            for status in _REFUSED
            if self._refused[status]
        )
        return (*self._signs.hints(), *refused)

    def run(
        self,
        t_s: Array,
        depth_m: Array,
        force_N: Array,
        speed_m_s: Array | None = None,
        dt_s: Array | None = None,
    ) -> ReplayedRows:
        """Take further rows.

        Args:
            t_s: Time stamps [s], shape (n,), n > 0; the first call must bring `HEAD_ROWS` rows, or
                all that there are.
            depth_m: Tip depth, growing into the tissue [m], shape (n,).
            force_N: Axial force, positive when tissue pushes back [N], shape (n,).
            speed_m_s: Rate of depth [m/s], shape (n,); None, always, to derive it from depth,
                for which rows wait 25 ms.
            dt_s: Time since the latest row that advanced [s], shape (n,), not positive for rows
                that do not; None, always, to count from the latest stamp. That of the very first
                row is not read.

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
        columns = (depth_m, speed_m_s, force_N, dt_s)
        estimates = list(map(self._identifier.update, *(column.tolist() for column in columns)))
        self._refused.update(estimate.status for estimate in estimates)
        return ReplayedRows(t_s, force_N, estimates)
