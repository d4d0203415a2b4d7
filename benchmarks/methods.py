"""Both methods on one signal: the virtual sensor, the F/T sensor, online identification."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from benchmarks import DataError
from benchmarks.benchmark import Progress
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

Array = NDArray[np.float64]

METHODS: Mapping[Method, SensorConfig] = MappingProxyType(
    {"default": DEFAULT_SENSOR, "published": PUBLISHED_SENSOR}
)
"""Settings of the virtual sensor, by the name they are reported under."""
IDENTIFIERS: Mapping[Method, MultilayerConfig | PublishedConfig] = MappingProxyType(
    {"default": MULTILAYER, "published": PUBLISHED}
)
"""Settings of the identification; one configuration each for every run."""


def on_lwr(config: SensorConfig) -> SensorConfig:
    """A setting with what a user knows of the simulated arm, as of the real one.

    Its torque command is held over each period, and its gears are in the data sheet.
    """
    prior = replace(config.prior, gear_ratio=LWR_GEAR_RATIO)
    return replace(config, alignment="hold", prior=prior)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ForceReading:
    """Axial force of one source and method over a whole run, n samples."""

    source: Source  # see `Source`
    method: Method  # see `Method`
    axial_N: Array  # force, positive when tissue pushes back, shape (n,)
    std_N: Array  # standard deviation the source states for it, shape (n,)


REPORT_EVERY = 1000
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

    Raises:
        TareError: The sensor sees contact at that time.
    """
    sensor = VirtualForceSensor(robot, config)
    found = np.zeros((2, len(signals.t_s)))
    tare = int(np.searchsorted(signals.t_s, tare_s))
    for k, sample in enumerate(signals.samples()):
        if k % REPORT_EVERY == 0:
            progress(k / len(signals.t_s))
        if k == tare:
            sensor.tare()
        estimate = sensor.update(*sample)
        found[:, k] = estimate.axial, estimate.axial_std
    return ForceReading(source="virtual", method=method, axial_N=found[0], std_N=found[1])


TARE_s = 3.0
"""The last stroke in free air. Over a whole stroke, from rest to rest, the needle's inertia cancels
from the mean; its weight does not change on a straight line and goes with the bias."""


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


def joint_residual(
    robot: Robot,
    signals: JointSignals,
    gain_per_s: float,
    *,
    alignment: Alignment = "trapezoid",
    friction: FrictionModel | None = None,
) -> Array:
    """Residual of a `MomentumObserver`, without tare or wrench, after every sample [Nm], (n, j).

    Raises:
        DataError: The arm sent no velocities.
    """
    if signals.dq_rad_s is None:
        raise DataError("a plain observer needs joint velocities, and these signals have none")
    observer = MomentumObserver(robot, gain_per_s, alignment=alignment, friction=friction)
    samples = zip(signals.q_rad, signals.dq_rad_s, signals.tau_Nm, signals.dt_s, strict=True)
    return np.array([observer.update(q, dq, tau, float(dt)) for q, dq, tau, dt in samples])


class Alarm(NamedTuple):
    """One rupture as an identifier reported it, on the run's own clock."""

    sample: int  # index of the sample that raised it
    alarm_s: float  # time of that sample
    rupture_s: float  # estimated rupture time, as known at the end
    # the layer it ended, as known at the end; None if it was never identified
    layer: LayerEstimate | None
    # the same layer as identified in the layer after it, before any later rupture: what was taken
    # off the force then
    online: LayerEstimate | None


def alarms_of(result: Replay, t_s: NDArray[np.float64]) -> list[Alarm]:
    """Every rupture reported, in order; `t_s` are the true instants of the samples, shape (n,)."""
    by_alarm = {layer.rupture.alarm_s: layer for layer in result.layers}
    known = (one.identified_layer for one in result.estimates if one.identified_layer is not None)
    online = {layer.rupture.alarm_s: layer for layer in known}
    found = []
    for k, estimate in enumerate(result.estimates):
        event = estimate.rupture
        if event is None:
            continue
        layer = by_alarm.get(event.alarm_s)
        # The estimated time may have become better since the alarm.
        last = event if layer is None else layer.rupture
        rupture_s = float(t_s[k]) - (event.alarm_s - last.time_s)
        found.append(Alarm(k, float(t_s[k]), rupture_s, layer, online.get(event.alarm_s)))
    return found


def first_compensation(result: Replay) -> int | None:
    """Index of the sample at which friction was first identified, if ever."""
    estimates = enumerate(result.estimates)
    return next((k for k, found in estimates if found.identified_layer is not None), None)


def cumulative_friction_Ns_per_m(alarms: Iterable[Alarm]) -> float:
    """Sum of B d over the traversed layers, each at the speed of its rupture, as known at last."""
    layers = [alarm.layer for alarm in alarms if alarm.layer is not None]
    return sum(layer.friction_N / max(layer.rupture.speed_m_s, 1e-9) for layer in layers)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Identified:
    """What a method made of a signal; sample k of it is sample ``start + k`` of the run."""

    source: Source  # of the force
    method: Method  # of the identification (and, of a virtual force, of the sensor)
    start: int  # the first sample it was given: the end of the tare
    result: Replay  # its estimates
    alarms: tuple[Alarm, ...]  # the ruptures it reported; their samples count from the run's first
    force_N: Array  # the force it was given, shape (n - start,)

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
    """Run a method from the end of the tare to the end of the run.

    `default` finds first contact by itself. `published` assumes it known, and is given it: the one
    thing of the ground truth that an identifier sees here.
    """
    start = int(np.searchsorted(truth.t_s, truth.tare_end_s))
    config = IDENTIFIERS[method] if config is None else config
    if isinstance(config, PublishedConfig):
        touch = float(np.interp(truth.contact_s, truth.t_s, signal.depth_m))
        config = replace(config, contact_depth_m=touch)
    columns = (signal.t_s, signal.depth_m, signal.force_N, signal.speed_m_s)
    t_s, depth_m, force_N, speed_m_s = (column[start:] for column in columns)
    result = replay(t_s, depth_m, force_N, speed_m_s, config)
    alarms = alarms_of(result, truth.t_s[start:])
    return Identified(
        source=signal.source,
        method=method,
        start=start,
        result=result,
        alarms=tuple(alarm._replace(sample=alarm.sample + start) for alarm in alarms),
        force_N=signal.force_N[start:],
    )
