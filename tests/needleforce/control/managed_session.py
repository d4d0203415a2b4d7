"""A manager whose session is a stand-in: what it reports is set by the test."""

import numpy as np

from groundtruth import ArmSample
from identification import SampleStatus
from needleforce import InsertionSession
from needleforce.control import (
    Beside,
    HandleReading,
    HandleReport,
    Manager,
    SafetyLimits,
    State,
)
from residual import SensorConfig, SensorWarning, Status, TareError
from urdf import load_lwr

ROBOT = load_lwr()
LIMITS = SafetyLimits(axial_N=2.0)
DEVICE = Beside(handle=HandleReport(HandleReading(np.zeros(3), np.zeros(3), True)))
"""A haptic device answers."""
FIRST = InsertionSession(ROBOT).update(np.zeros(7), np.zeros(7), np.zeros(7), 1e-3)


class Sensor:
    """Stands in for a session: what it reports is set by the test."""

    lag_s = 0.014
    sensor_config = SensorConfig()

    def __init__(self):
        self.tared = False
        self.estimate = FIRST
        self.refuses = False
        self.is_slow = False
        self.taring = False
        self.tare_refusal = None
        self.zero = 0

    def update(self, q, dq, tau, dt_s):
        if self.taring and not self.is_slow:
            self.taring = False
            self.tared = not self.refuses
            self.tare_refusal = TareError("contact") if self.refuses else None
        return self.estimate

    def start_tare(self, steps_per_tick):
        self.taring = True

    def start_tare_recording(self):
        self.tared = False

    def reads(
        self,
        status=Status.OK,
        *,
        depth_m=0.0,
        in_contact=False,
        sample_status=SampleStatus.OK,
        hard_contact=None,
        **wrench,
    ):
        estimate = self.estimate
        usual = {"warnings": SensorWarning.NONE, "message": ""}
        wrench = usual | {"axial": 0.0, "lateral": 0.0} | wrench
        self.estimate = estimate._replace(
            wrench=estimate.wrench._replace(status=status, **wrench),
            status=status,
            depth_m=depth_m,
            identification=estimate.identification._replace(
                in_contact=in_contact,
                layer=int(in_contact),
                hard_contact=hard_contact,
                status=sample_status,
            ),
        )


def new_manager(limits=LIMITS, log=None):
    sensor = Sensor()
    sensor.reads()
    return Manager(sensor, limits, log=log), sensor


def run(manager, seconds=1e-3, beside=None, dt_s=1e-3, q_rad=None, is_alive=True):
    """Update for some time, with a heartbeat unless the program is dead."""
    q_rad = np.zeros(7) if q_rad is None else q_rad
    for _ in range(round(seconds / 1e-3)):
        if is_alive:
            manager.heartbeat()
        sample = ArmSample(dt_s, q_rad, np.zeros(7), np.zeros(7))
        situation = manager.update(sample, beside or Beside())
    return situation


def at(depth_m, in_contact=False, **how):
    """Return a step in which the needle is there, in tissue or not."""
    return {"depth_m": depth_m, "in_contact": in_contact} | how


def play(manager, sensor, *steps):
    """Play steps, assert what each expects, and return the last situation.

    An event is requested; with "!" before it that must be refused, and for a reason
    with the word after it. A state must be the one after a cycle. A number is time that
    passes, a `Beside` what comes with all samples from then on. A dictionary is what
    the sensor reads and has from then on, and ``dt_s`` of the one cycle that follows.
    """
    beside = Beside()
    for step in steps:
        if isinstance(step, State):
            situation = run(manager, beside=beside)
            assert situation.state is step, (steps, situation.reason)
        elif isinstance(step, str):
            event, _, word = step.partition(" ")
            refused = manager.request(event.strip("!"))
            assert bool(refused) == event.startswith("!"), (step, refused)
            assert word in refused
        elif isinstance(step, float):
            situation = run(manager, step, beside)
        elif isinstance(step, Beside):
            beside = step
        else:
            has = {name: step[name] for name in step if name in vars(sensor)}
            vars(sensor).update(has)
            reads = {name: step[name] for name in step if name not in (*has, "dt_s")}
            sensor.reads(**reads)
            situation = run(manager, 1e-3, beside, step.get("dt_s", 1e-3))
    return situation


def inserting(**how):
    manager, sensor = new_manager(**how)
    play(manager, sensor, 0.2, "tare", "arrived", 1e-3, "insert", 1e-3)
    return manager, sensor
