"""A manager whose session is a stand-in: what it reports is set by the test."""

import numpy as np

from groundtruth.rig_arm import ArmSample
from identification import SampleStatus
from needleforce import InsertionSession
from needleforce.control.manager import Manager
from needleforce.control.monitors import Beside, SafetyLimits
from residual import SensorConfig, SensorWarning, Status, TareError
from urdf import load_lwr

ROBOT = load_lwr()
NOTHING = Beside()
LIMITS = SafetyLimits(axial_N=2.0)
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
        wrench = {"warnings": SensorWarning.NONE, "message": ""} | wrench
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


def run(manager, seconds=1e-3, beside=NOTHING, dt_s=1e-3):
    for _ in range(round(seconds / 1e-3)):
        manager.heartbeat()
        situation = manager.update(
            ArmSample(dt_s, np.zeros(7), np.zeros(7), np.zeros(7)), beside
        )
    return situation


def inserting(**kwargs):
    manager, sensor = new_manager(**kwargs)
    run(manager, 0.2)
    for event in ("tare", "arrived", "insert"):
        assert manager.request(event) == ""

        run(manager)

    return manager, sensor
