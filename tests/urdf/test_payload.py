"""Payloads: the algebra of rigid bodies, needle tools, and what is identified from
torques."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.residual.residual_signals import gravity_of
from urdf import (
    InertiaError,
    InputError,
    NeedleTool,
    Payload,
    build_robot,
    identify_payload_static,
    load_lwr,
)

NOISE_NM = np.array([0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011])
HOME_RAD = np.array([0, 0.6, 0, -1.2, 0, 1.0, 0])
TRUE = NeedleTool().payload
number = st.floats(-1.0, 1.0)
vectors = st.tuples(number, number, number).map(np.array)
rotations = vectors.map(lambda w: pin.exp3(3.0 * w))


@st.composite
def payloads(draw):
    """A cloud of three point masses in a box: physical by construction."""
    masses = [draw(st.floats(0.05, 2.0)) for _ in range(3)]
    points = [0.3 * draw(vectors) for _ in range(3)]
    com = sum(m * p for m, p in zip(masses, points, strict=True)) / sum(masses)
    arms = zip(masses, (p - com for p in points), strict=True)
    inertia = sum(m * (r @ r * np.eye(3) - np.outer(r, r)) for m, r in arms)
    return Payload(mass_kg=sum(masses), com_m=com, inertia_kg_m2=inertia)


@pytest.mark.slow
@given(payloads(), payloads(), rotations, vectors)
def test_bodies_add_and_moving_is_linear(one, other, rotation, shift):
    place = pin.SE3(rotation, shift)
    moved = one.moved(place)
    both = (one + other).moved(place)
    back = moved.moved(place.inverse())
    moved_sum = moved.parameters + other.moved(place).parameters

    assert (one + other).parameters == pytest.approx(
        one.parameters + other.parameters, abs=1e-12
    )
    assert (moved.com_m, both.parameters, back.parameters) == (
        pytest.approx(rotation @ one.com_m + shift, abs=1e-9),
        pytest.approx(moved_sum, abs=1e-9),
        pytest.approx(one.parameters, abs=1e-9),
    )


def test_degenerate_bodies_are_accepted_and_movable():
    com_m = np.array([0.4, -0.3, 0.2])
    point = Payload(mass_kg=1.0, com_m=com_m, inertia_kg_m2=np.zeros((3, 3)))
    nothing = Payload.from_parameters(np.zeros(10))
    com_m[2] = 9.0

    Payload(mass_kg=1.0, com_m=np.zeros(3), inertia_kg_m2=np.diag([0.01, 0.01, 0.0]))
    assert point.com_m[2] == 0.2
    assert (nothing + point).parameters == pytest.approx(point.parameters)
    assert not any(
        array.flags.writeable
        for array in (point.com_m, point.inertia_kg_m2, NeedleTool().tip_in_flange_m)
    )
    for placement in (np.diag([1.0, 1, 2, 1]), np.diag([-1, -1, -1, 1]), [0]):
        with pytest.raises(InputError):
            point.moved(placement)
    with pytest.raises(TypeError):
        point + 1.0


@pytest.mark.parametrize(
    ("change", "error", "word"),
    [
        ({"mass_kg": -0.1}, InertiaError, "-0.1"),
        ({"mass_kg": 1e308}, InertiaError, "1e"),
        ({"inertia_kg_m2": np.diag([0.01, 0.01, -1e-3])}, InertiaError, "payload"),
        ({"inertia_kg_m2": np.diag([0.01, 0.01, 0.03])}, InertiaError, "payload"),
        ({"mass_kg": np.nan}, InputError, "mass_kg"),
        ({"mass_kg": "heavy"}, InputError, "mass_kg"),
        ({"mass_kg": 1j}, InputError, "mass_kg"),
        ({"com_m": np.zeros(2)}, InputError, "com_m"),
        ({"inertia_kg_m2": np.triu(np.full((3, 3), 0.01))}, InputError, "symmetric"),
        ([0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InertiaError, "0.1"),
        ([1e-320, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InertiaError, "0.1"),
        (np.zeros(9), InputError, "10"),
    ],
)
def test_what_no_body_can_be(change, error, word):
    good = {"mass_kg": 1.0, "com_m": np.full(3, 0.2), "inertia_kg_m2": 0.01 * np.eye(3)}
    is_named = isinstance(change, dict)
    with pytest.raises(error, match=word):
        Payload(**(good | change)) if is_named else Payload.from_parameters(change)


def test_default_tool_is_published_and_rod_is_textbook():
    tool = NeedleTool()
    beyond = tool.beyond_sensor
    by_hand = 0.236 * 0.020 + 0.068 * (0.040 + beyond.com_m[2])
    # A solid 18-gauge steel shaft of 118 mm weighs rho pi/4 d^2 L.
    shaft_kg = 7850 * np.pi / 4 * 0.00127**2 * 0.118

    assert tool.payload.parameters[:4] == pytest.approx([0.304, 0, 0, by_hand])
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.040 + 0.153])
    assert tool.shaft_mass_kg == pytest.approx(shaft_kg, rel=1e-12)

    rod = {"needle_mass_kg": 0.1, "needle_length_m": 0.2 + 1e-9, "hub_length_m": 1e-9}
    density = 0.1 / (np.pi / 4 * 0.002**2 * 0.2)
    rod |= {"needle_diameter_m": 0.002, "shaft_density_kg_m3": density}
    beyond = NeedleTool(**rod).beyond_sensor
    across = 0.1 * (3 * 0.001**2 + 0.2**2) / 12
    expected = [across, across, 0.5 * 0.1 * 0.001**2]

    assert (np.diag(beyond.inertia_kg_m2), beyond.com_m[2]) == (
        pytest.approx(expected, rel=1e-6),
        pytest.approx(0.1),
    )


@pytest.mark.parametrize(
    ("kinds", "mass_kg", "has_sensor", "tip_m"),
    [
        ({"sensor_mass_kg": 0.0}, 0.068, True, 0.193),
        ({"sensor_height_m": 0}, 0.068, False, 0.153),
        ({"sensor_height_m": 0, "sensor_mass_kg": 0.1}, 0.168, False, 0.153),
    ],
)
def test_a_tool_without_a_sensor(kinds, mass_kg, has_sensor, tip_m):
    tool = NeedleTool(**kinds)

    assert (tool.payload.mass_kg, tool.has_sensor, tool.tip_in_flange_m[2]) == (
        *(pytest.approx(mass_kg), has_sensor, pytest.approx(tip_m)),
    )


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("needle_length_m", 0.0),
        ("sensor_mass_kg", -0.1),
        ("hub_diameter_m", np.nan),
        ("hub_diameter_m", 1e7),
        ("needle_length_m", 0.03),  # shorter than the hub
        ("needle_diameter_m", 0.02),  # heavier than the needle
    ],
)
def test_tools_that_cannot_be_built(name, value):
    with pytest.raises(InputError):
        NeedleTool(**{name: value})


@pytest.fixture(scope="module")
def posed(lwr):
    q = HOME_RAD + np.random.default_rng(4).uniform(-1, 1, (60, 7))
    return q, gravity_of(lwr, q)


def test_poses_at_rest_give_mass_and_centre(lwr, posed):
    other = Payload(mass_kg=5.0, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    for robot in (lwr, lwr.with_payload(None), lwr.with_payload(other)):
        found = identify_payload_static(robot, *posed)
        assert (found.parameters, found.payload.com_m, found.residual_rms_Nm) == (
            pytest.approx(TRUE.parameters[:4], abs=1e-9),
            pytest.approx(TRUE.com_m, abs=1e-9),
            pytest.approx(np.zeros(7), abs=1e-9),
        )


@pytest.mark.parametrize("count", [30, 60])
@pytest.mark.parametrize("options", [{}, {"torque_noise_std_Nm": NOISE_NM}])
def test_standard_deviations_are_true(lwr, posed, count, options):
    q, tau = (x[:count] for x in posed)
    rows = []
    for seed in range(40):
        noise_Nm = np.random.default_rng(seed).normal(size=tau.shape) * NOISE_NM
        estimate = identify_payload_static(lwr, q, tau + noise_Nm, **options)
        error = estimate.parameters - TRUE.parameters[:4]
        com = (estimate.payload.com_m - TRUE.com_m) / estimate.com_std_m
        rows.append([*error / np.sqrt(np.diag(estimate.covariance)), *com])
    errors = np.array(rows)

    assert estimate.mass_std_kg == np.sqrt(estimate.covariance[0, 0])
    for errors_in_std in (errors[:, :4], errors[:, 4:]):
        assert 0.8 < np.sqrt(np.mean(np.square(errors_in_std))) < 1.25


def test_poses_that_do_not_turn_the_flange_are_refused(lwr, posed):
    q, tau = posed
    floating = load_lwr(gravity_m_s2=np.zeros(3))
    for robot, poses, torque in ((lwr, q[:1], tau[:1]), (floating, q, tau)):
        with pytest.raises(InputError, match="q_rad"):
            identify_payload_static(robot, poses, torque)


def test_a_negative_mass_gives_no_payload(lwr, posed):
    q, tau = posed
    lifted_Nm = 2 * gravity_of(lwr.with_payload(None), q) - tau
    found = identify_payload_static(lwr, q, lifted_Nm)

    assert (found.payload.mass_kg, found.parameters[0], *found.com_std_m) == (
        *(0.0, pytest.approx(-0.304), np.inf, np.inf, np.inf),
    )


def test_the_flange_may_be_off_its_joint():
    flange = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.4, 0.5), np.array([0.05, 0.1, -0.2]))
    inertia = np.diag([0.01, 0.02, 0.02])
    tool = Payload(mass_kg=0.8, com_m=np.array([0.1, 0, 0.2]), inertia_kg_m2=inertia)
    robot = build_robot(
        pin.buildSampleModelManipulator(),
        flange_frame="wrist2_joint",
        tool_placement=flange,
        payload=tool,
    )
    q = np.random.default_rng(0).uniform(-1, 1, (200, 6))
    estimate = identify_payload_static(robot, q, gravity_of(robot, q))

    assert estimate.parameters == pytest.approx(tool.parameters[:4], abs=1e-9)


@pytest.mark.parametrize(
    ("name", "value"),
    [
        ("q_rad", np.zeros((5, 6))),
        ("q_rad", np.zeros((0, 7))),
        ("tau_Nm", np.full((5, 7), np.nan)),
        ("tau_Nm", np.zeros((4, 7))),
        ("torque_noise_std_Nm", np.zeros(7)),
        ("torque_noise_std_Nm", -NOISE_NM),
        ("torque_noise_std_Nm", NOISE_NM[:3]),
    ],
)
def test_malformed_recordings_are_refused(lwr, name, value):
    good = {"q_rad": np.zeros((5, 7)), "tau_Nm": np.zeros((5, 7))}
    with pytest.raises(InputError, match=name):
        identify_payload_static(lwr, **(good | {name: value}))
