"""What arms with a vendor's client library have in common: checks and counts."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.devices.guard import GuardedArm
from needleforce.devices.link import ArmReading


class ArmSignals(NamedTuple):
    """What an arm's client has read at a time.

    Attributes:
        time_s: On the arm's clock.
        q_rad: Joint positions, shape (n,).
        dq_rad_s: Joint velocities, shape (n,).
        effort: Torques or motor currents, shape (n,).
        external_Nm: The arm's own estimate of the external torques, shape (n,), or
            None.
    """

    time_s: float
    q_rad: Array
    dq_rad_s: Array
    effort: Array
    external_Nm: Array | None = None


class CheckedArm(GuardedArm):
    """An arm whose signals are checked and counted before they are handed on.

    Args:
        joints: How many it has.
        period_s: Of its cycle.
        robot: The model of the arm, kept for those who need both.

    Attributes:
        joints: How many it has.
        robot: The model of the arm.
    """

    def __init__(self, joints: int, period_s: float, robot: Any) -> None:
        super().__init__()
        self.robot = robot
        self.joints = joints
        self._period_s = period_s
        self._latest_s = -np.inf

    def _checked(self, signals: ArmSignals) -> Iterator[ArmReading]:
        """Yield signals as a reading, if they are valid and new."""
        arrays = [signals.q_rad, signals.dq_rad_s, signals.effort]
        if signals.external_Nm is not None:
            arrays.append(signals.external_Nm)
        if not all(self._is_valid(array) for array in arrays):
            self.report.malformed += 1
            return

        gap_s = signals.time_s - self._latest_s
        if gap_s <= 0.0:
            self.report.stale += 1
            return

        # Stamps count microseconds or more; their differences have rounding errors.
        # Decimals of a difference of stamps [s].
        stamp_digits = 9
        dt_s = round(gap_s, stamp_digits) if np.isfinite(gap_s) else self._period_s
        missed = max(round(dt_s / self._period_s) - 1, 0)
        self._latest_s = signals.time_s
        self.report.count_used(missed + 1, dt_s)
        yield ArmReading(
            dt_s=dt_s,
            q_rad=signals.q_rad,
            dq_rad_s=signals.dq_rad_s,
            tau_Nm=signals.effort,
            external_Nm=signals.external_Nm,
            missed=missed,
            accepts_commands=self._accepts_commands,
            is_real=True,
        )

    def _is_valid(self, values: ArrayLike) -> bool:
        """Return whether there is one finite number for each joint."""
        array = np.asarray(values)
        return array.shape == (self.joints,) and bool(np.isfinite(array).all())
