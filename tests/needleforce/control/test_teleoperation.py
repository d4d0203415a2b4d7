"""Teleoperation of one-dimensional plants: passive at the hand, faithful in position
and force."""

from collections import deque
from types import SimpleNamespace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundtruth.errors import PlantError
from groundtruth.rig_line import DelayLine
from groundtruth.rig_operator import HapticMaster, Operator, random_operator
from needleforce.control import SettingError
from needleforce.control.passivity import HandPort, NeedlePort, Port, passive_fraction
from needleforce.control.teleoperation import Teleoperation, shown_force
from residual import Status

DT = 1e-3
SURFACE_M = 5e-3
PLANTS = {
    "spring": lambda x, v: 500.0 * max(0.0, x - SURFACE_M),
    "viscous": lambda x, v: 200.0 * v,
    "wall": lambda x, v: 20e3 * max(0.0, x - SURFACE_M),
}
MIN_ENERGY_J = {"spring": -0.1e-3, "viscous": -0.1e-3, "wall": -5e-3}


def estimate(
    axial_N=0.0,
    tip_N=None,
    depth_m=0.0,
    speed_m_s=0.0,
    status=Status.OK,
    rupture=None,
    stiffness=0.0,
):
    tip_N = axial_N if tip_N is None else tip_N
    identification = SimpleNamespace(
        tip_force_N=tip_N,
        enhanced_force_N=0.5 * (tip_N + axial_N),
        rupture=rupture,
        provisional=None,
        stiffness_N_per_m=stiffness,
    )
    return SimpleNamespace(
        wrench=SimpleNamespace(axial_unsmoothed=axial_N),
        identification=identification,
        depth_m=depth_m,
        speed_m_s=speed_m_s,
        status=status,
    )


def line(delay_s, rng):
    return DelayLine(delay_s, min(5e-3, delay_s), rng)


def drive(plant, tele, master, seconds, rng, clutch=lambda t: True):
    """A needle that follows its command within 5 ms; force late by the observer's 14
    ms."""
    depth = speed = late_N = 0.0
    for k in range(round(seconds / DT)):
        master.clutch = clutch(k * DT)
        late_N += (plant(depth, speed) - late_N) / 15.0
        session_estimate = estimate(
            late_N + 0.02 * rng.standard_normal(), None, depth, speed
        )
        command = tele.update(master.read(), session_estimate, DT)
        master.render(command.force_N)
        speed += (command.speed_m_s - speed) / 6.0
        depth += speed * DT

    return depth


def advancing(speed_m_s, travel_m):
    return lambda t: (0.0, 0.0, min(max(t - 0.2, 0.0) * speed_m_s, travel_m))


@pytest.mark.parametrize("delay_s", [0.0, 0.01, 0.05])
@pytest.mark.parametrize("plant", PLANTS)
@pytest.mark.parametrize("seed", range(3))
def test_hand_gets_no_more_energy_than_it_gave(plant, delay_s, seed):
    rng = np.random.default_rng([seed, *plant.encode(), round(1e3 * delay_s)])
    scale = float(rng.choice([0.1, 0.2, 0.4, 1.0]))
    master = HapticMaster(random_operator(advancing(8e-3 / scale, 12e-3 / scale), rng))
    lines = line(delay_s, rng), line(delay_s, rng)
    tele = Teleoperation(motion_scale=scale, shown="raw", lines=lines)
    drive(PLANTS[plant], tele, master, 3.0, rng)

    assert master.least_energy_J >= MIN_ENERGY_J[plant]


def test_energy_is_observed_exactly_where_the_encoder_is():
    rng = np.random.default_rng(1)
    master = HapticMaster(Operator(wish_m=advancing(20e-3, 30e-3)), position_step_m=0.0)
    tele = Teleoperation(shown="raw")
    drive(PLANTS["spring"], tele, master, 2.0, rng)

    assert tele.device.port.net_J == pytest.approx(master.port_energy_J, rel=1e-9)


def test_without_passivity_a_delayed_wall_gives_energy_away():
    """The plants above are hard ones: the same loop without the controllers is not
    passive."""
    rng = np.random.default_rng(5)
    master = HapticMaster(Operator(wish_m=advancing(20e-3, 30e-3)))
    tele = Teleoperation(lines=(line(0.05, rng), line(0.05, rng)), shown="raw")
    tele.device.port.update = lambda wanted, *_, **__: wanted
    tele.needle.port.update = lambda wanted, *_, **__: wanted
    drive(PLANTS["wall"], tele, master, 3.0, rng)

    assert master.least_energy_J < -5e-3


