"""Tissues outside the catalogue's law: each says what it changes and changes nothing
else."""

import numpy as np
import pytest

from groundtruth import (
    ScenarioError,
    Texture,
    Tissue,
    TissueVariation,
    gel,
    insert_needle,
    random_stack,
    random_tissue,
    scenario,
)

SPEED = 2.3e-3
FADE_M = 5e-3


def varied(layer, **change):
    return TissueVariation(**change).layer(layer, np.random.default_rng(0))


def pushed_through(layers, end_m, speed_m_s=SPEED):
    """Depths 1e-5 m apart and the forces there."""
    law = Tissue(layers)
    depths = np.arange(-1e-3, end_m, 1e-5)
    return depths, [law.step(float(z), speed_m_s, 1e-5 / speed_m_s) for z in depths]


@pytest.mark.parametrize(
    "name", ["texture-20mN", "release-2mm", "concave", "kept-60", "speed-0.3"]
)
def test_variations_keep_the_boundaries(name):
    plain = scenario("stack-glove-constant", 0)
    varied = scenario(f"{plain.id}+{name}", 0)
    run = insert_needle(varied, rate_hz=200.0)
    boundaries = Tissue(plain.layers).interfaces[1:]
    is_beyond = run.depth_m > boundaries[-1].depth_m + 2.1e-3

    assert (varied.id, varied.motion) == (f"{plain.id}+{name}", plain.motion)
    assert [rupture.onset_m for rupture in run.truth.ruptures] == pytest.approx(
        [boundary.onset_m for boundary in boundaries]
    )
    assert not run.truth.tip_N[is_beyond].any()


def test_texture_has_stated_spread_and_correlation():
    place = np.arange(0.0, 30e-3, 2e-5)
    rngs = map(np.random.default_rng, range(20))
    textures = [Texture.drawn(0.02, 0.5e-3, rng) for rng in rngs]
    force = np.array([[texture.force_N(x) for x in place] for texture in textures])

    assert force.std() == pytest.approx(0.02, rel=0.05)
    for lag in (0.25e-3, 0.5e-3, 1e-3):
        apart = round(lag / 2e-5)
        together = (force[:, apart:] * force[:, :-apart]).mean() / force.var()
        assert together == pytest.approx(np.exp(-((lag / 0.5e-3) ** 2) / 2.0), abs=0.05)


def test_a_cut_slips_behind_a_rupture_by_what_is_drawn():
    layers = tuple(varied(gel(70), slip_N=0.15) for _ in range(2))
    end = 2 * gel(70).thickness_m
    depth, even = pushed_through((gel(70), gel(70)), end)
    _, slipping = pushed_through(layers, end)
    extra = np.array([b.tip_N - a.tip_N for a, b in zip(even, slipping, strict=True)])
    is_top = (extra[1:-1] > extra[:-2]) & (extra[1:-1] > extra[2:])
    tops = np.flatnonzero(is_top) + 1
    apart_m = np.diff(depth[tops])

    assert not extra[depth <= gel(70).thickness_m].any()
    assert len(tops) > 10
    assert 0.04 < extra[tops].min() < extra[tops].max() <= 0.15
    assert 0.29e-3 < apart_m.min() < apart_m.max() < 2.01e-3
    assert np.abs(extra[tops + 3]).max() < 0.02


def test_kept_tip_force_fades_after_an_internal_rupture():
    layers = (gel(70), gel(70))
    keeping = tuple(varied(layer, kept_fraction=0.6) for layer in layers)
    end = 2 * gel(70).thickness_m + 2e-3
    depth, plain = pushed_through(layers, end)
    _, held = pushed_through(keeping, end)
    extra = np.array([b.tip_N - a.tip_N for a, b in zip(plain, held, strict=True)])
    onset = gel(70).thickness_m
    at_release = np.interp(onset + gel(70).release_m, depth, extra)
    remaining = (1.0 - gel(70).release_m / FADE_M) ** 2

    assert not extra[depth < onset].any()
    assert at_release == pytest.approx(0.6 * gel(70).exit_force_N * remaining, rel=0.02)
    assert np.abs(extra[depth > onset + FADE_M]).max() < 1e-12


def test_friction_follows_powers_of_length_and_speed():
    layer = varied(gel(70), length_exponent=0.6)
    depth, plain = pushed_through((gel(70),), gel(70).thickness_m)
    _, power = pushed_through((layer,), gel(70).thickness_m)
    for fraction in (0.25, 0.5, 1.0):
        k = int(np.searchsorted(depth, fraction * gel(70).thickness_m)) - 1
        ratio = power[k].friction_N / plain[k].friction_N
        assert ratio == pytest.approx(fraction**-0.4, rel=1e-3)
        assert power[k].tip_N == plain[k].tip_N
    plain = gel(70).friction
    power = varied(gel(70), speed_exponent=0.3).friction
    slid = plain.sliding_N_per_m(SPEED)
    speeds = (SPEED, 2 * SPEED, -SPEED, 1e-9)

    assert [power.sliding_N_per_m(speed) / slid for speed in speeds] == [
        *(pytest.approx(1.0), pytest.approx(2**0.3), pytest.approx(-1.0)),
        pytest.approx(0.0, abs=1e-3),
    ]


@pytest.mark.slow
def test_random_tissue_is_random_stack_with_drawn_laws():
    rough = "gel-70-constant+texture-20mN"

    assert scenario(rough, 1) == scenario(rough, 1) != scenario(rough, 2)
    assert scenario("random-stack+kept-60", 3).layers[0].kept_fraction == 0.6
    with pytest.raises(ScenarioError, match="soft"):
        scenario("gel-70-constant+soft", 0)

    stacks = [random_stack(np.random.default_rng(seed)) for seed in range(60)]
    tissues = [random_tissue(np.random.default_rng(seed)) for seed in range(60)]

    assert scenario("random-tissue", 7) == tissues[7]
    assert [item.motion for item in tissues] == [item.motion for item in stacks]

    exponents = [layer.tip_exponent for item in tissues for layer in item.layers]

    assert 0.5 < min(exponents) < 0.8 < 1.5 < max(exponents) < 2.0
