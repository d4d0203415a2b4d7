"""The force of a sample split into tip force and friction."""

import numpy as np
import pytest

from foundation.records import as_record
from identification.estimate import (
    NO_EVENTS,
    RuptureState,
    SampleStatus,
    make_estimate,
)
from identification.mixture.force_split import estimate_sample
from identification.mixture.needle_contact import NeedleContact
from identification.mixture.shaft_posterior import Friction, ShaftPosterior


@pytest.mark.parametrize("friction_N", [0.2, 1.0, 1.4])
def test_an_erring_model_leaves_no_negative_tip_force(friction_N):
    contact = NeedleContact(deflection=1.0, deepest_m=0.02)
    posterior = ShaftPosterior(
        in_contact=True,
        model_error_variance=0.3**2,
        shaft=Friction(coulomb=friction_N, coulomb_variance=0.3**2),
    )
    outputs = estimate_sample(
        as_record(posterior), as_record(contact), np.zeros((0, 4)), 0.02, 0.005, 1.1
    )
    estimate = make_estimate(
        0.0, SampleStatus.OK, RuptureState.NO_RUPTURE, outputs, NO_EVENTS
    )
    tips_N = np.random.default_rng(3).normal(1.1 - friction_N, 0.3, 1_000_000)
    tips_N = tips_N[tips_N > 0.0]
    excess_N = max(friction_N - 1.1, 0.0)
    std_N = np.hypot(tips_N.std(), excess_N)

    assert estimate.tip_force_N == pytest.approx(tips_N.mean(), abs=2e-3)
    assert estimate.shaft_friction_N == pytest.approx(1.1 - tips_N.mean(), abs=2e-3)
    assert estimate.tip_force_std_N == pytest.approx(std_N, abs=2e-3)
    assert estimate.shaft_friction_std_N == pytest.approx(std_N, abs=2e-3)
