"""The whole chain in one object: what it estimates, and what it uses for
identification."""

import numpy as np
import pinocchio as pin
import pytest

from benchmarks.insertion.signals import JointSignals, measured_travel
from identification import MixtureConfig, SampleStatus
from identification.config import CheckConfig
from needleforce import InsertionError, InsertionSession
from residual import DEFAULT, SensorWarning, Status, TareError
from residual.tool_kinematics import ToolKinematics
from tests.insertion_run import (
    insert,
    resumed_after,
    same,
    samples,
    short_run,
    tare_index,
    time_steps,
)

RUN = short_run()
TARE = tare_index(RUN)
INSIDE = int(np.argmax(RUN.truth.depth_m > 15e-3)) - 1
"""The last sample before the middle of the gel."""


def ruptures(found):
    return [k for k, e in enumerate(found) if e.identification.rupture is not None]


@pytest.fixture(scope="module")
def whole():
    """Until the needle has left the gel."""
    session = InsertionSession(RUN.robot)
    return session, insert(session, TARE + 17_500)


def test_the_chain_finds_force_depth_and_layer(whole):
    session, estimates = whole
    touched = int(np.searchsorted(RUN.signals.t_s, RUN.truth.contact_s))
    axial = np.array([e.wrench.axial for e in estimates])
    error = (axial - RUN.truth.axial_N[: len(estimates)])[touched:]

    assert np.sqrt(np.mean(error**2)) < 0.05
    assert len(ruptures(estimates)) == len(session.layers) == 1
    assert session.layers[0].thickness_m == pytest.approx(28.2e-3, abs=1e-3)
    assert estimates[-1].status is Status.OK
    assert estimates[-1].used_for_identification
    assert session.rejected == 0
    assert session.lag_s == pytest.approx(1.0 / DEFAULT.gain_per_s)


@pytest.mark.slow
@pytest.mark.parametrize("with_velocity", [True, False])
def test_depth_and_speed_equal_the_offline_kinematics(whole, with_velocity):
    end = TARE + 4000
    sent = RUN.signals
    estimates = whole[1]
    if not with_velocity:
        estimates = insert(InsertionSession(RUN.robot), end, with_velocity=False)
    dq = sent.dq_rad_s if with_velocity else None
    signals = JointSignals(
        t_s=sent.t_s, q_rad=sent.q_rad, dq_rad_s=dq, tau_Nm=sent.tau_Nm
    )
    offline_m, offline_m_s = measured_travel(RUN.robot, signals, RUN.tare_end_s)
    compared = slice(TARE, end + 1)
    depth, speed = np.array([(e.depth_m, e.speed_m_s) for e in estimates[compared]]).T
    # The zero is noisy by a sample's worth; without velocities depth is 10 ms old.
    tolerance_m = 2e-5 if with_velocity else 8e-5

    np.testing.assert_allclose(depth, offline_m[compared], atol=tolerance_m)
    np.testing.assert_allclose(
        speed, offline_m_s[compared], atol=2e-6 if with_velocity else 1e-4
    )

    truth = RUN.truth.depth_m[compared] - RUN.truth.depth_m[TARE]

    np.testing.assert_allclose(depth, truth, atol=1e-4)


@pytest.mark.slow
def test_only_valid_tared_forces_are_used():
    session = InsertionSession(RUN.robot)
    lost = range(TARE + 100, TARE + 500)
    estimate = None
    for k, (q, dq, tau, dt_s) in samples(RUN):
        if k == TARE:
            assert not session.tared
            session.tare()
            tared_s = estimate.time_s
        estimate = session.update(q, dq, tau * np.nan if k in lost else tau, dt_s)
        if k < TARE:
            assert estimate.status in (Status.INITIALIZING, Status.NOT_TARED)
            assert not estimate.used_for_identification
            assert estimate.identification.time_s == 0.0
        if k == TARE + 499:
            assert estimate.status is Status.REJECTED
            assert not estimate.used_for_identification
            assert estimate.identification.time_s - tared_s == pytest.approx(0.1)
        if k == TARE + 500:
            assert estimate.status is Status.INITIALIZING
        if estimate.used_for_identification and k > TARE + 500:
            break

    # The time of what was not used has passed, and the identifier reports the gap.
    assert estimate.identification.status is SampleStatus.TIME_GAP
    assert estimate.identification.time_s == estimate.time_s
    assert estimate.time_s == pytest.approx(k * 1e-3, abs=2e-3)


