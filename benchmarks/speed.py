"""What a tick of the estimators costs, beside the bare Pinocchio calls it cannot do without."""

import gc
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter_ns
from typing import Any

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray
from rich.table import Table

from benchmarks.methods import on_lwr
from benchmarks.signals import JointSignals
from benchmarks.tables import met_mark
from benchmarks.targets import (
    CHAIN_COST_RATIO,
    OBSERVER_COST_RATIO,
    RERUN_COST_RATIO,
    SENSOR_COST_RATIO,
)
from groundtruth import Scenario, insert_needle, simulate
from groundtruth.materials import TABLE_I_SPEED_M_S, gel
from groundtruth.motion import constant_motion
from identification import MULTILAYER as DEFAULT_IDENTIFIER
from identification import PUBLISHED as PAPER_IDENTIFIER
from identification import Identifier, MultilayerConfig, PublishedConfig
from needleforce import InsertionSession
from needleforce.jit import COMPILER
from residual import DEFAULT, MomentumObserver, VirtualForceSensor
from residual.bias_estimator import BiasEstimator
from urdf import Robot

# Times ticks of several subjects side by side.


Tick = Callable[[int], object]
"""Processes the sample of that index."""

BLOCK = 200
"""Ticks of one subject before the next has its turn: short enough that whatever slows the machine
down slows all of them."""
NS_PER_US = 1e3


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Timing:
    """Times of one subject.

    Attributes:
        tick_us: Time of each tick [us], shape (blocks, BLOCK).
    """

    tick_us: NDArray[np.float64]

    def percentile_us(self, percent: float) -> float:
        """Time that this share of all ticks keeps [us]."""
        return float(np.percentile(self.tick_us, percent))

    @property
    def worst_us(self) -> float:
        """Time of the slowest tick [us]."""
        return float(self.tick_us.max())

    def ticks_us(self, indices: Iterable[int]) -> NDArray[np.float64]:
        """Times of some ticks [us], counted from the first that was timed, shape (m,)."""
        flat = self.tick_us.reshape(-1)
        return np.array([flat[k] for k in indices if 0 <= k < flat.size])

    def ratio_to(self, other: "Timing") -> float:
        """Cost in times of the other's: median of the ratios of neighbouring blocks' medians."""
        ours, theirs = (np.median(item.tick_us, axis=1) for item in (self, other))
        return float(np.median(ours / theirs))


def time_side_by_side(subjects: Mapping[str, Tick], first: int, last: int) -> dict[str, Timing]:
    """Let subjects take turns, block by block, over the same samples.

    Args:
        subjects: By name; each gets every index from 0 to last - 1 once, in order.
        first: Ticks before this index are not counted: caches fill, filters settle.
        last: End of the samples; at least one block after ``first``.
    """
    times: dict[str, list[list[float]]] = {name: [] for name in subjects}
    for tick in subjects.values():
        _time(tick, 0, first)
    for start in range(first, last - BLOCK + 1, BLOCK):
        for name, tick in subjects.items():
            times[name].append(_time(tick, start, start + BLOCK))
    return {name: Timing(tick_us=np.array(blocks)) for name, blocks in times.items()}


def _time(tick: Tick, start: int, stop: int) -> list[float]:
    taken = []
    for k in range(start, stop):
        before = perf_counter_ns()
        tick(k)
        taken.append((perf_counter_ns() - before) / NS_PER_US)
    return taken


# One tick of the whole chain on the samples of an insertion, and what happened in it.


RERUN_TICKS = 6
"""A layer is identified anew over so many ticks at most: the last one tells it."""


class ChainTick:
    """A session fed sample by sample; called with the index of the next one.

    Args:
        robot: The arm.
        signals: What it sent.
        tare: Index of the sample before which to tare.
        identifier: Settings of the identifier.

    Attributes:
        alarms: Indices of the ticks that raised a rupture.
        reruns: Indices of the ticks that worked on identifying a layer that had been left.
    """

    def __init__(
        self,
        robot: Robot,
        signals: JointSignals,
        tare: int,
        identifier: MultilayerConfig | PublishedConfig = DEFAULT_IDENTIFIER,
    ) -> None:
        self._session = InsertionSession(robot, on_lwr(DEFAULT), identifier)
        # Lists: a controller has its sample at hand and need not cut it out of an array.
        count = len(signals.t_s)
        velocities = [None] * count if signals.dq_rad_s is None else list(signals.dq_rad_s)
        steps = signals.dt_s.tolist()
        self._samples = list(zip(signals.q_rad, velocities, signals.tau_Nm, steps, strict=True))
        self._tare = tare
        self.alarms: list[int] = []
        self.reruns: list[int] = []

    def __call__(self, k: int) -> None:
        """Take sample k."""
        if k == self._tare:
            self._session.tare()
        found = self._session.update(*self._samples[k]).identification
        if found.rupture is not None:
            self.alarms.append(k)
        if found.identified_layer is not None:
            self.reruns.extend(range(k + 1 - RERUN_TICKS, k + 1))


