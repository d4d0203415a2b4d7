"""Payloads: the algebra of rigid bodies, needle tools, and what is identified from torques."""

import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from urdf import (
    InertiaError,
    InputError,
    NeedleTool,
    Payload,
    identify_payload,
    identify_payload_static,
    load_lwr,
)
from urdf.inertia import from_pseudo_inertia, nearest_body, pseudo_inertia

NOISE_NM = np.array([0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011])
OFFSETS_NM = np.array([0.5, -0.7, 0.3, 0.4, -0.2, 0.1, 0.05])
ROTOR = np.array([3.19, 3.05, 1.98, 2.05, 0.787, 0.391, 0.394])
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


@given(payloads(), payloads(), rotations, vectors)
def test_bodies_add_and_moving_is_linear_and_agrees_with_pinocchio(one, other, rotation, shift):
    moved = one.moved(rotation, shift)
    assert moved.com_m == pytest.approx(rotation @ one.com_m + shift, abs=1e-9)
    expected = pin.SE3(rotation, shift).act(one.spatial_inertia).toDynamicParameters()
    assert moved.parameters == pytest.approx(expected, abs=1e-9)
    assert (one + other).parameters == pytest.approx(one.parameters + other.parameters, abs=1e-12)
    assert (one + other).parameters == pytest.approx((other + one).parameters, abs=1e-12)
    both = (one + other).moved(rotation, shift).parameters
    assert both == pytest.approx((moved + other.moved(rotation, shift)).parameters, abs=1e-9)
    back = moved.moved(rotation.T, -rotation.T @ shift)
    assert back.parameters == pytest.approx(one.parameters, abs=1e-9)


def test_a_point_mass_a_thin_rod_and_nothing_are_bodies_and_no_motion_deforms_them():
    point = Payload(mass_kg=1.0, com_m=np.array([0.4, -0.3, 0.2]), inertia_kg_m2=np.zeros((3, 3)))
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
    payload, tool = Payload(mass_kg=1.0, com_m=com, inertia_kg_m2=0.01 * np.eye(3)), NeedleTool()
    com[2] = 9.0
    assert payload.com_m[2] == 0.1
    for array in (payload.com_m, payload.inertia_kg_m2, tool.tip_in_flange_m):
        assert not array.flags.writeable


@pytest.mark.parametrize(
    ("change", "error", "message"),
    [
        ({"mass_kg": -0.1}, InertiaError, "mass is -0.1 kg"),
        ({"mass_kg": 1e308}, InertiaError, r"parameters \[1e\+308, .*above 1e\+09 in SI units"),
        ({"inertia_kg_m2": np.diag([0.01, 0.01, -0.01])}, InertiaError, "not positive definite"),
        ({"inertia_kg_m2": np.diag([0.01, 0.01, 0.03])}, InertiaError, "triangle inequality"),
        ({"mass_kg": np.nan}, InputError, "mass_kg has NaN"),
        ({"mass_kg": "heavy"}, InputError, "mass_kg is not an array of numbers"),
        ({"com_m": np.zeros(2)}, InputError, r"com_m has shape \(2,\), expected \(3,\)"),
        ({"inertia_kg_m2": np.triu(np.full((3, 3), 0.01))}, InputError, "not symmetric"),
        ([0, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InertiaError, "mass is 0 kg but"),
        ([1e-320, 0.1, 0, 0, 0, 0, 0, 0, 0, 0], InputError, "NaN or infinite"),
        (np.zeros(9), InputError, r"expected \(10,\)"),
    ],
)
def test_what_no_body_can_be(change, error, message):
    good = {"mass_kg": 1.0, "com_m": np.full(3, 0.2), "inertia_kg_m2": 0.01 * np.eye(3)}
    with pytest.raises(error, match=message):
        Payload(**(good | change)) if isinstance(change, dict) else Payload.from_parameters(change)


def test_default_tool_is_the_published_one_and_a_bare_rod_the_textbook_s():
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
    assert tool.payload.parameters == pytest.approx(NeedleTool().beyond_sensor.parameters)
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.153])
    assert NeedleTool(sensor_height_m=0, sensor_mass_kg=0.1).payload.mass_kg == pytest.approx(0.168)


