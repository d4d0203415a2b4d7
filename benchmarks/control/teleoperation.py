"""A hand drives the needle over a delay of 0 to 50 ms.

Measured are energy, drift, what is felt at a rupture, and alarms. Energy is that of the
emulated device's own account; forces before a rupture are means over 0.1 s.
"""

from collections.abc import Iterator

import numpy as np

from benchmarks.control.hand_driven import (
    STANDOFF_M,
    HandPlan,
    Teleinsertion,
    ruptures_felt,
    teleoperate,
)
from benchmarks.control.loop import SERVOS
from benchmarks.jobs import Figure, Job, make_figures
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import Wall
from residual import DEFAULT, HAND_DRIVEN

DELAYS_MS = (0, 10, 50)
CASES = (
    *(f"S tissue {delay}" for delay in DELAYS_MS),
    *(f"{servo} wall {delay}" for servo in SERVOS for delay in DELAYS_MS),
)


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of one run through a stack, or against a wall.

    Hand and scale are drawn. Where the arm sends no velocity, the sensor has the
    setting for hands.
    """
    servo, kind, delay = job.case.split()
    is_wall = kind == "wall"
    arm = SimulatedArm(
        None if is_wall else "stack-glove-constant",
        job.plant,
        job.seed,
        servo=SERVOS[servo],
        standoff_m=None if is_wall else STANDOFF_M,
        contacts=[Wall(distance_m=STANDOFF_M)] if is_wall else (),
        duration_s=120.0 if is_wall else 90.0,
    )
    rng = np.random.default_rng([job.seed, int(delay)])
    scale = float(rng.choice((0.1, 0.2, 0.4, 1.0)))
    # Speed if the hand had its will, and travel: through the stack and beyond.
    hand = HandPlan(10e-3, 20e-3, scale) if is_wall else HandPlan(4e-3, 111e-3, scale)
    sends_velocity = PLANT_MODELS[job.plant].velocity_noise_std_rad_s is not None
    driven = teleoperate(
        arm,
        hand,
        rng,
        seed=job.seed,
        shown="raw" if is_wall else "tip",
        delay_s=1e-3 * int(delay),
        sensor=DEFAULT if sends_velocity else HAND_DRIVEN,
    )
    yield Figure("port_energy_min_mJ", 1e3 * driven.least_energy_J)
    if not is_wall:
        yield from measure_feeling(driven)


def measure_feeling(driven: Teleinsertion) -> Iterator[Figure]:
    """Yield how the hand felt the ruptures of a stack."""
    felt = list(ruptures_felt(driven))
    is_found = np.isfinite([item.delay_s for item in felt])
    membranes = felt[:2]
    shown = min((item.shown_drop for item in membranes), default=0.0)
    raw = min((item.raw_drop for item in membranes), default=0.0)
    error_N = max((abs(item.error_N) for item in felt), default=np.nan)
    values = {
        "master_slave_drift_mm": 1e3 * abs(driven.drift_m),
        "membrane_contrast_shown": shown,
        "membrane_contrast_raw": raw,
        "shown_force_error_N": error_N,
        "felt_rupture_recall": is_found.mean() if felt else 0.0,
        "felt_false_alarms": len(driven.alarms_s) - is_found.sum(),
    }
    yield from make_figures(values)
