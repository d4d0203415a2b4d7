"""The whole chain in one object: what it estimates, and what it uses for
identification."""

from copy import copy
from itertools import islice

import numpy as np
import pinocchio as pin
import pytest

from identification import CheckConfig, MixtureConfig, SampleStatus
from needleforce import InsertionError, InsertionSession, session_events
from residual import DEFAULT, SensorWarning, Status, TareError, ToolKinematics
from tests.insertion_run import (
    insert,
    resumed_after,
    same,
    samples,
    short_run,
    tare_index,
)
from tests.residual.residual_signals import jacobian_of, pose_of

RUN = short_run()
TARE = tare_index(RUN)
INSIDE = int(np.argmax(RUN.truth.depth_m > 15e-3)) - 1
"""The last sample before the middle of the gel."""


def ruptures(found):
    return [k for k, e in enumerate(found) if e.identification.rupture is not None]


def warned(found, warning):
    return [k for k, e in enumerate(found) if warning in e.warnings]


def updated(session, rows):
    return [session.update(*row) for row in rows]


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
    assert len(ruptures(estimates)) == 1
    assert [layer.thickness_m for layer in session.layers] == [
        pytest.approx(28.2e-3, abs=1e-3)
    ]
    assert estimates[-1].used_for_identification
    assert (session.rejected, session.lag_s) == (
        *(0, pytest.approx(1.0 / DEFAULT.gain_per_s)),
    )


@pytest.mark.slow
def test_depth_and_speed_are_those_of_the_measured_joints(whole):
    _, estimates = whole
    q_rad = RUN.signals.q_rad
    start = pose_of(RUN.robot, q_rad[TARE])
    axis = start.rotation[:, 2]
    for k in range(TARE, TARE + 4000, 50):
        pose = pose_of(RUN.robot, q_rad[k])
        along = pose.rotation[:, 2] @ jacobian_of(RUN.robot, q_rad[k])[:3]

        # The zero is noisy by a sample's worth.
        assert estimates[k].depth_m == pytest.approx(
            axis @ (pose.translation - start.translation), abs=2e-5
        )
        assert estimates[k].speed_m_s == pytest.approx(
            along @ RUN.signals.dq_rad_s[k], abs=1e-12
        )


@pytest.mark.slow
def test_without_velocities_depth_and_speed_are_true_and_10_ms_late():
    end = TARE + 4000
    session = InsertionSession(RUN.robot)
    estimates = insert(session, end, with_velocity=False)[TARE + 210 :]
    depth_m, speed_m_s = np.array([(e.depth_m, e.speed_m_s) for e in estimates]).T
    true_m = RUN.truth.depth_m[TARE + 200 : end - 9] - RUN.truth.depth_m[TARE - 10]
    true_m_s = RUN.truth.speed_m_s[TARE + 200 : end - 9]

    np.testing.assert_allclose(depth_m, true_m, atol=2e-5)
    np.testing.assert_allclose(speed_m_s, true_m_s, atol=1e-3)


@pytest.mark.slow
def test_only_valid_tared_forces_are_used():
    session = InsertionSession(RUN.robot)
    rows = [row for _, row in samples(RUN)]
    before = updated(session, rows[:TARE])
    session.tare()
    updated(session, rows[TARE : TARE + 100])
    lost = [(q, dq, tau * np.nan, dt_s) for q, dq, tau, dt_s in rows[TARE + 100 :]]
    rejected = updated(session, lost[:400])[-1]
    after = updated(session, rows[TARE + 500 : TARE + 1500])
    back = next(k for k, e in enumerate(after) if e.used_for_identification)
    used = after[back]
    unused_s = rejected.identification.time_s - before[-1].time_s

    assert {
        (e.status, e.used_for_identification, e.identification.time_s) for e in before
    } == {(s, False, 0.0) for s in (Status.INITIALIZING, Status.NOT_TARED)}
    assert (rejected.status, rejected.used_for_identification, unused_s) == (
        *(Status.REJECTED, False, pytest.approx(0.1)),
    )
    assert after[0].status is Status.INITIALIZING
    # The time of what was not used has passed, and the identifier reports the gap.
    assert (used.identification.status, used.identification.time_s, used.time_s) == (
        *(SampleStatus.TIME_GAP, used.time_s),
        pytest.approx((TARE + 500 + back) * 1e-3, abs=2e-3),
    )