def test_tools_that_cannot_be_built():
    for name, value, message in (
        ("needle_length_m", 0.0, "needle_length_m is 0, expected a positive"),
        ("sensor_mass_kg", -0.1, "sensor_mass_kg is -0.1"),
        ("hub_diameter_m", np.nan, "hub_diameter_m has NaN"),
        ("needle_length_m", 0.03, "hub_length_m 0.035 must be shorter"),
        ("needle_diameter_m", 0.02, "more than needle_mass_kg 0.068; give a thinner shaft"),
    ):
        with pytest.raises(InputError, match=message):
            NeedleTool(**{name: value})


# Identification: what simulation knows, it finds; its uncertainty is true.


def torques(robot, *motion):
    data = robot.create_data()
    rows = zip(*motion, strict=True)
    return np.array([pin.rnea(robot.model, data, *row).copy() for row in rows])


@pytest.fixture(scope="module")
def moved(lwr):
    """A minute of three sines per joint: positions, velocities, accelerations, torques."""
    rng, t = np.random.default_rng(0), 0.02 * np.arange(3000)[:, None]
    q, dq, ddq = np.tile(HOME_RAD, (3000, 1)), np.zeros((3000, 7)), np.zeros((3000, 7))
    for k in (1, 2, 3):
        w, phase, size = 0.2 * np.pi * k, rng.uniform(0, 2 * np.pi, 7), rng.normal(0, 0.35, 7) / k
        q += size * np.sin(w * t + phase)
        dq += size * w * np.cos(w * t + phase)
        ddq -= size * w**2 * np.sin(w * t + phase)
    return q, dq, ddq, torques(lwr, q, dq, ddq)


@pytest.fixture(scope="module")
def posed(lwr):
    q = HOME_RAD + np.random.default_rng(4).uniform(-1, 1, (60, 7))
    return q, torques(lwr, q, np.zeros_like(q), np.zeros_like(q))


def noisy(tau, seed, offsets=0.0):
    return tau + np.random.default_rng(seed).normal(size=tau.shape) * NOISE_NM + offsets