# How long Python's garbage collector stops everything.


class GcPauses:
    """Times every collection while it is entered; collections happen in whatever tick is next.

    Attributes:
        pauses_us: Length of each [us], in order.
    """

    def __init__(self) -> None:
        self.pauses_us: list[float] = []
        self._start_ns = 0

    def __enter__(self) -> "GcPauses":
        gc.callbacks.append(self._note)
        return self

    def __exit__(self, *_: object) -> None:
        gc.callbacks.remove(self._note)

    def _note(self, phase: str, _: dict[str, Any]) -> None:
        if phase == "start":
            self._start_ns = perf_counter_ns()
        else:
            self.pauses_us.append((perf_counter_ns() - self._start_ns) / NS_PER_US)


SCENARIO, ARM = "stack-constant", "clean"
JITTER_s = 5e-5
"""Of the uneven clock: that of the degraded arm."""
OBSERVER, SENSOR = "observer", "sensor"
UNEVEN_OBSERVER, UNEVEN_SENSOR = "observer, uneven clock", "sensor, uneven clock"
CHAIN, CHAIN_WITHOUT_VELOCITY = "chain", "chain, velocity estimated"
PAPER_CHAIN, PAPER_CHAIN_WITHOUT_VELOCITY = (
    "chain, paper's identifier",
    "chain, paper's identifier, velocity estimated",
)
BARE_OBSERVER, BARE_SENSOR = "dynamics of the observer", "dynamics of the sensor"


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedReport:
    """What was timed.

    Attributes:
        timings: By subject.
        alarms: Ticks that raised a rupture, by chain, counted from the first that was timed.
        reruns: Ticks that worked on identifying a layer anew, counted alike.
        pauses: Garbage collections meanwhile.
    """

    timings: dict[str, Timing]
    alarms: dict[str, tuple[int, ...]]
    reruns: dict[str, tuple[int, ...]]
    pauses: GcPauses


def measure_speed(progress: Callable[[float], None]) -> SpeedReport:
    """Time all of them on the signals of a simulated insertion, from the tare on.

    Args:
        progress: Told the share of the simulation that is done.
    """
    run = simulate(SCENARIO, ARM, 0, progress)
    even = JointSignals.of_run(run)
    noise = np.random.default_rng(0).normal(scale=JITTER_s, size=len(even.t_s))
    uneven = replace(even, t_s=even.t_s + noise)
    blind = replace(even, dq_rad_s=None)
    tare = int(np.searchsorted(even.t_s, run.tare_end_s))
    chains = {
        CHAIN: ChainTick(run.robot, even, tare),
        CHAIN_WITHOUT_VELOCITY: ChainTick(run.robot, blind, tare),
        PAPER_CHAIN: ChainTick(run.robot, even, tare, PAPER_IDENTIFIER),
        PAPER_CHAIN_WITHOUT_VELOCITY: ChainTick(run.robot, blind, tare, PAPER_IDENTIFIER),
    }
    subjects = {
        BARE_OBSERVER: _bare_observer(run.robot, even),
        OBSERVER: _observer(run.robot, even),
        UNEVEN_OBSERVER: _observer(run.robot, uneven),
        BARE_SENSOR: bare_sensor(run.robot, even),
        SENSOR: _sensor(run.robot, even, tare),
        UNEVEN_SENSOR: _sensor(run.robot, uneven, tare),
        **chains,
    }
    # The first counted tick comes after that of the tare.
    first = tare + 1
    with GcPauses() as pauses:
        timings = time_side_by_side(subjects, first, len(even.t_s))
    return SpeedReport(
        timings=timings,
        alarms={name: tuple(k - first for k in tick.alarms) for name, tick in chains.items()},
        reruns={name: tuple(k - first for k in tick.reruns) for name, tick in chains.items()},
        pauses=pauses,
    )


def _bare_observer(robot: Robot, signals: JointSignals) -> Tick:
    """Mass matrix, Coriolis matrix and gravity."""
    model, data = robot.model, robot.create_data()
    positions, velocities = list(signals.q_rad), _velocities(signals)

    def tick(k: int) -> None:
        q = positions[k]
        pin.crba(model, data, q)
        pin.computeCoriolisMatrix(model, data, q, velocities[k])
        pin.computeGeneralizedGravity(model, data, q)

    return tick


