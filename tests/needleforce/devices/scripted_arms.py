"""Arms whose controllers are scripts: they keep every velocity that they are told.

The clients of Franka and UR are replaced by objects that do what the drivers call. As a
program, ``scripted_arms.py END FOLDER``, each kind is driven by a process of its own
until that ends by an error, or by a signal; what the arm was told is written into a
file in the folder.
"""

import atexit
import os
import signal
import socket
import struct
import sys
import threading
import time
from types import SimpleNamespace
from unittest import mock

import numpy as np

from needleforce.devices import (
    Fr3Arm,
    FrankaArm,
    FriArm,
    IiwaArm,
    UrArm,
    franka,
    ur,
    ur_control,
)
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
        self.time_s = 0.0
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

    def open(self, robot):
        self.count = 0
        self.is_heard = True
        self.box = socket.socket(type=socket.SOCK_DGRAM)
        self.box.settimeout(10.0)
        self.told_rad = None
        return self.open_link(port=0, wait_s=0.5, give_up_s=2.0, robot=robot)

    open_link = FriArm

    def message(self):
        data = bytearray(golden_measurement(count=self.count, state=2))
        data[146] = 3 if self.is_good else 1
        struct.pack_into("<7f", data, 292, *self.place_rad)  # commanded
        struct.pack_into("<7f", data, 320, *np.zeros(7))  # added
        return bytes(data)

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

    def open(self, robot):
        self.begun_rad = self.place_rad
        return super().open(robot)

    def message(self):
        message = Monitoring(
            header=Header(MONITORING_KIND, self.count, 0),
            session=Session.COMMANDING_ACTIVE,
            quality=Quality.EXCELLENT if self.is_good else Quality.FAIR,
            period_s=self.cycle_s,
            answer_cycles=1,
            safety_stop=0,
            command_mode=CommandMode.POSITION,
            stamp_s=self.count * self.cycle_s,
            position_rad=self.place_rad,
            torque_Nm=np.zeros(7),
            external_Nm=np.zeros(7),
            commanded_rad=None,
            interpolated_rad=self.begun_rad,
        )
        return write_monitoring(message)

    def read(self, data):
        return read_command(data).position_rad


class ClientError(RuntimeError):
    """What a client raises when its arm stops."""


class Fr3(ScriptedArm):
    """Also the client of an FR3."""

    preset = "fr3"

    def open(self, robot):
        library = SimpleNamespace(
            Robot=lambda *_: self,
            RealtimeConfig=SimpleNamespace(kIgnore=0),
            ControllerMode=SimpleNamespace(JointImpedance=0),
            JointVelocities=lambda values: SimpleNamespace(values=values),
            FrankaException=ClientError,
        )
        with mock.patch.object(franka, "import_client", return_value=library):
            return self.open_arm(takes_commands=True, robot=robot)

    open_arm = Fr3Arm

    def state(self):
        self.time_s += self.cycle_s
        time_s = self.time_s
        return SimpleNamespace(
            q=self.place_rad.tolist(),
            dq=[0.0] * 7,
            tau_J=[0.0] * 7,
            tau_ext_hat_filtered=[0.0] * 7,
            time=SimpleNamespace(
                to_sec=lambda: time_s, to_msec=lambda: round(1e3 * time_s)
            ),
        )

    def require_good(self):
        if not self.is_good:
            raise ClientError("communication_constraints_violation")

    def start_joint_velocity_control(self, mode):
        return self

    def readOnce(self):
        self.require_good()
        if self.is_free:
            time.sleep(self.cycle_s)
        return self.state(), None

    def writeOnce(self, velocities):
        self.require_good()
        self.keep(velocities.values)


class Fer(Fr3):
    """Also the client of an FER, which calls for every cycle from a thread."""

    preset = "fer"
    open_arm = FrankaArm

    def open(self, robot):
        self.wanted = threading.Semaphore(0)  # cycles
        return super().open(robot)

    def control_joint_velocity(self, answer):
        is_finished = False
        while not is_finished:
            if self.is_free:
                time.sleep(self.cycle_s)
            else:
                self.wanted.acquire(timeout=10.0)
            self.require_good()
            velocities = answer(self.state(), None)
            self.keep(velocities.values)
            is_finished = velocities.motion_finished

    def cycle(self, speed_rad_s=None):
        self.wanted.release()
        return super().cycle(speed_rad_s)

    def run_freely(self):
        super().run_freely()
        self.wanted.release()


class Ur(ScriptedArm):
    """Also both clients of a UR."""

    preset = "ur5e"
    cycle_s = 2e-3
    joints = 6

    def open(self, robot):
        self.looks = 0
        self.stopped_at_rad_s = None
        self.takes_velocity = True
        library = SimpleNamespace(
            RTDEReceiveInterface=lambda *_: self, RTDEControlInterface=lambda *_: self
        )
        with (
            mock.patch.object(ur, "import_client", return_value=library),
            mock.patch.object(ur_control, "import_client", return_value=library),
        ):
            return UrArm(takes_commands=True, robot=robot)

    def isConnected(self):
        return True

    def getTimestamp(self):
        """A driver looks twice at each."""
        self.looks += 1
        if self.is_free:
            time.sleep(0.5 * self.cycle_s)
        return self.cycle_s * ((self.looks + 1) // 2)

    def getActualQ(self):
        return self.place_rad.tolist()

    def getActualQd(self):
        return [0.0] * 6

    getActualCurrent = getActualQd

    def isProgramRunning(self):
        return self.is_good

    def setWatchdog(self, _rate_Hz):
        pass

    def kickWatchdog(self):
        self.keep(np.zeros(6))

    def speedJ(self, velocity_rad_s, acceleration_rad_s2, _time_s):
        assert acceleration_rad_s2 >= 9.8
        if self.takes_velocity:
            self.keep(velocity_rad_s)
        return self.takes_velocity

    def speedStop(self, _acceleration_rad_s2):
        self.stopped_at_rad_s = self.sent_rad_s[-1]

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
    for kind in KINDS:
        pid = os.fork()  # rather than importing all again
        if pid == 0:
            drive(kind, sys.argv[1], f"{sys.argv[2]}/{kind}.npy")
            break
        os.waitpid(pid, 0)
