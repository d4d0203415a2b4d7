"""The facade: it reads a force, keeps its state, and reports what it cannot use."""

import copy
import math
import pickle
from dataclasses import replace
from fractions import Fraction

import numpy as np
import pinocchio as pin
import pytest

from residual import (
    DEFAULT,
    HAND_DRIVEN,
    BiasPrior,
    ConfigurationError,
    JointFriction,
    MomentumObserver,
    SampleError,
    SensorConfig,
    SensorWarning,
    SigmoidFriction,
    SnapshotError,
    Status,
    TareError,
    VelocityEstimator,
    VirtualForceSensor,
    WrenchEstimator,
)
from tests.insertion_run import same
from tests.residual.guarded_sensor import (
    WITH_OR_WITHOUT,
    at,
    changed,
    feed,
    feed_external,
    pushed,
    rows_of,
    signals,
    tared,
)
from tests.residual.residual_signals import (
    BIAS,
    MIDDLE,
    external_torque_of,
    gravity_of,
    pose_of,
    swing,
)
from urdf import Robot

STILL = np.zeros(7)
POINT = replace(DEFAULT, mode="point")
FORCE_N = np.array([1.0, -0.5, 2.0])


def robot_of(joint, count, effort_Nm=None):
    """An arm built straight in Pinocchio, whose unset limits are the largest float."""
    model = pin.Model()
    link = pin.Inertia(2.0, np.array([0.1, 0.0, 0.2]), 0.05 * np.eye(3))
    place = pin.SE3(np.eye(3), np.array([0.0, 0.3, 0.1]))
    for i in range(count):
        index = model.addJoint(i, joint, place, f"joint_{i}")
        model.addJointFrame(index, -1)
        model.appendBodyToJoint(index, link, place)
    tip = pin.SE3(np.eye(3), np.array([0.2, 0.2, 0.1]))
    model.addFrame(
        pin.Frame("tool", count, model.nframes - 1, tip, pin.FrameType.OP_FRAME)
    )
    if effort_Nm is not None:
        model.upperEffortLimit = np.full(count, effort_Nm)
    return Robot(bare_model=model, tool_frame="tool", flange_frame="tool")


# What it reads.


@WITH_OR_WITHOUT
def test_a_force_is_read_through_a_bias_and_the_tare_does_not_fade(lwr, with_velocity):
    sensor, rows = tared(lwr, POINT, with_velocity=with_velocity, noisy=False, more=3.0)
    found = feed(sensor, pushed(lwr, rows[:500], FORCE_N) + rows[500:])

    assert {e.status for e in found} == {Status.OK}
    np.testing.assert_allclose(found[499].force, FORCE_N, atol=0.03)
    assert max(np.abs(e.force).max() for e in found[1000:]) < 0.03


@WITH_OR_WITHOUT
def test_the_force_of_external_torques_follows_at_once(lwr, with_velocity):
    sensor = VirtualForceSensor(lwr, replace(POINT, force_bandwidth_per_s=None))
    _, q, dq, _ = swing(lwr, seconds=1.0, amplitude=0.03)
    torque_Nm = BIAS + 0.03 * np.random.default_rng(0).normal(size=q.shape)
    rows = rows_of(q, dq if with_velocity else None, torque_Nm)
    free = feed_external(sensor, rows[:500])
    sensor.tare()
    found = feed_external(sensor, pushed(lwr, rows[500:], -FORCE_N))
    needles = np.array([pose_of(lwr, one).rotation[:, 2] for one in q[500:]])
    errors_N = [e.axial for e in found] + needles @ FORCE_N
    late = 0 if with_velocity else 10

    assert (free[60].status, sensor.lag_s) == (Status.NOT_TARED, 0.0)
    np.testing.assert_allclose(sensor.velocity_rad_s, dq[-1 - late], atol=2e-3)
    assert 0.3 < np.std(errors_N) / found[-1].axial_std < 2.0
    assert abs(np.mean(errors_N)) < 0.02


def read(robot, rows, config=DEFAULT):
    """Forces after a tare on the first two seconds."""
    sensor = VirtualForceSensor(robot, config)
    feed(sensor, rows[:2000])
    sensor.tare()
    return [e.axial for e in feed(sensor, rows[2000:])]


