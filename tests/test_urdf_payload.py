"""Payload and NeedleTool: the algebra of rigid bodies, and what no body can be."""

from dataclasses import FrozenInstanceError

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from urdf import InertiaError, InputError, NeedleTool, Payload
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
        (1e308, 0.01 * np.eye(3), r"parameters \[1e\+308, .*above 1e\+09 in SI units"),
        (1e300, np.full((3, 3), 1e300), "above 1e.09 in SI units"),
        (0.0, 0.01 * np.eye(3), "mass is 0 kg but"),
        (1.0, np.diag([0.01, 0.01, -0.01]), "not positive definite"),
        (1.0, np.diag([0.01, 0.01, 0.03]), "triangle inequality"),
    ],
)
def test_what_no_body_can_be(mass, inertia, message):
    with pytest.raises(InertiaError, match=message):
        Payload(mass_kg=mass, com_m=np.full(3, 0.2), inertia_kg_m2=inertia)


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


def test_default_tool_is_the_published_one():
    tool = NeedleTool()
    assert tool.sensor.mass_kg == 0.236
    assert tool.beyond_sensor.mass_kg == pytest.approx(0.068)
    assert tool.payload.mass_kg == pytest.approx(0.304)
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.040 + 0.153])


def test_whole_tool_is_sensor_plus_needle_moved_to_the_flange():
    tool = NeedleTool()
    first_moment = tool.payload.parameters[3]
    beyond = tool.beyond_sensor
    by_hand = 0.236 * 0.020 + 0.068 * (0.040 + beyond.com_m[2])
    assert first_moment == pytest.approx(by_hand)
    assert tool.payload.com_m[:2] == pytest.approx([0, 0])


def test_shaft_is_a_small_part_of_the_needle_mass():
    """A solid 18-gauge steel shaft of 118 mm weighs 7850 pi/4 d^2 L."""
    assert NeedleTool().shaft_mass_kg == pytest.approx(
        7850 * np.pi / 4 * 0.00127**2 * 0.118, rel=1e-12
    )


def test_inertia_of_a_bare_rod_is_the_textbook_s():
    rod = NeedleTool(
        needle_mass_kg=0.1,
        needle_length_m=0.2 + 1e-9,
        hub_length_m=1e-9,
        needle_diameter_m=0.002,
        shaft_density_kg_m3=0.1 / (np.pi / 4 * 0.002**2 * 0.2),
    ).beyond_sensor
    transverse = 0.1 * (3 * 0.001**2 + 0.2**2) / 12
    assert np.diag(rod.inertia_kg_m2) == pytest.approx(
        [transverse, transverse, 0.5 * 0.1 * 0.001**2], rel=1e-6
    )
    assert rod.com_m[2] == pytest.approx(0.1)


def test_no_sensor_leaves_the_needle_on_the_flange():
    assert NeedleTool(sensor_mass_kg=0.0).payload.mass_kg == pytest.approx(0.068)
    tool = NeedleTool(sensor_height_m=0)
    assert not tool.has_sensor
    assert tool.sensor_mass_kg == 0.0
    assert tool.payload.parameters == pytest.approx(NeedleTool().beyond_sensor.parameters)
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.153])
    plate = NeedleTool(sensor_height_m=0, sensor_mass_kg=0.1)
    assert plate.payload.mass_kg == pytest.approx(0.168)


def test_tool_is_frozen_and_its_arrays_read_only():
    tool = NeedleTool()
    with pytest.raises(FrozenInstanceError):
        tool.needle_length_m = 0.2
    with pytest.raises(ValueError, match="read-only"):
        tool.tip_in_flange_m[2] = 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"needle_length_m": 0.0}, "needle_length_m is 0, expected a positive"),
        ({"sensor_mass_kg": -0.1}, "sensor_mass_kg is -0.1"),
        ({"hub_diameter_m": np.nan}, "hub_diameter_m has NaN"),
        ({"needle_diameter_m": 1e200}, "needle_diameter_m is 1e.200"),
        ({"sensor_height_m": "tall"}, "sensor_height_m is not an array of numbers"),
        ({"needle_length_m": 0.03}, "hub_length_m 0.035 must be shorter"),
        ({"needle_diameter_m": 0.02}, "more than needle_mass_kg 0.068; give a thinner shaft"),
    ],
)
def test_tools_that_cannot_be_built(change, message):
    with pytest.raises(InputError, match=message):
        NeedleTool(**change)
