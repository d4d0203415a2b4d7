"""Valid numbers that are no measurements are held back, reported, and forgotten;
measurements never are."""

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from residual import DEFAULT, SensorWarning, Status, VirtualForceSensor
from tests.residual.guarded_sensor import (
    NOISE,
    WITH_OR_WITHOUT,
    at,
    changed,
    feed,
    feed_external,
    held,
    pushed,
    rows_of,
    signals,
    tared,
)
from tests.residual.residual_signals import (
    MIDDLE,
    jacobian_of,
    swing,
)


def rounded(values, resolution):
    return np.round(values / resolution) * resolution if resolution else values


def rejected(estimates, warning=SensorWarning(0)):  # noqa: B008
    return [
        k
        for k, e in enumerate(estimates)
        if e.status is Status.REJECTED and warning in e.warnings
    ]


# One sample, or a lasting change.


LIMIT_NM = np.array([176.0, 176.0, 100.0, 100.0, 100.0, 38.0, 38.0])
FROZEN_TAU = {2: lambda rows: lambda _: rows[99][2]}
FROZEN_Q = {which: lambda rows, k=which: lambda _: rows[99][k] for which in (0, 1)}
FAULTS = {
    "position": (
        {0: lambda _: lambda q: q + at(2, 0.02)},
        50,
        51,
        0,
        "SPIKE",
        "joint 3",
    ),
    **{
        f"torque {joint + 1}": (
            {2: lambda _, joint=joint: lambda tau: tau + at(joint, 0.06 * LIMIT_NM)},
            *(50, 51, 0, "SPIKE", f"joint {joint + 1}"),
        )
        for joint in range(7)
    },
    "saturated": (
        {2: lambda _: lambda tau: np.where(at(3, True), LIMIT_NM, tau)},
        *(50, 250, 0, "SATURATED", "joint 4"),
    ),
    "frozen torque": (FROZEN_TAU, 100, 400, 30, "FROZEN", "torque"),
    "frozen position": (FROZEN_Q, 100, 400, 30, "FROZEN", "position"),
    "frozen": (FROZEN_TAU | FROZEN_Q, 100, 400, 30, "FROZEN", "position and torque"),
}


@pytest.mark.parametrize("resolution_Nm", [0.0, 1e-2])
@pytest.mark.parametrize("kind", FAULTS)
def test_a_fault_is_held_back_while_it_lasts(lwr, kind, resolution_Nm):
    faults, first, last, seen_after, warning, word = FAULTS[kind]
    sensor, rows = tared(lwr, more=1.2)
    sent = rows = changed(rows, 2, lambda tau: rounded(tau, resolution_Nm))
    for which, fault in faults.items():
        sent = changed(sent, which, fault(rows), first, last)
    found = feed(sensor, sent)
    seen = first + seen_after

    assert set(range(seen, last)) <= set(rejected(found, SensorWarning[warning]))
    assert set(rejected(found)) <= set(range(first, last + 8))
    assert word in found[last - 1].message
    assert found[last - 1].axial == found[seen].axial
    assert max(abs(e.axial) for e in found[last:]) < 0.2


@pytest.mark.parametrize(("sigmas", "is_spike"), [(11.0, False), (14.0, True)])
def test_a_noisy_torque_may_jump_by_twelve_times_its_noise(lwr, sigmas, is_spike):
    q, dq, tau = signals(lwr, 0.7)
    wrist_Nm = 0.3 * np.random.default_rng(0).normal(size=len(tau))
    # The difference of two samples has twice the variance of one. A wrist of 38 Nm may
    # also step by 2 % of that.
    wrist_Nm[-2:] = 0.0, sigmas * np.sqrt(2.0) * 0.3 + 0.76
    tau[:, 6] += wrist_Nm
    found = feed(VirtualForceSensor(lwr), rows_of(q, dq, tau))

    assert bool(rejected(found[-1:])) == is_spike


@WITH_OR_WITHOUT
@pytest.mark.parametrize(("which", "size"), [(2, -12.0), (0, 0.01)])
def test_a_change_that_stays_is_accepted(lwr, which, size, with_velocity):
    sensor, rows = tared(lwr, with_velocity=with_velocity)
    found = feed(sensor, changed(rows[:400], which, lambda x: x + at(1, size), 50))
    refused = rejected(found)

    assert 1 <= len(refused) <= 8
    assert set(refused) <= set(range(50, 60))
    assert (found[-1].status, Status.INITIALIZING in {e.status for e in found}) == (
        Status.OK,
        which == 0 and not with_velocity,
    )
    if which:
        assert found[-1].residual[1] == pytest.approx(-size, abs=0.5)
    else:
        assert max(abs(e.axial) for e in found) < 1.0


