"""A hand drives the needle in closed loop on the simulated arm.

The arm tares over a free stroke and stops above
the tissue; then a hand takes over, which moves inwards in strokes of what a haptic
device reaches, with the clutch open while it goes back.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import ArmSample, ArmTruth, SimulatedArm
from groundtruth.rig_line import DelayLine
from groundtruth.rig_operator import HapticMaster, Operator
from groundtruth.tissue import Rupture
from needleforce import InsertionSession, SessionEstimate
from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    HandleWatch,
    Limits,
    Posture,
    Teleoperation,
)
from needleforce.control.teleoperation import Shown
from residual import DEFAULT, SensorConfig

TARE_STROKE_M = 60e-3
"""Free stroke over which the arm tares [m]."""

STANDOFF_M = TARE_STROKE_M + 5e-3
"""Distance to the tissue at the start [m]; less the stroke, at its end."""

HAND_STROKE_M = 0.15
"""Reach of a haptic device [m]."""

BACK_S = 1.0
"""Time in which the hand goes back between two strokes, clutch open [s]."""


class HandWish(NamedTuple):
    """What the hand wants at an instant.

    Attributes:
        position_m: Where it wants to be along the needle [m].
        pedal_down: Whether the pedal is down, so that the needle follows.
    """

    position_m: float
    pedal_down: bool


class HandPlan(NamedTuple):
    """Where the hand wants to be over time, and whether its pedal is down.

    Attributes:
        needle_speed_m_s: Speed of the needle while the hand goes forward [m/s].
        needle_travel_m: Travel of the needle over all strokes [m].
        scale: Needle travel per travel of the hand.
    """

    needle_speed_m_s: float
    needle_travel_m: float
    scale: float

    @property
    def strokes(self) -> int:
        """How often the hand reaches forward."""
        return int(np.ceil(self.needle_travel_m / self.scale / HAND_STROKE_M))

    @property
    def duration_s(self) -> float:
        """Time of all strokes and of the ways back between them [s]."""
        return (
            self.needle_travel_m / self.needle_speed_m_s + (self.strokes - 1) * BACK_S
        )

    def at(self, t_s: float) -> HandWish:
        """Return what the hand wants after a time [s]."""
        stroke_m = self.needle_travel_m / self.scale / self.strokes
        forward_s = stroke_m * self.scale / self.needle_speed_m_s
        stroke = min(int(t_s / (forward_s + BACK_S)), self.strokes - 1)
        within_s = max(t_s, 0.0) - stroke * (forward_s + BACK_S)
        if within_s <= forward_s or stroke == self.strokes - 1:
            position_m = stroke_m * min(within_s / forward_s, 1.0)
            return HandWish(position_m, pedal_down=True)
        # It moves for 0.8 of that time.
        back = min((within_s - forward_s) / (0.8 * BACK_S), 1.0)
        position_m = stroke_m * (0.5 + 0.5 * np.cos(np.pi * back))
        return HandWish(position_m, pedal_down=False)


@dataclass(kw_only=True)
class Teleinsertion:
    """What happened while the hand drove the needle; lists have one row per tick.

    Attributes:
        t_s: Time [s].
        depth_m: Position of the true tip along the needle [m].
        tip_N: True force at the tip [N].
        raw_N: Axial force as the virtual sensor measures it [N].
        shown_N: Force that is sent to be felt [N].
        alarms_s: Times of the rupture alarms [s].
        least_energy_J: The least true energy at the hand's port, at every instant of
            the device [J].
        drift_m: Travel of the needle beyond what the hand asked for [m].
        ruptures: The true ruptures.
    """

    t_s: list[float] = field(default_factory=list)
    depth_m: list[float] = field(default_factory=list)
    tip_N: list[float] = field(default_factory=list)
    raw_N: list[float] = field(default_factory=list)
    shown_N: list[float] = field(default_factory=list)
    alarms_s: list[float] = field(default_factory=list)
    least_energy_J: float = 0.0
    drift_m: float = 0.0
    ruptures: tuple[Rupture, ...] = ()

    def rows(self, name: str) -> np.ndarray:
        """Return one of the lists as an array."""
        return np.array(getattr(self, name))

    def add(self, truth: ArmTruth, estimate: SessionEstimate, shown_N: float) -> None:
        """Add a row."""
        self.t_s.append(truth.t_s)
        self.depth_m.append(float(truth.tip_m @ truth.rotation[:, 2]))
        self.tip_N.append(truth.tissue.tip_N)
        self.raw_N.append(estimate.wrench.axial)
        self.shown_N.append(shown_N)
        has_alarm = estimate.identification.rupture is not None
        if estimate.used_for_identification and has_alarm:
            self.alarms_s.append(truth.t_s)


class _TareStroke:
    """The free stroke over which a session is tared, and the tare at its end."""

    def __init__(self, session: InsertionSession) -> None:
        self._session = session
        self._rest_s = 0.0

    def speed_m_s(self, estimate: SessionEstimate, t_s: float) -> float:
        """Return the speed along the needle [m/s]; tare after a rest at the end.

        It rises to 20 mm/s in 0.3 s, and is 8 / s of the remaining way at the end,
        which is reached at 0.2 mm.
        """
        remaining_m = TARE_STROKE_M - estimate.depth_m
        if remaining_m > 2e-4:
            return float(min(20e-3 * min(t_s / 0.3, 1.0), 8.0 * remaining_m))
        self._rest_s += 1e-3  # a tick of the simulated arm
        if self._rest_s >= 0.4:
            self._session.tare()
        return 0.0


class _HandLoop:
    """The closed loop of hand, delayed lines, session and controller."""

    def __init__(
        self,
        arm: SimulatedArm,
        hand: HandPlan,
        master: HapticMaster,
        teleoperation: Teleoperation,
        sensor: SensorConfig,
    ) -> None:
        self.run = Teleinsertion()
        self._arm = arm
        self._hand = hand
        self._master = master
        self._teleoperation = teleoperation
        self._handle_watch = HandleWatch()
        self._session = InsertionSession(arm.robot, sensor)
        self._stroke = _TareStroke(self._session)
        self._controller = Controller(arm.robot, Limits.of_arm(arm.robot, arm.preset))
        self._controller.tool.update(arm.home_rad)
        self._shaft = Fixture.here(self._controller.tool)
        self._posture = Posture(arm.home_rad)
        self._asked_m = 0.0
        self._end_s = np.inf

    @property
    def is_over(self) -> bool:
        """Whether all strokes, and the time after them, have passed."""
        return self._arm.time_s > self._end_s

    def update(self, sample: ArmSample) -> None:
        """Do one tick: the tare stroke, then the hand."""
        estimate = self._session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        if self._session.tared:
            speed_m_s = self._follow_hand(estimate, sample.dt_s)
        else:
            # After its tare the estimate at hand still counts depth from before.
            speed_m_s = self._stroke.speed_m_s(estimate, self._arm.time_s)
        tasks = [self._shaft, AxialSpeed(speed_m_s), self._posture]
        self._arm.send(self._controller.update(sample, tasks).dq_rad_s)

    def finish(self) -> Teleinsertion:
        """Return what happened."""
        run = self.run
        run.least_energy_J = self._master.least_energy_J
        run.drift_m = run.depth_m[-1] - run.depth_m[0] - self._asked_m
        run.ruptures = self._arm.tissue_truth().ruptures
        return run

    def _follow_hand(self, estimate: SessionEstimate, dt_s: float) -> float:
        """Return the speed that the hand asks for [m/s], and let it feel the force."""
        master = self._master
        # 1.5 s after the last stroke.
        end_s = self._arm.time_s + self._hand.duration_s + 1.5
        self._end_s = min(self._end_s, end_s)
        master.clutch = self._hand.at(master.time_s).pedal_down
        position_m = master.position_m[2]
        command = self._teleoperation.update(
            self._handle_watch.update(master.read(), dt_s), estimate, dt_s
        )
        moved_m = master.position_m[2] - position_m
        self._asked_m += self._hand.scale * moved_m * master.clutch
        master.render(command.force_N)
        self.run.add(self._arm.truth, estimate, self._teleoperation.shown_N)
        return command.speed_m_s


def teleoperate(
    arm: SimulatedArm,
    hand: HandPlan,
    *,
    seed: int = 0,
    shown: Shown = "tip",
    delay_s: float = 0.0,
    operator: Callable[[Callable], Operator] = lambda wish: Operator(wish_m=wish),
    sensor: SensorConfig = DEFAULT,
) -> Teleinsertion:
    """Tare over a stroke, then let a hand drive the needle.

    Args:
        arm: The arm; it starts `STANDOFF_M` above the tissue.
        hand: Where the hand wants to be.
        seed: Seed of the jitter of the lines.
        shown: Which force is sent to be felt.
        delay_s: Delay of the lines between hand and arm, each way [s].
        operator: Makes a hand of its wish over time.
        sensor: Settings of the virtual sensor.
    """
    rng = np.random.default_rng(seed)
    jitter_s = min(5e-3, delay_s)
    to_arm = DelayLine(delay_s, jitter_s, rng)
    to_hand = DelayLine(delay_s, jitter_s, rng)
    teleoperation = Teleoperation(
        motion_scale=hand.scale,
        shown=shown,
        force_lag_s=1.0 / sensor.slowest_gain_per_s,
        lines=(to_arm, to_hand),
    )
    master = HapticMaster(operator(lambda t_s: (0.0, 0.0, hand.at(t_s).position_m)))
    loop = _HandLoop(arm, hand, master, teleoperation, sensor)
    for sample in arm:
        loop.update(sample)
        if loop.is_over:
            break
    return loop.finish()


class RuptureFelt(NamedTuple):
    """One rupture as it was shown to the hand.

    Attributes:
        shown_drop: Fall of the shown force over the force before it.
        raw_drop: The same of the measured force.
        error_N: Error of the shown force before it, against the true tip force [N].
        delay_s: Time until the alarm [s]; nan without one.
    """

    shown_drop: float
    raw_drop: float
    error_N: float
    delay_s: float


BEFORE_TICKS = 100
"""Ticks before a rupture over which forces are averaged."""


def ruptures_felt(run: Teleinsertion) -> list[RuptureFelt]:
    """Return how each rupture inside the tissue was shown to the hand."""
    felt: list[RuptureFelt] = []
    t_s = run.rows("t_s")
    shown_N = run.rows("shown_N")
    raw_N = run.rows("raw_N")
    error_N = shown_N - run.rows("tip_N")
    for rupture in run.ruptures:
        start = int(np.searchsorted(t_s, rupture.onset_s))
        if rupture.layer == 0 or not BEFORE_TICKS < start < len(t_s) - 1:
            continue
        end = int(np.searchsorted(t_s, rupture.end_s)) + 250
        before = slice(start - BEFORE_TICKS, start)
        after = slice(start, end)
        felt.append(
            RuptureFelt(
                shown_drop=_drop(shown_N[before], shown_N[after]),
                raw_drop=_drop(raw_N[before], raw_N[after]),
                error_N=float(np.mean(error_N[before])),
                delay_s=_alarm_delay_s(run.rows("alarms_s"), rupture.onset_s),
            )
        )
    return felt


def _drop(before_N: Array, after_N: Array) -> float:
    """Return the fall of a force over its mean before a rupture."""
    # The least mean of 20 ticks; a force below 0.05 N would make the fall infinite.
    least_N = np.convolve(after_N, np.full(20, 1.0 / 20), "valid").min()
    return float(1.0 - max(least_N, 0.0) / max(before_N.mean(), 0.05))


def _alarm_delay_s(alarms_s: Array, onset_s: float) -> float:
    """Return the time from a rupture to its alarm [s]; nan without one."""
    # A later one is not of the rupture.
    is_of_rupture = (alarms_s >= onset_s) & (alarms_s < onset_s + 0.6)
    if not is_of_rupture.any():
        return float("nan")
    return float(alarms_s[is_of_rupture][0] - onset_s)
