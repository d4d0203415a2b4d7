"""Offline identification recovers what it was given and says what it cannot know."""

import numpy as np
import pytest

from identification import (
    InvalidConfigError,
    InvalidLogError,
    LayerSpan,
    identify_offline,
    regression_matrix,
)

THICKNESS_M = 0.03
STIFFNESS = 30.0
FRICTION = 9000.0

SPAN = {"start_s": -1.0, "start_depth_m": 0.0, "thickness_m": 0.1, "rupture_s": 9.0}


SPEEDS = {
    "constant": lambda t: np.full_like(t, 0.0023),
    "sinusoidal": lambda t: 0.003 * np.sin(np.pi * t / 20.0),
}


def traversal(speed):
    """Time, depth and speed through one layer, and the layer."""
    t = np.arange(0.0, 20.0, 0.002)
    v = SPEEDS[speed](t)
    z = np.cumsum(v) * 0.002
    end_s = float(t[np.searchsorted(z, THICKNESS_M)]) - 1e-9
    return t, z, v, LayerSpan(**SPAN | {"thickness_m": THICKNESS_M, "rupture_s": end_s})


@pytest.mark.parametrize("speed", SPEEDS)
def test_full_traversal_identifies_both_parameters(speed):
    t, z, v, span = traversal(speed)
    force = regression_matrix(t, z, v, [span]) @ [STIFFNESS, FRICTION]
    fit = identify_offline(t, z, v, force, [span])
    layer = fit.layers[0]
    found = layer.stiffness_N_per_m, layer.friction, layer.cumulative_friction_Ns_per_m

    assert (layer.stiffness_identified, layer.friction_identified) == (True, True)
    assert found == pytest.approx((STIFFNESS, FRICTION, FRICTION * THICKNESS_M))
    assert fit.rmse_N < 1e-9


def test_constant_speed_inside_one_layer_separates_nothing():
    t, z, v = (column[:5000] for column in traversal("constant")[:3])
    span = LayerSpan(**SPAN | {"rupture_s": 99.0})
    fit = identify_offline(t, z, v, STIFFNESS * z + FRICTION * z * v, [span])
    (layer,) = fit.layers

    assert (fit.rank, layer.stiffness_identified, layer.friction_identified) == (
        1,
        False,
        False,
    )
    assert (layer.friction_std, fit.rmse_N) == (np.inf, pytest.approx(0.0, abs=1e-9))


def test_standard_deviations_cover_the_truth():
    rng = np.random.default_rng(1)
    t, z, v, span = traversal("sinusoidal")
    clean = regression_matrix(t, z, v, [span]) @ [STIFFNESS, FRICTION]
    noises = 0.05 * rng.standard_normal((40, len(t)))
    fits = [identify_offline(t, z, v, clean + noise, [span]) for noise in noises]
    layers = [fit.layers[0] for fit in fits]
    errors = [(layer.friction - FRICTION) / layer.friction_std for layer in layers]

    assert 0.6 < np.std(errors) < 1.6


def test_a_membrane_ends_the_elastic_column_and_friction_shrinks_on_the_way_out():
    z = np.array([0.0, 0.01, 0.03, 0.01, 0.0])
    span = LayerSpan(**SPAN | {"thickness_m": 0.02, "rupture_s": 1.5})
    matrix = regression_matrix(np.arange(5.0), z, np.ones(5), [span])

    assert np.allclose(
        matrix.T, [[0.0, 0.01, 0.0, 0.0, 0.0], [0.0, 0.01, 0.02, 0.01, 0.0]]
    )


@pytest.mark.parametrize(
    ("model", "columns"), [("kv", (0.5, 0.1)), ("ml", (0.5, 0.5 * 0.1))]
)
def test_a_row_is_that_of_its_equation(model, columns):
    span = LayerSpan(**SPAN | {"thickness_m": 1.0})
    row = regression_matrix(
        np.zeros(1), np.array([0.5]), np.array([0.1]), [span], model
    )

    assert row[0] == pytest.approx(columns)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"force_N": [1.0]}, "rows"),
        ({"force_N": ["a", "b", "c"]}, "not a vector of numbers"),
        ({"force_N": [0.0, np.nan, 0.0]}, "not finite"),
        ({"t_s": [0.0, 2.0, 1.0]}, "increase"),
        ({"depth_m": [[0.0], [1.0], [2.0]]}, "vector"),
    ],
)
def test_bad_columns_are_refused(change, message):
    log = {key: [0.0, 0.1, 0.2] for key in ("depth_m", "speed_m_s", "force_N")}
    log["t_s"] = [0.0, 1.0, 2.0]

    with pytest.raises(InvalidLogError, match=message):
        identify_offline(**(log | change), layers=[LayerSpan(**SPAN)])


@pytest.mark.parametrize(
    ("spans", "model", "message"),
    [
        ([SPAN | {"thickness_m": 0.0}], "ml", "thickness"),
        ([SPAN | {"start_s": 2.0, "rupture_s": 1.0}], "ml", "rupture"),
        ([], "ml", "layer"),
        ([SPAN], "xx", "xx"),
    ],
)
def test_bad_and_no_layers_and_an_unknown_model_are_refused(spans, model, message):
    with pytest.raises(InvalidConfigError, match=message):
        identify_offline(
            *([0.0],) * 4, [LayerSpan(**span) for span in spans], model=model
        )
