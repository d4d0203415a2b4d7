"""Rows of results, and a thin gel that takes seconds instead of half a minute."""

from dataclasses import replace

from benchmarks.results import Row
from groundtruth import Scenario
from groundtruth.materials import gel
from groundtruth.motion import constant_motion

TEMPLATE = {
    "scenario": "gel-25-constant",
    "plant": "degraded",
    "seed": 0,
    "source": "virtual",
    "method": "ours",
    "metric": "wrench_rmse_N",
    "value": 0.1,
    "unit": "N",
}


def make_row(**changes):
    """A row of an insertion on the degraded arm, with changes."""
    return Row(**(TEMPLATE | changes))


def by_head(table):
    """The lines of a table, each as cells by head.

    A head without text is "mark of" the head before it.
    """
    names = []
    for head in table.heads:
        name = head.replace("\n", " ")
        names.append(name or f"mark of {names[-1]}")
    return [dict(zip(names, line, strict=True)) for line in table.lines]


def silent(fraction):
    """A progress that is not shown."""
    assert 0.0 <= fraction <= 1.0


def gel_slice(percent=70, *, thickness_m=12e-3, speed_m_s=5e-3):
    """An insertion at constant speed into a slice of one of the published gels."""
    depth_m = thickness_m + 11e-3
    return Scenario(
        id="short",
        title="a slice of gel",
        layers=(replace(gel(percent), thickness_m=thickness_m),),
        motion=constant_motion(speed_m_s=speed_m_s, depth_m=depth_m, standoff_m=10e-3),
    )
