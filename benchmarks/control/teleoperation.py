"""A hand drives the needle over a delay of 0 to 50 ms.

Measured are energy, drift, what is felt at a rupture, and alarms. Energy is that of the
emulated device's own account; forces before a rupture are means over 0.1 s.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.control.hand_driven import (
    STANDOFF_M,
    HandPlan,
    ruptures_felt,
    teleoperate,
)
from benchmarks.control.loop import SERVOS
from benchmarks.jobs import Figure, Job
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import Wall
from groundtruth.rig_operator import random_operator
from residual import DEFAULT, HAND_DRIVEN, SensorConfig

DELAYS_MS = (0, 10, 50)
CASES = (
    *(f"S tissue {delay}" for delay in DELAYS_MS),
    *(f"{servo} wall {delay}" for servo in SERVOS for delay in DELAYS_MS),
)


def _sensor(plant: str) -> SensorConfig:
    """Return the setting for hands where the arm sends no velocity."""
    sends_velocity = PLANT_MODELS[plant].velocity_noise_std_rad_s is not None
    return DEFAULT if sends_velocity else HAND_DRIVEN


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of one run; hand and scale are drawn."""
    servo, kind, delay = job.case.split()
    rng = np.random.default_rng([job.seed, int(delay)])
    scale = float(rng.choice((0.1, 0.2, 0.4, 1.0)))
    if kind == "wall":
        return _wall(servo, int(delay), job.plant, job.seed, scale, rng)
    return _tissue(servo, int(delay), job.plant, job.seed, scale, rng)


def _tissue(
    servo: str,
    delay_ms: int,
    plant: str,
    seed: int,
    scale: float,
    rng: np.random.Generator,
) -> Iterator[Figure]:
    """Drive the needle through a stack."""
    arm = SimulatedArm(
        "stack-glove-constant",
        plant,
        seed,
        servo=SERVOS[servo],
        standoff_m=STANDOFF_M,
        duration_s=90.0,
    )
    run = teleoperate(
        arm,
        # Speed if the hand had its will, and travel: through the stack and beyond.
        HandPlan(4e-3, 111e-3, scale),
        seed=seed,
        delay_s=1e-3 * delay_ms,
        operator=lambda wish: random_operator(wish, rng),
        sensor=_sensor(plant),
    )
    felt = ruptures_felt(run)
    alarms = len(run.alarms_s) - sum(np.isfinite(item.delay_s) for item in felt)
    recall = (
        float(np.mean([np.isfinite(item.delay_s) for item in felt])) if felt else 0.0
    )
    yield Figure("port_energy_min_mJ", 1e3 * run.least_energy_J)
    yield Figure("master_slave_drift_mm", 1e3 * abs(run.drift_m))
    membranes = felt[:2]
    shown = min((item.shown_drop for item in membranes), default=0.0)
    raw = min((item.raw_drop for item in membranes), default=0.0)
    yield Figure("membrane_contrast_shown", shown)
    yield Figure("membrane_contrast_raw", raw)
    error_N = max((abs(item.error_N) for item in felt), default=np.nan)
    yield Figure("shown_force_error_N", error_N)
    yield Figure("felt_rupture_recall", recall)
    yield Figure("felt_false_alarms", alarms)


def _wall(
    servo: str,
    delay_ms: int,
    plant: str,
    seed: int,
    scale: float,
    rng: np.random.Generator,
) -> Iterator[Figure]:
    """Drive the needle against a wall."""
    wall = Wall(distance_m=STANDOFF_M)
    arm = SimulatedArm(None, plant, seed, servo=SERVOS[servo], contacts=[wall])
    run = teleoperate(
        arm,
        HandPlan(10e-3, 20e-3, scale),
        seed=seed,
        shown="raw",
        delay_s=1e-3 * delay_ms,
        operator=lambda wish: random_operator(wish, rng),
        sensor=_sensor(plant),
    )
    yield Figure("port_energy_min_mJ", 1e3 * run.least_energy_J)