def bare_sensor(robot: Robot, signals: JointSignals) -> Tick:
    """Mass and Coriolis matrix, gravity and Jacobian; the torque regressor when the offset is due.

    Args:
        robot: The arm.
        signals: What it sent, evenly.
    """
    model, data = robot.model, robot.create_data()
    positions, still = list(signals.q_rad), np.zeros(robot.nv)
    frame, axes = robot.tool_frame_id, pin.ReferenceFrame.LOCAL
    observer = _bare_observer(robot, signals)
    ticks = round(BiasEstimator.RENEW_S / float(np.median(signals.dt_s)))

    def tick(k: int) -> None:
        observer(k)
        q = positions[k]
        pin.computeFrameJacobian(model, data, q, frame, axes)
        if k % ticks == 0:
            pin.computeJointTorqueRegressor(model, data, q, still, still)

    return tick


def _observer(robot: Robot, signals: JointSignals) -> Tick:
    observer = MomentumObserver(robot, DEFAULT.gain_per_s, alignment="hold")
    return _feed(signals, observer.update)


def _sensor(robot: Robot, signals: JointSignals, tare: int) -> Tick:
    sensor = VirtualForceSensor(robot, on_lwr(DEFAULT))
    update = _feed(signals, sensor.update)

    def tick(k: int) -> None:
        if k == tare:
            sensor.tare()
        update(k)

    return tick


def _feed(signals: JointSignals, update: Callable[..., object]) -> Tick:
    # Lists: a controller has its sample at hand and need not cut it out of an array.
    positions, velocities = list(signals.q_rad), _velocities(signals)
    torques, steps = list(signals.tau_Nm), signals.dt_s.tolist()

    def tick(k: int) -> None:
        update(positions[k], velocities[k], torques[k], steps[k])

    return tick


def _velocities(signals: JointSignals) -> list[NDArray[np.float64]]:
    assert signals.dq_rad_s is not None, "the arm that is timed sends velocities"
    return list(signals.dq_rad_s)


# What the dearest of the ticks costs that identify a layer anew, after short and long layers.


SHORT_S, LONG_S = 10.0, 60.0
"""Time spent in the layer; at 1 kHz."""
REPEATS = 9
"""Insertions of each kind: the median is free of whatever else a busy machine did."""


def slab(seconds: float) -> Scenario:
    """One gel of such a thickness that the needle is in it for a time [s]."""
    thickness = TABLE_I_SPEED_M_S * seconds
    return Scenario(
        id=f"slab-{seconds:g}s",
        title=f"one 70 % gel, {1e3 * thickness:.0f} mm",
        layers=(replace(gel(70), thickness_m=thickness),),
        motion=constant_motion(
            speed_m_s=TABLE_I_SPEED_M_S, depth_m=thickness + 8e-3, standoff_m=5e-3
        ),
    )


def rerun_us(seconds: float, config: MultilayerConfig | PublishedConfig) -> float:
    """Time of the slowest tick from the first alarm until the last layer is identified [us].

    Of each tick the median of `REPEATS` equal insertions.

    Args:
        seconds: Time spent in the layer [s].
        config: Settings of the identifier.
    """
    run = insert_needle(slab(seconds), seed=0)
    inside = run.t_s > run.tare_end_s
    samples = list(
        zip(
            run.depth_m[inside].tolist(),
            run.speed_m_s[inside].tolist(),
            run.force_N[inside].tolist(),
            strict=True,
        )
    )
    ticks = [_event_ticks_us(samples, config) for _ in range(REPEATS)]
    # The same work every time: what is slow only once was interrupted.
    return float(np.max(np.median(ticks, axis=0)))


def _event_ticks_us(
    samples: list[tuple[float, float, float]], config: MultilayerConfig | PublishedConfig
) -> NDArray[np.float64]:
    """Times of the ticks from the first alarm to the last identification, zero elsewhere."""
    identifier, taken_us = Identifier(config), np.zeros(len(samples))
    alarm, last = len(samples), 0
    for k, sample in enumerate(samples):
        before = perf_counter_ns()
        found = identifier.update(*sample, 1e-3)
        taken_us[k] = (perf_counter_ns() - before) / NS_PER_US
        if found.rupture is not None:
            alarm = min(alarm, k)
        if found.identified_layer is not None:
            last = k
    tick = np.arange(len(samples))
    return np.where((tick >= alarm) & (tick <= last), taken_us, 0.0)


# The tables of ``python -m benchmarks speed``.


PERCENTILES = {"median": 50.0, "99 %": 99.0, "99.9 %": 99.9}
BARE = {
    OBSERVER: BARE_OBSERVER,
    UNEVEN_OBSERVER: BARE_OBSERVER,
    SENSOR: BARE_SENSOR,
    UNEVEN_SENSOR: BARE_SENSOR,
    CHAIN: BARE_SENSOR,
    CHAIN_WITHOUT_VELOCITY: BARE_SENSOR,
    PAPER_CHAIN: BARE_SENSOR,
    PAPER_CHAIN_WITHOUT_VELOCITY: BARE_SENSOR,
}
"""What a subject's cost is a multiple of."""
LIMITS = {
    OBSERVER: OBSERVER_COST_RATIO,
    SENSOR: SENSOR_COST_RATIO,
    CHAIN: CHAIN_COST_RATIO,
    CHAIN_WITHOUT_VELOCITY: CHAIN_COST_RATIO,
    PAPER_CHAIN: CHAIN_COST_RATIO,
    PAPER_CHAIN_WITHOUT_VELOCITY: CHAIN_COST_RATIO,
}


