"""What stops a motion: force, side force, signals, commands, device; each says why.

Forces are judged ahead of time: from the reading and its rate to the force at which the
arm will have come to rest. A stiff contact is then noticed while its force is still
small.
"""

import math
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from foundation.arrays import Array
from identification.estimate import SampleStatus
from needleforce.control.errors import SettingError, as_vector, require_positive
from needleforce.control.handle_watch import HandleReport
from needleforce.control.ports import ArmSample
from needleforce.control.state_machine import State
from needleforce.insertion_events import describe_hard_contact
from needleforce.needle_on_plan import describe_clearances, describe_deviation
from residual.checks.input import as_float
from residual.estimate import SensorWarning, Status

if TYPE_CHECKING:
    from needleforce.session import InsertionSession, SessionEstimate


@dataclass(frozen=True, slots=True, kw_only=True)
class SafetyLimits:
    """What a motion must not exceed.

    Attributes:
        axial_N: Force against the motion along the needle.
        lateral_N: Force across the needle.
        lateral_s: Time for which that force may act; a force twice that limit, half as
            long.
        free_N: Change of the axial force in free air, where it may not be tared yet.
        lost_s: Time of bad samples beyond that of valid ones.
        late_s: Longest time without a sample.
        refused_s: Time of refused commands.
        tracking_rad: Motion of a joint within a second that was not commanded.
        reaction_s: Time from a decision to the arm at rest, over which forces are
            predicted.
        stop_off_plan: Stop an advance while the needle is off the plan that the session
            follows, and one by hand past the plan's target or too near to a structure
            at risk. An autonomous insertion always stops at these two.

    Raises:
        SettingError: A limit is no positive number.
    """

    axial_N: float
    lateral_N: float = 0.5
    lateral_s: float = 0.04
    free_N: float = 15.0
    lost_s: float = 0.006
    late_s: float = 0.03
    refused_s: float = 0.005
    tracking_rad: float = 0.05
    reaction_s: float = 0.015
    stop_off_plan: bool = False

    def __post_init__(self) -> None:
        require_positive(asdict(self) | {"stop_off_plan": 1.0})


class Beside(NamedTuple):
    """What came beside a sample of the arm.

    Attributes:
        accepted: Whether the arm took the last command.
        command_rad_s: That command, shape (n,); None while the arm is not commanded.
        axial_N: Axial force of an F/T sensor, its bias and the needle's weight removed;
            None for that of the session.
        handle: What a sample of the haptic device is good for, see `HandleWatch`; None
            where nobody has asked.
        sample_status: Of an `Identifier` that uses the F/T sensor, at the sample
            before; nothing of it is known to the session.
    """

    accepted: bool = True
    command_rad_s: Array | None = None
    axial_N: float | None = None
    handle: HandleReport | None = None
    sample_status: SampleStatus = SampleStatus.OK


NOTHING = Beside()
"""Nothing came beside a sample."""

_AT_TISSUE = (State.TELEOP, State.INSERTION, State.DWELL, State.WITHDRAW)

_ADVANCING = (State.TELEOP, State.INSERTION)
"""States that need a usable force; without it a needle can be held, and must come
out."""


class CommandTracking:
    """Compares commanded and measured motion of the joints.

    Args:
        max_rad: Motion of a joint that was not commanded, at most.
    """

    def __init__(self, max_rad: float) -> None:
        self._max_rad = max_rad
        self.restart()

    def restart(self) -> None:
        """Forget the motion so far: others may have led the arm."""
        self._position_rad: Array | None = None
        self._path_rad = 0.0
        self._measured_rad = np.zeros(1)
        self._commanded_rad = np.zeros(1)

    def check(self, position_rad: Array, command_rad_s: Array, step_s: float) -> str:
        """Return what is wrong after one cycle; empty if the arm follows.

        Both motions are remembered for a second: a joint that drifts shows within it.
        The arm may lag behind its commands by 30 ms and by half of their path; less
        than 2 mrad are noise and backlash.

        Args:
            position_rad: Where the joints are, shape (n,), in an array of its own.
            command_rad_s: Velocity commanded in this cycle, shape (n,).
            step_s: Time of the cycle.
        """
        decay = math.exp(-step_s)  # a memory of one second
        last_rad = position_rad if self._position_rad is None else self._position_rad
        self._position_rad = position_rad
        moved_rad = position_rad - last_rad
        self._measured_rad = decay * (self._measured_rad + moved_rad)
        self._commanded_rad = decay * (self._commanded_rad + step_s * command_rad_s)
        speed_rad_s = math.sqrt(float(command_rad_s.dot(command_rad_s)))
        self._path_rad = decay * (self._path_rad + step_s * speed_rad_s)
        lag_rad = 0.03 * speed_rad_s
        deviation_rad = self._commanded_rad - self._measured_rad
        commanded_rad = math.sqrt(float(self._commanded_rad.dot(self._commanded_rad)))
        behind_rad = float(deviation_rad.dot(self._commanded_rad)) / max(
            commanded_rad,
            1e-9,  # finite where there was no motion
        )
        if behind_rad > 0.5 * self._path_rad + 2e-3 + lag_rad:
            return "the arm does not follow its commands"
        largest_rad = float(np.abs(deviation_rad).max())
        if largest_rad > self._max_rad + lag_rad:
            return f"a joint has moved by {largest_rad:.2g} rad that were not commanded"
        return ""


