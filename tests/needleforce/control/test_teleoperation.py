"""Teleoperation of one-dimensional plants: passive at the hand, faithful in position
and force."""

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundtruth import DelayLine, HapticMaster, Operator, random_operator
from needleforce.control import HandleReport, HandleWatch, SettingError
from needleforce.control.passivity import HandPort, NeedlePort, Port
from residual import Status
from tests.needleforce.control.haptic import (
    DT,
    Needle,
    answer,
    estimate,
    handle,
    push,
    teleoperate,
    track,
)

SURFACE_M = 5e-3
PLANTS = {
    "spring": lambda x, v: 500.0 * max(0.0, x - SURFACE_M),
    "viscous": lambda x, v: 200.0 * v,
    "wall": lambda x, v: 20e3 * max(0.0, x - SURFACE_M),
}
MIN_ENERGY_J = {"spring": -0.1e-3, "viscous": -0.1e-3, "wall": -5e-3}


def lines(delay_s, rng):
    return [DelayLine(delay_s, min(5e-3, delay_s), rng) for _ in range(2)]


def drive(plant, tele, master, seconds, rng, clutch=True, is_sent=lambda: True):
    """Drive a needle whose force is late by the observer's 14 ms; return its depth."""
    master.clutch = clutch
    late_N = 0.0

    def force_at(depth_m, speed_m_s):
        nonlocal late_N
        late_N += (plant(depth_m, speed_m_s) - late_N) / 15.0
        return late_N + 0.02 * rng.standard_normal()

    reads = (master.read() for _ in range(round(seconds / DT)))
    samples = (sample if is_sent() else None for sample in reads)
    return track(tele, samples, force_at, device=master)[0][-1]


def advancing(speed_m_s, travel_m):
    return lambda t: (0.0, 0.0, min(max(t - 0.2, 0.0) * speed_m_s, travel_m))


@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("seed", range(2))
def test_hand_gets_no_more_energy_than_it_gave(plant, delay_s, seed):
    rng = np.random.default_rng([seed, *plant.encode(), round(1e3 * delay_s)])
    scale = float(rng.choice([0.1, 0.2, 0.4, 1.0]))
    master = HapticMaster(random_operator(advancing(8e-3 / scale, 12e-3 / scale), rng))
    tele = teleoperate(motion_scale=scale, shown="raw", lines=lines(delay_s, rng))
    drive(PLANTS[plant], tele, master, 3.0, rng)

    assert master.least_energy_J >= MIN_ENERGY_J[plant]


def test_without_passivity_a_delayed_wall_gives_energy_away():
    """The plants above are hard ones: the same loop without the controllers is not
    passive."""
    rng = np.random.default_rng(5)
    master = HapticMaster(Operator(wish_m=advancing(20e-3, 30e-3)))
    tele = teleoperate(lines=lines(0.05, rng), shown="raw")
    tele.device.port.update = lambda wanted, *_, **__: wanted
    tele.needle.port.update = lambda wanted, *_, **__: wanted
    drive(PLANTS["wall"], tele, master, 3.0, rng)

    assert master.least_energy_J < -5e-3


@pytest.mark.parametrize("every", [1, 2, 5])
def test_energy_is_observed_where_the_encoder_is(every):
    """A device may send less often than the loop runs."""
    rng = np.random.default_rng(2)
    master = HapticMaster(Operator(wish_m=advancing(20e-3, 30e-3)), position_step_m=0.0)
    tele = teleoperate(shown="raw")
    sent = iter(np.arange(2000) % every == 0)
    depth_m = drive(PLANTS["spring"], tele, master, 2.0, rng, is_sent=sent.__next__)

    error_J = 1e-9 if every == 1 else 1e-4
    assert tele.device.port.net_J == pytest.approx(master.port_energy_J, abs=error_J)
    assert master.least_energy_J >= -0.1e-3
    assert depth_m == pytest.approx(0.4 * master.position_m[2], abs=3e-4)