def test_garbage_is_not_held_back_for_ever(lwr):
    sensor, rows = tared(lwr)
    normal = np.random.default_rng(0).normal
    found = feed(sensor, changed(rows, 2, lambda x: x + 50.0 * normal(size=7), 50, 400))

    assert not set(range(50, 400)) <= set(rejected(found))
    assert (found[-1].status, found[-1].axial) == (
        Status.OK,
        pytest.approx(0.0, abs=0.1),
    )


# Signals that are stuck are told from valid ones that repeat.


SOURCES = [(lsb, noise, 1) for lsb in (0.0, 4e-3, 0.1) for noise in (0.0, 0.03)]


@pytest.mark.slow
@pytest.mark.parametrize("moves_first", [False, True])
@pytest.mark.parametrize("source", [*SOURCES, (0.0, 0.03, 10), (0.02, 4e-3, 4)])
def test_an_arm_at_rest_is_never_refused(lwr, source, moves_first):
    resolution, noise, samples = source
    _, q, _, tau = swing(lwr, seconds=0.8, amplitude=0.1 * moves_first)
    q, tau = (np.concatenate((x, np.repeat(x[-1:], 2000, axis=0))) for x in (q, tau))
    noise_Nm = noise * np.random.default_rng(1).normal(size=tau.shape)
    tau = held(rounded(tau + noise_Nm, resolution), samples)
    found = feed_external(VirtualForceSensor(lwr), rows_of(q, None, tau))

    assert not any(SensorWarning.FROZEN in e.warnings for e in found[800:])


def test_a_slow_source_is_frozen_after_far_longer(lwr):
    tau = held(NOISE["tau"] * np.random.default_rng(0).normal(size=(2000, 7)), 10)
    tau[1000:] = tau[999]
    rows = [(MIDDLE, None, one) for one in tau]
    found = feed_external(VirtualForceSensor(lwr), rows)
    frozen = [SensorWarning.FROZEN in e.warnings for e in found]

    assert (any(frozen[:1150]), all(frozen[1250:])) == (False, True)


def test_one_stuck_torque_is_reported_and_not_refused(lwr):
    sensor, rows = tared(lwr, more=1.5)
    stuck = rows[99][2]
    one = changed(rows[:1100], 2, lambda x: np.where(at(1, True), stuck, x), 100, 1000)
    found = feed(sensor, one)
    is_frozen = [SensorWarning.FROZEN in e.warnings for e in found]
    times = set(is_frozen[:500]), set(is_frozen[700:1000]), is_frozen[-1]

    assert {e.status for e in found} == {Status.OK}
    assert times == ({False}, {True}, False)
    assert "joint 2" in found[999].message


def test_nothing_is_refused_for_ever(lwr):
    sensor, rows = tared(lwr)
    feed(sensor, rows[:100])
    found = feed(sensor, [rows[99]] * 1000, 0.01)

    assert 4.5 < 0.01 * len(rejected(found)) <= 5.0
    assert found[-1].status is Status.OK
    assert SensorWarning.FROZEN in found[-1].warnings


def test_signals_without_noise_may_repeat_themselves(lwr):
    sensor = VirtualForceSensor(lwr)
    row = MIDDLE, np.zeros(7), swing(lwr, seconds=0.1)[-1][0]
    found = feed(sensor, [row] * 1500)
    sensor.tare()
    found += feed(sensor, [row] * 1500)

    assert not any(e.warnings for e in found)
    assert (found[1499].status, found[-1].status) == (Status.NOT_TARED, Status.OK)
    assert "changed" in found[-1].message
    assert sensor.update(*row[:2], row[2] + 1e-3, 0.1).message == ""


# A source slower than the clock repeats its samples, then jumps: that is no spike.


def moving(robot, noise_rad):
    """Positions, velocities and torques of a brisk motion, up to half a radian a
    second."""
    q, dq, tau = signals(robot, 1.5, amplitude=0.2)
    return q + noise_rad * np.random.default_rng(0).normal(size=q.shape), dq, tau


