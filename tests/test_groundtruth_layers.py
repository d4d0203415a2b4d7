"""Layers, membranes, friction, and the boundaries between layers."""

from dataclasses import FrozenInstanceError, replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth.errors import TissueError
from groundtruth.layers import CUTTING_ONSET_M, Membrane, ShaftFriction, interfaces
from groundtruth.materials import GLOVE, bovine_liver, gel

MEMBRANE = Membrane(puncture_N=1.2, indentation_m=4e-3, hardening=0.5, release_m=5e-4)
FRICTION = ShaftFriction(
    coulomb_N_per_m=10.0, viscous_Ns_per_m2=1e3, presliding_m=1e-4, reference_speed_m_s=2.3e-3
)
fractions = st.floats(0.0, 1.0)


@pytest.mark.parametrize("layer", [gel(25), gel(70, membrane=GLOVE), bovine_liver()])
def test_tip_force_rises_to_the_exit_force(layer):
    penetration = np.linspace(0.0, layer.thickness_m - layer.entry_m, 500)
    force = [layer.tip_force_N(float(p)) for p in penetration]
    assert force[0] == 0.0
    assert force[-1] == pytest.approx(layer.exit_force_N)
    assert (np.diff(force) > 0.0).all()


def test_cutting_force_builds_up_within_a_needle_diameter_and_stays():
    cutting = replace(gel(50), cutting_fraction=1.0)
    assert cutting.tip_force_N(0.5 * CUTTING_ONSET_M) == pytest.approx(0.75 * cutting.exit_force_N)
    for penetration in (CUTTING_ONSET_M, 0.01, 0.03):
        assert cutting.tip_force_N(penetration) == pytest.approx(cutting.exit_force_N)


@pytest.mark.parametrize("percent", [25, 50, 70])
def test_gel_peak_is_about_half_elastic(percent):
    """Fig. 8: about half of the peak is gone once the tip is through."""
    layer = gel(percent)
    peak = layer.exit_force_N + layer.friction.sliding_N_per_m(2.3e-3) * layer.thickness_m
    assert 0.4 < layer.exit_force_N / peak < 0.6


@given(hardening=fractions, u=fractions)
def test_membrane_stiffens_up_to_its_puncture_force(hardening, u):
    membrane = replace(MEMBRANE, hardening=hardening)
    assert membrane.force_N(4e-3) == pytest.approx(1.2)
    assert membrane.force_N(-1e-3) == 0.0
    assert 0.0 <= membrane.force_N(u * 4e-3) <= 1.2 * u + 1e-12


@given(force=st.floats(0.1, 100.0), speed=st.floats(1e-4, 0.1), fraction=fractions)
def test_calibrated_friction_is_the_measured_one_at_its_speed_and_odd_in_speed(
    force, speed, fraction
):
    friction = ShaftFriction.calibrated(
        force_N_per_m=force,
        reference_speed_m_s=speed,
        coulomb_fraction=fraction,
        presliding_m=1e-4,
    )
    assert friction.sliding_N_per_m(speed) == pytest.approx(force)
    assert friction.sliding_N_per_m(-speed) == -friction.sliding_N_per_m(speed)
    assert friction.sliding_N_per_m(0.0) == 0.0
    assert friction.equivalent_viscous_Ns_per_m2 * speed == pytest.approx(force)


@pytest.mark.parametrize(
    ("good", "field", "value"),
    [
        (gel(50), "thickness_m", 0.0),
        (gel(50), "exit_force_N", -1.0),
        (gel(50), "cutting_fraction", 1.1),
        (gel(50), "stiffening", -0.1),
        (gel(50), "release_m", 0.0),
        (gel(50), "relaxed_fraction", float("nan")),
        (MEMBRANE, "puncture_N", 0.0),
        (MEMBRANE, "indentation_m", -1e-3),
        (MEMBRANE, "hardening", 1.5),
        (MEMBRANE, "release_m", 0.0),
        (FRICTION, "coulomb_N_per_m", -1.0),
        (FRICTION, "viscous_Ns_per_m2", float("nan")),
        (FRICTION, "presliding_m", 0.0),
        (FRICTION, "reference_speed_m_s", 0.0),
    ],
)
def test_what_no_tissue_has_is_refused_by_name(good, field, value):
    with pytest.raises(TissueError, match=field):
        replace(good, **{field: value})
    with pytest.raises(FrozenInstanceError):
        setattr(good, field, value)


def test_layers_that_cannot_be_made_are_refused():
    with pytest.raises(TissueError, match="make it thicker"):
        replace(bovine_liver(), thickness_m=12e-3)
    with pytest.raises(TissueError, match="25, 50 and 70"):
        gel(60)
    good = {"force_N_per_m": 10.0, "presliding_m": 1e-4}
    with pytest.raises(TissueError, match="coulomb_fraction"):
        ShaftFriction.calibrated(**good, reference_speed_m_s=1e-3, coulomb_fraction=1.2)
    with pytest.raises(TissueError, match="reference_speed_m_s"):
        ShaftFriction.calibrated(**good, reference_speed_m_s=0.0, coulomb_fraction=0.5)


def test_release_starts_fast_and_is_complete_after_its_travel():
    boundary = interfaces((gel(50),))[1]
    released = [boundary.released(boundary.onset_m + x) for x in np.linspace(-1e-4, 4e-4, 101)]
    assert (released[0], released[-1]) == (0.0, 1.0)
    assert (np.diff(released) >= 0.0).all()
    assert boundary.released(boundary.onset_m + boundary.release_m / 2) == pytest.approx(0.75)


def test_bare_surface_holds_nothing_and_every_boundary_is_listed():
    found = interfaces((gel(25), gel(50, membrane=GLOVE)))
    assert [b.drop_N for b in found] == pytest.approx([0.0, 0.30 + GLOVE.puncture_N, 0.75])
    assert found[1].onset_m == pytest.approx(gel(25).thickness_m + GLOVE.indentation_m)
    assert found[1].release_m == GLOVE.release_m
    assert interfaces(()) == ()
