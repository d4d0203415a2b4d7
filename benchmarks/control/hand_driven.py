"""A hand drives the needle in closed loop on the simulated arm.

The arm tares over a free stroke and stops above
the tissue; then a hand takes over, which moves inwards in strokes of what a haptic
device reaches, with the clutch open while it goes back.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from groundtruth.rig_arm import ArmSample, SimulatedArm
from groundtruth.rig_line import DelayLine
from groundtruth.rig_operator import HapticMaster, random_operator
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
from residual import SensorConfig

TARE_STROKE_M = 60e-3
"""Free stroke over which the arm tares [m]."""

STANDOFF_M = TARE_STROKE_M + 5e-3
"""Distance to the tissue at the start [m]; less the stroke, at its end."""

HAND_STROKE_M = 0.15
"""Reach of a haptic device [m]."""

BACK_S = 1.0
"""Time in which the hand goes back between two strokes, clutch open [s]."""


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

    def at(self, t_s: float) -> tuple[float, bool]:
        """Return what the hand wants after a time [s].

        Returns:
            Where it wants to be along the needle [m], and whether the pedal is down, so
            that the needle follows.
        """
        stroke_m = self.needle_travel_m / self.scale / self.strokes
        forward_s = stroke_m * self.scale / self.needle_speed_m_s
        stroke = min(int(t_s / (forward_s + BACK_S)), self.strokes - 1)
        within_s = max(t_s, 0.0) - stroke * (forward_s + BACK_S)
        if within_s <= forward_s or stroke == self.strokes - 1:
            return stroke_m * min(within_s / forward_s, 1.0), True
        # It moves for 0.8 of that time.
        back = min((within_s - forward_s) / (0.8 * BACK_S), 1.0)
        return stroke_m * (0.5 + 0.5 * np.cos(np.pi * back)), False


class Teleinsertion(NamedTuple):
    """What happened in n ticks while the hand drove the needle.

    Attributes:
        t_s: Time [s], shape (n,).
        tip_N: True force at the tip [N], shape (n,).
        raw_N: Axial force as the virtual sensor measures it [N], shape (n,).
        shown_N: Force that is sent to be felt [N], shape (n,).
        alarms_s: Times of the rupture alarms [s].
        ruptures: The true ruptures.
        least_energy_J: The least true energy at the hand's port, at every instant of
            the device [J].
        drift_m: Travel of the needle beyond what the hand asked for [m].
    """

    t_s: Array
    tip_N: Array
    raw_N: Array
    shown_N: Array
    alarms_s: Array
    ruptures: tuple[Rupture, ...]
    least_energy_J: float = 0.0
    drift_m: float = 0.0


class _Needle:
    """An arm that moves along its needle only, and the session that it feeds."""

    def __init__(self, arm: SimulatedArm, sensor: SensorConfig) -> None:
        self._arm = arm
        self._session = InsertionSession(arm.robot, sensor)
        self._controller = Controller(arm.robot, Limits.of_arm(arm.robot, arm.preset))
        self._controller.tool.update(arm.home_rad)
        self._shaft = Fixture.here(self._controller.tool)
        self._posture = Posture(arm.home_rad)

    def estimate(self, sample: ArmSample) -> SessionEstimate:
        """Return what the session makes of a sample."""
        return self._session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )

    def advance(self, sample: ArmSample, speed_m_s: float) -> None:
        """Command a speed along the needle."""
        tasks = [self._shaft, AxialSpeed(speed_m_s), self._posture]
        self._arm.send(self._controller.update(sample, tasks).dq_rad_s)

    def tare(self) -> None:
        """Make the free stroke, and tare the session after a rest at its end.

        The speed rises to 20 mm/s in 0.3 s, and is 8 / s of the remaining way at the
        end, which is reached at 0.2 mm.
        """
        rest_s = 0.0
        for sample in self._arm:
            remaining_m = TARE_STROKE_M - self.estimate(sample).depth_m
            if remaining_m > 2e-4:
                begun_m_s = 20e-3 * min(self._arm.time_s / 0.3, 1.0)
                self.advance(sample, min(begun_m_s, 8.0 * remaining_m))
                continue
            self.advance(sample, 0.0)
            rest_s += 1e-3  # a tick of the simulated arm
            if rest_s >= 0.4:
                self._session.tare()
                return


def teleoperate(
    arm: SimulatedArm,
    hand: HandPlan,
    rng: np.random.Generator,
    *,
    seed: int,
    shown: Shown,
    delay_s: float,
    sensor: SensorConfig,
) -> Teleinsertion:
    """Tare over a stroke, then let a hand drive the needle.

    Args:
        arm: The arm; it starts `STANDOFF_M` above the tissue.
        hand: Where the hand wants to be.
        rng: Source of the hand's stiffness and mass.
        seed: Seed of the jitter of the lines.
        shown: Which force is sent to be felt.
        delay_s: Delay of the lines between hand and arm, each way [s].
        sensor: Settings of the virtual sensor.
    """
    of_lines = np.random.default_rng(seed)
    delay = (delay_s, min(5e-3, delay_s), of_lines)  # with jitter
    teleoperation = Teleoperation(
        motion_scale=hand.scale,
        shown=shown,
        force_lag_s=1.0 / sensor.slowest_gain_per_s,
        lines=(DelayLine(*delay), DelayLine(*delay)),
    )
    master = HapticMaster(random_operator(lambda t_s: (0.0, 0.0, hand.at(t_s)[0]), rng))
    handle_watch = HandleWatch()
    needle = _Needle(arm, sensor)
    needle.tare()
    rows: list[tuple[float, ...]] = []
    alarms_s: list[float] = []
    asked_m = 0.0
    end_s = math.inf
    for sample in arm:
        estimate = needle.estimate(sample)
        _, master.clutch = hand.at(master.time_s)
        position_m = master.position_m[2]
        command = teleoperation.update(
            handle_watch.update(master.read(), sample.dt_s), estimate, sample.dt_s
        )
        moved_m = master.position_m[2] - position_m
        asked_m += hand.scale * moved_m * master.clutch
        master.render(command.force_N)
        truth = arm.truth
        depth_m = float(truth.tip_m @ truth.rotation[:, 2])
        forces_N = truth.tissue.tip_N, estimate.wrench.axial, teleoperation.shown_N
        rows.append((truth.t_s, depth_m, *forces_N))
        has_alarm = estimate.identification.rupture is not None
        if estimate.used_for_identification and has_alarm:
            alarms_s.append(truth.t_s)
        needle.advance(sample, command.speed_m_s)
        end_s = min(end_s, arm.time_s + hand.duration_s + 1.5)  # a while after it
        if arm.time_s > end_s:
            break
    t_s, depths_m, tip_N, raw_N, shown_N = np.array(rows).T.copy()
    return Teleinsertion(
        t_s=t_s,
        tip_N=tip_N,
        raw_N=raw_N,
        shown_N=shown_N,
        alarms_s=np.array(alarms_s),
        ruptures=arm.tissue_truth().ruptures,
        least_energy_J=master.least_energy_J,
        drift_m=depths_m[-1] - depths_m[0] - asked_m,
    )


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


def ruptures_felt(run: Teleinsertion) -> Iterator[RuptureFelt]:
    """Yield how each rupture inside the tissue was shown to the hand."""
    ticks = 100  # before a rupture, over which forces are averaged
    for rupture in run.ruptures:
        start = int(np.searchsorted(run.t_s, rupture.onset_s))
        if rupture.layer == 0 or not ticks < start < len(run.t_s) - 1:
            continue
        end = int(np.searchsorted(run.t_s, rupture.end_s)) + 250
        before = slice(start - ticks, start)
        after = slice(start, end)
        error_N = run.shown_N[before] - run.tip_N[before]
        yield RuptureFelt(
            shown_drop=_drop(run.shown_N[before], run.shown_N[after]),
            raw_drop=_drop(run.raw_N[before], run.raw_N[after]),
            error_N=float(np.mean(error_N)),
            delay_s=_alarm_delay_s(run.alarms_s, rupture.onset_s),
        )


def _drop(before_N: Array, after_N: Array) -> float:
    """Return the fall of a force over its mean before a rupture."""
    # The least mean of 20 ticks; a force below 0.05 N would make the fall infinite.
    least_N = np.convolve(after_N, np.full(20, 1.0 / 20), "valid").min()
    return float(1.0 - max(least_N, 0.0) / max(before_N.mean(), 0.05))


def _alarm_delay_s(alarms_s: Array, onset_s: float) -> float:
    """Return the time from a rupture to its alarm [s]; nan without one."""
    # A later one is not of the rupture.
    is_of_rupture = (alarms_s >= onset_s) & (alarms_s < onset_s + 0.6)
    first = alarms_s[is_of_rupture][:1]
    return float(first[0] - onset_s) if first.size else math.nan