@pytest.mark.slow
def test_refused_tares_and_new_insertions_keep_the_tare():
    session, (first, second) = resumed_after(TARE + 12_000, 2)
    deep = session.update(*first)

    with pytest.raises(TareError, match="start_tare_recording"):
        session.tare()
    assert session.snapshot().course.travel.depth_m == deep.depth_m > 5e-3

    session.begin_insertion()

    assert session.tared
    assert session.layers == ()

    again = session.update(*second)

    assert again.depth_m == pytest.approx(0.0, abs=1e-4)
    assert again.identification.layer == 1  # the tip is in its own channel

    tip_N = again.identification.tip_force_N

    assert tip_N == pytest.approx(deep.identification.tip_force_N, abs=0.05)

    session.start_tare_recording()

    assert not session.tared

    session.reset()

    assert not session.tared
    with pytest.raises(TareError):
        session.tare()


@pytest.mark.slow
def test_external_torque_gives_force_and_speed():
    sent = RUN.signals
    truth = RUN.truth
    end = TARE + 5000
    noise = 0.01 * np.random.default_rng(0).normal(size=truth.external_torque_Nm.shape)
    torque = truth.external_torque_Nm + 0.3 + noise
    for with_velocity in (True, False):
        session = InsertionSession(RUN.robot)
        for k, dt_s in enumerate(time_steps(RUN)[: end + 1]):
            if k == TARE:
                session.tare()
            dq = sent.dq_rad_s[k] if with_velocity else None
            estimate = session.update_external_torque(
                sent.q_rad[k], dq, torque[k], dt_s
            )
            assert estimate.status is not Status.REJECTED
        assert estimate.wrench.axial == pytest.approx(truth.axial_N[end], abs=0.1)
        assert estimate.speed_m_s == pytest.approx(truth.speed_m_s[end], abs=3e-4)


@pytest.mark.slow
def test_speed_lag_smooths_over_the_true_time(whole):
    lost, other = (InsertionSession(RUN.robot, speed_lag_s=0.02) for _ in range(2))
    moving = slice(TARE + 4001, TARE + 6001)
    smooth = np.std([e.speed_m_s for e in insert(other, TARE + 6000)[moving]])

    assert smooth < 0.5 * np.std([e.speed_m_s for e in whole[1][moving]])

    lost.restore(other.snapshot())
    rows = [sample for _, sample in samples(RUN)][TARE + 6001 : TARE + 7101]
    for k, (q, dq, tau, dt_s) in enumerate(rows):
        dq = dq * (3.0 if k >= 1000 else 1.0)
        ours = lost.update(q, dq, tau * np.nan if k % 10 else tau, dt_s)
        theirs = other.update(q, dq, tau, dt_s)
        if k % 10 == 0 and k >= 1030:
            assert ours.speed_m_s == pytest.approx(theirs.speed_m_s, rel=0.2)


@pytest.mark.parametrize("speed_lag_s", [-1.0, np.inf])
def test_a_lag_that_cannot_be_is_refused(speed_lag_s):
    with pytest.raises(InsertionError, match="speed_lag_s"):
        InsertionSession(RUN.robot, speed_lag_s=speed_lag_s)


@pytest.mark.parametrize("dt_s", [-10.0, 1.8e9, np.nan, None])
def test_a_clock_that_was_set_takes_no_time(dt_s):
    session, rows = resumed_after(TARE, 52)
    for row in rows[:50]:
        earlier = session.update(*row)

    assert earlier.used_for_identification

    set_back = session.update(*rows[50][:3], dt_s)

    assert set_back.status is Status.REJECTED
    assert not set_back.used_for_identification

    after = session.update(*rows[51])

    assert after.used_for_identification

    passed_s = after.identification.time_s - earlier.identification.time_s

    assert passed_s == pytest.approx(rows[51][3])


@pytest.mark.slow
def test_a_force_rejected_by_identifier_is_unused():
    config = MixtureConfig(check=CheckConfig(force_limit_N=1.0))
    session = InsertionSession(RUN.robot, identifier_config=config)
    insert(session, TARE)
    kinematics = ToolKinematics(RUN.robot)
    estimates = []
    for k, (q, dq, tau, dt_s) in enumerate(resumed_after(TARE, 400)[1]):
        kinematics.update(q)
        push = 3.0 * kinematics.axial_jacobian if k > 100 else 0.0
        estimates.append(session.update(q, dq, tau + push, dt_s))

    assert all(e.used_for_identification for e in estimates[:100])
    assert estimates[-1].status is Status.OK
    assert estimates[-1].wrench.axial > 1.0
    assert estimates[-1].identification.status is SampleStatus.FORCE_RANGE
    assert not estimates[-1].used_for_identification


# A push aside is no rupture; one on the elbow looks like one before its mismatch has
# lasted.


