"""Loss and delay of the ROS 2 node beside an arm that sends at 1 kHz for 30 s.

``python -m benchmarks.performance.ros2_node`` with rclpy importable. An insertion in
the simulated arm is replayed by this process, the node is another one: it tares by its
service and reports the rupture. Delays are from the stamp, given when a sample is
published, to when the middleware receives the answer.
"""

import json
import os
import subprocess
import sys
from collections.abc import Callable
from time import perf_counter, sleep, time_ns
from typing import Any, NamedTuple

import numpy as np

from benchmarks import BenchmarkError
from foundation.arrays import Array
from groundtruth import simulate
from needleforce.ros2.messages import fill_stamp
from needleforce.ros2.ros_modules import RosModules, import_ros

SCENARIO = "gel-25-constant"
PLANT = "clean"
PERIOD_S = 1e-3
DURATION_S = 30.0
BEFORE_TARE_S = 8.0
"""Motion in free air that is replayed before the tare."""

MAX_START_S = 300.0
"""For which a node that compiles first is waited for."""

OUTLASTING_S = 2.0
"""For which answers are waited for after the last sample."""

DOMAIN = "87"
"""Of ROS: the two processes hear each other only."""

DEPTH = 1000
MAX_LOST_PERCENT = 0.1
MAX_EVENT_MS = 100.0
NS_PER_MS = 1e6


class LinkResult(NamedTuple):
    """What a run of the node has shown.

    Attributes:
        sent: Samples published.
        late: Samples published more than a period late, by this process.
        answered: Wrenches that came back.
        delay_ms: From stamp to wrench, shape (answered,).
        event_ms: From the stamp of the sample that raised the alarm to the event; NaN
            if no rupture was reported.
        tare: What the service answered.
    """

    sent: int
    late: int
    answered: int
    delay_ms: Array
    event_ms: float
    tare: str

    def describe(self) -> dict[str, Any]:
        """Return the numbers by name, the limits beside them."""
        lost_percent = 100.0 * (1.0 - self.answered / self.sent)
        median_ms, high_ms, worst_ms = np.percentile(self.delay_ms, [50, 99, 100])
        return {
            "sent": self.sent,
            "late by this process": self.late,
            "lost %": round(lost_percent, 3),
            f"lost at most {MAX_LOST_PERCENT} %": lost_percent <= MAX_LOST_PERCENT,
            "delay median ms": round(median_ms, 2),
            "delay 99 % ms": round(high_ms, 2),
            "delay worst ms": round(worst_ms, 2),
            "rupture event ms": round(self.event_ms, 2),
            f"event within {MAX_EVENT_MS:g} ms": self.event_ms <= MAX_EVENT_MS,
            "tare": self.tare,
            "load of the machine": round(os.getloadavg()[0], 1),
        }


