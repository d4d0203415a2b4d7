"""An arm of another process: replays joint signals through ROS 2, keeps the answers.

Needs rclpy and numpy alone. Usage: arm_process.py SIGNALS.npz ANSWERS.json, or without
the latter to send alone, at 500 Hz.
"""

import json
import sys
import time
from collections import defaultdict
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import rclpy
from diagnostic_msgs.msg import DiagnosticArray
from geometry_msgs.msg import WrenchStamped
from rcl_interfaces.srv import DescribeParameters, SetParameters
from rclpy.parameter import Parameter
from rclpy.qos import DurabilityPolicy, QoSProfile
from sensor_msgs.msg import JointState
from std_srvs.srv import Trigger

NS_PER_S = 10**9
MAX_AHEAD = 300
"""Samples that wait in the node; its queue holds more, so that none is lost."""

SENT_AT_ONCE = 5
MAX_SILENCE_S = 30.0
MAX_START_S = 240.0
"""Of a node that compiles first."""

OUTLASTING_S = 5.0
SERVICES = ("tare", "begin_insertion", "stop")
GRIPPER = ("finger_1", "finger_2")


class ArmProcess:
    """The node of the arm, and what came back to it."""

    def __init__(self, signals):
        self.signals = signals
        self.node = rclpy.create_node("arm")
        self.answers = defaultdict(list)
        self.publisher = self.node.create_publisher(JointState, "joint_states", 1000)
        kept = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        subscribe = self.node.create_subscription
        subscribe(WrenchStamped, "/needleforce/wrench", self.on_wrench, 1000)
        subscribe(WrenchStamped, "/needleforce/tip_force", self.on_tip, 1000)
        subscribe(DiagnosticArray, "/needleforce/events", self.on_event, kept)
        subscribe(DiagnosticArray, "/needleforce/layers", self.on_layers, kept)
        subscribe(DiagnosticArray, "/diagnostics", self.on_diagnostics, 10)
        self.services = {
            name: self.node.create_client(Trigger, f"/needleforce/{name}")
            for name in SERVICES
        }
        self.setting = self.node.create_client(
            SetParameters, "/needleforce/set_parameters"
        )
        self.describing = self.node.create_client(
            DescribeParameters, "/needleforce/describe_parameters"
        )

    def on_wrench(self, message):
        force = message.wrench.force
        row = [stamp_ns(message), force.x, force.y, force.z]
        self.answers["wrench"].append(row)
        self.answers["frame"] = message.header.frame_id

    def on_tip(self, message):
        self.answers["tip_force"].append([stamp_ns(message), message.wrench.force.z])

    def on_event(self, message):
        self.answers["events"] += statuses(message)

    def on_layers(self, message):
        self.answers["layers"] = statuses(message)

    def on_diagnostics(self, message):
        self.answers["diagnostics"] += statuses(message)

    def wait_until(self, is_reached, max_s=MAX_SILENCE_S):
        end_s = time.monotonic() + max_s
        rclpy.spin_once(self.node, timeout_sec=0.0)
        while not is_reached():
            rclpy.spin_once(self.node, timeout_sec=0.01)
            assert time.monotonic() < end_s, "the node stays away"

    def call(self, name):
        """Begin a call; its answer is kept."""
        future = self.services[name].call_async(Trigger.Request())

        def keep(done):
            answer = done.result()
            self.answers[name].append([answer.success, answer.message])

        future.add_done_callback(keep)

    def set(self, name, value):
        """Set a parameter of the node; return whether it was taken, and the reason."""
        request = SetParameters.Request()
        request.parameters = [Parameter(name, value=value).to_parameter_msg()]
        future = self.setting.call_async(request)
        self.wait_until(future.done)
        result = future.result().results[0]
        self.answers["set"].append([name, result.successful, result.reason])

    def describe(self, name):
        future = self.describing.call_async(DescribeParameters.Request(names=[name]))
        self.wait_until(future.done)
        self.answers["descriptions"].append(future.result().descriptors[0].description)

    def send(self, k):
        """Publish a sample, its joints in reverse order and with a gripper's."""
        at_ns = round(NS_PER_S * (1.0 + self.signals["t_s"][k]))
        message = JointState()
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(at_ns, NS_PER_S)
        message.name = [*GRIPPER, *self.signals["names"][::-1].tolist()]
        for field, key in (
            ("position", "q_rad"),
            ("velocity", "dq_rad_s"),
            ("effort", "tau_Nm"),
        ):
            values = self.signals[key][k][::-1].tolist()
            setattr(message, field, [0.0] * len(GRIPPER) + values)
        self.publisher.publish(message)

    def send_gripper(self):
        message = JointState(name=list(GRIPPER), position=[0.0, 0.0])
        self.publisher.publish(message)

    def replay(self):
        """Publish all samples, as fast as they are answered, and tare in between."""
        tare = int(self.signals["tare"])
        self.call("begin_insertion")
        for k in range(len(self.signals["t_s"])):
            if k == tare:
                self.call("tare")
            if k % 100 == 0:
                self.send_gripper()
            self.send(k)
            if k % SENT_AT_ONCE == 0:
                self.wait_until(lambda k=k: k - len(self.answers["wrench"]) < MAX_AHEAD)
        total = len(self.signals["t_s"])
        end_s = time.monotonic() + OUTLASTING_S
        self.wait_until(
            lambda: len(self.answers["wrench"]) >= total or time.monotonic() > end_s
        )


def stamp_ns(message):
    return message.header.stamp.sec * NS_PER_S + message.header.stamp.nanosec


def statuses(message):
    return [
        SimpleNamespace(
            stamp_ns=stamp_ns(message),
            name=status.name,
            level=status.level[0],
            message=status.message,
            values={pair.key: pair.value for pair in status.values},
        ).__dict__
        for status in message.status
    ]


def send_alone(arm):
    """Publish the samples, at 500 Hz, as soon as someone listens."""
    for k in range(len(arm.signals["t_s"])):
        arm.send(k)
        time.sleep(0.002)


def main():
    source, *answers = map(Path, sys.argv[1:])
    rclpy.init()
    arm = ArmProcess(dict(np.load(source)))
    arm.wait_until(lambda: arm.publisher.get_subscription_count() > 0, MAX_START_S)
    if not answers:
        send_alone(arm)
        return
    arm.wait_until(arm.setting.service_is_ready)
    arm.wait_until(lambda: all(s.service_is_ready() for s in arm.services.values()))
    arm.describe("queue_depth")
    arm.set("silence_s", 1000.0)
    arm.set("queue_depth", 5)
    arm.set("silence_s", 2.0)
    arm.replay()
    arm.call("stop")
    arm.wait_until(lambda: arm.answers["stop"])
    answers[0].write_text(json.dumps(arm.answers))
    rclpy.try_shutdown()


main()
