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
SAME_m = 3e-3
"""A rupture is that of a boundary if its release began so close to it."""


class Case(NamedTuple):
    """What the match is given.

    Attributes:
        name: In the results.
        withheld: Part of the ruptures.
        stated: Deviation of the offset, of the true one.
        is_skin_right: Only what lies beneath the surface is off.
    """

    name: str
    withheld: float = 0.0
    stated: float = 1.0
    is_skin_right: bool = False


CASES = (
    Case("as stated"),
    Case("30 % withheld", withheld=0.3),
    Case("deviation stated twice too large", stated=2.0),
    Case("deviation stated half", stated=0.5),
    Case("organs shifted beneath the skin", is_skin_right=True),
)


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


class Scores(NamedTuple):
    """What came of the plans of one case.

    Attributes:
        offset_errors_m: After three ruptures.
        is_right: Whether the boundary is, rupture by rupture.
        is_inside: Whether the interval covers the true offset, likewise.
    """

    offset_errors_m: list[float]
    is_right: list[bool]
    is_inside: list[bool]


class Found(NamedTuple):
    """The ruptures of one insertion.

    Attributes:
        boundaries_m: True ones, below the surface, the surface first.
        events: In order.
    """

    boundaries_m: np.ndarray
    events: list[Event]


def ruptures_of(seed: int) -> Found:
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
                is_same = near is not None and abs(near.onset_m - depth) < SAME_m
                layer = near.layer if near is not None and is_same else -1
                is_retracted = rupture is identification.retracted
                contact = rupture.contact_depth_m + zero
                events.append(
                    Event(estimate.depth_m + zero, depth, layer, is_retracted, contact)
                )
    thickness = [layer.thickness_m for layer in run.scenario.layers]
    return Found(np.cumsum([0.0, *thickness]), events)


def run(job: Job, progress: Progress) -> Iterator[Figure]:
    """Yield the numbers of every case."""
    insertions = []
    for k in range(STACKS):
        insertions.append(ruptures_of(job.seed + k))
        progress((k + 1) / STACKS)
    for case in CASES:
        rng = np.random.default_rng([job.seed, 11])
        scores = Scores([], [], [])
        for insertion in insertions:
            for _ in range(PLANS):
                match_plan(insertion, case, rng, scores)
        errors_m = scores.offset_errors_m
        rms_mm = 1e3 * np.sqrt(np.mean(np.square(errors_m))) if errors_m else math.nan
        right_pct = 100.0 * np.mean(scores.is_right)
        coverage = np.mean(scores.is_inside)
        yield Figure("plan_offset_rms_mm", rms_mm, case.name)
        yield Figure("plan_boundary_right_pct", right_pct, case.name)
        yield Figure("plan_interval_coverage_95", coverage, case.name)


def match_plan(
    insertion: Found, case: Case, rng: np.random.Generator, scores: Scores
) -> None:
    """Match one insertion with a plan that is drawn, and append what came of it."""
    offset = OFFSET_STD_m * float(rng.normal())
    edges = (
        insertion.boundaries_m
        - offset
        + BOUNDARY_STD_m * rng.normal(size=len(insertion.boundaries_m))
    )
    if case.is_skin_right:
        edges[0] += offset
    if (np.diff(edges) <= 5e-4).any():
        return
    layers = [
        Layer(str(k), start, end, BOUNDARY_STD_m, BOUNDARY_STD_m, False)
        for k, (start, end) in enumerate(pairwise([*edges, edges[-1] + 0.05]))
    ]
    match = PlanMatch(layers, case.stated * OFFSET_STD_m)
    ruptures = []
    for event in insertion.events:
        if event.is_retracted:
            ruptures = [depth for depth in ruptures if depth != event.depth_m]
        if event.is_retracted or rng.random() < case.withheld:
            continue
        ruptures.append(event.depth_m)
        state = match.state(event.tip_m, ruptures, contact_m=event.contact_m)
        low, high = match.interval_m(event.tip_m, ruptures, contact_m=event.contact_m)
        scores.is_right.append(state.matched == event.layer)
        scores.is_inside.append(low <= offset <= high)
        if len(ruptures) == 3:
            scores.offset_errors_m.append(state.offset_m - offset)
