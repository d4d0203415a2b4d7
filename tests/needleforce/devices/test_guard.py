"""What arms are sent: never a step above their speed, acceleration and jerk."""

import os
import signal
import socket
import struct
import subprocess
import sys
from contextlib import suppress
from pathlib import Path

import numpy as np
import pytest

from needleforce.devices import FriArm, IiwaArm
from needleforce.devices.arm_limits import ARM_LIMITS
from needleforce.devices.guard import Guard
from needleforce.devices.sunrise_messages import (
    MONITORING_KIND,
    CommandMode,
    Header,
    Monitoring,
    Quality,
    Session,
    read_command,
    write_monitoring,
)
from tests.needleforce.devices.test_golden_datagrams import golden_measurement

CYCLE_s = 2e-3
NAMES = sorted(ARM_LIMITS)


def worst_ratios(velocities_rad_s, cycle_s, speed, acceleration, jerk):
    """Highest speed, acceleration and jerk of what was sent, over the limits."""
    joints = np.shape(velocities_rad_s)[1]
    velocities = np.vstack((np.zeros((2, joints)), velocities_rad_s))
    accelerations = np.diff(velocities, axis=0) / cycle_s
    jerks = np.diff(accelerations, axis=0) / cycle_s
    return np.array(
        [
            (np.abs(velocities) / speed).max(),
            (np.abs(accelerations) / acceleration).max(),
            (np.abs(jerks) / jerk).max(),
        ]
    )


def preset_ratios(name, velocities_rad_s, cycle_s):
    preset = ARM_LIMITS[name]
    return worst_ratios(
        velocities_rad_s,
        cycle_s,
        preset.speed_rad_s,
        preset.acceleration_rad_s2,
        preset.jerk_rad_s3,
    )