@WITH_OR_WITHOUT
def test_torque_without_gravity_gives_the_same_force(lwr, with_velocity):
    q, dq, tau = signals(lwr, 2.2)
    with_gravity, without = (
        rows_of(q, dq if with_velocity else None, one)
        for one in (tau, tau - gravity_of(lwr, q))
    )
    compensated = replace(DEFAULT, torque_is_gravity_compensated=True)

    np.testing.assert_allclose(
        read(lwr, without, compensated), read(lwr, with_gravity), atol=1e-9
    )


def test_a_tip_offset_equals_a_displaced_frame(lwr):
    offset_m = (0.02, -0.03, 0.1)
    model = pin.Model(lwr.bare_model)
    at = model.frames[lwr.tool_frame_id]
    place = at.placement * pin.SE3(np.eye(3), np.array(offset_m))
    model.addFrame(pin.Frame("tip", at.parentJoint, lwr.tool_frame_id, place, at.type))
    longer = replace(lwr, bare_model=model, tool_frame="tip")
    rows = pushed(longer, rows_of(*signals(lwr, 2.3)), FORCE_N, first=2100)
    displaced = replace(POINT, tool_offset_m=offset_m)

    np.testing.assert_allclose(
        read(lwr, rows, displaced), read(longer, rows, POINT), atol=1e-6
    )


@pytest.mark.filterwarnings("error")
@WITH_OR_WITHOUT
@pytest.mark.parametrize(
    ("joint", "count"),
    [(pin.JointModelPZ(), 1), (pin.JointModelRX(), 1), (pin.JointModelRY(), 3)],
)
def test_robots_without_limits_or_with_one_joint_work(joint, count, with_velocity):
    robot = robot_of(joint, count)
    kinds = {"with_velocity": with_velocity, "middle": np.full(count, 0.4)}
    sensor, rows = tared(robot, replace(DEFAULT, mode="axial"), **kinds)
    last = feed(sensor, pushed(robot, rows, [0.0, 0.0, 3.0]))[-1]
    torque = external_torque_of(robot, rows[-1][0], [0.0, 0.0, 3.0])

    assert last.status is Status.OK
    assert all(np.isfinite(value).all() for value in last[:8])
    if count == 1:
        lever_m = sensor.kinematics.axial_jacobian
        assert last.axial == pytest.approx(-torque[0] / lever_m[0], abs=0.5)


# How certain it is.


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
def test_noise_is_smoothed_and_a_rupture_passes(lwr, mode):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode=mode))
    needle = pose_of(lwr, MIDDLE).rotation[:, 2]
    push_Nm = external_torque_of(lwr, MIDDLE, -2.0 * needle)
    torque_Nm = 0.02 * np.random.default_rng(0).normal(size=(4000, 7))
    torque_Nm[3000:] += push_Nm
    rows = [(MIDDLE, None, torque) for torque in torque_Nm]
    feed_external(sensor, rows[:1000])
    sensor.tare()
    found = feed_external(sensor, rows[1000:])
    still = found[500:2000]
    smooth, rough, across, std = (
        np.array([getattr(e, name) for e in still])
        for name in ("axial", "axial_unsmoothed", "lateral", "axial_std")
    )

    # A lag of 33 samples leaves 1 / 66 of the variance of white noise; wide steps let
    # more pass.
    assert np.std(smooth) < 0.35 * np.std(rough)
    assert np.std(smooth) < std.mean() < np.std(rough)
    assert [e.axial for e in found[2001:]] == pytest.approx(
        np.full(999, 2.0), abs=3.0 * std.mean()
    )
    if mode != "axial":
        assert np.sqrt(np.mean(across**2)) < 0.3 * still[-1].lateral_std


def test_a_force_that_the_lag_hides_widens_the_deviation_for_a_while(lwr):
    sensor, rows = tared(lwr, noisy=False)
    calm_N = feed(sensor, rows[:20])[-1].axial_std
    found = feed(sensor, pushed(lwr, rows[20:820], [0.0, 0.0, 2.0]))

    assert max(e.axial_std for e in found) > 20 * calm_N
    assert sensor.std_of_bias_N(found[-1]) < 4 * calm_N
    assert found[-1].axial_std < math.hypot(4 * calm_N, 0.03 * found[-1].axial)