@pytest.mark.slow
def test_refused_tares_and_new_insertions_keep_the_tare():
    session, (first, second) = resumed_after(TARE + 12_000, 2)
    deep = session.update(*first)

    with pytest.raises(TareError, match="start_tare_recording"):
        session.tare()
    assert session.snapshot().course.travel.depth_m == deep.depth_m > 5e-3

    session.begin_insertion()
    again = session.update(*second)
    found = again.identification

    assert (session.tared, session.layers) == (True, ())
    assert (again.depth_m, found.layer, found.tip_force_N) == (
        pytest.approx(0.0, abs=1e-4),
        1,  # the tip is in its own channel
        pytest.approx(deep.identification.tip_force_N, abs=0.05),
    )

    session.start_tare_recording()

    assert not session.tared

    session.reset()
    with pytest.raises(TareError):
        session.tare()


@pytest.mark.slow
@pytest.mark.parametrize("with_velocity", [True, False])
def test_external_torque_gives_force_and_speed(with_velocity):
    truth = RUN.truth
    end = TARE + 5000
    noise = 0.01 * np.random.default_rng(0).normal(size=truth.external_torque_Nm.shape)
    torque = truth.external_torque_Nm + 0.3 + noise
    session = InsertionSession(RUN.robot)
    for k, (q, dq, _, dt_s) in islice(
        samples(RUN, with_velocity=with_velocity), end + 1
    ):
        if k == TARE:
            session.tare()
        estimate = session.update_external_torque(q, dq, torque[k], dt_s)

    assert session.rejected == 0
    assert (estimate.wrench.axial, estimate.speed_m_s) == (
        pytest.approx(truth.axial_N[end], abs=0.1),
        pytest.approx(truth.speed_m_s[end], abs=3e-4),
    )


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


def test_the_identifier_gets_depths_that_are_as_late_as_the_force():
    session, rows = resumed_after(TARE, 600)
    last = updated(session, rows)[-1]
    travel = session.snapshot().course.travel
    late_m = travel.depth_m - travel.delayed_depth_m

    assert travel.depth_m == last.depth_m
    assert last.speed_m_s > 2e-3
    # The depth is noisy.
    assert late_m == pytest.approx(session.lag_s * last.speed_m_s, rel=0.3)


@pytest.mark.parametrize("speed_lag_s", [-1.0, np.inf])
def test_a_lag_that_cannot_be_is_refused(speed_lag_s):
    with pytest.raises(InsertionError, match="speed_lag_s"):
        InsertionSession(RUN.robot, speed_lag_s=speed_lag_s)


@pytest.mark.parametrize("dt_s", [-10.0, 1.8e9, np.nan, None])
def test_a_clock_that_was_set_takes_no_time(dt_s):
    session, rows = resumed_after(TARE, 52)
    earlier = updated(session, rows[:50])[-1]
    set_back = session.update(*rows[50][:3], dt_s)
    after = session.update(*rows[51])
    passed_s = after.identification.time_s - earlier.identification.time_s

    assert set_back.status is Status.REJECTED
    assert [e.used_for_identification for e in (earlier, set_back, after)] == [
        *(True, False, True),
    ]
    assert passed_s == pytest.approx(rows[51][3])


