"""The paper's Table I beside ours."""

import statistics
from collections.abc import Sequence

from benchmarks.report.gel_friction import PERCENTS, SPEEDS, GelFriction
from benchmarks.tables.summary import NOTHING
from benchmarks.verdict.published import TABLE_ONE_Ns_per_m
from figures import PageTable

ONLINE = (
    ("published, tuned, F/T", "tuned", "ft", "paper"),
    ("published, F/T", "online", "ft", "paper"),
    ("ours, F/T", "online", "ft", "default"),
    ("ours, virtual", "online", "virtual", "default"),
)
"""Words, kind, source, method."""


def gel_table(gels: GelFriction) -> PageTable:
    """Mean ± spread over the two speeds (and seeds), and the way from offline in per cent."""
    head = ["gel", "paper\noffline", "paper\nonline", "here\ntrue", "here\noffline"]
    head += [f"here online\n{words}" for words, *_ in ONLINE]
    rows = []
    for percent in PERCENTS:
        published = TABLE_ONE_Ns_per_m[percent]
        offline = _both(gels, percent, "offline")
        rows.append(
            (
                f"{percent} %",
                f"{published.offline} ± {published.offline_spread}",
                f"{published.online} ± {published.online_spread}"
                f" ({100.0 * (published.online / published.offline - 1.0):+.0f} %)",
                _cell(_both(gels, percent, "true")),
                _cell(offline),
                *(_cell(_both(gels, percent, *key), offline) for _, *key in ONLINE),
            )
        )
    return PageTable(
        caption="Cumulative friction of single gels [Ns/m]: mean ± spread over both speeds "
        "(online: difference from offline)",
        head=tuple(head),
        rows=tuple(rows),
        numeric=frozenset(range(1, len(head))),
        note="The paper calls its spread a variance; its size and unit are those of a standard "
        "deviation. Tuned: with the commanded speed, as its authors ran it; else with the speed "
        "that the arm measures, whose noise the published method takes for excitation.",
    )


def _both(
    gels: GelFriction, percent: int, kind: str, source: str = "ft", method: str = "default"
) -> list[float]:
    return [
        value
        for speed in SPEEDS
        for value in gels.values(percent, speed, kind, source=source, method=method)
    ]


def _cell(values: Sequence[float], offline: Sequence[float] = ()) -> str:
    if not values:
        return NOTHING
    mean = statistics.fmean(values)
    spread = f" ± {statistics.pstdev(values):.0f}" if len(values) > 1 else ""
    more = ""
    if offline:
        more = f" ({100.0 * (mean / statistics.fmean(offline) - 1.0):+.0f} %)"
    return f"{mean:.0f}{spread}{more}"
