"""What stops a motion: force, side force, signals, commands, device; each says why.

Forces are judged ahead of time: from the reading and its rate to the force at which the arm will
have come to rest. A stiff contact is then noticed while it is still soft.
"""

import math
from dataclasses import dataclass, fields
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.control.errors import SettingError
from needleforce.control.ports import ArmSample
from needleforce.session import SessionEstimate
from residual import SensorWarning, Status

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyLimits:
    """What a motion must not exceed.

    Attributes:
        axial_N: Force against the motion along the needle.
        lateral_N: Force across the needle.
        free_N: Change of the axial force in free motion before the tare, when its zero is unknown.
        lost_s: Time of bad samples beyond that of valid ones.
        late_s: Longest time without a sample.
        refused_s: Time of refused commands.
        device_s: Longest time without news of the haptic device in teleoperation.
        tracking_rad: Joint motion within a fifth of a second that was not commanded, or not made.
        reaction_s: Time from a decision to the arm at rest, over which forces are predicted.

    Raises:
        SettingError: A limit is not a positive number.
    """

    axial_N: float
    lateral_N: float = 1.0
    free_N: float = 15.0
    lost_s: float = 0.01
    late_s: float = 0.03
    refused_s: float = 0.005
    device_s: float = 0.05
    tracking_rad: float = 0.02
    reaction_s: float = 0.015

    def __post_init__(self) -> None:
        """Check every limit."""
        for field in fields(self):
            value = getattr(self, field.name)
            if not (isinstance(value, int | float) and 0.0 < value < math.inf):
                raise SettingError(f"{field.name} is {value!r}, expected a positive number")


class Beside(NamedTuple):
    """What came beside a sample of the arm."""

    accepted: bool = True  # whether the arm took the last command
    command_rad_s: Array | None = None  # that command, shape (n,)
    axial_N: float | None = None  # of an F/T sensor, its bias and the needle's weight removed
    has_device: bool = False  # whether the haptic device has sent something new


NOTHING_BESIDE = Beside()


class Finding(NamedTuple):
    """What a monitor has found."""

    event: str  # "limit": stop; "fault": stop, and do not go on before a reset
    reason: str


_BROKEN = SensorWarning.FROZEN | SensorWarning.VELOCITY
_UNUSABLE = (
    SensorWarning.JOINT_LIMIT
    | SensorWarning.NEAR_SINGULAR
    | SensorWarning.MODEL_MISMATCH
    | SensorWarning.TARE_EXPIRED
)
_IN_AIR = ("guidance", "approach", "tare")
"""States in which the needle is in free air and the sensor need not be tared."""
_AT_TISSUE = ("teleop", "insertion", "dwell", "withdraw")
_RATE_S = 0.01
"""Time constant of the force's rate: shorter than the lag of the virtual sensor."""
_TRACKING_S, _TRACKING_LAG_S = 0.2, 0.03
"""Memory of the comparison, and time by which an arm may follow its command."""
_CLEAR_S = 0.1
"""A fault must be gone for so long before a reset."""


