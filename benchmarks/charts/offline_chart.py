"""After the paper's Figures 2 and 3: the two models fitted offline, and what they leave."""

import numpy as np
from numpy.typing import NDArray

from benchmarks.charts.insertion_axis import InsertionAxis
from benchmarks.methods.offline_fit import layer_spans, offline_fit, quiet_speed_m_s
from benchmarks.signals.insertion_truth import InsertionTruth
from benchmarks.signals.needle_signal import NeedleSignal
from figures import Chart, Curve, LineStyle, Panel, Shading, palette
from identification import OfflineIdentification
from identification.regressor import Model, regression_matrix

Array = NDArray[np.float64]

AFTER_s = 1.0
NOT_FITTED = "#f0ead8"
MODELS: tuple[tuple[Model, str, LineStyle], ...] = (
    ("kv", "Kelvin-Voigt", palette.PAPER_KV),
    ("ml", "multi-layer", palette.OURS),
)


def offline_chart(title: str, signal: NeedleSignal, truth: InsertionTruth) -> Chart:
    """Reading, both reconstructions, and their errors; in and out of the tissue.

    The parameters are those of the insertion; the withdrawal is foretold with them.
    """
    axis = InsertionAxis(truth)
    shown = truth.t_s >= truth.contact_s - AFTER_s
    x, reading = axis.place(truth.t_s[shown]), signal.force_N[shown]
    forces = [Curve(style=palette.READING, x=x, y=reading, label="F/T reading")]
    errors = []
    for model, name, style in MODELS:
        fit = offline_fit(signal, truth, model)
        predicted = _prediction(fit, signal, truth)[shown]
        label = f"{name}, RMSE {fit.rmse_N:.3f} N"
        forces.append(Curve(style=style, x=x, y=predicted, label=label))
        errors.append(Curve(style=style, x=x, y=reading - predicted))
    end = axis.at(truth.insertion_end_s)
    return Chart(
        title=title,
        x_label=palette.INSERTION_TIME,
        panels=(
            Panel(y_label=palette.FORCE, curves=tuple(forces), height=1.7),
            Panel(y_label=palette.FORCE_ERROR, curves=tuple(errors)),
        ),
        shadings=(
            axis.true_ruptures(),
            Shading(label="not fitted: foretold", color=NOT_FITTED, spans=((end, float(x[-1])),)),
        ),
        x_limits=(float(x[0]), float(x[-1])),
    )


def _prediction(fit: OfflineIdentification, signal: NeedleSignal, truth: InsertionTruth) -> Array:
    """The model's force over the whole run."""
    depth = signal.depth_m - np.interp(truth.contact_s, truth.t_s, signal.depth_m)
    spans, speed = layer_spans(truth), quiet_speed_m_s(signal)
    matrix = regression_matrix(truth.t_s, depth, speed, spans, fit.model)
    parameters = [(layer.stiffness_N_per_m, layer.friction) for layer in fit.layers]
    return matrix @ np.array(parameters).ravel()
