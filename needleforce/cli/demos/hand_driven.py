"""Closed loops on the simulated arm that demonstrations and benchmarks share: a
hand-driven needle.

The arm tares over a free stroke and stops above the tissue; then a hand takes over,
whose wish goes inwards in strokes of what a haptic device reaches, with the clutch open
while it goes back.
"""

from collections.abc import Callable
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from groundtruth.rig_arm import ArmTruth, SimulatedArm
from groundtruth.rig_line import DelayLine
from groundtruth.rig_operator import HapticMaster, Operator
from groundtruth.tissue import Rupture
from needleforce import InsertionSession, SessionEstimate
from needleforce.control import (
    AxialSpeed,
    Controller,
    Fixture,
    Limits,
    Posture,
    Teleoperation,
)
from needleforce.control.teleoperation import Shown
from residual import DEFAULT, SensorConfig

TARE_STROKE_M = 60e-3


GAP_M = 5e-3


TARE_SPEED_M_S = 20e-3


STANDOFF_M = TARE_STROKE_M + GAP_M


HAND_STROKE_M = 0.15


BACK_S = 1.0


JITTER_s = 5e-3


TICK_s = 1e-3


SETTLE_S = 1.5


class HandPlan(NamedTuple):
    """Where the hand wants to be over time, and whether its pedal is down.

    Attributes:
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
        """Of all strokes and the ways back between them."""
        return (
            self.needle_travel_m / self.needle_speed_m_s + (self.strokes - 1) * BACK_S
        )

    def at(self, t_s: float) -> tuple[float, bool]:
        """Place of the wish [m] and the pedal, after a time."""
        stroke_m = self.needle_travel_m / self.scale / self.strokes
        forward_s = stroke_m * self.scale / self.needle_speed_m_s
        stroke = min(int(t_s / (forward_s + BACK_S)), self.strokes - 1)
        within_s = max(t_s, 0.0) - stroke * (forward_s + BACK_S)
        if within_s <= forward_s or stroke == self.strokes - 1:
            return stroke_m * min(within_s / forward_s, 1.0), True
        back = min((within_s - forward_s) / (0.8 * BACK_S), 1.0)
        return stroke_m * (0.5 + 0.5 * np.cos(np.pi * back)), False


@dataclass(kw_only=True)
class Teleinsertion:
    """What happened while the hand drove the needle, one row per tick of 1 ms.

    Attributes:
        tip_N: True.
        raw_N: As the virtual sensor measures it.
        shown_N: What is sent to be felt.
        energy_J: true, at the hand's port.
        is_open: The clutch: the hand goes back.
    """

    t_s: list[float] = field(default_factory=list)
    depth_m: list[float] = field(default_factory=list)
    tip_N: list[float] = field(default_factory=list)
    raw_N: list[float] = field(default_factory=list)
    shown_N: list[float] = field(default_factory=list)
    energy_J: list[float] = field(default_factory=list)
    is_open: list[bool] = field(default_factory=list)
    alarms_s: list[float] = field(default_factory=list)
    least_energy_J: float = 0.0
    drift_m: float = 0.0
    ruptures: tuple[Rupture, ...] = ()

    def rows(self, name: str) -> np.ndarray:
        """One column as an array."""
        return np.array(getattr(self, name))

    def note(
        self,
        truth: ArmTruth,
        estimate: SessionEstimate,
        shown_N: float,
        master: HapticMaster,
    ) -> None:
        """Take a row."""
        self.t_s.append(truth.t_s)
        self.depth_m.append(float(truth.tip_m @ truth.rotation[:, 2]))
        self.tip_N.append(truth.tissue.tip_N)
        self.raw_N.append(estimate.wrench.axial)
        self.shown_N.append(shown_N)
        self.energy_J.append(master.port_energy_J)
        self.is_open.append(not master.clutch)
        if (
            estimate.used_for_identification
            and estimate.identification.rupture is not None
        ):
            self.alarms_s.append(truth.t_s)


class _Approach:
    """Tares over a free stroke; speed until it is done."""

    def __init__(self, session: InsertionSession) -> None:
        self._session = session
        self._rest_s = 0.0

    def speed_m_s(self, estimate: SessionEstimate, t_s: float) -> float:
        """Speed along the needle until the session is tared."""
        left_m = TARE_STROKE_M - estimate.depth_m
        if left_m > 2e-4:
            return float(min(TARE_SPEED_M_S * min(t_s / 0.3, 1.0), 8.0 * left_m))
        self._rest_s += TICK_s
        if self._rest_s >= 0.4:
            self._session.tare()
        return 0.0  # after a tare the estimate at hand still counts depth from before


def teleoperate(
    arm: SimulatedArm,
    hand: HandPlan,
    *,
    seed: int = 0,
    shown: Shown = "tip",
    delay_s: float = 0.0,
    operator: Callable[[Callable], Operator] = lambda wish: Operator(wish_m=wish),
    sensor: SensorConfig = DEFAULT,
    progress: Callable[[float], None] = lambda _: None,
) -> Teleinsertion:
    """Tare over a stroke, then let a hand drive the needle; the arm starts
    `STANDOFF_M` above.
    """
    session = InsertionSession(arm.robot, sensor)
    control = Controller(arm.robot, Limits(arm.robot))
    control.tool.update(arm.home_rad)
    shaft = Fixture.here(control.tool)
    posture = Posture(arm.home_rad)
    rng = np.random.default_rng(seed)
    jitter_s = min(JITTER_s, delay_s)
    lag_s = 1.0 / sensor.slowest_gain_per_s
    lines = DelayLine(delay_s, jitter_s, rng), DelayLine(delay_s, jitter_s, rng)
    tele = Teleoperation(
        motion_scale=hand.scale, shown=shown, force_lag_s=lag_s, lines=lines
    )
    master = HapticMaster(operator(lambda t: (0.0, 0.0, hand.at(t)[0])))
    approach = _Approach(session)
    found = Teleinsertion()
    wanted_m = 0.0
    end_s = np.inf
    for sample in arm:
        estimate = session.update(
            sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s
        )
        speed_m_s = (
            approach.speed_m_s(estimate, arm.time_s) if not session.tared else None
        )
        if session.tared and speed_m_s is None:
            end_s = min(end_s, arm.time_s + hand.duration_s + SETTLE_S)
            master.clutch = hand.at(master.time_s)[1]
            before_m = master.position_m[2]
            move = tele.update(master.read(), estimate, sample.dt_s)
            wanted_m += hand.scale * (master.position_m[2] - before_m) * master.clutch
            master.render(move.force_N)
            speed_m_s = move.speed_m_s
            found.note(arm.truth, estimate, tele.shown_N, master)
            progress(1.0 - (end_s - arm.time_s) / (hand.duration_s + SETTLE_S))
        arm.send(
            control.update(
                sample, [shaft, AxialSpeed(speed_m_s or 0.0), posture]
            ).dq_rad_s
        )
        if arm.time_s > end_s:
            break
    found.least_energy_J = master.least_energy_J
    found.drift_m = found.depth_m[-1] - found.depth_m[0] - wanted_m
    found.ruptures = arm.tissue_truth().ruptures
    return found


class RuptureFelt(NamedTuple):
    """One rupture as it was shown.

    Attributes:
        shown_drop: Fall of the shown force / force before.
        raw_drop: The same of the measured force.
        error_N: Of the shown force before, against the true tip force.
        delay_s: Until the alarm; nan without one.
    """

    shown_drop: float
    raw_drop: float
    error_N: float
    delay_s: float


BEFORE_TICKS = 100


AFTER_TICKS = 250


MEAN_TICKS = 20


LATEST_ALARM_s = 0.6


def ruptures_felt(run: Teleinsertion) -> list[RuptureFelt]:
    """How each rupture inside the tissue was shown."""
    felt = []
    t_s = run.rows("t_s")
    alarms = run.rows("alarms_s")
    for rupture in run.ruptures:
        start = int(np.searchsorted(t_s, rupture.onset_s))
        if rupture.layer == 0 or not BEFORE_TICKS < start < len(t_s) - 1:
            continue
        before = slice(start - BEFORE_TICKS, start)
        after = slice(start, int(np.searchsorted(t_s, rupture.end_s)) + AFTER_TICKS)
        drops = []
        for name in ("shown_N", "raw_N"):
            force = run.rows(name)
            smooth = np.convolve(
                force[after], np.full(MEAN_TICKS, 1.0 / MEAN_TICKS), "valid"
            )
            drops.append(
                float(1.0 - max(smooth.min(), 0.0) / max(force[before].mean(), 0.05))
            )
        error_N = float(
            np.mean(run.rows("shown_N")[before] - run.rows("tip_N")[before])
        )
        late = alarms[
            (alarms >= rupture.onset_s) & (alarms < rupture.onset_s + LATEST_ALARM_s)
        ]
        delay_s = float(late[0] - rupture.onset_s) if len(late) else float("nan")
        felt.append(RuptureFelt(drops[0], drops[1], error_N, delay_s))
    return felt