def test_clean_motion_gives_ten_parameters_exactly(lwr, moved):
    """Whatever the robot carries already, and with the inertia of its rotors."""
    other = Payload(mass_kg=5.0, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    q, dq, ddq, tau = moved
    robots = [(robot, tau) for robot in (lwr, lwr.with_payload(None), lwr.with_payload(other))]
    for robot, torque in (*robots, (lwr.with_armature(ROTOR), tau + ROTOR * ddq)):
        estimate = identify_payload(robot, q, dq, ddq, torque)
        assert estimate.payload.parameters == pytest.approx(TRUE.parameters, abs=1e-9)
        assert (estimate.rank, estimate.parameter_count) == (10, 10)
        assert estimate.is_identified
        assert np.all(estimate.residual_rms_Nm < 1e-9)


@pytest.mark.parametrize("seed", range(2))
def test_mass_is_within_one_percent_at_realistic_noise_and_bias(lwr, moved, seed):
    *motion, tau = moved
    estimate = identify_payload(lwr, *motion, noisy(tau, seed))
    assert estimate.payload.mass_kg == pytest.approx(0.304, rel=0.01)
    assert estimate.payload.com_m == pytest.approx(TRUE.com_m, abs=0.004)
    biased, options = noisy(tau, seed, OFFSETS_NM), {"torque_noise_std_Nm": NOISE_NM}
    estimate = identify_payload(lwr, *motion, biased, fit_offsets=True, **options)
    assert estimate.payload.mass_kg == pytest.approx(0.304, rel=0.01)
    assert estimate.offsets_Nm == pytest.approx(OFFSETS_NM, abs=0.05)
    wrong = identify_payload(lwr, *motion, biased)
    assert abs(wrong.payload.mass_kg - 0.304) > 0.01


@pytest.mark.parametrize("case", ["white noise", "lasting noise", "poses"])
def test_standard_deviations_are_true(lwr, moved, posed, case):
    """Errors over stated standard deviations, over 40 seeds, also of noise that lasts 0.5 s."""
    *motion, tau = (x[:: 3 if case == "lasting noise" else 6] for x in moved)
    rows = []
    for seed in range(40):
        if case == "poses":
            estimate = identify_payload_static(lwr, posed[0], noisy(posed[1], seed))
        elif case == "lasting noise":
            white = np.random.default_rng(seed).normal(size=(len(tau) + 9, 7)) * NOISE_NM
            slow = np.array([white[k : k + 10].sum(axis=0) for k in range(len(tau))])
            estimate = identify_payload(lwr, *motion, tau + slow / np.sqrt(10))
        else:
            estimate = identify_payload(lwr, *motion, noisy(tau, seed), fit_offsets=True)
        count = estimate.parameter_count
        error = (estimate.unconstrained_parameters - TRUE.parameters)[:count]
        com = (estimate.payload.com_m - TRUE.com_m) / estimate.com_std_m
        rows.append(com if case == "poses" else error / estimate.standard_deviations[:count])
    assert 0.75 < np.sqrt(np.mean(np.square(rows))) < 1.3


def test_poses_at_rest_give_four_parameters_and_offsets(lwr, posed):
    q, tau = posed
    estimate = identify_payload_static(lwr, q, tau)
    assert (estimate.rank, estimate.parameter_count, estimate.is_identified) == (4, 4, True)
    assert estimate.payload.mass_kg == pytest.approx(0.304)
    assert estimate.payload.com_m == pytest.approx(TRUE.com_m, abs=1e-9)
    assert estimate.payload.inertia_kg_m2 == pytest.approx(np.zeros((3, 3)), abs=1e-15)
    assert np.all(np.isinf(estimate.standard_deviations[4:]))
    estimate = identify_payload_static(lwr, q, noisy(tau, 3, OFFSETS_NM), fit_offsets=True)
    assert abs(estimate.payload.mass_kg - 0.304) < 4.0 * estimate.mass_std_kg < 0.08
    assert np.all(np.abs(estimate.offsets_Nm - OFFSETS_NM) < 5.0 * estimate.offsets_std_Nm)


def test_what_the_data_do_not_determine_is_infinite(lwr, posed):
    """A single pose; poses alone in the full fit; poses without gravity."""
    q, tau = posed
    estimate = identify_payload_static(lwr, q[:1], tau[:1])
    assert estimate.rank < 4
    assert not estimate.is_identified
    assert np.all(np.isinf(estimate.com_std_m))
    estimate = identify_payload(lwr, q, np.zeros_like(q), np.zeros_like(q), tau)
    assert (estimate.rank, estimate.is_identified) == (4, False)
    assert np.isfinite(estimate.standard_deviations[:4]).all()
    assert np.isinf(estimate.standard_deviations[4:]).all()
    assert estimate.payload.mass_kg == pytest.approx(0.304, abs=1e-4)
    floating = load_lwr(gravity_m_s2=np.zeros(3))
    estimate = identify_payload_static(floating, q, np.zeros((60, 7)))
    assert estimate.rank == 0
    assert np.isinf(estimate.mass_std_kg)
    assert estimate.payload.mass_kg == 0.0


def test_an_answer_that_is_no_body_is_moved_to_the_nearest_and_flagged(lwr, moved, posed):
    """Noise makes the inertia of so small a tool come out as no body's."""
    *motion, tau = moved
    estimate = identify_payload(lwr, *motion, noisy(tau, 1))
    assert estimate.is_constrained
    with pytest.raises(ValueError, match=r"not positive definite|triangle"):
        Payload.from_parameters(estimate.unconstrained_parameters)
    lwr.with_payload(estimate.payload)
    # A negative payload does not exist: the nearest body weighs next to nothing.
    bare, (q, held) = lwr.with_payload(None), posed
    unloaded = torques(bare, *motion)
    estimate = identify_payload(lwr, *motion, noisy(unloaded, 2))
    assert estimate.payload.mass_kg < 4.0 * estimate.mass_std_kg < 0.01
    for estimate in (
        identify_payload(lwr, *motion, 2 * unloaded - tau),
        identify_payload_static(lwr, q, 2 * torques(bare, q, 0 * q, 0 * q) - held),
    ):
        assert estimate.is_constrained
        assert estimate.payload.mass_kg < 0.05
        assert estimate.unconstrained_parameters[0] == pytest.approx(-0.304)


@pytest.mark.parametrize(
    ("which", "bad", "message"),
    [
        (0, np.zeros((5, 6)), r"q_rad has shape \(5, 6\), expected \(n, 7\)"),
        (1, np.zeros((4, 7)), r"dq_rad_s has shape \(4, 7\), expected \(5, 7\)"),
        (2, np.full((5, 7), np.inf), "ddq_rad_s2 has NaN or infinite"),
        (3, np.full((5, 7), np.nan), "tau_Nm has NaN or infinite"),
        (4, -NOISE_NM, "torque_noise_std_Nm must be positive"),
        (4, NOISE_NM[:3], "torque_noise_std_Nm has shape"),
    ],
)
def test_malformed_recordings_are_refused(lwr, which, bad, message):
    arguments = [*(np.zeros((5, 7)) for _ in range(4)), NOISE_NM]
    arguments[which] = bad
    *motion, noise = arguments
    with pytest.raises(InputError, match=message):
        identify_payload(lwr, *motion, torque_noise_std_Nm=noise)
    if which not in (1, 2):
        with pytest.raises(InputError, match=message):
            identify_payload_static(lwr, motion[0], motion[3], torque_noise_std_Nm=noise)


# The nearest rigid body is a body, and no other body is nearer.


@given(st.integers(0, 10**6))
@settings(max_examples=50)
def test_no_body_is_nearer(seed):
    """Optimality on a cone: the gradient is orthogonal to the answer and dual to the cone."""
    rng = np.random.default_rng(seed)
    root = rng.normal(size=(10, 10)) * np.logspace(0, -rng.uniform(0, 3), 10)  # three decades
    solution = rng.normal(size=10)
    body = nearest_body(solution, root)
    assert np.linalg.eigvalsh(pseudo_inertia(body))[0] >= 0.0
    gradient = root.T @ root @ (body - solution)
    scale = np.linalg.norm(root @ solution) ** 2
    assert abs(gradient @ body) < 1e-5 * scale
    slopes = [
        gradient @ from_pseudo_inertia(np.outer(v, v)) / (v @ v) for v in rng.normal(size=(200, 4))
    ]
    assert min(slopes) * np.trace(pseudo_inertia(body)) > -1e-5 * scale


def test_a_body_stays_where_it_is_and_directions_without_data_get_an_answer():
    inside = from_pseudo_inertia(np.diag([0.2, 0.3, 0.4, 1.0]))
    assert nearest_body(inside, np.eye(10)) == pytest.approx(inside, abs=1e-6)
    answer = np.array([2.0, 0.3, -0.2, 0.5, 0, 0, 0, 0, 0, 0])
    body = nearest_body(answer, np.diag([1.0] * 4 + [0.0] * 6))
    assert np.linalg.eigvalsh(pseudo_inertia(body))[0] >= 0.0
    assert body[:4] == pytest.approx(answer[:4], abs=1e-4)
