"""What arms are sent: never a step above their speed, acceleration and jerk."""

import itertools
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from needleforce.devices import ARM_LIMITS, LinkError
from needleforce.devices.guard import Guard
from needleforce.devices.sunrise_messages import Quality
from tests.needleforce.devices.scripted_arms import KINDS
from urdf import load_example, load_lwr

NAMES = sorted(ARM_LIMITS)


@pytest.fixture(autouse=True)
def _patient(monkeypatch):
    """A pause of this machine is no silence of an arm."""
    monkeypatch.setattr("needleforce.devices.link.SILENCE_S", 5.0)


def highest_ratio(name, velocities_rad_s, cycle_s):
    """Highest speed, acceleration or jerk of what was sent, over its limit."""
    limits = ARM_LIMITS[name]
    sent = np.pad(velocities_rad_s, ((2, 0), (0, 0)))
    orders = (limits.speed_rad_s, limits.acceleration_rad_s2, limits.jerk_rad_s3)
    return max(
        (np.abs(np.diff(sent, order, axis=0)) / cycle_s**order / limit).max()
        for order, limit in enumerate(orders)
    )


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["random", "alternating", "tiny"])
def test_whatever_is_asked_for_keeps_the_limits(name, kind):
    preset = ARM_LIMITS[name]
    rng = np.random.default_rng(1000)
    joints = len(preset.speed_rad_s)
    wishes_rad_s = {
        "random": rng.uniform(-2.5, 2.5, (1500, joints)),
        "tiny": 1e-9 * rng.standard_normal((1500, joints)),
        "alternating": np.tile([[-2.5], [2.5]], (750, joints)),
    }
    guard = Guard(preset, preset.cycle_s)
    q_rad = np.zeros(joints)
    if preset.stops is not None:
        q_rad = np.mean((preset.stops.lower_rad, preset.stops.upper_rad), axis=0)
    sent = []
    for wish_rad_s in wishes_rad_s[kind]:
        assert guard.want(wish_rad_s)
        sent.append(guard.advance(q_rad))
        q_rad = q_rad + preset.cycle_s * sent[-1]

    guard.brake()
    while not guard.is_at_rest and len(sent) < 3500:
        sent.append(guard.advance(q_rad))
        q_rad = q_rad + preset.cycle_s * sent[-1]

    assert guard.is_at_rest
    assert highest_ratio(name, sent, preset.cycle_s) <= 0.98 + 1e-6
    assert kind == "tiny" or np.ptp(sent) > 0.1


@pytest.mark.parametrize("start_rad_s", [0.5, 5.0])
@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_an_fr3_keeps_its_speed_limits_near_the_stops(start_rad_s, side):
    """Numbers of the vendor's URDF: |dq| <= sqrt(2 D room) - O."""
    deceleration = np.array([6.0, 2.585, 3.5, 4.0, 17.0, 5.5, 17.0])
    offset = np.array([0.652, 0.25, 0.2005, 0.3542, 0.5738, 0.4885, 0.4592])
    upper = np.array([2.9007, 1.8361, 2.9007, -0.1169, 2.8763, 4.6216, 3.0508])
    lower = np.array([-2.9007, -1.8361, -2.9007, -3.077, -2.8763, 0.4398, -3.0508])
    guard = Guard(ARM_LIMITS["fr3"], 1e-3)
    q_rad = 0.5 * (upper + lower)
    rng = np.random.default_rng(1000)
    sent = []
    for _ in range(6_000):
        assert guard.want(np.full(7, side * start_rad_s))
        measured_rad = q_rad + 1e-6 * rng.standard_normal(7)
        dq_rad_s = guard.advance(measured_rad)
        room_rad = upper - q_rad if side > 0.0 else q_rad - lower
        allowed = np.sqrt(2.0 * deceleration * room_rad) - offset

        assert (np.abs(dq_rad_s) <= np.maximum(allowed, 0.0) + 1e-9).all()

        q_rad = q_rad + 1e-3 * dq_rad_s
        sent.append(dq_rad_s)

    assert np.minimum(upper - q_rad, q_rad - lower).min() > 0.0399
    assert highest_ratio("fr3", sent, 1e-3) <= 1.0


def test_velocities_within_the_limits_pass_unchanged():
    guard = Guard(ARM_LIMITS["lwr"], 1e-3)
    ramp_rad_s = np.minimum(4.9 * 1e-3 * np.arange(200), 0.5)
    for speed_rad_s in ramp_rad_s:
        assert guard.want(np.full(7, speed_rad_s))
        assert guard.advance(np.zeros(7)) == pytest.approx([speed_rad_s] * 7, abs=1e-12)