@pytest.mark.parametrize("delay_s", [0.0, 0.05])
@pytest.mark.parametrize(("chance", "least", "most"), [(0.3, 1, 4), (0.01, 10, 18)])
@pytest.mark.parametrize("seed", range(2))
def test_gaps_between_samples_give_no_energy_away(chance, least, most, delay_s, seed):
    rng = np.random.default_rng([seed, least])
    master = HapticMaster(random_operator(advancing(20e-3, 30e-3), rng))
    sent = np.ones(2000, bool)
    for start in np.flatnonzero(rng.random(2000) < chance):
        sent[start : start + rng.integers(least, most + 1)] = False
    tele = teleoperate(lines=lines(delay_s, rng), shown="raw")
    drive(PLANTS["wall"], tele, master, 2.0, rng, is_sent=iter(sent).__next__)

    assert master.least_energy_J >= MIN_ENERGY_J["wall"]


@given(st.lists(st.tuples(st.floats(-30.0, 30.0), st.floats(-1.0, 1.0)), max_size=100))
@settings(deadline=None)
def test_a_free_device_gains_no_energy(steps):
    """Whatever force is wanted and however the handle is hit between the samples."""
    port = HandPort()
    position_m = 0.0
    for wanted_N, speed_m_s in steps:
        force_N = port.update(wanted_N, position_m, speed_m_s, 1e9, dt_s=DT, ahead_s=DT)
        position_m += speed_m_s * DT - force_N / 0.25 * DT**2 / 2.0
        port.update(0.0, position_m, 0.0, 1e9, dt_s=DT, ahead_s=DT)
        assert abs(force_N) <= 5.0
        assert port.net_J >= -1e-12


@pytest.mark.parametrize(("travel_m", "given_m"), [(0.01, 0.0), (-0.01, 0.01)])
def test_a_force_that_is_let_go_counts_what_it_gives_only(travel_m, given_m):
    port = HandPort()
    forces_N = [
        port.update(1.0, 1e-4 * k, 0.1, 1.0, dt_s=DT, ahead_s=DT) for k in range(100)
    ]
    before_J = port.net_J
    port.release(travel_m)

    assert forces_N[-1] == pytest.approx(1.0)
    assert before_J - port.net_J == pytest.approx(given_m)


def test_unused_allowance_is_not_saved_up():
    port = Port(1e-3, 2e-3)

    assert [port.update_budget_J(0.0, DT) for _ in range(60_000)][-1] == 1e-3

    port.observe(-1.0, 1.5e-3)  # more than may leave has left
    later_J = [port.update_budget_J(0.0, DT) for _ in range(2001)]

    assert later_J[0] == pytest.approx(-0.5e-3 + 2e-6)
    assert later_J[-1] == pytest.approx(1e-3)
    assert port.update_budget_J(0.1, DT) == pytest.approx(0.1 - 1.5e-3 + 1e-3)


def test_without_a_hand_the_allowance_limits_pressing():
    """Without energy of a hand the needle presses no further than its allowance."""
    port = NeedlePort(1e-3, 0.0)
    depth = 0.0
    speed = 0.0
    for _ in range(2000):
        speed = port.update(0.02, 20e3 * depth, speed, 0.0, DT)
        depth += speed * DT

    assert 10e3 * depth**2 < 3e-3  # half k x^2, where 40 mm were asked for


@pytest.mark.parametrize("scale", [0.1, 0.4, 1.0])
def test_needle_follows_the_hand_unless_declutched(scale):
    """The needle follows the scaled hand, and stands while the clutch is open."""
    rng = np.random.default_rng(3)
    master = HapticMaster(Operator(wish_m=advancing(4e-3 / scale, 6e-3 / scale)))
    tele = teleoperate(motion_scale=scale, lines=lines(0.01, rng))
    depth_m = drive(PLANTS["spring"], tele, master, 3.0, rng)

    assert depth_m == pytest.approx(scale * master.position_m[2], abs=1e-4)

    master._operator = Operator(
        wish_m=lambda t: (0.0, 0.0, -0.05)
    )  # the hand goes elsewhere
    tele.needle.start_m -= depth_m  # the plant of `drive` starts anew at zero
    stands_m = drive(lambda x, v: 0.0, tele, master, 1.0, rng, clutch=False)

    assert stands_m == pytest.approx(0.0, abs=1e-4)


