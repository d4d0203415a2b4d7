"""The last thing before an arm: turns wanted joint velocities into what it may be sent.

The state is the command that the arm took last. Every cycle changes it within the arm's
limits of speed, acceleration and jerk towards the wanted velocity, and slows it before
the stops, see `rate_limiter`: the commands of a controller with the same limits pass
unchanged.
"""

import atexit
import math
import signal
import threading
from abc import abstractmethod
from collections.abc import Iterator
from time import monotonic
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.jit import compile_waiting
from needleforce.devices.arm_limits import ARM_LIMITS, ArmLimits
from needleforce.devices.errors import DeviceSettingError, LinkError
from needleforce.devices.link import SILENCE_S, ArmReading, Link
from needleforce.devices.rate_limiter import write_velocity_bounds

if TYPE_CHECKING:
    from needleforce.control.joint_limits import Limits

HEADROOM = 0.98
"""Fraction of each limit that is used: arms round positions, and their clocks drift."""

MAX_START_rad_s = 0.05
"""After an interruption the first command that is taken is at most this: a program that
has not seen that it was refused would go on at full speed. 10 rad/s2 for 5 ms."""


class Guard:
    """Gives the velocity of every cycle, always within limits; brakes when in doubt.

    Args:
        preset: The arm's limits.
        cycle_s: Between two commands.
        robot: Its model, for the stops of an arm whose preset names none; or None.
        hold_cycles: A velocity holds for so many cycles without a new one; then the arm
            brakes.

    Attributes:
        refusal: Why the last velocity was not taken; empty if it was.
    """

    def __init__(
        self,
        preset: ArmLimits,
        cycle_s: float,
        robot: Any = None,
        hold_cycles: int = 5,
    ) -> None:
        compile_waiting()
        self.refusal = ""
        self._limits = _limit_rows(preset, robot, cycle_s)
        self._highest_rad_s = np.array(preset.speed_rad_s)
        self.cycle_s = cycle_s
        self._joints = len(preset.speed_rad_s)
        self._is_interrupted = False  # until a command starts from rest
        self._motion = np.zeros((2, self._joints))  # velocity, acceleration
        self._wanted_rad_s = np.zeros(self._joints)
        self._hold_cycles = hold_cycles
        self._silent_cycles = hold_cycles

    @property
    def is_at_rest(self) -> bool:
        """Whether nothing moves any more."""
        return not self._motion.any()

    @property
    def is_idle(self) -> bool:
        """Whether nothing moves, and no velocity is wanted."""
        return self.is_at_rest and self._silent_cycles >= self._hold_cycles

    @property
    def is_ready(self) -> bool:
        """Whether a command would be taken: not while braking after an interruption."""
        return not self._is_interrupted or self.is_at_rest

    def refuse(self, reason: str) -> bool:
        """Note why a velocity was not taken; return False."""
        self.refusal = reason
        return False

    def want(self, velocity_rad_s: ArrayLike) -> bool:
        """Take the velocity of the coming cycles, shape (n,).

        Returns:
            False with a `refusal` for anything but n finite numbers, for more than
            twice the arm's highest speed, and, after an interruption, before the arm is
            at rest and for more than `MAX_START_rad_s`.
        """
        try:
            wanted = np.array(velocity_rad_s, dtype=float)
        except (TypeError, ValueError):
            wanted = np.empty(0)
        if wanted.shape != (self._joints,) or not math.isfinite(wanted.sum()):
            return self.refuse(
                f"got {velocity_rad_s!r:.80}; expected {self._joints} finite numbers"
            )
        speed_rad_s = np.abs(wanted)
        # Times the arm's highest speed: what is above was not meant, in degrees
        # perhaps.
        absurd = 2.0
        if (speed_rad_s > absurd * self._highest_rad_s).any():
            return self.refuse(
                f"got {speed_rad_s.max():g} rad/s, more than twice what the arm can; "
                "velocities are in rad/s"
            )
        if self._is_interrupted:
            if not self.is_at_rest:
                return self.refuse("the arm brakes after an interruption: let it rest")
            if speed_rad_s.max() > MAX_START_rad_s:
                return self.refuse(
                    f"got {speed_rad_s.max():g} rad/s after an interruption; begin "
                    f"with at most {MAX_START_rad_s:g}, with Controller.reset"
                )
        self._is_interrupted = False
        self._wanted_rad_s = wanted
        self._silent_cycles = 0
        self.refusal = ""
        return True

    def brake(self) -> None:
        """Forget the command: the arm brakes to rest."""
        self._silent_cycles = self._hold_cycles

    def interrupt(self) -> None:
        """Brake, and take commands again from rest only, slow ones first."""
        self.brake()
        self._is_interrupted = True

    def anchor(self) -> None:
        """Begin at rest there: the arm took no commands, or has stopped itself."""
        self._is_interrupted = self._is_interrupted or not self.is_at_rest
        self._motion[:] = 0.0
        self.brake()

    def advance(self, position_rad: Array) -> Array:
        """Return the velocity of the next cycle, shape (n,) [rad/s].

        Args:
            position_rad: Where the arm is, or is commanded to be, shape (n,).
        """
        if self._silent_cycles >= self._hold_cycles:
            self._wanted_rad_s = np.zeros(self._joints)
        self._silent_cycles += 1
        last_rad_s, last_rad_s2 = self._motion
        bounds_rad_s = np.empty((2, self._joints))
        write_velocity_bounds(
            self._limits,
            position_rad,
            last_rad_s,
            last_rad_s2,
            self.cycle_s,
            0.0,
            bounds_rad_s,
        )
        velocity_rad_s = np.clip(self._wanted_rad_s, *bounds_rad_s)
        self._motion[1] = (velocity_rad_s - last_rad_s) / self.cycle_s
        self._motion[0] = velocity_rad_s
        return velocity_rad_s


