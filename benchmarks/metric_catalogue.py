"""Every metric a row may carry. A new metric is a line here and a function that measures it."""

from collections.abc import Mapping
from types import MappingProxyType

from benchmarks.errors import UnknownMetricError
from benchmarks.identification_catalogue import (
    BOUNDS,
    IDENTIFICATION,
    LIVER_LIMIT,
    OFFLINE,
    REAL_TISSUE,
    TABLE_I,
)
from benchmarks.metric import Metric

# Axial force against the true one, from first contact to the end of withdrawal.
_WRENCH = (
    Metric(name="wrench_rmse_N", unit="N", meaning="rms error of the axial force", tolerance=1e-3),
    Metric(name="wrench_bias_N", unit="N", meaning="mean error", tolerance=5e-3),
    Metric(
        name="wrench_lag_ms",
        unit="ms",
        meaning="time shift that best aligns the estimate with the truth",
        tolerance=2.0,
    ),
    Metric(
        name="wrench_coverage_2sigma",
        unit="1",
        meaning="share of samples whose error lies within twice the stated standard deviation",
        best=0.95,
        tolerance=0.02,
    ),
)

_RESIDUAL = (
    Metric(
        name="residual_rms_Nm",
        unit="Nm",
        meaning="residual against the ideal filter of the true torque, worst joint",
        tolerance=1e-6,
    ),
    *(
        Metric(
            name=f"residual_rms_J{joint}_Nm",
            unit="Nm",
            meaning=f"rms residual of joint {joint} without contact",
            tolerance=5e-3,
        )
        for joint in range(1, 8)
    ),
)

_OBSERVERS = tuple(
    Metric(
        name=f"observer_{name}_rmse_N",
        unit="N",
        meaning=f"noise and lag of the {meaning}, at its best setting",
        tolerance=1e-3,
    )
    for name, meaning in (
        ("momentum", "momentum observer"),
        ("smoothed", "momentum observer with smoothed momentum"),
        ("kalman", "Kalman observer"),
    )
)

_WEIGHT = (
    Metric(
        name="force_up_unloaded_N",
        unit="N",
        meaning="mean vertical force without payload, truth 0",
        tolerance=0.1,
    ),
    Metric(
        name="force_up_unloaded_std_N",
        unit="N",
        meaning="scatter of that force over the recording",
        tolerance=0.1,
    ),
    Metric(
        name="force_up_loaded_N",
        unit="N",
        meaning="mean vertical force with the payload",
        best=-27.5,
        tolerance=0.1,
    ),
    Metric(
        name="force_up_loaded_std_N",
        unit="N",
        meaning="scatter of that force over the recording",
        tolerance=0.1,
    ),
    Metric(
        name="torque_scale",
        unit="1",
        meaning="common factor on all joint torques, fitted on the first half",
        best=1.0,
        tolerance=0.01,
    ),
    Metric(
        name="weight_error_pct",
        unit="%",
        meaning="error of the weight over the second half with that factor",
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
