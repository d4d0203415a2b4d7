"""The friction of a layer traversed, where hypotheses differ."""

import numpy as np
import pytest

from identification.multilayer.evidence import weigh_evidence
from identification.multilayer.force_model import FRICTION_LAST, LAYER
from identification.multilayer.layer_report import friction_of_last_layer
from tests.identification.multilayer.mixtures import component, select


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
