"""A simulated insertion: two methods on its joint signals, and the truth beside them.

The methods get joint positions, velocities and torques, as a robot reports them. What
the simulation knows is used for the comparison alone.
"""

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth import Run, Rupture
from groundtruth.rupture_match import nearest_pairs
from identification import (
    MULTILAYER,
    PUBLISHED,
    LayerEstimate,
    MultilayerConfig,
    PublishedConfig,
)
from needleforce.cli.terminal import Progress
from needleforce.session import InsertionSession
from residual import DEFAULT as DEFAULT_SENSOR
from residual import PUBLISHED as PUBLISHED_SENSOR
from residual import SensorConfig, TareError

PUBLISHED_SPEED_s = 0.02
"""Time constant of a low-pass on the speed for the published method, which takes speed
as exact [s]."""

CLOCK_DIGITS = 9
"""Time stamps are whole nanoseconds; differences of their floats are not."""

REPORT_EVERY = 1000
"""Samples between two reports of progress."""


class MethodSettings(NamedTuple):
    """Settings of a whole chain from joint signals to layers.

    Attributes:
        sensor: Settings of the virtual force sensor.
        identifier: Settings of the identification.
        speed_lag_s: Time constant of the low-pass on the speed [s].
    """

    sensor: SensorConfig
    identifier: MultilayerConfig | PublishedConfig
    speed_lag_s: float = 0.0


MULTILAYER_METHOD = MethodSettings(DEFAULT_SENSOR, MULTILAYER)
"""What `InsertionSession` does when nothing is set."""


def published_method(contact_depth_m: float) -> MethodSettings:
    """Return the published method with its published settings.

    Args:
        contact_depth_m: Depth of the surface since the tare, which it assumes known
            [m].
    """
    identifier = replace(PUBLISHED, contact_depth_m=contact_depth_m)
    return MethodSettings(PUBLISHED_SENSOR, identifier, PUBLISHED_SPEED_s)


class Alarm(NamedTuple):
    """A rupture that a method reported.

    Attributes:
        sample: Number of the sample that raised the alarm.
        alarm_s: Time of the alarm on the session's clock, which names its layer [s].
    """

    sample: int
    alarm_s: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class MethodResult:
    """What a method made of n samples.

    Attributes:
        force_N: Force on the needle, shape (n,).
        force_std_N: Its standard deviation, shape (n,).
        tip_N: Force at the tip, shape (n,); zero before the tare.
        tip_std_N: Its standard deviation, shape (n,); NaN where none is stated.
        alarms: The ruptures it reported, in order.
        layers: The layers traversed, as known at the end.
    """

    force_N: Array
    force_std_N: Array
    tip_N: Array
    tip_std_N: Array
    alarms: tuple[Alarm, ...]
    layers: tuple[LayerEstimate, ...]


def begin_session(run: Run, settings: MethodSettings) -> InsertionSession:
    """Return a session for the robot of an insertion; the first one compiles."""
    return InsertionSession(
        run.robot,
        settings.sensor,
        settings.identifier,
        speed_lag_s=settings.speed_lag_s,
    )


def run_session(
    run: Run, session: InsertionSession, progress: Progress
) -> MethodResult:
    """Run a session over the signals of an insertion, tared once in free air.

    Args:
        run: The insertion; only its signals and the end of its free motion are used.
        session: A session that has seen nothing.
        progress: Takes the fraction of the samples that are done.
    """
    signals = run.signals
    count = len(signals.t_s)
    series = np.zeros((4, count))
    alarms: list[Alarm] = []
    steps_s = np.round(np.diff(signals.t_s, prepend=signals.t_s[0]), CLOCK_DIGITS)
    for number, step_s in enumerate(steps_s.tolist()):
        if number % REPORT_EVERY == 0:
            progress(number / count)
        if not session.tared and signals.t_s[number] > run.tare_end_s:
            _tare(session)
        velocity_rad_s = None if signals.dq_rad_s is None else signals.dq_rad_s[number]
        estimate = session.update(
            signals.q_rad[number], velocity_rad_s, signals.tau_Nm[number], step_s
        )
        wrench = estimate.wrench
        layers = estimate.identification
        tip_std_N = layers.tip_force_std_N
        series[:, number] = (
            wrench.axial,
            wrench.axial_std,
            layers.tip_force_N,
            np.nan if tip_std_N is None else tip_std_N,
        )
        if layers.rupture is not None:
            alarms.append(Alarm(number, layers.rupture.alarm_s))
    return MethodResult(
        force_N=series[0],
        force_std_N=series[1],
        tip_N=series[2],
        tip_std_N=series[3],
        alarms=tuple(alarms),
        layers=tuple(session.layers),
    )


