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
    return Row(**(TEMPLATE | changes))


def silent(fraction):
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