@pytest.mark.parametrize("scale", [0.1, 0.4, 1.0])
def test_needle_follows_the_hand_unless_declutched(scale):
    """The needle follows the scaled hand, and stands while the clutch is open."""
    rng = np.random.default_rng(3)
    master = HapticMaster(Operator(wish_m=advancing(4e-3 / scale, 6e-3 / scale)))
    tele = Teleoperation(motion_scale=scale, lines=(line(0.01, rng), line(0.01, rng)))
    depth = drive(PLANTS["spring"], tele, master, 3.0, rng)

    assert depth == pytest.approx(scale * master.position_m[2], abs=1e-4)

    master.clutch = False
    master._operator = Operator(
        wish_m=lambda t: (0.0, 0.0, -0.05)
    )  # the hand goes elsewhere
    tele.needle.start_m -= depth  # the plant of `drive` starts anew at zero

    assert drive(
        lambda x, v: 0.0, tele, master, 1.0, rng, lambda t: False
    ) == pytest.approx(0.0, abs=1e-4)


def test_a_lagging_needle_stands_when_declutched():
    """A needle behind its hand stands once the clutch is open."""
    tele = Teleoperation(motion_scale=1.0)
    depth = 0.0
    speed = 0.0
    for k in range(1500):
        place = (0.0, 0.0, 0.15 * min(k * DT, 0.5))  # 75 mm in half a second
        rate = (0.0, 0.0, 0.15 * (k < 500))
        handle = SimpleNamespace(position_m=place, velocity_m_s=rate, clutch=k < 500)
        speed = tele.update(handle, estimate(1.0, None, depth, speed), DT).speed_m_s
        depth += speed * DT

    assert depth == pytest.approx(0.01, abs=1e-4)  # at 20 mm/s


def quick_hand(t_s, travel_m, seconds):
    """Return position and speed of a hand that reaches out smoothly, and stands."""
    part = min(max(t_s / seconds, 0.0), 1.0)
    position_m = travel_m * part**3 * (10.0 - 15.0 * part + 6.0 * part**2)
    speed_m_s = travel_m / seconds * 30.0 * part**2 * (1.0 - part) ** 2
    return position_m, speed_m_s


def hand_that_stops_dead(t_s, travel_m, seconds):
    """Return position and speed of a hand that hits something."""
    speed_m_s = travel_m / seconds
    return speed_m_s * min(t_s, seconds), speed_m_s * (t_s < seconds)


@pytest.mark.parametrize("hand", [quick_hand, hand_that_stops_dead])
@pytest.mark.parametrize("stiffness_N_per_m", [0.0, 300.0])
@pytest.mark.parametrize("speed_limit_m_s", [0.005, 0.02, 0.1])
@pytest.mark.parametrize("scale", [0.4, 1.0])
@pytest.mark.parametrize(("travel_m", "seconds"), [(0.06, 0.3), (0.1, 0.5)])
def test_the_needle_stands_when_a_quick_hand_stands(
    travel_m, seconds, scale, speed_limit_m_s, stiffness_N_per_m, hand
):
    """An arm that is 5 ms late moves by 2.5 mm more, for 0.15 s, at most."""
    tele = Teleoperation(motion_scale=scale, speed_limit_m_s=speed_limit_m_s)
    commands_m_s = deque([0.0] * 5)
    depths_m = []
    forces_N = []
    depth_m = speed_m_s = 0.0
    for k in range(round((seconds + 1.5) / DT)):
        place_m, hand_m_s = hand(k * DT, travel_m, seconds)
        sample = handle((0.0, 0.0, place_m), (0.0, 0.0, hand_m_s))
        spring_N = stiffness_N_per_m * max(depth_m - SURFACE_M, 0.0)
        move = tele.update(sample, estimate(spring_N, None, depth_m, speed_m_s), DT)
        commands_m_s.append(move.speed_m_s)
        speed_m_s = commands_m_s.popleft()
        depth_m += DT * speed_m_s
        depths_m.append(depth_m)
        forces_N.append(abs(move.force_N[2]))
    after_m = np.array(depths_m[round(seconds / DT) :])
    moving = np.flatnonzero(np.abs(np.diff(after_m)) > 2e-3 * DT)

    assert np.abs(after_m - after_m[0]).max() <= 2.5e-3
    assert moving.size == 0 or DT * moving[-1] <= 0.15
    assert max(forces_N) <= 5.0
    assert np.diff(forces_N).max() <= 0.5 + 1e-9


