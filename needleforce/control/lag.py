"""The delay from command to measured motion, and the largest gain that it allows.

An arm that is commanded velocities v follows its commanded positions x late:

    q(t) = a + b t + c x(t - T),    x = integral of v

A loop v = K (g - q), sampled every h, sees the delay T and half a cycle of holding:

    L(s) = K exp(-s (T + h / 2)) / s

It crosses gain one at K and is stable for K (T + h / 2) < pi / 2; its phase margin is
pi / 2 - K (T + h / 2). So with a margin phi, and T taken two deviations later:

    K_safe = (pi / 2 - phi) / (T + 2 sigma + h / 2)
"""

import math
from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import minimize_scalar

from foundation.arrays import Array
from needleforce.control.controller import Command, Controller
from needleforce.control.delay_prediction import MAX_DELAY_s
from needleforce.control.errors import ControlError, SettingError
from needleforce.control.joint_limits import Limits
from needleforce.control.ports import ArmSample
from needleforce.control.setting_checks import require_positive
from needleforce.control.tasks import JointVelocity
from urdf import Robot

PHASE_MARGIN_deg = 55.0
"""phi: K times the delay is then 0.61. Errors decay without a swing up to 1 / e, and
overshoot by a twentieth at most here."""

SAFE_DEVIATIONS = 2.0
"""So many deviations later than measured the delay is taken."""

MIN_DELAY_s = -0.01
"""Noise may make a delay of zero negative."""

COARSE_STEP_s = 2e-3
"""Of the delays that are tried before the best is refined."""

WINDOWS = 4
"""Parts of the chirp in which the delay is measured anew: slow to quick motion."""

MIN_FOLLOWED = 0.5
"""An arm that moves by less of its commands has not followed them. A soft servo makes
0.7 of quick ones."""

MAX_FOLLOWED = 1.2
"""An arm that moves by more was moved by something else."""

MIN_EXPLAINED = 0.8
"""Fraction of a joint's motion that the command must explain."""

POSTURE_MARGIN_rad = 0.05
"""A joint must be so far from its limits, besides what the chirp takes."""

MAX_STRAY = 3.0
"""A joint that is so many times the chirp's excursion off its start is pushed or runs
away: the measurement stops."""

MIN_STRAY_rad = 5e-3
"""The same for a small chirp."""

REFINED_STEPS = 5.0
"""So many coarse steps either way the best delay is refined: noise may have put it a
few steps off."""

NO_MOTION_rad2 = 1e-24
"""Sum of squared motions, or of squared speeds, at least: what does not move leaves
ratios finite."""

MIN_REACH_m_per_rad = 1e-9
"""Motion of the tip by all joints, at least: keeps the amplitude finite."""


class Delay(NamedTuple):
    """The delay of one joint.

    Attributes:
        delay_s: T.
        std_s: Its standard deviation: noise, and how T differs between slow and quick
            motion.
        followed: c, the fraction of the command that the joint has followed.
    """

    delay_s: float
    std_s: float
    followed: float


class SafeGain(NamedTuple):
    """Gains of a P loop over commands of velocity, see the module.

    Attributes:
        safe_per_s: The largest with the phase margin.
        unstable_per_s: From here on, at the measured delay, the loop diverges.
        margin_deg: The phase margin phi.
    """

    safe_per_s: float
    unstable_per_s: float
    margin_deg: float


class ChirpSettings(NamedTuple):
    """How the joints are moved to measure their delay.

    Attributes:
        duration_s: Of the motion.
        first_Hz: Frequency at its start.
        last_Hz: Frequency at its end.
        speed_rad_s: Highest speed of a joint.
        tip_m: Highest sum of the tip's excursions from the single joints.
        ramp_s: Time of a smooth beginning and end.
        rest_s: Time of listening before and after it.
    """

    duration_s: float = 3.0
    first_Hz: float = 1.0
    last_Hz: float = 6.0
    speed_rad_s: float = 0.03
    tip_m: float = 5e-3
    ramp_s: float = 0.3
    rest_s: float = 0.3


USUAL_CHIRP = ChirpSettings()
"""What the command uses."""


