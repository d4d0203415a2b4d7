"""What an update of the estimators costs, beside its bare Pinocchio calls."""

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, replace
from time import perf_counter_ns, thread_time_ns
from typing import Any, NamedTuple

import numpy as np
import pinocchio as pin

from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import JointSignals
from benchmarks.performance.tare_ticks import TareTicks, tare_table, time_tare
from benchmarks.report.tables import ResultTable, met_mark
from benchmarks.targets import (
    CHAIN_COST_RATIOS,
    ESTIMATED_VELOCITY_COST_RATIO,
    MEAN_TICK_RATIO,
    OBSERVER_COST_RATIOS,
    PUBLISHED_CHAIN_COST_RATIOS,
    SENSOR_COST_RATIOS,
)
from foundation.arrays import Array
from foundation.jit import COMPILER
from groundtruth import Run, simulate
from identification import MULTILAYER, PUBLISHED, MultilayerConfig, PublishedConfig
from needleforce import InsertionSession
from residual import DEFAULT, MomentumObserver, VirtualForceSensor
from residual.bias.estimator import BiasEstimator
from urdf import Robot

Update = Callable[[int], object]
"""Processes the sample of that index."""
BLOCK = 200
"""Updates of one subject before the next has its turn: short enough that whatever slows
the machine down slows all of them."""
NS_PER_US = 1e3
SCENARIO = "stack-constant"
PLANT = "clean"
LAYER_TICKS = 6
"""A layer is identified over so many updates at most: the last one reports it."""
PERCENTILES = {"median": 50.0, "99 %": 99.0, "99.9 %": 99.9, "worst": 100.0}

BARE_OBSERVER = "dynamics of the observer"
BARE_SENSOR = "dynamics of the sensor"


class Subject(NamedTuple):
    """What a subject's cost is a multiple of, and the most it may be.

    Attributes:
        bare: Name of the bare calls that it is relative to.
        compiled: Limit of the ratio where numba compiles; None for none.
        plain: Limit of the ratio in plain Python.
    """

    bare: str
    compiled: float | None = None
    plain: float | None = None


OBSERVER = "observer"
SENSOR = "sensor"
CHAIN = "chain"
PUBLISHED_CHAIN = "chain, published identifier"
ESTIMATED = ", velocity estimated"
SUBJECTS: Mapping[str, Subject] = {
    OBSERVER: Subject(BARE_OBSERVER, *OBSERVER_COST_RATIOS),
    SENSOR: Subject(BARE_SENSOR, *SENSOR_COST_RATIOS),
    CHAIN: Subject(BARE_SENSOR, *CHAIN_COST_RATIOS),
    CHAIN + ESTIMATED: Subject(BARE_SENSOR, ESTIMATED_VELOCITY_COST_RATIO),
    PUBLISHED_CHAIN: Subject(BARE_SENSOR, *PUBLISHED_CHAIN_COST_RATIOS),
    PUBLISHED_CHAIN + ESTIMATED: Subject(BARE_SENSOR, ESTIMATED_VELOCITY_COST_RATIO),
}


def cost_ratio(times: Array, bare: Array) -> float:
    """Return the cost relative to the bare dynamics.

    It is the median of the ratios of neighbouring blocks' medians.
    """
    return float(np.median(np.median(times, axis=1) / np.median(bare, axis=1)))


def time_side_by_side(
    subjects: Mapping[str, Update], first: int, last: int
) -> dict[str, Array]:
    """Let subjects take turns, block by block, over the same samples 0 to last - 1.

    Returns the time of each update of a subject [us], shape (blocks, BLOCK). Updates
    before `first` are not counted: caches fill, filters settle.
    """
    return {
        name: np.array(blocks)
        for name, blocks in take_turns(subjects, first, last, time_each).items()
    }


def processor_times(
    subjects: Mapping[str, Update], first: int, last: int
) -> dict[str, Array]:
    """Let subjects take turns as in `time_side_by_side`.

    Returns processor times, on which other processes do not count: a mean needs them.
    Each holds a reading of that clock, about 1 us.
    """
    return {
        name: np.array(blocks)
        for name, blocks in take_turns(
            subjects, first, last, time_each_on_processor
        ).items()
    }


def take_turns(
    subjects: Mapping[str, Update],
    first: int,
    last: int,
    measure: Callable[[Update, range], list[float]],
) -> dict[str, list[list[float]]]:
    """Let subjects take turns, block by block; return what is measured of each."""
    for update in subjects.values():
        measure(update, range(first))
    measured: dict[str, list[list[float]]] = {name: [] for name in subjects}
    for start in range(first, last - BLOCK + 1, BLOCK):
        for name, update in subjects.items():
            measured[name].append(measure(update, range(start, start + BLOCK)))
    return measured


