"""A hand drives the needle: energy, drift, what is felt at a rupture, alarms; delays 0
to 50 ms.

Energy is that of the emulated device's own account; forces before a rupture are means
over 0.1 s.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.control.study import Figure
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.rig_arm import Servo, SimulatedArm
from groundtruth.rig_contacts import Wall
from groundtruth.rig_operator import random_operator
from needleforce.cli.demos.hand_driven import (
    STANDOFF_M,
    HandPlan,
    ruptures_felt,
    teleoperate,
)
from residual import DEFAULT, HAND_DRIVEN, SensorConfig

DELAYS_MS = (0, 10, 50)
SERVOS: dict[str, Servo] = {"S": "stiff", "I": "impedance"}
CASES = (
    *(f"S tissue {delay}" for delay in DELAYS_MS),
    *(f"{servo} wall {delay}" for servo in SERVOS for delay in DELAYS_MS),
)
SCALES = (0.1, 0.2, 0.4, 1.0)
SPEED_M_S = 4e-3
TRAVEL_M = 111e-3
"""The needle's speed if the hand had its will, and its travel: through the stack and
beyond."""
WALL_SPEED_M_S = 10e-3
PRESSED_M = 20e-3
MOST_S = 90.0


def _sensor(plant: str) -> SensorConfig:
    """The setting for hands where the arm sends no velocity."""
    sends_velocity = PLANT_MODELS[plant].velocity_noise_std_rad_s is not None
    return DEFAULT if sends_velocity else HAND_DRIVEN


def measure(case: str, plant: str, seed: int) -> Iterator[Figure]:
    """Figures of one run; hand and scale are drawn from the seed."""
    servo, kind, delay = case.split()
    rng = np.random.default_rng([seed, int(delay)])
    scale = float(rng.choice(SCALES))
    if kind == "wall":
        return _wall(servo, int(delay), plant, seed, scale, rng)
    return _tissue(servo, int(delay), plant, seed, scale, rng)


def _tissue(
    servo: str,
    delay_ms: int,
    plant: str,
    seed: int,
    scale: float,
    rng: np.random.Generator,
) -> Iterator[Figure]:
    arm = SimulatedArm(
        "stack-glove-constant",
        plant,
        seed,
        servo=SERVOS[servo],
        standoff_m=STANDOFF_M,
        duration_s=MOST_S,
    )
    run = teleoperate(
        arm,
        HandPlan(SPEED_M_S, TRAVEL_M, scale),
        seed=seed,
        delay_s=1e-3 * delay_ms,
        operator=lambda wish: random_operator(wish, rng),
        sensor=_sensor(plant),
    )
    by = f"{delay_ms} ms"
    felt = ruptures_felt(run)
    alarms = len(run.alarms_s) - sum(np.isfinite(item.delay_s) for item in felt)
    found = (
        float(np.mean([np.isfinite(item.delay_s) for item in felt])) if felt else 0.0
    )
    yield Figure(
        f"port energy in tissue, {by}",
        servo,
        1e3 * run.least_energy_J,
        "mJ",
        -0.1,
        True,
    )
    yield Figure(f"master-slave drift, {by}", servo, 1e3 * abs(run.drift_m), "mm", 1.0)
    membranes = felt[:2] or [None]
    for name, target in (("shown_drop", 0.85), ("raw_drop", None)):
        worst = min((getattr(item, name, 0.0) for item in membranes), default=0.0)
        text = f"contrast at a membrane, {name.partition('_')[0]} force, {by}"
        yield Figure(text, servo, worst, "", target, True)
    error_N = max((abs(item.error_N) for item in felt), default=np.nan)
    yield Figure(f"shown force before a rupture, error, {by}", servo, error_N, "N", 0.2)
    yield Figure(f"rupture recall, {by}", servo, found, "", 1.0, True)
    yield Figure(f"false alarms, {by}", servo, float(alarms), "", 1.0)


def _wall(
    servo: str,
    delay_ms: int,
    plant: str,
    seed: int,
    scale: float,
    rng: np.random.Generator,
) -> Iterator[Figure]:
    wall = Wall(distance_m=STANDOFF_M)
    arm = SimulatedArm(None, plant, seed, servo=SERVOS[servo], contacts=[wall])
    run = teleoperate(
        arm,
        HandPlan(WALL_SPEED_M_S, PRESSED_M, scale),
        seed=seed,
        shown="raw",
        delay_s=1e-3 * delay_ms,
        operator=lambda wish: random_operator(wish, rng),
        sensor=_sensor(plant),
    )
    least_mJ = 1e3 * run.least_energy_J
    what = f"port energy against 20 kN/m, raw force, {delay_ms} ms"
    yield Figure(what, servo, least_mJ, "mJ", -5.0, True)
