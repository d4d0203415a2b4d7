"""What each part of the identifier beside its mixture buys: each off in turn.

The needle alone, in perturbed worlds, is enough: these parts see depth, speed and force
only. Two kinds more than `perturbations` has: a hub that somebody pulls while the
needle advances, and while it rests.
"""

import math
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from benchmarks.insertion.methods import identify
from benchmarks.insertion.metrics import coverage_metrics, enhanced_metrics
from benchmarks.insertion.robustness import perturbed_needle
from benchmarks.insertion.ruptures import is_visible, match
from benchmarks.insertion.signals import InsertionTruth, NeedleSignal
from foundation.records import read_column
from identification.multilayer import method as multilayer
from identification.multilayer.hard_contact import HardContactState
from identification.multilayer.mixture import MixtureMemory
from identification.multilayer.needle_pull import NeedlePull
from identification.multilayer.noise_levels import Texture
from identification.multilayer.rest_force import RestForce
from identification.multilayer.tissue_motion import TissueMotion
from identification.multilayer.tissue_pull import TissuePull

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
    "hub-pulled",
    "hub-pulled-at-rest",
)
"""`kept` has ruptures that release a part of the force only."""


def _unchanged(state: Any, *_: object, **__: object) -> Any:
    """Return a state as it was: what it watches for is never seen."""
    return state


def _no_swing() -> Any:
    """Let no speed before the filter reach the method: the needle never swings."""
    update = multilayer.MultilayerMethod.update

    def update_without(self: Any, sample: Any) -> Any:
        return update(self, sample._replace(raw_speed_m_s=0.0))

    return patch.object(multilayer.MultilayerMethod, "update", update_without)


def _no_partial_ruptures() -> Any:
    """Drop every component that takes a rupture for a partial one."""
    branch = MixtureMemory.branch

    def branch_without(self: Any, *arguments: Any) -> None:
        branch(self, *arguments)
        mixture = self.mixture
        was_partial = read_column(mixture.history, "was_partial") > 0.0
        mixture.log_weights[was_partial] = -1e9

    return patch.object(MixtureMemory, "branch", branch_without)


def _no_own_speed() -> Any:
    """Give the force model the filtered speed."""

    def own_speed(state: Any, depth: float, speed: float, *_: float) -> Any:
        return speed, state

    return patch.object(multilayer, "filter_speed", own_speed)


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
    "waiting for the speed": lambda: (
        patch.object(multilayer, "may_be_braking", lambda *_: False),
    ),
    "partial ruptures": lambda: (_no_partial_ruptures(),),
}
"""Parts by name, with what switches each off."""


@contextmanager
def switched_off(part: str) -> Iterator[None]:
    """Switch one of `PARTS` off."""
    with ExitStack() as stack:
        for switch in PARTS[part]():
            stack.enter_context(switch)
        yield


class Figures(NamedTuple):
    """What an insertion was identified like.

    Attributes:
        ruptures: True ones that can be seen.
        found: Of these.
        false_alarms: Alarms without one.
        delay_ms: Median of the alarms.
        tip_rmse_N: From the first layer's end on.
        tip_covered: Part of the time within two deviations, moving.
        at_rest_covered: The same at rest; nan where the needle never rests.
        processor_s: Of the identification.
    """

    ruptures: int
    found: int
    false_alarms: int
    delay_ms: float
    tip_rmse_N: float
    tip_covered: float
    at_rest_covered: float
    processor_s: float


def _pulled(
    signal: NeedleSignal, truth: InsertionTruth, *, at_rest: bool
) -> NeedleSignal:
    """Return the signal of a needle whose hub is pulled by 1 N for a second, twice."""
    pull_N = 1.0
    duration_s = 1.0
    is_inside = truth.is_insertion
    is_chosen = is_inside & ((np.abs(truth.speed_m_s) < 1e-4) == at_rest)
    times_s = truth.t_s[is_chosen]
    force_N = signal.force_N.copy()
    for fraction in (0.35, 0.75):
        begin_s = times_s[int(fraction * len(times_s))]
        ramp = np.clip((truth.t_s - begin_s) / 0.1, 0.0, 1.0)
        ramp *= np.clip((begin_s + duration_s - truth.t_s) / 0.1, 0.0, 1.0)
        force_N -= pull_N * ramp
    return replace(signal, force_N=force_N)


def perturbed_signal(kind: str, seed: int) -> tuple[NeedleSignal, InsertionTruth]:
    """Insert the needle alone in a world of one of `KINDS`."""
    if not kind.startswith("hub-pulled"):
        return perturbed_needle(kind, SCENARIO, seed)
    at_rest = kind.endswith("at-rest")
    world = "stop-and-go" if at_rest else "none"
    signal, truth = perturbed_needle(world, SCENARIO, seed)
    return _pulled(signal, truth, at_rest=at_rest), truth


def identify_without(part: str, signal: NeedleSignal, truth: InsertionTruth) -> Figures:
    """Identify an insertion with a part switched off."""
    with switched_off(part):
        begin_s = time.process_time()
        item = identify(signal, truth, "ours")
        processor_s = time.process_time() - begin_s
    pairs = match(truth.ruptures, item.alarms)
    seen = [pair for pair in pairs.found if is_visible(pair[0])]
    delays_s = [alarm.alarm_s - rupture.onset_s for rupture, alarm in seen]
    covered = coverage_metrics(item, truth)
    return Figures(
        ruptures=sum(map(is_visible, truth.ruptures)),
        found=len(seen),
        false_alarms=len(pairs.false),
        delay_ms=1e3 * float(np.median(delays_s)) if delays_s else math.nan,
        tip_rmse_N=enhanced_metrics(item, truth).get("tip_rmse_N", math.nan),
        tip_covered=covered.get("tip_coverage_moving_2sigma", math.nan),
        at_rest_covered=covered.get("tip_coverage_at_rest_2sigma", math.nan),
        processor_s=processor_s,
    )