def _limit_rows(preset: ArmLimits, robot: Any, cycle_s: float) -> Array:
    """Return lowest and highest position, speed, acceleration, jerk, brake; (6, n).

    The acceleration is at most the jerk times the arm's cycle: a command that is lost,
    the one before held, then exceeds no jerk either. Joints brake before a stop at
    B < D, along a parabola that ends O^2 / (2 (D - B)) before it, and so keep to
    `PositionStops` at every speed.
    """
    speed_rad_s = HEADROOM * np.array(preset.speed_rad_s)
    jerk_rad_s3 = HEADROOM * np.array(preset.jerk_rad_s3)
    acceleration_rad_s2 = np.minimum(
        HEADROOM * np.array(preset.acceleration_rad_s2),
        jerk_rad_s3 * min(cycle_s, preset.cycle_s),
    )
    brake_rad_s2 = 0.5 * acceleration_rad_s2
    # Kept from the stops, for what moves the arm besides the command.
    margin_rad = np.full(speed_rad_s.size, 0.04)
    lower_rad = np.full(speed_rad_s.size, -np.inf)
    upper_rad = np.full(speed_rad_s.size, np.inf)
    if preset.stops is not None:
        lower_rad, upper_rad, deceleration_rad_s2, offset_rad_s = np.array(preset.stops)
        brake_rad_s2 = np.minimum(brake_rad_s2, 0.5 * deceleration_rad_s2)
        near_rad = offset_rad_s**2 / (2.0 * (deceleration_rad_s2 - brake_rad_s2))
        margin_rad = np.maximum(margin_rad, near_rad)
    elif robot is not None and robot.nv == speed_rad_s.size:
        lower_rad = robot.position_lower_rad
        upper_rad = robot.position_upper_rad
    return np.array(
        (
            lower_rad + margin_rad,
            upper_rad - margin_rad,
            speed_rad_s,
            acceleration_rad_s2,
            jerk_rad_s3,
            brake_rad_s2,
        )
    )


