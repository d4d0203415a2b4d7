"""The friction of a layer traversed, where hypotheses differ."""

import numpy as np
import pytest

from identification.mixture.evidence import weigh_evidence
from identification.mixture.force_model import FRICTION_LAST, LAYER
from identification.mixture.layer_report import friction_of_last_layer
from tests.identification.mixture import test_method
from tests.identification.mixture.mixtures import component, select


def test_hypotheses_that_differ_leave_the_friction_in_doubt():
    mixture = select(component(5, LAYER), [0, 0])
    mixture.means[:, FRICTION_LAST] = 0.1, 0.5
    mixture.covariances[:] = 0.0
    evidence = weigh_evidence(mixture, None, 0)

    friction = friction_of_last_layer(evidence, 1, force_variance=0.0)

    assert friction.force_N == pytest.approx(0.3)
    assert friction.std_N == pytest.approx(0.2)


def test_the_slow_error_of_the_sensor_is_in_the_friction():
    mixture = component(5, LAYER)
    mixture.covariances[:] = 0.0
    mixture.covariances[0, FRICTION_LAST, FRICTION_LAST] = 0.03**2
    evidence = weigh_evidence(mixture, None, 0)

    friction = friction_of_last_layer(evidence, 1, force_variance=0.04**2)

    assert friction.std_N == pytest.approx(np.hypot(0.03, 0.04))


def test_a_smooth_layer_does_not_make_a_rough_one_before_it_certain():
    rows = test_method.straight(seed=2)
    rng = np.random.default_rng(2)
    places_m = np.arange(-5e-3, 50e-3, 1e-4)
    texture_N = np.convolve(
        rng.standard_normal(len(places_m)), np.exp(-np.arange(30) / 10.0), "same"
    )
    texture_N *= 0.06 / texture_N.std()
    rough = [
        row._replace(
            force_N=row.force_N + float(np.interp(row.depth_m, places_m, texture_N))
        )
        if 0.0 < row.depth_m < 14.5e-3
        else row
        for row in rows
    ]

    identifier, estimates = test_method.run(rough)

    final = next(
        estimate.identified_layer
        for estimate in estimates
        if estimate.identified_layer is not None and estimate.identified_layer.is_final
    )
    assert final.layer == 1
    assert identifier.layers[0].friction_std_N > 0.8 * final.friction_std_N
