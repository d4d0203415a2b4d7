"""Offline identification recovers what it was given and says what it cannot know."""

import numpy as np
import pytest

from identification.errors import InvalidConfigError, InvalidLogError
from identification.published.offline import (
    LayerSpan,
    identify_offline,
    regression_matrix,
)

THICKNESS_M = 0.03
STIFFNESS = 30.0
FRICTION = 9000.0


def _insertion(speed_of_t, duration_s=20.0):
    t = np.arange(0.0, duration_s, 0.002)
    v = speed_of_t(t)
    return t, np.cumsum(v) * 0.002, v


def _one_layer(t, z):
    end_s = float(t[np.searchsorted(z, THICKNESS_M)]) - 1e-9
    return LayerSpan(
        start_s=-1.0, start_depth_m=0.0, thickness_m=THICKNESS_M, rupture_s=end_s
    )


def _constant(t):
    return np.full_like(t, 0.0023)


def _sinusoidal(t):
    return 0.003 * np.sin(np.pi * t / 20.0)


@pytest.mark.parametrize("speed", [_constant, _sinusoidal])
def test_full_traversal_identifies_both_parameters(speed):
    t, z, v = _insertion(speed)
    span = _one_layer(t, z)
    force = regression_matrix(t, z, v, [span]) @ [STIFFNESS, FRICTION]
    fit = identify_offline(t, z, v, force, [span])
    layer = fit.layers[0]

    assert layer.stiffness_identified
    assert layer.friction_identified
    assert layer.stiffness_N_per_m == pytest.approx(STIFFNESS)
    assert layer.friction == pytest.approx(FRICTION)
    assert layer.cumulative_friction_Ns_per_m == pytest.approx(FRICTION * THICKNESS_M)
    assert fit.rmse_N < 1e-9


def test_constant_speed_inside_one_layer_separates_nothing():
    t, z, v = _insertion(_constant, duration_s=10.0)
    span = LayerSpan(
        start_s=-1.0, start_depth_m=0.0, thickness_m=THICKNESS_M, rupture_s=99.0
    )
    fit = identify_offline(t, z, v, STIFFNESS * z + FRICTION * z * v, [span])

    assert fit.rank == 1
    assert not fit.layers[0].stiffness_identified
    assert not fit.layers[0].friction_identified
    assert fit.layers[0].friction_std == np.inf
    assert fit.rmse_N < 1e-9


def test_standard_deviations_cover_the_truth():
    rng = np.random.default_rng(1)
    t, z, v = _insertion(_sinusoidal)
    span = _one_layer(t, z)
    clean = regression_matrix(t, z, v, [span]) @ [STIFFNESS, FRICTION]
    errors = []
    for _ in range(40):
        fit = identify_offline(
            t, z, v, clean + 0.05 * rng.standard_normal(len(t)), [span]
        )
        layer = fit.layers[0]
        errors.append((layer.friction - FRICTION) / layer.friction_std)

    assert 0.6 < np.std(errors) < 1.6


def test_membrane_ends_elastic_column_at_its_own_rupture():
    t, z, v = _insertion(_constant)
    span = LayerSpan(
        start_s=0.5, start_depth_m=float(z[250]), thickness_m=0.02, rupture_s=3.0
    )
    matrix = regression_matrix(t, z, v, [span])

    assert np.all(matrix[t > 3.0, 0] == 0)
    assert np.all(matrix[t > 3.1, 1] > 0)
    assert matrix[-1, 1] == pytest.approx(0.02 * v[-1])


@pytest.mark.parametrize(
    ("model", "columns"), [("kv", (0.5, 0.1)), ("ml", (0.5, 0.5 * 0.1))]
)
def test_a_row_is_that_of_its_equation(model, columns):
    span = LayerSpan(start_s=-1.0, start_depth_m=0.0, thickness_m=1.0, rupture_s=9.0)
    row = regression_matrix(
        np.zeros(1), np.array([0.5]), np.array([0.1]), [span], model
    )

    assert row[0] == pytest.approx(columns)


def test_friction_column_shrinks_again_on_the_way_out():
    t = np.arange(5.0)
    z = np.array([0.0, 0.01, 0.03, 0.01, 0.0])
    span = LayerSpan(start_s=-1.0, start_depth_m=0.0, thickness_m=0.02, rupture_s=1.5)
    column = regression_matrix(t, z, np.ones(5), [span])[:, 1]

    assert np.allclose(column, [0.0, 0.01, 0.02, 0.01, 0.0])


SPAN = {"start_s": 0.0, "start_depth_m": 0.0, "thickness_m": 0.1, "rupture_s": 9.0}


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
    ("change", "message"),
    [
        ({"thickness_m": 0.0}, "thickness"),
        ({"start_s": 2.0, "rupture_s": 1.0}, "rupture"),
    ],
)
def test_bad_layers_are_refused(change, message):
    with pytest.raises(InvalidConfigError, match=message):
        LayerSpan(**(SPAN | change))


@pytest.mark.parametrize(
    ("layers", "model", "message"),
    [([], "ml", "layer"), ([LayerSpan(**SPAN)], "xx", "xx")],
)
def test_no_layer_and_an_unknown_model_are_refused(layers, model, message):
    with pytest.raises(InvalidConfigError, match=message):
        identify_offline([0.0], [0.0], [0.0], [0.0], layers, model=model)