def _tare(session: InsertionSession) -> None:
    """Tare, also where the tare's own check takes the free motion for a contact."""
    try:
        session.tare()
    except TareError:
        session.tare(ignore_contact=True)


class FoundRupture(NamedTuple):
    """A true rupture and what a method reported of it.

    Attributes:
        true: The true rupture.
        alarm: The alarm that belongs to it; None if it was missed.
        layer: The layer that it ended, as known at the end; None if it was missed or
            never identified.
    """

    true: Rupture
    alarm: Alarm | None
    layer: LayerEstimate | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedMethod:
    """What a method made of an insertion, against the truth.

    Attributes:
        result: What it made of the signals.
        ruptures: The true ruptures, and what it reported of each.
        false_alarms: Alarms without a true rupture.
        force_error_N: Root mean square error of the force on the needle, from first
            contact until the needle has left the tissue.
        tip_error_N: The same of the force at the tip, from first contact to the deepest
            point.
    """

    result: MethodResult
    ruptures: tuple[FoundRupture, ...]
    false_alarms: int
    force_error_N: float
    tip_error_N: float

    @property
    def found(self) -> int:
        """Number of true ruptures that it reported."""
        return sum(rupture.alarm is not None for rupture in self.ruptures)


def is_insertion(run: Run) -> NDArray[np.bool_]:
    """Return which samples lie between first contact and the deepest point."""
    t_s = run.truth.t_s
    return (t_s >= run.truth.contact_s) & (t_s <= run.scenario.motion.insertion_end_s)


def judge(run: Run, result: MethodResult) -> JudgedMethod:
    """Compare what a method made of an insertion with the truth."""
    truth = run.truth
    alarms_s = [float(truth.t_s[alarm.sample]) for alarm in result.alarms]
    pairs = nearest_pairs([item.onset_s for item in truth.ruptures], alarms_s)
    layer_of = {layer.rupture.alarm_s: layer for layer in result.layers}
    ruptures: list[FoundRupture] = []
    for number, true in enumerate(truth.ruptures):
        alarm = result.alarms[pairs[number]] if number in pairs else None
        layer = None if alarm is None else layer_of.get(alarm.alarm_s)
        ruptures.append(FoundRupture(true, alarm, layer))
    touches = (truth.t_s >= truth.contact_s) & (truth.t_s <= truth.withdrawn_s)
    inserts = is_insertion(run)
    return JudgedMethod(
        result=result,
        ruptures=tuple(ruptures),
        false_alarms=len(alarms_s) - len(pairs),
        force_error_N=_rms((result.force_N - truth.axial_N)[touches]),
        tip_error_N=_rms((result.tip_N - truth.tip_N)[inserts]),
    )


def _rms(errors: Array) -> float:
    """Return the root mean square of errors, shape (n,)."""
    return float(np.sqrt(np.mean(errors**2)))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ComparedInsertion:
    """A simulated insertion, and what two methods made of it.

    Attributes:
        run: The insertion.
        multilayer: The multi-layer method.
        published: The published method.
    """

    run: Run
    multilayer: JudgedMethod
    published: JudgedMethod