class Monitors:
    """Watch every sample of a session, command and device; see `update`.

    Args:
        session: Force sensor and identification.
        limits: What a motion must not exceed.

    Attributes:
        has_device: Whether the haptic device has sent something of late.
        is_healthy: Whether no fault has been seen of late.
    """

    def __init__(self, session: "InsertionSession", limits: SafetyLimits) -> None:
        self.has_device = False
        self.is_healthy = True
        self._session = session
        self._limits = limits
        self._tracking = CommandTracking(limits.tracking_rad)
        self._bad_s = 0.0
        self._clear_s = math.inf
        self._lateral_N = 0.0
        self._last_step_s = math.inf
        self.enter(State.IDLE)

    def enter(self, state: State) -> None:
        """Begin a state: commands and forces are compared with what they are now.

        A needle that was stopped by a side force must still come out.
        """
        self._state = state
        self._refused_s = 0.0
        self._axial_N: float | None = None  # a tare makes the force jump
        self._axial_rate_N_per_s = 0.0
        self._entry_axial_N: float | None = None
        self._tracking.restart()
        self._impulse_Ns = 0.0  # of a side force that lasts
        self._fading_s = 0.0  # time for which a gap still shows in the force
        borne_N = self._lateral_N if state == State.WITHDRAW else 0.0
        self._max_lateral_N = self._limits.lateral_N + borne_N

    def update(
        self,
        estimate: "SessionEstimate",
        sample: ArmSample,
        beside: Beside,
        step_s: float,
    ) -> tuple[str, str]:
        """Return the gravest event in one cycle and its reason; empty if there is none.

        Args:
            estimate: Of the session.
            sample: Of the arm.
            beside: What came beside it.
            step_s: Time of the sample, or the one before where the clock was set.

        Returns:
            ``fault`` or ``limit``, and why.
        """
        has_sensor = beside.axial_N is not None
        axial_N = as_float(beside.axial_N) if has_sensor else estimate.wrench.axial
        self._lateral_N = estimate.wrench.lateral
        handle = beside.handle
        device_fault = handle.fault if handle else "nobody reads the haptic device"
        self.has_device = not device_fault
        own_status = estimate.identification.status
        status = beside.sample_status if has_sensor else own_status
        # No tissue exerts it; a dwell may have begun by it.
        is_held = self._state in (*_ADVANCING, State.DWELL)
        is_pull = is_held and status is SampleStatus.NEEDLE_PULLED
        pull = f"axial force {axial_N:.2f} N: {status.value}" if is_pull else ""
        fault = (
            self._check_signals(estimate, sample, axial_N, step_s)
            or pull
            or self._check_command(estimate, sample, beside, step_s)
        )
        self._clear_s = 0.0 if fault else self._clear_s + step_s
        self.is_healthy = self._clear_s >= 0.1  # a fault is gone for so long
        if fault:
            return "fault", fault
        if not math.isfinite(axial_N):
            axial_N = self._axial_N or 0.0
        lag_s = 0.0 if has_sensor else self._session.lag_s
        ahead_N = self._predict_axial_N(axial_N, lag_s, step_s)
        side_force = self._check_side_force(step_s)
        stop = (
            (device_fault if self._state == State.TELEOP else "")
            or self._check_by_itself(estimate, has_sensor)
            or self._check_axial(estimate, axial_N, ahead_N)
            or side_force
            or self._check_plan(estimate)
        )
        return ("limit", stop) if stop else ("", "")

    def _check_signals(
        self,
        estimate: "SessionEstimate",
        sample: ArmSample,
        axial_N: float,
        step_s: float,
    ) -> str:
        """Return what is wrong with the signals of arm and force sensor."""
        message = estimate.wrench.message
        is_rejected = estimate.status is Status.REJECTED
        is_bad = is_rejected or not math.isfinite(axial_N)
        self._bad_s = max(self._bad_s + (step_s if is_bad else -step_s), 0.0)
        dt_s = as_float(getattr(sample, "dt_s", None))
        if dt_s > self._limits.late_s:
            return f"no sample for {1e3 * dt_s:.0f} ms"
        if self._bad_s > self._limits.lost_s:
            reason = message or f"axial force {axial_N}"
            return f"bad samples for {1e3 * self._bad_s:.0f} ms: {reason}"
        broken = SensorWarning.FROZEN | SensorWarning.VELOCITY
        return message if estimate.warnings & broken and not is_rejected else ""

    def _check_command(
        self,
        estimate: "SessionEstimate",
        sample: ArmSample,
        beside: Beside,
        step_s: float,
    ) -> str:
        """Return what is wrong with the last command and what the arm made of it."""
        self._refused_s = 0.0 if beside.accepted else self._refused_s + step_s
        if self._refused_s > self._limits.refused_s:
            return f"the arm has refused commands for {1e3 * self._refused_s:.0f} ms"
        command = beside.command_rad_s
        if command is None:
            self._tracking.restart()
        if command is None or estimate.status is Status.REJECTED:
            return ""
        position_rad = np.array(sample.q_rad, dtype=np.float64)
        try:
            command_rad_s = as_vector(command, position_rad.size, "the command")
        except SettingError as error:
            return str(error)
        return self._tracking.check(position_rad, command_rad_s, step_s)

    def _predict_axial_N(self, axial_N: float, lag_s: float, step_s: float) -> float:
        """Return the axial force with the arm at rest, from its reading and its rate.

        The rate is a mean over 10 ms, less than the lag of the virtual sensor.
        """
        rise_N = 0.0 if self._axial_N is None else axial_N - self._axial_N
        self._axial_N = axial_N
        self._axial_rate_N_per_s -= math.expm1(-step_s / 0.01) * (
            rise_N / step_s - self._axial_rate_N_per_s
        )
        ahead_s = self._limits.reaction_s + lag_s
        return axial_N + ahead_s * self._axial_rate_N_per_s

    def _check_side_force(self, step_s: float) -> str:
        """Return what is wrong with a side force that lasts, and no gap has left.

        A step of three usual ones, and of 5 ms at least, is a gap: an arm that nobody
        commanded has stopped and started in it. What torques that nobody saw did to the
        force decays within three of its lags.
        """
        self._fading_s = max(self._fading_s - step_s, 0.0)
        if step_s > max(5e-3, 3.0 * self._last_step_s):
            self._fading_s = 3.0 * self._session.lag_s
        self._last_step_s = step_s
        is_above = self._state in _AT_TISSUE and self._lateral_N > self._max_lateral_N
        self._impulse_Ns += step_s * self._lateral_N
        if self._fading_s > 0.0 or not is_above:
            self._impulse_Ns = 0.0
        if self._impulse_Ns > self._limits.lateral_s * self._max_lateral_N:
            return f"side force {self._lateral_N:.2f} N"
        return ""

    def _check_by_itself(self, estimate: "SessionEstimate", has_sensor: bool) -> str:
        """Return what stops an insertion by itself: bone, or an outrun force.

        In teleoperation the hand feels the one and decides on the other.
        """
        if self._state != State.INSERTION:
            return ""
        if estimate.identification.hard_contact is not None:
            return describe_hard_contact(estimate.identification.hard_contact)
        is_outrun = SensorWarning.TOO_FAST in estimate.warnings
        return estimate.wrench.message if is_outrun and not has_sensor else ""

    def _check_axial(
        self, estimate: "SessionEstimate", axial_N: float, ahead_N: float
    ) -> str:
        """Return what is wrong with the axial force, now or a time ahead."""
        if self._state in (State.GUIDANCE, State.APPROACH, State.TARE):
            # In guidance the force is the hand's, before a tare it holds the bias.
            if self._entry_axial_N is None:
                self._entry_axial_N = estimate.wrench.axial
            max_N = self._limits.free_N
            if self._state != State.GUIDANCE and estimate.status is Status.OK:
                max_N = min(self._limits.axial_N, max_N)
            change_N = abs(estimate.wrench.axial - self._entry_axial_N)
            is_beyond = change_N > max_N
            return f"axial force changed by {change_N:.1f} N" if is_beyond else ""
        if self._state not in _AT_TISSUE:
            return ""
        unusable = (
            SensorWarning.JOINT_LIMIT
            | SensorWarning.NEAR_SINGULAR
            | SensorWarning.MODEL_MISMATCH
            | SensorWarning.TARE_EXPIRED
            | SensorWarning.TORQUE_JUMP
        )
        if estimate.warnings & unusable and self._state in _ADVANCING:
            return estimate.wrench.message
        pushing_N = max(axial_N, ahead_N)
        pulling_N = -min(axial_N, ahead_N)
        against_N = {
            State.WITHDRAW: pulling_N,
            State.TELEOP: max(pushing_N, pulling_N),
        }.get(self._state, pushing_N)
        if against_N > self._limits.axial_N:
            return (
                f"axial force {axial_N:.2f} N, {against_N:.2f} N ahead; "
                f"limit {self._limits.axial_N:g} N"
            )
        return ""

    def _check_plan(self, estimate: "SessionEstimate") -> str:
        """Return what stops an advance by the plan; empty if nothing does."""
        deviation = estimate.deviation
        is_asked = self._limits.stop_off_plan
        watched = _ADVANCING if is_asked else (State.INSERTION,)
        if deviation is None or self._state not in watched:
            return ""
        if deviation.is_past_target or (is_asked and deviation.is_off_plan):
            return describe_deviation(deviation)
        near = estimate.clearances[:1]
        return describe_clearances(near) if near and near[0].is_too_near else ""