def test_the_prior_gives_the_deviation_before_taring(lwr):
    sensor = VirtualForceSensor(lwr)
    rows = rows_of(*signals(lwr, 1.0))
    before = feed(sensor, rows[:-1])[-1]
    sensor.tare()

    assert abs(before.axial) < 2 * before.axial_std
    assert feed(sensor, rows[-1:])[0].axial_std < 0.1 * before.axial_std


@pytest.mark.parametrize(
    ("quiet", "loud", "amplitude", "ratio", "with_velocity"),
    [
        (DEFAULT, replace(DEFAULT, smooth_momentum=False), 0.005, 0.75, True),
        (DEFAULT, replace(DEFAULT, smooth_momentum=False), 0.3, 2.0, True),
        (HAND_DRIVEN, DEFAULT, 0.1, 0.6, False),
    ],
)
def test_settings_that_read_less_force_in_free_motion(
    lwr, quiet, loud, amplitude, ratio, with_velocity
):
    kinds = {"amplitude": amplitude, "with_velocity": with_velocity, "more": 2.0}
    quiet_N, loud_N = (
        np.std([e.axial_unsmoothed for e in feed(*tared(lwr, config, **kinds))[200:]])
        for config in (quiet, loud)
    )

    assert quiet_N < ratio * loud_N


# Two ways of one thing are equal, bit for bit.


def restored(sensor):
    other = VirtualForceSensor(sensor._robot)
    other.restore(sensor.snapshot())
    return other


GO_ON = {
    "copy": copy.copy,
    "deep copy": copy.deepcopy,
    "pickle": lambda sensor: pickle.loads(pickle.dumps(sensor)),
    "snapshot": restored,
}


@WITH_OR_WITHOUT
@pytest.mark.parametrize("how", GO_ON)
def test_a_copy_goes_on_bit_for_bit_amid_a_jump(lwr, how, with_velocity):
    twin, rows = tared(lwr, with_velocity=with_velocity, more=1.6)
    rows = changed(rows, 2, lambda tau: tau + at(3, 0.5), 300)
    feed(twin, rows[:800])
    sensor = GO_ON[how](twin)

    assert sensor.is_measuring_jump
    assert same(tuple(feed(sensor, rows[800:])), tuple(feed(twin, rows[800:])))


GIVEN = {
    "with gaps": lambda values: np.repeat(values, 2)[::2],
    "a list": list,
    "fractions": lambda values: [Fraction(float(one)) for one in values],
}


