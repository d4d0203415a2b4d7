"""The needle by itself: ruptures, bone, a push from the side, lost signals.

What is measured is how far it goes. Positions, speeds and forces are the simulator's,
at every tick. What stops the needle is the manager, with the session's force and
identification, or the F/T sensor's.
"""

from collections import deque
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from benchmarks.control.loop import OPEN_N, SERVOS, STANDOFF_M, Insertion
from benchmarks.jobs import Figure, Job, Source
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import HandOnArm, Wall
from needleforce.control import InsertionPlan, SafetyLimits

SOURCES: Mapping[str, Source] = {"virtual": "virtual", "F/T": "ft"}
"""In the results, by the sensor of a case."""
LOST = {
    "torques": "tau_Nm",
    "positions": "q_rad",
    "samples": "sample",
    "commands": "command",
}
STRUCK_M = 15e-3
"""Depth, from the tare, at which a side force or a loss begins."""

CASES = (
    *(
        f"{s} rupture {by} {v:g}"
        for s in SERVOS
        for by in SOURCES
        for v in (2.3, 5.0, 10.0, 20.0)  # mm/s
    ),
    *(f"{s} bone {v:g}" for s in SERVOS for v in (5.0, 20.0)),  # mm/s
    *(f"{s} side" for s in SERVOS),
    *(f"{s} lost {what}" for s in SERVOS for what in LOST),
)


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of one run.

    The layer at whose end it must stop goes round with the seed.
    """
    servo, kind, *options = job.case.split()
    if kind == "rupture":
        return _rupture(servo, options[0], float(options[1]), job.plant, job.seed)
    if kind == "bone":
        return _bone(servo, float(options[0]), job.plant, job.seed)
    return (
        _side(servo, job.plant, job.seed)
        if kind == "side"
        else _lost(servo, options[0], job.plant, job.seed)
    )


def _rupture(
    servo: str, sensor: str, mm_s: float, plant: str, seed: int
) -> Iterator[Figure]:
    """Insert through layers, and stop after a rupture."""
    layer = 1 + seed % 3
    rig = SimulatedArm(
        "stack-glove-constant", plant, seed, servo=SERVOS[servo], standoff_m=STANDOFF_M
    )
    plan = InsertionPlan(speed_m_s=1e-3 * mm_s, depth_m=0.125, layer=layer)
    run = Insertion(rig, plan, SafetyLimits(axial_N=OPEN_N), with_ft=sensor == "F/T")
    (last,) = deque(run, maxlen=1)
    source = SOURCES[sensor]
    is_refused = "has outrun the force" in last.reason
    yield Figure("refused_as_too_fast", is_refused, source)
    if is_refused:
        return
    ends = [
        rupture
        for rupture in rig.tissue_truth().ruptures
        if rupture.onset_s < (run.ended_s or np.inf)
    ]
    surplus = len(ends) - layer
    yield Figure("stopped_without_rupture", surplus < 0, source)
    yield Figure("rupture_passed_by", surplus > 0 or not run.ended_s, source)
    if surplus == 0 and run.ended_s:
        start = round(1e3 * ends[-1].onset_s)
        depths_m = rig.depths_m[start:]
        travel_mm = 1e3 * float(depths_m.max() - depths_m[0])
        yield Figure("travel_past_rupture_mm", travel_mm, source)
        yield Figure("stop_after_rupture_ms", 1e3 * run.ended_s - start, source)


def _bone(servo: str, mm_s: float, plant: str, seed: int) -> Iterator[Figure]:
    """Insert until the needle hits bone."""
    wall = Wall(distance_m=STRUCK_M)
    rig = SimulatedArm(None, plant, seed, servo=SERVOS[servo], contacts=[wall])
    plan = InsertionPlan(speed_m_s=1e-3 * mm_s, depth_m=0.05)
    limit_N = 2.0
    run = Insertion(rig, plan, SafetyLimits(axial_N=limit_N))
    deepest_m = max(wall.penetration_m for _ in run)
    pushed_N = wall.stiffness_N_per_m * max(deepest_m, 0.0)
    yield Figure("bone_force_excess_N", pushed_N - limit_N)


def _side(servo: str, plant: str, seed: int) -> Iterator[Figure]:
    """Insert into gel, and push the hub from the side."""
    pushed_s = [np.inf]
    hand = HandOnArm(
        at="hub", force_N=lambda t_s: (2.0 if t_s >= pushed_s[0] else 0.0, 0.0, 0.0)
    )
    run = _in_gel(servo, plant, seed, 5.0, [hand])
    moving_s = 0.0
    for situation in run:
        if (
            np.isinf(pushed_s[0])
            and situation.state == "insertion"
            and situation.estimate.depth_m > STRUCK_M
        ):
            pushed_s[0] = run.rig.time_s
        # Below 1 mm/s it counts as stopped: an arm with a soft servo goes on to settle.
        if abs(run.rig.truth.speed_m_s) > 1e-3:
            moving_s = run.rig.time_s
    yield Figure("stop_after_side_push_ms", 1e3 * (moving_s - pushed_s[0]))


def _lost(servo: str, what: str, plant: str, seed: int) -> Iterator[Figure]:
    """Insert into gel, and lose a signal for a while."""
    has_velocity = PLANT_MODELS[plant].velocity_noise_std_rad_s is not None
    # Faster than the force allows, it would be stopped before.
    run = _in_gel(servo, plant, seed, 20.0 if has_velocity else 10.0)
    lost_s = 0.3
    start = 0
    for situation in run:
        if (
            not start
            and situation.state == "insertion"
            and situation.estimate.depth_m > STRUCK_M
        ):
            start = round(1e3 * run.rig.time_s)
            run.rig.lose(LOST[what], lost_s)
    depths_m = run.rig.depths_m[start : start + round(1e3 * lost_s)]
    yield Figure("travel_in_loss_mm", 1e3 * (depths_m.max() - depths_m[0]))


def _in_gel(
    servo: str, plant: str, seed: int, mm_s: float, contacts: Sequence[HandOnArm] = ()
) -> Insertion:
    """Return an insertion into the 70 % gel."""
    rig = SimulatedArm(
        "gel-70-constant",
        plant,
        seed,
        servo=SERVOS[servo],
        standoff_m=STANDOFF_M,
        contacts=contacts,
        duration_s=20.0,
    )
    plan = InsertionPlan(speed_m_s=1e-3 * mm_s, depth_m=0.03)
    return Insertion(rig, plan, SafetyLimits(axial_N=OPEN_N))
