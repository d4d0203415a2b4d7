"""Every metric a row may carry. A new metric is a line here and a function that measures it."""

from collections.abc import Mapping
from types import MappingProxyType

from benchmarks.errors import UnknownMetricError
from benchmarks.metrics.identification_catalogue import (
    BOUNDS,
    IDENTIFICATION,
    LIVER_LIMIT,
    OFFLINE,
    REAL_TISSUE,
    TABLE_I,
)
from benchmarks.metrics.metric import Metric

# Axial force against the true one, from first contact to the end of withdrawal.
_WRENCH = (
    Metric("wrench_rmse_N", "rms error of the axial force", tolerance=1e-3),
    Metric("wrench_bias_N", "mean error", tolerance=5e-3),
    Metric(
        "wrench_lag_ms", "time shift that best aligns the estimate with the truth", tolerance=2.0
    ),
    Metric(
        "wrench_coverage_2sigma",
        "share of samples whose error lies within twice the stated standard deviation",
        best=0.95,
        tolerance=0.02,
    ),
)

_RESIDUAL = (
    Metric(
        "residual_rms_Nm",
        "residual against the ideal filter of the true torque, worst joint",
        tolerance=1e-6,
    ),
    *(
        Metric(
            f"residual_rms_J{joint}_Nm",
            f"rms residual of joint {joint} without contact",
            tolerance=5e-3,
        )
        for joint in range(1, 8)
    ),
)

_OBSERVERS = tuple(
    Metric(
        f"observer_{name}_rmse_N",
        f"noise and lag of the {meaning}, at its best setting",
        tolerance=1e-3,
    )
    for name, meaning in (
        ("momentum", "momentum observer"),
        ("smoothed", "momentum observer with smoothed momentum"),
        ("kalman", "Kalman observer"),
    )
)

_WEIGHT = (
    Metric("force_up_unloaded_N", "mean vertical force without payload, truth 0", tolerance=0.1),
    Metric("force_up_unloaded_std_N", "scatter of that force over the recording", tolerance=0.1),
    Metric("force_up_loaded_N", "mean vertical force with the payload", best=-27.5, tolerance=0.1),
    Metric("force_up_loaded_std_N", "scatter of that force over the recording", tolerance=0.1),
    Metric(
        "torque_scale",
        "common factor on all joint torques, fitted on the first half",
        best=1.0,
        tolerance=0.01,
    ),
    Metric(
        "weight_error_pct",
        "error of the weight over the second half with that factor",
        tolerance=0.2,
    ),
)

METRICS: Mapping[str, Metric] = MappingProxyType(
    {
        metric.name: metric
        for metric in (
            *_WRENCH,
            *_RESIDUAL,
            *_OBSERVERS,
            *_WEIGHT,
            *IDENTIFICATION,
            *BOUNDS,
            *TABLE_I,
            *OFFLINE,
            *REAL_TISSUE,
            *LIVER_LIMIT,
        )
    }
)
"""By name."""


def metric(name: str) -> Metric:
    """The metric of that name.

    Raises:
        UnknownMetricError: There is none.
    """
    try:
        return METRICS[name]
    except KeyError:
        raise UnknownMetricError(f"no metric {name!r}; known: {', '.join(METRICS)}") from None
