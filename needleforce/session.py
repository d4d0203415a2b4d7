"""One insertion, tick by tick, from joint signals to the force at the needle's tip."""

import math
import numbers
from copy import deepcopy
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from identification import MULTILAYER as DEFAULT_IDENTIFIER
from identification import (
    Estimate,
    IdentificationError,
    Identifier,
    LayerEstimate,
    MultilayerConfig,
    PublishedConfig,
    SampleStatus,
)
from identification import Snapshot as IdentifierSnapshot
from needleforce.plan_follower import Plan, PlanFollower, PlanMemory
from needleforce.tip_travel import TravelZero, travel_step
from residual import DEFAULT as DEFAULT_SENSOR
from residual import (
    SensorConfig,
    SensorWarning,
    Status,
    VirtualForceSensor,
    WrenchEstimate,
)
from residual.bias.model import Tare
from residual.virtual_force_sensor import SensorState
from urdf import Robot

if TYPE_CHECKING:
    from needleforce.anatomy import PlanState

_new = tuple.__new__  # makes a named tuple in half the time: there is one in every tick


class InsertionError(Exception):
    """Base of the errors of a session; errors of `residual` and `identification`
    pass through.
    """


class SettingError(InsertionError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class SnapshotMismatchError(InsertionError, ValueError):
    """A snapshot that cannot be restored here; nothing has changed."""


class SnapshotFileError(InsertionError, ValueError):
    """A file that is no snapshot, or one of a version that cannot be read."""


class SessionEstimate(NamedTuple):
    """State of knowledge after one tick. Every number is finite.

    Attributes:
        wrench: Force on the needle, see `WrenchEstimate`.
        depth_m: Travel of the tip along the needle since the tare or `begin_insertion`.
        speed_m_s: Its rate.
        identification: Layers, friction, tip force: that of the last tick used for
            identification, its events (``rupture``, ``identified_layer``,
            ``retracted``) only in the tick that brought them. Times are on this
            session's clock, depths from its zero.
        status: Whether the numbers are of this tick and tared.
        used_for_identification: Whether this tick's force went into the identification.
        time_s: Sum of the time steps since the first sample after `reset` [s]: the
            clock of all events. Rejected samples count, a clock that was set does not.
        plan: What plan and ruptures say together: the layer, the next boundary, the
            offset; None before the tare, and without `InsertionSession.follow`.
    """

    wrench: WrenchEstimate
    depth_m: float
    speed_m_s: float
    identification: Estimate
    status: Status
    used_for_identification: bool
    time_s: float
    plan: "PlanState | None" = None

    @property
    def warnings(self) -> SensorWarning:
        """What may be wrong with the force beyond its standard deviation."""
        return self.wrench.warnings


class Checkpoint(NamedTuple):
    """Where the identification can go back to.

    Attributes:
        time_s: See `SessionEstimate`.
    """

    time_s: float
    identifier: IdentifierSnapshot


class SessionSnapshot(NamedTuple):
    """All that an `InsertionSession` remembers; immutable.

    Attributes:
        travel: See `travel_step`.
        speed_lag_s: Setting of the session.
        unused_s: Time of valid samples that were not used for identification.
        time_s: See `SessionEstimate`.
        earlier: Older and newer.
    """

    sensor: SensorState
    identifier: IdentifierSnapshot
    zero: TravelZero
    travel: tuple[float, float, float, float]
    speed_lag_s: float
    unused_s: float
    time_s: float
    earlier: tuple[Checkpoint, Checkpoint]
    plan: PlanMemory


_NOT_USED = (
    SensorWarning.JOINT_LIMIT
    | SensorWarning.NEAR_SINGULAR
    | SensorWarning.MODEL_MISMATCH
    | SensorWarning.FROZEN
    | SensorWarning.TARE_EXPIRED
    | SensorWarning.VELOCITY
)
_PUSHED = SensorWarning.MODEL_MISMATCH | SensorWarning.ARM_PUSHED
_TAKEN_BACK_S = 0.25  # A push on the arm grows for so long before it is known as one
# Looking up a name of an enumeration takes as long as a call, so it is done once.
_OK = Status.OK
_REJECTED = Status.REJECTED
_USED = tuple(status for status in SampleStatus if status.is_used)


class InsertionSession:
    """Virtual sensor, tip travel and identifier in one.

    Call `update` every tick from the start of the robot; move in free air, call `tare`,
    insert. For another insertion with the same tare call `begin_insertion` above the
    tissue.

    Only forces of this tick (`Status.OK`) without a warning that makes them worthless
    (joint limit, singular pose, frozen signal, model mismatch, expired tare, wrong
    velocity) are used for identification. In other ticks its last estimate stays and
    time passes: after a longer gap it reports ``TIME_GAP`` and starts its local
    predictions again.

    Depth counts from `zero`: the tare or the last `begin_insertion`, before both the
    first sample.

    Args:
        robot: The arm with its payload; the z axis of its tool frame is the needle,
            unless ``sensor_config`` names another frame or axis.
        sensor_config: Settings of the virtual sensor.
        identifier_config: Settings of the identifier.
        speed_lag_s: Time constant of a low-pass on the speed that the identifier gets
            [s]. Ours needs none; the published one takes speed as exact and wants 20 ms
            on an arm.

    Raises:
        SettingError: For a negative or infinite lag.
        residual.ConfigurationError: For settings of the sensor that cannot work.
        identification.IdentificationError: For settings of another kind of identifier.
    """

    __copy__ = deepcopy  # A shallow copy would share what every sample changes

    def __init__(
        self,
        robot: Robot,
        sensor_config: SensorConfig = DEFAULT_SENSOR,
        identifier_config: MultilayerConfig | PublishedConfig = DEFAULT_IDENTIFIER,
        *,
        speed_lag_s: float = 0.0,
    ) -> None:
        for name, value, kind, hint in (
            ("robot", robot, Robot, "load_lwr() or load_urdf(path) of urdf makes one"),
            (
                "sensor_config",
                sensor_config,
                SensorConfig,
                "SensorConfig() is the default",
            ),
        ):
            if not isinstance(value, kind):
                given = f"{name} is a {type(value).__name__}"
                raise SettingError(f"{given}, expected a {kind.__name__}; {hint}")
        if not (
            isinstance(speed_lag_s, numbers.Real)
            and 0.0 <= float(speed_lag_s) < math.inf
        ):
            raise SettingError(
                f"speed_lag_s is {speed_lag_s!r}, expected a finite number >= 0"
            )
        self._sensor = VirtualForceSensor(robot, sensor_config)
        self.sensor_config = sensor_config
        self._identifier = Identifier(identifier_config)
        self._identifier_config = identifier_config
        self._tool = self._sensor.kinematics
        self._speed_lag_s = float(speed_lag_s)
        self._plan = PlanFollower(None, None)
        self.reset()

    @property
    def tared(self) -> bool:
        """Whether the bias has been removed."""
        return self._sensor.tared

    @property
    def lag_s(self) -> float:
        """Time by which the estimate follows the force [s]; 0 before the first
        sample.
        """
        return self._sensor.lag_s

    @property
    def rejected(self) -> int:
        """Bad samples since the last `reset`."""
        return self._sensor.rejected

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        return self._identifier.layers

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float
    ) -> SessionEstimate:
        """Take one sample of joint signals; see `VirtualForceSensor.update`.

        Args:
            q: Joint positions [rad], shape (n,).
            dq: Joint velocities [rad/s], shape (n,); None, always, for a robot that
                sends none.
            tau: Measured link-side joint torques [Nm], shape (n,).
            dt_s: Time since the previous call [s]; not read on the first one.

        Returns:
            What is known now. A bad sample does not raise: the status reports it.
        """
        return self._follow(self._sensor.update(q, dq, tau, dt_s))

    def update_external_torque(
        self,
        q: ArrayLike,
        dq: ArrayLike | None,
        external_torque: ArrayLike,
        dt_s: float,
    ) -> SessionEstimate:
        """Take one sample of an external-torque estimate that the robot supplies
        itself.

        As `update`, with the torque of the environment on the joints [Nm], shape (n,),
        in place of the measured one.
        """
        return self._follow(
            self._sensor.update_external_torque(q, dq, external_torque, dt_s)
        )

    def tare(self, *, ignore_contact: bool = False) -> Tare:
        """Remove the bias and begin an insertion here; see `VirtualForceSensor.tare`.

        Args:
            ignore_contact: Tare even with contact detected, or velocities that cannot
                be.

        Raises:
            TareError: Without data, a second time without `start_tare_recording`, with
                contact detected or velocities that do not fit positions; nothing has
                then changed.
        """
        tare = self._sensor.tare(ignore_contact=ignore_contact)
        self.begin_insertion()
        return tare

    def start_tare_recording(self) -> None:
        """Record free motion anew for the next `tare`; estimates are `NOT_TARED`
        until then.
        """
        self._sensor.start_tare_recording()

    def follow(
        self, plan: Plan | None, entry_in_base_m: ArrayLike | None = None
    ) -> None:
        """Match the ruptures from now on with a plan: see `SessionEstimate.plan`.

        Args:
            plan: A `needleforce.anatomy.PlanMatch`; None to follow none.
            entry_in_base_m: The plan's entry point in the robot's base, shape (3,), as
                `Registration.to_robot` gives it; None where the plan's depths count
                from where the session's do.

        Raises:
            SettingError: For anything but a plan, or an entry that is no point.
        """
        if plan is not None and not hasattr(plan, "fingerprint"):
            raise SettingError(
                f"plan is a {type(plan).__name__}, expected a PlanMatch of anatomy"
            )
        entry_m = (
            None if entry_in_base_m is None else np.array(entry_in_base_m, dtype=float)
        )
        if entry_m is not None and not (
            entry_m.shape == (3,) and np.isfinite(entry_m).all()
        ):
            raise SettingError(
                f"entry_in_base_m is {entry_in_base_m!r}, expected 3 finite numbers"
            )
        self._plan = PlanFollower(plan, entry_m)
        self._plan.begin(*self.zero)

    def begin_insertion(self) -> None:
        """Count depth from here and forget the layers; the tare stays."""
        self._zero_depth()
        self._travel = 0.0, 0.0, 0.0, 0.0
        self._identifier.reset()
        self._identification = self._identifier.snapshot().last
        self._unused_s = 0.0
        self._is_due = self._had_events = True  # There is nothing before it
        self._keep_checkpoint()
        self._plan.begin(*self.zero)

    def reset(self) -> None:
        """Forget everything, the tare included."""
        self._sensor.reset()
        self._is_started = False
        self._time_s = 0.0
        self.begin_insertion()

    def snapshot(self) -> SessionSnapshot:
        """All that the session remembers; `write_snapshot` stores it."""
        self._keep_checkpoint()
        parts = (
            self._sensor.snapshot(),
            self._identifier.snapshot(),
            self.zero,
            self._travel,
        )
        times_s = self._speed_lag_s, self._unused_s, self._time_s
        return SessionSnapshot(*parts, *times_s, self._earlier, self._plan.memory)

    def restore(self, snapshot: SessionSnapshot) -> None:
        """Go on, bit for bit, from where `snapshot` was taken; an error changes
        nothing.

        Raises:
            SnapshotMismatchError: Not a snapshot of a session, a damaged one, or one of
                another speed lag or plan.
            residual.SnapshotError: A damaged one, or of another robot or settings of
                the sensor.
            identification.IdentificationError: One of other settings of the identifier.
        """
        if not isinstance(snapshot, SessionSnapshot):
            raise SnapshotMismatchError(
                f"expected a SessionSnapshot, got {type(snapshot).__name__}"
            )
        if (
            type(snapshot.plan) is not type(self._plan.memory)
            or len(snapshot.earlier) != 2
        ):
            raise SnapshotMismatchError("the snapshot is damaged: plan or checkpoints")
        if snapshot.speed_lag_s != self._speed_lag_s:
            raise SnapshotMismatchError(
                f"the snapshot is of speed_lag_s {snapshot.speed_lag_s:g}, this session has "
                f"{self._speed_lag_s:g}"
            )
        if snapshot.plan.fingerprint != self._plan.memory.fingerprint:
            what = "with another plan or entry: follow() the same"
            what = what if snapshot.plan.fingerprint else "without a plan: follow(None)"
            raise SnapshotMismatchError(
                f"the snapshot is of a session {what} before restore()"
            )
        plan_state = self._try_out(snapshot)
        # The last that can fail, and it fails as a whole.
        self._sensor.restore(snapshot.sensor)
        self._identifier.restore(snapshot.identifier)
        self._count_from(snapshot.zero)
        self._is_started = snapshot.sensor.last is not None
        self._travel = snapshot.travel
        self._unused_s = snapshot.unused_s
        self._time_s = snapshot.time_s
        self._earlier = snapshot.earlier
        self._is_due = False
        self._identification = snapshot.identifier.last.without_events()
        self._plan.resume(snapshot.plan, plan_state)

    def _try_out(self, snapshot: SessionSnapshot) -> "PlanState | None":
        """Refuse what would fail in later updates; nothing of this session changes."""
        twin = Identifier(self._identifier_config)
        try:
            for part in (
                *(each.identifier for each in snapshot.earlier),
                snapshot.identifier,
            ):
                twin.restore(part)
            for _ in range(3):
                twin.update(*snapshot.travel[:2], 0.0, 1e-3)
            numbers = (
                *snapshot.travel,
                snapshot.unused_s,
                snapshot.time_s,
                *np.ravel(snapshot.zero),
            )
            shapes = np.shape(snapshot.zero), np.shape(snapshot.travel)
            if (
                shapes != ((2, 3), (4,))
                or not np.isfinite(numbers).all()
                or snapshot.time_s < 0.0
            ):
                raise SnapshotMismatchError(
                    "the snapshot is damaged: zero, travel or time"
                )
            return self._plan.read(snapshot.plan)
        except (IdentificationError, InsertionError):
            raise
        except Exception as error:  # whatever a damaged state makes of its parts
            raise SnapshotMismatchError(
                f"the snapshot is damaged: {error!r}"
            ) from error

    def _zero_depth(self) -> None:
        """Count depth from where the tip is, along the needle's present direction."""
        tool = self._tool
        self._count_from(TravelZero(tool.pose[:3, 3].copy(), tool.axis_in_base.copy()))

    def _count_from(self, zero: TravelZero) -> None:
        self._start_m = float(zero.axis_in_base.dot(zero.start_in_base_m))
        self.zero = zero

    def _follow(self, wrench: WrenchEstimate) -> SessionEstimate:
        """Depth, speed and, where the force can be used, the identification."""
        self._keep_checkpoint()
        status = wrench.status
        if status is _REJECTED:
            return self._idle(wrench)
        if not self._is_started:
            self._zero_depth()
            self._is_started = True
        else:
            # The sensor's clock counts the time of rejected samples and knows one that
            # was set.
            self._time_s += self._sensor.elapsed_s
        sensor = self._sensor
        tool = self._tool
        axis = self.zero.axis_in_base
        elapsed_s = sensor.elapsed_s
        lags_s = (self._speed_lag_s, sensor.filter_lag_s)
        tip = axis, tool.needle, sensor.velocity_rad_s
        self._travel = travel = travel_step(
            tip, self._start_m, self._travel, elapsed_s, lags_s
        )
        if status is not _OK or (wrench.warnings and wrench.warnings & _NOT_USED):
            return self._skip(wrench, elapsed_s)
        if self._unused_s:
            if sensor.recheck(wrench).warnings & _PUSHED:
                return self._skip(wrench, elapsed_s)
            elapsed_s = elapsed_s + self._unused_s
            self._unused_s = 0.0
        _, _, depth_m, speed_m_s = travel
        time_s = self._time_s
        force_N = wrench.axial_unsmoothed
        std_N = wrench.axial_std
        found = self._identifier.update(
            depth_m, speed_m_s, force_N, elapsed_s, time_s, std_N
        )
        if found.rupture is not None:
            # A push on the arm looks like a rupture, even before the checks, every 20
            # ms, know it.
            wrench = self._sensor.recheck(wrench)
            if wrench.warnings & _PUSHED:
                return self._skip(wrench, 0.0)  # its time was used: that is taken back
        self._identification = found
        self._had_events = found.has_events
        due_s = self._earlier[1].time_s + _TAKEN_BACK_S
        self._is_due = self._had_events or self._time_s >= due_s
        self._plan.follow(found, depth_m, self._identifier)
        at = (found.status in _USED, self._time_s, self._plan.state)
        return _new(SessionEstimate, (wrench, *travel[:2], found, status, *at))

    def _keep_checkpoint(self) -> None:
        """Keep where to go back to, not before events: what was reported is not
        reported again.
        """
        if self._is_due:  # since the last sample, which had enough to do
            now = Checkpoint(self._time_s, self._identifier.snapshot())
            self._is_due = False
            self._earlier = now if self._had_events else self._earlier[1], now

    def _skip(self, wrench: WrenchEstimate, elapsed_s: float) -> SessionEstimate:
        """A valid tick that the identification does not get, or that raised a rupture
        in a push.

        The first with a push on the arm also takes back what that has done before it
        was known.
        """
        self._unused_s += elapsed_s
        before = self._earlier[0]
        used_s = self._time_s - self._unused_s - before.time_s
        if used_s > 0.5 * elapsed_s and wrench.warnings & _PUSHED:
            self._identifier.resume(before.identifier)  # checks take longer than a tick
            self._identification = before.identifier.last
            self._unused_s = self._time_s - before.time_s
            self._earlier = (before, before)
        return self._idle(wrench)

    def _idle(self, wrench: WrenchEstimate) -> SessionEstimate:
        """A tick that is not used for identification."""
        last = self._identification = self._identification.without_events()
        at = (False, self._time_s, self._plan.state)
        return _new(
            SessionEstimate, (wrench, *self._travel[:2], last, wrench.status, *at)
        )
