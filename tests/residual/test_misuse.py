"""What an odd robot, an odd caller or a wrong convention does: it works, or is
reported by name."""

import copy
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from residual import (
    DEFAULT,
    PUBLISHED,
    ConfigurationError,
    MomentumObserver,
    SampleError,
    SensorConfig,
    Status,
    TareError,
    VelocityEstimator,
    VirtualForceSensor,
    WrenchEstimator,
)
from tests.insertion_run import same
from tests.residual.guarded_sensor import feed, rows_of, signals, tared
from tests.residual.residual_signals import (
    MIDDLE,
    external_torque_of,
    gravity_of,
    swing,
)
from urdf import Robot, UnsupportedJointError


@pytest.mark.parametrize(
    ("copied", "with_velocity"), [(copy.copy, True), (copy.deepcopy, False)]
)
def test_a_copy_goes_on_bit_for_bit(lwr, copied, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    feed(sensor, rows[:700])
    twin = copied(sensor)
    for row in rows[700:]:
        assert same(sensor.update(*row, 1e-3), twin.update(*row, 1e-3))


def robot_of(joint, count):
    """An arm built straight in Pinocchio, whose unset limits are the largest float."""
    model = pin.Model()
    link = pin.Inertia(2.0, np.array([0.1, 0.0, 0.2]), np.eye(3))
    for i in range(count):
        place = pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.1]))
        index = model.addJoint(i, joint, place, f"joint_{i}")
        model.addJointFrame(index, -1)
        model.appendBodyToJoint(index, link, place)
    tip = pin.SE3(np.eye(3), np.array([0.2, 0.2, 0.1]))
    model.addFrame(
        pin.Frame("tool", count, model.nframes - 1, tip, pin.FrameType.OP_FRAME)
    )
    return Robot(bare_model=model, tool_frame="tool", flange_frame="tool")


@pytest.mark.filterwarnings("error")
@pytest.mark.parametrize("mode", ["axial", "point"])
@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize(
    ("joint", "count"),
    [(pin.JointModelPZ(), 1), (pin.JointModelRX(), 1), (pin.JointModelRY(), 3)],
)
def test_robots_without_limits_or_with_one_joint_work(
    joint, count, with_velocity, mode
):
    robot = robot_of(joint, count)
    sensor = VirtualForceSensor(robot, replace(DEFAULT, mode=mode))
    _, q, dq, tau = swing(
        robot, seconds=2.0, amplitude=0.03, middle=np.full(count, 0.4)
    )
    rng = np.random.default_rng(0)
    tau = tau - 0.2 + 0.01 * rng.normal(size=tau.shape)
    rows = rows_of(q, dq if with_velocity else None, tau)
    feed(sensor, rows[:1500])
    sensor.tare()
    force = np.array([0.0, 0.0, 3.0])
    pushed = [
        (q, dq, tau - external_torque_of(robot, q, force)) for q, dq, tau in rows[1500:]
    ]
    last = feed(sensor, pushed)[-1]

    assert last.status is Status.OK
    assert all(np.isfinite(value).all() for value in last[:8])

    if count == 1 and mode == "axial":
        torque = external_torque_of(robot, q[-1], force)
        lever_m = sensor.kinematics.axial_jacobian
        assert last.axial == pytest.approx(-torque[0] / lever_m[0], abs=0.3)


def with_limits(effort):
    model = pin.Model(robot_of(pin.JointModelRX(), 2).bare_model)
    model.upperEffortLimit = np.full(2, effort)
    return Robot(bare_model=model, tool_frame="tool", flange_frame="tool")


@pytest.mark.parametrize("effort", [-1.0, np.nan, np.inf])
def test_an_impossible_effort_limit_counts_as_unknown(effort):
    sensor, expected = (VirtualForceSensor(with_limits(one)) for one in (effort, 0.0))
    _, q, dq, tau = swing(with_limits(effort), seconds=1.0, amplitude=0.03)
    rows = list(zip(q, dq, tau, strict=True))
    ours = feed(sensor, rows)[-1]
    theirs = feed(expected, rows)[-1]

    assert ours.axial_std == theirs.axial_std < 100.0


@pytest.mark.parametrize("joint", [pin.JointModelRUBZ(), pin.JointModelSpherical()])
def test_an_unusable_robot_is_refused_at_construction(joint):
    with pytest.raises(UnsupportedJointError, match="joint 'joint_0' has"):
        robot_of(joint, 1)
    with pytest.raises(ConfigurationError, match=r"effort limits at joints 1, 2"):
        VirtualForceSensor(with_limits(1e-300))