@WITH_OR_WITHOUT
@pytest.mark.parametrize("noise_rad", [0.0, 1e-4])
@pytest.mark.parametrize("samples", [2, 5, 20])
def test_positions_of_slow_sources_are_no_spikes(
    lwr, samples, noise_rad, with_velocity
):
    q, dq, tau = moving(lwr, noise_rad)
    for rng in (None, np.random.default_rng(1)):
        rows = rows_of(held(q, samples, rng), dq if with_velocity else None, tau)
        found = feed(VirtualForceSensor(lwr), rows)
        assert not any(e.warnings for e in found)


@pytest.mark.parametrize("samples", [2, 5, 20])
def test_a_spike_of_a_held_position_is_rejected(lwr, samples):
    q, dq, tau = moving(lwr, 1e-5)
    q = held(q, samples)
    q[1000 : 1000 + 4, 2] += 0.05
    found = feed(VirtualForceSensor(lwr), rows_of(q, dq, tau))

    assert rejected(found, SensorWarning.SPIKE)[:4] == [1000, 1001, 1002, 1003]
    assert len(rejected(found)) <= 5


def test_a_long_rest_makes_no_gate_wide(lwr):
    noise = np.random.default_rng(3).normal(size=(4000, 7))
    q = np.repeat(MIDDLE[None], 4000, axis=0)
    q[3990, 4] += 1e-3
    rows = rows_of(q, 1e-3 * noise, 0.03 * noise)

    assert rejected(feed(VirtualForceSensor(lwr), rows)) == [3990]


# What an arm does is never held back.


def fast_motion(robot, rng):
    """Two seconds of sines up to each joint's velocity limit."""
    limit_rad_s = robot.velocity_limit_rad_s
    middle = MIDDLE + rng.uniform(-0.5, 0.5, robot.nv)
    # 40 rad/s2: twice what the interface of a Panda allows its joints at most.
    quickest = 40.0 / limit_rad_s
    omega = np.exp(rng.uniform(np.log(0.3 * quickest), np.log(quickest)))
    phase = rng.uniform(0.0, 2.0 * np.pi, robot.nv)
    wave = omega * 1e-3 * np.arange(2000)[:, None] + phase
    q = middle + limit_rad_s / omega * np.sin(wave)
    dq = limit_rad_s * np.cos(wave)
    motion = zip(q, dq, -limit_rad_s * omega * np.sin(wave), strict=True)
    data = robot.create_data()
    return q, dq, np.array([pin.rnea(robot.model, data, *one) for one in motion])


def hands(robot, rng):
    """Pushes on the forearm of 5 to 50 N, each within 30 ms, let go within 10 ms."""
    q, dq, tau = signals(robot, 2.0, noisy=False)
    t_s = 1e-3 * np.arange(len(q))
    for start_s in (0.8, 1.2, 1.6):
        force = rng.normal(size=3)
        force *= rng.uniform(5.0, 50.0) / np.linalg.norm(force)
        size = np.interp(t_s - start_s, [0.0, 0.03, 0.2, 0.21], [0.0, 1.0, 1.0, 0.0])
        for k in np.flatnonzero(size):
            lever = jacobian_of(robot, q[k], "lwr_link_5")[:3]
            tau[k] -= size[k] * lever.T @ force
    return q, dq, tau


@pytest.mark.parametrize(
    ("motion_of", "with_velocity", "which", "size", "held_back"),
    [
        *((one, dq, 0, 0.0, 0) for one in (fast_motion, hands) for dq in (True, False)),
        (fast_motion, True, 0, 0.05, 3),
        (fast_motion, True, 2, 20.0, 3),
    ],
)
def test_spikes_of_a_fast_arm_are_rejected_and_no_valid_sample(
    lwr, motion_of, with_velocity, which, size, held_back
):
    rng = np.random.default_rng(1)
    q, dq, tau = (
        value + std * rng.normal(size=value.shape)
        for value, std in zip(motion_of(lwr, rng), NOISE.values(), strict=True)
    )
    rows = rows_of(q, dq if with_velocity else None, tau)
    for k in (1500, 1600, 1700):
        rows[k][which][2] += size

    assert len(rejected(feed(VirtualForceSensor(lwr), rows))) == held_back


