"""The arm's description from its topic, as robot_state_publisher has it."""

import math
from time import monotonic
from typing import Any

from needleforce.ros2.errors import MissingDescriptionError
from needleforce.ros2.ros_modules import RosModules

TOPIC = "robot_description"

REMINDER_S = 5.0
"""Time between two log messages that say what is waited for."""

STEP_S = 0.1
"""Longest wait for a message before the time is looked at."""


def wait_for_description(ros: RosModules, node: Any, max_s: float = math.inf) -> str:
    """Return the URDF that is published on `robot_description`, once it is.

    Args:
        ros: The modules of ROS 2.
        node: Whose subscription it is; nothing else of it is served meanwhile.
        max_s: Longest wait.

    Raises:
        MissingDescriptionError: None came in that time.
    """
    texts: list[str] = []
    # It is published once, and kept for who comes later.
    kept = ros.qos.QoSProfile(
        depth=1, durability=ros.qos.DurabilityPolicy.TRANSIENT_LOCAL
    )
    subscription = node.create_subscription(
        ros.standard.String, TOPIC, lambda message: texts.append(message.data), kept
    )
    executor = ros.executors.SingleThreadedExecutor(context=node.context)
    executor.add_node(node)
    topic = subscription.topic_name
    begun_s = monotonic()
    reminded_s = begun_s
    try:
        while not any(texts):
            executor.spin_once(timeout_sec=STEP_S)
            now_s = monotonic()
            if now_s - begun_s > max_s:
                raise MissingDescriptionError(
                    f"{topic}: no description of the arm came within {max_s:g} s"
                )
            if now_s - reminded_s > REMINDER_S:
                reminded_s = now_s
                node.get_logger().warning(
                    f"waiting for {topic}, as robot_state_publisher publishes it; "
                    "--urdf FILE and --robot NAME describe the arm without it"
                )
    finally:
        executor.remove_node(node)
        node.destroy_subscription(subscription)
    return next(filter(None, texts))
