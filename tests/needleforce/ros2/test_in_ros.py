"""Node and arm with the user's rclpy, between processes.

Skipped, saying so, where this Python cannot import rclpy; `.ci/run` has an environment
with it.
"""

import json
import os
import subprocess
import sys
import time
from collections import deque
from importlib.util import find_spec
from pathlib import Path
from threading import Thread

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import read_log
from tests.insertion_run import cut, short_run

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(find_spec("rclpy") is None, reason="no rclpy: source a ROS 2"),
]
RUN = short_run()
JOINTS = RUN.robot.joint_names
SPEED_rad_s = np.array([0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.7])
CONFIGURE, CLEANUP, ACTIVATE, DEACTIVATE = range(1, 5)
SHUTDOWN = 7  # of an active node


@pytest.fixture(autouse=True, scope="module")
def _own_domain():
    """Nodes of this file hear each other only."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("ROS_DOMAIN_ID", str(50 + os.getpid() % 150))
        patch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
        patch.setenv("PYTHONPATH", str(Path(__file__).resolve().parents[3]))
        yield


def command(*arguments):
    return [sys.executable, "-m", "needleforce", *arguments]


class Arm:
    """An arm's driver, and what a node answers it."""

    def __init__(self):
        import rclpy
        from diagnostic_msgs.msg import DiagnosticArray
        from geometry_msgs.msg import WrenchStamped
        from rclpy.qos import DurabilityPolicy, QoSProfile
        from sensor_msgs.msg import JointState

        self.context = rclpy.Context()
        self.context.init(args=[])
        self.node = rclpy.create_node("arm", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.state_type = JointState
        self.states = self.node.create_publisher(JointState, "joint_states", 1000)
        kept = QoSProfile(depth=100, durability=DurabilityPolicy.TRANSIENT_LOCAL)
        self.answers = {name: [] for name in ("wrench", "events", "layers")}
        kinds = (WrenchStamped, DiagnosticArray, DiagnosticArray)
        for (name, answers), kind in zip(self.answers.items(), kinds, strict=True):
            quality = 1000 if name == "wrench" else kept
            topic = f"/needleforce/{name}"
            self.node.create_subscription(kind, topic, answers.append, quality)

    def send(self, stamp_s, q_rad, dq_rad_s, tau_Nm, names=JOINTS):
        """Publish a state, its joints in reverse order."""
        message = self.state_type(name=list(names)[::-1])
        stamp_ns = round(1e9 * stamp_s)
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(stamp_ns, 10**9)
        message.position = q_rad[::-1].tolist()
        message.velocity = dq_rad_s[::-1].tolist()
        message.effort = tau_Nm[::-1].tolist()
        self.states.publish(message)

    def send_row(self, signals, row, stamp_s):
        self.send(
            stamp_s, signals.q_rad[row], signals.dq_rad_s[row], signals.tau_Nm[row]
        )

    def rest(self, seconds):
        """Send the first state at 200 Hz; return the wrenches that come meanwhile."""
        self.answers["wrench"].clear()
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.send_row(RUN.signals, 0, time.time())
            self.executor.spin_once(timeout_sec=5e-3)
        return len(self.answers["wrench"])

    def wait_until(self, is_reached, seconds=30.0):
        end_s = time.monotonic() + seconds
        while not is_reached():
            self.executor.spin_once(timeout_sec=0.01)
            assert time.monotonic() < end_s, "the node stays away"

    def call(self, kind, name, **fields):
        """The future answer of a service of the node."""
        client = self.node.create_client(kind, f"/needleforce/{name}")
        assert client.wait_for_service(timeout_sec=240.0)
        return client.call_async(kind.Request(**fields))

    def ask(self, *arguments, **fields):
        future = self.call(*arguments, **fields)
        self.wait_until(future.done, 240.0)
        return future.result()

    def transit(self, number):
        """Begin a transition of the node's life; return whether it was made."""
        from lifecycle_msgs.msg import Transition
        from lifecycle_msgs.srv import ChangeState

        transition = Transition(id=number)
        return self.ask(ChangeState, "change_state", transition=transition).success


@pytest.fixture
def arm():
    arm = Arm()
    yield arm
    arm.executor.shutdown()
    arm.context.try_shutdown()


def test_an_insertion_is_followed_by_the_node(arm):
    from rcl_interfaces.srv import DescribeParameters, SetParameters
    from rclpy.parameter import Parameter
    from std_srvs.srv import Trigger

    # At 500 Hz, until the layer is known.
    end = int(np.searchsorted(RUN.signals.t_s, RUN.truth.ruptures[-1].end_s + 4.0))
    signals = cut(RUN.signals, slice(0, end, 2))
    reliable = ("--ros-args", "-p", "reliable:=true")
    with subprocess.Popen(command("ros2", "--robot", "lwr", *reliable)) as node:
        try:
            described = arm.ask(
                DescribeParameters, "describe_parameters", names=["queue_depth"]
            )
            tried = [
                arm.ask(
                    SetParameters,
                    "set_parameters",
                    parameters=[Parameter(name, value=value).to_parameter_msg()],
                ).results[0]
                for name, value in (
                    ("silence_s", 1000.0),
                    ("queue_depth", 5),
                    ("silence_s", 2.0),
                )
            ]
            wrenches = arm.answers["wrench"]
            for row, t_s in enumerate(signals.t_s.tolist()):
                if row == np.searchsorted(signals.t_s, RUN.tare_end_s):
                    tare = arm.call(Trigger, "tare")
                if row % 100 == 0:
                    gripper = np.zeros(2)
                    arm.send(0.0, gripper, gripper, gripper, ("finger_1", "finger_2"))
                arm.send_row(signals, row, 1.0 + t_s)
                # No more wait in the node than its queue holds.
                arm.wait_until(lambda row=row: row - len(wrenches) < 300)
            arm.wait_until(lambda: len(wrenches) == len(signals.t_s))
            arm.wait_until(
                lambda: arm.answers["layers"] and arm.answers["layers"][-1].status
            )
            assert arm.transit(SHUTDOWN)
            assert node.wait(30.0) == 0
        finally:
            node.kill()
    stamps_s = [
        one.header.stamp.sec + 1e-9 * one.header.stamp.nanosec for one in wrenches
    ]
    force_N = np.array([one.wrench.force.z for one in wrenches])
    first = int(np.searchsorted(signals.t_s, RUN.truth.contact_s))
    events = [status for array in arm.answers["events"] for status in array.status]
    kinds = [event.name for event in events]
    rupture = events[kinds.index("rupture")]
    values = {pair.key: pair.value for pair in rupture.values}
    [true] = RUN.truth.ruptures

    assert "wait" in described.descriptors[0].description
    assert [result.successful for result in tried] == [False, False, True]
    assert np.allclose(stamps_s, 1.0 + signals.t_s)
    # Tissue pushes against the z axis of the needle.
    assert -force_N[first:].min() == pytest.approx(
        true.drop_N + true.friction_N, abs=0.15
    )
    assert tare.result().success
    assert kinds[0] == "tared"
    assert values["layer"] == "1"
    assert float(values["probability"]) > 0.9
    [layer] = arm.answers["layers"][-1].status
    layer_values = {pair.key: pair.value for pair in layer.values}
    assert layer.name == "layer 1"
    assert float(layer_values["stiffness_N_per_m"]) > 0.0


@pytest.mark.parametrize("setting", ["queue_depth:=0", "gain_per_s:=70"])
def test_a_node_with_a_wrong_parameter_does_not_start(setting):
    arguments = ("ros2", "--robot", "lwr", "--ros-args", "-p", setting)
    done = subprocess.run(
        command(*arguments), capture_output=True, text=True, timeout=240
    )

    assert done.returncode == 2
    assert setting.partition(":")[0] in done.stderr


def test_a_manager_configures_activates_and_deactivates_the_node(arm):
    arguments = ("ros2", "--robot", "lwr", "--ros-args", "-p", "autostart:=false")
    with subprocess.Popen(command(*arguments), stderr=subprocess.DEVNULL) as node:
        try:
            steps = [
                (arm.transit(number), arm.rest(0.5) and arm.rest(0.5) > 0)
                for number in (
                    *(ACTIVATE, CONFIGURE, ACTIVATE, DEACTIVATE, ACTIVATE),
                    *(DEACTIVATE, CLEANUP, CONFIGURE, ACTIVATE),
                )
            ]
        finally:
            node.kill()

    is_made, is_answered = zip(*steps, strict=True)
    assert is_made == (False, *[True] * 8)
    assert list(map(bool, is_answered)) == [0, 0, 1, 0, 1, 0, 0, 0, 1]


def test_an_arm_on_a_topic_is_recorded_with_the_signals_that_it_sends(arm, tmp_path):
    path = tmp_path / "arm.csv"
    options = ("-o", str(path), "--robot", "lwr", "--seconds", "0.5")
    with subprocess.Popen(
        command("record", "ros2:/joint_states", *options)
    ) as recording:
        row = 0
        while recording.poll() is None:
            arm.send_row(RUN.signals, row, RUN.signals.t_s[row])
            row += 1
            time.sleep(1e-3)

    log = read_log(path, required=["q", "tau"])
    first = int(np.argmin(np.abs(RUN.signals.q_rad - log["q_rad"][0]).sum(axis=1)))
    assert recording.returncode == 0
    assert len(log.t_s) > 100
    assert np.array_equal(log["q_rad"][0], RUN.signals.q_rad[first])
    assert log.t_s[-1] == pytest.approx(0.5, abs=0.1)


def test_an_arm_that_sends_nothing_is_an_error_with_the_topic(tmp_path, capsys):
    options = ("-o", str(tmp_path / "arm.csv"), "--robot", "lwr")

    assert main(["record", "ros2:/nobody", *options]) == 2
    assert "/nobody" in capsys.readouterr().err


@pytest.fixture
def controller():
    """A velocity controller at 100 Hz that moves by what came five cycles ago."""
    import rclpy
    from rclpy.executors import SingleThreadedExecutor
    from std_msgs.msg import Float64MultiArray

    arm = Arm()
    name = "forward_velocity_controller"
    node = rclpy.create_node(name, context=arm.context)
    node.declare_parameter("joints", list(JOINTS[::-1]))
    node.declare_parameter("interface_name", "velocity")
    arm.q_rad = np.zeros(7)
    arm.velocities = [np.zeros(7)]
    waiting = deque([np.zeros(7)] * 5)
    stepped_s = time.time()

    def take(message):
        arm.velocities.append(np.array(message.data)[::-1])

    def step():
        nonlocal stepped_s
        now_s = time.time()
        waiting.append(arm.velocities[-1])
        velocity_rad_s = waiting.popleft()
        arm.q_rad = arm.q_rad + (now_s - stepped_s) * velocity_rad_s
        stepped_s = now_s
        arm.send(now_s, arm.q_rad, velocity_rad_s, np.zeros(7))

    # As a real-time controller: only the latest command counts, however late it comes.
    node.create_subscription(Float64MultiArray, "~/commands", take, 1)
    node.create_timer(0.01, step)
    executor = SingleThreadedExecutor(context=arm.context)
    executor.add_node(node)
    thread = Thread(target=executor.spin, daemon=True)
    thread.start()
    yield arm
    executor.shutdown()
    arm.context.try_shutdown()
    thread.join()


def test_the_delay_of_an_arm_of_ros_2_is_measured(controller, capsys):
    arguments = ["lag", "ros2:/joint_states", "--robot", "lwr", "--yes", "--json"]
    # On a busy machine states stay away for 0.1 s, and a command is refused.
    results = [
        json.loads(capsys.readouterr().out) for _ in range(3) if main(arguments) == 0
    ]

    def delay_ms(result):
        return np.median([joint["delay_ms"] for joint in result["joints"]])

    # Five cycles of 10 ms and the way; what else the machine does only adds to it.
    quickest = min(results, key=delay_ms)
    assert 35.0 < delay_ms(quickest) < 100.0
    assert quickest["cycle_ms"] == pytest.approx(10.0, abs=2.0)
    for joint in quickest["joints"]:
        assert joint["followed"] == pytest.approx(1.0, abs=0.2)
    assert not controller.velocities[-1].any()


def test_an_arm_moves_and_stops_through_ros_2(controller):
    from needleforce.ros2.arm import Ros2Arm

    options = {"takes_commands": True, "robot": RUN.robot}
    positions_rad = []
    # A second with commands, three without.
    with Ros2Arm("/joint_states", JOINTS, **options) as arm:
        for number, reading in zip(range(400), arm, strict=False):
            positions_rad.append(reading.q_rad)
            if number < 100:
                arm.send(SPEED_rad_s)
    time.sleep(0.5)
    moved_rad = positions_rad[-1] - positions_rad[0]

    assert not controller.velocities[-1].any()
    assert np.ptp(positions_rad[-20:], axis=0).max() == 0.0
    # A second, less the time until the first was taken.
    assert (moved_rad > 0.5 * SPEED_rad_s).all()
    assert np.allclose(moved_rad / moved_rad[0], SPEED_rad_s / 0.1, rtol=0.2)
