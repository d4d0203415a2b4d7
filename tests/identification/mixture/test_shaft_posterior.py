"""What the mixture knows of the shaft, where its hypotheses differ."""

import numpy as np
import pytest

from foundation.records import as_record, from_record
from identification.mixture.evidence import weigh_evidence
from identification.mixture.force_model import (
    FRICTION_LAST,
    HELD,
    LAYER,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    OFFSET,
    TRAVERSED_COULOMB,
    TRAVERSED_VISCOUS,
)
from identification.mixture.shaft_posterior import ShaftPosterior, update_posterior
from tests.identification.mixture.mixtures import BLOCK, component, select

ON_SHAFT = [TRAVERSED_COULOMB, TRAVERSED_VISCOUS, OFFSET]


def known_of_two(first, second, *, layer_N=0.0, ruptures=1, reported=1):
    """What is known of two certain, equally likely hypotheses of friction and offset.

    Nothing else rubs. Each knows of so many ruptures, and takes a part of its friction
    for that of its last layer.
    """
    mixture = select(component(5, LAYER), [0, 0])
    mixture.means[:, [LAYER_COULOMB, LAYER_VISCOUS, HELD]] = 0.0
    mixture.means[0, ON_SHAFT] = first
    mixture.means[1, ON_SHAFT] = second
    mixture.means[:, FRICTION_LAST] = layer_N
    mixture.covariances[:] = 0.0
    mixture.assumptions["ruptures"] = ruptures
    record = as_record(ShaftPosterior())
    evidence = weigh_evidence(mixture, None, reported)
    update_posterior(record, evidence, BLOCK, reported, reported, 2.0)
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


def test_before_the_first_rupture_is_reported_no_layer_is_traversed():
    known = known_of_two((0.1, 0.01, 0.0), (0.5, 0.03, 0.0), ruptures=1, reported=0)

    assert known.traversed.coulomb == 0.0
    assert known.traversed.viscous == 0.0
    assert known.traversed.coulomb_variance == 0.0
    assert known.shaft.coulomb == pytest.approx(0.3)


def test_friction_of_a_layer_whose_end_is_not_reported_is_not_traversed():
    known = known_of_two(
        (0.5, 0.0, 0.0), (0.5, 0.0, 0.0), layer_N=0.2, ruptures=2, reported=1
    )

    assert known.traversed.coulomb == pytest.approx(0.3)
    assert known.shaft.coulomb == pytest.approx(0.5)
