"""The figures this toolkit has set itself for online identification.

Friction is judged as it was known online, in the layer after the one it is of, not with hindsight.
"""

from collections.abc import Iterator

from benchmarks.targets import TISSUE, Target

GELS = tuple(name for name in TISSUE if name.startswith("gel-"))
STACKS = tuple(name for name in TISSUE if name.startswith("stack-"))
RANDOM = ("random-stack",)
JUDGED_ON = (("ft", "needle"), ("ft", "realistic"), ("virtual", "realistic"))
"""Source and plant: the F/T sensor on the needle alone and on the arm, the virtual one on it."""
PAPER_SHARE = 0.5


def _targets(source: str, plant: str) -> Iterator[Target]:
    """The targets of one source on one plant."""
    ft = source == "ft"
    where = f"{'F/T' if ft else 'virtual'}, {plant}"

    def most(what: str, metric: str, limit: float, scenarios: tuple[str, ...]) -> Target:
        return Target(
            what=f"{where}: {what}",
            metric=metric,
            plant=plant,
            source=source,
            scenarios=scenarios,
            at_most=limit,
        )

    friction = "friction_error_online_worst_pct"
    yield most("friction, gels", friction, 5.0 if ft else 10.0, GELS)
    yield most("friction, stacks, worst layer", friction, 10.0 if ft else 20.0, STACKS)
    yield most(
        "residue, gels and stacks", "exit_residue_pct", 5.0 if ft else 10.0, (*GELS, *STACKS)
    )
    yield from _rupture_targets(source, plant, where)
    for what, metric in (("friction", friction), ("delay", "rupture_delay_ms")):
        yield Target(
            what=f"{where}: {what} as a share of the paper's in the same run",
            metric=metric,
            plant=plant,
            source=source,
            scenarios=TISSUE,
            at_most=PAPER_SHARE,
            of_paper=True,
            where_paper_tells=True,
            # A single small error of the paper's method is luck.
            statistic="median",
        )
    yield from _random_targets(source, plant, where)


def _rupture_targets(source: str, plant: str, where: str) -> Iterator[Target]:
    """Recall, precision and delay over the catalogue's tissues."""
    ft = source == "ft"
    for name in ("recall", "precision"):
        yield Target(
            what=f"{where}: {name}, each tissue" if ft else f"{where}: {name}, all together",
            metric=f"rupture_{name}",
            plant=plant,
            source=source,
            scenarios=TISSUE,
            at_least=1.0 if ft else 0.98,
            statistic="worst" if ft else "mean",
        )
    yield Target(
        what=f"{where}: delay of the alarm",
        metric="rupture_delay_ms",
        plant=plant,
        source=source,
        scenarios=TISSUE,
        at_most=40.0 if ft else 80.0,
        statistic="median",
    )


def _random_targets(source: str, plant: str, where: str) -> Iterator[Target]:
    """What must hold on stacks drawn at random; means and medians over all seeds."""
    ft = source == "ft"
    for name in ("recall", "precision"):
        yield Target(
            what=f"{where}: random stacks, {name}",
            metric=f"rupture_{name}",
            plant=plant,
            source=source,
            scenarios=RANDOM,
            at_least=0.98 if ft else 0.95,
            statistic="mean",
        )
    yield Target(
        what=f"{where}: random stacks, friction, mean of layers",
        metric="friction_error_online_mean_pct",
        plant=plant,
        source=source,
        scenarios=RANDOM,
        at_most=6.0 if ft else 12.0,
        statistic="median",
    )
    yield Target(
        what=f"{where}: random stacks, friction within twice its standard deviation",
        metric="friction_coverage_online_2sigma",
        plant=plant,
        source=source,
        scenarios=RANDOM,
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
