"""One insertion, tick by tick, from joint signals to the force at the needle's tip."""

import math
import numbers
from copy import deepcopy
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from foundation.errors import NeedleforceError
from foundation.state import (
    OWN_SNAPSHOT,
    SAME_KIND,
    SAME_SETTINGS,
    StateError,
    check_state,
)
from identification import MIXTURE as DEFAULT_IDENTIFIER
from identification import (
    Estimate,
    IdentificationError,
    Identifier,
    LayerEstimate,
    MixtureConfig,
    PublishedConfig,
)
from identification import Snapshot as IdentifierSnapshot
from identification.channel import (
    continue_channel,
    count_depth_from,
    has_cut,
    read_friction,
)
from needleforce.air_watch import FIRST_AIR_WATCH, AirWatch
from needleforce.insertion_course import (
    InsertionCourse,
    InsertionProgress,
    follow_needle,
)
from needleforce.needle_channels import (
    MIN_LENGTH_M,
    ChannelState,
    NeedleChannel,
    OldChannel,
    add_channel,
    find_channel,
    remove_channel,
)
from needleforce.needle_on_plan import (
    PlanDeviation,
    PlannedEntry,
    PlannedPath,
    Surroundings,
)
from needleforce.plan_follower import Plan, PlanFollower, PlanMemory
from needleforce.session_event import SessionEvent
from needleforce.tip_travel import TipTravel, TravelZero
from residual import DEFAULT as DEFAULT_SENSOR
from residual import (
    SensorConfig,
    SensorWarning,
    Status,
    TareError,
    VirtualForceSensor,
    WrenchEstimate,
)
from residual.bias.model import Tare
from residual.bias.separation import JointSeparation
from residual.virtual_force_sensor import SensorState
from urdf import Robot

if TYPE_CHECKING:
    from needleforce.anatomy import NeedleClearance, PlanState

UNUSABLE = (
    SensorWarning.JOINT_LIMIT
    | SensorWarning.NEAR_SINGULAR
    | SensorWarning.MODEL_MISMATCH
    | SensorWarning.FROZEN
    | SensorWarning.TARE_EXPIRED
    | SensorWarning.VELOCITY
)
"""Warnings with which the force of a sample is not used for identification."""
PUSHED = SensorWarning.MODEL_MISMATCH | SensorWarning.ARM_PUSHED
"""Warnings that indicate a contact elsewhere than at the tip.

With `ARM_PUSHED` alone samples are still used: the force is off only by the part that
looks axial, and a lateral force that begins suddenly raises the warning, too. But no
rupture is reported then, and no gap ends.
"""
CHECKPOINT_PERIOD_S = 0.25
"""Time between states to rewind to: a push on the arm grows for up to this long before
it is detected."""


class InsertionError(NeedleforceError):
    """Base of a session's errors.

    Errors of `residual` and `identification` pass through a session unchanged.
    """

    usual_advice = (
        "Give what the message expects; `load_lwr` and `load_urdf` make a robot, "
        "`SensorConfig` holds the settings of the sensor."
    )


class SessionSettingError(InsertionError, ValueError):
    """A setting that cannot work: the message names it, what came and what is valid."""


class SnapshotMismatchError(InsertionError, ValueError):
    """A snapshot that cannot be restored here; nothing has changed."""

    usual_advice = "Take an older snapshot, or start and tare anew."


class SnapshotFileError(InsertionError, ValueError):
    """A file that is no snapshot, or one of a version that cannot be read."""

    usual_advice = OWN_SNAPSHOT


class SessionEstimate(NamedTuple):
    """Estimate after one tick. Every number is finite.

    Attributes:
        wrench: Force on the needle, see `WrenchEstimate`.
        depth_m: Travel of the tip along the needle since the tare, `begin_insertion` or
            a turn of the needle in free air.
        speed_m_s: Speed of the tip along the needle.
        identification: Layers, friction, tip force: those of the last tick used for
            identification. Its events (``rupture``, ``identified_layer``,
            ``retracted``) stand only in the tick that brought them. Times are on this
            session's clock, depths from its zero.
        status: Whether the numbers are of this tick and tared.
        used_for_identification: Whether this tick's force went into the identification.
        time_s: Sum of the time steps since the first valid sample after `reset` [s]:
            the clock of all events. The time step of a rejected sample is added with
            the next valid one. A clock that is set back, or forward by more than a day,
            adds nothing.
        depth_in_tissue_m: Depth below the first contact, or below the entry of the plan
            that is followed; None before the contact, without an entry.
        channel: Whether this insertion goes on in an earlier one's channel.
        plan: State of plan and ruptures together: the layer, the next boundary, the
            offset; None before the tare, and without `InsertionSession.follow`. Where
            the needle is off the plan it names no layer.
        deviation: The needle against the planned path, at every tick; None without one.
        clearances: How near the needle, and its way ahead, come to structures at risk,
            the nearest first; empty where that is not known.
        plan_events: What happened on the plan with this tick: ``past_target``,
            ``too_near``.
    """

    wrench: WrenchEstimate
    depth_m: float
    speed_m_s: float
    identification: Estimate
    status: Status
    used_for_identification: bool
    time_s: float
    depth_in_tissue_m: float | None = None
    channel: ChannelState = ChannelState.FRESH
    plan: "PlanState | None" = None
    deviation: PlanDeviation | None = None
    clearances: tuple["NeedleClearance", ...] = ()
    plan_events: tuple[SessionEvent, ...] = ()

    @property
    def warnings(self) -> SensorWarning:
        """Possible errors of the force beyond its standard deviation."""
        return self.wrench.warnings