def steady_force_N(hand_m_s, *, clutch=True):
    """Return the force on a hand that has moved steadily in free air for 2 s."""
    tele = Teleoperation(motion_scale=0.4)
    depth_m = 0.0
    for k in range(2000):
        sample = handle((0.0, 0.0, hand_m_s * k * DT), (0.0, 0.0, hand_m_s), clutch)
        move = tele.update(sample, estimate(0.0, depth_m=depth_m), DT)
        depth_m += DT * move.speed_m_s
    return move.force_N[2]


def test_a_hand_feels_that_the_needle_cannot_follow():
    """At 20 mm/s and a scale of 0.4 the needle follows a hand of 50 mm/s."""
    assert steady_force_N(0.045) == pytest.approx(0.0, abs=0.01)
    assert steady_force_N(0.1) == pytest.approx(-1.0, abs=0.05)
    assert steady_force_N(-0.1) == pytest.approx(1.0, abs=0.05)
    assert steady_force_N(0.1, clutch=False) == pytest.approx(0.0, abs=0.01)


@pytest.mark.parametrize("every", [1, 2, 5])
def test_a_device_may_send_seldom(every):
    """A device may send less often than the loop runs."""
    rng = np.random.default_rng(2)
    master = HapticMaster(Operator(wish_m=advancing(20e-3, 30e-3)), position_step_m=0.0)
    tele = Teleoperation(shown="raw")
    read = master.read
    count = iter(range(10**6))
    master.read = lambda: (read(), None)[next(count) % every > 0]
    depth = drive(PLANTS["spring"], tele, master, 2.0, rng)

    assert depth == pytest.approx(0.4 * master.position_m[2], abs=3e-4)
    assert tele.device.port.net_J == pytest.approx(master.port_energy_J, abs=1e-4)
    assert master.least_energy_J >= -0.1e-3


@pytest.mark.parametrize("seed", range(3))
@pytest.mark.parametrize("delay_s", [0.0, 0.05])
@pytest.mark.parametrize(("chance", "least", "most"), [(0.3, 1, 4), (0.01, 10, 18)])
def test_gaps_between_samples_give_no_energy_away(chance, least, most, delay_s, seed):
    rng = np.random.default_rng([seed, least])
    master = HapticMaster(random_operator(advancing(20e-3, 30e-3), rng))
    read = master.read
    silent = iter(())

    def read_with_gaps():
        nonlocal silent
        sample = read()
        if rng.random() < chance:
            silent = iter(range(rng.integers(least, most + 1)))

        return sample if next(silent, None) is None else None

    master.read = read_with_gaps
    tele = Teleoperation(lines=(line(delay_s, rng), line(delay_s, rng)), shown="raw")
    drive(PLANTS["wall"], tele, master, 2.0, rng)

    assert master.least_energy_J >= MIN_ENERGY_J["wall"]


@pytest.mark.parametrize("mass_kg", [0.25, 0.5, 1.25])
@pytest.mark.parametrize("every", [1, 4, 10, 20])
def test_a_free_handle_gains_no_energy(every, mass_kg):
    """A handle that nobody holds gains no energy, however seldom it is read."""
    tele = Teleoperation()
    place = 0.0
    speed = 0.0
    depth = 0.0
    pace = 0.0
    force_N = given_J = least_J = 0.0
    for k in range(4000):
        push_N = 6.0 if k // 1000 % 2 == 0 else -6.0
        speed += (push_N - 5.0 * speed + force_N) / mass_kg * DT
        place += speed * DT
        given_J -= force_N * speed * DT
        least_J = min(least_J, given_J)
        handle = SimpleNamespace(
            position_m=(0.0, 0.0, place), velocity_m_s=(0.0, 0.0, speed), clutch=True
        )
        session_estimate = estimate(300.0 * max(depth, 0.0), None, depth, pace)
        move = tele.update(handle if k % every == 0 else None, session_estimate, DT)
        force_N = move.force_N[2]
        pace = move.speed_m_s
        depth += pace * DT
        assert abs(force_N) <= 5.0

    assert least_J > -0.05


