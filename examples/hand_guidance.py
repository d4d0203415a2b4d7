"""A hand on the needle's hub leads the arm, which feels it through its joint torques.

The simulated arm stands in for yours; see `needleforce.control.ports.Arm`. Not a
medical device.
"""

import math

import numpy as np

from groundtruth.rig_arm import SimulatedArm
from groundtruth.rig_contacts import HandOnArm
from needleforce.control import AxialSpeed, Controller, Fixture, Guidance, Limits
from residual import SensorConfig, Status, VirtualForceSensor

# a stroke in free air before the tare; a push along x after it
TARE_s = 3.0
PUSH_N = 4.0
hand = HandOnArm(
    at="hub", force_N=lambda t: (PUSH_N if t > TARE_s + 0.5 else 0.0, 0.0, 0.0)
)
arm = SimulatedArm(plant="clean", contacts=[hand], duration_s=TARE_s + 1.5)
control = Controller(arm.robot, Limits(arm.robot))
guidance = Guidance(arm.robot)
sensor = VirtualForceSensor(arm.robot, SensorConfig(smooth_momentum=False))
control.tool.update(arm.home_rad)
line = Fixture.here(control.tool)
start_m = arm.truth.tip_m

for sample in arm:
    force = sensor.update(*sample[1:], sample.dt_s)
    if arm.time_s < TARE_s:
        speed_m_s = -0.05 * math.sin(2.0 * math.pi * arm.time_s / TARE_s)
        stack = [line, AxialSpeed(speed_m_s)]
    else:
        if not sensor.tared:
            sensor.tare()
            start_m = arm.truth.tip_m
        is_ok = force.status is Status.OK
        felt = force.residual, sensor.residual_std_Nm, sample.dt_s
        stack = [guidance.update(*felt, is_valid=is_ok)]
    arm.send(control.update(sample, stack).dq_rad_s)  # never raises; within all limits

moved_m = np.linalg.norm(arm.truth.tip_m - start_m)
print(f"pushed by {PUSH_N:g} N for a second, the tip moved {1e3 * moved_m:.0f} mm")
