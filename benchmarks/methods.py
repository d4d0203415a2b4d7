"""One signal through one method's online identification."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks.benchmark import Progress
from benchmarks.errors import DataError
from benchmarks.rows import Method, Source
from benchmarks.signals import InsertionTruth, JointSignals, NeedleSignal
from groundtruth import Run
from identification import (
    MULTILAYER,
    PUBLISHED,
    LayerEstimate,
    MultilayerConfig,
    PublishedConfig,
    Replay,
    replay,
)
from residual import DEFAULT as DEFAULT_SENSOR
from residual import PUBLISHED as PUBLISHED_SENSOR
from residual import FrictionModel, MomentumObserver, SensorConfig, VirtualForceSensor
from residual.momentum_observer import Alignment
from urdf import LWR_GEAR_RATIO, Robot

# Ruptures as an identifier reported them, on the run's own clock.


class Alarm(NamedTuple):
    """One reported rupture.

    Attributes:
        sample: Index of the sample that raised it.
        alarm_s: Time of that sample.
        dated_s: When the rupture happened, as estimated at last.
        layer: The layer it ended, as known at the end; None if it was never identified.
        online: The same layer as identified in the layer after it, before any later rupture told
            more: what was taken off the force then.
    """

    sample: int
    alarm_s: float
    dated_s: float
    layer: LayerEstimate | None
    online: LayerEstimate | None


def alarms_of(result: Replay, t_s: NDArray[np.float64]) -> list[Alarm]:
    """Every rupture reported, in order.

    Args:
        result: Estimates, one per sample.
        t_s: True instants of the samples, shape (n,).
    """
    by_alarm = {layer.rupture.alarm_s: layer for layer in result.layers}
    online = {
        estimate.identified_layer.rupture.alarm_s: estimate.identified_layer
        for estimate in result.estimates
        if estimate.identified_layer is not None
    }
    found = []
    for k, estimate in enumerate(result.estimates):
        event = estimate.rupture
        if event is None:
            continue
        layer = by_alarm.get(event.alarm_s)
        # The date may have become better since the alarm.
        last = event if layer is None else layer.rupture
        dated_s = float(t_s[k]) - (event.alarm_s - last.time_s)
        found.append(Alarm(k, float(t_s[k]), dated_s, layer, online.get(event.alarm_s)))
    return found


def first_compensation(result: Replay) -> int | None:
    """Index of the sample at which friction was first identified, if ever."""
    is_compensated = (estimate.identified_layer is not None for estimate in result.estimates)
    return next((k for k, found in enumerate(is_compensated) if found), None)


def cumulative_friction_Ns_per_m(alarms: Iterable[Alarm]) -> float:
    """Sum of B d over the layers left, each at the speed of its rupture, as known at the end."""
    layers = [alarm.layer for alarm in alarms if alarm.layer is not None]
    return sum(layer.friction_N / max(layer.rupture.speed_m_s, 1e-9) for layer in layers)


Array = NDArray[np.float64]

IDENTIFIERS: Mapping[Method, MultilayerConfig | PublishedConfig] = MappingProxyType(
    {"default": MULTILAYER, "published": PUBLISHED}
)
"""By the name they are reported under; one configuration each for every run."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identified:
    """What a method made of a signal; sample k of it is sample ``start + k`` of the run.

    Attributes:
        source: Of the force.
        method: Of the identification (and, of a virtual force, of the sensor).
        start: The first sample it was given: the end of the tare.
        result: Its estimates.
        alarms: The ruptures it reported; their samples count from the run's first.
        force_N: The force it was given, shape (n - start,).
    """

    source: Source
    method: Method
    start: int
    result: Replay
    alarms: tuple[Alarm, ...]
    force_N: Array

    @property
    def enhanced_N(self) -> Array:
        """Its enhanced force, shape (n - start,)."""
        return np.array([estimate.enhanced_force_N for estimate in self.result.estimates])

    @property
    def tip_N(self) -> Array:
        """Its tip force, shape (n - start,)."""
        return np.array([estimate.tip_force_N for estimate in self.result.estimates])


def identify(
    signal: NeedleSignal,
    truth: InsertionTruth,
    method: Method,
    config: MultilayerConfig | PublishedConfig | None = None,
) -> Identified:
    """Feed a method from the end of the tare to the end of the run.

    `default` finds first contact by itself. `published` assumes it known, and is told: the one
    thing of the truth that an identifier sees here.
    """
    start = int(np.searchsorted(truth.t_s, truth.tare_end_s))
    config = IDENTIFIERS[method] if config is None else config
    if isinstance(config, PublishedConfig):
        touch = float(np.interp(truth.contact_s, truth.t_s, signal.depth_m))
        config = replace(config, contact_depth_m=touch)
    result = replay(
        signal.t_s[start:],
        signal.depth_m[start:],
        signal.force_N[start:],
        signal.speed_m_s[start:],
        config,
    )
    alarms = alarms_of(result, truth.t_s[start:])
    return Identified(
        source=signal.source,
        method=method,
        start=start,
        result=result,
        alarms=tuple(alarm._replace(sample=alarm.sample + start) for alarm in alarms),
        force_N=signal.force_N[start:],
    )


