"""What a tick of the estimators costs, beside the bare Pinocchio calls it cannot do without."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.methods.sensor_settings import on_lwr
from benchmarks.signals.joint_signals import JointSignals
from benchmarks.speed.chain_tick import ChainTick
from benchmarks.speed.gc_pauses import GcPauses
from benchmarks.speed.timing import Tick, Timing, time_side_by_side
from groundtruth import simulate
from identification import PAPER as PAPER_IDENTIFIER
from residual import DEFAULT, MomentumObserver, VirtualForceSensor
from residual.offset_removal import OffsetRemoval
from urdf import Robot

SCENARIO, ARM = "stack-constant", "realistic"
JITTER_s = 5e-5
"""Of the uneven clock: that of the hard arm."""
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
    ticks = round(OffsetRemoval.RENEW_S / float(np.median(signals.dt_s)))

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
