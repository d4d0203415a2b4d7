"""What an update of the estimators costs, beside its bare Pinocchio calls."""

from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import replace
from time import perf_counter_ns
from typing import Any

import numpy as np
import pinocchio as pin

from benchmarks.insertion.methods import on_lwr
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Figure, Job, make_figures
from foundation.arrays import Array
from groundtruth import Run, simulate
from identification import MIXTURE, PUBLISHED
from needleforce import InsertionSession
from residual import DEFAULT, MomentumObserver, VirtualForceSensor
from residual.bias.estimator import BiasEstimator
from urdf import Robot

Update = Callable[[int], object]
"""Processes the sample of that index."""
BLOCK = 200
"""Updates of one subject before the next has its turn: short enough that whatever slows
the machine down slows all of them."""
SCENARIO = "stack-constant"
PLANT = "clean"

BARE_OBSERVER = "dynamics of the observer"
BARE_SENSOR = "dynamics of the sensor"


OBSERVER = "observer"
SENSOR = "sensor"
CHAIN = "chain"
PUBLISHED_CHAIN = "chain, published identifier"
ESTIMATED = ", velocity estimated"


def cost_ratio(times: Array, bare: Array) -> float:
    """Return the cost relative to the bare dynamics.

    It is the median of the ratios of neighbouring blocks' medians.
    """
    return float(np.median(np.median(times, axis=1) / np.median(bare, axis=1)))


def time_side_by_side(
    subjects: Mapping[str, Update],
    first: int,
    last: int,
    clock: Callable[[], int] = perf_counter_ns,
) -> dict[str, Array]:
    """Let subjects take turns, block by block, over the same samples 0 to last - 1.

    Returns the time of each update of a subject [us], shape (blocks, BLOCK). Updates
    before `first` are not counted: caches fill, filters settle. A mean needs the
    processor's clock (`thread_time_ns`), on which other processes do not count; each
    time holds a reading of it, about 1 us.
    """
    for update in subjects.values():
        time_each(update, range(first), clock)
    taken_us: dict[str, list[list[float]]] = {name: [] for name in subjects}
    for start in range(first, last - BLOCK + 1, BLOCK):
        for name, update in subjects.items():
            block = range(start, start + BLOCK)
            taken_us[name].append(time_each(update, block, clock))
    return {name: np.array(blocks) for name, blocks in taken_us.items()}


def time_each(
    update: Update, indices: Iterable[int], clock: Callable[[], int] = perf_counter_ns
) -> list[float]:
    """Time of every update [us]."""
    taken_us = []
    for k in indices:
        begin_ns = clock()
        update(k)
        taken_us.append((clock() - begin_ns) / 1e3)
    return taken_us


def run(job: Job) -> Iterator[Figure]:
    """Time everything on the signals of a simulated insertion, from the tare on."""
    run = simulate(SCENARIO, PLANT, job.seed)
    signals = JointSignals.of_run(run)
    blind = replace(signals, dq_rad_s=None)
    first = first_counted(run, signals)
    chains = make_chains(run, {"": signals, ESTIMATED: blind})
    subjects = make_estimators(run, signals) | chains
    times = time_side_by_side(subjects, first, len(signals.t_s))
    for name, taken_us in times.items():
        yield from describe_ticks(name, taken_us, times)


def describe_ticks(
    name: str, taken_us: Array, times: Mapping[str, Array]
) -> Iterator[Figure]:
    """Yield time per update, and the ratio to the bare dynamics.

    Args:
        name: Of the subject.
        taken_us: Time of its updates.
        times: Of all subjects.
    """
    values = {
        "tick_mean_us": np.mean(taken_us),
        "tick_median_us": np.median(taken_us),
        "tick_p99_us": np.percentile(taken_us, 99.0),
        "tick_p999_us": np.percentile(taken_us, 99.9),
        "tick_worst_us": taken_us.max(),
    }
    if name not in (BARE_OBSERVER, BARE_SENSOR):
        bare_us = times[BARE_OBSERVER if name == OBSERVER else BARE_SENSOR]
        values["tick_ratio"] = cost_ratio(taken_us, bare_us)
        mean_over_median = values["tick_mean_us"] / values["tick_median_us"]
        values["tick_mean_over_median"] = mean_over_median
    yield from make_figures(values, name)


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


def make_chains(run: Run, sent: Mapping[str, JointSignals]) -> dict[str, Update]:
    """Return new sessions with both identifiers; the keys of `sent` end their names."""
    configs = {CHAIN: MIXTURE, PUBLISHED_CHAIN: PUBLISHED}
    return {
        name + how: fed(
            InsertionSession(run.robot, on_lwr(DEFAULT), config),
            signals,
            first_counted(run, signals) - 1,
        )
        for name, config in configs.items()
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
