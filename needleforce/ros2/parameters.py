"""The parameters of the node: defaults, ranges, descriptions, checks."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from difflib import get_close_matches
from typing import Any, NamedTuple

from needleforce.ros2.errors import Ros2ParameterError

ParameterValue = bool | int | float | str
"""A value as ROS 2 has it; the types of a parameter and of its value are the same."""

RELIABILITIES = ("best_effort", "reliable")
"""How joint states may be subscribed to."""


class NumberRange(NamedTuple):
    """Numbers that a parameter may have, both ends included.

    Attributes:
        minimum: The smallest.
        maximum: The largest.
    """

    minimum: float
    maximum: float


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeParameter:
    """A parameter of the node.

    Attributes:
        name: Its name in ROS.
        default: Its value if it is not given; has its type.
        description: One sentence, as `ros2 param describe` shows it.
        range: Of a number.
        choices: Of a text; none if it may be any.
        is_read_only: Whether it is read at the start only.
    """

    name: str
    default: ParameterValue
    description: str
    range: NumberRange | None = None
    choices: tuple[str, ...] = ()
    is_read_only: bool = True

    def check(self, value: object) -> str:
        """Return why a value cannot be, in one sentence; empty if it can."""
        expected = self._describe_expected()
        if not self._has_type(value):
            kind = type(value).__name__
            return f"{self.name} is {value!r}, a {kind}; expected {expected}"
        if not self._is_in_range(value):
            return f"{self.name} is {value!r}; expected {expected}"
        return ""

    def convert(self, value: Any) -> ParameterValue:
        """Return a checked value in the parameter's type: 1 of a real number is 1.0."""
        return type(self.default)(value)

    def _has_type(self, value: object) -> bool:
        if isinstance(self.default, bool) or isinstance(value, bool):
            return isinstance(self.default, bool) and isinstance(value, bool)
        if isinstance(self.default, float):
            return isinstance(value, int | float)
        return isinstance(value, type(self.default))

    def _is_in_range(self, value: Any) -> bool:
        if self.choices:
            return value in self.choices
        if self.range is None:
            return True
        is_finite = math.isfinite(value)
        return is_finite and self.range.minimum <= value <= self.range.maximum

    def _describe_expected(self) -> str:
        if self.choices:
            return " or ".join(self.choices)
        if isinstance(self.default, bool):
            return "true or false"
        if self.range is None:
            return "a text"
        kind = "a whole number" if isinstance(self.default, int) else "a number"
        return f"{kind} from {self.range.minimum:g} to {self.range.maximum:g}"


PARAMETERS = (
    NodeParameter(
        name="external_torque_topic",
        default="",
        description="Topic of JointState whose effort is the arm's own estimate of the "
        "external torque [Nm], with the stamps of joint_states; empty to use the "
        "measured torque in the effort of joint_states.",
    ),
    NodeParameter(
        name="lbr_state_topic",
        default="",
        description="Topic of lbr_fri_idl/LBRState whose positions and external_torque "
        "are used in place of joint_states; empty to use joint_states.",
    ),
    NodeParameter(
        name="joint_pattern",
        default="",
        description="Pattern that the names of the arm's joints fit, such as left_*, "
        "where two arms are on the topic; empty for any.",
    ),
    NodeParameter(
        name="frame_id",
        default="",
        description="Frame named in wrenches, at the needle's tip with z along the "
        "needle; empty for the tool frame of the robot's description.",
    ),
    NodeParameter(
        name="broadcast_tip",
        default=True,
        description="Whether the frame named in wrenches is broadcast on /tf_static, "
        "where the robot's description has no link of its name.",
    ),
    NodeParameter(
        name="gain_per_s",
        default=70.0,
        description="Gain K of the momentum observer [1/s]; the force lags by 1/K.",
        range=NumberRange(1.0, 500.0),
    ),
    NodeParameter(
        name="gravity_compensated",
        default=False,
        description="Whether the driver has already subtracted gravity from effort.",
    ),
    NodeParameter(
        name="queue_depth",
        default=1000,
        description="Joint states that wait for the node before the oldest is lost.",
        range=NumberRange(1, 100_000),
    ),
    NodeParameter(
        name="reliability",
        default="best_effort",
        description="How joint_states is subscribed to: best_effort hears every "
        "publisher; reliable asks again for what is lost, and hears reliable "
        "publishers only.",
        choices=RELIABILITIES,
    ),
    NodeParameter(
        name="autostart",
        default=True,
        description="Whether the node configures and activates itself at the start; "
        "false where a lifecycle manager does.",
    ),
    NodeParameter(
        name="tare_recording_s",
        default=4.0,
        description="Free motion that is recorded before a second tare [s].",
        range=NumberRange(1.0, 60.0),
    ),
    NodeParameter(
        name="silence_s",
        default=0.08,
        description="Time without a joint state after which diagnostics show an error "
        "[s].",
        range=NumberRange(0.01, 60.0),
        is_read_only=False,
    ),
)
"""All parameters of the node; the robot is described by options of the command."""


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeSettings:
    """Values of `PARAMETERS`, which describe them.

    Attributes:
        external_torque_topic: See `PARAMETERS`.
        lbr_state_topic: See `PARAMETERS`.
        joint_pattern: See `PARAMETERS`.
        frame_id: See `PARAMETERS`.
        broadcast_tip: See `PARAMETERS`.
        gain_per_s: See `PARAMETERS`.
        gravity_compensated: See `PARAMETERS`.
        queue_depth: See `PARAMETERS`.
        reliability: See `PARAMETERS`.
        autostart: See `PARAMETERS`.
        tare_recording_s: See `PARAMETERS`.
        silence_s: See `PARAMETERS`.
    """

    external_torque_topic: str
    lbr_state_topic: str
    joint_pattern: str
    frame_id: str
    broadcast_tip: bool
    gain_per_s: float
    gravity_compensated: bool
    queue_depth: int
    reliability: str
    autostart: bool
    tare_recording_s: float
    silence_s: float


def settings_from_values(values: Mapping[str, Any]) -> NodeSettings:
    """Return the settings of parameters that a user gives, defaults for the others.

    Raises:
        Ros2ParameterError: One is unknown, of another type, or out of its range.
    """
    known = {parameter.name: parameter for parameter in PARAMETERS}
    for name in values:
        if name not in known:
            raise Ros2ParameterError(_describe_unknown(name, tuple(known)))
    settings: dict[str, Any] = {}
    for name, parameter in known.items():
        value = values.get(name, parameter.default)
        problem = parameter.check(value)
        if problem:
            raise Ros2ParameterError(problem)
        settings[name] = parameter.convert(value)
    if settings["external_torque_topic"] and settings["lbr_state_topic"]:
        raise Ros2ParameterError(
            "external_torque_topic and lbr_state_topic both name a source of external "
            "torques; expected one of them"
        )
    return NodeSettings(**settings)


def _describe_unknown(name: str, known: tuple[str, ...]) -> str:
    """Return the sentence that refuses an unknown parameter."""
    similar = get_close_matches(name, known, n=1)
    expected = f"did you mean {similar[0]}" if similar else f"known: {', '.join(known)}"
    return f"there is no parameter {name}; {expected}"