def find_safe_gain(
    delay: Delay, cycle_s: float, margin_deg: float = PHASE_MARGIN_deg
) -> SafeGain:
    """Return the largest gain that a delay allows, see the module.

    Raises:
        SettingError: The cycle is not positive, or the margin not within 0 to 90.
    """
    require_positive({"cycle_s": cycle_s})
    if not 0.0 < margin_deg < 90.0:
        raise SettingError(
            f"margin_deg is {margin_deg!r}, expected degrees between 0 and 90"
        )
    delay_s = max(delay.delay_s, 0.0) + 0.5 * cycle_s
    late_s = delay_s + SAFE_DEVIATIONS * delay.std_s
    return SafeGain(
        safe_per_s=(0.5 * math.pi - math.radians(margin_deg)) / late_s,
        unstable_per_s=0.5 * math.pi / delay_s,
        margin_deg=margin_deg,
    )


def measure_delay(
    times_s: Array, command_rad_s: Array, q_rad: Array, joint: str = "the joint"
) -> Delay:
    """Measure the delay of one joint by least squares, see the module.

    Args:
        times_s: Of the samples, shape (m,).
        command_rad_s: Velocity that was sent after each sample, until the next one,
            shape (m,).
        q_rad: Positions, shape (m,).
        joint: Name of the joint, for messages.

    Raises:
        ControlError: The joint has not followed its commands.
    """
    steps_s = np.diff(times_s)
    commanded_rad = np.concatenate(([0.0], np.cumsum(command_rad_s[:-1] * steps_s)))
    path = _Path(times_s, commanded_rad, q_rad)
    delay_s = path.find_delay()
    fit = path.fit(delay_s)
    explained = 1.0 - fit.left_rad.var() / max(fit.moved_rad.var(), NO_MOTION_rad2)
    if not (MIN_FOLLOWED < fit.followed < MAX_FOLLOWED and explained > MIN_EXPLAINED):
        raise ControlError(
            f"{joint} moved by {100.0 * fit.followed:.0f} % of its commands, which "
            f"explain {100.0 * max(explained, 0.0):.0f} % of its motion: expected an "
            "arm that follows velocities and that nothing touches",
            "Let the arm take commands, with nothing touching it, away from "
            "its limits.",
        )
    noise_s = fit.noise_of_delay(np.gradient(commanded_rad, times_s))
    parts = np.array_split(np.flatnonzero(command_rad_s), WINDOWS)
    delays_s = [path.within(part).find_delay(delay_s) for part in parts if part.size]
    spread_s = float(np.std(delays_s))
    return Delay(delay_s, math.hypot(noise_s, spread_s), fit.followed)


class _Fit(NamedTuple):
    """A path fitted at a delay.

    Attributes:
        followed: c.
        left_rad: What the command does not explain, shape (m,).
        moved_rad: Motion without its straight part, shape (m,).
    """

    followed: float
    left_rad: Array
    moved_rad: Array

    def noise_of_delay(self, speed_rad_s: Array) -> float:
        """Return the deviation of T that what is left over makes.

        sigma^2 = rms(r)^2 (1 + rho) / (1 - rho) / sum(x'^2),    rho of lag one
        """
        left = self.left_rad
        power = max(float(left @ left), NO_MOTION_rad2)
        rho = min(max(float(left[1:] @ left[:-1]) / power, 0.0), 0.99)
        variance = power / left.size * (1.0 + rho) / (1.0 - rho)
        return math.sqrt(
            variance / max(float(speed_rad_s @ speed_rad_s), NO_MOTION_rad2)
        )