class Raises:
    """An object of somebody else's whose conversions fail in their own way."""

    def __array__(self, *_, **__):
        raise RuntimeError("no array")

    def __float__(self):
        raise RuntimeError("no float")

    def __repr__(self):
        raise RuntimeError("no text")


STEPS = {
    "far beyond": 10**5000,
    "next to nothing": 5e-324,
    "a stranger": Raises(),
    "NaN": np.float64("nan"),
    "true": True,
    "text": "x",
    "none": None,
}


@pytest.mark.parametrize("dt_s", STEPS.values(), ids=STEPS)
def test_no_time_step_makes_an_update_raise(lwr, dt_s):
    sensor, rows = tared(lwr)
    twin, _ = tared(lwr)
    reported = sensor.update(*rows[0], dt_s)

    assert reported.status is Status.REJECTED
    assert "dt_s" in reported.message

    next_one = sensor.update(*rows[1], 1e-3)

    assert next_one.axial == twin.update(*rows[1], 1e-3).axial

    velocity = VelocityEstimator(7)
    velocity.update(rows[0][0], rows[0][2], 1e-3)

    with pytest.raises(SampleError, match="dt_s"):
        velocity.update(rows[0][0], rows[0][2], dt_s)


@pytest.mark.parametrize("which", [0, 1, 2])
def test_no_signal_makes_an_update_raise(lwr, which):
    sensor, rows = tared(lwr)
    bad = list(rows[0])
    bad[which] = Raises()

    assert sensor.update(*bad, 1e-3).status is Status.REJECTED
    assert sensor.update(*rows[1], 1e-3).status is Status.OK


REFUSED_SETTINGS = {
    "gain_per_s": [0.0, np.inf, "5", (), True, 10**400],
    "tare_window_s": [-1.0],
    "expected_force_N": [0.0, -1.0, 1e-160, 1e200],
    "max_gap_s": [np.nan],
    "velocity_bandwidth_per_s": [1e150, 1e-200],
    "mode": ["x"],
    "axes": ["x"],
    "alignment": ["x"],
    "weighting": ["x"],
    "tare": ["x"],
    "insertion_axis": [(0, 0, 0), (0, 0, np.nan), (0, 1), "z", (0, True, Raises())],
    "tool_offset_m": [(0.0, 0.0), (0.0, 0.0, 150.0), (0.0, -150.0, 0.0)],
    "guard": ["no", 1],
    "smooth_momentum": [3, None],
    "torque_is_gravity_compensated": [1],
    "prior": [None],
    "friction": [3],
}


@pytest.mark.parametrize("name", REFUSED_SETTINGS)
def test_settings_that_cannot_work_are_refused(name):
    for value in REFUSED_SETTINGS[name]:
        with pytest.raises(ConfigurationError, match=name):
            SensorConfig(**{name: value})


@pytest.mark.parametrize(
    ("make", "settings"),
    [
        (MomentumObserver, {"gain_per_s": [1.0, 2.0]}),
        (MomentumObserver, {"alignment": "euler"}),
        (MomentumObserver, {"max_gap_s": 0.0}),
        (
            lambda _, **settings: VelocityEstimator(7, **settings),
            {"bandwidth_per_s": np.inf},
        ),
        (lambda _, **settings: VelocityEstimator(**settings), {"joints": -1}),
    ],
)
def test_each_part_refuses_impossible_settings_by_name(lwr, make, settings):
    with pytest.raises(ConfigurationError, match=next(iter(settings))):
        make(lwr, **settings)


WRONG = {
    "missing gravity": (lambda g, tau: tau - g, {}),
    "gravity twice": (lambda g, tau: tau, {"torque_is_gravity_compensated": True}),
    "wrong sign": (lambda g, tau: -tau, {}),
    "two joints": (lambda g, tau: tau[:, [0, 3, 2, 1, 4, 5, 6]], {}),
}


@pytest.mark.slow
@pytest.mark.parametrize("preset", [DEFAULT, PUBLISHED])
@pytest.mark.parametrize("kind", WRONG)
def test_a_tare_of_wrong_torques_is_refused(lwr, kind, preset):
    bend, settings = WRONG[kind]
    q, dq, tau = signals(lwr, 3.0)
    sensor = VirtualForceSensor(lwr, replace(preset, **settings))
    feed(sensor, zip(q, dq, bend(gravity_of(lwr, q), tau), strict=True))

    with pytest.raises(TareError, match="units, signs, order, payload"):
        sensor.tare()

    sensor.tare(ignore_contact=True)


@pytest.mark.parametrize("preset", [DEFAULT, PUBLISHED])
def test_a_tare_of_right_torques_without_gravity_is_accepted(lwr, preset):
    q, dq, tau = signals(lwr, 3.0)
    sensor = VirtualForceSensor(
        lwr, replace(preset, torque_is_gravity_compensated=True)
    )
    feed(sensor, zip(q, dq, tau - gravity_of(lwr, q), strict=True))
    sensor.tare()

    assert sensor.diagnosis.wrong_joints == []


