"""The whole chain in one object: what it tells, and what it feeds the identifier."""

import numpy as np
import pytest
from insertion_run import samples, short_run, tare_index, time_steps

from benchmarks.signals import JointSignals, measured_travel
from identification import SampleStatus
from needleforce import InsertionError, InsertionSession
from needleforce.session import TipTravel
from residual import DEFAULT, PUBLISHED, Status, TareError
from residual.tool_kinematics import ToolKinematics


def insert(session, *, with_velocity=True, last=None):
    """Every estimate of the short run, tared where a user would."""
    run = short_run()
    tare = tare_index(run)
    found = []
    for k, sample in samples(run, with_velocity=with_velocity):
        if k == tare:
            session.tare()
        found.append(session.update(*sample))
        if k == last:
            break
    return found


@pytest.fixture(scope="module")
def whole():
    session = InsertionSession(short_run().robot)
    return session, insert(session)


def test_the_chain_finds_force_depth_and_layer(whole):
    run, (session, found) = short_run(), whole
    inside = (run.signals.t_s > run.contact_s) & (run.signals.t_s < run.withdrawn_s)
    axial = np.array([e.wrench.axial for e in found])
    assert np.sqrt(np.mean((axial - run.truth.axial_N)[inside] ** 2)) < 0.05
    assert [e.identification.rupture is not None for e in found].count(True) == 1
    assert len(session.layers) == 1
    assert session.layers[0].thickness_m == pytest.approx(28.2e-3, abs=1e-3)
    assert found[-1].status is Status.OK
    assert found[-1].used_for_identification
    assert session.skipped == 0
    assert session.lag_s == pytest.approx(1.0 / DEFAULT.gain_per_s)


@pytest.mark.parametrize("with_velocity", [True, False])
def test_depth_and_speed_are_those_of_the_offline_kinematics(with_velocity):
    run = short_run()
    sent = run.signals
    tare = tare_index(run)
    online = insert(InsertionSession(run.robot), with_velocity=with_velocity, last=tare + 4000)[
        tare:
    ]
    offline = measured_travel(
        run.robot,
        JointSignals(
            t_s=sent.t_s,
            q_rad=sent.q_rad,
            dq_rad_s=sent.dq_rad_s if with_velocity else None,
            tau_Nm=sent.tau_Nm,
        ),
        run.tare_end_s,
    )
    depth = np.array([e.depth_m for e in online])
    speed = np.array([e.speed_m_s for e in online])
    part = slice(tare, tare + len(depth))
    # The zero is noisy by a sample's worth; without velocities depth is 10 ms old.
    tolerance_m = 2e-5 if with_velocity else 8e-5
    np.testing.assert_allclose(depth, offline.depth_m[part], atol=tolerance_m)
    np.testing.assert_allclose(speed, offline.speed_m_s[part], atol=2e-6 if with_velocity else 1e-4)
    truth = run.truth.depth_m[part] - run.truth.depth_m[tare]
    np.testing.assert_allclose(depth, truth, atol=1e-4)


def test_travel_counts_from_its_zero_along_the_needle(lwr):
    kinematics = ToolKinematics(lwr)
    q = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])
    kinematics.update(q)
    travel = TipTravel(kinematics)
    assert travel.read(np.zeros(7)) == pytest.approx((0.0, 0.0), abs=1e-12)
    step = kinematics.axial_jacobian / kinematics.axial_jacobian.dot(kinematics.axial_jacobian)
    assert travel.read(step).speed_m_s == pytest.approx(1.0)
    kinematics.update(q + 1e-4 * step)
    assert travel.read(step).depth_m == pytest.approx(1e-4, rel=1e-2)
    kept = travel.state
    travel.zero()
    assert travel.read(step).depth_m == pytest.approx(0.0, abs=1e-12)
    travel.restore(kept)
    assert travel.read(step).depth_m == pytest.approx(1e-4, rel=1e-2)


def test_the_identifier_is_fed_only_forces_of_this_tick():
    run = short_run()
    session = InsertionSession(run.robot)
    tare = tare_index(run)
    for k, (q, dq, tau, dt_s) in samples(run):
        if k == tare:
            assert not session.tared
            session.tare()
            tared_s = estimate.time_s
        estimate = session.update(
            q, dq, tau * np.nan if k in range(tare + 100, tare + 500) else tau, dt_s
        )
        if k < tare:
            assert estimate.status in (Status.INITIALIZING, Status.NOT_TARED)
            assert not estimate.used_for_identification
            assert estimate.identification.time_s == 0.0
        if k == tare + 499:
            assert estimate.status is Status.REJECTED
            assert not estimate.used_for_identification
            assert estimate.identification.time_s - tared_s == pytest.approx(0.1)
        if k == tare + 500:
            assert estimate.status is Status.INITIALIZING
        if estimate.used_for_identification and k > tare + 500:
            break
    # The time of what was not fed has passed; the identifier is told of the gap.
    assert estimate.identification.status is SampleStatus.TIME_GAP
    assert estimate.identification.time_s == estimate.time_s
    assert estimate.time_s == pytest.approx(k * 1e-3, abs=2e-3)