class Checkpoint(NamedTuple):
    """State of the identification at one instant, to which a session can rewind.

    Attributes:
        time_s: See `SessionEstimate`.
        identifier: State of the identifier at that time.
    """

    time_s: float
    identifier: IdentifierSnapshot


class Checkpoints(NamedTuple):
    """The two checkpoints that a session keeps.

    A push on the arm rewinds to the older one. While the two differ, this undoes at
    least `CHECKPOINT_PERIOD_S`. They are equal, and less may be undone, from an event,
    a rewind or the start of an insertion until the next checkpoint.

    Attributes:
        older: The one before ``newer``, or the same one: events are never undone.
        newer: State after the sample that made it due, saved when the next one comes.
    """

    older: Checkpoint
    newer: Checkpoint


class SessionSnapshot(NamedTuple):
    """Complete state of an `InsertionSession`; immutable.

    Attributes:
        sensor: State of the virtual sensor.
        identifier: State of the identifier.
        zero: Where depth counts from.
        travel: Depth and speed of the tip.
        speed_lag_s: Setting of the session.
        unused_s: Time of valid samples that were not used for identification.
        jumps: Number of jumps of torque sensors that the identifier knows of.
        jump_std_N: Standard deviation of the axial force due to these jumps; 0 without
            one.
        time_s: See `SessionEstimate`.
        checkpoints: States of the identification to rewind to.
        insertion: Course of this insertion.
        channels: Those that earlier insertions have cut.
        plan: State of the plan's follower.
        air: What the force in free air has shown.
    """

    sensor: SensorState
    identifier: IdentifierSnapshot
    zero: TravelZero
    travel: TipTravel
    speed_lag_s: float
    unused_s: float
    jumps: int
    jump_std_N: float
    time_s: float
    checkpoints: Checkpoints
    insertion: InsertionProgress
    channels: tuple[NeedleChannel, ...]
    plan: PlanMemory
    air: AirWatch


JUMP_SEEN_S = 0.6
"""Within it a changed zero is noticed: a rupture since may be that change."""

_OUTSIDE_M = 2e-3  # In front of the first contact the tissue is left behind for sure