def test_an_angle_that_steps_by_a_turn_is_an_event():
    session, rows = resumed_after(TARE, 60)
    turn_rad = 2.0 * np.pi * np.eye(7)[2]
    steps = [q + turn_rad * (k >= 50) for k, (q, *_) in enumerate(rows)]
    found = updated(
        session, [(q, *row[1:]) for q, row in zip(steps, rows, strict=True)]
    )
    events = {k: [one.kind for one in session_events(e)] for k, e in enumerate(found)}

    assert {k: kinds for k, kinds in events.items() if kinds} == {50: ["turn"]}
    assert found[-1].used_for_identification


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

    last = estimates[-1]

    assert all(e.used_for_identification for e in estimates[:100])
    assert last.wrench.axial > 1.0
    assert (last.status, last.identification.status, last.used_for_identification) == (
        *(Status.OK, SampleStatus.FORCE_RANGE, False),
    )


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
    estimates = updated(session, pushed(rows, (1.0, 0.0, 0.0), first, 400))
    axial_N, alone_N = (
        np.array([estimate.wrench.axial for estimate in found])
        for found in (estimates, updated(still, rows))
    )
    wrench = estimates[-1].wrench
    sideways = np.cross([1.0, 0.0, 0.0], session._sensor.kinematics.axis_in_base)

    assert ruptures(estimates) == []
    assert all(e.used_for_identification for e in estimates)
    assert np.abs(axial_N - alone_N).max() < 0.05
    assert wrench.lateral == pytest.approx(np.linalg.norm(sideways), abs=0.1)
    assert wrench.lateral_std < 0.05


@pytest.mark.parametrize("first", [100, 112])
def test_a_push_on_the_elbow_raises_no_rupture(first):
    session, rows = resumed_after(INSIDE, 400)
    rows = pushed(rows, (0.0, 2.0, 0.0), first, 400, joint=4)
    estimates = updated(session, rows)
    flagged = warned(estimates, SensorWarning.MODEL_MISMATCH)

    assert ruptures(estimates) == []
    assert not any(e.identification.provisional for e in estimates)
    assert first < flagged[0] < first + 100
    assert "do not fit" in estimates[flagged[0]].wrench.message
    assert not any(estimates[k].used_for_identification for k in flagged)
    assert {e.status for e in estimates} == {Status.OK}


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
    alarm = getattr(estimate.identification, kind)

    assert (alarm, estimate.used_for_identification) == (None, False)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "seconds"), [(1_000, (0.9, 1.8)), (4_500, (1.9, 2.4))]
)
def test_a_small_push_shows_in_torque_changes(count, seconds):
    session, rows = resumed_after(INSIDE, 5_000)
    estimates = updated(session, pushed(rows, (0.0, 0.5, 0.0), 500, count, joint=4))
    flagged = warned(estimates, SensorWarning.ARM_PUSHED)
    # A push that lasts is a torque that has jumped.
    lasts = warned(estimates, SensorWarning.TORQUE_JUMP)

    assert 500 < flagged[0] < 620
    assert seconds[0] < 1e-3 * len(flagged) < seconds[1]
    assert warned(estimates, SensorWarning.MODEL_MISMATCH) == ruptures(estimates) == []
    assert estimates[-1].used_for_identification
    assert len(lasts) > 600
    assert (lasts[-1] == len(rows) - 1) == (count == 4_500)


@pytest.mark.slow
def test_a_push_rewinds_to_before_it_began():
    session, rows = resumed_after(INSIDE, 900)
    still, _ = resumed_after(INSIDE, 900)
    history = []
    for row in rows:
        still.update(*row)
        history.append(still.snapshot().identifier.travel)
    k = next(
        k
        for k, row in enumerate(pushed(rows, (0.0, 2.0, 0.0), 700, 200, joint=4))
        if SensorWarning.MODEL_MISMATCH in session.update(*row).warnings
    )
    rewound = session.snapshot()
    equal_to = [
        n for n, one in enumerate(history) if same(one, rewound.identifier.travel)
    ]

    assert k - 520 < equal_to[-1] <= k - 250  # as if nothing had come since
    assert rewound.unused_s == pytest.approx(1e-3 * (k - equal_to[-1]), abs=2e-3)