def quick_hand(t_s, travel_m, seconds):
    """Return position and speed of a hand that reaches out smoothly, and stands."""
    part = min(max(t_s / seconds, 0.0), 1.0)
    position_m = travel_m * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    return position_m, travel_m / seconds * 30.0 * part**2 * (1.0 - part) ** 2


def hand_that_stops_dead(t_s, travel_m, seconds):
    """Return position and speed of a hand that hits something."""
    speed_m_s = travel_m / seconds
    return speed_m_s * min(t_s, seconds), speed_m_s * (t_s < seconds)


@pytest.mark.parametrize("hand", [quick_hand, hand_that_stops_dead])
@pytest.mark.parametrize("stiffness_N_per_m", [0.0, 300.0])
@pytest.mark.parametrize("speed_limit_m_s", [0.005, 0.02, 0.1])
@pytest.mark.parametrize(
    ("scale", "travel_m", "seconds"), [(0.4, 0.06, 0.3), (1.0, 0.1, 0.5)]
)
def test_the_needle_stands_when_a_quick_hand_stands(
    travel_m, seconds, scale, speed_limit_m_s, stiffness_N_per_m, hand
):
    """Within a millimetre, an arm that is 5 ms late."""
    tele = teleoperate(motion_scale=scale, speed_limit_m_s=speed_limit_m_s)
    times_s = DT * np.arange(round((seconds + 0.7) / DT))
    samples = [handle(*hand(t_s, travel_m, seconds)) for t_s in times_s]
    spring_N = lambda depth_m, speed_m_s: (  # noqa: E731
        stiffness_N_per_m * max(depth_m - SURFACE_M, 0.0)
    )
    depths_m, _, forces_N, *_ = track(tele, samples, spring_N)
    after_m = depths_m[round(seconds / DT) :]
    moving = np.flatnonzero(np.abs(np.diff(after_m)) > 2e-3 * DT)

    assert np.abs(after_m - after_m[0]).max() <= 1e-3
    assert moving.size == 0 or DT * moving[-1] <= 0.15
    assert np.abs(forces_N).max() <= 5.0
    assert np.diff(np.abs(forces_N)).max() <= 0.5 + 1e-9


@pytest.mark.parametrize(
    ("hand_m_s", "clutch", "felt_N"),
    [(0.045, True, 0.0), (0.1, True, -1.0), (-0.1, True, 1.0), (0.1, False, 0.0)],
)
def test_a_hand_feels_that_the_needle_cannot_follow(hand_m_s, clutch, felt_N):
    """At 20 mm/s and a scale of 0.4 the needle follows a hand of 50 mm/s."""
    samples = [handle(hand_m_s * k * DT, hand_m_s, clutch) for k in range(2000)]

    assert track(teleoperate(), samples)[2][-1] == pytest.approx(felt_N, abs=0.05)


def test_after_a_reset_force_and_motion_are_zero():
    """Neither goes on before the device has sent."""
    tele = teleoperate()
    samples = [handle(4e-5 * k, 0.04) for k in range(500)]
    _, speeds_m_s, forces_N, *_ = track(tele, samples, push(2.0))

    assert speeds_m_s[-1] > 0.01
    assert abs(forces_N[-1]) > 0.5

    tele.reset()
    for dt_s in (np.nan, DT):
        move = answer(tele, None, estimate(2.0), dt_s)
        assert (move.speed_m_s, *move.force_N) == (0.0, 0.0, 0.0, 0.0)


