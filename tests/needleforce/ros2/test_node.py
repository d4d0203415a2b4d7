"""The node with the user's ROS 2 and an arm in another process.

Skipped, saying so, where this Python cannot import rclpy; `.ci/run` has an environment
with it.
"""

import json
import os
import subprocess
import sys
import time
from importlib.util import find_spec
from pathlib import Path

import numpy as np
import pytest

from needleforce.recordings import read_log
from tests.insertion_run import cut, short_run

pytestmark = pytest.mark.skipif(
    find_spec("rclpy") is None, reason="no rclpy: source a ROS 2 to test the node"
)
ROOT = Path(__file__).resolve().parents[3]
ARM = Path(__file__).with_name("arm_process.py")
FRAME = "needle_tip"
DOMAIN = str(50 + os.getpid() % 150)
"""Beside the domain that a user's own nodes are in."""


def ros_environment():
    """Of processes that hear each other only."""
    return {
        **os.environ,
        "ROS_DOMAIN_ID": DOMAIN,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOCALHOST_ONLY": "1",
        "PYTHONPATH": str(ROOT),
    }


def sent_signals():
    """The short insertion at 500 Hz, until its layer is known."""
    run = short_run()
    end = int(np.searchsorted(run.signals.t_s, run.truth.ruptures[-1].end_s + 4.0))
    return cut(run.signals, slice(0, end, 2))


def node_command(*arguments):
    return [sys.executable, "-m", "needleforce", "ros2", "--robot", "lwr", *arguments]


@pytest.fixture(scope="module")
def signals(tmp_path_factory):
    """File of the signals that the arm sends."""
    folder = tmp_path_factory.mktemp("ros2")
    run = short_run()
    sent = sent_signals()
    np.savez(
        folder / "signals.npz",
        t_s=sent.t_s,
        q_rad=sent.q_rad,
        dq_rad_s=sent.dq_rad_s,
        tau_Nm=sent.tau_Nm,
        names=np.array(run.robot.joint_names),
        tare=int(np.searchsorted(sent.t_s, run.tare_end_s)),
    )
    return folder / "signals.npz"


@pytest.fixture(scope="module")
def answers(signals):
    """What an arm that replays an insertion gets back, and how the node ended."""
    output = signals.with_name("answers.json")
    with subprocess.Popen(
        node_command("--ros-args", "-p", "reliability:=reliable"),
        env=ros_environment(),
        stderr=subprocess.PIPE,
        text=True,
    ) as node:
        try:
            subprocess.run(
                [sys.executable, str(ARM), str(signals), str(output)],
                env=ros_environment(),
                timeout=600,
                check=True,
            )
            _, said = node.communicate(timeout=30)
        finally:
            node.kill()
    return {**json.loads(output.read_text()), "code": node.returncode, "said": said}


def last_diagnostics(answers):
    return answers["diagnostics"][-1]


def test_every_sample_that_arrived_is_answered_by_a_wrench_with_its_stamp(answers):
    stamps_ns = np.round(1e9 * (1.0 + sent_signals().t_s)).astype(int)
    answered_ns = np.array([row[0] for row in answers["wrench"]])
    values = last_diagnostics(answers)["values"]

    assert set(answered_ns) <= set(stamps_ns)
    assert np.unique(answered_ns).size == answered_ns.size
    assert answered_ns.size == int(values["used"]) - int(values["rejected"])
    assert answered_ns.size == stamps_ns.size
    assert int(values["lost"]) == 0


def test_the_wrench_is_at_the_tip_in_the_tool_frame(answers):
    run = short_run()
    force_N = np.array([row[1:] for row in answers["wrench"]])
    first = int(np.searchsorted(sent_signals().t_s, run.truth.contact_s))
    # Tissue pushes against the z axis of the needle.
    peak_N = -force_N[first:, 2].min()
    [rupture] = run.truth.ruptures

    assert answers["frame"] == FRAME
    assert peak_N == pytest.approx(rupture.drop_N + rupture.friction_N, abs=0.15)


def test_a_gripper_on_the_topic_is_passed_by(answers):
    assert int(last_diagnostics(answers)["values"]["other_joints"]) > 100


def test_a_service_tares_beside_the_samples_and_answers_at_the_end(answers):
    [[is_begun, reason]] = answers["begin_insertion"]
    kinds = [event["name"] for event in answers["events"]]

    assert answers["tare"] == [[True, "tared"]]
    assert kinds[0] == "tared"
    assert not is_begun
    assert "~/tare" in reason


def test_the_rupture_is_an_event_with_its_depth(answers):
    run = short_run()
    [event] = [event for event in answers["events"] if event["name"] == "rupture"]
    [rupture] = run.truth.ruptures
    alarm_s = 1e-9 * event["stamp_ns"] - 1.0

    assert "rupture of layer 1" in event["message"]
    assert event["values"]["layer"] == "1"
    assert float(event["values"]["probability"]) > 0.9
    assert rupture.onset_s < alarm_s < rupture.end_s + 0.1


def test_layers_and_tip_force_are_published(answers):
    [layer] = answers["layers"]

    assert layer["name"] == "layer 1"
    assert float(layer["values"]["thickness_m"]) > 0.0
    assert 0 < len(answers["tip_force"]) < len(answers["wrench"])


def test_parameters_are_described_and_refused_with_a_sentence(answers):
    too_long, fixed, taken = answers["set"]

    assert answers["descriptions"][0].startswith("Joint states that wait")
    assert too_long[1] is False
    assert "silence_s" in too_long[2]
    assert fixed[1] is False
    assert "queue_depth" in fixed[2]
    assert taken[1] is True