# An axial force as a sensor tells it, sample by sample.


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceReading:
    """Axial force of one source and method over a whole run, n samples.

    Attributes:
        source: See `Source`.
        method: See `Method`.
        axial_N: Force, positive when tissue pushes back, shape (n,), read-only.
        std_N: Standard deviation the source states for it, shape (n,), read-only.
    """

    source: Source
    method: Method
    axial_N: Array
    std_N: Array

    def __post_init__(self) -> None:
        """Keep read-only copies."""
        for name in ("axial_N", "std_N"):
            array = np.array(getattr(self, name), dtype=np.float64)
            array.setflags(write=False)
            object.__setattr__(self, name, array)


# The virtual sensor on a stream of joint signals.


TELL_EVERY = 1000
"""Samples between two reports of progress."""


def virtual_force(
    robot: Robot,
    signals: JointSignals,
    config: SensorConfig,
    method: Method,
    tare_s: float,
    progress: Progress,
) -> ForceReading:
    """Axial force from joint signals, tared once as a user would.

    Args:
        robot: The arm as the estimator knows it.
        signals: What the arm sent.
        config: Settings of the sensor.
        method: Under which name the reading is reported.
        tare_s: Time of the tare: nothing has been touched before it.
        progress: Told the share done.

    Raises:
        TareError: The sensor sees contact at that time.
    """
    sensor = VirtualForceSensor(robot, config)
    axial, std = np.zeros(len(signals.t_s)), np.zeros(len(signals.t_s))
    dt_s = signals.dt_s
    waiting = True
    for k, now in enumerate(signals.t_s):
        if k % TELL_EVERY == 0:
            progress(k / len(signals.t_s))
        if waiting and now >= tare_s:
            sensor.tare()
            waiting = False
        estimate = sensor.update(
            signals.q_rad[k], signals.velocity(k), signals.tau_Nm[k], float(dt_s[k])
        )
        axial[k], std[k] = estimate.axial, estimate.axial_std
    return ForceReading(source="virtual", method=method, axial_N=axial, std_N=std)


# The axial force that the F/T sensor at the needle's base reads.


TARE_s = 3.0
"""The last stroke in free air. Over a whole stroke, from rest to rest, the needle's inertia cancels
from the mean; its weight does not change on a straight line and goes with the offset."""


def ft_force(run: Run) -> ForceReading:
    """Axial force from the F/T reading, zeroed over the last free stroke.

    The standard deviation it states is its noise over that stroke: what a user would write down.
    """
    t_s = run.signals.t_s
    resistance = -run.signals.ft_wrench[:, 2]
    free = resistance[(t_s > run.tare_end_s - TARE_s) & (t_s <= run.tare_end_s)]
    return ForceReading(
        source="ft",
        method="default",
        axial_N=resistance - free.mean(),
        std_N=np.full(len(t_s), free.std()),
    )


# The plain residual of a stream of joint signals, without tare or wrench.


def joint_residual(
    robot: Robot,
    signals: JointSignals,
    gain_per_s: float,
    *,
    alignment: Alignment = "trapezoid",
    friction: FrictionModel | None = None,
) -> Array:
    """Run a `MomentumObserver` over all samples.

    Args:
        robot: The arm.
        signals: What it sent, velocities included.
        gain_per_s: Observer gain K.
        alignment: How torque fills a tick.
        friction: Joint friction, if any is modelled.

    Returns:
        Residual after every sample [Nm], shape (n, j).

    Raises:
        DataError: The arm sent no velocities.
    """
    if signals.dq_rad_s is None:
        raise DataError("a plain observer needs joint velocities, and these signals have none")
    observer = MomentumObserver(robot, gain_per_s, alignment=alignment, friction=friction)
    samples = zip(signals.q_rad, signals.dq_rad_s, signals.tau_Nm, signals.dt_s, strict=True)
    return np.array([observer.update(q, dq, tau, float(dt)) for q, dq, tau, dt in samples])


# The two settings of the virtual sensor that are always run side by side.


METHODS: Mapping[Method, SensorConfig] = MappingProxyType(
    {"default": DEFAULT_SENSOR, "published": PUBLISHED_SENSOR}
)
"""By the name they are reported under."""


def on_lwr(config: SensorConfig) -> SensorConfig:
    """A setting with what a user knows of the simulated arm, as of the real one.

    Its torque command is held over each tick, and its gears are in the data sheet.
    """
    prior = replace(config.prior, gear_ratio=LWR_GEAR_RATIO)
    return replace(config, alignment="hold", prior=prior)
