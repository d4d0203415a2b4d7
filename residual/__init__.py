"""Joint signals to external joint torque to wrench: the virtual force/torque sensor.

Reading order: `momentum_observer` (the equation and the residual), `sample_stream`
(samples to residual), `bias` (what the residual reads without contact),
`wrench_estimator` (equation 13), `checks` (what is no measurement, such as a NaN, and
when an estimate may be wrong), `virtual_force_sensor` (all of it in two calls).
"""

from residual.bias.model import BiasPrior
from residual.config import DEFAULT, HAND_DRIVEN, PUBLISHED, SensorConfig
from residual.errors import (
    ConfigurationError,
    ResidualError,
    SampleError,
    SnapshotError,
    TareError,
)
from residual.estimate import SensorWarning, Status, WrenchEstimate
from residual.joint_friction import FrictionModel, JointFriction, SigmoidFriction
from residual.momentum_observer import MomentumObserver
from residual.tool_kinematics import ToolKinematics
from residual.velocity_filter import VelocityEstimator
from residual.virtual_force_sensor import SensorState, VirtualForceSensor
from residual.wrench_estimator import WrenchEstimator

__all__ = [
    "DEFAULT",
    "HAND_DRIVEN",
    "PUBLISHED",
    "BiasPrior",
    "ConfigurationError",
    "FrictionModel",
    "JointFriction",
    "MomentumObserver",
    "ResidualError",
    "SampleError",
    "SensorConfig",
    "SensorState",
    "SensorWarning",
    "SigmoidFriction",
    "SnapshotError",
    "Status",
    "TareError",
    "ToolKinematics",
    "VelocityEstimator",
    "VirtualForceSensor",
    "WrenchEstimate",
    "WrenchEstimator",
]