@WITH_OR_WITHOUT
@pytest.mark.parametrize("kind", GIVEN)
def test_numbers_may_come_in_any_layout_and_are_not_kept(lwr, kind, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    twin, _ = tared(lwr, with_velocity=with_velocity)
    for row in rows[:100]:
        given = [None if one is None else GIVEN[kind](one) for one in row]
        found = sensor.update(*given, 1e-3), sensor.velocity_rad_s.copy()
        for one in given:
            if one is not None:
                one[:] = np.full(7, 7.0)
        assert same(found, (twin.update(*row, np.float64(1e-3)), twin.velocity_rad_s))


@pytest.mark.parametrize(
    "stamps_s", [np.arange(1001) * 1e-3, 1.7e9 + np.arange(1001) / 1000]
)
@WITH_OR_WITHOUT
def test_rounding_of_time_stamps_decides_nothing(lwr, with_velocity, stamps_s):
    (sensor, rows), (twin, _) = (
        tared(lwr, with_velocity=with_velocity) for _ in range(2)
    )
    pairs = zip(rows, np.diff(stamps_s).tolist(), strict=True)
    found = [sensor.update(*row, dt_s) for row, dt_s in pairs]

    assert [(e.status, e.axial) for e in found] == [
        (Status.OK, pytest.approx(e.axial, abs=1e-4)) for e in feed(twin, rows)
    ]


# What it cannot use is reported, and never used.


class Raises:
    """An object of somebody else's whose conversions fail in their own way."""

    def __array__(self, *_, **__):
        raise RuntimeError("no array")

    __float__ = __repr__ = __array__


NO_SIGNAL = {
    "finite": [
        np.r_[STILL[1:], np.nan],
        np.r_[np.inf, STILL[1:]],
        np.array([None] * 7),
    ],
    "shape": [STILL[:3], np.zeros((7, 2))],
    "array of numbers": [
        ["a"] * 7,
        STILL + 0j,
        np.zeros(7, dtype=bool),
        np.ma.array(STILL, mask=[True] + [False] * 6),
        [10**400] * 7,
        Raises(),
    ],
    "reaches": [STILL + 1e300, STILL + 1e6],
}
NO_STEP = [10**5000, 5e-324, Raises(), np.float64("nan"), True, "x", None, 0.0]


def reports(robot, change, dt_s, word, **kinds):
    """Whether a bad sample is reported, counted and not used, and its time passes."""
    (sensor, rows), (twin, _) = (tared(robot, **kinds) for _ in range(2))
    bad = dict(enumerate(rows[1])) | change
    before, _ = (one.update(*rows[0], 1e-3) for one in (sensor, twin))
    held = sensor.update(*bad.values(), dt_s)
    passed_s = 1e-3 if dt_s == 1e-3 else 0.0
    after = sensor.update(*rows[2], 1e-3), twin.update(*rows[2], 1e-3 + passed_s)
    is_reported = held.status is Status.REJECTED and word in held.message
    return is_reported and (held.axial, sensor.rejected, after[0].axial) == (
        before.axial,
        1,
        after[1].axial,
    )


@pytest.mark.filterwarnings("error")
@WITH_OR_WITHOUT
@pytest.mark.parametrize("word", NO_SIGNAL)
def test_what_is_no_measurement_is_reported_and_never_used(lwr, word, with_velocity):
    for value in NO_SIGNAL[word]:
        for which in (0, 1, 2) if with_velocity else (0, 2):
            bad = {which: value}, 1e-3, "" if word == "reaches" else word
            assert reports(lwr, *bad, with_velocity=with_velocity)


@pytest.mark.parametrize("dt_s", NO_STEP, ids=range(len(NO_STEP)))
def test_no_time_step_makes_an_update_raise(lwr, dt_s):
    velocity = VelocityEstimator(7)
    velocity.update(STILL, STILL, 1e-3)

    assert reports(lwr, {}, dt_s, "dt_s")
    with pytest.raises(SampleError, match="dt_s"):
        velocity.update(STILL, STILL, dt_s)


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
def test_bad_first_samples_give_finite_read_only_numbers(lwr, mode):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode=mode))
    rows = rows_of(*signals(lwr, 1.0))
    found = [sensor.update(STILL * np.nan, STILL, STILL, 1e-3), feed(sensor, rows)[-1]]
    tare = sensor.tare()

    assert (found[0].status, found[0].covariance.shape) == (
        Status.REJECTED,
        found[1].covariance.shape,
    )
    assert found[0].axial_std >= 1e6
    assert all(np.isfinite(value).all() for e in found for value in e[:8])
    assert not any(
        isinstance(value, np.ndarray) and value.flags.writeable
        for value in (*found[0], *found[1], tare.mean, tare.covariance, tare.noise_Nm2)
    )


# Its life, and its clock.


