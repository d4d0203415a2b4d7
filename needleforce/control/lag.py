"""The delay from command to measured motion, and the largest gain that it allows.

An arm that is commanded velocities follows the commanded positions x a time T late. All
joints are moved by a small chirp that begins and ends where it began, and T is where
the cross-correlation of x and the measured positions q is largest:

    T = argmax_t sum x(s - t) q(s)

A loop v = K (g - q), sampled every h, sees the delay T and half a cycle of holding:

    L(s) = K exp(-s (T + h / 2)) / s

It crosses gain one at K and is stable for K (T + h / 2) < pi / 2; its phase margin is
pi / 2 - K (T + h / 2). So with a margin phi, and T taken two deviations later:

    K_safe = (pi / 2 - phi) / (T + 2 sigma + h / 2)
"""

import math
from typing import NamedTuple

import numpy as np
from scipy import signal
from scipy.signal.windows import tukey

from foundation.arrays import Array
from needleforce.control.controller import Controller, MAX_DELAY_s
from needleforce.control.errors import ControlError, require_positive
from needleforce.control.joint_limits import Limits
from needleforce.control.ports import Arm
from needleforce.control.run import RIGHT_ARM, move_guarded
from needleforce.control.tasks import JointVelocity
from urdf import Robot

PHASE_MARGIN_deg = 55.0
"""phi: K times the delay is then 0.61. Errors decay without a swing up to 1 / e, and
overshoot by a twentieth at most here."""

REST_s = 0.3
"""Rest before the chirp, and after it: the longest delay."""


class Delay(NamedTuple):
    """The delay of one joint.

    Attributes:
        delay_s: T.
        std_s: Its standard deviation, by what the command does not explain.
        followed: The fraction of the command that the joint has followed.
        cycle_s: h, the usual time between two samples.
    """

    delay_s: float
    std_s: float
    followed: float
    cycle_s: float


class SafeGain(NamedTuple):
    """Gains of a P loop over commands of velocity, see the module.

    Attributes:
        safe_per_s: The largest with the phase margin.
        unstable_per_s: From here on, at the measured delay, the loop diverges.
    """

    safe_per_s: float
    unstable_per_s: float


def find_safe_gain(delay: Delay) -> SafeGain:
    """Return the largest gain that a delay allows, see the module."""
    delay_s = max(delay.delay_s, 0.0) + 0.5 * delay.cycle_s
    margin_rad = math.radians(PHASE_MARGIN_deg)
    return SafeGain(
        safe_per_s=(0.5 * math.pi - margin_rad) / (delay_s + 2.0 * delay.std_s),
        unstable_per_s=0.5 * math.pi / delay_s,
    )


def find_delay(
    times_s: Array, command_rad_s: Array, q_rad: Array, joint: str = "the joint"
) -> Delay:
    """Find the delay of one joint in a motion that ends where it began.

    Args:
        times_s: Of the samples, shape (m,).
        command_rad_s: Velocity that was sent after each sample, until the next one,
            shape (m - 1,).
        q_rad: Positions, shape (m,).
        joint: Name of the joint, for messages.

    Raises:
        ControlError: The joint has not followed its commands.
    """
    step_s = 2e-4  # of the even grid, on which delays are told apart
    grid_s = np.arange(times_s[0], times_s[-1], step_s)
    commanded_rad = np.append(0.0, np.cumsum(command_rad_s * np.diff(times_s)))
    commanded_rad = signal.detrend(np.interp(grid_s, times_s, commanded_rad))
    measured_rad = signal.detrend(np.interp(grid_s, times_s, q_rad))
    lags = signal.correlation_lags(grid_s.size, grid_s.size)
    products = signal.correlate(measured_rad, commanded_rad)
    products[np.abs(lags * step_s) > MAX_DELAY_s] = 0.0
    lag = int(lags[products.argmax()])
    late_rad = np.roll(commanded_rad, lag)  # both ends rest at the same place
    followed = float(late_rad @ measured_rad) / max(float(late_rad @ late_rad), 1e-24)
    left_rad = measured_rad - followed * late_rad
    explained = 1.0 - left_rad.var() / max(measured_rad.var(), 1e-24)
    # A soft servo makes 0.7 of quick commands.
    if not (0.5 < followed < 1.2 and explained > 0.8):
        raise ControlError(
            f"{joint} moved by {100.0 * followed:.0f} % of its commands, which explain "
            f"{100.0 * max(explained, 0.0):.0f} % of its motion: expected an arm that "
            "follows velocities",
            RIGHT_ARM,
        )
    speed_rad_s = np.sqrt(np.mean(np.gradient(commanded_rad, step_s) ** 2))
    samples = math.sqrt(times_s.size)
    return Delay(
        delay_s=lag * step_s,
        std_s=float(left_rad.std() / (followed * speed_rad_s * samples)),
        followed=followed,
        cycle_s=float(np.median(np.diff(times_s))),
    )


def measure_lag(
    arm: Arm, robot: Robot, limits: Limits, duration_s: float = 3.0
) -> list[Delay]:
    """Move all joints by a small chirp, and measure the delay of each.

    The tip moves by 5 mm at most. However it ends, the arm is brought to rest.

    Args:
        arm: It moves without a question.
        robot: Its model.
        limits: What its joints may do.
        duration_s: Of the motion.

    Raises:
        ControlError: The arm takes no commands, or a joint is moved by something else
            or has not followed its commands, as at a limit.
        SettingError: The duration is not positive.
    """
    require_positive({"duration_s": duration_s})
    controller = Controller(robot, limits)
    chirp_s = np.arange(0.0, duration_s, 1e-3)
    # To the frequencies of loops with the usual gain.
    path = signal.chirp(chirp_s, f0=1.0, t1=duration_s, f1=6.0, phi=-90)
    rates_per_s = np.gradient(path * tukey(chirp_s.size, 0.4), chirp_s)
    moved_s = duration_s + 2.0 * REST_s
    rows = list[tuple[float, Array, Array]]()
    excursion_rad = 0.0
    for time_s, tick in move_guarded(arm, controller, moved_s):
        if time_s > moved_s and not controller.last_rad_s.any():
            break
        if 0.0 < time_s <= moved_s:
            q_rad = np.array(tick.sample.q_rad, dtype=np.float64)
            if not rows:
                controller.tool.update(q_rad)
                reach_m_per_rad = np.linalg.norm(controller.tool.jacobian[:3], axis=0)
                # No joint exceeds 0.03 rad/s, nor the sum of the tip's excursions from
                # the single joints 5 mm.
                excursion_rad = min(
                    0.03 / np.abs(rates_per_s).max(), 5e-3 / reach_m_per_rad.sum()
                )
            rows.append((time_s, q_rad, controller.last_rad_s))
            rate_per_s = np.interp(time_s - REST_s, chirp_s, rates_per_s, 0.0, 0.0)
            tick.tasks = [JointVelocity(np.full(robot.nv, excursion_rad * rate_per_s))]
    times_s, positions_rad, sent_rad_s = map(np.array, zip(*rows, strict=True))
    return [
        find_delay(times_s, *signals)
        for signals in zip(
            sent_rad_s[1:].T, positions_rad.T, robot.joint_names, strict=True
        )
    ]