def test_a_push_beginning_in_unused_ticks_rewinds_once():
    session, rows = resumed_after(INSIDE, 900)
    updated(session, rows[:700])
    used = session.snapshot()
    wrench = session.update(*rows[700]).wrench._replace(status=Status.OK)
    for warning in (SensorWarning.VELOCITY, *[SensorWarning.MODEL_MISMATCH] * 3):
        session._follow_needle(wrench._replace(warnings=warning))
    rewound = session.snapshot()

    assert same(rewound.identifier, used.checkpoints[0].identifier)
    assert rewound.unused_s == pytest.approx(
        rewound.course.time_s - used.checkpoints[0].time_s
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("first", "count", "late"),
    # The last two: within a push, so only after it.
    [(-5_700, 200, 10), (-100, 300, 900), (-50, 1_500, 1_850), (-400, 1_200, 1_200)],
)
def test_a_rupture_around_an_elbow_push_is_found(first, count, late):
    undisturbed, rows = resumed_after(INSIDE, 9_000)
    session, _ = resumed_after(INSIDE, 9_000)
    (undisturbed_alarm,) = ruptures(updated(undisturbed, rows))
    start = undisturbed_alarm + first
    estimates = updated(session, pushed(rows, (0.0, 2.0, 0.0), start, count, joint=4))
    (alarm,) = ruptures(estimates)
    frictions_N = [one.layers[0].friction_N for one in (session, undisturbed)]

    # Blocks of the identifier begin elsewhere after the pause.
    assert -10 < alarm - undisturbed_alarm < late
    assert {e.identification.retracted for e in estimates} == {None}
    assert abs(frictions_N[0] / frictions_N[1] - 1.0) < 0.15


def jumped(rows, joint, step_Nm, end):
    """The rows, of which the 501st to the end have another torque at a joint."""
    return [
        (q, dq, tau + step_Nm * np.eye(7)[joint] * (500 <= k < end), dt_s)
        for k, (q, dq, tau, dt_s) in enumerate(rows)
    ]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "step_Nm", "end"),
    # The first three as a hand that leans on the elbow for a while and lets go.
    [(1, 0.3, 2_000), (3, -0.3, 2_000), (5, 0.3, 2_000), (3, 0.3, 9_000)],
)
def test_a_torque_that_jumps_makes_no_rupture_and_hides_none(joint, step_Nm, end):
    session, rows = resumed_after(INSIDE, 9_000)
    estimates = updated(session, jumped(rows, joint, step_Nm, end))
    (alarm,) = ruptures(estimates)
    onset = int(np.searchsorted(RUN.signals.t_s, RUN.truth.ruptures[0].onset_s))

    assert 500 < warned(estimates, SensorWarning.TORQUE_JUMP)[0] <= 1_000
    assert onset < alarm + INSIDE + 1 < onset + 300
    assert {e.identification.retracted for e in estimates} == {None}
    assert sum(not e.used_for_identification for e in estimates) < 2_700


@pytest.mark.slow
def test_a_session_restored_during_a_jump_knows_of_it():
    session, rows = resumed_after(INSIDE, 9_000)
    rows = jumped(rows, 3, -0.3, 3_500)
    updated(session, rows[:3_400])
    snapshot = session.snapshot()
    restored, _ = resumed_after(INSIDE, 1)
    restored.restore(snapshot)
    (alarm,) = ruptures(updated(restored, rows[3_400:]))

    assert snapshot.air.jump_std_N > 0.05
    assert 1_500 < alarm < 3_500


@pytest.mark.slow
def test_a_jump_takes_back_a_rupture_of_the_0_6_s_before_it_was_noticed():
    """It may have been that jump: a torque sensor's is noticed within half a second."""
    session, rows = resumed_after(INSIDE, 9_000)
    samples_left = iter(rows)
    for row in samples_left:
        if session.update(*row).identification.rupture:
            break
    retracted = []
    for later in (449, 200):  # 0.45 and 0.65 s after the alarm
        updated(session, islice(samples_left, later))
        after = list(islice(copy(samples_left), 100))
        snapshot = session.snapshot()
        air = snapshot.air._replace(jumps=snapshot.air.jumps + 1, jump_std_N=0.3)
        other, _ = resumed_after(INSIDE, 1)
        other.restore(snapshot._replace(air=air))
        found = updated(other, after)
        retracted.append(any(e.identification.retracted for e in found))

    assert retracted == [True, False]