@pytest.mark.parametrize(
    ("velocity", "word"),
    [
        ([np.nan] + [0.0] * 6, "nan"),
        ([np.inf] + [0.0] * 6, "inf"),
        ([0.0] * 6, "7"),
        ("fast", "fast"),
        ([50.0] + [0.0] * 6, "50"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_the_reason(velocity, word):
    guard = Guard(ARM_LIMITS["lwr"], 1e-3)

    assert not guard.want(velocity)
    assert word in guard.refusal
    assert not guard.advance(np.zeros(7)).any()
    assert guard.want([1.7] + [0.0] * 6)
    assert guard.refusal == ""
    assert guard.advance(np.zeros(7))[0] <= 5e-3  # a step of 1.7 rad/s was asked for


def test_a_velocity_holds_for_five_cycles():
    guard = Guard(ARM_LIMITS["lwr"], 1e-3)
    for _ in range(100):
        assert guard.want([0.1] + [0.0] * 6)
        guard.advance(np.zeros(7))
    speeds_rad_s = [guard.advance(np.zeros(7))[0] for _ in range(10)]

    assert speeds_rad_s[:4] == pytest.approx([0.1] * 4)
    assert (np.diff(speeds_rad_s[3:]) < 0.0).all()


@pytest.mark.parametrize("interrupt", ["interrupt", "interrupt and anchor"])
def test_after_an_interruption_an_arm_starts_with_0_05_rad_per_s_at_most(interrupt):
    guard = Guard(ARM_LIMITS["lwr"], 1e-3)
    guard.interrupt()
    if "anchor" in interrupt:
        guard.anchor()

    assert not guard.want([0.051] + [0.0] * 6)
    assert "interruption" in guard.refusal
    assert guard.want([0.049] + [0.0] * 6)
    assert guard.want([0.5] + [0.0] * 6)


@pytest.fixture(params=NAMES)
def scripted(request):
    """Every arm, or the named ones, with a controller that keeps what it is told."""
    arm = KINDS[request.param]()
    yield arm
    arm.close()


def assert_within_limits(scripted, sent_rad_s=None):
    sent_rad_s = scripted.sent_rad_s if sent_rad_s is None else sent_rad_s
    ratio = highest_ratio(scripted.preset, sent_rad_s, scripted.cycle_s)
    # An LWR is told positions as 32 bits: off by 1.2e-7 rad beyond 2 rad, which are
    # 8 * 1.2e-7 / 0.002^3 = 120 of 5,000 rad/s3, and 0.12 of 10 rad/s2.
    assert ratio <= (1.004 if scripted.preset == "lwr" else 1.0)


def drive_fast(scripted, speed_rad_s=0.3):
    for _ in range(600):
        assert scripted.cycle(speed_rad_s)
    assert scripted.sent_rad_s[-1][0] == pytest.approx(speed_rad_s, abs=1e-3)


def test_an_arm_brakes_when_it_is_told_nothing_or_nonsense(scripted):
    """It takes commands again, from the velocity that it then has."""
    drive_fast(scripted)
    wrongs = itertools.cycle((None, np.nan, 50.0, "fast"))
    for wrong in itertools.islice(wrongs, 150):
        assert not scripted.cycle(wrong)

    assert not scripted.sent_rad_s[-1].any()

    drive_fast(scripted)
    for wrong in itertools.islice(wrongs, 20):
        scripted.cycle(wrong)  # still moving
    drive_fast(scripted)

    assert_within_limits(scripted)


def test_a_place_that_jumps_moves_no_arm(scripted):
    """The controller says another place, by 1.7 rad, for 10 cycles."""
    drive_fast(scripted)
    for sign in (1.0, -1.0):
        scripted.place_rad = scripted.place_rad + sign * 1.7
        for _ in range(10):
            scripted.cycle(0.3)

    assert_within_limits(scripted)


@pytest.mark.parametrize(
    ("scripted", "fault"),
    [
        ("lwr", None),
        ("iiwa14", {"quality": Quality.FAIR}),
        ("iiwa14", {"safety_stop": 1}),
        ("iiwa14", {"mode": 0}),
    ],
    indirect=["scripted"],
)
def test_after_a_bad_connection_an_arm_begins_slowly_from_rest(scripted, fault):
    """These arms go on; what is commanded meanwhile is refused."""
    drive_fast(scripted)
    scripted.fault = fault
    scripted.is_good = False
    for _ in range(100):
        assert not scripted.cycle(0.3)
    assert not scripted.sent_rad_s[-1].any()
    scripted.is_good = True

    assert not scripted.cycle(0.3)
    assert "interruption" in scripted.arm.refusal

    drive_fast(scripted, 0.05)
    drive_fast(scripted)

    assert_within_limits(scripted)


def test_after_a_silence_an_arm_begins_slowly_from_rest(scripted, monkeypatch):
    drive_fast(scripted)
    monkeypatch.setattr("needleforce.devices.link.SILENCE_S", 0.1)
    scripted.arm.on_silence = lambda _: scripted.send()
    next(scripted.readings)

    assert not scripted.arm.send([0.3] + [0.0] * (scripted.joints - 1))
    assert "interruption" in scripted.arm.refusal
    assert scripted.arm.send([0.05] + [0.0] * (scripted.joints - 1))


@pytest.mark.parametrize("scripted", ["fr3", "ur5e"], indirect=True)
def test_a_program_that_was_busy_sends_one_command_a_cycle(scripted):
    """What waits for it tells of the past."""
    drive_fast(scripted)
    for _ in range(15):
        scripted.send()
        time.sleep(0.02)
    told = len(scripted.sent_rad_s)
    for _ in range(6):
        next(scripted.readings)

    assert len(scripted.sent_rad_s) == told


@pytest.mark.parametrize("scripted", ["fr3", "fer", "ur5e"], indirect=True)
def test_an_arm_that_has_stopped_itself_takes_nothing_more(scripted):
    drive_fast(scripted)
    scripted.is_good = False
    with pytest.raises(LinkError, match="stopped"):
        drive_fast(scripted)
    told = len(scripted.sent_rad_s)

    for speed_rad_s in (0.3, 0.05, 0.0):
        assert not scripted.arm.send([speed_rad_s] + [0.0] * (scripted.joints - 1))
        assert scripted.arm.refusal

    scripted.close()

    assert len(scripted.sent_rad_s) == told
    assert_within_limits(scripted)


@pytest.mark.parametrize("scripted", ["ur5e"], indirect=True)
def test_a_ur_that_refuses_a_cycle_goes_on_from_where_it_was(scripted):
    """Its program runs: it keeps its velocity until the next command."""
    drive_fast(scripted)
    scripted.takes_velocity = False
    scripted.cycle(0.3)
    scripted.keep(scripted.sent_rad_s[-1])
    scripted.takes_velocity = True
    for _ in range(100):
        scripted.cycle(0.3)

    assert not scripted.sent_rad_s[-1].any()
    assert "interruption" in scripted.arm.refusal

    drive_fast(scripted, 0.05)

    assert_within_limits(scripted)


def test_an_arm_that_is_closed_brakes_to_rest(scripted):
    with scripted.arm:
        drive_fast(scripted, 1.2)
        scripted.run_freely()
    scripted.settle()

    assert not scripted.sent_rad_s[-1].any()
    assert_within_limits(scripted)
    assert not scripted.arm.send([0.0] * scripted.joints)


def model_of(name):
    if name == "ur5e":
        return load_example("ur5e")
    if name in ("lwr", "iiwa14"):  # no model of an iiwa is shipped
        return load_lwr()
    return load_example("panda", without=["panda_hand"])


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("speed_rad_s", [0.5, -2.0])
def test_an_arm_stops_before_its_stops(name, speed_rad_s):
    """Every joint is driven towards its stop, from 0.4 rad before it."""
    robot = model_of(name)
    lower_rad = robot.position_lower_rad
    upper_rad = robot.position_upper_rad
    if name == "fr3":
        lower_rad, upper_rad = np.array(ARM_LIMITS["fr3"].stops)[:2]
    is_up = speed_rad_s > 0.0
    begun_rad = upper_rad - 0.4 if is_up else lower_rad + 0.4
    scripted = KINDS[name](robot, begun_rad)
    speeds_rad_s = np.full(scripted.joints, speed_rad_s)
    for _ in range(1500):
        scripted.cycle()
        assert scripted.arm.send(speeds_rad_s)
    scripted.close()
    moved_rad = scripted.cycle_s * np.cumsum(scripted.sent_rad_s, axis=0)
    places_rad = begun_rad + moved_rad
    room_rad = upper_rad - places_rad if is_up else places_rad - lower_rad

    assert 0.04 - 1e-6 <= room_rad.min() < 0.0405
    assert_within_limits(scripted)


@pytest.mark.slow
def test_a_program_that_ends_brakes_its_arm(tmp_path):
    """Without a ``with`` statement, too; the arm has come to rest in limits."""
    root = Path(__file__).parents[3]
    ends = ("error", "SIGTERM", "SIGINT")
    subprocess.run(
        [
            sys.executable,
            "-m",
            "tests.needleforce.devices.scripted_arms",
            *(tmp_path, *ends),
        ],
        stderr=subprocess.DEVNULL,
        cwd=root,
        env={**os.environ, "PYTHONPATH": str(root)},
        timeout=360.0,
    )
    for name, end in itertools.product(NAMES, ends):
        sent_rad_s = np.load(tmp_path / f"{name}-{end}.npy")

        assert np.abs(sent_rad_s).max() == pytest.approx(0.3, abs=1e-3)
        assert not sent_rad_s[-1].any()
        assert_within_limits(KINDS[name], sent_rad_s)
