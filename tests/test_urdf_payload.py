"""Payload: the algebra of rigid bodies, and what no body can be."""

from dataclasses import FrozenInstanceError

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from urdf import InertiaError, InputError, Payload
from urdf.inertia import from_pseudo_inertia, pseudo_inertia

number = st.floats(-1.0, 1.0)
vectors = st.tuples(number, number, number).map(np.array)
rotations = vectors.map(lambda w: pin.exp3(3.0 * w))


@st.composite
def payloads(draw):
    """A cloud of three point masses in a box: physical by construction."""
    masses = [draw(st.floats(0.05, 2.0)) for _ in range(3)]
    points = [0.3 * draw(vectors) for _ in range(3)]
    com = sum(m * p for m, p in zip(masses, points, strict=True)) / sum(masses)
    arms = [p - com for p in points]
    inertia = sum(
        m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in zip(masses, arms, strict=True)
    )
    return Payload(mass_kg=sum(masses), com_m=com, inertia_kg_m2=inertia)


@given(payloads())
def test_parameters_are_pinocchio_s(payload):
    expected = payload.spatial_inertia.toDynamicParameters()
    assert payload.parameters == pytest.approx(expected, abs=1e-12)


@given(payloads())
def test_parameters_describe_the_payload_fully(payload):
    again = Payload.from_parameters(payload.parameters)
    assert again.mass_kg == pytest.approx(payload.mass_kg)
    assert again.com_m == pytest.approx(payload.com_m, abs=1e-12)
    assert again.inertia_kg_m2 == pytest.approx(payload.inertia_kg_m2, abs=1e-12)


@given(payloads(), payloads())
def test_composition_adds_parameters_and_commutes(one, other):
    assert (one + other).parameters == pytest.approx(one.parameters + other.parameters, abs=1e-12)
    assert (one + other).parameters == pytest.approx((other + one).parameters, abs=1e-12)
    assert (one + other).mass_kg == pytest.approx(one.mass_kg + other.mass_kg)


@given(payloads(), payloads(), rotations, vectors)
def test_moving_is_linear_and_agrees_with_pinocchio(one, other, rotation, shift):
    moved = one.moved(rotation, shift)
    assert moved.com_m == pytest.approx(rotation @ one.com_m + shift, abs=1e-9)
    expected = pin.SE3(rotation, shift).act(one.spatial_inertia).toDynamicParameters()
    assert moved.parameters == pytest.approx(expected, abs=1e-9)
    both = (one + other).moved(rotation, shift).parameters
    assert both == pytest.approx((moved + other.moved(rotation, shift)).parameters, abs=1e-9)


@given(payloads(), rotations, vectors)
def test_moving_there_and_back_changes_nothing(payload, rotation, shift):
    back = payload.moved(rotation, shift).moved(rotation.T, -rotation.T @ shift)
    assert back.parameters == pytest.approx(payload.parameters, abs=1e-9)


@given(payloads())
def test_pseudo_inertia_of_a_body_is_positive_semidefinite(payload):
    matrix = pseudo_inertia(payload.parameters)
    assert np.linalg.eigvalsh(matrix)[0] >= -1e-12
    assert from_pseudo_inertia(matrix) == pytest.approx(payload.parameters, abs=1e-12)


def test_a_point_mass_a_thin_rod_and_nothing_are_bodies():
    point = Payload(mass_kg=1.0, com_m=np.array([0.4, -0.3, 0.2]), inertia_kg_m2=np.zeros((3, 3)))
    assert Payload.from_parameters(point.parameters).com_m == pytest.approx(point.com_m)
    Payload(mass_kg=1.0, com_m=np.zeros(3), inertia_kg_m2=np.diag([0.01, 0.01, 0.0]))
    nothing = Payload.from_parameters(np.zeros(10))
    assert (nothing + point).parameters == pytest.approx(point.parameters)


def test_arrays_are_read_only_copies_and_fields_frozen():
    com = np.array([0.0, 0.0, 0.1])
    payload = Payload(mass_kg=1.0, com_m=com, inertia_kg_m2=0.01 * np.eye(3))
    com[2] = 9.0
    assert payload.com_m[2] == 0.1
    for array in (payload.com_m, payload.inertia_kg_m2):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    with pytest.raises(FrozenInstanceError):
        payload.mass_kg = 2.0


@pytest.mark.parametrize(
    ("mass", "inertia", "message"),
    [
        (-0.1, 0.01 * np.eye(3), "mass is -0.1 kg"),
        (0.0, 0.01 * np.eye(3), "mass is 0 kg but"),
        (1.0, np.diag([0.01, 0.01, -0.01]), "not positive definite"),
        (1.0, np.diag([0.01, 0.01, 0.03]), "triangle inequality"),
    ],
)
def test_what_no_body_can_be(mass, inertia, message):
    with pytest.raises(InertiaError, match=message):
        Payload(mass_kg=mass, com_m=np.zeros(3), inertia_kg_m2=inertia)


def test_parameters_that_are_no_body():
    with pytest.raises(InertiaError, match="mass is 0 kg but"):
        Payload.from_parameters([0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0])
    with pytest.raises(InertiaError, match="not positive definite"):
        Payload.from_parameters([1, 0.1, 0, 0, 0, 0, 0, 0, 0, 0])


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"mass_kg": np.nan}, "mass_kg has NaN"),
        ({"mass_kg": "heavy"}, "mass_kg is not an array of numbers"),
        ({"com_m": np.zeros(2)}, r"com_m has shape \(2,\), expected \(3,\)"),
        ({"com_m": np.array([0, np.inf, 0])}, "com_m has NaN"),
        ({"inertia_kg_m2": np.zeros(6)}, r"inertia_kg_m2 has shape \(6,\), expected \(3, 3\)"),
        ({"inertia_kg_m2": np.triu(np.full((3, 3), 0.01))}, "not symmetric"),
    ],
)
def test_malformed_arguments_are_refused(change, message):
    good = {"mass_kg": 1.0, "com_m": np.zeros(3), "inertia_kg_m2": 0.01 * np.eye(3)}
    with pytest.raises(InputError, match=message):
        Payload(**(good | change))


def test_malformed_parameters_and_motions_are_refused():
    payload = Payload(mass_kg=1.0, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    with pytest.raises(InputError, match=r"expected \(10,\)"):
        Payload.from_parameters(np.zeros(9))
    with pytest.raises(InputError, match="not a rotation"):
        payload.moved(2.0 * np.eye(3), np.zeros(3))
    with pytest.raises(InputError, match="not a rotation"):
        payload.moved(-np.eye(3), np.zeros(3))
    with pytest.raises(InputError, match="translation_m"):
        payload.moved(np.eye(3), [0, 0])
    with pytest.raises(TypeError):
        payload + 1.0
