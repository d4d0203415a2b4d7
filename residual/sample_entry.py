"""Where the samples of a stream come in: copied, checked once, and judged."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from residual.errors import SampleError
from residual.guard_state import GuardState
from residual.sample_check import check_rows, read_rows
from residual.sample_guard import SampleGuard
from residual.sensor_config import SensorConfig
from urdf import Robot


class SampleEntry:
    """Reads positions, velocities if there are any, and torques; all or none with velocities.

    Args:
        robot: The arm.
        config: Settings of the sensor.
        has_velocity: Whether samples carry a velocity.
        torque_name: What the caller calls the torque.
        velocity_delay_s: Age of the velocity that `accept` is told [s].
    """

    def __init__(
        self,
        robot: Robot,
        config: SensorConfig,
        *,
        has_velocity: bool,
        torque_name: str,
        velocity_delay_s: float,
    ) -> None:
        self._joints, self._has_velocity = robot.nv, has_velocity
        self._names = ("q", "dq", torque_name) if has_velocity else ("q", torque_name)
        self._guard = (
            SampleGuard(robot, has_velocity=has_velocity, velocity_delay_s=velocity_delay_s)
            if config.guard
            else None
        )
        self._read = np.zeros(0)

    def read(
        self, q: ArrayLike, dq: ArrayLike | None, torque: ArrayLike, dt_s: float
    ) -> tuple[NDArray[np.float64], bool]:
        """Read a sample; nothing changes before `accept` but what the guard knows of spikes.

        Args:
            q: Positions [rad], shape (n,).
            dq: Velocities [rad/s], shape (n,), or None.
            torque: Torques [Nm], shape (n,).
            dt_s: Time since the last accepted sample [s].

        Returns:
            The signals, one a row, torque last, as a read-only copy of shape (2, n) or (3, n); and
            whether the position has jumped, and stayed there.

        Raises:
            SampleError: For a wrong shape, numbers that are not finite, or a velocity that comes
                and goes.
            SuspectSampleError: For a spike, frozen signals or a saturated torque.
        """
        if (dq is None) == self._has_velocity:
            raise SampleError(
                "dq was given before and is missing now, or the reverse; keep to one of the two "
                "for a stream, or reset() first"
            )
        values = (q, torque) if dq is None else (q, dq, torque)
        rows = read_rows(self._names, values, self._joints)
        now, guard = rows.ravel(), self._guard
        if guard is None:
            check_rows(self._names, rows)
            return rows, False
        self._read = now
        # What is hardly off the last sample needs no other look, nor a check of its numbers.
        if guard.surely_passes(now):
            return rows, False
        check_rows(self._names, rows)
        return rows, guard.check(now, dt_s)

    def accept(self, velocity: NDArray[np.float64], dt_s: float) -> None:
        """The sample last read has been absorbed; see `SampleGuard.accept`."""
        if self._guard is not None:
            self._guard.accept(self._read, velocity, dt_s)

    @property
    def warning(self) -> str:
        """What seems frozen in samples that are accepted all the same; empty if nothing does."""
        return "" if self._guard is None else self._guard.warning

    @property
    def state(self) -> GuardState | None:
        """All that is remembered; None without a guard."""
        return None if self._guard is None else self._guard.state

    def restore(self, state: GuardState | None) -> None:
        """Go on from a `state` taken earlier with the same settings."""
        if self._guard is not None and state is not None:
            self._guard.restore(state)