@pytest.mark.parametrize("is_reset", [False, True])
def test_after_a_reset_the_needle_does_not_make_up_for_the_hand(is_reset):
    tele = teleoperate()
    answer(tele, handle(), estimate(depth_m=0.05))
    tele.watch = HandleWatch()
    if is_reset:
        tele.reset()
    move = answer(tele, handle(0.004), estimate(depth_m=0.0))

    assert (move.speed_m_s == 0.0) == is_reset


def shown_along(tele, ticks, axial_N, **how):
    """Return what is shown over some ticks of the same estimate [N]."""
    return track(tele, [None] * ticks, push(axial_N), **how)[3]


def test_noise_is_hidden_ruptures_show_at_once():
    tele = teleoperate()
    noise_N = np.random.default_rng(4).normal(0.0, 0.1, 2000)
    shown_N = np.concatenate([shown_along(tele, 1, 1.0 + n) for n in noise_N])

    assert np.std(shown_N[1000:]) < 0.02
    assert np.mean(shown_N[1000:]) == pytest.approx(1.0, abs=0.02)
    assert shown_along(tele, 1, 0.5) == pytest.approx(0.8)  # never further than 0.3 N

    shown_along(tele, 1, 0.5, rupture=object())

    assert shown_along(tele, 60, 0.5)[-1] == pytest.approx(0.5, abs=0.02)

    shown_along(tele, 300, 0.5)  # the rupture is over

    assert shown_along(tele, 1, 0.6) < 0.51


@pytest.mark.parametrize(
    ("stiffness", "late_N"), [(0.0, -0.2), (250.0, 0.0), (1e9, 0.3)]
)
def test_known_stiffness_removes_the_lag_of_force(stiffness, late_N):
    """A membrane of 250 N/m at 4 mm/s; a stiffness out of reason moves it by 0.3 N
    at most."""
    tele = teleoperate()
    speed = 4e-3
    for k in range(2000):
        force = 250.0 * speed * k * DT
        answer(tele, None, estimate(force, speed_m_s=speed, stiffness=stiffness))

    assert tele.shown_N - force == pytest.approx(late_N, abs=0.01)

    how = {"tip_N": 0.0, "speed_m_s": -speed, "stiffness": stiffness}
    # Nothing springs back.
    assert shown_along(tele, 2000, -1.0, **how)[-1] == pytest.approx(0.0, abs=0.01)


def test_motion_and_force_end_without_signals():
    """The needle stops without the device, and the force fades without estimates."""
    tele = teleoperate(lines=None)
    needle = Needle()
    force_at = push(1.0)
    samples = [handle(8e-6 * k, 8e-3) for k in range(1000)]
    _, speeds_m_s, forces_N, *_ = track(tele, samples, force_at, needle)

    assert speeds_m_s[-1] == pytest.approx(3.2e-3, rel=0.02)
    assert forces_N[-1] == pytest.approx(-1.0, abs=0.02)

    _, speeds_m_s, forces_N, *_ = track(tele, [None] * 200, force_at, needle)

    assert speeds_m_s[-1] == pytest.approx(0.0, abs=1e-4)
    assert forces_N[-1] == 0.0

    samples = [handle(8e-3, 8e-3)] * 1000
    lost_N = track(tele, samples, force_at, needle, status=Status.REJECTED)[2]

    # the damping of a handle that is said to move is left
    assert abs(lost_N[-1]) < 0.2


@pytest.mark.parametrize(
    ("axial_N", "tip_N", "shown", "shown_N"),
    [
        (1.0, -3.0, "raw", 1.0),
        (1.0, 0.4, "tip", 0.4),
        (1.0, 3.0, "tip", 1.0),
        (1.0, -3.0, "tip", 0.0),
        (-1.0, 3.0, "tip", 0.0),
        (-1.0, -3.0, "tip", -1.0),
        (1.0, 0.4, "enhanced", 0.7),
        (1.0, 3.0, "enhanced", 1.0),
        (1.0, -3.0, "enhanced", 0.0),
    ],
)
def test_shown_force_lies_within_the_measured_one(axial_N, tip_N, shown, shown_N):
    tele = teleoperate(shown=shown)
    felt_N = shown_along(tele, 1200, axial_N, tip_N=tip_N)[-1]

    assert felt_N == pytest.approx(shown_N, abs=0.01)