def test_after_a_reset_force_and_motion_are_zero():
    """After a reset neither force nor motion goes on before the device has sent."""
    tele = Teleoperation()
    handle = {"velocity_m_s": (0.0, 0.0, 0.04), "clutch": True}
    for k in range(500):
        sample = SimpleNamespace(position_m=(0.0, 0.0, 4e-5 * k), **handle)
        move = tele.update(sample, estimate(2.0), DT)

    assert move.speed_m_s > 0.01
    assert abs(move.force_N[2]) > 0.5

    tele.reset()
    for dt_s in (np.nan, DT):
        move = tele.update(None, estimate(2.0), dt_s)
        assert (move.speed_m_s, *move.force_N) == (0.0, 0.0, 0.0, 0.0)


def test_noise_is_hidden_ruptures_show_at_once():
    """Noise is not shown, and a rupture is shown at once."""
    tele = Teleoperation()
    rng = np.random.default_rng(4)
    shown = []
    for noise_N in rng.normal(0.0, 0.1, 2000):
        tele.update(None, estimate(1.0 + noise_N), DT)
        shown.append(tele.shown_N)

    assert np.std(shown[1000:]) < 0.02
    assert np.mean(shown[1000:]) == pytest.approx(1.0, abs=0.02)

    tele.update(None, estimate(0.5), DT)

    assert tele.shown_N == pytest.approx(0.8)  # never further than 0.3 N

    tele.update(None, estimate(0.5, rupture=object()), DT)
    for _ in range(60):
        tele.update(None, estimate(0.5), DT)

    assert tele.shown_N == pytest.approx(0.5, abs=0.02)


@pytest.mark.parametrize(
    ("stiffness", "late_N"), [(0.0, -0.2), (250.0, 0.0), (1e9, 0.3)]
)
def test_known_stiffness_removes_the_lag_of_force(stiffness, late_N):
    """A membrane of 250 N/m at 4 mm/s; a stiffness out of reason moves it by 0.3 N
    at most."""
    tele = Teleoperation()
    speed = 4e-3
    for k in range(2000):
        force = 250.0 * speed * k * DT
        tele.update(None, estimate(force, speed_m_s=speed, stiffness=stiffness), DT)

    assert tele.shown_N - force == pytest.approx(late_N, abs=0.01)

    for _ in range(2000):
        tele.update(
            None, estimate(-1.0, 0.0, speed_m_s=-speed, stiffness=stiffness), DT
        )

    assert tele.shown_N == pytest.approx(
        0.0, abs=0.01
    )  # withdrawn, nothing springs back


def test_motion_and_force_end_without_signals():
    """The needle stops without the device, and the force fades without estimates."""
    tele = Teleoperation(lines=None)
    sample = SimpleNamespace(
        position_m=np.zeros(3), velocity_m_s=np.zeros(3), clutch=True
    )
    for k in range(1000):
        sample.position_m = np.array([0.0, 0.0, 8e-6 * k])
        sample.velocity_m_s = np.array([0.0, 0.0, 8e-3])
        moving = tele.update(sample, estimate(1.0, depth_m=3.2e-6 * k), DT)

    assert moving.speed_m_s == pytest.approx(3.2e-3, rel=0.02)
    assert moving.force_N == pytest.approx([0.0, 0.0, -1.0], abs=0.02)

    for _ in range(200):
        gone = tele.update(None, estimate(1.0, depth_m=3.2e-3), DT)

    assert gone.speed_m_s == pytest.approx(0.0, abs=1e-4)
    assert not gone.force_N.any()

    for _ in range(1000):
        lost = tele.update(
            sample, estimate(1.0, depth_m=3.2e-3, status=Status.REJECTED), DT
        )

    assert (
        abs(lost.force_N[2]) < 0.2
    )  # the damping of a handle that is said to move is left


def test_after_a_reset_the_needle_stays():
    """After a reset the needle does not make up for the hand's motion."""
    place = SimpleNamespace(
        position_m=np.zeros(3), velocity_m_s=np.zeros(3), clutch=True
    )
    speeds_m_s = {}
    for is_reset in (False, True):
        tele = Teleoperation()
        place.position_m = np.zeros(3)
        tele.update(place, estimate(depth_m=0.05), DT)
        place.position_m = np.array(
            [0.0, 0.0, 0.004]
        )  # while nobody asked, and the depth is new
        if is_reset:
            tele.reset()
        speeds_m_s[is_reset] = tele.update(place, estimate(depth_m=0.0), DT).speed_m_s

    assert speeds_m_s[False] > 0.01
    assert speeds_m_s[True] == 0.0


