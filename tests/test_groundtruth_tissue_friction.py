"""Presliding and relaxation: exact, bounded and independent of how a stretch is cut into steps."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth.errors import TissueError
from groundtruth.layers import Membrane, ShaftFriction
from groundtruth.tissue import RELAXATION_S, bristle_step, relaxation_step

bristles = st.floats(-1.0, 1.0)
travels = st.floats(-0.1, 0.1)
times = st.floats(1e-6, 10.0)
lengths = st.floats(1e-5, 1e-2)
shares = st.floats(0.0, 1.0)


@given(bristle=bristles, travel=travels, dt=times, length=lengths, share=shares)
def test_bristle_never_leaves_its_range(bristle, travel, dt, length, share):
    after = bristle_step(bristle, travel, dt, length, share)
    assert -1.0 - 1e-12 <= after <= 1.0 + 1e-12


@given(bristle=bristles, travel=travels, length=lengths)
def test_two_half_steps_of_travel_equal_one(bristle, travel, length):
    once = bristle_step(bristle, travel, 1e-3, length, 0.0)
    half = bristle_step(bristle, travel / 2, 5e-4, length, 0.0)
    twice = bristle_step(half, travel / 2, 5e-4, length, 0.0)
    assert twice == pytest.approx(once, abs=1e-9)


@given(bristle=bristles, travel=travels, length=lengths, share=shares)
def test_travel_pulls_the_bristle_towards_its_direction(bristle, travel, length, share):
    if abs(bristle) > 1.0 - share:
        return
    after = bristle_step(bristle, travel, 1e-3, length, share)
    assert (after - bristle) * travel >= 0.0


def test_a_long_rest_leaves_the_held_share_and_no_travel_no_relaxation_leaves_it_all():
    assert bristle_step(1.0, 0.0, 100.0 * RELAXATION_S, 1e-3, 0.4) == pytest.approx(0.6)
    assert bristle_step(-1.0, 0.0, 100.0 * RELAXATION_S, 1e-3, 0.4) == pytest.approx(-0.6)
    assert bristle_step(0.3, 0.0, 100.0, 1e-3, 0.4) == 0.3
    assert bristle_step(0.8, 0.0, 100.0, 1e-3, 0.0) == 0.8


def test_presliding_length_closes_63_per_cent_of_a_reversal():
    assert bristle_step(1.0, -2e-4, 1e-9, 2e-4, 0.0) == pytest.approx(1.0 - 2.0 * 0.6321, abs=1e-3)


@given(relaxed=st.floats(0.0, 1.0), speed=st.floats(-0.1, 0.1), dt=times)
def test_relaxation_stays_a_share_and_half_steps_agree(relaxed, speed, dt):
    once = relaxation_step(relaxed, speed, dt)
    twice = relaxation_step(relaxation_step(relaxed, speed, dt / 2), speed, dt / 2)
    assert 0.0 <= once <= 1.0
    assert twice == pytest.approx(once, abs=1e-9)


@given(force=st.floats(0.1, 100.0), speed=st.floats(1e-4, 0.1), share=shares)
def test_calibrated_friction_is_the_measured_one_at_its_speed(force, speed, share):
    friction = ShaftFriction.calibrated(
        force_N_per_m=force, reference_speed_m_s=speed, coulomb_share=share, presliding_m=1e-4
    )
    assert friction.sliding_N_per_m(speed) == pytest.approx(force)
    assert friction.sliding_N_per_m(-speed) == pytest.approx(-force)
    assert friction.textbook_Ns_per_m2 * speed == pytest.approx(force)


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("coulomb_N_per_m", -1.0),
        ("viscous_Ns_per_m2", float("nan")),
        ("presliding_m", 0.0),
        ("reference_speed_m_s", 0.0),
    ],
)
def test_friction_no_tissue_has_is_refused_by_name(field, value):
    good = {
        "coulomb_N_per_m": 1.0,
        "viscous_Ns_per_m2": 1.0,
        "presliding_m": 1e-4,
        "reference_speed_m_s": 1e-3,
    }
    with pytest.raises(TissueError, match=field):
        ShaftFriction(**{**good, field: value})


def test_calibration_outside_its_range_is_refused():
    good = {"force_N_per_m": 10.0, "presliding_m": 1e-4}
    with pytest.raises(TissueError, match="coulomb_share"):
        ShaftFriction.calibrated(**good, reference_speed_m_s=1e-3, coulomb_share=1.2)
    with pytest.raises(TissueError, match="reference_speed_m_s"):
        ShaftFriction.calibrated(**good, reference_speed_m_s=0.0, coulomb_share=0.5)


@given(hardening=shares, u=st.floats(0.0, 1.0))
def test_membrane_stiffens_up_to_its_puncture_force(hardening, u):
    membrane = Membrane(puncture_N=1.2, indentation_m=4e-3, hardening=hardening, release_m=5e-4)
    assert membrane.force_N(4e-3) == pytest.approx(1.2)
    assert membrane.force_N(-1e-3) == 0.0
    assert 0.0 <= membrane.force_N(u * 4e-3) <= 1.2 * u + 1e-12


@pytest.mark.parametrize(
    ("field", "value"),
    [("puncture_N", 0.0), ("indentation_m", -1e-3), ("hardening", 1.5), ("release_m", 0.0)],
)
def test_membrane_no_tissue_has_is_refused_by_name(field, value):
    good = {"puncture_N": 1.0, "indentation_m": 4e-3, "hardening": 0.5, "release_m": 5e-4}
    with pytest.raises(TissueError, match=field):
        Membrane(**{**good, field: value})