class GuardedArm(Link):
    """An arm that is iterated over and takes commands through a guard.

    Silence is reported by `on_silence` and in the report; after `give_up_s` of it the
    arm is lost. Whoever iterates again waits for it again.

    Args:
        joints: How many the arm has.
        robot: Its model, or None.
        give_up_s: So long a silence is waited for.
        cycle_s: Between two commands; None: as its limits name it.
        hold_cycles: So long a velocity holds, see `Guard`.
        link: Arguments of the connection below.

    Attributes:
        joints: How many the arm has.
        robot: The model of the arm, or None.
        give_up_s: So long a silence is waited for.
        preset: Its limits, or their name in `ARM_LIMITS`.

    Raises:
        DeviceSettingError: A time that cannot be, or limits of another arm.
    """

    preset: str | ArmLimits

    def __init__(
        self,
        joints: int,
        robot: Any,
        give_up_s: float,
        *,
        cycle_s: float | None = None,
        hold_cycles: int = 5,
        **link: Any,
    ) -> None:
        if not SILENCE_S <= give_up_s < math.inf:
            raise DeviceSettingError(
                f"{give_up_s=}: expected seconds, at least {SILENCE_S:g}"
            )
        limits = self.preset
        if isinstance(limits, str):
            if limits not in ARM_LIMITS:
                raise DeviceSettingError(
                    f"limits of an arm {limits!r}; expected one of "
                    f"{', '.join(ARM_LIMITS)}"
                )
            limits = ARM_LIMITS[limits]
        if len(limits.speed_rad_s) != joints:
            raise DeviceSettingError(
                f"limits of {len(limits.speed_rad_s)} joints; expected those of "
                f"{joints}"
            )
        super().__init__(**link)
        self.joints = joints
        self.robot = robot
        self.give_up_s = give_up_s
        self._guard = Guard(limits, cycle_s or limits.cycle_s, robot, hold_cycles)
        self._closes_at_exit = False

    def __iter__(self) -> Iterator[ArmReading]:
        """Yield readings as they come.

        Raises:
            LinkError: Nothing valid came for `give_up_s`, or an arm that is commanded
                has stopped.
        """
        self._heard_s = monotonic()
        while self._is_open:
            reading = self._read(SILENCE_S)
            if reading is not None:
                self._hear()
                yield reading
                self._heard_s = monotonic()
            elif self._is_open and (silent_s := self._count_silence()) > 0.0:
                self._lose()
                if silent_s >= self.give_up_s:
                    raise LinkError(
                        f"the arm {self._place()} has been silent for {silent_s:.1f} s "
                        f"({self.report})"
                    )

    @abstractmethod
    def _read(self, wait_s: float) -> ArmReading | None:
        """Return the next valid reading; None if none comes in time."""

    @abstractmethod
    def _place(self) -> str:
        """Return where the arm is expected, for messages."""

    def _lose(self) -> None:
        """Note that the arm is silent."""

    @property
    def limits(self) -> "Limits":
        """The limits of the arm moving a needle, for `needleforce.control.Controller`.

        Raises:
            DeviceSettingError: The arm was opened without its model.
        """
        from needleforce.control.joint_limits import Limits

        if self.robot is None:
            raise DeviceSettingError(
                "limits of an arm without its model; expected "
                "connect_arm(..., robot=load_urdf(...))"
            )
        return Limits.of_arm(self.robot, self.preset)

    @property
    def refusal(self) -> str:
        """Why the last velocity was not taken; empty if it was."""
        return self._guard.refusal

    @property
    def _accepts_commands(self) -> bool:
        """Whether a command would be taken now; not while the arm brakes."""
        return self._is_open and not self._find_refusal() and self._guard.is_ready

    @abstractmethod
    def _find_refusal(self) -> str:
        """Return why the arm takes no commands now; empty if it does."""

    def send(self, dq_rad_s: ArrayLike) -> bool:
        """Command a joint velocity for the coming cycles; see `Guard` for how long.

        From then on the end of the program brakes the arm: an exception, Ctrl-C and
        SIGTERM alike. SIGTERM keeps a handler that the program has set itself.

        Args:
            dq_rad_s: Velocity, shape (n,).

        Returns:
            False where the arm takes no commands and for what `Guard.want` refuses;
            `refusal` says why.
        """
        if not self._is_open:
            return self._guard.refuse(
                "the connection is closed, or the arm has stopped: open it again"
            )
        why = self._find_refusal()
        if why:
            return self._guard.refuse(why)
        if not self._guard.want(dq_rad_s):
            return False
        if not self._closes_at_exit:
            self._closes_at_exit = True
            atexit.register(self.close)
            is_main = threading.current_thread() is threading.main_thread()
            if is_main and signal.getsignal(signal.SIGTERM) is signal.SIG_DFL:
                signal.signal(signal.SIGTERM, _exit_for_signal)
        return True

    def close(self) -> None:
        """End the connection, and with it the readings."""
        atexit.unregister(self.close)
        super().close()


def _exit_for_signal(number: int, _frame: object) -> None:
    """End the program as an exception does, so that its links are closed."""
    raise SystemExit(128 + number)