@given(axial=st.floats(-20.0, 20.0), tip=st.floats(-20.0, 20.0))
def test_shown_force_lies_within_the_measured_one(axial, tip):
    for shown in ("tip", "enhanced"):
        force = shown_force(estimate(axial, tip), shown)
        assert min(axial, 0.0) <= force <= max(axial, 0.0)
    assert shown_force(estimate(axial, tip), "raw") == axial


@settings(deadline=None)
@given(st.lists(st.tuples(st.floats(-30.0, 30.0), st.floats(-1.0, 1.0)), max_size=100))
def test_a_free_device_gains_no_energy(steps):
    """Whatever force is wanted and however the handle is hit between the samples."""
    port = HandPort()
    position_m = 0.0
    mass_kg = 0.25
    for wanted_N, speed_m_s in steps:
        force_N = port.update(wanted_N, position_m, speed_m_s, 1e9, dt_s=DT, ahead_s=DT)
        position_m += speed_m_s * DT - force_N / mass_kg * DT**2 / 2.0
        port.update(0.0, position_m, 0.0, 1e9, dt_s=DT, ahead_s=DT)
        assert port.net_J >= -1e-12


def test_energy_of_a_port_counts_both_ways_apart():
    port = Port()
    port.observe(2.0, 0.1)
    port.observe(2.0, -0.05)

    assert (port.in_J, port.out_J, port.net_J) == pytest.approx((0.2, 0.1, 0.1))
    assert passive_fraction(1.0, 0.25) == 0.25
    assert passive_fraction(1.0, -1.0) == 0.0
    assert passive_fraction(-1.0, -1.0) == 1.0


def test_unused_allowance_is_not_saved_up():
    """An unused allowance does not grow."""
    port = Port(1e-3, 2e-3)
    for _ in range(60_000):
        quiet = port.update_budget_J(0.0, DT)

    assert quiet == 1e-3

    port.observe(-1.0, 1.5e-3)  # more than may leave has left

    assert port.update_budget_J(0.0, DT) == pytest.approx(-0.5e-3 + 2e-6)

    for _ in range(2000):
        later = port.update_budget_J(0.0, DT)

    assert later == pytest.approx(1e-3)
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


def test_line_keeps_the_order_and_the_newest_counts():
    rng = np.random.default_rng(0)
    sent = 0
    late = DelayLine(0.02, 0.015, rng)
    newest = -1
    for sent in range(500):
        received = late.exchange(sent, DT)
        if received is not None:
            assert received >= newest
            newest = received
            assert 4 <= sent - received <= 36

    assert DelayLine().exchange("now", DT) == "now"

    for make, said in (
        (lambda: DelayLine(-0.1), "expected finite numbers >= 0"),
        (lambda: DelayLine(0.1, 0.01), "pass rng="),
    ):
        with pytest.raises(PlantError, match=said):
            make()


@pytest.mark.parametrize(
    ("make", "said"),
    [
        (
            lambda: Teleoperation(motion_scale=0.05),
            "motion_scale is 0.05, expected 0.1 to 1",
        ),
        (lambda: Teleoperation(force_scale=-1.0), "force_scale is -1.0"),
        (lambda: Teleoperation(force_lag_s=0.0), "force_lag_s is 0.0"),
        (
            lambda: Teleoperation(axis=(0.0, 0.0, 0.0)),
            "three numbers that are not all zero",
        ),
        (lambda: Teleoperation(shown="all"), "expected 'tip', 'enhanced' or 'raw'"),
    ],
)
def test_settings_that_cannot_work_are_refused(make, said):
    with pytest.raises(SettingError, match=said):
        make()


def handle(position_m=(0.0, 0.0, 0.0), velocity_m_s=(0.0, 0.0, 0.0), clutch=True):
    return SimpleNamespace(
        position_m=position_m, velocity_m_s=velocity_m_s, clutch=clutch
    )


def damping_Ns_m(tele, hz):
    """Most force per speed that a hand feels in free air, oscillating for half a
    second."""
    position_m = 0.0
    most_N = 0.0
    for angle in (2.0 * np.pi * hz * DT * np.arange(500)).tolist():
        speed_m_s = 0.02 * np.sin(angle)
        position_m += speed_m_s * DT
        sample = handle((0.0, 0.0, position_m), (0.0, 0.0, speed_m_s))
        most_N = max(most_N, abs(tele.update(sample, estimate(0.0), DT).force_N[2]))

    return most_N / 0.02


