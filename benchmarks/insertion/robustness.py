"""Estimators in perturbed worlds, by the arm or by the needle alone.

The needle alone is enough for the identification. The published method runs on the F/T
force where no arm is simulated; on the virtual force only where the plant itself is
what changes, since its sensor would double the time.
"""

from collections.abc import Iterator
from dataclasses import fields, replace
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from benchmarks.insertion.methods import (
    METHODS,
    Identified,
    identify,
    identify_as_run,
)
from benchmarks.insertion.metrics import (
    coverage_metrics,
    enhanced_metrics,
    event_metrics,
)
from benchmarks.insertion.perturbations import (
    FT_ONLY,
    GROUPS,
    MIXED,
    PERTURBED,
    perturbed,
)
from benchmarks.insertion.signals import (
    InsertionTruth,
    JointSignals,
    NeedleSignal,
    insertion_truth,
    measured_travel,
)
from benchmarks.insertion.simulated import (
    identify_sources,
    read_sensors,
    simulated_metrics,
)
from benchmarks.jobs import Figure, Job, make_figures
from groundtruth import ForceNoise, PlantModel, Scenario, insert_needle, simulate
from groundtruth.arm_motion import scenario_motion, scenario_path
from groundtruth.plant_model import MINI45
from groundtruth.scenarios import scenario as named_scenario
from groundtruth.sensors import (
    SECONDS_PER_MINUTE,
    measured_position,
    measured_velocity,
    received_samples,
    time_stamps,
)
from urdf import NeedleTool, Robot, load_lwr

SCENARIOS = (
    "gel-25-constant",
    "stack-constant",
    "liver-constant",
    "abdomen-sinusoidal",
)
"""A single layer, several, one with a membrane, and a motion that is never constant."""


def perturbed_needle(
    name: str, scenario: Scenario | str, seed: int
) -> tuple[NeedleSignal, InsertionTruth]:
    """Insert the needle alone in a perturbed world; return the reading and the truth.

    Depth and speed are as an arm that follows its motion exactly would measure them.

    Args:
        name: One of `PERTURBATIONS`, or ``mixed``.
        scenario: A scenario, or the name of one.
        seed: Of sizes and noise; of the scenario too, where that is drawn.
    """
    chosen = named_scenario(scenario, seed) if isinstance(scenario, str) else scenario
    world, _ = perturbed(name, chosen, seed)
    plant = world.plant
    robot = _lwr()
    run = insert_needle(world.scenario, seed=seed, noise=ft_noise(plant))
    q_rad, dq_rad_s = scenario_motion(
        scenario_path(robot, world.scenario), world.scenario
    )
    clock, loss, position, velocity = map(
        np.random.default_rng, np.random.SeedSequence([seed, 2]).spawn(4)
    )
    received = received_samples(len(run.t_s), plant, loss)
    dq = measured_velocity(dq_rad_s, plant, velocity)
    signals = JointSignals(
        t_s=time_stamps(run.t_s, plant, clock)[received],
        q_rad=measured_position(q_rad, plant, position)[received],
        dq_rad_s=None if dq is None or not world.has_speed else dq[received],
        tau_Nm=np.zeros((len(received), robot.nv)),
    )
    still = replace(signals, dq_rad_s=np.zeros_like(signals.q_rad))
    sent = signals if world.has_speed else still
    depth_m, measured_m_s = measured_travel(robot, sent, run.tare_end_s)
    speed_m_s = measured_m_s if world.has_speed else None
    signal = NeedleSignal("ft", signals.t_s, depth_m, speed_m_s, run.force_N[received])
    return signal, _at_samples(insertion_truth(run), received)


def run(job: Job) -> Iterator[Figure]:
    """Run ``robustness-...``: our method and the published one in a perturbed world.

    The world is that of the plant's name.
    """
    name = job.plant
    chosen = job.benchmark.removeprefix(PERTURBED)
    scenario = SCENARIOS[job.seed % len(SCENARIOS)] if chosen == MIXED else chosen
    if name in FT_ONLY:
        signal, truth = perturbed_needle(name, scenario, job.seed)
        as_run = identify_as_run(signal, truth, truth.speed_m_s)
        identified = [identify(signal, truth, "ours"), as_run]
        yield from _events(identified, truth)
        return
    world, _ = perturbed(name, named_scenario(scenario, job.seed), job.seed)
    run = simulate(world.scenario, world.plant, job.seed)
    is_compared = name in GROUPS["plants"] and chosen in SCENARIOS
    methods = METHODS if is_compared else ("ours",)
    case = read_sensors(run, tuple(methods))
    yield from simulated_metrics(case)
    identified = [item for source in identify_sources(case) for item in source]
    yield from _events(identified, insertion_truth(run))


def _events(identified: list[Identified], truth: InsertionTruth) -> Iterator[Figure]:
    """Yield the numbers of ruptures, friction, forces and coverage of every method."""
    for item in identified:
        values = event_metrics(item, truth) | enhanced_metrics(item, truth)
        values |= coverage_metrics(item, truth)
        yield from make_figures(values, item.source, item.method)


@lru_cache(maxsize=1)
def _lwr() -> Robot:
    """Load the arm once."""
    return load_lwr(payload=NeedleTool())


def ft_noise(plant: PlantModel) -> ForceNoise:
    """Return the noise of the plant's F/T sensor along the needle."""
    return ForceNoise(
        white_std_N=plant.ft_noise_std[2],
        drift_std_N_per_s=plant.ft_drift_std_per_min[2] / SECONDS_PER_MINUTE,
        step_N=MINI45.step_N,
        correlation_s=plant.ft_noise_correlation_s,
    )


def _at_samples(truth: InsertionTruth, received: NDArray[np.intp]) -> InsertionTruth:
    """Return the truth at the samples that were received."""
    values = {item.name: getattr(truth, item.name) for item in fields(truth)}
    return replace(
        truth,
        **{n: v[received] for n, v in values.items() if isinstance(v, np.ndarray)},
    )