def damping_Ns_m(tele, hz):
    """Most force per speed that a hand feels in free air, oscillating for half a
    second."""
    speeds_m_s = 0.02 * np.sin(2.0 * np.pi * hz * DT * np.arange(500))
    samples = map(handle, DT * np.cumsum(speeds_m_s), speeds_m_s)

    return np.abs(track(tele, samples)[2]).max() / 0.02


@pytest.mark.parametrize(
    ("hz", "least", "most"), [(1.0, 10.0, 50.0), (5.0, 60.0, 150.0)]
)
def test_a_swinging_hand_is_damped_more(hz, least, most):
    """A hand that swings is damped more than one that springs forward."""
    assert least < damping_Ns_m(teleoperate(motion_scale=0.2), hz) < most


def test_late_force_is_damped_more():
    usual, sooner, late = (
        damping_Ns_m(teleoperate(motion_scale=1.0, force_lag_s=lag_s), 1.0)
        for lag_s in (0.015, 5e-3, 1.0 / 15.0)
    )

    assert sooner == usual
    assert late > 1.3 * usual


@pytest.mark.parametrize("dt_s", [np.nan, np.inf, 0.0, -1e-3, -0.2, None, "x"])
def test_without_time_passing_the_needle_stands(dt_s):
    """With a time step that does not advance the needle stands, the force stays."""
    tele = teleoperate()
    samples = [handle(5e-5 * k, 0.05) for k in range(50)]
    _, speeds_m_s, forces_N, *_ = track(tele, samples, push(2.0))
    command = answer(tele, handle(2.5e-3, 0.05), estimate(2.0), dt_s)

    assert speeds_m_s[-1] > 0.0
    assert command.speed_m_s == 0.0
    assert command.force_N[2] == pytest.approx(forces_N[-1])


def test_a_cut_line_stops_the_needle():
    """It follows a hand of 10 mm/s for 0.3 s, and stands 0.1 s after the last news."""
    line = DelayLine()
    tele = teleoperate(motion_scale=1.0, lines=[line, DelayLine()])
    needle = Needle()
    samples = [handle(1e-5 * k, 0.01) for k in range(1000)]
    followed_m_s = track(tele, samples[:300], needle=needle)[1]
    last = tele.device.update(HandleReport(None), None, DT)
    line.exchange = lambda packet, dt_s: last
    cut_m_s = track(tele, samples[300:], needle=needle)[1]

    assert followed_m_s[-1] == pytest.approx(0.01, rel=0.1)
    assert cut_m_s[80] > 1e-3
    assert not cut_m_s[110:].any()


@pytest.mark.parametrize(
    "wrong",
    [
        {"motion_scale": 0.05},
        {"motion_scale": 1.1},
        {"motion_scale": None},
        {"motion_scale": "0.4"},
        {"force_scale": -1.0},
        {"force_lag_s": 0.0},
        {"axis": (0.0, 0.0, 0.0)},
        {"axis": "abc"},
        {"shown": "all"},
        {"max_force_N": np.nan},
        {"speed_limit_m_s": 0.0},
    ],
)
def test_settings_that_cannot_work_are_refused(wrong):
    with pytest.raises(SettingError, match=next(iter(wrong))):
        teleoperate(**wrong)


def test_line_keeps_the_order_and_the_newest_counts():
    late = DelayLine(0.02, 0.015, np.random.default_rng(0))
    received = [late.exchange(sent, DT) for sent in range(500)]
    arrived = np.array(received[40:])
    delays = np.arange(40, 500) - arrived

    assert (np.diff(arrived) >= 0).all()
    assert 4 <= delays.min() < delays.max() <= 36
    assert DelayLine().exchange("now", DT) == "now"
