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
    SerialJoint,
    build_serial_robot,
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


@given(payloads())
def test_parameters_are_pinocchios_and_complete(payload):
    expected = payload.spatial_inertia.toDynamicParameters()

    assert payload.parameters == pytest.approx(expected, abs=1e-12)

    again = Payload.from_parameters(payload.parameters)

    assert again.mass_kg == pytest.approx(payload.mass_kg)
    assert again.com_m == pytest.approx(payload.com_m, abs=1e-12)
    assert again.inertia_kg_m2 == pytest.approx(payload.inertia_kg_m2, abs=1e-12)


@pytest.mark.slow
@given(payloads(), payloads(), rotations, vectors)
def test_bodies_add_and_moving_is_linear(one, other, rotation, shift):
    moved = one.moved(rotation, shift)

    assert moved.com_m == pytest.approx(rotation @ one.com_m + shift, abs=1e-9)
    assert (one + other).parameters == pytest.approx(
        one.parameters + other.parameters, abs=1e-12
    )
    assert (one + other).parameters == pytest.approx(
        (other + one).parameters, abs=1e-12
    )

    moved_sum = (one + other).moved(rotation, shift).parameters

    assert moved_sum == pytest.approx(
        (moved + other.moved(rotation, shift)).parameters, abs=1e-9
    )

    back = moved.moved(rotation.T, -rotation.T @ shift)

    assert back.parameters == pytest.approx(one.parameters, abs=1e-9)


def test_degenerate_bodies_are_accepted_and_movable():
    point = Payload(
        mass_kg=1.0, com_m=np.array([0.4, -0.3, 0.2]), inertia_kg_m2=np.zeros((3, 3))
    )

    assert Payload.from_parameters(point.parameters).com_m == pytest.approx(point.com_m)

    Payload(mass_kg=1.0, com_m=np.zeros(3), inertia_kg_m2=np.diag([0.01, 0.01, 0.0]))
    nothing = Payload.from_parameters(np.zeros(10))

    assert (nothing + point).parameters == pytest.approx(point.parameters)

    for rotation in (2.0 * np.eye(3), -np.eye(3)):
        with pytest.raises(InputError, match="not a rotation"):
            point.moved(rotation, np.zeros(3))

    with pytest.raises(InputError, match="translation_m"):
        point.moved(np.eye(3), [0, 0])
    with pytest.raises(TypeError):
        point + 1.0


def test_arrays_are_read_only_copies():
    com = np.array([0.0, 0.0, 0.1])
    payload = Payload(mass_kg=1.0, com_m=com, inertia_kg_m2=0.01 * np.eye(3))
    tool = NeedleTool()
    com[2] = 9.0

    assert payload.com_m[2] == 0.1

    for array in (payload.com_m, payload.inertia_kg_m2, tool.tip_in_flange_m):
        assert not array.flags.writeable


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"mass_kg": -0.1}, InertiaError, "mass is -0.1 kg"),
        (
            {"mass_kg": 1e308},
            InertiaError,
            r"parameters \[1e\+308, .*above 1e\+09 in SI units",
        ),
        (
            {"inertia_kg_m2": np.diag([0.01, 0.01, -0.01])},
            InertiaError,
            "not positive definite",
        ),
        (
            {"inertia_kg_m2": np.diag([0.01, 0.01, 0.03])},
            InertiaError,
            "triangle inequality",
        ),
        ({"mass_kg": np.nan}, InputError, "mass_kg has NaN"),
        ({"mass_kg": "heavy"}, InputError, "mass_kg is not an array of numbers"),
        (
            {"com_m": np.zeros(2)},
            InputError,
            r"com_m has shape \(2,\), expected \(3,\)",
        ),
        (
            {"inertia_kg_m2": np.triu(np.full((3, 3), 0.01))},
            InputError,
            "not symmetric",
        ),
        ([0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InertiaError, "mass is 0 kg but"),
        ([1e-320, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InputError, "NaN or infinite"),
        (np.zeros(9), InputError, r"expected \(10,\)"),
    ],
)
def test_what_no_body_can_be(change, error, message):
    good = {"mass_kg": 1.0, "com_m": np.full(3, 0.2), "inertia_kg_m2": 0.01 * np.eye(3)}
    with pytest.raises(error, match=message):
        Payload(**(good | change)) if isinstance(
            change, dict
        ) else Payload.from_parameters(change)


def test_default_tool_is_published_and_rod_is_textbook():
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
    assert tool.shaft_mass_kg == pytest.approx(
        7850 * np.pi / 4 * 0.00127**2 * 0.118, rel=1e-12
    )

    rod = {"needle_mass_kg": 0.1, "needle_length_m": 0.2 + 1e-9, "hub_length_m": 1e-9}
    density = 0.1 / (np.pi / 4 * 0.002**2 * 0.2)
    tool = NeedleTool(**rod, needle_diameter_m=0.002, shaft_density_kg_m3=density)
    across = 0.1 * (3 * 0.001**2 + 0.2**2) / 12
    moments = np.diag(tool.beyond_sensor.inertia_kg_m2)

    assert moments == pytest.approx([across, across, 0.5 * 0.1 * 0.001**2], rel=1e-6)
    assert tool.beyond_sensor.com_m[2] == pytest.approx(0.1)