def time_each_on_processor(update: Update, indices: Iterable[int]) -> list[float]:
    """Processor time of every update [us]."""
    return time_each(update, indices, thread_time_ns)


def time_each(
    update: Update, indices: Iterable[int], clock: Callable[[], int] = perf_counter_ns
) -> list[float]:
    """Time of every update [us]."""
    taken_us = []
    for k in indices:
        begin_ns = clock()
        update(k)
        taken_us.append((clock() - begin_ns) / NS_PER_US)
    return taken_us


class ChainUpdate:
    """A session that takes an arm's signals, called with the index of the next sample.

    `alarms` are the updates that raised a rupture, `layers` those that worked on
    identifying a traversed layer.
    """

    def __init__(
        self,
        robot: Robot,
        signals: JointSignals,
        tare: int,
        identifier: MultilayerConfig | PublishedConfig = MULTILAYER,
    ) -> None:
        self._session = InsertionSession(robot, on_lwr(DEFAULT), identifier)
        self._samples = signals.samples()
        self._tare = tare
        self.alarms: list[int] = []
        self.layers: list[int] = []

    def __call__(self, k: int) -> None:
        """Take sample k."""
        if k == self._tare:
            self._session.tare()
        identification = self._session.update(*self._samples[k]).identification
        if identification.rupture is not None:
            self.alarms.append(k)
        if identification.identified_layer is not None:
            self.layers.extend(range(k + 1 - LAYER_TICKS, k + 1))


@dataclass(frozen=True, slots=True, kw_only=True)
class SpeedReport:
    """What was timed; updates are counted from the first that was timed.

    Attributes:
        times: By subject, as of `time_side_by_side`.
        alarms: Updates that raised a rupture, by chain.
        layers: Updates that worked on identifying a layer, by chain.
        tare: Updates beside a tare; None where none was timed.
    """

    times: dict[str, Array]
    alarms: dict[str, list[int]]
    layers: dict[str, list[int]]
    tare: TareTicks | None = None


def measure_speed(progress: Callable[[float], None]) -> SpeedReport:
    """Time everything on the signals of a simulated insertion, from the tare on."""
    run = simulate(SCENARIO, PLANT, 0, progress)
    signals = JointSignals.of_run(run)
    blind = replace(signals, dq_rad_s=None)
    first = first_counted(run, signals)
    chains = make_chains(run, {"": signals, ESTIMATED: blind})
    subjects = make_estimators(run, signals) | chains
    times = time_side_by_side(subjects, first, len(signals.t_s))
    return SpeedReport(
        times=times,
        alarms={
            name: [k - first for k in chain.alarms] for name, chain in chains.items()
        },
        layers={
            name: [k - first for k in chain.layers] for name, chain in chains.items()
        },
        tare=time_tare(run),
    )


def first_counted(run: Run, signals: JointSignals) -> int:
    """Return the index of the first update that counts: after that of the tare."""
    return int(np.searchsorted(signals.t_s, run.tare_end_s)) + 1


def make_estimators(run: Run, signals: JointSignals) -> dict[str, Update]:
    """Return new observer and sensor, each after its bare calls."""
    observer = MomentumObserver(run.robot, DEFAULT.gain_per_s, alignment="hold")
    sensor = VirtualForceSensor(run.robot, on_lwr(DEFAULT))
    return {
        BARE_OBSERVER: _bare_observer(run.robot, signals),
        OBSERVER: fed(observer, signals),
        BARE_SENSOR: bare_sensor(run.robot, signals),
        SENSOR: fed(sensor, signals, first_counted(run, signals) - 1),
    }


def make_chains(run: Run, sent: Mapping[str, JointSignals]) -> dict[str, ChainUpdate]:
    """Return new chains with both identifiers; the keys of `sent` end their names."""
    return {
        name + how: ChainUpdate(
            run.robot, signals, first_counted(run, signals) - 1, config
        )
        for name, config in ((CHAIN, MULTILAYER), (PUBLISHED_CHAIN, PUBLISHED))
        for how, signals in sent.items()
    }