# Velocities that are wrong for a moment.


@pytest.mark.parametrize("wrong", [lambda dq: 0.0 * dq, lambda dq: dq + at(3, 0.2)])
def test_a_velocity_that_is_no_rate_of_q_is_rejected(lwr, wrong):
    sensor, rows = tared(lwr, noisy=0.1, more=2.0)
    sent = changed(rows, 1, wrong, 700, 703)
    found = feed(sensor, changed(sent, 1, wrong, 1700, 1703))

    assert rejected(found, SensorWarning.SPIKE) == [700, 701, 702, 1700, 1701, 1702]
    assert max(abs(e.axial) for e in found) < 0.1


def test_velocities_that_stay_wrong_are_rejected_for_a_moment_only(lwr):
    sensor, rows = tared(lwr, more=4.0)
    found = feed(sensor, changed(rows, 1, lambda dq: 0.0 * dq - 0.3, 500))

    assert 50 <= len(rejected(found)) <= 110
    assert SensorWarning.VELOCITY in found[-1].warnings


# Angles on a circle.


@WITH_OR_WITHOUT
@pytest.mark.parametrize("guard", [True, False])
def test_a_step_of_a_turn_is_no_motion(lwr, with_velocity, guard):
    (sensor, rows), (twin, _) = (
        tared(lwr, replace(DEFAULT, guard=guard), with_velocity=with_velocity)
        for _ in range(2)
    )
    wrapped = changed(rows, 0, lambda q: q - at(2, 2.0 * np.pi), 300)
    wrapped = changed(wrapped, 0, lambda q: q + at(4, 4.0 * np.pi), 600, 800)
    estimates = feed(sensor, wrapped)
    found = [(e.status, e.axial) for e in estimates]
    warned = [k for k, e in enumerate(estimates) if SensorWarning.TURN in e.warnings]

    assert found == [
        (Status.OK, pytest.approx(e.axial, abs=1e-6)) for e in feed(twin, rows)
    ]
    assert warned == [300, 600, 800]


# Where an estimate may be wrong.


@pytest.mark.slow
def test_a_joint_at_its_limit_is_reported(lwr):
    middle = MIDDLE.copy()
    middle[5] = lwr.position_upper_rad[5] - 0.05
    sensor, rows = tared(lwr, middle=middle, more=4.0)
    named = [e for e in feed(sensor, rows) if SensorWarning.JOINT_LIMIT in e.warnings]

    assert 0 < len(named) < len(rows)
    assert "joint 6" in named[-1].message


@pytest.mark.parametrize("mode", ["axial", "point", "full"])
@pytest.mark.parametrize(
    ("q", "is_blind"), [(np.full(7, 0.001), True), (MIDDLE, False)]
)
def test_a_pose_that_feels_nothing_is_reported(lwr, mode, q, is_blind):
    sensor = VirtualForceSensor(lwr, replace(DEFAULT, mode=mode))
    found = feed(sensor, [(q, np.zeros(7), np.zeros(7))] * 600)[-1]

    assert (SensorWarning.NEAR_SINGULAR in found.warnings) == is_blind
    assert all(np.isfinite(value).all() for value in found[:8])


@pytest.mark.parametrize(("mode", "mismatches"), [("axial", True), ("point", False)])
def test_a_lateral_push_mismatches_only_the_axial_mode(lwr, mode, mismatches):
    sensor, rows = tared(lwr, replace(DEFAULT, mode=mode))
    found = feed(sensor, pushed(lwr, rows[:600], [1.0, 0.5, 0.0], first=100))
    warned = SensorWarning.MODEL_MISMATCH in found[-1].warnings

    assert found[99].model_mismatch < 2.0
    assert (found[-1].model_mismatch > 4.0, warned) == (mismatches, mismatches)
    assert bool(found[-1].message) == mismatches


def test_acceleration_widens_the_deviation_of_each_joint(lwr):
    sensor, rows = tared(lwr)
    before = feed(sensor, rows[:100])[-1]
    at_rest = sensor.residual_std_Nm
    fast = rows_of(*fast_motion(lwr, np.random.default_rng(2)))
    after = feed(sensor, fast)[-1]

    assert (sensor.residual_std_Nm[:4] > 3.0 * at_rest[:4]).all()
    assert after.axial_std > 3.0 * before.axial_std
