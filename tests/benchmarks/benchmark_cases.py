"""Rows of results, and a thin gel that takes seconds instead of half a minute."""

from dataclasses import replace

from benchmarks.campaign import make_frame
from benchmarks.judging import COLUMNS, unit_of
from groundtruth import Scenario, constant_motion, gel


def make_results(*rows):
    """A frame of results of an insertion on the degraded arm, each row with changes."""
    usual = {
        "scenario": "gel-25-constant",
        "plant": "degraded",
        "seed": 0,
        "source": "virtual",
        "method": "ours",
        "metric": "wrench_rmse_N",
        "value": 0.1,
    }
    return make_frame(
        [
            tuple((row | {"unit": unit_of(row["metric"])})[name] for name in COLUMNS)
            for row in [usual | row for row in rows]
        ]
    )


def make_seeds(values, **changes):
    """A frame of results with a row for each value, each of another seed."""
    return make_results(
        *({"seed": k, "value": value} | changes for k, value in enumerate(values))
    )


def gel_slice(percent=70, *, thickness_m=12e-3, speed_m_s=5e-3):
    """An insertion at constant speed into a slice of one of the published gels."""
    depth_m = thickness_m + 11e-3
    return Scenario(
        id="short",
        title="a slice of gel",
        layers=(replace(gel(percent), thickness_m=thickness_m),),
        motion=constant_motion(speed_m_s=speed_m_s, depth_m=depth_m, standoff_m=10e-3),
    )
