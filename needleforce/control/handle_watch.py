"""Is a sample of the haptic device to be used? Numbers, motion, velocity, jumps.

It is checked once; manager and teleoperation both go by the report:

    report = watch.update(device.read(), dt_s)          # or tick.check_handle(...)
    situation = manager.update(sample, Beside(handle=report))
    move = teleoperation.update(report, situation.estimate, dt_s)

What a device reports moves a needle, so nothing of it is taken for granted: a handle
may be gone, repeat itself, jump, or report a velocity that its positions contradict.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.control.ports import MasterSample
from residual.checks.input import as_float


class HandleReading(NamedTuple):
    """A usable sample of the handle, in the device's axes.

    Attributes:
        position_m: Its position, shape (3,).
        velocity_m_s: Its velocity, shape (3,); that of its positions where they
            contradict the one reported.
        is_coupled: Whether the hand moves the needle.
    """

    position_m: Array
    velocity_m_s: Array
    is_coupled: bool


class HandleReport(NamedTuple):
    """What a sample of the handle is good for.

    Attributes:
        reading: The sample; None if it is not to be used.
        fault: Why there has been no usable sample of late, or none at all; else empty.
        doubt: Why the needle should stand, although the sample is usable: the handle
            has jumped, or its velocity has been wrong for a while; else empty.
        has_jumped: Whether the handle is elsewhere than a hand can have moved it since
            the reading before.
    """

    reading: HandleReading | None
    fault: str = ""
    doubt: str = ""
    has_jumped: bool = False


def _parse(sample: MasterSample | None) -> HandleReading | None:
    """Return a sample as numbers; None for one that no handle can give."""
    handle: Any = sample  # whatever a driver gives
    try:
        vectors = np.array((handle.position_m, handle.velocity_m_s), np.float64)
        reading = HandleReading(*vectors, is_coupled=bool(handle.clutch))
    except (AttributeError, TypeError, ValueError):
        return None
    # No handle is further away [m], or quicker [m/s].
    is_possible = vectors.shape == (2, 3) and (np.abs(vectors) < 100.0).all()
    return reading if is_possible else None


class HandleWatch:
    """Checks every sample of a haptic device; see `update`.

    Make a new one after a pause in which nobody asked: positions before it would look
    like a motion.
    """

    def __init__(self) -> None:
        self._last: HandleReading | None = None
        self._last_t_s: object = None
        self._since_s = math.inf  # time since the last usable sample
        self._repeated_s = 0.0  # time for which one sample has been repeated
        self._contradicted_s = 0.0  # time for which the velocity has been wrong
        # Means over 20 ms, which lag alike: by positions, as reported.
        self._means_m_s = np.zeros((2, 3))

    def update(self, sample: MasterSample | None, dt_s: float) -> HandleReport:
        """Return what a sample is good for; never raise.

        A sample counts as repeated if its ``t_s`` is, or if its position and velocity
        are; but a handle may rest, its velocity zero, while ``t_s`` goes on.

        Args:
            sample: Of the device, or None if it has sent nothing new.
            dt_s: Time since the last call; without one the sample is not used.
        """
        dt_s = as_float(dt_s)
        if not 0.0 < dt_s < math.inf:
            return HandleReport(None)
        self._since_s += dt_s
        since_s = self._since_s
        reading = _parse(sample)
        if reading is None:
            what = "is silent" if sample is None else "sends no finite numbers"
            # With 20 ms to the next cycle of the manager and the arm's own, it is
            # noticed within 50 ms.
            is_gone = since_s >= 0.03
            return HandleReport(None, f"the haptic device {what}" if is_gone else "")
        last = self._last
        is_repeated = last is not None and self._is_repeated(sample, reading, last)
        self._last = reading
        self._last_t_s = getattr(sample, "t_s", None)
        self._repeated_s = self._repeated_s + dt_s if is_repeated else 0.0
        # Encoders of 10 um show the tremor of a hand at rest within it.
        if self._repeated_s >= 0.03:
            return HandleReport(
                None,
                "the haptic device has repeated one sample: it is frozen, or nobody "
                "holds it",
            )
        self._since_s = 0.0
        if last is None:
            self._means_m_s[:] = reading.velocity_m_s
            return HandleReport(reading)
        return self._compare(reading, reading.position_m - last.position_m, since_s)

    def _is_repeated(
        self, sample: object, reading: HandleReading, last: HandleReading
    ) -> bool:
        """Return whether a sample is the one before it."""
        t_s = getattr(sample, "t_s", None)
        is_stamp_old = t_s == self._last_t_s
        if t_s is not None and (is_stamp_old or not reading.velocity_m_s.any()):
            return is_stamp_old
        return bool(
            (reading.position_m == last.position_m).all()
            and (reading.velocity_m_s == last.velocity_m_s).all()
        )

    def _compare(
        self, reading: HandleReading, moved_m: Array, since_s: float
    ) -> HandleReport:
        """Return a sample with the velocity to be used, and what is in doubt.

        Of two that contradict each other it is the slower one, in each direction, and
        none where they oppose each other. A device that reports zeros has no velocity
        to report: that of its positions is used. A velocity that is contradicted for 40
        ms is wrong, not late.

        Encoder steps of 10 um at 1 kHz leave 1 mm/s in means over 20 ms. They may
        differ by 10 mm/s, for these steps and the device's own filter, and by half the
        speed: cycles of device and loop drift through each other, so that a sample
        comes twice or not at all.

        Args:
            reading: The sample.
            moved_m: Change of its position since the one before, shape (3,).
            since_s: The time of that.
        """
        distance_m = math.sqrt(float(moved_m @ moved_m))
        # No hand moves a handle further between two samples of 200 Hz or more.
        if distance_m > 5e-3:
            self._means_m_s[:] = 0.0  # positions before say nothing about it
            return HandleReport(
                reading._replace(velocity_m_s=np.zeros(3)),
                doubt=f"the handle jumped by {1e3 * distance_m:.0f} mm in "
                f"{1e3 * since_s:.0f} ms",
                has_jumped=True,
            )
        velocities_m_s = np.array((moved_m / since_s, reading.velocity_m_s))
        weight = since_s / (0.02 + since_s)
        self._means_m_s += weight * (velocities_m_s - self._means_m_s)
        by_positions_m_s, reported_m_s = self._means_m_s
        error_m_s = np.linalg.norm(reported_m_s - by_positions_m_s)
        tolerated_m_s = 0.01 + 0.5 * np.linalg.norm(by_positions_m_s)
        is_contradicted = bool(error_m_s > tolerated_m_s)
        has_velocity = bool(reported_m_s.any())
        wrong_s = self._contradicted_s + since_s
        self._contradicted_s = wrong_s if is_contradicted and has_velocity else 0.0
        if not is_contradicted:
            return HandleReport(reading)
        if not has_velocity:
            return HandleReport(reading._replace(velocity_m_s=by_positions_m_s.copy()))
        is_wrong = self._contradicted_s >= 0.04
        is_along = reading.velocity_m_s * by_positions_m_s > 0.0
        slower_m_s = np.minimum(np.abs(reading.velocity_m_s), np.abs(by_positions_m_s))
        return HandleReport(
            reading._replace(
                velocity_m_s=is_along * np.sign(by_positions_m_s) * slower_m_s
            ),
            doubt="the handle's velocity contradicts its positions" if is_wrong else "",
        )
