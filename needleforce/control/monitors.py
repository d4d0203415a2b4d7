"""What stops a motion: force, side force, signals, commands, device; each says why.

Forces are judged ahead of time: from the reading and its rate to the force at which the
arm will have come to rest. A stiff contact is then noticed while its force is still
small.
"""

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from needleforce.control.errors import SettingError, require_positive
from needleforce.control.ports import ArmSample, Array
from needleforce.control.tasks import vector
from residual.checks.input import as_float
from residual.estimate import SensorWarning, Status

if TYPE_CHECKING:
    from needleforce.session import InsertionSession, SessionEstimate


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyLimits:
    """What a motion must not exceed; `SettingError` for a limit that is no positive
    number.

    Attributes:
        axial_N: Force against the motion along the needle.
        lateral_N: Force across the needle.
        lost_s: Time of bad samples beyond that of valid ones.
        late_s: Longest time without a sample.
        refused_s: Time of refused commands.
    """

    axial_N: float
    lateral_N: float = 0.5
    lateral_s: float = (
        0.04  # for which it may act; a force twice that limit, half as long
    )
    free_N: float = (
        15.0  # change of the axial force in free air, where it may not be tared yet
    )
    lost_s: float = 0.006
    late_s: float = 0.03
    refused_s: float = 0.005
    device_s: float = (
        0.05  # longest time without news of the haptic device in teleoperation
    )
    tracking_rad: float = (
        0.05  # motion of a joint within a second that was not commanded
    )
    reaction_s: float = (
        0.015  # from a decision to the arm at rest: forces are predicted over it
    )

    def __post_init__(self) -> None:
        require_positive(asdict(self))


class Beside(NamedTuple):
    """What came beside a sample of the arm.

    Attributes:
        accepted: Whether the arm took the last command.
        command_rad_s: That command, shape (n,).
        has_device: Whether the haptic device has sent something new.
    """

    accepted: bool = True
    command_rad_s: Array | None = None
    axial_N: float | None = (
        None  # of an F/T sensor, its bias and the needle's weight removed
    )
    has_device: bool = False


NOTHING = Beside()

_BROKEN = SensorWarning.FROZEN | SensorWarning.VELOCITY
_UNUSABLE = (
    SensorWarning.JOINT_LIMIT
    | SensorWarning.NEAR_SINGULAR
    | SensorWarning.MODEL_MISMATCH
    | SensorWarning.TARE_EXPIRED
)
_IN_AIR = ("guidance", "approach", "tare")
_AT_TISSUE = ("teleop", "insertion", "dwell", "withdraw")
_DRIVEN = (
    "teleop",
    "insertion",
)  # Without the force a needle can be held, and must come out
_RATE_S = 0.01  # Time constant of the force's rate: shorter than the lag of the virtual sensor
_TRACKING_S = 1.0
_FOLLOWS_S = 0.03
_LEAST_PATH_RAD = 2e-3
"""Memory of commanded and made motion, time by which an arm may follow, least motion
compared."""
_CLEAR_S = 0.1  # A fault must be gone for so long before a reset
_GAP_S = 5e-3
_GAP_STEPS = 3.0
_FADE_LAGS = 3.0
"""A step so long, and so many usual ones, is a gap: an arm that nobody commanded has
stopped and started in it, and what torques nobody saw did to the force fades within so
many of its lags."""