class ReplayedArm:
    """The arm: publishes an insertion and takes what comes back.

    Args:
        ros: The modules of ROS 2.
    """

    def __init__(self, ros: RosModules) -> None:
        run = simulate(SCENARIO, plant=PLANT)
        first = int(np.searchsorted(run.signals.t_s, run.tare_end_s - BEFORE_TARE_S))
        rows = slice(first, first + round(DURATION_S / PERIOD_S))
        sent = run.signals
        if sent.dq_rad_s is None:
            raise BenchmarkError(f"the arm of {SCENARIO} has no velocities")
        self._signals = [
            values[rows].tolist() for values in (sent.q_rad, sent.dq_rad_s, sent.tau_Nm)
        ]
        self._tare_index = round(BEFORE_TARE_S / PERIOD_S)
        self._ros = ros
        self._delay_ms: list[float] = []
        self._event_ms = float("nan")
        self._tare = "no answer"
        node = ros.rclpy.create_node("arm")
        self._executor = ros.executors.SingleThreadedExecutor()
        self._executor.add_node(node)
        self._message = ros.sensor.JointState(name=list(run.robot.joint_names))
        self._publisher = node.create_publisher(
            ros.sensor.JointState, "joint_states", DEPTH
        )
        subscribe = node.create_subscription
        wrench_type = ros.geometry.WrenchStamped
        subscribe(wrench_type, "/needleforce/wrench", self._take_wrench, DEPTH)
        event_type = ros.diagnostic.DiagnosticArray
        subscribe(event_type, "/needleforce/events", self._take_event, DEPTH)
        self._service = node.create_client(ros.services.Trigger, "/needleforce/tare")

    def _take_wrench(self, message: Any, info: Any) -> None:
        self._delay_ms.append(delay_ms(message, info))

    def _take_event(self, message: Any, info: Any) -> None:
        if message.status[0].name == "rupture":
            self._event_ms = delay_ms(message, info)

    def wait_for_node(self) -> None:
        """Wait until the node listens and serves."""
        end_s = perf_counter() + MAX_START_S
        while not self._is_node_there():
            if perf_counter() > end_s:
                raise BenchmarkError(f"no node within {MAX_START_S:g} s")
            sleep(0.1)

    def _is_node_there(self) -> bool:
        is_heard = self._publisher.get_subscription_count() > 0
        return is_heard and self._service.service_is_ready()

    def replay(self) -> LinkResult:
        """Publish the insertion in real time; return what came back."""
        late = 0
        samples = list(zip(*self._signals, strict=True))
        start_s = perf_counter()
        for k, (position, velocity, effort) in enumerate(samples):
            due_s = start_s + PERIOD_S * k
            late += perf_counter() > due_s + PERIOD_S
            while (left_s := due_s - perf_counter()) > 0.0:
                self._executor.spin_once(timeout_sec=left_s)
            if k == self._tare_index:
                future = self._service.call_async(self._ros.services.Trigger.Request())
                future.add_done_callback(self._note_tare)
            message = self._message
            message.position = position
            message.velocity = velocity
            message.effort = effort
            fill_stamp(message, time_ns())
            self._publisher.publish(message)
        end_s = perf_counter() + OUTLASTING_S
        while perf_counter() < end_s:
            self._executor.spin_once(timeout_sec=0.1)
        return LinkResult(
            sent=len(samples),
            late=late,
            answered=len(self._delay_ms),
            delay_ms=np.array(self._delay_ms),
            event_ms=self._event_ms,
            tare=self._tare,
        )

    def _note_tare(self, future: Any) -> None:
        self._tare = future.result().message


def delay_ms(message: Any, info: Any) -> float:
    """Return the time from a message's stamp to when it was received [ms]."""
    stamp = message.header.stamp
    stamp_ns = stamp.sec * 1_000_000_000 + stamp.nanosec
    return (info["received_timestamp"] - stamp_ns) / NS_PER_MS


def measure_link(
    arguments: tuple[str, ...], say: Callable[[str], object]
) -> LinkResult:
    """Run the node beside the replayed arm.

    Args:
        arguments: Of the node.
        say: Takes what is being done.
    """
    environment = {
        "ROS_DOMAIN_ID": DOMAIN,
        "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST",
        "ROS_LOCALHOST_ONLY": "1",
    }
    os.environ.update(environment)
    ros = import_ros()
    ros.rclpy.init(args=[])
    say("simulating")
    arm = ReplayedArm(ros)
    command = [sys.executable, "-m", "needleforce", "ros2", "--robot", "lwr"]
    with subprocess.Popen([*command, *arguments]) as node:
        try:
            say("waiting for the node")
            arm.wait_for_node()
            say(f"replaying {DURATION_S:g} s")
            return arm.replay()
        finally:
            node.terminate()
            ros.rclpy.try_shutdown()


def main() -> None:
    """Measure with the node's default parameters, or those given; print as JSON."""
    result = measure_link(
        tuple(sys.argv[1:]), lambda text: sys.stderr.write(f"{text}\n")
    )
    sys.stdout.write(json.dumps(result.describe(), indent=2) + "\n")


if __name__ == "__main__":
    main()
