"""Collects free motion for a tare, in bounded memory."""

from collections import deque

import numpy as np
from numpy.typing import NDArray

from residual.errors import TareError
from residual.tare import TareBlocks


class TareRecorder:
    """Means of residual, position and direction over short blocks, the latest ones kept.

    Args:
        joints: Number of joints.
        block_s: Length of a block [s]; longer than the observer's lag, so that blocks are nearly
            independent.
        keep_s: How much of the past is kept [s].
    """

    def __init__(self, joints: int, block_s: float, keep_s: float = 120.0) -> None:
        self._joints = joints
        self._block_s = block_s
        self._blocks: deque[tuple[NDArray[np.float64], float, NDArray[np.float64]]] = deque(
            maxlen=max(1, round(keep_s / block_s))
        )
        self.clear()

    def clear(self) -> None:
        """Forget all blocks."""
        self._blocks.clear()
        self._open()

    def _open(self) -> None:
        self._sum = np.zeros((3, self._joints))
        self._squares = np.zeros(self._joints)
        self._count = 0
        self._age_s = 0.0

    def add(
        self,
        q: NDArray[np.float64],
        direction: NDArray[np.float64],
        residual: NDArray[np.float64],
        time_s: float,
        dt_s: float,
    ) -> None:
        """Add one sample: position [rad], direction, residual [Nm], each (n,), at a time [s]."""
        self._sum += (q, direction, residual)
        self._squares += residual * residual
        self._count += 1
        self._age_s += dt_s
        if self._age_s >= self._block_s:
            means = self._sum / self._count
            scatter = np.maximum(self._squares / self._count - means[2] ** 2, 0.0)
            self._blocks.append((means, time_s - 0.5 * self._age_s, scatter))
            self._open()

    def blocks(self, now_s: float, window_s: float | None = None) -> TareBlocks:
        """What was recorded, or the last ``window_s`` of it [s].

        Raises:
            TareError: If there is not a single block.
        """
        kept = [b for b in self._blocks if window_s is None or now_s - b[1] <= window_s]
        if not kept:
            raise TareError(
                f"no free motion has been recorded ({len(self._blocks)} blocks of "
                f"{self._block_s:g} s); update() the sensor without contact first, then tare()"
            )
        means = np.stack([b[0] for b in kept])
        return TareBlocks(
            q_rad=means[:, 0],
            direction=means[:, 1],
            residual_Nm=means[:, 2],
            age_s=np.array([b[1] for b in kept]) - now_s,
            # The median, so that a knock in one block does not pass for noise in all.
            scatter_Nm2=np.median([b[2] for b in kept], axis=0),
        )