class Monitors:
    """Watch every sample of a session, command and device; see `update`.

    Attributes:
        has_device: Whether the haptic device has sent something of late.
        is_healthy: Whether no fault has been seen of late.
        missed_s: Time for which the program, not the arm, was away.
    """

    def __init__(self, session: "InsertionSession", limits: SafetyLimits) -> None:
        self._session = session
        self._limits = limits
        self._bad_s = 0.0
        self._device_s = math.inf
        self._clear_s = math.inf
        self._step_s = math.inf
        self._position: Array | None = None
        self._lateral_N = 0.0  # of the session, across the needle
        self.has_device = False
        self.is_healthy = True
        self.missed_s = 0.0
        self.enter("idle")

    def enter(self, state: str) -> None:
        """A new state begins: commands and forces are compared with what they are
        now.
        """
        self._state = state
        self._refused_s = self._path_rad = self._rate_N_per_s = 0.0
        self._made_rad = self._asked_rad = np.zeros(1)
        self._axial_N: float | None = None  # a tare makes the force jump
        self._entry_axial_N: float | None = None
        self._side_Ns = 0.0
        self._fading_s = 0.0
        self._entry_lateral_N = self._lateral_N

    def update(
        self,
        estimate: "SessionEstimate",
        sample: ArmSample,
        beside: Beside,
        step_s: float,
    ) -> tuple[str, str]:
        """The gravest event in one cycle, ``fault`` or ``limit``, and its reason; empty
        if none.

        The step [s] is that of the sample, or the one before where the clock was set.
        """
        since_s = as_float(getattr(sample, "dt_s", None))
        lag_s = self._session.lag_s
        self._lateral_N = estimate.wrench.lateral
        self._device_s = 0.0 if beside.has_device else self._device_s + step_s
        self.has_device = self._device_s <= self._limits.device_s
        axial_N = (
            estimate.wrench.axial
            if beside.axial_N is None
            else as_float(beside.axial_N)
        )
        fault = f"no sample for {1e3 * since_s:.0f} ms"
        is_late = since_s > self._limits.late_s + self.missed_s
        self.missed_s = max(self.missed_s - max(since_s, step_s), 0.0)
        if not is_late:
            fault = self._signals(estimate, axial_N, step_s)
            fault = fault or self._commands(estimate, sample, beside, step_s)
        self._clear_s = 0.0 if fault else self._clear_s + step_s
        self.is_healthy = self._clear_s >= _CLEAR_S
        if fault:
            return "fault", fault
        ahead_s = self._limits.reaction_s + (lag_s if beside.axial_N is None else 0.0)
        if not math.isfinite(axial_N):
            axial_N = self._axial_N or 0.0
        rise_N = 0.0 if self._axial_N is None else axial_N - self._axial_N
        self._axial_N = axial_N
        self._rate_N_per_s -= math.expm1(-step_s / _RATE_S) * (
            rise_N / step_s - self._rate_N_per_s
        )
        ahead_N = axial_N + ahead_s * self._rate_N_per_s
        side = self._side_force(step_s, lag_s)
        stop = self._forces(estimate, axial_N, ahead_N) or side
        if self._state == "teleop" and not self.has_device:
            stop = (
                f"the haptic device has been silent for {1e3 * self._device_s:.0f} ms"
            )
        return ("limit", stop) if stop else ("", "")

    def _signals(
        self, estimate: "SessionEstimate", axial_N: float, step_s: float
    ) -> str:
        is_bad = estimate.status is Status.REJECTED
        has_force = math.isfinite(axial_N)
        self._bad_s = max(
            self._bad_s + (-step_s if has_force and not is_bad else step_s), 0.0
        )
        if self._bad_s > self._limits.lost_s:
            why = (
                estimate.wrench.message
                if has_force
                else f"axial force of the sensor {axial_N}"
            )
            return f"bad samples for {1e3 * self._bad_s:.0f} ms: {why}"
        return (
            estimate.wrench.message
            if estimate.warnings & _BROKEN and not is_bad
            else ""
        )

    def _commands(
        self,
        estimate: "SessionEstimate",
        sample: ArmSample,
        beside: Beside,
        step_s: float,
    ) -> str:
        command = beside.command_rad_s
        self._refused_s = 0.0 if beside.accepted else self._refused_s + step_s
        if self._refused_s > self._limits.refused_s:
            return f"the arm has refused commands for {1e3 * self._refused_s:.0f} ms"
        if command is None:  # the arm may go where others lead it
            self._position = None
            self._path_rad = 0.0
            self._made_rad = self._asked_rad = np.zeros(1)
        if command is None or estimate.status is Status.REJECTED:
            return ""
        position = np.array(sample.q_rad, dtype=np.float64)
        kept = math.exp(-step_s / _TRACKING_S)
        try:
            command = vector(command, len(position), "command")
        except SettingError:
            return f"the command is {command!r:.80}, expected {len(position)} finite numbers"
        moved = 0.0 if self._position is None else position - self._position
        self._position = position
        self._made_rad = kept * (self._made_rad + moved)
        self._asked_rad = asked = kept * (self._asked_rad + step_s * command)
        speed_rad_s = math.sqrt(float(command.dot(command)))
        self._path_rad = kept * (self._path_rad + step_s * speed_rad_s)
        off = asked - self._made_rad
        late_rad = _FOLLOWS_S * speed_rad_s
        behind_rad = float(off.dot(asked)) / max(
            math.sqrt(float(asked.dot(asked))), 1e-9
        )
        if behind_rad > 0.5 * self._path_rad + _LEAST_PATH_RAD + late_rad:
            return "the arm does not follow its commands"
        if (
            most_rad := float(np.abs(off).max())
        ) > self._limits.tracking_rad + late_rad:
            return f"a joint has moved by {most_rad:.2g} rad that were not commanded"
        return ""

    def _forces(
        self, estimate: "SessionEstimate", axial_N: float, ahead_N: float
    ) -> str:
        limits = self._limits
        wrench = estimate.wrench
        state = self._state
        if state in _IN_AIR:
            if self._entry_axial_N is None:
                self._entry_axial_N = wrench.axial
            # In guidance it is the hand's, before a tare it holds the bias.
            is_known = state != "guidance" and estimate.status is Status.OK
            most_N = min(limits.axial_N, limits.free_N) if is_known else limits.free_N
            change_N = abs(wrench.axial - self._entry_axial_N)
            return (
                f"axial force changed by {change_N:.1f} N" if change_N > most_N else ""
            )
        if state not in _AT_TISSUE:
            return ""
        if estimate.warnings & _UNUSABLE and state in _DRIVEN:
            return wrench.message
        inwards_N = max(axial_N, ahead_N)
        outwards_N = -min(axial_N, ahead_N)
        both_N = max(inwards_N, outwards_N)
        most_N = {"withdraw": outwards_N, "teleop": both_N}.get(state, inwards_N)
        if most_N > limits.axial_N:
            return f"axial force {axial_N:.2f} N, {most_N:.2f} N ahead; limit {limits.axial_N:g} N"
        return ""

    def _side_force(self, step_s: float, lag_s: float) -> str:
        """A force across the needle that lasts, and is not what a gap has left."""
        state = self._state
        lateral_N = self._lateral_N
        # A needle that was stopped by a side force must still come out.
        most_N = self._limits.lateral_N + (
            self._entry_lateral_N if state == "withdraw" else 0.0
        )
        is_gap = step_s > max(_GAP_S, _GAP_STEPS * self._step_s)
        self._fading_s = (
            _FADE_LAGS * lag_s if is_gap else max(self._fading_s - step_s, 0.0)
        )
        self._step_s = step_s
        counts = state in _AT_TISSUE and lateral_N > most_N and self._fading_s == 0.0
        self._side_Ns = self._side_Ns + step_s * lateral_N if counts else 0.0
        is_over = self._side_Ns > self._limits.lateral_s * most_N
        return f"side force {lateral_N:.2f} N" if is_over else ""
