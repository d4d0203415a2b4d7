"""What the mixture knows of the shaft, where its hypotheses differ."""

import numpy as np
import pytest

from foundation.records import as_record, from_record
from identification.multilayer.evidence import weigh_evidence
from identification.multilayer.force_model import (
    HELD,
    LAYER,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    OFFSET,
    TRAVERSED_COULOMB,
    TRAVERSED_VISCOUS,
)
from identification.multilayer.shaft_posterior import ShaftPosterior, update_posterior
from tests.identification.multilayer.mixtures import BLOCK, component, select

ON_SHAFT = [TRAVERSED_COULOMB, TRAVERSED_VISCOUS, OFFSET]


def known_of_two(first, second):
    """What is known of two certain, equally likely hypotheses of friction and offset.

    Nothing else rubs.
    """
    mixture = select(component(5, LAYER), [0, 0])
    mixture.means[:, [LAYER_COULOMB, LAYER_VISCOUS, HELD]] = 0.0
    mixture.means[0, ON_SHAFT] = first
    mixture.means[1, ON_SHAFT] = second
    mixture.covariances[:] = 0.0
    record = as_record(ShaftPosterior())
    evidence = weigh_evidence(mixture, None, 1)
    update_posterior(record, evidence, BLOCK, 1, 1, 2.0)
    return from_record(ShaftPosterior, record)


def test_hypotheses_that_differ_leave_the_shaft_in_doubt():
    known = known_of_two((0.1, 0.01, 0.0), (0.5, 0.03, 0.0))
    shaft = known.shaft

    assert shaft.coulomb == pytest.approx(0.3)
    assert shaft.viscous == pytest.approx(0.02)
    assert np.sqrt(shaft.coulomb_variance) == pytest.approx(0.2)
    assert np.sqrt(shaft.viscous_variance) == pytest.approx(0.01)
    assert shaft.covariance == pytest.approx(0.2 * 0.01)


def test_an_offset_that_friction_makes_up_for_is_correlated_with_it():
    known = known_of_two((0.1, 0.0, 0.06), (0.2, 0.0, -0.04))

    assert known.offset == pytest.approx(0.01)
    assert np.sqrt(known.offset_variance) == pytest.approx(0.05)
    assert known.shaft.offset_coulomb == pytest.approx(-0.05 * 0.05)
