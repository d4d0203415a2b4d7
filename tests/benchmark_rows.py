"""Rows for the tests of `benchmarks`."""

from benchmarks.rows import Row

TEMPLATE = {
    "scenario": "gel-25-constant",
    "plant": "degraded",
    "seed": 0,
    "source": "virtual",
    "method": "default",
    "metric": "wrench_rmse_N",
    "value": 0.1,
    "unit": "N",
}


def make_row(**changes):
    return Row(**(TEMPLATE | changes))
