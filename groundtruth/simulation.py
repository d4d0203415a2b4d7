"""Simulate an insertion: the arm drives the needle, its sensors report it.

`simulate` has the arm move the needle; `insert_needle` has the tip follow the motion
exactly and reads the force at its base. Both return what a robot would give and, apart
from it, the truth.
"""

from collections.abc import Callable
from dataclasses import dataclass, fields
from typing import Any

import numpy as np
from numpy.random import SeedSequence
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth import sensors
from groundtruth.arm_control import ArmTrace, drive
from groundtruth.arm_motion import scenario_motion, scenario_path
from groundtruth.arm_plant import ArmPlant, bearings, lwr_bodies, tissue_before
from groundtruth.errors import MotionError, require_positive
from groundtruth.plant_model import MINI45, ForceNoise, PlantModel, TICK_s, plant_named
from groundtruth.scenarios import Scenario
from groundtruth.scenarios import scenario as scenario_named
from groundtruth.tissue import ReadOnlyArrays, Tissue, TissueTruth, collect_truth
from urdf import NeedleTool, Robot


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals(ReadOnlyArrays):
    """Signals of a robot and its F/T sensor, n samples.

    They are all that an estimator may see.

    A row of torques is held from its sample to the next tick (torque alignment
    ``hold``); at rest it equals the gravity torque. A wrench is that of the environment
    on the needle plus the needle's weight (so tissue that pushes back lowers z), minus
    its inertia.

    Attributes:
        t_s: Time stamps, shape (n,), increasing; jittered, or with gaps, on some
            plants.
        q_rad: Joint positions, shape (n, 7).
        dq_rad_s: Joint velocities, shape (n, 7); None where the interface reports none.
        tau_Nm: Joint torques on the link side, shape (n, 7).
        ft_wrench: Force [N], then torque [Nm], shape (n, 6), ``ft_sensor`` axes, z
            inwards.
    """

    t_s: Array
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array
    ft_wrench: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth(TissueTruth):
    """Ground truth at the same n samples, of the tissue and of the arm.

    The tissue's is that of `TissueTruth`.

    Torques of the tissue on the joints and of the bearings on the links, which no
    torque sensor sees and an observer takes for external, are means over the tick that
    begins at the sample: what a momentum observer can learn from that sample and the
    next.

    Attributes:
        t_s: True instants of the samples, shape (n,).
        q_rad: Joint positions, shape (n, 7).
        dq_rad_s: Joint velocities, shape (n, 7).
        tau_Nm: Joint torques held from each sample to the next tick, shape (n, 7).
        external_torque_Nm: Torque of the tissue on the joints, mean over the tick,
            shape (n, 7).
        joint_friction_Nm: Torque of the bearings on the links, mean over the tick,
            shape (n, 7).
        depth_m: Depth of the tip in the tissue, negative above, shape (n,); zero
            without tissue.
        speed_m_s: Speed of the tip along the needle, shape (n,).
    """

    t_s: Array
    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    external_torque_Nm: Array
    joint_friction_Nm: Array
    depth_m: Array
    speed_m_s: Array


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """One simulated insertion: the signals of the robot, and the ground truth.

    Attributes:
        scenario: What was simulated.
        plant: Name of the plant model.
        seed: Seed of everything drawn.
        robot: The arm as the estimator knows it: nominal links, nominal tool.
        tool: The tool as the estimator knows it.
        signals: All that an estimator may see.
        truth: Ground truth at the same samples.
        tare_end_s: Time before which the needle has not met anything; a user knows
            that.
    """

    scenario: Scenario
    plant: str
    seed: int
    robot: Robot
    tool: NeedleTool
    signals: Signals
    truth: Truth
    tare_end_s: float


def simulate(
    scenario: Scenario | str,
    plant: PlantModel | str = "ideal",
    seed: int = 0,
    progress: Callable[[float], None] = lambda _: None,
) -> Run:
    """Push the needle of a simulated LWR 4+ through a scenario's tissue and back out.

    A scenario without layers moves all joints in free air instead.

    Args:
        scenario: A scenario or its name, see `groundtruth.scenario`.
        plant: A plant model or the name of one: ``ideal``, ``clean``, ``fri`` or
            ``degraded``.
        seed: Seed of everything drawn; equal arguments give equal runs.
        progress: Called now and then with the fraction done, 0 to 1.

    Raises:
        ScenarioError: There is no scenario of that name.
        PlantModelError: There is no plant model of that name.
        MotionError: The needle's line is out of the arm's reach.
        PlantError: The tissue has pushed the arm off its motion.
    """
    chosen = scenario_named(scenario, seed) if isinstance(scenario, str) else scenario
    plant_model = plant_named(plant)
    tool = NeedleTool()
    mass_seed, sensor_seed, friction_seed = SeedSequence(seed).spawn(3)
    bodies = lwr_bodies(tool, plant_model, np.random.default_rng(mass_seed))
    path = scenario_path(bodies.robot, chosen)
    # The zero of the scenario's motion is the surface.
    contact = tissue_before(path.start, -chosen.motion.start_m, chosen)
    motion = scenario_motion(path, chosen)
    limit_Nm = bodies.robot.effort_limit_Nm
    friction = bearings(plant_model, limit_Nm, np.random.default_rng(friction_seed))
    trace = drive(ArmPlant(bodies, contact, friction), bodies.model(), motion, progress)
    time_s = np.arange(len(trace.q_rad), dtype=np.float64) * TICK_s
    received, signals = _sense(trace, time_s, limit_Nm, plant_model, sensor_seed)
    tissue = collect_truth(contact.law, time_s, trace.depth_m, trace.forces)
    return Run(
        scenario=chosen,
        plant=plant_model.name,
        seed=seed,
        robot=bodies.robot,
        tool=tool,
        signals=signals,
        truth=_truth_at(received, time_s, trace, tissue),
        tare_end_s=chosen.motion.tare_end_s,
    )


