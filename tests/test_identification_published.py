"""The published method on forces made by its own model (3), ruptures released at once."""

import numpy as np
import pytest

from identification.config import PUBLISHED, PUBLISHED_KV, PublishedConfig
from identification.errors import InvalidConfigError
from identification.estimate import RuptureState
from identification.identifier import Identifier

DT_S, SPEED = 1e-3, 2.3e-3
LAYERS = ((0.030, 15.0, 8_000.0), (0.020, 60.0, 9_000.0))


def ml_insertion(layers=LAYERS, noise_N=0.01, beyond_m=4e-3, seed=3):
    """Depth and force of an insertion at constant speed through layers (d, K, B)."""
    rng = np.random.default_rng(seed)
    total = sum(layer[0] for layer in layers) + beyond_m
    z = np.arange(-1e-3, total, SPEED * DT_S)
    f, start = np.zeros_like(z), 0.0
    for thickness, stiffness, friction in layers:
        reach = np.clip(z - start, 0.0, thickness)
        f += friction * reach * SPEED + np.where(reach < thickness, stiffness * reach, 0.0)
        start += thickness
    return z, f + noise_N * rng.standard_normal(len(z))


def run(identifier, z, f):
    return [identifier.update(float(a), SPEED, float(b), DT_S) for a, b in zip(z, f, strict=True)]


def test_finds_ruptures_and_friction_of_its_own_model():
    z, f = ml_insertion()
    identifier = Identifier(PUBLISHED)
    estimates = run(identifier, z, f)
    ruptures = [e.rupture for e in estimates if e.rupture]
    assert [round(r.depth_m, 3) for r in ruptures] == [0.030, 0.050]
    for layer, (thickness, stiffness, friction) in zip(identifier.layers, LAYERS, strict=True):
        assert layer.thickness_m == pytest.approx(thickness, rel=0.02)
        assert layer.friction_Ns_per_m2 == pytest.approx(friction, rel=0.25)
        assert layer.stiffness_N_per_m == pytest.approx(stiffness, rel=0.25)
    last = np.mean([e.enhanced_force_N for e in estimates[-500:]])
    assert abs(last) < 0.2 * np.mean(f[-500:])


def test_states_follow_the_machine():
    z, f = ml_insertion(LAYERS[:1])
    states = [e.rupture_state for e in run(Identifier(PUBLISHED), z, f)]
    detected = states.index(RuptureState.DETECTED)
    measuring = states.count(RuptureState.FORCE_DROP_MEASURING) * DT_S
    assert states[detected + 1] is RuptureState.FORCE_DROP_MEASURING
    assert measuring == pytest.approx(1e-3 / SPEED, abs=0.01)
    assert states[-1] in (RuptureState.NO_RUPTURE, RuptureState.EXPECTED)


def test_compensation_leaves_no_jump_in_the_prediction():
    z, f = ml_insertion(noise_N=0.002)
    estimates = run(Identifier(PUBLISHED), z, f)
    at = next(k for k, e in enumerate(estimates) if e.identified_layer)
    after = [
        abs(e.predicted_force_N - y) for e, y in zip(estimates[at + 1 :], f[at + 1 :], strict=True)
    ][:200]
    assert max(after) < 0.15


def test_a_layer_is_listed_when_identified_and_subtracted_from_the_next_sample_on():
    z, f = ml_insertion(LAYERS[:1])
    identifier, before = Identifier(PUBLISHED), 0
    for a, b in zip(z, f, strict=True):
        estimate = identifier.update(float(a), SPEED, float(b), DT_S)
        if estimate.identified_layer:
            break
        assert estimate.cumulative_friction_Ns_per_m == 0.0
        before = before or len(identifier.layers)
    assert before == 1
    assert identifier.layers == (estimate.identified_layer,)
    share = estimate.identified_layer.friction_N / estimate.identified_layer.rupture.speed_m_s
    assert estimate.cumulative_friction_Ns_per_m == pytest.approx(share)


def test_nothing_happens_before_contact():
    estimates = run(Identifier(PUBLISHED), np.linspace(-0.01, -0.001, 500), np.zeros(500))
    assert all(not e.in_contact and e.layer == 0 and e.rupture is None for e in estimates)


def test_multilayer_model_compensates_better_than_kelvin_voigt():
    z, f = ml_insertion()
    residues = []
    for config in (PUBLISHED, PUBLISHED_KV):
        estimates = run(Identifier(config), z, f)
        residues.append(abs(np.mean([e.enhanced_force_N for e in estimates[-500:]])))
    assert residues[0] < residues[1]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"model": "xx"}, "unknown model"),
        ({"sigma0_N": 0.1}, "exceed"),
        ({"reset_frequency_Hz": 0.0}, "positive"),
        ({"drop_travel_m": float("nan")}, "finite"),
    ],
)
def test_bad_settings_are_refused(change, message):
    with pytest.raises(InvalidConfigError, match=message):
        PublishedConfig(**change)