class Monitors:
    """Watch every sample, command and device.

    Attributes:
        has_device: Whether the haptic device has sent something of late.
        is_healthy: Whether no fault has been seen of late.
    """

    def __init__(self, limits: SafetyLimits) -> None:
        self._limits = limits
        self._bad_s = self._refused_s = self._rate_N_per_s = 0.0
        self._device_s = self._clear_s = math.inf
        self._entry_axial_N = self._entry_lateral_N = 0.0
        self._axial_N: float | None = None
        self._position: Array | None = None
        self._off_rad: Array | float = 0.0

    @property
    def has_device(self) -> bool:
        """See the class."""
        return self._device_s <= self._limits.device_s

    @property
    def is_healthy(self) -> bool:
        """See the class."""
        return self._clear_s >= _CLEAR_S

    def enter(self, estimate: SessionEstimate | None) -> None:
        """A new state begins: commands and forces are compared with what they are now."""
        self._refused_s, self._off_rad = 0.0, 0.0
        if estimate is not None:
            self._entry_axial_N = estimate.wrench.axial
            self._entry_lateral_N = estimate.wrench.lateral

    def update(
        self,
        state: str,
        watched: tuple[SessionEstimate, ArmSample, Beside],
        step_s: float,
        lag_s: float,
    ) -> Finding | None:
        """The gravest finding in one cycle; None if all is well.

        Args:
            state: Of the manager.
            watched: What the session says of a sample, the sample, and what came beside it.
            step_s: Time since the last sample, or the one before that where its clock was set.
            lag_s: Time by which the session's force is late.
        """
        estimate, sample, beside = watched
        self._device_s = 0.0 if beside.has_device else self._device_s + step_s
        fault = f"no sample for {1e3 * sample.dt_s:.0f} ms"
        if not sample.dt_s > self._limits.late_s:
            fault = self._signals(estimate, step_s) or self._commands(*watched, step_s)
        self._clear_s = 0.0 if fault else self._clear_s + step_s
        if fault:
            return Finding("fault", fault)
        stop = self._forces(state, estimate, beside, step_s, lag_s)
        if state == "teleop" and not self.has_device:
            stop = f"the haptic device has been silent for {1e3 * self._device_s:.0f} ms"
        return Finding("limit", stop) if stop else None

    def _signals(self, estimate: SessionEstimate, step_s: float) -> str:
        """Why the arm's signals cannot be relied on."""
        is_bad = estimate.status is Status.REJECTED
        self._bad_s = max(self._bad_s + (step_s if is_bad else -step_s), 0.0)
        if self._bad_s > self._limits.lost_s:
            return f"bad samples for {1e3 * self._bad_s:.0f} ms: {estimate.wrench.message}"
        return estimate.wrench.message if estimate.warnings & _BROKEN and not is_bad else ""

    def _commands(
        self, estimate: SessionEstimate, sample: ArmSample, beside: Beside, step_s: float
    ) -> str:
        """Why the arm does not do what it is asked to."""
        limits, command = self._limits, beside.command_rad_s
        self._refused_s = 0.0 if beside.accepted else self._refused_s + step_s
        if self._refused_s > limits.refused_s:
            return f"the arm has refused commands for {1e3 * self._refused_s:.0f} ms"
        if command is None or estimate.status is Status.REJECTED:
            return ""
        position = np.array(sample.q_rad, dtype=np.float64)
        moved = position - (position if self._position is None else self._position)
        self._position = position
        kept = math.exp(-step_s / _TRACKING_S)
        self._off_rad = kept * (self._off_rad + moved - step_s * command)
        beyond = np.abs(self._off_rad) - _TRACKING_LAG_S * np.abs(command)
        joint = int(np.argmax(beyond))
        if beyond[joint] <= limits.tracking_rad:
            return ""
        return f"joint index {joint} is {self._off_rad[joint]:.3g} rad off what was commanded"

    def _forces(
        self, state: str, estimate: SessionEstimate, beside: Beside, step_s: float, lag_s: float
    ) -> str:
        """Which force is, or will be, beyond its limit."""
        limits, wrench = self._limits, estimate.wrench
        axial_N, lead_s = wrench.axial, lag_s + limits.reaction_s
        if beside.axial_N is not None:
            axial_N, lead_s = beside.axial_N, limits.reaction_s
        rise_N = 0.0 if self._axial_N is None else axial_N - self._axial_N
        weight = -math.expm1(-step_s / _RATE_S)
        self._rate_N_per_s += weight * (rise_N / step_s - self._rate_N_per_s)
        self._axial_N = axial_N
        ahead_N = axial_N + lead_s * self._rate_N_per_s
        if state in _IN_AIR:
            change_N = abs(wrench.axial - self._entry_axial_N)
            return f"axial force changed by {change_N:.1f} N" if change_N > limits.free_N else ""
        if state not in _AT_TISSUE:
            return ""
        if estimate.warnings & _UNUSABLE:
            return wrench.message
        against = max(axial_N, ahead_N), max(-axial_N, -ahead_N)
        most_N = against[1] if state == "withdraw" else against[0]
        if state == "teleop":
            most_N = max(against)
        if most_N > limits.axial_N:
            return f"axial force {axial_N:.2f} N, {most_N:.2f} N ahead; limit {limits.axial_N:g} N"
        least_N = self._entry_lateral_N if state == "withdraw" else 0.0
        if wrench.lateral > limits.lateral_N + least_N:
            return f"side force {wrench.lateral:.2f} N, limit {limits.lateral_N + least_N:g} N"
        return ""
