"""Arms whose controllers are scripts: they keep every velocity that they are told.

The clients of Franka and UR are replaced by objects that do what the drivers call. As a
program, ``scripted_arms.py FOLDER END...``, each kind is driven by a process of its own
until that ends by an error, or by a signal; what the arm was told is written into a
file in the folder, for each way to end.
"""

import atexit
import itertools
import os
import signal
import socket
import struct
import sys
import threading
import time
from types import MappingProxyType, SimpleNamespace
from unittest import mock

import numpy as np

from needleforce.devices import (
    Fr3Arm,
    FrankaArm,
    FriArm,
    IiwaArm,
    UrArm,
    franka,
    link,
    ur,
)
from needleforce.devices.sunrise_messages import (
    MONITORING_KIND,
    POSITION_MODE,
    Quality,
    Session,
    message_type,
)


def lwr_measurement(count=1, state=1, quality=3, joints=None, size=916):
    """A measurement of FRI 1.0, its bytes at their published offsets.

    Each signal of `joints` has the offset of its seven numbers.
    """
    data = bytearray(size)
    struct.pack_into("<4H", data, 0, count % 65536, 0x5678, 916, 0x2006)
    struct.pack_into("<fHHf", data, 140, 12.5, state, quality, 0.002)
    for offset, values in (joints or {}).items():
        struct.pack_into("<7f", data, offset, *values)
    return bytes(data)


def iiwa_message(
    count=1,
    session=Session.COMMANDING_ACTIVE,
    place_rad=(0.0,) * 7,
    *,
    quality=Quality.EXCELLENT,
    period_ms=2,
    safety_stop=0,
    mode=POSITION_MODE,
    program_rad=(0.0,) * 7,
    **changes,
):
    """A message of an iiwa's controller, version 2."""
    message = message_type("Monitoring")()
    message.header.kind = changes.get("kind", MONITORING_KIND)
    message.header.number = count
    message.robot.safety_stop = safety_stop
    for signal_name in ("position_rad", "torque_Nm", "external_Nm"):
        values = place_rad if signal_name == "position_rad" else [0.0] * 7
        getattr(message.measured, signal_name).value.extend(values)
    stamp = message.measured.time
    stamp.seconds, stamp.nanoseconds = divmod(2_000_000 * count, 1_000_000_000)
    message.connection.session = session
    message.connection.quality = quality
    message.connection.period_ms = period_ms
    message.program.mode = mode
    message.program.position_rad.value.extend(program_rad)
    return message.SerializeToString()


class ScriptedArm:
    """An arm and its controller, which goes on cycle by cycle.

    Attributes:
        preset: Name of the arm's limits.
        cycle_s: Of the controller.
        arm: The driver.
        place_rad: Where the controller says that the arm is.
        sent_rad_s: The velocities that it was told, one a cycle.
        is_good: Whether the connection is good; else the arm does not obey.
    """

    preset = ""
    cycle_s = 1e-3
    joints = 7

    def __init__(self, robot=None, place_rad=None):
        self.place_rad = np.zeros(self.joints) if place_rad is None else place_rad
        self.sent_rad_s = []
        self.is_good = True
        self.is_free = False  # whether the controller goes on by itself
        self.arm = self.open(robot)
        self.readings = iter(self.arm)

    def keep(self, velocity_rad_s):
        """Move as told."""
        velocity_rad_s = np.array(velocity_rad_s, dtype=float)
        self.sent_rad_s.append(velocity_rad_s)
        self.place_rad = self.place_rad + self.cycle_s * velocity_rad_s

    def cycle(self, speed_rad_s=None):
        """Run a cycle; return whether its command, of the first joint, was taken."""
        next(self.readings)
        if speed_rad_s is None:
            return False
        return self.arm.send([speed_rad_s] + [0.0] * (self.joints - 1))

    def run_freely(self):
        """Let the controller go on by itself."""
        self.is_free = True

    def settle(self):
        """Wait until all has come that the arm was told."""

    def close(self):
        self.run_freely()
        self.arm.close()
        self.settle()


class Lwr(ScriptedArm):
    preset = "lwr"
    cycle_s = 2e-3
    open_link = FriArm

    def open(self, robot):
        self.count = 0
        self.begun_rad = self.place_rad
        self.box = socket.socket(type=socket.SOCK_DGRAM)
        self.box.settimeout(10.0)
        self.told_rad = None
        return self.open_link(port=0, give_up_s=2.0, robot=robot)

    def message(self):
        joints = {292: self.place_rad, 320: np.zeros(7)}  # commanded, added
        return lwr_measurement(self.count, 2, 3 if self.is_good else 1, joints)

    def read(self, data):
        return np.array(struct.unpack_from("<7f", data, 144), dtype=float)

    def hear(self):
        place_rad = self.read(self.box.recv(2048))
        if self.told_rad is not None:
            self.keep((place_rad - self.told_rad) / self.cycle_s)
        self.told_rad = place_rad

    def send(self):
        self.count += 1
        self.box.sendto(self.message(), self.arm.address)

    def cycle(self, speed_rad_s=None):
        self.send()
        taken = super().cycle(speed_rad_s)
        self.hear()
        return taken

    def run_freely(self):
        if self.is_free:
            return
        super().run_freely()

        def run():
            self.box.settimeout(0.3)
            while True:
                self.send()
                try:
                    self.hear()
                except OSError:
                    return
                time.sleep(self.cycle_s)

        self.thread = threading.Thread(target=run, daemon=True)
        self.thread.start()

    def settle(self):
        self.thread.join()
        self.box.close()


