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

TARE_s = 3.0  # a stroke in free air until then
PUSH_s = TARE_s + 0.5
PUSH_N = 4.0


def push(t_s):
    """Return the force of the hand: along x, half a second after the tare."""
    return (PUSH_N if t_s > PUSH_s else 0.0, 0.0, 0.0)


hand = HandOnArm(at="hub", force_N=push)
arm = SimulatedArm(plant="clean", contacts=[hand], duration_s=TARE_s + 1.5)

control = Controller(arm.robot, Limits(arm.robot))
control.tool.update(arm.home_rad)
line = Fixture.here(control.tool)
guidance = Guidance(arm.robot)
sensor = VirtualForceSensor(arm.robot, SensorConfig(smooth_momentum=False))
start_m = arm.truth.tip_m

for sample in arm:
    wrench = sensor.update(sample.q_rad, sample.dq_rad_s, sample.tau_Nm, sample.dt_s)

    if arm.time_s < TARE_s:
        # Move up and down along the needle: the tare learns from it.
        phase = 2.0 * math.pi * arm.time_s / TARE_s
        tasks = [line, AxialSpeed(-0.05 * math.sin(phase))]
    else:
        if not sensor.tared:
            sensor.tare()
            start_m = arm.truth.tip_m
        follow_hand = guidance.update(
            wrench.residual,
            sensor.residual_std_Nm,
            sample.dt_s,
            is_valid=wrench.status is Status.OK,
        )
        tasks = [follow_hand]

    command = control.update(sample, tasks)  # never raises; within all limits
    arm.send(command.dq_rad_s)

moved_m = np.linalg.norm(arm.truth.tip_m - start_m)
print(f"pushed by {PUSH_N:g} N for a second, the tip moved {1e3 * moved_m:.0f} mm")