class InsertionSession:
    """Virtual sensor, tip travel and identifier in one.

    Call `update` every tick from the start of the robot; move in free air, call `tare`,
    insert. Another insertion with the same tare needs no call: in free air a turn of 3
    degrees, an advance after a retreat of 3 mm, or a move aside from the place of the
    last insertion begins it. Channels are remembered: in an old one the tip has no
    force until the end, unless the force contradicts that (`SessionEstimate.channel`).
    The published method gets none of this: call `begin_insertion`.

    Only forces of this tick (`Status.OK`) without a warning that makes them worthless
    (joint limit, singular pose, frozen signal, model mismatch, expired tare, wrong
    velocity) are used for identification. In other ticks its last estimate stays and
    time passes: after a longer gap it reports ``TIME_GAP`` and starts its local
    predictions again.

    Depth counts from `zero`: where the tip was at the tare, the last `begin_insertion`
    or the last turn in free air, whichever came latest. Until then it counts from the
    first valid sample.

    Args:
        robot: The arm with its payload; the z axis of its tool frame is the needle,
            unless ``sensor_config`` names another frame or axis.
        sensor_config: Settings of the virtual sensor.
        identifier_config: Settings of the identifier.
        speed_lag_s: Time constant of a low-pass on the speed that the identifier gets
            [s]. Ours needs none; the published one takes speed as exact and wants 20 ms
            on an arm.

    Raises:
        SessionSettingError: For a negative or infinite lag.
        residual.ConfigurationError: For settings of the sensor that cannot work.
        identification.IdentificationError: For settings of another kind of identifier.
    """

    __copy__ = deepcopy  # A shallow copy would share what every sample changes

    def __init__(
        self,
        robot: Robot,
        sensor_config: SensorConfig = DEFAULT_SENSOR,
        identifier_config: MixtureConfig | PublishedConfig = DEFAULT_IDENTIFIER,
        *,
        speed_lag_s: float = 0.0,
    ) -> None:
        _check_settings(robot, sensor_config, speed_lag_s)
        self._sensor = VirtualForceSensor(robot, sensor_config)
        self.sensor_config = sensor_config
        self._identifier = Identifier(identifier_config)
        self._identifier_config = identifier_config
        self._is_watched = isinstance(identifier_config, MixtureConfig)
        self._tool = self._sensor.kinematics
        self._speed_lag_s = float(speed_lag_s)
        self._plan = PlanFollower(None, None)
        self.reset()

    @property
    def tared(self) -> bool:
        """Whether the bias has been removed."""
        return self._sensor.tared

    @property
    def taring(self) -> bool:
        """Whether a tare is being fitted beside the updates, see `start_tare`."""
        return self._sensor.taring

    @property
    def tare_refusal(self) -> TareError | None:
        """Why the latest `start_tare` was refused; None if it was not."""
        return self._sensor.tare_refusal

    @property
    def tare_separation(self) -> tuple[JointSeparation, ...]:
        """How well the tare told hysteresis from friction at every joint.

        `residual.advise_motion` says what motion would tell more. Empty before a tare.
        """
        return self._sensor.tare_separation

    @property
    def lag_s(self) -> float:
        """Time by which the estimate follows the force [s]; 0 before any sample."""
        return self._sensor.lag_s

    @property
    def rejected(self) -> int:
        """Bad samples since the last `reset`."""
        return self._sensor.rejected

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as estimated now.

        Before the needle meets tissue they are those of the insertion before, unless
        `begin_insertion` or `tare` was called.
        """
        return self._identifier.layers or self._course.layers_before

    def update(
        self, q: ArrayLike, dq: ArrayLike | None, tau: ArrayLike, dt_s: float
    ) -> SessionEstimate:
        """Process one sample of joint signals; see `VirtualForceSensor.update`.

        Args:
            q: Joint positions [rad], shape (n,).
            dq: Joint velocities [rad/s], shape (n,); None, always, for a robot that
                sends none.
            tau: Measured link-side joint torques [Nm], shape (n,).
            dt_s: Time since the previous call [s]; not read on the first one.

        Returns:
            The estimate after this sample. A bad sample does not raise: the status
            reports it.
        """
        was_taring = self._sensor.taring
        estimate = self._process(self._sensor.update(q, dq, tau, dt_s))
        if was_taring and self.tared:
            self._begin_where_tared()
        return estimate

    def update_external_torque(
        self,
        q: ArrayLike,
        dq: ArrayLike | None,
        external_torque: ArrayLike,
        dt_s: float,
    ) -> SessionEstimate:
        """Process one sample of the robot's own estimate of the external torque.

        As `update`, with the torque of the environment on the joints [Nm], shape (n,),
        in place of the measured one.
        """
        was_taring = self._sensor.taring
        estimate = self._process(
            self._sensor.update_external_torque(q, dq, external_torque, dt_s)
        )
        if was_taring and self.tared:
            self._begin_where_tared()
        return estimate

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
        self._begin_tare()
        return tare

    def start_tare(
        self, *, ignore_contact: bool = False, steps_per_tick: int = 1
    ) -> None:
        """Begin a tare that is fitted beside the updates that follow.

        While `taring`, estimates are `NOT_TARED` and say so, and nothing is used for
        identification; the layers are forgotten at once. Depth counts from where the
        tip is in the update that completes the tare; the next one is tared. Keep the
        needle in free air until then. If the tare is refused, `taring` ends without
        `tared`, and `tare_refusal` says why. See `VirtualForceSensor.start_tare`.

        Args:
            ignore_contact: See `tare`.
            steps_per_tick: Steps of the fit in every update.

        Raises:
            TareError: Without data, a second time without `start_tare_recording`, or
                with velocities that do not fit positions.
            residual.ConfigurationError: If the number of steps cannot be.
        """
        if self.taring:
            return
        self._sensor.start_tare(
            ignore_contact=ignore_contact, steps_per_tick=steps_per_tick
        )
        # Now, not in the tick that ends the tare: that would be a long one.
        self._begin_tare()

    def start_tare_recording(self) -> None:
        """Record free motion anew for the next `tare`.

        Estimates are `NOT_TARED` until then.
        """
        self._sensor.start_tare_recording()

    def follow(
        self,
        plan: Plan | None,
        entry_in_base_m: ArrayLike | None = None,
        *,
        path: PlannedPath | None = None,
        surroundings: Surroundings | None = None,
    ) -> None:
        """Match the ruptures from now on with a plan: see `SessionEstimate.plan`.

        With a path every estimate states how far the needle is off it, and an entry
        alone how far the needle's line passes from it; see `SessionEstimate.deviation`.

        Args:
            plan: A `needleforce.anatomy.PlanMatch`; None to follow none.
            entry_in_base_m: The plan's entry point in the robot's base, shape (3,), as
                `Registration.to_robot` gives it; None where the plan's depths count
                from where the session's do, or with a path.
            path: The planned path in the robot's base.
            surroundings: A `needleforce.anatomy.NeedleSurroundings`; with it and a path
                every estimate states how near the needle comes to structures at risk.

        Raises:
            SessionSettingError: For anything but a plan, or an entry that is no point.
        """
        if plan is not None and not hasattr(plan, "fingerprint"):
            raise SessionSettingError(
                f"plan is a {type(plan).__name__}, expected a PlanMatch of anatomy"
            )
        checked_path: PlannedPath | PlannedEntry | None = path
        if plan is not None and path is None and entry_in_base_m is not None:
            entry_m = _checked_entry(entry_in_base_m)
            checked_path = PlannedEntry(entry_m, plan.offset_std_m)
        self._plan = PlanFollower(plan, checked_path, surroundings)
        self._plan.begin(*self.zero)

    def begin_insertion(self) -> None:
        """Count depth from here and, in free air, forget the layers.

        Tare and channels stay. In tissue, in a channel that the needle has cut, or in
        front of it, layers and friction stay as well.
        """
        if self._is_in_tissue:
            self._move_zero_here()
        else:
            self._remember_channel()
            self._begin_here()
            self._continue_channel()

    def forget_channels(self) -> None:
        """Forget the channels of earlier insertions: the tissue has moved.

        A needle in tissue keeps what it knows of its own channel.
        """
        self._channels = ()
        if not self._is_in_tissue:
            self._begin_anew()

    @property
    def _is_in_air(self) -> bool:
        """Whether the tip is in front of the tissue, or none has been met."""
        contact_m = self._contact_m
        return contact_m is None or self._travel.depth_m < contact_m

    @property
    def _is_in_tissue(self) -> bool:
        """Whether tip and force are where tissue has been met.

        A contact that the force does not show may be none.
        """
        # Deviations of a force that shows that the tip is in tissue
        tissue_sigmas = 3.0
        if self._is_in_air:
            return False
        identification = self._identification
        net_N = identification.tip_force_N + identification.shaft_friction_N
        std_N = identification.tip_force_std_N or 0.0
        return abs(net_N) > tissue_sigmas * std_N or self._length_to_remember_m > 0.0

    def _move_zero_here(self) -> None:
        """Count depth from here; what is known of the tissue stays."""
        travel = self._travel
        moved_m = -travel.depth_m
        self._zero_depth()
        self._travel = travel._replace(
            depth_m=0.0, delayed_depth_m=travel.delayed_depth_m + moved_m
        )
        self._course.begin(self._course.insertion.with_depths_moved(moved_m))
        unused_s = self._unused_s
        self._resume(count_depth_from(self._identifier.snapshot(), moved_m))
        self._unused_s = unused_s
        self._plan.move_zero(*self.zero, moved_m)

    def _begin_here(self) -> None:
        """Begin an insertion with depth zero here."""
        self._zero_depth()
        self._travel = TipTravel()
        self._begin(InsertionProgress(self.zero))

    def _begin_tare(self) -> None:
        """Begin an insertion where a tare says that there is free air."""
        self._air = FIRST_AIR_WATCH
        if self._is_in_air:
            self._remember_channel()
        self._begin_here()

    def _begin_where_tared(self) -> None:
        """Count depth from here at the end of a tare; no sample was used since."""
        self._air = FIRST_AIR_WATCH
        self._zero_depth()
        self._travel = TipTravel()
        self._course.begin(InsertionProgress(self.zero))
        self._unused_s = 0.0
        begin = Checkpoint(self._time_s, self._checkpoints.newer.identifier)
        self._checkpoints = Checkpoints(begin, begin)
        self._plan.begin(*self.zero)

    def reset(self) -> None:
        """Forget everything, the tare and the channels included."""
        self._sensor.reset()
        self._is_started = False
        self._air = FIRST_AIR_WATCH
        self._time_s = 0.0
        self._channels: tuple[NeedleChannel, ...] = ()
        self._course = InsertionCourse(InsertionProgress(self._line))
        self._begin_here()

    def snapshot(self) -> SessionSnapshot:
        """Return the complete state of the session; `write_snapshot` stores it."""
        self._save_checkpoint_if_due()
        return SessionSnapshot(
            sensor=self._sensor.snapshot(),
            identifier=self._identifier.snapshot(),
            zero=self.zero,
            travel=self._travel,
            speed_lag_s=self._speed_lag_s,
            unused_s=self._unused_s,
            jumps=self._jumps,
            jump_std_N=self._jump_std_N,
            time_s=self._time_s,
            checkpoints=self._checkpoints,
            insertion=self._course.insertion,
            channels=self._channels,
            plan=self._plan.memory,
            air=self._air,
        )

    def restore(self, snapshot: SessionSnapshot) -> None:
        """Continue, bit for bit, from where ``snapshot`` was taken.

        An error changes nothing.

        Raises:
            SnapshotMismatchError: Not a snapshot of a session, a damaged one, or one of
                another speed lag or plan.
            residual.SnapshotError: A damaged one, or of another robot or settings of
                the sensor.
            identification.IdentificationError: One of other settings of the identifier.
        """
        self._check_kind_and_settings(snapshot)
        plan_state = self._check_parts(snapshot)
        # The last step that can fail; where it does, the sensor has not changed either.
        self._sensor.restore(snapshot.sensor)
        self._identifier.restore(snapshot.identifier)
        self._count_depth_from(snapshot.zero)
        self._is_started = snapshot.sensor.last is not None
        self._travel = snapshot.travel
        self._unused_s = snapshot.unused_s
        self._jumps = snapshot.jumps
        self._jump_std_N = snapshot.jump_std_N
        self._time_s = snapshot.time_s
        self._checkpoints = snapshot.checkpoints
        self._course.begin(snapshot.insertion)
        self._channels = snapshot.channels
        self._air = snapshot.air
        self._contact_m = self._identifier.contact_depth_m
        self._is_checkpoint_due = False
        self._identification = snapshot.identifier.last.without_events()
        self._plan.resume(snapshot.plan, plan_state)
        self._plan.compare_with(self._tool)

    def _check_kind_and_settings(self, snapshot: SessionSnapshot) -> None:
        """Refuse what is no snapshot of a session with these settings and this plan."""
        if not isinstance(snapshot, SessionSnapshot):
            raise SnapshotMismatchError(
                f"expected a SessionSnapshot, got {type(snapshot).__name__}",
                SAME_KIND,
            )
        if not (
            isinstance(snapshot.plan, PlanMemory)
            and isinstance(snapshot.checkpoints, Checkpoints)
        ):
            raise SnapshotMismatchError("the snapshot is damaged: plan or checkpoints")
        if snapshot.speed_lag_s != self._speed_lag_s:
            raise SnapshotMismatchError(
                f"the snapshot is of speed_lag_s {snapshot.speed_lag_s:g}, this "
                f"session has {self._speed_lag_s:g}",
                SAME_SETTINGS,
            )
        if snapshot.plan.fingerprint != self._plan.memory.fingerprint:
            difference = (
                "with another plan or entry"
                if snapshot.plan.fingerprint
                else "without a plan"
            )
            raise SnapshotMismatchError(
                f"the snapshot is of a session {difference}",
                "Call `follow` with the plan of the snapshot, or None, "
                "before `restore`.",
            )

    def _check_parts(self, snapshot: SessionSnapshot) -> "PlanState | None":
        """Refuse a snapshot that would fail in later updates; the session stays as is.

        Returns:
            The state of the plan that belongs to the snapshot.
        """
        try:
            self._check_identifiers(snapshot)
            self._check_own_part(snapshot)
            return self._plan.evaluate(snapshot.plan)
        except (IdentificationError, InsertionError):
            raise
        except Exception as error:  # the parts of a damaged state may raise anything
            raise SnapshotMismatchError(
                f"the snapshot is damaged: {error!r}"
            ) from error

    def _check_identifiers(self, snapshot: SessionSnapshot) -> None:
        """Restore each state of an identifier in a trial one, and update the last."""
        trial_step_s = 1e-3  # Time step of these updates
        trial_updates = 3  # Updates that a restored identifier must survive
        trial = Identifier(self._identifier_config)
        trial.restore(snapshot.checkpoints.older.identifier)
        trial.restore(snapshot.checkpoints.newer.identifier)
        for channel in snapshot.channels:
            trial.restore(channel.identifier)
        if snapshot.insertion.channel is not None:
            trial.restore(snapshot.insertion.channel.in_air)
        trial.restore(snapshot.identifier)
        travel = snapshot.travel
        for _ in range(trial_updates):
            trial.update(travel.depth_m, travel.speed_m_s, 0.0, trial_step_s)

    def _check_own_part(self, snapshot: SessionSnapshot) -> None:
        """Refuse values that cannot be in what is the session's own.

        Sensor and identifiers check their parts, the plan's follower its own.
        """
        here = self.snapshot()
        for name in (
            "zero",
            "travel",
            "unused_s",
            "jumps",
            "jump_std_N",
            "time_s",
            "air",
        ):
            check_state(getattr(snapshot, name), getattr(here, name), name)
        check_state(snapshot.insertion, here.insertion, "insertion")
        for channel in snapshot.channels:
            check_state(channel, place="channel")
            check_state(channel.entry, here.zero, "channel.entry")
        if snapshot.time_s < 0.0:
            raise StateError(f"time_s is {snapshot.time_s:g}, expected no less than 0")

    def _zero_depth(self) -> None:
        """Count depth from where the tip is, along the needle's present direction."""
        self._count_depth_from(self._line)

    def _count_depth_from(self, zero: TravelZero) -> None:
        self._start_m = float(zero.axis_in_base.dot(zero.start_in_base_m))
        self.zero = zero

    def _process(self, wrench: WrenchEstimate) -> SessionEstimate:
        """Update depth, speed and, where the force is usable, the identification."""
        self._save_checkpoint_if_due()
        if wrench.status is Status.REJECTED:
            return self._repeat_last(wrench)
        self._advance_clock()
        self._update_travel()
        elapsed_s = self._sensor.elapsed_s
        is_spoilt = self._sensor.is_measuring_jump
        warnings = wrench.warnings
        # Without any, the test of a flag, which takes a microsecond, is left out.
        is_unusable = warnings is not SensorWarning.NONE and bool(warnings & UNUSABLE)
        is_bad = wrench.status is not Status.OK or is_unusable
        if is_bad or is_spoilt:
            return self._skip_sample(wrench, elapsed_s, is_spoilt=is_spoilt)
        is_resuming = self._unused_s > 0.0
        if self._is_watched:
            self._watch_needle(is_resuming=is_resuming)
        # The warnings of a push come from periodic checks, which may miss one that is
        # still there: a gap ends only once a check of this very sample shows none.
        if is_resuming and self._sensor.recheck(wrench).warnings & PUSHED:
            return self._skip_sample(wrench, elapsed_s)
        self._doubt_zero_after_jump()
        self._watch_air(wrench, elapsed_s)
        identification = self._identify(wrench, elapsed_s + self._unused_s)
        self._unused_s = 0.0
        if identification.rupture is not None:
            # A push on the arm looks like a rupture, even before the periodic checks
            # detect it.
            wrench = self._sensor.recheck(wrench)
            if wrench.warnings & PUSHED:
                # The identifier has used this sample, so its time is not added here.
                # The rewind that follows undoes that and counts it as unused.
                return self._skip_sample(wrench, elapsed_s=0.0)
        self._accept(identification)
        channel = self._course.channel
        if channel is not None:
            self._check_channel(channel, wrench)
        return self._estimate(wrench, is_used=identification.status.is_used)

    def _advance_clock(self) -> None:
        """Add the time since the last valid sample; the first one sets zero depth.

        That time includes the steps of samples rejected in between, but not the jump of
        a clock that was set.
        """
        if self._is_started:
            self._time_s += self._sensor.elapsed_s
        else:
            self._zero_depth()
            self._course.begin(InsertionProgress(self.zero))
            self._plan.begin(*self.zero)
            self._is_started = True

    def _update_travel(self) -> None:
        """Update depth and speed of the tip from the sample's joint signals."""
        sensor = self._sensor
        line = self._course.line
        position_m, speed_m_s, self._is_turned, self._is_aside, self._is_off_line = (
            follow_needle(
                self.zero.axis_in_base,
                line.start_in_base_m,
                line.axis_in_base,
                self._tool.needle,
                sensor.velocity_rad_s,
            )
        )
        self._travel = self._travel.advanced(
            position_m - self._start_m,
            speed_m_s,
            sensor.elapsed_s,
            speed_lag_s=self._speed_lag_s,
            force_lag_s=sensor.filter_lag_s,
        )
        self._plan.compare_with(self._tool)

    def _watch_needle(self, *, is_resuming: bool) -> None:
        """Follow the needle, and begin another insertion where it has left the last.

        Args:
            is_resuming: Whether samples before this one were not used, in which the
                needle may have gone anywhere.
        """
        course = self._course
        depth_m = self._travel.depth_m
        contact_m = self._contact_m
        course.move_to(depth_m)
        is_met = contact_m is not None
        if course.is_met != is_met:
            course.meet(self._line, depth_m, is_met=is_met)
            self._is_aside = False
            self._is_off_line = False
        if contact_m is not None and depth_m >= contact_m:
            if not self._is_aside:
                return
            if not is_resuming:
                course.is_met = False  # No tissue lets a needle move so.
            self._leave_insertion()
        elif (
            self._is_aside
            or course.has_retreated(depth_m, contact_m)
            or (is_met and self._is_off_line)
            or self._is_turned
        ):
            self._leave_insertion()
        if self._channels and not course.is_met:
            self._continue_channel()

    @property
    def _line(self) -> TravelZero:
        """Where the tip is now, and the needle's direction."""
        tool = self._tool
        return TravelZero(
            start_in_base_m=tool.pose[:3, 3].copy(),
            axis_in_base=tool.axis_in_base.copy(),
        )

    def _leave_insertion(self) -> None:
        """Remember the channel and begin anew, along the needle's axis if it turned."""
        self._remember_channel()
        if self._is_turned:
            self._zero_depth()
            self._travel = TipTravel()
        self._begin_anew()

    def _begin_anew(self) -> None:
        """Begin an insertion here; layers stay until tissue is met."""
        layers = self.layers
        depth_m = self._travel.depth_m
        self._begin(
            InsertionProgress(
                line=self._line,
                line_depth_m=depth_m,
                deepest_m=depth_m,
                highest_m=depth_m,
                layers_before=layers,
            )
        )

    def _begin(self, insertion: InsertionProgress) -> None:
        """Begin an insertion: forget what was identified."""
        self._course.begin(insertion)
        self._identifier.reset()
        self._jumps = self._sensor.jumps
        self._jump_std_N = self._sensor.jump_std_N
        self._forget_checkpoints()
        self._plan.begin(*self.zero)

    def _resume(self, identifier: IdentifierSnapshot) -> None:
        """Go on from a state of the identifier, without a way back."""
        self._identifier.resume(identifier)
        self._forget_checkpoints()

    def _forget_checkpoints(self) -> None:
        """Keep no state of an earlier insertion to rewind to."""
        self._unused_s = 0.0
        self._is_checkpoint_due = True
        self._had_events = True
        self._save_checkpoint_if_due()
        self._identification = self._checkpoints.newer.identifier.last
        self._contact_m = self._identifier.contact_depth_m

    @property
    def _length_to_remember_m(self) -> float:
        """Length of the channel that this insertion has cut; 0 if it has cut none."""
        contact_m = self._contact_m
        if contact_m is None or not self._course.is_met:
            return 0.0
        length_m = self._course.insertion.deepest_m - contact_m
        is_long = length_m >= MIN_LENGTH_M
        return length_m if is_long and has_cut(self._identifier.snapshot()) else 0.0

    def _remember_channel(self) -> None:
        """Remember the channel that this insertion has cut, if it has cut one."""
        contact_m = self._contact_m
        length_m = self._length_to_remember_m
        if contact_m is None or length_m == 0.0:
            return
        insertion = self._course.insertion
        start_m, axis = insertion.line
        entry_m = start_m + (contact_m - insertion.line_depth_m) * axis
        channel = NeedleChannel(
            entry=TravelZero(entry_m, axis),
            length_m=length_m,
            entry_depth_m=contact_m,
            left_s=self._time_s,
            identifier=self._identifier.snapshot(),
        )
        self._channels = add_channel(self._channels, channel)

    def _continue_channel(self) -> None:
        """Go on in a channel that the needle comes to, or is in."""
        channel = find_channel(self._channels, self._tool.needle)
        if channel is None:
            return
        friction = read_friction(channel.identifier)
        if friction is None:
            return
        start_m, zero_axis = self.zero
        entry_depth_m = float(zero_axis.dot(channel.entry.start_in_base_m - start_m))
        end_m = entry_depth_m + channel.length_m
        depth_m = self._travel.depth_m
        in_air = self._identifier.snapshot()
        self._resume(
            continue_channel(
                channel.identifier,
                in_air,
                moved_m=entry_depth_m - channel.entry_depth_m,
                passed_s=self._time_s - channel.left_s,
            )
        )
        old = OldChannel(
            begin_m=entry_depth_m,
            end_m=end_m,
            friction=friction,
            in_air_s=self._time_s,
            in_air=in_air,
            checked_m=depth_m,
        )
        self._course.begin(
            InsertionProgress(
                line=channel.entry,
                line_depth_m=entry_depth_m,
                is_met=True,
                deepest_m=end_m,
                highest_m=depth_m,
                channel_state=ChannelState.REMEMBERED,
                channel=old,
            )
        )
        layers = self._identifier.layers
        self._plan.begin(*self.zero, tuple(layer.rupture for layer in layers))

    def _check_channel(self, old: OldChannel, wrench: WrenchEstimate) -> None:
        """Compare the force with the friction of the channel; drop it if they differ.

        Args:
            old: The channel in which the needle goes on.
            wrench: Force of a sample that was used.
        """
        identification = self._identification
        friction_N = identification.predicted_force_N
        excess_N = wrench.axial_unsmoothed - friction_N
        old = old.compared(self._travel, excess_N, wrench.axial_std)
        self._course.channel = old
        if old.is_contradicted(
            self._travel.delayed_speed_m_s,
            friction_N,
            wrench.axial_std,
            identification.tip_force_std_N or 0.0,
        ):
            self._drop_channel(old)

    def _drop_channel(self, old: OldChannel) -> None:
        """Forget a channel, and what was identified since the needle came to it.

        The identification goes on where the needle was still in free air; the time
        since then is a gap.
        """
        line = self._course.line
        self._channels = remove_channel(
            self._channels, line, length_m=old.end_m - old.begin_m
        )
        self._resume(old.in_air)
        checkpoint = Checkpoint(old.in_air_s, old.in_air)
        self._checkpoints = Checkpoints(checkpoint, checkpoint)
        self._unused_s = self._time_s - old.in_air_s
        depth_m = self._travel.depth_m
        self._course.begin(
            InsertionProgress(
                line=line,
                line_depth_m=old.begin_m,
                deepest_m=depth_m,
                highest_m=depth_m,
                channel_state=ChannelState.CONTRADICTED,
            )
        )
        self._plan.begin(*self.zero)

    def _doubt_zero_after_jump(self) -> None:
        """Let the identifier doubt the force's zero, once after a jump of a torque.

        When the torque returns it is doubted again, by as much as before.
        """
        if self._jumps != self._sensor.jumps:
            old_std_N = self._jump_std_N
            self._jumps = self._sensor.jumps
            self._jump_std_N = self._sensor.jump_std_N
            doubted_N = max(old_std_N, self._jump_std_N)
            # The identifier's clock has stood still since samples are not used.
            since_s = max(self._sensor.jump_since_s - self._unused_s, 0.0)
            self._identifier.doubt_zero(doubted_N, min(since_s, JUMP_SEEN_S))

    def _watch_air(self, wrench: WrenchEstimate, elapsed_s: float) -> None:
        """Look for a force where none can be; let the identifier doubt its zero.

        The published method is told of no contact, so it never leaves the air.
        """
        if not self._is_watched:
            return
        contact_m = self._contact_m
        is_in_air = contact_m is None or self._travel.depth_m < contact_m - _OUTSIDE_M
        if not is_in_air or self._course.channel is not None:
            if self._air.odd_s + self._air.quiet_s > 0.0:
                self._air = self._air.in_tissue()
            return
        was_odd = self._air.doubt_N > 0.0
        self._air = self._air.with_force(wrench.axial, wrench.axial_std, elapsed_s)
        if self._air.doubt_N > 0.0 and not was_odd and contact_m is None:
            self._identifier.doubt_zero(self._air.doubt_N, JUMP_SEEN_S)

    def _with_air_doubt(self, wrench: WrenchEstimate) -> WrenchEstimate:
        """Return an estimate with what free air has shown in its deviation."""
        if self._air.doubt_N == 0.0:
            return wrench
        return wrench._replace(
            axial_std=math.hypot(wrench.axial_std, self._air.doubt_N),
            warnings=wrench.warnings | SensorWarning.UNEXPLAINED,
        )

    def _identify(self, wrench: WrenchEstimate, elapsed_s: float) -> Estimate:
        """Return the identifier's estimate after this sample.

        It gets the force before smoothing, since it filters on its own. That force
        lags by the observer only; depth and speed are delayed to match.
        """
        # `axial_std` is the deviation of the smoothed force: error of the tare, drift,
        # uncertain torque of motion, what the lag hides, noise that smoothing leaves.
        # The identifier wants just this slow error: it learns the sample noise itself,
        # and a wrong scale of the torques scales all that it finds alike.
        return self._identifier.update(
            self._travel.delayed_depth_m,
            self._travel.delayed_speed_m_s,
            wrench.axial_unsmoothed,
            elapsed_s,
            time_s=self._time_s,
            force_std_N=self._sensor.std_of_bias_N(wrench),
        )

    def _accept(self, identification: Estimate) -> None:
        """Keep the identification of this sample, and match its events with a plan."""
        self._identification = identification
        self._had_events = identification.has_events
        due_s = self._checkpoints.newer.time_s + CHECKPOINT_PERIOD_S
        self._is_checkpoint_due = self._had_events or self._time_s >= due_s
        self._plan.update(
            identification, self._travel.delayed_depth_m, self._identifier
        )

    def _save_checkpoint_if_due(self) -> None:
        """Save a state to rewind to.

        This is put off until the sample after the one that made it due, to spread the
        work.
        """
        if not self._is_checkpoint_due:
            return
        newer = Checkpoint(self._time_s, self._identifier.snapshot())
        # An event must not be reported twice: nothing before it is kept.
        older = newer if self._had_events else self._checkpoints.newer
        self._checkpoints = Checkpoints(older, newer)
        self._is_checkpoint_due = False

    def _skip_sample(
        self, wrench: WrenchEstimate, elapsed_s: float, *, is_spoilt: bool = False
    ) -> SessionEstimate:
        """Leave a valid sample out of the identification.

        Rewind if a push begins, or if samples before it are spoilt in another way.
        """
        self._unused_s += elapsed_s
        is_spoilt = is_spoilt or bool(wrench.warnings & PUSHED)
        if is_spoilt and self._is_rewindable(elapsed_s):
            self._rewind()
        return self._repeat_last(wrench)

    def _is_rewindable(self, elapsed_s: float) -> bool:
        """Return whether samples were used since the older checkpoint.

        Half a time step allows for the rounding of sums of time steps.
        """
        used_s = self._time_s - self._unused_s - self._checkpoints.older.time_s
        return used_s > 0.5 * elapsed_s

    def _rewind(self) -> None:
        """Undo what the identification made of the push before it was detected."""
        checkpoint = self._checkpoints.older
        # `resume` is `restore` without checks: the state is this identifier's own, or
        # was checked when the session was restored.
        self._identifier.resume(checkpoint.identifier)
        self._identification = checkpoint.identifier.last
        self._unused_s = self._time_s - checkpoint.time_s
        self._checkpoints = Checkpoints(checkpoint, checkpoint)

    def _repeat_last(self, wrench: WrenchEstimate) -> SessionEstimate:
        """Return the estimate of a sample that is not used for identification."""
        self._identification = self._identification.without_events()
        return self._estimate(wrench, is_used=False)

    def _estimate(self, wrench: WrenchEstimate, *, is_used: bool) -> SessionEstimate:
        """Put the estimate together, with the contact as known after this sample."""
        contact_m = self._identifier.contact_depth_m
        self._contact_m = contact_m
        entry_m = self._plan.entry_depth_m
        if entry_m is None:
            entry_m = contact_m
        depth_m = self._travel.depth_m
        return SessionEstimate(
            wrench=self._with_air_doubt(wrench),
            depth_m=depth_m,
            speed_m_s=self._travel.speed_m_s,
            identification=self._identification,
            status=wrench.status,
            used_for_identification=is_used,
            time_s=self._time_s,
            depth_in_tissue_m=None if entry_m is None else depth_m - entry_m,
            channel=self._course.channel_state,
            plan=self._plan.reported_state,
            deviation=self._plan.deviation,
            clearances=self._plan.clearances,
            plan_events=self._plan.take_events(),
        )


def _checked_entry(entry_in_base_m: ArrayLike) -> Array:
    """Return an entry point as three numbers."""
    entry_m = np.array(entry_in_base_m, dtype=float)
    if entry_m.shape != (3,) or not np.isfinite(entry_m).all():
        raise SessionSettingError(
            f"entry_in_base_m is {entry_in_base_m!r}, expected 3 finite numbers"
        )
    return entry_m


def _check_settings(robot: object, sensor_config: object, speed_lag_s: object) -> None:
    """Raise `SessionSettingError` for arguments of a session that cannot work."""
    if not isinstance(robot, Robot):
        raise SessionSettingError(
            f"robot is a {type(robot).__name__}, expected a Robot"
        )
    if not isinstance(sensor_config, SensorConfig):
        raise SessionSettingError(
            f"sensor_config is a {type(sensor_config).__name__}, expected a "
            "SensorConfig"
        )
    is_number = isinstance(speed_lag_s, numbers.Real)
    if not (is_number and 0.0 <= float(speed_lag_s) < math.inf):
        raise SessionSettingError(
            f"speed_lag_s is {speed_lag_s!r}, expected a finite number >= 0"
        )