class Iiwa(Lwr):
    preset = "iiwa14"
    open_link = IiwaArm
    fault = MappingProxyType({"quality": Quality.FAIR})  # unless all is good

    def message(self):
        fault = {} if self.is_good else self.fault
        places_rad = {"place_rad": self.place_rad, "program_rad": self.begun_rad}
        return iiwa_message(self.count, **places_rad, **fault)

    def read(self, data):
        command = message_type("Command").FromString(data)
        return np.array(command.wanted.position_rad.value)


class ClientError(RuntimeError):
    """What a client raises when its arm stops."""


class ScriptedClient(ScriptedArm):
    """Also the client of the arm; a thread of the driver looks for new readings."""

    def open(self, robot):
        self.time_s = 0.0
        self.read_s = -1.0  # the latest time that the driver has read
        return self.open_arm(robot)

    def send(self):
        self.time_s += self.cycle_s

    def cycle(self, speed_rad_s=None):
        self.send()
        return super().cycle(speed_rad_s)

    def pass_time(self):
        if self.is_free:
            time.sleep(self.cycle_s)
            self.time_s += self.cycle_s


class Fr3(ScriptedClient):
    preset = "fr3"
    driver = Fr3Arm

    def open_arm(self, robot):
        library = SimpleNamespace(
            Robot=lambda *_, **__: self,
            RealtimeConfig=SimpleNamespace(Ignore=0),
            Duration=int,
            JointVelocityWaypoint=lambda velocity, **_: velocity,
            JointVelocityWaypointMotion=lambda waypoints: waypoints,
            Exception=ClientError,
        )
        with mock.patch.object(franka, "import_client", return_value=library):
            return self.driver(takes_commands=True, robot=robot)

    @property
    def state(self):
        self.pass_time()
        time_ms = round(1e3 * self.time_s)
        return SimpleNamespace(
            q=self.place_rad.tolist(),
            dq=[0.0] * 7,
            tau_J=[0.0] * 7,
            tau_ext_hat_filtered=[0.0] * 7,
            time=SimpleNamespace(to_msec=lambda: time_ms),
        )

    def move(self, waypoints, *, asynchronous):
        assert asynchronous
        if not self.is_good:
            raise ClientError("communication_constraints_violation")
        held_rad_s, rest_rad_s = waypoints
        assert not rest_rad_s.any()
        self.keep(held_rad_s)


class Fer(Fr3):
    preset = "fer"
    driver = FrankaArm


class Ur(ScriptedClient):
    preset = "ur5e"
    cycle_s = 2e-3
    joints = 6

    takes_velocity = True
    settings = MappingProxyType({"takes_commands": True})

    def open_arm(self, robot):
        with mock.patch.object(ur, "import_client", return_value=self.library):
            return UrArm(robot=robot, **self.settings)

    @property
    def library(self):
        self.is_connected = True
        return SimpleNamespace(
            RTDEReceiveInterface=lambda *_: self, RTDEControlInterface=lambda *_: self
        )

    def isConnected(self):
        self.pass_time()
        return self.is_connected

    def getTimestamp(self):
        return self.time_s

    def getActualQ(self):
        return self.place_rad.tolist()

    def getActualQd(self):
        return [0.0] * 6

    getActualCurrent = getActualQd

    def isProgramRunning(self):
        return self.is_good

    def setWatchdog(self, rate_Hz):
        assert rate_Hz == 10.0

    def kickWatchdog(self):
        self.keep(np.zeros(6))

    def speedJ(self, velocity_rad_s, acceleration_rad_s2, _time_s):
        assert acceleration_rad_s2 >= 9.8
        if self.takes_velocity:
            self.keep(velocity_rad_s)
        return self.takes_velocity

    def speedStop(self, _acceleration_rad_s2):
        assert not self.sent_rad_s or not self.sent_rad_s[-1].any()

    def stopScript(self):
        self.is_good = False

    def disconnect(self):
        pass


KINDS = {kind.preset: kind for kind in (Lwr, Iiwa, Fr3, Fer, Ur)}


def drive(name, end, path):
    """Drive an arm until the program ends so; write what it was told."""
    scripted = KINDS[name]()

    def write():
        time.sleep(0.3)  # what was sent last has come
        np.save(path, scripted.sent_rad_s)

    atexit.register(write)  # before the arm's: it is called after it
    scripted.run_freely()
    speed_rad_s = [0.3] + [0.0] * (scripted.joints - 1)
    for number, _ in enumerate(scripted.arm):
        scripted.arm.send(speed_rad_s)
        if number == 200:
            if end == "error":
                raise ZeroDivisionError
            os.kill(os.getpid(), getattr(signal, end))


if __name__ == "__main__":
    # A shell lets what it starts in the background ignore this signal.
    signal.signal(signal.SIGINT, signal.default_int_handler)
    link.SILENCE_S = 1.0  # a pause of this machine is no silence of an arm
    folder, *ends = sys.argv[1:]
    for kind, end in itertools.product(KINDS, ends):
        if os.fork() == 0:  # rather than importing all again
            drive(kind, end, f"{folder}/{kind}-{end}.npy")
            break
        os.wait()