# Acts of a caller; then so many samples, of which the first comes after a time step.
# What the last of them says: status, warning and a word; or with which word the act is
# refused.
NONE = SensorWarning(0)
EXPIRED = SensorWarning.TARE_EXPIRED
WRONG = SensorWarning.VELOCITY
FREE = ("", "update", 2000, 1e-3, Status.NOT_TARED, NONE, "")
ANEW = ("start_tare_recording", "update", 900, 1e-3, Status.NOT_TARED, NONE, "")
TARE = ("tare", "update", 100, 1e-3, Status.OK, NONE, "")
REFUSED = ("tare", "update", 0, 0.0, None, NONE)
STORIES = {
    "a life": [
        (*REFUSED, "free motion"),
        ("", "update", 1, 1e-3, Status.INITIALIZING, NONE, ""),
        *(FREE, TARE, (*REFUSED, "start_tare_recording"), ANEW),
        ("", "update", 1, 5.0, Status.INITIALIZING, NONE, ""),
        ("tare", "update", 900, 1e-3, Status.OK, NONE, ""),
        ("reset", "update", 1, 1e-3, Status.INITIALIZING, NONE, ""),
        (*REFUSED, "free motion"),
    ],
    "a clock that leaps after a tare": [
        *(FREE, TARE, ("", "update", 150, 59.0, Status.OK, NONE, "")),  # a pause
        ("", "update", 350, 3600.0, Status.OK, EXPIRED, "tare again"),
        ("copied", "update", 1, 1e-3, Status.OK, EXPIRED, ""),
        *(ANEW, TARE),
    ],
    "a clock that leaps before a tare": [
        *(FREE, ("", "update", 1, 3600.0, Status.INITIALIZING, EXPIRED, "")),
        (*REFUSED, "free motion"),
        ("", "update", 900, 1e-3, Status.NOT_TARED, EXPIRED, "forgotten"),
        TARE,
    ],
    "a tare beside the ticks": [
        ("start_tare", "update", 0, 0.0, None, NONE, "free motion"),
        *(FREE, ("start_tare", "update", 100, 1e-3, Status.NOT_TARED, NONE, "fitted")),
        ("start_tare_recording", "update", 900, 1e-3, Status.NOT_TARED, NONE, ""),
        ("start_tare", "update", 1, 1e-3, Status.NOT_TARED, NONE, "fitted"),
        ("start_tare", "update", 1500, 1e-3, Status.OK, NONE, ""),
    ],
    "milliseconds": [
        *[("", "update", 1, 1.0, Status.INITIALIZING, NONE, "milliseconds")] * 9,
        (*REFUSED, "free motion"),
    ],
    "a clock that goes back, and is waited for": [
        *(FREE, TARE),
        *(
            (
                "",
                "update",
                1,
                dt_s,
                Status.REJECTED,
                NONE,
                "dt_s" if dt_s < 1e-3 else "",
            )
            for dt_s in (-2e-3, 1e-3, 0.0, 5e-4)
        ),
        ("", "update", 1, 2e-3, Status.OK, NONE, ""),
        ("", "update", 1, -3600.0, Status.REJECTED, NONE, ""),
        ("", "update", 1, 1e-3, Status.OK, NONE, ""),
    ],
    "a clock that is set forward": [
        *(FREE, TARE),
        ("", "update", 1, 1e200, Status.REJECTED, NONE, "clock"),
        ("", "update", 1, 86_401.0, Status.REJECTED, NONE, "clock"),
        ("", "update", 1, 1e-3, Status.OK, NONE, ""),
    ],
    "torques that are mixed": [
        *(FREE, TARE),
        ("", "update_external_torque", 1, 1e-3, Status.REJECTED, NONE, "mixed"),
        (
            "start_tare_recording",
            "update_external_torque",
            1,
            1e-3,
            Status.NOT_TARED,
            NONE,
            "",
        ),
        ("", "update", 1, 1e-3, Status.REJECTED, NONE, "mixed"),
        ("reset", "update", 1, 1e-3, Status.INITIALIZING, NONE, ""),
    ],
    "velocities that are wrong, right, and wrong again": [
        ("", "in_degrees", 4000, 1e-3, Status.NOT_TARED, WRONG, "dq"),
        ("", "update", 500, 1e-3, Status.NOT_TARED, WRONG, "dq"),
        *(ANEW, TARE),
        (
            "start_tare_recording",
            "in_degrees",
            4000,
            1e-3,
            Status.NOT_TARED,
            WRONG,
            "dq",
        ),
        (*REFUSED, "dq"),
    ],
}


class Sensor(VirtualForceSensor):
    def copied(self):
        self.restore(self.snapshot())

    def in_degrees(self, q, dq, tau, dt_s):
        return self.update(q, np.degrees(dq), tau, dt_s)


@pytest.mark.parametrize("story", STORIES)
def test_a_sensor_says_what_it_knows_all_its_life(lwr, story):
    sensor = Sensor(lwr)
    rows = iter(rows_of(*signals(lwr, 12.0)))
    for act, update, count, dt_s, status, warning, word in STORIES[story]:
        if status is None:
            with pytest.raises(TareError, match=word):
                getattr(sensor, act)()
            continue
        getattr(sensor, act or "copied")()
        steps_s = [dt_s, *[1e-3] * (count - 1)]
        found = [getattr(sensor, update)(*next(rows), one) for one in steps_s][-1]
        assert (found.status, found.warnings) == (status, warning)
        assert word in found.message
        assert sensor.tared == (status is Status.OK) or found.status is Status.REJECTED