class _Path(NamedTuple):
    """Commanded and measured positions of a joint.

    Attributes:
        times_s: Of the samples, shape (m,).
        commanded_rad: x at those times, shape (m,).
        q_rad: q at those times, shape (m,).
        rows: Indices of the samples that are compared; None for all.
    """

    times_s: Array
    commanded_rad: Array
    q_rad: Array
    rows: NDArray[np.intp] | None = None

    def within(self, rows: NDArray[np.intp]) -> "_Path":
        """Return the same, compared at some samples."""
        return self._replace(rows=rows)

    def fit(self, delay_s: float) -> _Fit:
        """Fit a, b and c at a delay."""
        rows = np.arange(self.times_s.size) if self.rows is None else self.rows
        times_s = self.times_s[rows]
        moved_rad = self.q_rad[rows]
        late_rad = np.interp(times_s - delay_s, self.times_s, self.commanded_rad)
        straight = np.column_stack((np.ones(times_s.size), times_s - times_s.mean()))
        basis, _ = np.linalg.qr(straight)
        late_rad = late_rad - basis @ (basis.T @ late_rad)
        moved_rad = moved_rad - basis @ (basis.T @ moved_rad)
        power = max(float(late_rad @ late_rad), NO_MOTION_rad2)
        followed = float(late_rad @ moved_rad) / power
        return _Fit(followed, moved_rad - followed * late_rad, moved_rad)

    def find_delay(self, near_s: float | None = None) -> float:
        """Return the delay that leaves least over; near another one if it is given."""

        def find_left(delay_s: float) -> float:
            left_rad = self.fit(delay_s).left_rad
            return float(left_rad @ left_rad)

        if near_s is None:
            tried_s = np.arange(MIN_DELAY_s, MAX_DELAY_s, COARSE_STEP_s)
            near_s = float(tried_s[np.argmin([find_left(delay) for delay in tried_s])])
        width_s = REFINED_STEPS * COARSE_STEP_s
        # The square of what is left, relative to a step of the delay, may be tiny.
        scale = 1.0 / max(find_left(near_s + width_s), NO_MOTION_rad2)
        best = minimize_scalar(
            lambda delay_s: scale * find_left(delay_s),
            bounds=(near_s - width_s, near_s + width_s),
            method="bounded",
            options={"xatol": 1e-6},
        )
        return float(best.x)


class ProbeState(StrEnum):
    """How far a measurement of the delay has come."""

    WAITING = "waiting"  # for the arm to take commands
    MOVING = "moving"
    DONE = "done"
    FAILED = "failed"  # see `LagProbe.reason`


