"""The needle against the plan: needles aside and turned, and needles on the plan.

Registrations err by a rotation and a shift drawn from the covariance that they state.
"""

from collections.abc import Iterator

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from needleforce.needle_on_plan import PlannedPath

INSERTIONS = 1000
DRAWS = 100
STDS_mm = (0.1, 0.2, 0.3)
"""Error of the registration at the entry, rms of three axes."""


FAULTS = {
    "2 mm aside": (2e-3, 0.0),
    "5 mm aside": (5e-3, 0.0),
    "50 mm aside": (50e-3, 0.0),
    "turned by 2 degrees": (0.0, 2.0),
    "turned by 10 degrees": (0.0, 10.0),
}
"""How the needle is off the plan: aside of the path [m], turned about the entry
[degrees]."""


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Yield how many needles are found off the plan."""
    for number, std_mm in enumerate(STDS_mm):
        rng = np.random.default_rng([job.seed, 23, number])
        name = f"registration {std_mm:g} mm"
        accused = sum(is_found(std_mm, 0.0, 0.0, rng) for _ in range(INSERTIONS))
        yield Figure("on_plan_accused", accused, name)
        for fault_name, fault in FAULTS.items():
            found = sum(is_found(std_mm, *fault, rng) for _ in range(DRAWS))
            percent = 100.0 * found / DRAWS
            yield Figure("off_plan_found_pct", percent, f"{name}, {fault_name}")
        progress((number + 1) / len(STDS_mm))


def is_found(
    std_mm: float, aside_m: float, turn_deg: float, rng: np.random.Generator
) -> bool:
    """Return whether an insertion is found off the plan at any depth."""
    std_m = 1e-3 * std_mm / np.sqrt(3.0)
    entry_m = rng.normal(0.0, 0.3, 3)
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    target_m = entry_m + rng.uniform(0.05, 0.12) * axis
    pivot_m = entry_m + rng.normal(0.0, 0.03, 3)
    turn_std = std_m / 0.1  # landmarks lie 0.1 m away
    turn = turn_std * rng.normal(size=3)
    shift_m = std_m * rng.normal(size=3)
    planned_entry_m, planned_target_m = (
        point_m + np.cross(turn, point_m - pivot_m) + shift_m
        for point_m in (entry_m, target_m)
    )
    covariance = np.diag([turn_std**2] * 3 + [std_m**2] * 3)
    path = PlannedPath(planned_entry_m, planned_target_m, covariance, pivot_m)
    across = np.cross(axis, rng.normal(size=3))
    across /= np.linalg.norm(across)
    needle = Rotation.from_rotvec(np.radians(turn_deg) * across).apply(axis)
    # Of the tip, in lengths of the path.
    depths = np.linspace(-0.1, 1.0, 12)
    depths_m = depths * np.linalg.norm(target_m - entry_m)
    tips_m = entry_m + aside_m * across + depths_m[:, None] * needle
    return any(path.deviation(tip_m, needle).is_off_plan for tip_m in tips_m)
