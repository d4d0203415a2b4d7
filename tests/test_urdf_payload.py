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
def test_parameters_are_pinocchio_s_and_describe_the_payload_fully(payload):
    expected = payload.spatial_inertia.toDynamicParameters()
    assert payload.parameters == pytest.approx(expected, abs=1e-12)
    matrix = pseudo_inertia(payload.parameters)
    assert np.linalg.eigvalsh(matrix)[0] >= -1e-12
    assert from_pseudo_inertia(matrix) == pytest.approx(payload.parameters, abs=1e-12)
    again = Payload.from_parameters(payload.parameters)
    assert again.mass_kg == pytest.approx(payload.mass_kg)
    assert again.com_m == pytest.approx(payload.com_m, abs=1e-12)
    assert again.inertia_kg_m2 == pytest.approx(payload.inertia_kg_m2, abs=1e-12)


@given(payloads(), payloads())
def test_composition_adds_parameters_and_commutes(one, other):
    assert (one + other).parameters == pytest.approx(one.parameters + other.parameters, abs=1e-12)
    assert (one + other).parameters == pytest.approx((other + one).parameters, abs=1e-12)


@given(payloads(), payloads(), rotations, vectors)
def test_moving_is_linear_and_agrees_with_pinocchio(one, other, rotation, shift):
    moved = one.moved(rotation, shift)
    assert moved.com_m == pytest.approx(rotation @ one.com_m + shift, abs=1e-9)
    expected = pin.SE3(rotation, shift).act(one.spatial_inertia).toDynamicParameters()
    assert moved.parameters == pytest.approx(expected, abs=1e-9)
    both = (one + other).moved(rotation, shift).parameters
    assert both == pytest.approx((moved + other.moved(rotation, shift)).parameters, abs=1e-9)
    back = moved.moved(rotation.T, -rotation.T @ shift)
    assert back.parameters == pytest.approx(one.parameters, abs=1e-9)


def test_a_point_mass_a_thin_rod_and_nothing_are_bodies():
    point = Payload(mass_kg=1.0, com_m=np.array([0.4, -0.3, 0.2]), inertia_kg_m2=np.zeros((3, 3)))
    assert Payload.from_parameters(point.parameters).com_m == pytest.approx(point.com_m)
    Payload(mass_kg=1.0, com_m=np.zeros(3), inertia_kg_m2=np.diag([0.01, 0.01, 0.0]))
    nothing = Payload.from_parameters(np.zeros(10))
    assert (nothing + point).parameters == pytest.approx(point.parameters)


def test_arrays_are_read_only_copies_and_fields_frozen():
    com = np.array([0.0, 0.0, 0.1])
    payload, tool = Payload(mass_kg=1.0, com_m=com, inertia_kg_m2=0.01 * np.eye(3)), NeedleTool()
    com[2] = 9.0
    assert payload.com_m[2] == 0.1
    for array in (payload.com_m, payload.inertia_kg_m2, tool.tip_in_flange_m):
        with pytest.raises(ValueError, match="read-only"):
            array[0] = 1.0
    for frozen, name in ((payload, "mass_kg"), (tool, "needle_length_m")):
        with pytest.raises(FrozenInstanceError):
            setattr(frozen, name, 2.0)


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"mass_kg": -0.1}, InertiaError, "mass is -0.1 kg"),
        ({"mass_kg": 0.0}, InertiaError, "mass is 0 kg but"),
        ({"mass_kg": 1e308}, InertiaError, r"parameters \[1e\+308, .*above 1e\+09 in SI units"),
        ({"inertia_kg_m2": np.full((3, 3), 1e300)}, InertiaError, "above 1e.09 in SI units"),
        ({"inertia_kg_m2": np.diag([0.01, 0.01, -0.01])}, InertiaError, "not positive definite"),
        ({"inertia_kg_m2": np.diag([0.01, 0.01, 0.03])}, InertiaError, "triangle inequality"),
        ({"mass_kg": np.nan}, InputError, "mass_kg has NaN"),
        ({"mass_kg": "heavy"}, InputError, "mass_kg is not an array of numbers"),
        ({"mass_kg": 10**400}, InputError, "mass_kg is not an array of numbers"),
        ({"com_m": np.zeros(2)}, InputError, r"com_m has shape \(2,\), expected \(3,\)"),
        ({"com_m": np.array([0, np.inf, 0])}, InputError, "com_m has NaN"),
        ({"inertia_kg_m2": np.zeros(6)}, InputError, r"has shape \(6,\), expected \(3, 3\)"),
        ({"inertia_kg_m2": np.triu(np.full((3, 3), 0.01))}, InputError, "not symmetric"),
        ([0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InertiaError, "mass is 0 kg but"),
        ([1, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InertiaError, "not positive definite"),
        ([1e-320, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InputError, "NaN or infinite"),
        (np.zeros(9), InputError, r"expected \(10,\)"),
    ],
)
def test_what_no_body_can_be(change, error, message):
    good = {"mass_kg": 1.0, "com_m": np.full(3, 0.2), "inertia_kg_m2": 0.01 * np.eye(3)}
    with pytest.raises(error, match=message):
        Payload(**(good | change)) if isinstance(change, dict) else Payload.from_parameters(change)


def test_malformed_motions_are_refused():
    payload = Payload(mass_kg=1.0, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    for rotation in (2.0 * np.eye(3), -np.eye(3)):
        with pytest.raises(InputError, match="not a rotation"):
            payload.moved(rotation, np.zeros(3))
    with pytest.raises(InputError, match="translation_m"):
        payload.moved(np.eye(3), [0, 0])
    with pytest.raises(TypeError):
        payload + 1.0


def test_default_tool_is_the_published_one():
    tool = NeedleTool()
    beyond = tool.beyond_sensor
    assert tool.sensor.mass_kg == 0.236
    assert beyond.mass_kg == pytest.approx(0.068)
    assert tool.payload.mass_kg == pytest.approx(0.304)
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.040 + 0.153])
    by_hand = 0.236 * 0.020 + 0.068 * (0.040 + beyond.com_m[2])
    assert tool.payload.parameters[3] == pytest.approx(by_hand)
    assert tool.payload.com_m[:2] == pytest.approx([0, 0])
    # A solid 18-gauge steel shaft of 118 mm weighs rho pi/4 d^2 L.
    assert tool.shaft_mass_kg == pytest.approx(7850 * np.pi / 4 * 0.00127**2 * 0.118, rel=1e-12)


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
    assert (tool.has_sensor, tool.sensor_mass_kg) == (False, 0.0)
    assert tool.payload.parameters == pytest.approx(NeedleTool().beyond_sensor.parameters)
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.153])
    plate = NeedleTool(sensor_height_m=0, sensor_mass_kg=0.1)
    assert plate.payload.mass_kg == pytest.approx(0.168)


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