class LagProbe:
    """Moves all joints by a small chirp, and measures the delay of each.

        v(t) = V w(t) sin(2 pi (f_0 t + (f_1 - f_0) t^2 / 2 D))

    with w smooth at both ends. Call `update`, send its velocity, then `note_sent`.

    Args:
        robot: The arm.
        limits: What its joints may do.
        chirp: The motion.

    Attributes:
        state: How far it has come.
        reason: Why it has failed; empty otherwise.
        speed_rad_s: V of every joint; zero before the first sample.
    """

    def __init__(
        self, robot: Robot, limits: Limits, chirp: ChirpSettings = USUAL_CHIRP
    ) -> None:
        require_positive(chirp._asdict())
        self.state = ProbeState.WAITING
        self.reason = ""
        self.speed_rad_s = 0.0
        self._robot = robot
        self._controller = Controller(robot, limits)
        self._chirp = chirp
        self._start_rad = np.zeros(0)  # empty before the first sample
        self._moving_s = 0.0
        self._times_s: list[float] = []
        self._commands_rad_s: list[Array] = []
        self._positions_rad: list[Array] = []

    def update(self, sample: ArmSample) -> Command:
        """Return the command for the coming cycle; at rest once it is over."""
        if not self._start_rad.size:
            self._begin(sample.q_rad)
        elif self.state is ProbeState.MOVING:
            self._moving_s += sample.dt_s
            self._record(sample)
        velocity_rad_s = self._speed_at(self._moving_s)
        joints = np.full(self._robot.nv, velocity_rad_s)
        return self._controller.update(sample, [JointVelocity(joints)])

    def note_sent(self, command: Command, *, is_accepted: bool) -> None:
        """Note whether the arm has taken the command of this cycle."""
        if self.state is ProbeState.WAITING and is_accepted:
            self.state = ProbeState.MOVING
            self._times_s.append(0.0)
            self._positions_rad.append(self._controller.tool.q_rad.copy())
        elif self.state is ProbeState.MOVING and not is_accepted:
            self._fail("the arm has refused a command while it was measured")
        if self.state is ProbeState.MOVING:
            self._commands_rad_s.append(command.dq_rad_s)

    def measure(self) -> list[Delay]:
        """Return the delay of every joint.

        Raises:
            ControlError: It is not done, or a joint has not followed its commands.
        """
        if self.state is not ProbeState.DONE:
            raise ControlError(
                f"the delay is not measured: {self.reason or self.state}",
                "Let the arm take commands, with nothing touching it, away "
                "from its limits.",
            )
        count = len(self._commands_rad_s)
        times_s = np.array(self._times_s[:count])
        commands_rad_s = np.array(self._commands_rad_s)
        positions_rad = np.array(self._positions_rad[:count])
        return [
            measure_delay(
                times_s, commands_rad_s[:, joint], positions_rad[:, joint], name
            )
            for joint, name in enumerate(self._robot.joint_names)
        ]

    @property
    def cycle_s(self) -> float:
        """Usual time between two samples."""
        return float(np.median(np.diff(self._times_s)))

    def _begin(self, q_rad: Array) -> None:
        """Choose the amplitude for a posture, and refuse one without room."""
        chirp = self._chirp
        self._start_rad = np.array(q_rad, dtype=np.float64)
        tool = self._controller.tool
        tool.update(self._start_rad)
        reach_m_per_rad = float(np.linalg.norm(tool.jacobian[:3], axis=0).sum())
        slowest_rad_s = 2.0 * np.pi * chirp.first_Hz
        by_tip_rad_s = (
            slowest_rad_s * chirp.tip_m / max(reach_m_per_rad, MIN_REACH_m_per_rad)
        )
        self.speed_rad_s = min(chirp.speed_rad_s, by_tip_rad_s)
        room_rad = np.minimum(
            self._start_rad - self._robot.position_lower_rad,
            self._robot.position_upper_rad - self._start_rad,
        )
        if (room_rad < POSTURE_MARGIN_rad + self.excursion_rad).any():
            joint = self._robot.joint_names[int(np.argmin(room_rad))]
            self._fail(
                f"{joint} is {room_rad.min():.3f} rad from its limit: move it at least "
                f"{POSTURE_MARGIN_rad + self.excursion_rad:.3f} rad away"
            )

    @property
    def excursion_rad(self) -> float:
        """How far a joint moves at most, from its start: 2 V / (2 pi f_0)."""
        return 2.0 * self.speed_rad_s / (2.0 * math.pi * self._chirp.first_Hz)

    def _record(self, sample: ArmSample) -> None:
        """Record a sample, and see whether the motion is over or out of hand."""
        q_rad = np.array(sample.q_rad, dtype=np.float64)
        self._times_s.append(self._moving_s)
        self._positions_rad.append(q_rad)
        strays_rad = np.abs(q_rad - self._start_rad)
        stray_rad = float(strays_rad.max())
        max_stray_rad = max(MAX_STRAY * self.excursion_rad, MIN_STRAY_rad)
        if not stray_rad < max_stray_rad:
            joint = self._robot.joint_names[int(strays_rad.argmax())]
            self._fail(
                f"{joint} is {stray_rad:.3f} rad off its start, expected less than "
                f"{max_stray_rad:.3f}: something moves the arm, or it runs away"
            )
        elif self._moving_s > self._chirp.duration_s + 2.0 * self._chirp.rest_s:
            self.state = ProbeState.DONE

    def _fail(self, reason: str) -> None:
        """End the motion, and keep why."""
        self.state = ProbeState.FAILED
        self.reason = reason

    def _speed_at(self, moving_s: float) -> float:
        """Return the chirp's velocity at a time since its begin; zero outside."""
        chirp = self._chirp
        time_s = moving_s - chirp.rest_s
        if self.state is not ProbeState.MOVING or not 0.0 < time_s < chirp.duration_s:
            return 0.0
        to_end_s = min(time_s, chirp.duration_s - time_s)
        window = math.sin(0.5 * math.pi * min(to_end_s / chirp.ramp_s, 1.0)) ** 2
        sweep_Hz_per_s = (chirp.last_Hz - chirp.first_Hz) / chirp.duration_s
        turns = chirp.first_Hz * time_s + 0.5 * sweep_Hz_per_s * time_s**2
        return self.speed_rad_s * window * math.sin(2.0 * math.pi * turns)