def speed_table(timings: Mapping[str, Timing]) -> Table:
    """Microseconds per tick, and the ratio to the bare dynamics with its target."""
    ticks = next(iter(timings.values())).tick_us.size
    table = Table(
        title="Cost of a tick",
        caption=f"{ticks} ticks each of a simulated insertion, taking turns; ratios of medians; "
        + (f"compiled by {COMPILER}" if COMPILER else "plain Python: no numba, the extra `fast`"),
    )
    table.add_column("what", no_wrap=True)
    for name in (*PERCENTILES, "worst"):
        table.add_column(f"{name}\nus", justify="right")
    for name in ("ratio", "target", ""):
        table.add_column(name, justify="right", no_wrap=True)
    for name, timing in timings.items():
        times = [f"{timing.percentile_us(percent):.1f}" for percent in PERCENTILES.values()]
        ratio = ratio_of(timings, name) if name in BARE else None
        cells = _ratio_cells(ratio, LIMITS.get(name))
        table.add_row(name, *times, f"{timing.worst_us:.0f}", *cells)
    return table


def event_table(report: SpeedReport) -> Table:
    """Ticks that raise a rupture and ticks that identify a layer anew, in the same insertion."""
    table = Table(title="Ticks in which something happens")
    for name in ("what", "in"):
        table.add_column(name, no_wrap=True)
    for name in ("ticks", "median\nus", "worst\nus", "worst as\na ratio"):
        table.add_column(name, justify="right")
    bare = report.timings[BARE_SENSOR].percentile_us(50.0)
    for what, events in (("rupture raised", report.alarms), ("layer identified", report.reruns)):
        for name, indices in events.items():
            times = report.timings[name].ticks_us(indices)
            if len(times):
                worst = float(times.max())
                cells = (f"{np.median(times):.0f}", f"{worst:.0f}", f"{worst / bare:.0f}")
                table.add_row(what, name, str(len(times)), *cells)
    return table


def rerun_table(report: SpeedReport, rerun_us: Mapping[tuple[str, float], float]) -> Table:
    """The tick that identifies a layer anew, after short and long layers, with its target.

    Args:
        report: Gives the sensor's share of such a tick, and the bare dynamics.
        rerun_us: Of the identifier alone, by its name and the seconds in the layer.
    """
    table = Table(
        title="The tick that identifies a layer anew, with the sensor's median tick",
        caption="median of insertions into one gel of the needle alone, at 1 kHz",
    )
    for name in ("identifier", "layer", "us", "ratio", "target", ""):
        table.add_column(name, justify="right" if name != "identifier" else "left", no_wrap=True)
    sensor = report.timings[SENSOR].percentile_us(50.0)
    for (name, seconds), taken in rerun_us.items():
        ratio = rerun_ratio(report, taken)
        cells = _ratio_cells(ratio, RERUN_COST_RATIO)
        table.add_row(name, f"{seconds:g} s", f"{sensor + taken:.0f}", *cells)
    return table


def pause_line(pauses: GcPauses) -> str:
    """What the garbage collector took of all these ticks."""
    if not pauses.pauses_us:
        return "No garbage collection happened meanwhile."
    return (
        f"{len(pauses.pauses_us)} garbage collections happened meanwhile, in whatever tick was "
        f"next; the longest took {max(pauses.pauses_us):.0f} us. gc.freeze() after the tare "
        "spares a controller most of it (docs/loop.md)."
    )


def ratio_of(timings: Mapping[str, Timing], name: str) -> float:
    """Cost of a subject in times of its bare dynamics."""
    return timings[name].ratio_to(timings[BARE[name]])


def rerun_ratio(report: SpeedReport, identifier_us: float) -> float:
    """A sensor's median tick and an identifier's tick in times of the bare dynamics."""
    bare = report.timings[BARE_SENSOR].percentile_us(50.0)
    return (report.timings[SENSOR].percentile_us(50.0) + identifier_us) / bare


def _ratio_cells(ratio: float | None, limit: float | None) -> tuple[str, str, str]:
    if ratio is None:
        return "", "", ""
    if limit is None:
        return f"{ratio:.2f}", "", ""
    return f"{ratio:.2f}", f"≤ {limit:g}", met_mark(ratio <= limit)