def pushed(rows, force_in_base_N, first, count, joint=None):
    """Samples, so many of them with a force on the tip, or on a joint, beside the
    tissue's."""
    kinematics = ToolKinematics(RUN.robot)
    data = RUN.robot.create_data()
    for k, (q, dq, tau, dt_s) in enumerate(rows):
        if first <= k < first + count:
            kinematics.update(q)
            lever = kinematics.pose[:3, :3] @ kinematics.jacobian[:3]
            if joint is not None:
                pin.computeJointJacobians(RUN.robot.model, data, q)
                axes = pin.LOCAL_WORLD_ALIGNED
                lever = pin.getJointJacobian(RUN.robot.model, data, joint, axes)[:3]
            tau = tau - lever.T @ np.array(force_in_base_N)
        yield q, dq, tau, dt_s


@pytest.mark.slow
@pytest.mark.parametrize("first", [100, 112])
def test_a_lateral_push_is_no_axial_force(first):
    session, rows = resumed_after(INSIDE, 400)
    still, _ = resumed_after(INSIDE, 400)
    estimates = [
        session.update(*row) for row in pushed(rows, (1.0, 0.0, 0.0), first, 400)
    ]
    alone = [still.update(*row) for row in rows]

    assert ruptures(estimates) == []
    assert all(e.used_for_identification for e in estimates)

    error = [
        pushed_estimate.wrench.axial - other.wrench.axial
        for pushed_estimate, other in zip(estimates, alone, strict=True)
    ]

    assert np.abs(error).max() < 0.05

    wrench = estimates[-1].wrench
    sideways = np.linalg.norm(
        np.cross([1.0, 0.0, 0.0], session._sensor.kinematics.axis_in_base)
    )

    assert wrench.lateral == pytest.approx(sideways, abs=0.1)
    assert wrench.lateral_std < 0.05


@pytest.mark.parametrize("first", [100, 112])
def test_a_push_on_the_elbow_raises_no_rupture(first):
    session, rows = resumed_after(INSIDE, 400)
    rows = pushed(rows, (0.0, 2.0, 0.0), first, 400, joint=4)
    estimates = [session.update(*row) for row in rows]

    assert ruptures(estimates) == []
    assert not any(e.identification.provisional for e in estimates)

    flagged = [
        k for k, e in enumerate(estimates) if SensorWarning.MODEL_MISMATCH in e.warnings
    ]

    assert first < flagged[0] < first + 100
    assert "do not fit" in estimates[flagged[0]].wrench.message
    assert not any(estimates[k].used_for_identification for k in flagged)
    assert all(e.status is Status.OK for e in estimates)


@pytest.mark.parametrize("kind", ["rupture", "provisional"])
def test_no_alarm_of_a_push_is_reported_before_it_is_known(monkeypatch, kind):
    session, rows = resumed_after(INSIDE, 2)
    before = session.update(*rows[0])
    alarmed = before.identification._replace(**{kind: object()})
    monkeypatch.setattr(session._identifier, "use", lambda *_: alarmed)
    monkeypatch.setattr(
        session._sensor,
        "recheck",
        lambda wrench: wrench._replace(warnings=SensorWarning.ARM_PUSHED),
    )

    estimate = session.update(*rows[1])

    assert getattr(estimate.identification, kind) is None
    assert not estimate.used_for_identification


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "seconds"), [(1_000, (0.9, 1.8)), (4_500, (1.9, 2.4))]
)
def test_a_small_push_shows_in_torque_changes(count, seconds):
    session, rows = resumed_after(INSIDE, 5_000)
    estimates = [
        session.update(*row)
        for row in pushed(rows, (0.0, 0.5, 0.0), 500, count, joint=4)
    ]
    flagged = [
        k for k, e in enumerate(estimates) if SensorWarning.ARM_PUSHED in e.warnings
    ]

    assert 500 < flagged[0] < 620
    assert seconds[0] < 1e-3 * len(flagged) < seconds[1]
    assert not any(SensorWarning.MODEL_MISMATCH in e.warnings for e in estimates)
    assert estimates[-1].used_for_identification
    assert ruptures(estimates) == []

    # A push that lasts is a torque that has jumped.
    lasts = [SensorWarning.TORQUE_JUMP in e.warnings for e in estimates]

    assert sum(lasts) > 600
    assert lasts[-1] == (count == 4_500)


@pytest.mark.slow
def test_a_push_rewinds_to_before_it_began():
    session, rows = resumed_after(INSIDE, 900)
    still, _ = resumed_after(INSIDE, 900)
    history = []
    for row in rows:
        still.update(*row)
        history.append(still.snapshot().identifier.travel)
    rows = pushed(rows, (0.0, 2.0, 0.0), 700, 200, joint=4)
    is_detected = (
        SensorWarning.MODEL_MISMATCH in session.update(*row).warnings for row in rows
    )
    k = next(k for k, is_known in enumerate(is_detected) if is_known)
    rewound = session.snapshot().identifier.travel
    equal_to = [n for n, travel in enumerate(history) if same(travel, rewound)]

    assert k - 520 < equal_to[-1] <= k - 250  # as if nothing had come since
    assert session.snapshot().unused_s == pytest.approx(
        1e-3 * (k - equal_to[-1]), abs=2e-3
    )


