"""Settings of the virtual force sensor, validated once, and the two presets."""

from dataclasses import dataclass, field
from typing import Literal, get_args

import numpy as np

from residual.bias.model import BiasPrior, TareKind
from residual.checks.input import check_choice, check_positive
from residual.errors import FRICTION_OF_JOINTS, ConfigurationError
from residual.joint_friction import FrictionModel
from residual.momentum_observer import Alignment
from residual.tool_kinematics import check_offset, unit_axis
from residual.velocity_filter import VelocityEstimator

Mode = Literal["axial", "point", "full"]
"""What is assumed of the contact: ``axial``, a force along the needle; ``point``, a 3-D
force at the frame's origin; ``full``, a 6-D wrench, force and torque."""

Axes = Literal["base", "tool"]
"""Axes in which a wrench is given."""

Weighting = Literal["covariance", "none"]
"""How joints are weighted in the least squares of the wrench."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorConfig:
    """How joint signals become a force.

    Attributes:
        gain_per_s: Observer gain K [1/s], one for all joints or one each; 1/K is the
            lag.
        alignment: How torque fills a tick: ``trapezoid`` for a sampled sensor, ``hold``
            for a command held until the next sample.
        velocity_bandwidth_per_s: Of the velocity estimate used when ``dq`` is None
            [1/s].
        smooth_momentum: Smooth the momentum of an arm that hardly accelerates, see
            `residual.momentum_observer.momentum_smoothing_step`.
        force_bandwidth_per_s: Of the force's smoothing while it stays within its noise
            [1/s], see `residual.wrench_estimator.smoothing_step`; None for none.
        friction: Joint friction between torque sensor and link, if any is modelled.
        mode: What is assumed of the contact: ``point``, a force in any direction;
            ``axial``, one along the needle, into which a lateral force leaks; ``full``,
            force and torque.
        weighting: ``covariance``: by what the tare has learnt of each joint; ``none``:
            the plain pseudo-inverse of equation (13).
        frame: Frame of the wrench; the robot's tool frame when None.
        axes: Axes of force and torque.
        insertion_axis: Insertion direction in the frame.
        tool_offset_m: Where the needle's tip is in the frame [m]: force, depth and
            lever arms are the tip's, without a change of the robot's description.
        torque_is_gravity_compensated: The measured torque leaves gravity out, as some
            drivers report it: g(q) is added back. Not for the external torque of a
            robot's own estimate (Panda's ``tau_ext_hat_filtered``), which goes to
            ``update_external_torque``.
        expected_force_N: Size of force beyond which an estimate is drawn to zero where
            the joints cannot see it (damping near singular poses, not without
            weighting); None for no damping.
        tare: Kind of offset removal.
        tare_window_s: Only this much of the past enters a tare [s]; None for all of it.
        prior: What the residual may be off by before data.
        contact_force_N: Smallest axial force for which a tare is refused [N].
        guard: Hold back spikes and frozen or saturated torques, see
            `residual.checks.outliers`.
        max_gap_s: Longest time step that is integrated [s]; after a longer one filters
            restart.

    Raises:
        ConfigurationError: For a setting that cannot be: a number that is not finite
            and positive, a choice that does not exist, an axis of no direction, a
            switch that is neither true nor false.
    """

    gain_per_s: float | tuple[float, ...] = 70.0
    alignment: Alignment = "trapezoid"
    velocity_bandwidth_per_s: float = 200.0
    smooth_momentum: bool = True
    force_bandwidth_per_s: float | None = 30.0
    friction: FrictionModel | None = None
    mode: Mode = "point"
    weighting: Weighting = "covariance"
    frame: str | None = None
    axes: Axes = "base"
    insertion_axis: tuple[float, float, float] = (0.0, 0.0, 1.0)
    tool_offset_m: tuple[float, float, float] = (0.0, 0.0, 0.0)
    torque_is_gravity_compensated: bool = False
    expected_force_N: float | None = 100.0
    tare: TareKind = "model"
    tare_window_s: float | None = None
    prior: BiasPrior = field(default_factory=BiasPrior)
    contact_force_N: float = 0.25
    guard: bool = True
    max_gap_s: float = 0.1

    def __post_init__(self) -> None:
        self._check_numbers()
        for name in ("smooth_momentum", "guard", "torque_is_gravity_compensated"):
            value = getattr(self, name)
            if not isinstance(value, bool | np.bool_):
                raise ConfigurationError(f"{name} is {value!r}, expected True or False")
        for name, choices in (
            ("alignment", Alignment),
            ("mode", Mode),
            ("weighting", Weighting),
            ("axes", Axes),
            ("tare", TareKind),
        ):
            check_choice(name, getattr(self, name), get_args(choices))
        if not isinstance(self.prior, BiasPrior):
            raise ConfigurationError(f"prior is {self.prior!r}, expected a BiasPrior")
        if self.friction is not None and not hasattr(self.friction, "torque"):
            raise ConfigurationError(
                f"friction is {self.friction!r}, expected a JointFriction or another "
                "object that gives a torque(dq), or None",
                FRICTION_OF_JOINTS,
            )
        unit_axis(self.insertion_axis)
        check_offset(self.tool_offset_m)

    def _check_numbers(self) -> None:
        gains = self.gain_per_s if isinstance(self.gain_per_s, tuple) else ()
        for gain in gains or (self.gain_per_s,):
            check_positive("gain_per_s", gain)
        for name in ("contact_force_N", "max_gap_s"):
            check_positive(name, getattr(self, name))
        for name in ("tare_window_s", "force_bandwidth_per_s"):
            if getattr(self, name) is not None:
                check_positive(name, getattr(self, name))
        check_positive(
            "velocity_bandwidth_per_s",
            self.velocity_bandwidth_per_s,
            minimum=VelocityEstimator.MIN_BANDWIDTH_PER_S,
            maximum=VelocityEstimator.MAX_BANDWIDTH_PER_S,
        )
        if self.expected_force_N is not None:
            # Its inverse square is calculated with.
            check_positive(
                "expected_force_N", self.expected_force_N, minimum=1e-6, maximum=1e9
            )

    @property
    def slowest_gain_per_s(self) -> float:
        """Smallest gain of any joint [1/s]: it sets the lag."""
        return float(np.min(self.gain_per_s))


DEFAULT = SensorConfig()
"""The settings of this package's own method."""

HAND_DRIVEN = SensorConfig(gain_per_s=15.0, smooth_momentum=False)
"""For a needle that a hand drives on an arm that sends no velocity: an unsteady motion
then reads as a force where the momentum is smoothed. Later by 0.05 s than `DEFAULT`,
and noisier at rest."""

PUBLISHED = SensorConfig(
    gain_per_s=5.0,
    smooth_momentum=False,
    force_bandwidth_per_s=None,
    mode="full",
    weighting="none",
    expected_force_N=None,
    tare="constant",
    tare_window_s=0.5,
    guard=False,
)
"""Section IV as published: K = 5 1/s, r_0 from just before contact, six-dimensional
(J')#."""