@pytest.mark.parametrize(
    ("hz", "least", "most"), [(1.0, 10.0, 50.0), (5.0, 60.0, 150.0)]
)
def test_a_swinging_hand_is_damped_more(hz, least, most):
    """A hand that swings is damped more than one that springs forward."""
    assert least < damping_Ns_m(Teleoperation(motion_scale=0.2), hz) < most


def test_late_force_is_damped_more():
    usual, sooner = (
        damping_Ns_m(Teleoperation(motion_scale=1.0, **lag), 1.0)
        for lag in ({}, {"force_lag_s": 5e-3})
    )
    late = damping_Ns_m(Teleoperation(motion_scale=1.0, force_lag_s=1.0 / 15.0), 1.0)

    assert sooner == usual
    assert late > 1.3 * usual


@pytest.mark.parametrize("dt_s", [np.nan, np.inf, 0.0, -1e-3, -0.2, None, "x"])
def test_without_time_passing_the_needle_stands(dt_s):
    """With a time step that does not advance the needle stands."""
    tele = Teleoperation()
    session_estimate = estimate(axial_N=2.0)
    moving = handle(velocity_m_s=(0.0, 0.0, 0.05))
    last_command = [tele.update(moving, session_estimate, DT) for _ in range(50)][-1]
    command = tele.update(moving, session_estimate, dt_s)

    assert command.speed_m_s == 0.0
    assert command.force_N == pytest.approx(last_command.force_N)
    assert np.isfinite(tele.update(moving, session_estimate, DT).force_N).all()


@pytest.mark.parametrize(
    "sample",
    [
        handle(position_m=None),
        handle(position_m=(0.0, 0.0)),
        handle(position_m=((0.0,), 1.0, 2.0)),
        handle(velocity_m_s=(0.0, 0.0, 1e300)),
        handle(velocity_m_s=(0.0, np.nan, 0.0)),
        handle(clutch=np.zeros(3)),
        SimpleNamespace(position_m=np.zeros(3), velocity_m_s=np.zeros(3)),
        SimpleNamespace(),
    ],
)
def test_an_impossible_handle_sample_counts_as_none(sample):
    """A sample that no handle can have given counts as none."""
    forces_N = []
    for wrong in (sample, None):
        tele = Teleoperation()
        z = 0.0
        for k in range(100):
            z += 2e-5
            good = handle((0.0, 0.0, z), (0.0, 0.0, 0.02))
            command = tele.update(wrong if k == 50 else good, estimate(1.0), DT)
        forces_N.append(command.force_N)

    assert np.abs(forces_N[0]).max() > 0.01
    assert forces_N[0].tolist() == forces_N[1].tolist()
    assert np.isfinite(
        tele.update(handle(clutch=None), estimate(1.0), DT).force_N
    ).all()

    for odd, dt_s in ((handle(("0", "0", "0")), DT), (handle(), 10**400)):
        assert np.isfinite(tele.update(odd, estimate(1.0), dt_s).force_N).all()


@pytest.mark.parametrize("frozen", [False, True])
def test_the_needle_stands_when_the_device_is_silent(frozen):
    """The needle stands soon after the device is gone or repeats itself."""
    tele = Teleoperation(motion_scale=1.0)
    depth_m = 0.0
    depths = []
    for k in range(2000):
        z = 3e-5 * min(k, 300)  # 30 mm/s; the needle follows with 20
        sample = handle((0.0, 0.0, z), (0.0, 0.0, 0.03)) if k < 300 or frozen else None
        depth_m += DT * tele.update(sample, estimate(depth_m=depth_m), DT).speed_m_s
        depths.append(depth_m)

    assert depths[-1] - depths[299] < 0.005
    assert depths[-1] == pytest.approx(depths[1000], abs=1e-4)


@pytest.mark.parametrize(
    "wrong",
    [
        {"motion_scale": None},
        {"motion_scale": "0.4"},
        {"axis": "abc"},
        {"lines": (3, 4)},
    ],
)
def test_settings_of_another_kind_are_refused(wrong):
    with pytest.raises(SettingError, match=next(iter(wrong))):
        Teleoperation(**wrong)
