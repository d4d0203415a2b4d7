"""As much of rclpy as the node and the arm use, in one process.

Messages are plain objects with whatever fields are set; topics are those of a `Graph`.
What it stands for is tested with the real one in `test_in_ros.py`.
"""

import sys
from collections import defaultdict
from contextlib import contextmanager, nullcontext
from enum import Enum
from types import ModuleType, SimpleNamespace

import pytest

ReliabilityPolicy = Enum("ReliabilityPolicy", ["BEST_EFFORT", "RELIABLE"])
DurabilityPolicy = Enum("DurabilityPolicy", ["TRANSIENT_LOCAL"])


class NothingWaits(nullcontext):
    """The handle of a subscription, entered as rclpy's: what it yields is None."""

    def take_message(self, kind, raw):
        return None


class Message(SimpleNamespace):
    """A message: fields that were not set are messages, too."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        value = Message()
        setattr(self, name, value)
        return value

    def __len__(self):
        return 0


def joint_state_of(names, at_s):
    """A joint state of an arm at rest."""
    sec, nanosec = divmod(round(1e9 * at_s), 10**9)
    zeros = [0.0] * len(names)
    return Message(
        header=Message(stamp=Message(sec=sec, nanosec=nanosec)),
        name=list(names),
        position=[0.1] * len(names),
        velocity=zeros,
        effort=zeros,
    )


class Graph:
    """Topics, with what was published on them, and all else that a node has."""

    def __init__(self):
        self.published = defaultdict(list)
        self.kinds = {}
        self.callbacks = defaultdict(list)
        self.waiting = []
        self.services = {}
        self.timers = {}
        self.parameters = {}
        self.said = []

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


def node_class(graph):  # noqa: C901 (one class)
    """The class of nodes of a graph."""

    class Node:
        context = None
        publishers = subscriptions = services = timers = ()

        def __init__(self, name, **_):
            self._values = {}

        def create_publisher(self, kind, topic, quality):
            topic = topic.replace("~", "/needleforce")
            graph.kinds[topic] = kind.__name__
            return SimpleNamespace(
                publish=lambda message: graph.put(topic, message),
                get_subscription_count=lambda: len(graph.callbacks[topic]),
            )

        def create_subscription(self, kind, topic, callback, quality):
            graph.callbacks["/" + topic.lstrip("/")].append(callback)
            return SimpleNamespace(handle=NothingWaits())

        def create_service(self, kind, name, callback, callback_group=None):
            graph.services[name] = callback

        def create_timer(self, period_s, callback):
            graph.timers[period_s] = callback

        def get_parameters_by_prefix(self, prefix):
            return graph.parameters

        def undeclare_parameter(self, name):
            pass

        def declare_parameter(self, name, default, descriptor):
            self._values[name] = graph.parameters.get(name, default)

        def get_parameter(self, name):
            return SimpleNamespace(value=self._values[name])

        def get_logger(self):
            say = graph.said.append
            return SimpleNamespace(info=say, warning=say, error=say)

        def get_clock(self):
            return SimpleNamespace(now=lambda: SimpleNamespace(nanoseconds=7 * 10**9))

        def get_fully_qualified_name(self):
            return "/needleforce"

        def resolve_topic_name(self, topic):
            return f"/{topic}"

    return Node


class AnyType(ModuleType):
    """A module of messages; each type of them is a `Message` of its name."""

    def __getattr__(self, name):
        if name.startswith("__"):
            raise AttributeError(name)
        return type(name, (Message,), {})


@contextmanager
def installed_ros(graph):
    """Let modules of this project import a ROS whose nodes are in a graph."""
    node = node_class(graph)
    executor = SimpleNamespace(
        add_node=lambda node: None,
        spin_once=lambda timeout_sec=0.0: graph.deliver(),
        spin_until_future_complete=lambda future, timeout_sec: None,
        shutdown=lambda: None,
    )

    def client(_node, name):
        answer = graph.services.get(name)
        return SimpleNamespace(
            wait_for_services=lambda timeout_s: answer is not None,
            get_parameters=lambda names: SimpleNamespace(
                done=lambda: True,
                result=lambda: SimpleNamespace(values=answer(names)),
            ),
        )

    def wait_for_message(kind, node, topic, qos_profile, time_to_wait):
        published = graph.published[topic]
        return bool(published), published[-1] if published else None

    context = SimpleNamespace(init=lambda args: None, try_shutdown=lambda: None)
    results = Enum("TransitionCallbackReturn", ["SUCCESS", "FAILURE"])
    contents = {
        "rclpy": {
            "Context": lambda: context,
            "create_node": node,
            "ok": lambda: True,
        },
        "rclpy.callback_groups": {"ReentrantCallbackGroup": object},
        "rclpy.exceptions": {"ParameterException": type("E", (Exception,), {})},
        "rclpy.executors": {
            "ExternalShutdownException": KeyboardInterrupt,
            "SingleThreadedExecutor": lambda **_: executor,
        },
        "rclpy.lifecycle": {"LifecycleNode": node, "TransitionCallbackReturn": results},
        "rclpy.parameter_client": {"AsyncParameterClient": client},
        "rclpy.qos": {
            "DurabilityPolicy": DurabilityPolicy,
            "QoSProfile": Message,
            "ReliabilityPolicy": ReliabilityPolicy,
        },
        "rclpy.task": {"Future": Message},
        "rclpy.wait_for_message": {"wait_for_message": wait_for_message},
    }
    modules = {name: ModuleType(name) for name in contents}
    for name, values in contents.items():
        vars(modules[name]).update(values)
    for package in ("diagnostic", "geometry", "sensor", "std"):
        modules[f"{package}_msgs"] = ModuleType(f"{package}_msgs")
        modules[f"{package}_msgs.msg"] = AnyType(f"{package}_msgs.msg")
    for name in ("rcl_interfaces", "std_srvs"):
        modules[name] = ModuleType(name)
        modules |= {f"{name}.{kind}": AnyType(name) for kind in ("msg", "srv")}
    with pytest.MonkeyPatch.context() as patch:
        for name, module in modules.items():
            patch.setitem(sys.modules, name, module)
        _forget_importers()
        yield graph
    _forget_importers()


def _forget_importers():
    """Let modules that bind rclpy be imported anew."""
    for name in ("arm", "node", "parameters"):
        sys.modules.pop(f"needleforce.ros2.{name}", None)
