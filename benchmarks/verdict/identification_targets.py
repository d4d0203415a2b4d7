"""The figures this toolkit has set itself for online identification.

Friction is judged as it was known online, in the layer after the one it is of, not with hindsight.
"""

from collections.abc import Callable, Iterator
from functools import partial

from benchmarks.verdict.scenario_groups import GELS, RANDOM, STACKS, TISSUE
from benchmarks.verdict.targets import Target

JUDGED_ON = (("ft", "needle"), ("ft", "realistic"), ("virtual", "realistic"))
"""Source and plant: the F/T sensor on the needle alone and on the arm, the virtual one on it."""
FRICTION, DELAY = "friction_error_online_worst_pct", "rupture_delay_ms"
PAPER_SHARE = 0.5


def _targets(source: str, plant: str) -> Iterator[Target]:
    """The targets of one source on one plant."""
    is_ft = source == "ft"
    where = f"{'F/T' if is_ft else 'virtual'}, {plant}"
    target = partial(Target, plant=plant, source=source)
    for what, metric, scenarios, limit in (
        ("friction, gels", FRICTION, GELS, 5.0 if is_ft else 10.0),
        ("friction, stacks, worst layer", FRICTION, STACKS, 10.0 if is_ft else 20.0),
        ("residue, gels and stacks", "exit_residue_pct", GELS + STACKS, 5.0 if is_ft else 10.0),
    ):
        yield target(what=f"{where}: {what}", metric=metric, scenarios=scenarios, at_most=limit)
    yield from _rupture_targets(partial(target, scenarios=TISSUE), where, is_ft=is_ft)
    for what, metric in (("friction", FRICTION), ("delay", DELAY)):
        yield target(
            what=f"{where}: {what} as a share of the paper's in the same run",
            metric=metric,
            scenarios=TISSUE,
            at_most=PAPER_SHARE,
            of_paper=True,
            where_paper_tells=True,
            # A single small error of the paper's method is luck.
            statistic="median",
        )
    yield from _random_targets(partial(target, scenarios=RANDOM), where, is_ft=is_ft)


def _rupture_targets(target: Callable[..., Target], where: str, *, is_ft: bool) -> Iterator[Target]:
    """Recall, precision and delay over the catalogue's tissues."""
    for name in ("recall", "precision"):
        yield target(
            what=f"{where}: {name}, {'each tissue' if is_ft else 'all together'}",
            metric=f"rupture_{name}",
            at_least=1.0 if is_ft else 0.98,
            statistic="worst" if is_ft else "mean",
        )
    yield target(
        what=f"{where}: delay of the alarm",
        metric=DELAY,
        at_most=40.0 if is_ft else 80.0,
        statistic="median",
    )


def _random_targets(target: Callable[..., Target], where: str, *, is_ft: bool) -> Iterator[Target]:
    """What must hold on stacks drawn at random; means and medians over all seeds."""
    where = f"{where}: random stacks"
    for name in ("recall", "precision"):
        yield target(
            what=f"{where}, {name}",
            metric=f"rupture_{name}",
            at_least=0.98 if is_ft else 0.95,
            statistic="mean",
        )
    yield target(
        what=f"{where}, friction, mean of layers",
        metric="friction_error_online_mean_pct",
        at_most=6.0 if is_ft else 12.0,
        statistic="median",
    )
    yield target(
        what=f"{where}, friction within twice its standard deviation",
        metric="friction_coverage_online_2sigma",
        at_least=0.90,
        at_most=0.99,
        statistic="mean",
    )


def _real_targets() -> Iterator[Target]:
    """Real tissue: what the trivial guess reaches, what is aimed at, and four ruptures of four."""
    for scenario, what, metric, limit in (
        ("liver-real", "the guess beaten, median", "pullout_error_median_pct", 14.0),
        ("liver-real", "the guess beaten, 90th percentile", "pullout_error_p90_pct", 42.0),
        ("liver-real", "aim, median", "pullout_error_median_pct", 8.0),
        ("liver-real", "aim, 90th percentile", "pullout_error_p90_pct", 25.0),
        ("bovine-real", "ruptures missed", "ruptures_missed", 0.0),
        ("bovine-real", "false alarms", "ruptures_false", 0.0),
        ("bovine-real", "depth of the alarm", "rupture_depth_error_mm", 1.0),
    ):
        yield Target(
            what=f"{scenario}: {what}",
            metric=metric,
            plant="recording",
            source="ft",
            scenarios=(scenario,),
            at_most=limit,
        )


IDENTIFICATION_TARGETS: tuple[Target, ...] = (
    *(target for source, plant in JUDGED_ON for target in _targets(source, plant)),
    *_real_targets(),
)