def _bare_observer(robot: Robot, signals: JointSignals) -> Update:
    """Return what calls mass matrix, Coriolis matrix and gravity."""
    model = robot.model
    data = robot.create_data()
    assert signals.dq_rad_s is not None, "the arm that is timed sends velocities"
    positions = list(signals.q_rad)
    velocities = list(signals.dq_rad_s)

    def update(k: int) -> None:
        q = positions[k]
        pin.crba(model, data, q)
        pin.computeCoriolisMatrix(model, data, q, velocities[k])
        pin.computeGeneralizedGravity(model, data, q)

    return update


def bare_sensor(robot: Robot, signals: JointSignals) -> Update:
    """Return what calls mass and Coriolis matrix, gravity and Jacobian.

    And the torque regressor when the bias is due.
    """
    model = robot.model
    data = robot.create_data()
    positions = list(signals.q_rad)
    still = np.zeros(robot.nv)
    frame = robot.tool_frame_id
    axes = pin.ReferenceFrame.LOCAL
    observer = _bare_observer(robot, signals)
    ticks = round(BiasEstimator.RENEW_S / float(np.median(signals.dt_s)))

    def update(k: int) -> None:
        observer(k)
        q = positions[k]
        pin.computeFrameJacobian(model, data, q, frame, axes)
        if k % ticks == 0:
            pin.computeJointTorqueRegressor(model, data, q, still, still)

    return update


def fed(estimator: Any, signals: JointSignals, tare: int = -1) -> Update:
    """Return what gives an estimator the sample of each index.

    It is tared before that of `tare`.
    """
    samples = signals.samples()

    def update(k: int) -> None:
        if k == tare:
            estimator.tare()
        estimator.update(*samples[k])

    return update


def speed_report(report: SpeedReport) -> tuple[list[ResultTable], bool]:
    """Return the tables, and whether all targets are met."""
    tables = [speed_table(report), event_table(report)]
    if report.tare is not None:
        tables.append(tare_table(report.tare))
    return tables, not any("missed" in line for table in tables for line in table.lines)


def speed_table(report: SpeedReport) -> ResultTable:
    """Return time per update, and the ratio to the bare dynamics with its target."""
    lines = []
    for name, times in report.times.items():
        percentiles_us = [
            float(np.percentile(times, percent)) for percent in PERCENTILES.values()
        ]
        mean = float(np.mean(times))
        cells = [""] * 5
        subject = SUBJECTS.get(name)
        if subject is not None:
            ratio = cost_ratio(times, report.times[subject.bare])
            limit = subject.compiled if COMPILER else subject.plain
            cells[0] = f"{ratio:.2f}"
            if limit is not None:
                cells[1:3] = f"≤ {limit:g}", met_mark(ratio <= limit)
                is_even = mean <= MEAN_TICK_RATIO * percentiles_us[0]
                cells[3:] = f"{mean / percentiles_us[0]:.2f}", met_mark(is_even)
        lines.append(
            (name, *(f"{value:.1f}" for value in (mean, *percentiles_us)), *cells)
        )
    ticks = next(iter(report.times.values())).size
    how = (
        f"compiled by {COMPILER}"
        if COMPILER
        else "plain Python: NUMBA_DISABLE_JIT is set"
    )
    return ResultTable(
        title="Cost of a tick",
        heads=(
            *("what", "mean\nus", *(f"{name}\nus" for name in PERCENTILES)),
            *("ratio", "target", "", "mean /\nmedian", ""),
        ),
        align="LrrrrrrrLrL",
        lines=tuple(lines),
        caption=f"{ticks} ticks each of a simulated insertion, taking turns; ratios "
        "of medians, relative to the bare Pinocchio calls; means at most "
        f"{MEAN_TICK_RATIO:g} x the median; {how}",
    )


def event_table(report: SpeedReport) -> ResultTable:
    """Return the updates that raise a rupture, and those that identify a layer."""
    lines = []
    for event, events in (
        ("rupture raised", report.alarms),
        ("layer identified", report.layers),
    ):
        for name, indices in events.items():
            times = report.times[name].reshape(-1)
            taken_us = times[[k for k in indices if 0 <= k < times.size]]
            if taken_us.size:
                ratio = taken_us.max() / np.median(report.times[BARE_SENSOR])
                numbers = (taken_us.size, np.median(taken_us), taken_us.max(), ratio)
                lines.append((event, name, *(f"{number:.0f}" for number in numbers)))
    return ResultTable(
        title="Ticks in which something happens",
        heads=("what", "in", "ticks", "median\nus", "worst\nus", "worst,\nratio"),
        align="LLrrrr",
        lines=tuple(lines),
    )
