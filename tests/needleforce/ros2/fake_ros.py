"""As much of ROS 2 as the node and the arm use, in one process and without rclpy.

Messages are plain objects with whatever fields are set; topics are those of a `Graph`.
"""

from collections import defaultdict
from types import SimpleNamespace
from unittest.mock import MagicMock

from needleforce.ros2.ros_modules import RosModules


class Message(SimpleNamespace):
    """A message: fields that were not set are messages, too."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        value = Message()
        setattr(self, name, value)
        return value


class Graph:
    """Topics, with what was published on them."""

    def __init__(self):
        self.published = defaultdict(list)
        self.kept = set()
        self.callbacks = defaultdict(list)
        self.waiting = []
        self.services = {}
        self.warnings = []

    def put(self, topic, *messages):
        """Publish messages; they are delivered when an executor spins."""
        for message in messages:
            self.published[topic].append(message)
            self.waiting += [(call, message) for call in self.callbacks[topic]]

    def deliver(self):
        """Hand out what waits."""
        waiting, self.waiting = self.waiting, []
        for call, message in waiting:
            call(message)


class Node:
    """A node of a graph."""

    def __init__(self, graph):
        self.graph = graph
        self.context = None
        self.timers = []

    def create_publisher(self, kind, topic, quality):
        topic = topic.replace("~", "/needleforce")
        if getattr(quality, "durability", None) == "transient local":
            self.graph.kept.add(topic)
        self.graph.published[topic] = []
        return SimpleNamespace(
            publish=lambda message: self.graph.put(topic, message),
            get_subscription_count=lambda: len(self.graph.callbacks[topic]),
        )

    def create_subscription(self, kind, topic, callback, quality):
        topic = "/" + topic.lstrip("/")
        if callback.__name__.startswith("_take"):  # the node's ask whence they come

            def call(message):
                callback(message, {})

        else:
            call = callback
        self.graph.callbacks[topic].append(call)
        if getattr(quality, "durability", None) == "transient local":
            self.graph.waiting += [(call, kept) for kept in self.graph.published[topic]]
        return SimpleNamespace(topic_name=topic, msg_type=kind, handle=MagicMock())

    def create_client(self, kind, name):
        answer = self.graph.services.get(name)
        return SimpleNamespace(
            wait_for_service=lambda timeout_sec: answer is not None,
            call_async=lambda request: SimpleNamespace(
                done=lambda: True, result=lambda: answer(request)
            ),
        )

    def destroy_subscription(self, subscription):
        self.graph.callbacks[subscription.topic_name].clear()

    def get_logger(self):
        return SimpleNamespace(
            info=lambda text: None, warning=self.graph.warnings.append
        )

    def get_clock(self):
        return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=7 * 10**9))

    def __getattr__(self, name):
        return MagicMock()


def fake_ros(graph):
    """Return the modules of a ROS whose only node is in a graph."""
    kinds = SimpleNamespace(
        QoSProfile=Message,
        DurabilityPolicy=SimpleNamespace(TRANSIENT_LOCAL="transient local"),
        ReliabilityPolicy=SimpleNamespace(BEST_EFFORT="best", RELIABLE="reliable"),
    )

    class Messages:
        """Any type of message is `Message`."""

        def __getattr__(self, name):
            return Message

    ros = RosModules(*(MagicMock() for _ in RosModules._fields))
    ros.rclpy.create_node = lambda name, **context: Node(graph)
    ros.executors.SingleThreadedExecutor = lambda **context: SimpleNamespace(
        add_node=lambda node: None,
        remove_node=lambda node: None,
        spin_once=lambda timeout_sec=0.0: graph.deliver(),
        shutdown=lambda: None,
    )
    messages = dict.fromkeys(
        ("diagnostic", "geometry", "sensor", "standard", "transforms"), Messages()
    )
    services = SimpleNamespace(GetParameters=SimpleNamespace(Request=Message))
    return ros._replace(qos=kinds, parameter_services=services, **messages)