def test_no_sensor_leaves_the_needle_on_the_flange():
    assert NeedleTool(sensor_mass_kg=0.0).payload.mass_kg == pytest.approx(0.068)

    tool = NeedleTool(sensor_height_m=0)

    assert (tool.has_sensor, tool.sensor_mass_kg) == (False, 0.0)
    assert tool.payload.parameters == pytest.approx(
        NeedleTool().beyond_sensor.parameters
    )
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.153])
    assert NeedleTool(
        sensor_height_m=0, sensor_mass_kg=0.1
    ).payload.mass_kg == pytest.approx(0.168)


def test_tools_that_cannot_be_built():
    for name, value, message in (
        ("needle_length_m", 0.0, "needle_length_m is 0, expected a positive"),
        ("sensor_mass_kg", -0.1, "sensor_mass_kg is -0.1"),
        ("hub_diameter_m", np.nan, "hub_diameter_m has NaN"),
        ("needle_length_m", 0.03, "hub_length_m 0.035 must be shorter"),
        (
            "needle_diameter_m",
            0.02,
            "more than needle_mass_kg 0.068; give a thinner shaft",
        ),
    ):
        with pytest.raises(InputError, match=message):
            NeedleTool(**{name: value})


@pytest.fixture(scope="module")
def posed(lwr):
    q = HOME_RAD + np.random.default_rng(4).uniform(-1, 1, (60, 7))
    return q, gravity_of(lwr, q)


def test_poses_at_rest_give_mass_and_centre(lwr, posed):
    q, tau = posed
    other = Payload(mass_kg=5.0, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    for robot in (lwr, lwr.with_payload(None), lwr.with_payload(other)):
        estimate = identify_payload_static(robot, q, tau)
        assert (estimate.rank, estimate.is_identified) == (4, True)
        assert estimate.parameters == pytest.approx(TRUE.parameters[:4], abs=1e-9)
        assert estimate.payload.mass_kg == pytest.approx(0.304)
        assert estimate.payload.com_m == pytest.approx(TRUE.com_m, abs=1e-9)
        assert estimate.payload.inertia_kg_m2 == pytest.approx(
            np.zeros((3, 3)), abs=1e-15
        )
        assert np.all(estimate.residual_rms_Nm < 1e-9)


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

    assert estimate.mass_std_kg == np.sqrt(estimate.covariance[0, 0])

    for errors_in_std in (np.array(rows)[:, :4], np.array(rows)[:, 4:]):
        assert 0.8 < np.sqrt(np.mean(np.square(errors_in_std))) < 1.25


def test_what_the_data_do_not_determine_is_infinite(lwr, posed):
    q, tau = posed
    estimate = identify_payload_static(lwr, q[:1], tau[:1])

    assert estimate.rank < 4
    assert not estimate.is_identified
    assert np.all(np.isinf(estimate.com_std_m))

    floating = load_lwr(gravity_m_s2=np.zeros(3))
    estimate = identify_payload_static(floating, q, np.zeros((60, 7)))

    assert estimate.rank == 0
    assert np.isinf(estimate.mass_std_kg)
    assert estimate.payload.mass_kg == 0.0


def test_a_negative_mass_gives_no_payload(lwr, posed):
    q, tau = posed
    estimate = identify_payload_static(
        lwr, q, 2 * gravity_of(lwr.with_payload(None), q) - tau
    )

    assert estimate.payload.mass_kg == 0.0
    assert np.isinf(estimate.com_std_m).all()
    assert estimate.parameters[0] == pytest.approx(-0.304)


def test_the_flange_may_be_off_its_joint():
    link = np.array([1, 0, 0, 0, 0.1, 0, 0.1, 0, 0, 0.1])
    place = pin.SE3(np.eye(3), np.array([0.1, 0.2, 0.3]))
    joints = [
        SerialJoint(name=f"j{k}", placement=place, axis=axis, inertia=link)
        for k, axis in enumerate([(0, 1, 0), (1, 0, 0), (0, 1, 0)])
    ]
    flange = pin.SE3(pin.rpy.rpyToMatrix(0.3, 0.4, 0.5), np.array([0.05, 0.1, -0.2]))
    tool = Payload(
        mass_kg=0.8, com_m=[0.1, 0, 0.2], inertia_kg_m2=np.diag([0.01, 0.02, 0.02])
    )
    robot = build_serial_robot(joints, tool_placement=flange, payload=tool)
    q = np.random.default_rng(0).uniform(-1, 1, (200, 3))
    estimate = identify_payload_static(robot, q, gravity_of(robot, q))

    assert estimate.parameters == pytest.approx(tool.parameters[:4], abs=1e-9)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"q_rad": np.zeros((5, 6))}, r"q_rad has shape \(5, 6\), expected \(n, 7\)"),
        ({"q_rad": np.zeros((0, 7))}, r"q_rad has shape \(0, 7\)"),
        ({"tau_Nm": np.full((5, 7), np.nan)}, "tau_Nm has NaN or infinite"),
        ({"tau_Nm": np.zeros((4, 7))}, "tau_Nm has shape"),
        ({"torque_noise_std_Nm": np.zeros(7)}, "torque_noise_std_Nm must be positive"),
        ({"torque_noise_std_Nm": -NOISE_NM}, "torque_noise_std_Nm must be positive"),
        ({"torque_noise_std_Nm": NOISE_NM[:3]}, "torque_noise_std_Nm has shape"),
    ],
)
def test_malformed_recordings_are_refused(lwr, change, message):
    good = {"q_rad": np.zeros((5, 7)), "tau_Nm": np.zeros((5, 7))}
    with pytest.raises(InputError, match=message):
        identify_payload_static(lwr, **(good | change))