def test_a_push_beginning_in_unused_ticks_rewinds_once():
    session, rows = resumed_after(INSIDE, 900)
    for row in rows[:700]:
        session.update(*row)
    used = session.snapshot()
    wrench = session.update(*rows[700]).wrench._replace(status=Status.OK)
    for warning in (SensorWarning.VELOCITY, *[SensorWarning.MODEL_MISMATCH] * 3):
        session._follow_needle(wrench._replace(warnings=warning))
    rewound = session.snapshot()

    assert same(rewound.identifier, used.checkpoints.older.identifier)
    assert rewound.unused_s == pytest.approx(
        rewound.course.time_s - used.checkpoints.older.time_s
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "count", "late"),
    # The last two: within a push, so only after it.
    [(-5_700, 200, 10), (-100, 300, 900), (-50, 1_500, 1_850), (-400, 1_200, 1_200)],
)
def test_a_rupture_around_an_elbow_push_is_found(first, count, late):
    session, rows = resumed_after(INSIDE, 9_000)
    (undisturbed_alarm,) = ruptures([session.update(*row) for row in rows])
    (layer,) = session.layers
    session, rows = resumed_after(INSIDE, 9_000)
    rows = pushed(rows, (0.0, 2.0, 0.0), undisturbed_alarm + first, count, joint=4)
    estimates = [session.update(*row) for row in rows]
    (alarm,) = ruptures(estimates)

    # Blocks of the identifier begin elsewhere after the pause.
    assert -10 < alarm - undisturbed_alarm < late
    assert all(e.identification.retracted is None for e in estimates)
    assert abs(session.layers[0].friction_N / layer.friction_N - 1.0) < 0.15


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "step_Nm", "end"),
    # The first three as a hand that leans on the elbow for a while and lets go.
    [(1, 0.3, 2_000), (3, -0.3, 2_000), (5, 0.3, 2_000), (3, 0.3, 9_000)],
)
def test_a_torque_that_jumps_makes_no_rupture_and_hides_none(joint, step_Nm, end):
    session, rows = resumed_after(INSIDE, 9_000)
    jumped = [
        (q, dq, tau + step_Nm * np.eye(7)[joint] * (500 <= k < end), dt_s)
        for k, (q, dq, tau, dt_s) in enumerate(rows)
    ]
    estimates = [session.update(*row) for row in jumped]
    flagged = [
        k for k, e in enumerate(estimates) if SensorWarning.TORQUE_JUMP in e.warnings
    ]
    (alarm,) = ruptures(estimates)
    onset = int(np.searchsorted(RUN.signals.t_s, RUN.truth.ruptures[0].onset_s))

    assert 500 < flagged[0] <= 1_000
    assert onset < alarm + INSIDE + 1 < onset + 300
    assert all(e.identification.retracted is None for e in estimates)
    assert sum(not e.used_for_identification for e in estimates) < 2_700


@pytest.mark.slow
def test_a_session_restored_during_a_jump_knows_of_it():
    session, rows = resumed_after(INSIDE, 9_000)
    jumped = [
        (q, dq, tau - 0.3 * np.eye(7)[3] * (500 <= k < 3_500), dt_s)
        for k, (q, dq, tau, dt_s) in enumerate(rows)
    ]
    for row in jumped[:3_400]:
        session.update(*row)
    snapshot = session.snapshot()
    restored, _ = resumed_after(INSIDE, 1)
    restored.restore(snapshot)
    (alarm,) = ruptures([restored.update(*row) for row in jumped[3_400:]])

    assert snapshot.air.jump_std_N > 0.05
    assert 1_500 < alarm < 3_500


@pytest.mark.slow
def test_a_jump_takes_back_a_rupture_of_the_0_6_s_before_it_was_noticed():
    """It may have been that jump: a torque sensor's is noticed within half a second."""
    session, rows = resumed_after(INSIDE, 9_000)
    rows = list(rows)
    alarm = next(
        k for k, row in enumerate(rows) if session.update(*row).identification.rupture
    )
    retracted = []
    for row in rows[alarm + 1 : alarm + 450]:
        session.update(*row)
    for later in (0, 200):  # 0.45 and 0.65 s after the alarm
        for row in rows[alarm + 450 : alarm + 450 + later]:
            session.update(*row)
        jumped, _ = resumed_after(INSIDE, 1)
        snapshot = session.snapshot()
        air = snapshot.air._replace(jumps=snapshot.air.jumps + 1, jump_std_N=0.3)
        jumped.restore(snapshot._replace(air=air))
        after = rows[alarm + 450 + later : alarm + 550 + later]
        found = [jumped.update(*row).identification.retracted for row in after]
        retracted.append(any(found))

    assert retracted == [True, False]