# Settings and snapshots.


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
    "insertion_axis": [(0, 0, 0), (0, 0, np.nan), (0, 1), "z"],
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


SIX = np.ones(6)


@pytest.mark.parametrize(
    ("word", "make"),
    [
        ("gain_per_s", lambda arm: MomentumObserver(arm, gain_per_s=[1.0, 2.0])),
        ("alignment", lambda arm: MomentumObserver(arm, alignment="euler")),
        ("max_gap_s", lambda arm: MomentumObserver(arm, max_gap_s=0.0)),
        ("bandwidth_per_s", lambda _: VelocityEstimator(7, bandwidth_per_s=np.inf)),
        ("joints", lambda _: VelocityEstimator(joints=-1)),
        *(
            (
                next(iter(bad)),
                lambda arm, bad=bad: VirtualForceSensor(arm, SensorConfig(**bad)),
            )
            for bad in (
                {"gain_per_s": (50.0, 50.0)},
                {
                    "friction": JointFriction(
                        viscous_Nms=SIX, coulomb_Nm=SIX, offset_Nm=SIX
                    )
                },
                {
                    "friction": SigmoidFriction(
                        amplitude_Nm=SIX, slope_s_rad=SIX, shift_rad_s=SIX
                    )
                },
                {
                    "friction": type(
                        "NaN", (), {"torque": lambda self, dq: dq + np.nan}
                    )()
                },
            )
        ),
        *(
            (
                next(iter(bad)),
                lambda _, bad=bad: JointFriction(
                    **{"viscous_Nms": [1.0], "coulomb_Nm": [1.0], "offset_Nm": [0.0]}
                    | bad
                ),
            )
            for bad in (
                {"viscous_Nms": [-1.0]},
                {"coulomb_Nm": [1.0, 2.0]},
                {"offset_Nm": [np.nan]},
                {"offset_Nm": ["much"]},
                {"reversal_speed_rad_s": 0.0},
            )
        ),
        *(
            (
                word,
                lambda arm, bad=bad: VirtualForceSensor(
                    arm, SensorConfig(prior=BiasPrior(**bad))
                ),
            )
            for word, bad in (
                ("mass_fraction", {"mass_fraction": 0.0}),
                ("hysteresis_widths", {"hysteresis_widths": 1e-4}),
                ("com_m", {"com_m": np.nan}),
                ("7", {"gear_ratio": (160.0,)}),  # of another arm
            )
        ),
        *(
            (
                word,
                lambda arm, bad=bad: WrenchEstimator(arm).set_torque_covariance(bad),
            )
            for word, bad in (
                ("shape", np.eye(6)),
                ("symmetric", np.eye(7) + np.triu(np.ones((7, 7)), 1)),
                ("positive definite", -np.eye(7)),
                ("finite", np.eye(7) * np.nan),
            )
        ),
        ("steps_per_tick", lambda arm: tared(arm)[0].start_tare(steps_per_tick=0)),
        (
            "effort",
            lambda _: VirtualForceSensor(robot_of(pin.JointModelRX(), 2, 1e-300)),
        ),
    ],
)
def test_parts_and_settings_that_fit_no_arm_are_refused(lwr, word, make):
    with pytest.raises(ConfigurationError, match=word):
        make(lwr)


def test_a_snapshot_of_settings_that_differ_in_the_tenth_digit_is_refused(lwr):
    sensors = [
        VirtualForceSensor(
            lwr,
            replace(
                DEFAULT,
                friction=JointFriction(
                    viscous_Nms=np.r_[SIX, last], coulomb_Nm=STILL, offset_Nm=STILL
                ),
            ),
        )
        for last in (0.1, 0.1, 0.1 + 1e-10)
    ]
    sensors[1].restore(sensors[0].snapshot())
    with pytest.raises(SnapshotError, match="settings"):
        sensors[2].restore(sensors[0].snapshot())