def wishes_of(kind, cycles, joints, rng):
    """Velocities that a program may ask for, shape (cycles, n) [rad/s]."""
    if kind == "random":
        return rng.uniform(-2.5, 2.5, (cycles, joints))
    if kind == "switched":
        held = rng.uniform(-2.5, 2.5, (cycles // 50 + 1, joints))
        return np.repeat(held, 50, axis=0)[:cycles]
    if kind == "tiny":
        return 1e-9 * rng.standard_normal((cycles, joints))
    return np.where(np.arange(cycles)[:, None] % 2, 2.5, -2.5) * np.ones(joints)


@pytest.mark.parametrize("name", NAMES)
@pytest.mark.parametrize("kind", ["random", "switched", "alternating", "tiny"])
def test_whatever_is_asked_for_keeps_the_limits(name, kind):
    preset = ARM_LIMITS[name]
    rng = np.random.default_rng(1000)
    joints = len(preset.speed_rad_s)
    guard = Guard(preset, preset.cycle_s)
    q_rad = np.zeros(joints)
    if preset.stops is not None:
        q_rad = np.mean((preset.stops.lower_rad, preset.stops.upper_rad), axis=0)
    sent = []
    for wish_rad_s in wishes_of(kind, 3000, joints, rng):
        assert guard.want(wish_rad_s)
        sent.append(guard.advance(q_rad))
        q_rad = q_rad + preset.cycle_s * sent[-1]

    guard.brake()
    while not guard.is_at_rest and len(sent) < 5000:
        sent.append(guard.advance(q_rad))
        q_rad = q_rad + preset.cycle_s * sent[-1]

    assert guard.is_at_rest
    assert preset_ratios(name, sent, preset.cycle_s).max() <= 0.98 + 1e-6
    assert kind == "tiny" or np.ptp(sent) > 0.1


@pytest.mark.parametrize("start_rad_s", [0.1, 0.5, 1.5, 5.0])
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
    for _ in range(8_000 if start_rad_s > 0.1 else 25_000):
        assert guard.want(np.full(7, side * start_rad_s))
        measured_rad = q_rad + 1e-6 * rng.standard_normal(7)
        dq_rad_s = guard.advance(measured_rad)
        room_rad = upper - q_rad if side > 0.0 else q_rad - lower
        allowed = np.sqrt(2.0 * deceleration * room_rad) - offset

        assert (np.abs(dq_rad_s) <= np.maximum(allowed, 0.0) + 1e-9).all()

        q_rad = q_rad + 1e-3 * dq_rad_s
        sent.append(dq_rad_s)

    assert np.minimum(upper - q_rad, q_rad - lower).min() > 0.0399
    assert preset_ratios("fr3", sent, 1e-3).max() <= 1.0


def test_velocities_within_the_limits_pass_unchanged():
    guard = Guard(ARM_LIMITS["lwr"], 1e-3)
    ramp_rad_s = np.minimum(4.9 * 1e-3 * np.arange(200), 0.5)
    for speed_rad_s in ramp_rad_s:
        assert guard.want(np.full(7, speed_rad_s))
        assert guard.advance(np.zeros(7)) == pytest.approx([speed_rad_s] * 7, abs=1e-12)


@pytest.mark.parametrize(
    ("velocity", "words"),
    [
        ([np.nan] + [0.0] * 6, "7 finite numbers"),
        ([np.inf] + [0.0] * 6, "7 finite numbers"),
        ([0.0] * 6, "7 finite numbers"),
        ("fast", "expected numbers"),
        ([50.0] + [0.0] * 6, "got 50 rad/s, more than twice what the arm can"),
    ],
)
def test_what_cannot_be_meant_is_refused_with_the_reason(velocity, words):
    guard = Guard(ARM_LIMITS["lwr"], 1e-3)

    assert not guard.want(velocity)
    assert words in guard.refusal
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
    assert "after an interruption" in guard.refusal
    assert guard.want([0.049] + [0.0] * 6)
    assert guard.want([0.5] + [0.0] * 6)


class Lwr:
    """A controller of an LWR that sends cycle by cycle and keeps what it is told."""

    preset = "lwr"

    def __init__(self):
        self.arm = FriArm(port=0, wait_s=0.5, give_up_s=2.0)
        self.box = socket.socket(type=socket.SOCK_DGRAM)
        self.box.settimeout(10.0)
        self.readings = iter(self.arm)
        self.count = 0
        self.places_rad = []

    def send(self, is_good=True):
        self.count += 1
        data = bytearray(golden_measurement(count=self.count, state=2))
        data[146] = 3 if is_good else 1
        self.box.sendto(bytes(data), self.arm.address)

    def hear(self):
        place = struct.unpack_from("<7f", self.box.recv(2048), 144)
        self.places_rad.append(np.array(place, dtype=float))

    def cycle(self, speed_rad_s=None, is_good=True):
        """Run a cycle; return whether its command was taken."""
        self.send(is_good)
        next(self.readings)
        self.hear()
        if speed_rad_s is None:
            return False
        return self.arm.send([speed_rad_s] + [0.0] * 6)


class Iiwa(Lwr):
    """The same of an iiwa."""

    preset = "iiwa14"

    def __init__(self):
        super().__init__()
        self.arm.close()
        self.arm = IiwaArm(port=0, wait_s=0.5, give_up_s=2.0)
        self.readings = iter(self.arm)

    def send(self, is_good=True):
        self.count += 1
        message = Monitoring(
            header=Header(MONITORING_KIND, self.count, 0),
            session=Session.COMMANDING_ACTIVE,
            quality=Quality.EXCELLENT if is_good else Quality.FAIR,
            period_s=CYCLE_s,
            answer_cycles=1,
            safety_stop=0,
            command_mode=CommandMode.POSITION,
            stamp_s=self.count * CYCLE_s,
            position_rad=np.zeros(7),
            torque_Nm=np.zeros(7),
            external_Nm=np.zeros(7),
            commanded_rad=None,
            interpolated_rad=np.zeros(7),
        )
        self.box.sendto(write_monitoring(message), self.arm.address)

    def hear(self):
        self.places_rad.append(read_command(self.box.recv(2048)).position_rad)


def drive_silent(controller):
    for _ in range(200):
        controller.cycle(0.3)
    for _ in range(100):
        controller.cycle()


def drive_refused(controller):
    for _ in range(200):
        controller.cycle(0.3)
    for _ in range(100):
        assert not controller.cycle(0.3, is_good=False)
    assert not controller.cycle(0.3)
    assert "after an interruption" in controller.arm.refusal
    for _ in range(100):
        assert controller.cycle(0.05)


def drive_absurd(controller):
    for number in range(200):
        assert not controller.cycle(50.0)
        assert controller.cycle(1.2 if number % 2 else -1.2)
        assert not controller.cycle(np.nan)


def drive_closed(controller):
    for _ in range(200):
        controller.cycle(0.3)
    for _ in range(100):
        controller.send()
    controller.arm.close()
    controller.box.settimeout(0.1)
    with suppress(TimeoutError):
        while True:
            controller.hear()


def find_excess(kind, drive):
    """Worst ratios to the preset of what an arm was told, and the velocities."""
    controller = kind()
    with controller.arm, controller.box:
        drive(controller)
    velocities_rad_s = np.diff(controller.places_rad, axis=0) / CYCLE_s
    ratios = preset_ratios(kind.preset, velocities_rad_s, CYCLE_s)
    return ratios, velocities_rad_s


@pytest.mark.parametrize("kind", [Lwr, Iiwa])
@pytest.mark.parametrize(
    "drive", [drive_silent, drive_refused, drive_absurd, drive_closed]
)
def test_no_arm_is_told_a_step_above_its_preset(kind, drive):
    ratios, velocities_rad_s = find_excess(kind, drive)

    # An LWR is told positions as 32 bits: 1e-7 rad, 0.06 rad/s2, 60 rad/s3.
    assert ratios.max() <= 1.0
    assert np.abs(velocities_rad_s).max() > (0.009 if drive is drive_absurd else 0.29)
    if drive is drive_refused:
        assert np.abs(velocities_rad_s[-1]).max() == pytest.approx(0.05, abs=1e-3)
    if drive in (drive_silent, drive_closed):
        assert np.abs(velocities_rad_s[-1]).max() == 0.0


PROGRAM = """
import sys
from needleforce.devices import FriArm
arm = FriArm(port=int(sys.argv[1]), wait_s=0.5, give_up_s=5.0)
print("open", flush=True)
for number, reading in enumerate(arm):
    arm.send([0.3] + [0.0] * 6)
    if number == 200:
        print("moves", flush=True)
        if sys.argv[2] == "error":
            raise ZeroDivisionError
"""


@pytest.mark.slow
@pytest.mark.parametrize("end", ["error", "SIGTERM", "SIGINT"])
def test_a_program_that_ends_brakes_its_arm(end):
    """Without a ``with`` statement, too; the arm has come to rest in limits."""
    controller = Lwr()
    address = controller.arm.address
    controller.arm.close()
    program = subprocess.Popen(
        [sys.executable, "-c", PROGRAM, str(address.port), end],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        cwd=Path(__file__).parents[3],
        env={**os.environ, "PYTHONPATH": str(Path(__file__).parents[3])},
        text=True,
    )
    with program, controller.box:
        assert program.stdout.readline() == "open\n"
        for number in range(1000):
            controller.send()
            controller.box.settimeout(10.0 if number < 200 else 0.5)
            try:
                controller.hear()
            except (TimeoutError, ConnectionError):
                break
            if number == 250 and end != "error":
                program.send_signal(getattr(signal, end))
        program.wait(30.0)

    velocities_rad_s = np.diff(controller.places_rad, axis=0) / CYCLE_s

    assert np.abs(velocities_rad_s).max() == pytest.approx(0.3, abs=1e-3)
    assert np.abs(velocities_rad_s[-1]).max() == 0.0
    assert preset_ratios("lwr", velocities_rad_s, CYCLE_s).max() <= 1.0