OTHERS = np.arange(7) != 3


@pytest.mark.slow
@pytest.mark.parametrize(
    ("bend", "words"),
    [
        (
            lambda q, tau: (np.degrees(q), tau),
            "limit: .* is q in degrees. If not, the sensor",
        ),
        (
            lambda q, tau: (q, tau * OTHERS),
            "tau at joint 4 has not .* If not, the sensor reads",
        ),
    ],
)
def test_a_refused_tare_asks_for_units_and_signals(lwr, bend, words):
    q, _, tau = signals(lwr, 3.0)
    sensor = VirtualForceSensor(lwr)
    q, tau = bend(q, tau)
    feed(sensor, [(q_k, None, tau_k) for q_k, tau_k in zip(q, tau, strict=True)])

    with pytest.raises(TareError, match=words):
        sensor.tare()


@pytest.mark.slow
def test_a_tare_without_data_says_what_was_rejected(lwr):
    sensor = VirtualForceSensor(lwr)
    q, dq, tau = signals(lwr, 1.0)
    feed(sensor, zip(q, dq, tau * np.nan, strict=True))
    words = "1000 samples were rejected, the last one: tau is not finite at joints 1, 2"

    with pytest.raises(TareError, match=words):
        sensor.tare()


def test_measured_torque_given_as_external_torque_is_refused(lwr):
    q, _, tau = signals(lwr, 2.0)
    sensor = VirtualForceSensor(lwr)
    for one in zip(q, tau, strict=True):
        sensor.update_external_torque(one[0], None, one[1], 1e-3)

    with pytest.raises(TareError, match="not the external torques"):
        sensor.tare()


@pytest.mark.slow
@pytest.mark.parametrize("with_velocity", [True, False])
def test_torque_without_gravity_gives_the_same_force(lwr, with_velocity):
    config = replace(DEFAULT, torque_is_gravity_compensated=True)
    q, dq, tau = signals(lwr, 3.0)
    free = gravity_of(lwr, q)
    sensor = VirtualForceSensor(lwr, config)
    twin = VirtualForceSensor(lwr)
    for k in range(len(q)):
        if k == 2000:
            sensor.tare()
            twin.tare()
        velocity = dq[k] if with_velocity else None
        ours = sensor.update(q[k], velocity, tau[k] - free[k], 1e-3)
        theirs = twin.update(q[k], velocity, tau[k], 1e-3)
        assert ours.status is theirs.status

    assert ours.axial == pytest.approx(theirs.axial, abs=1e-9)


@pytest.mark.parametrize("dt_s", [1.0, 5.0])
def test_a_time_step_in_milliseconds_is_reported(lwr, dt_s):
    sensor = VirtualForceSensor(lwr)
    last = feed(sensor, zip(*signals(lwr, 0.1), strict=True), dt_s)[-1]

    assert last.status is Status.INITIALIZING
    assert f"dt_s = {dt_s:g} s" in last.message
    assert "in milliseconds?" in last.message
    with pytest.raises(TareError, match=r"in milliseconds\?"):
        sensor.tare()


@pytest.mark.parametrize("mode", ["axial", "point"])
def test_a_tip_offset_equals_a_displaced_frame(lwr, mode):
    offset = np.array([0.02, -0.03, 0.1])
    model = pin.Model(lwr.bare_model)
    at = model.frames[lwr.tool_frame_id]
    place = at.placement * pin.SE3(np.eye(3), offset)
    model.addFrame(pin.Frame("tip", at.parentJoint, lwr.tool_frame_id, place, at.type))
    longer = replace(lwr, bare_model=model, tool_frame="tip")
    torque = np.linspace(-1.0, 1.0, 7)
    ours = WrenchEstimator(lwr, SensorConfig(mode=mode, tool_offset_m=tuple(offset)))
    theirs = WrenchEstimator(longer, SensorConfig(mode=mode))
    forces = [one.estimate(MIDDLE, torque).force for one in (ours, theirs)]

    np.testing.assert_allclose(*forces, atol=1e-9)

    config = replace(DEFAULT, tool_offset_m=tuple(offset), mode=mode)
    sensor, rows = tared(lwr, config)
    pushed = [
        (q, dq, tau - external_torque_of(longer, q, [0, 0, 2.0])) for q, dq, tau in rows
    ]
    last = feed(sensor, pushed)[-1]

    assert last.status is Status.OK

    if mode == "point":
        np.testing.assert_allclose(last.force, [0, 0, 2.0], atol=0.1)
