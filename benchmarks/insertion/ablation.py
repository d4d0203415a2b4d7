"""What each part of the identifier beside its mixture buys: each off in turn.

The needle alone, in perturbed worlds, is enough: these parts see depth, speed and force
only. Some kinds more than `perturbations` has: a hub that somebody pulls or pushes, and
a needle that brakes while nobody measures its speed.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any
from unittest.mock import patch

import numpy as np
from numpy.typing import NDArray

from benchmarks.insertion.methods import identify
from benchmarks.insertion.metrics import (
    ADVANCING_m_s,
    coverage_metrics,
    enhanced_metrics,
    event_metrics,
)
from benchmarks.insertion.robustness import perturbed_needle
from benchmarks.insertion.signals import InsertionTruth, NeedleSignal
from benchmarks.jobs import Figure, Job, make_figures
from identification.estimate import SampleStatus
from identification.mixture import learner, method, reporter
from identification.mixture.foreign_force import NeedlePull, RestForce
from identification.mixture.noise_levels import Texture
from identification.mixture.tissue_doubt import (
    HardContactState,
    InnovationWatch,
    TissuePull,
)
from identification.mixture.tissue_motion import TissueMotion

SCENARIO = "stack-constant"

KINDS = (
    "none",
    "force-noise",
    "tremor",
    "heart-and-breath",
    "free-breathing",
    "stop-and-go",
    "reversals",
    "slow",
    "fast",
    "texture",
    "release",
    "kept",
    "braking-unmeasured",
    "hub-pulled",
    "hub-pushed-at-rest",
)
"""Worlds. `kept` has ruptures that release a part of the force only;
`braking-unmeasured` is `stop-and-go` without a measured speed."""


def _unchanged(state: Any, *_: object, **__: object) -> Any:
    """Return a state as it was: what it watches for is never seen."""
    return state


def _no_swing() -> Any:
    """Let no speed before the filter reach the method: the needle never swings."""
    use = method.MixtureMethod.use

    def use_without(self: Any, sample: Any, status: Any) -> Any:
        return use(self, sample._replace(raw_speed_m_s=0.0), status)

    return patch.object(method.MixtureMethod, "use", use_without)


def _no_own_speed() -> Any:
    """Give the force model the filtered speed."""

    def own_speed(state: Any, depth: float, speed: float, *_: float) -> Any:
        return speed, state

    return patch.object(learner, "filter_speed", own_speed)


PARTS: Mapping[str, Callable[[], tuple[Any, ...]]] = {
    "nothing": tuple,
    "swing": lambda: (_no_swing(),),
    "pull": lambda: (patch.object(NeedlePull, "with_force", _unchanged),),
    "rest": lambda: (patch.object(RestForce, "with_force", _unchanged),),
    "tissue pull": lambda: (
        patch.object(TissuePull, "with_zero", _unchanged),
        patch.object(TissuePull, "with_force", _unchanged),
    ),
    "hard contact": lambda: (patch.object(HardContactState, "with_force", _unchanged),),
    "motion search": lambda: (
        patch.object(TissueMotion, "is_due", lambda self, time_s: False),
    ),
    "texture": lambda: (patch.object(Texture, "with_force", _unchanged),),
    "own speed": lambda: (_no_own_speed(),),
    "innovations": lambda: (
        patch.object(InnovationWatch, "with_innovation", _unchanged),
    ),
    "waiting for the speed": lambda: (
        patch.object(reporter, "may_be_braking", lambda *_: False),
    ),
}
"""Parts by name, with what switches each off."""

CASES = tuple(PARTS)
"""One part a case; the first is all of them at work."""


@contextmanager
def switched_off(part: str) -> Iterator[None]:
    """Switch one of `PARTS` off."""
    with ExitStack() as stack:
        for switch in PARTS[part]():
            stack.enter_context(switch)
        yield


def _with_hub_force(
    signal: NeedleSignal, truth: InsertionTruth, force_N: float, *, at_rest: bool
) -> tuple[NeedleSignal, NDArray[np.bool_]]:
    """Add a force at the hub, twice for up to a second; return when it acts as well."""
    speed_m_s = np.abs(truth.speed_m_s)
    is_chosen = truth.is_insertion & ((speed_m_s < ADVANCING_m_s) == at_rest)
    times_s = truth.t_s[is_chosen]
    total_N = signal.force_N.copy()
    acts = np.zeros(len(total_N), dtype=bool)
    for fraction in (0.35, 0.75):
        begin_s = times_s[int(fraction * len(times_s))]
        onset = np.clip((truth.t_s - begin_s) / 0.1, 0.0, 1.0)
        end = np.clip((begin_s + 1.0 - truth.t_s) / 0.1, 0.0, 1.0)
        hub_N = force_N * onset * end * is_chosen
        total_N += hub_N
        acts |= np.abs(hub_N) > 0.5 * abs(force_N)
    return replace(signal, force_N=total_N), acts


def insert_in_world(
    kind: str, seed: int
) -> tuple[NeedleSignal, InsertionTruth, NDArray[np.bool_]]:
    """Insert the needle alone in a world of one of `KINDS`.

    Returns:
        Its signal, the truth, and when a foreign force acts.
    """
    world = {
        "hub-pulled": "none",
        "hub-pushed-at-rest": "stop-and-go",
        "braking-unmeasured": "stop-and-go",
    }.get(kind, kind)
    signal, truth = perturbed_needle(world, SCENARIO, seed)
    acts = np.zeros(len(signal.t_s), dtype=bool)
    if kind == "hub-pulled":
        signal, acts = _with_hub_force(signal, truth, -1.0, at_rest=False)
    elif kind == "hub-pushed-at-rest":
        signal, acts = _with_hub_force(signal, truth, 1.0, at_rest=True)
    elif kind == "braking-unmeasured":
        signal = replace(signal, speed_m_s=None)
    return signal, truth, acts


def run(job: Job) -> Iterator[Figure]:
    """Identify insertions of all kinds without the part that is the job's case."""
    worlds: list[dict[str, float]] = []
    for kind in KINDS:
        signal, truth, acts = insert_in_world(kind, job.seed)
        begin_s = time.process_time()
        with switched_off(job.case):
            item = identify(signal, truth, "ours")
        values = {"processor_s": time.process_time() - begin_s}
        values |= event_metrics(item, truth) | enhanced_metrics(item, truth)
        values |= coverage_metrics(item, truth)
        if acts.any():
            is_pulled = [
                estimate.status is SampleStatus.NEEDLE_PULLED
                for estimate in item.result.estimates
            ]
            said = np.array(is_pulled)[acts[item.start :]]
            values["foreign_force_said"] = float(np.mean(said))
        worlds.append(values)

    def gather(name: str) -> NDArray[np.float64]:
        return np.array([values.get(name, math.nan) for values in worlds])

    yield from make_figures(
        {
            "ablation_recall": np.mean(gather("rupture_recall")),
            "ablation_false_alarms": np.sum(gather("false_alarms")),
            "ablation_delay_ms": np.nanmedian(gather("rupture_delay_ms")),
            "ablation_tip_rmse_N": np.nanmean(gather("tip_rmse_N")),
            "ablation_tip_coverage_2sigma": np.mean(
                gather("tip_coverage_moving_2sigma")
            ),
            "ablation_foreign_force_said": np.nanmean(gather("foreign_force_said")),
            "ablation_processor_s": np.sum(gather("processor_s")),
        },
        "ft",
    )
