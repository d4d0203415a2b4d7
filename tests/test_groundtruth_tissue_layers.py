"""Layers and the boundaries between them."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest

from groundtruth.errors import TissueError
from groundtruth.layers import CUTTING_ONSET_M, interfaces
from groundtruth.materials import GLOVE, bovine_liver, gel


@pytest.mark.parametrize("layer", [gel(25), gel(70, membrane=GLOVE), bovine_liver()])
def test_tip_force_rises_to_the_exit_force(layer):
    penetration = np.linspace(0.0, layer.thickness_m - layer.entry_m, 500)
    force = [layer.tip_force_N(float(p)) for p in penetration]
    assert force[0] == 0.0
    assert force[-1] == pytest.approx(layer.exit_force_N)
    assert (np.diff(force) > 0.0).all()


def test_cutting_force_builds_up_within_a_needle_diameter_and_stays():
    cutting = replace(gel(50), cutting_share=1.0)
    assert cutting.tip_force_N(0.5 * CUTTING_ONSET_M) == pytest.approx(0.75 * cutting.exit_force_N)
    for penetration in (CUTTING_ONSET_M, 0.01, 0.03):
        assert cutting.tip_force_N(penetration) == pytest.approx(cutting.exit_force_N)


@pytest.mark.parametrize("percent", [25, 50, 70])
def test_gel_peak_is_about_half_elastic(percent):
    """Fig. 8: about half of the peak is gone once the tip is through."""
    layer = gel(percent)
    friction = layer.friction.sliding_N_per_m(2.3e-3) * layer.thickness_m
    assert 0.4 < layer.exit_force_N / (layer.exit_force_N + friction) < 0.6


def test_the_70_per_cent_gel_peaks_where_figure_8_does():
    layer = gel(70)
    peak = layer.exit_force_N + layer.friction.sliding_N_per_m(2.3e-3) * layer.thickness_m
    assert 2.5 < peak < 3.0


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("thickness_m", 0.0),
        ("exit_force_N", -1.0),
        ("cutting_share", 1.1),
        ("stiffening", -0.1),
        ("release_m", 0.0),
        ("relaxed_share", float("nan")),
    ],
)
def test_layer_no_tissue_has_is_refused_by_name(field, value):
    with pytest.raises(TissueError, match=field):
        replace(gel(50), **{field: value})


def test_layer_thinner_than_its_own_ruptures_is_refused():
    with pytest.raises(TissueError, match="make it thicker"):
        replace(bovine_liver(), thickness_m=12e-3)


def test_unknown_gel_is_refused():
    with pytest.raises(TissueError, match="25, 50 and 70"):
        gel(60)


def test_layers_are_frozen():
    with pytest.raises(FrozenInstanceError):
        gel(25).thickness_m = 1.0


def test_release_starts_fast_and_is_complete_after_its_travel():
    boundary = interfaces((gel(50),))[1]
    share = [boundary.released(boundary.onset_m + x) for x in np.linspace(-1e-4, 4e-4, 101)]
    assert share[0] == 0.0
    assert share[-1] == 1.0
    assert (np.diff(share) >= 0.0).all()
    assert boundary.released(boundary.onset_m + boundary.release_m / 2) == pytest.approx(0.75)


def test_bare_surface_holds_nothing_and_every_boundary_is_listed():
    found = interfaces((gel(25), gel(50, membrane=GLOVE)))
    assert [b.drop_N for b in found] == pytest.approx([0.0, 0.30 + GLOVE.puncture_N, 0.75])
    assert found[1].onset_m == pytest.approx(gel(25).thickness_m + GLOVE.indentation_m)
    assert found[1].release_m == GLOVE.release_m
    assert interfaces(()) == ()
