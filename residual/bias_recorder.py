"""Collects free motion for a tare, in bounded memory."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.bias_model import TareBlocks
from residual.errors import TareError
from residual.input_validation import ROUNDING_S

MOST_BLOCKS = 400
"""When there are as many, the older half is merged in pairs: a fit takes a fraction of a second."""


class _Block(NamedTuple):
    """Means over a block (rows: position, residual, trends), its middle and its scatter."""

    means: NDArray[np.float64]
    time_s: float
    scatter: NDArray[np.float64]
    samples: int

    def merge(self, other: "_Block") -> "_Block":
        count = self.samples + other.samples
        a, b = self.samples / count, other.samples / count
        between = a * b * (self.means[1] - other.means[1]) ** 2
        return _Block(
            a * self.means + b * other.means,
            a * self.time_s + b * other.time_s,
            a * self.scatter + b * other.scatter + between,
            count,
        )


class RecorderState(NamedTuple):
    """All that a `TareRecorder` remembers.

    Attributes:
        means: Of every block: position, residual, trends; shape (m, 2 + loops, n).
        time_s: Middle of every block [s], shape (m,).
        scatter: Variance within every block [Nm^2], shape (m, n).
        samples: Number of samples of every block.
        sums: Of the open block, shape (2 + loops, n).
        squares: Of its residuals [Nm^2], shape (n,).
        summed: Number of its samples.
        age_s: Its length so far [s].
    """

    means: NDArray[np.float64]
    time_s: NDArray[np.float64]
    scatter: NDArray[np.float64]
    samples: tuple[int, ...]
    sums: NDArray[np.float64]
    squares: NDArray[np.float64]
    summed: int
    age_s: float


class TareRecorder:
    """Means of residual, position and torque trend over short blocks.

    Memory is bounded: once there are `MOST_BLOCKS`, pairs of neighbours in the older half become
    one; the latest blocks stay short.

    Args:
        joints: Number of joints.
        loops: Number of hysteresis loops.
        block_s: Length of a block [s]; longer than the observer's lag, so that blocks are nearly
            independent.
    """

    def __init__(self, joints: int, loops: int, block_s: float) -> None:
        self._joints, self._loops = joints, loops
        self._block_s = block_s
        self.clear()

    def clear(self) -> None:
        """Forget all blocks."""
        self._blocks: list[_Block] = []
        self._open()

    @property
    def is_empty(self) -> bool:
        """Whether nothing has been recorded since `clear`."""
        return not (self._blocks or self._count)

    def _open(self) -> None:
        self._sum = np.zeros((2 + self._loops, self._joints))
        self._squares = np.zeros(self._joints)
        self._count = 0
        self._age_s = 0.0

    def add(
        self,
        q: NDArray[np.float64],
        trend: NDArray[np.float64],
        residual: NDArray[np.float64],
        time_s: float,
        dt_s: float,
    ) -> None:
        """Add one sample at a time [s].

        Args:
            q: Position [rad], shape (n,).
            trend: Of the torques, shape (loops, n).
            residual: Before offset removal [Nm], shape (n,).
            time_s: Its time [s].
            dt_s: Time since the sample before [s].
        """
        self._sum[0] += q
        self._sum[1] += residual
        self._sum[2:] += trend
        self._squares += residual * residual
        self._count += 1
        self._age_s += dt_s
        if self._age_s >= self._block_s - ROUNDING_S:
            means = self._sum / self._count
            scatter = np.maximum(self._squares / self._count - means[1] ** 2, 0.0)
            middle_s = time_s - 0.5 * self._age_s
            self._blocks.append(_Block(means, middle_s, scatter, self._count))
            self._open()
            if len(self._blocks) >= MOST_BLOCKS:
                half = MOST_BLOCKS // 2
                older, newer = self._blocks[:half], self._blocks[half:]
                pairs = zip(older[::2], older[1::2], strict=True)
                self._blocks = [one.merge(other) for one, other in pairs] + newer

    def blocks(self, now_s: float, window_s: float | None = None) -> TareBlocks:
        """What was recorded, or the last ``window_s`` of it [s]; at least one block.

        Raises:
            TareError: If there is not a single block.
        """
        if not self._blocks:
            raise TareError(
                f"no settled free motion has been recorded (less than {self._block_s:g} s of it); "
                "update() the sensor without contact first, in steps no longer than max_gap_s, "
                "then tare()"
            )
        kept = [b for b in self._blocks if window_s is None or now_s - b.time_s <= window_s]
        kept = kept or self._blocks[-1:]
        means = np.stack([b.means for b in kept])
        return TareBlocks(
            q_rad=means[:, 0],
            trend=means[:, 2:],
            residual_Nm=means[:, 1],
            age_s=np.array([b.time_s for b in kept]) - now_s,
            # The median, so that a knock in one block does not pass for noise in all.
            scatter_Nm2=np.median([b.scatter for b in kept], axis=0),
        )

    @property
    def state(self) -> RecorderState:
        """All that the recorder remembers, as copies."""
        blocks, shape = self._blocks, self._sum.shape
        return RecorderState(
            np.array([b.means for b in blocks]).reshape(-1, *shape),
            np.array([b.time_s for b in blocks]),
            np.array([b.scatter for b in blocks]).reshape(-1, shape[1]),
            tuple(b.samples for b in blocks),
            self._sum.copy(),
            self._squares.copy(),
            self._count,
            self._age_s,
        )

    def restore(self, state: RecorderState) -> None:
        """Go on from a `state` taken earlier."""
        rows = zip(state.means, state.time_s.tolist(), state.scatter, state.samples, strict=True)
        self._blocks = [_Block(*row) for row in rows]
        self._sum, self._squares = state.sums.copy(), state.squares.copy()
        self._count, self._age_s = state.summed, state.age_s