def test_the_service_stop_ends_the_node_with_its_counts(answers):
    [[is_stopped, text]] = answers["stop"]

    assert is_stopped
    assert "0 lost" in text
    assert answers["code"] == 0
    assert "0 lost" in answers["said"]


@pytest.mark.parametrize(
    ("setting", "message"),
    [
        ("queue_deph:=4", "there is no parameter queue_deph; did you mean queue_depth"),
        ("queue_depth:=0", "queue_depth is 0; expected a whole number from 1"),
        ("reliability:=maybe", "expected best_effort or reliable"),
    ],
)
def test_a_node_with_a_wrong_parameter_does_not_start(setting, message):
    done = subprocess.run(
        node_command("--ros-args", "-p", setting),
        env=ros_environment(),
        capture_output=True,
        text=True,
        timeout=240,
    )

    assert done.returncode == 2
    assert message in done.stderr


class Manager:
    """A lifecycle manager, beside an arm at rest that sends 200 times a second."""

    def __init__(self):
        import rclpy
        from geometry_msgs.msg import WrenchStamped
        from lifecycle_msgs.srv import ChangeState, GetState
        from sensor_msgs.msg import JointState

        self.context = rclpy.Context()
        self.context.init(args=[])
        self.node = rclpy.create_node("manager", context=self.context)
        self.executor = rclpy.executors.SingleThreadedExecutor(context=self.context)
        self.executor.add_node(self.node)
        self.change = self.node.create_client(ChangeState, "/needleforce/change_state")
        self.state = self.node.create_client(GetState, "/needleforce/get_state")
        self.requests = ChangeState.Request, GetState.Request
        self.state_type = JointState
        self.states = self.node.create_publisher(JointState, "joint_states", 10)
        self.wrenches = []
        self.node.create_subscription(
            WrenchStamped, "/needleforce/wrench", self.wrenches.append, 10
        )
        self.node.create_timer(5e-3, self.send)

    def send(self):
        run = short_run()
        message = self.state_type(name=list(run.robot.joint_names))
        now_ns = self.node.get_clock().now().nanoseconds
        message.header.stamp.sec, message.header.stamp.nanosec = divmod(now_ns, 10**9)
        message.position = run.signals.q_rad[0].tolist()
        message.velocity = [0.0] * 7
        message.effort = run.signals.tau_Nm[0].tolist()
        self.states.publish(message)

    def spin(self, seconds):
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            self.executor.spin_once(timeout_sec=0.1)

    def ask(self, client, request):
        assert client.wait_for_service(timeout_sec=240.0)
        future = client.call_async(request)
        self.executor.spin_until_future_complete(future, timeout_sec=240.0)
        return future.result()

    def transit(self, number):
        """Begin a transition; return whether it was made, and the state."""
        request = self.requests[0]()
        request.transition.id = number
        answer = self.ask(self.change, request)
        state = self.ask(self.state, self.requests[1]())
        self.spin(0.5)  # what was on its way has come
        self.wrenches.clear()
        self.spin(1.0)
        return answer.success, state.current_state.label, bool(self.wrenches)


@pytest.mark.slow
def test_a_manager_configures_activates_and_deactivates_the_node(monkeypatch):
    configure, cleanup, activate, deactivate = range(1, 5)
    monkeypatch.setenv("ROS_DOMAIN_ID", DOMAIN)
    monkeypatch.setenv("ROS_AUTOMATIC_DISCOVERY_RANGE", "LOCALHOST")
    with subprocess.Popen(
        node_command("--ros-args", "-p", "autostart:=false"),
        env=ros_environment(),
        stderr=subprocess.DEVNULL,
    ) as node:
        manager = Manager()
        try:
            steps = [
                manager.transit(number)
                for number in (
                    *(activate, configure, activate, deactivate, activate),
                    *(deactivate, cleanup, configure, activate),
                )
            ]
        finally:
            node.kill()
            manager.executor.shutdown()
            manager.context.try_shutdown()

    assert steps == [
        (False, "unconfigured", False),
        (True, "inactive", False),
        (True, "active", True),
        (True, "inactive", False),
        (True, "active", True),
        (True, "inactive", False),
        (True, "unconfigured", False),
        (True, "inactive", False),
        (True, "active", True),
    ]


def test_an_arm_on_a_topic_is_recorded_with_the_signals_that_it_sends(
    signals, tmp_path
):
    recording = tmp_path / "arm.csv"
    command = [sys.executable, "-m", "needleforce", "record", "ros2:/joint_states"]
    options = ["-o", str(recording), "--robot", "lwr", "--seconds", "0.5"]
    with subprocess.Popen(
        [sys.executable, str(ARM), str(signals)], env=ros_environment()
    ) as arm:
        done = subprocess.run(
            [*command, *options],
            env=ros_environment(),
            capture_output=True,
            text=True,
            timeout=240,
        )
        arm.kill()

    assert done.returncode == 0, done.stderr

    log = read_log(recording, required=["q", "tau"])
    sent_rad = sent_signals().q_rad
    first = int(np.argmin(np.abs(sent_rad - log["q_rad"][0]).sum(axis=1)))
    assert len(log.t_s) > 100
    assert np.array_equal(log["q_rad"][0], sent_rad[first])
    assert log.t_s[-1] == pytest.approx(0.5, abs=0.1)


def test_an_arm_that_sends_nothing_is_an_error_with_the_topic(tmp_path):
    done = subprocess.run(
        [
            *(sys.executable, "-m", "needleforce", "record", "ros2:/nobody"),
            *("-o", str(tmp_path / "arm.csv"), "--robot", "lwr"),
        ],
        env=ros_environment(),
        capture_output=True,
        text=True,
        timeout=240,
    )

    assert done.returncode == 2
    assert "/nobody: no joint state has come within 10 s" in done.stderr