def _truth_at(
    received: NDArray[np.intp], time_s: Array, trace: ArmTrace, tissue: TissueTruth
) -> Truth:
    """Return the ground truth of arm and tissue at the ticks that were received."""
    columns: dict[str, Any] = {"t_s": time_s[received]}
    for name in [item.name for item in fields(Truth) if item.name != "t_s"]:
        value = getattr(tissue if hasattr(tissue, name) else trace, name)
        columns[name] = value[received] if isinstance(value, np.ndarray) else value
    return Truth(**columns)


def _sense(
    trace: ArmTrace,
    time_s: Array,
    limit_Nm: Array,
    plant_model: PlantModel,
    seed: SeedSequence,
) -> tuple[NDArray[np.intp], Signals]:
    """Return the indices of the ticks received, and the signals at them.

    Each sensor has its own stream of noise.
    """
    clock, loss, position, velocity, torque, wrench = map(
        np.random.default_rng, seed.spawn(6)
    )
    received = sensors.received_samples(len(time_s), plant_model, loss)
    dq = sensors.measured_velocity(trace.dq_rad_s, plant_model, velocity)
    tau = sensors.measured_torque(
        trace.tau_Nm, trace.q_rad, limit_Nm, plant_model, torque
    )
    q = sensors.measured_position(trace.q_rad, plant_model, position)
    ft_wrench = sensors.measured_wrench(trace.ft_wrench, plant_model, wrench)
    return received, Signals(
        t_s=sensors.time_stamps(time_s, plant_model, clock)[received],
        q_rad=q[received],
        dq_rad_s=None if dq is None else dq[received],
        tau_Nm=tau[received],
        ft_wrench=ft_wrench[received],
    )


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NeedleRun(ReadOnlyArrays):
    """Signals and truth of one needle-only insertion; arrays of shape (n,).

    Attributes:
        scenario: What was simulated.
        seed: Seed of the sensor noise.
        t_s: Times of the samples.
        depth_m: Depth of the tip below the surface where that would rest, negative
            above.
        speed_m_s: Rate of that depth.
        force_N: Reading of the sensor, zeroed at the end of the tare stroke.
        tare_end_s: Time before which contact has not happened; all that a user knows of
            it.
        truth: Ground truth of the tissue.
    """

    scenario: Scenario
    seed: int
    t_s: Array
    depth_m: Array
    speed_m_s: Array
    force_N: Array
    tare_end_s: float
    truth: TissueTruth


def insert_needle(
    scenario: Scenario | str,
    *,
    seed: int = 0,
    rate_hz: float = 1000.0,
    noise: ForceNoise = MINI45,
) -> NeedleRun:
    """Carry out a scenario with the needle alone: the tip follows the motion exactly.

    Args:
        scenario: A scenario or its name, see `groundtruth.scenario`.
        seed: Seed of the sensor noise and of a drawn scenario; the same seed gives the
            same run.
        rate_hz: Samples per second.
        noise: What the force sensor adds, see `groundtruth.force_noise`.

    Raises:
        ScenarioError: There is no scenario of that name.
        MotionError: The rate is unusable.
    """
    chosen = scenario_named(scenario, seed) if isinstance(scenario, str) else scenario
    require_positive(MotionError, rate_hz=rate_hz)
    motion = chosen.motion
    t_s = np.arange(round(motion.duration_s * rate_hz) + 1) / rate_hz
    depth_m = motion.position_m(t_s)
    speed_m_s = motion.speed_m_s(t_s)
    inside_m = depth_m
    relative_m_s = speed_m_s
    if chosen.tissue_motion is not None:
        surface_m, surface_m_s = chosen.tissue_motion.at(t_s)
        inside_m = depth_m - surface_m
        relative_m_s = speed_m_s - surface_m_s
    law = Tissue(chosen.layers)
    samples = zip(inside_m.tolist(), relative_m_s.tolist(), strict=True)
    truth = collect_truth(
        law, t_s, inside_m, [law.step(z, v, 1.0 / rate_hz) for z, v in samples]
    )
    rng = np.random.default_rng(seed)
    return NeedleRun(
        scenario=chosen,
        seed=seed,
        t_s=t_s,
        depth_m=depth_m,
        speed_m_s=speed_m_s,
        force_N=noise.reading_N(truth.axial_N, t_s, motion.tare_end_s, rng),
        tare_end_s=motion.tare_end_s,
        truth=truth,
    )
