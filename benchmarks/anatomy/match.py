"""The plan against the ruptures of random stacks, found through the virtual sensor.

The plan lies off by 3 mm as a whole, its boundaries by 0.5 mm (standard deviations).
Then the same with 30 % of the ruptures withheld, with the offset's deviation misstated
twofold either way, and with a surface that lies where it was planned, as where organs
have moved beneath the skin.
"""

import math
from collections.abc import Iterator
from itertools import pairwise
from typing import NamedTuple

import numpy as np

from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Job, Progress
from benchmarks.results import Figure
from groundtruth import simulate
from groundtruth.scenarios import RANDOM_STACK, scenario
from needleforce import InsertionSession
from needleforce.anatomy import Layer, PlanMatch

STACKS = 200
PLANS = 5
"""Insertions, and plans for each; it takes half an hour."""
OFFSET_STD_m = 3e-3
BOUNDARY_STD_m = 0.5e-3
CASES = {
    "as stated": {},
    "30 % withheld": {"withheld": 0.3},
    "deviation stated twice too large": {"stated": 2.0},
    "deviation stated half": {"stated": 0.5},
    "organs shifted beneath the skin": {"is_skin_right": True},
}
"""What is not as it should be, see `match_plan`."""


class Event(NamedTuple):
    """A rupture that the session reported, or took back.

    Attributes:
        tip_m: Below the surface, at the alarm.
        depth_m: Of the rupture.
        layer: Into which it led, -1 for a false alarm.
        is_retracted: Whether the session took it back.
        contact_m: Depth at which the surface was found.
    """

    tip_m: float
    depth_m: float
    layer: int
    is_retracted: bool
    contact_m: float


Insertion = tuple[np.ndarray, list[Event]]
"""True boundaries below the surface [m], the surface first, and what was reported."""


def ruptures_of(seed: int) -> Insertion:
    """Push a needle through a drawn stack, and collect what the session reports."""
    run = simulate(scenario(RANDOM_STACK, seed), "clean", seed)
    session = InsertionSession(run.robot)
    true = run.truth
    tare = int(np.searchsorted(run.signals.t_s, run.tare_end_s))
    zero = 0.0
    events = []
    for k, row in enumerate(JointSignals.of_run(run).samples()):
        estimate = session.update(*row)
        if k == tare:
            session.tare()
            zero = float(true.depth_m[k])
        identification = estimate.identification
        for rupture in (identification.rupture, identification.retracted):
            if k > tare and rupture is not None:
                depth = rupture.depth_m + zero
                near = min(
                    true.ruptures,
                    key=lambda one: abs(one.onset_m - depth),
                    default=None,
                )
                # That of a boundary if its release began within 3 mm of it.
                is_same = near is not None and abs(near.onset_m - depth) < 3e-3
                layer = near.layer if near is not None and is_same else -1
                is_retracted = rupture is identification.retracted
                contact = rupture.contact_depth_m + zero
                events.append(
                    Event(estimate.depth_m + zero, depth, layer, is_retracted, contact)
                )
    thickness = [layer.thickness_m for layer in run.scenario.layers]
    return np.cumsum([0.0, *thickness]), events


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Yield the numbers of every case."""
    insertions = []
    for k in range(STACKS):
        insertions.append(ruptures_of(job.seed + k))
        progress((k + 1) / STACKS)
    for name, case in CASES.items():
        rng = np.random.default_rng([job.seed, 11])
        matches = [
            item
            for insertion in insertions
            for _ in range(PLANS)
            for item in match_plan(insertion, rng, **case)
        ]
        is_right, is_inside, offset_errors_m = np.array(matches).T
        errors_m = offset_errors_m[np.isfinite(offset_errors_m)]
        rms_mm = 1e3 * np.sqrt(np.mean(errors_m**2)) if len(errors_m) else math.nan
        yield Figure("plan_offset_rms_mm", rms_mm, name)
        yield Figure("plan_boundary_right_pct", 100.0 * np.mean(is_right), name)
        yield Figure("plan_interval_coverage_95", np.mean(is_inside), name)


def match_plan(
    insertion: Insertion,
    rng: np.random.Generator,
    *,
    withheld: float = 0.0,
    stated: float = 1.0,
    is_skin_right: bool = False,
) -> Iterator[tuple[bool, bool, float]]:
    """Match one insertion with a plan that is drawn; yield what came of each rupture.

    Whether the boundary is right and the interval covers the true offset, and the error
    of the offset [m], nan but after three ruptures.

    Args:
        insertion: What was reported in it.
        rng: Draws the plan.
        withheld: Part of the ruptures.
        stated: Deviation of the offset that the match is given, of the true one.
        is_skin_right: Only what lies beneath the surface is off.
    """
    boundaries_m, events = insertion
    offset = OFFSET_STD_m * float(rng.normal())
    edges = boundaries_m - offset + BOUNDARY_STD_m * rng.normal(size=len(boundaries_m))
    if is_skin_right:
        edges[0] += offset
    if (np.diff(edges) <= 5e-4).any():
        return
    layers = [
        Layer(str(k), start, end, BOUNDARY_STD_m, BOUNDARY_STD_m, False)
        for k, (start, end) in enumerate(pairwise([*edges, edges[-1] + 0.05]))
    ]
    match = PlanMatch(layers, stated * OFFSET_STD_m)
    ruptures = []
    for event in events:
        if event.is_retracted:
            ruptures = [depth for depth in ruptures if depth != event.depth_m]
        if event.is_retracted or rng.random() < withheld:
            continue
        ruptures.append(event.depth_m)
        state = match.state(event.tip_m, ruptures, contact_m=event.contact_m)
        low, high = match.interval_m(event.tip_m, ruptures, contact_m=event.contact_m)
        error_m = state.offset_m - offset if len(ruptures) == 3 else math.nan
        yield state.matched == event.layer, low <= offset <= high, error_m