def test_a_rupture_is_told_once(whole):
    found = whole[1]
    k = next(k for k, e in enumerate(found) if e.identification.rupture is not None)
    run = short_run()
    session = InsertionSession(run.robot)
    insert(session, last=k)
    q, dq, tau, dt_s = next(sample for j, sample in samples(run) if j == k + 1)
    assert session.update(q, dq, tau * np.nan, dt_s).identification.rupture is None


def test_a_withdrawn_rupture_is_told_once(whole):
    found = whole[1]
    k = next(k for k, e in enumerate(found) if e.identification.rupture is not None)
    told = found[k].identification
    run = short_run()
    session = InsertionSession(run.robot)
    insert(session, last=tare_index(run) + 10)
    session._identification = told._replace(rupture=None, retracted=told.rupture)
    q, dq, tau, dt_s = next(sample for j, sample in samples(run) if j == tare_index(run) + 11)
    for _ in range(2):
        idle = session.update(q, dq, tau * np.nan, dt_s).identification
        assert idle == told._replace(rupture=None)


def test_another_insertion_begins_anew_but_keeps_the_tare():
    run = short_run()
    session = InsertionSession(run.robot)
    insert(session, last=tare_index(run) + 12_000)
    deep = session.update(*next(sample for k, sample in samples(run) if k == 25_000))
    session.begin_insertion()
    assert session.tared
    assert session.layers == ()
    again = session.update(*next(sample for k, sample in samples(run) if k == 25_001))
    assert deep.depth_m > 5e-3
    assert again.depth_m == pytest.approx(0.0, abs=1e-4)
    assert again.identification.layer == 0
    session.reset()
    assert not session.tared
    with pytest.raises(TareError):
        session.tare()


def test_a_refused_tare_leaves_the_insertion_as_it_was():
    session = InsertionSession(short_run().robot)
    insert(session, last=tare_index(short_run()) + 3000)
    depth_m = session.snapshot().travel.depth_m
    with pytest.raises(TareError, match="start_tare_recording"):
        session.tare()
    assert session.snapshot().travel.depth_m == depth_m
    session.start_tare_recording()
    assert not session.tared


def test_the_robots_own_external_torque_takes_the_same_way():
    run = short_run()
    sent, truth = run.signals, run.truth
    tare = tare_index(run)
    rng = np.random.default_rng(0)
    torque = truth.external_torque_Nm + 0.3 + 0.01 * rng.normal(size=truth.external_torque_Nm.shape)
    sessions = {True: InsertionSession(run.robot), False: InsertionSession(run.robot)}
    for k, dt_s in enumerate(time_steps(run)):
        for given, session in sessions.items():
            if k == tare:
                session.tare()
            dq = sent.dq_rad_s[k] if given else None
            estimate = session.update_external_torque(sent.q_rad[k], dq, torque[k], dt_s)
            assert estimate.status is not Status.REJECTED
            if k == tare + 8000:
                assert estimate.wrench.axial == pytest.approx(truth.axial_N[k], abs=0.1)
                assert estimate.speed_m_s == pytest.approx(truth.speed_m_s[k], abs=3e-4)
        if k == tare + 8000:
            break


def test_speed_lag_smooths_the_speed():
    run = short_run()
    end = tare_index(run) + 6000
    spread = {
        lag_s: np.std(
            [
                e.speed_m_s
                for e in insert(InsertionSession(run.robot, speed_lag_s=lag_s), last=end)[-2000:]
            ]
        )
        for lag_s in (0.0, 0.02)
    }
    assert spread[0.02] < 0.5 * spread[0.0]


@pytest.mark.parametrize("lag_s", [-1.0, np.inf, np.nan, "x"])
def test_a_lag_that_cannot_work_is_refused(lwr, lag_s):
    with pytest.raises(InsertionError, match="speed_lag_s"):
        InsertionSession(lwr, speed_lag_s=lag_s)


def test_the_published_settings_run_through(lwr):
    session = InsertionSession(lwr, PUBLISHED)
    q = np.array([0.1, 0.5, -0.2, -1.5, 0.3, 1.0, 0.2])
    for _ in range(10):
        estimate = session.update(q, np.zeros(7), np.zeros(7), 1e-3)
    assert estimate.wrench.covariance.shape == (6, 6)


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        (("arm.urdf",), r"robot is a str, expected a Robot; .*load_urdf"),
        ((short_run().robot, {"mode": "full"}), r"sensor_config is a dict, .*SensorConfig"),
    ],
)
def test_a_path_or_a_dict_is_refused_with_a_sentence(arguments, match):
    with pytest.raises(InsertionError, match=match):
        InsertionSession(*arguments)
