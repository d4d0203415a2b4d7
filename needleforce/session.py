"""One insertion, tick by tick, from joint signals to the force at the needle's tip.

Left to others: the torque of the environment to `residual.momentum_observer` and the
force that it shows to `residual.wrench_estimator`, both called by `VirtualForceSensor`;
ruptures, layers and the tip force to `identification`.
"""

import math
from collections.abc import Callable
from copy import deepcopy
from typing import TYPE_CHECKING, Any, NamedTuple

from numpy.typing import ArrayLike

from foundation.state import SAME_KIND, SAME_SETTINGS
from identification import MIXTURE as DEFAULT_IDENTIFIER
from identification import (
    Estimate,
    Identifier,
    LayerEstimate,
    MixtureConfig,
    PublishedConfig,
)
from needleforce.insertion_course import MAX_TRAVEL_IN_LAG_M, InsertionCourse
from needleforce.insertion_events import SessionEvent
from needleforce.needle_channels import ChannelState
from needleforce.needle_on_plan import PlanDeviation, PlannedPath
from needleforce.plan_follower import PlanFollower
from needleforce.rewinding import RewindingIdentifier
from needleforce.session_snapshot import InsertionError, SessionSnapshot
from needleforce.tip_travel import TravelZero
from needleforce.zero_watch import ZeroWatch
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
from urdf import Robot

if TYPE_CHECKING:
    from needleforce.anatomy import (
        NeedleClearance,
        NeedleSurroundings,
        PlanMatch,
        PlanState,
    )

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
            those too near first, then the nearest; empty where that is not known.
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
        """Possible errors beyond the standard deviation, or that have widened it."""
        return self.wrench.warnings


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
    velocity), and not while a jump of a torque sensor is measured or the arm is pushed,
    are used for identification. In other ticks its last estimate stays and
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
        InsertionError: For a negative or infinite lag.
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
        if not 0.0 <= speed_lag_s < math.inf:
            raise InsertionError(
                f"speed_lag_s is {speed_lag_s!r}, expected a finite number >= 0"
            )
        self._sensor = VirtualForceSensor(robot, sensor_config)
        self.sensor_config = sensor_config
        self._identifier = RewindingIdentifier(identifier_config)
        self._identifier_config = identifier_config
        # The published method is told of no contact, so it never leaves the air.
        self._is_watched = isinstance(identifier_config, MixtureConfig)
        self._speed_lag_s = float(speed_lag_s)
        self._zero_watch = ZeroWatch(self._sensor, self._identifier)
        self._needle = InsertionCourse(
            self._sensor.kinematics,
            self._identifier,
            self._zero_watch,
            self._speed_lag_s,
        )

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
    def lag_s(self) -> float:
        """Time by which the estimate follows the force [s]; 0 before any sample."""
        return self._sensor.lag_s

    @property
    def rejected(self) -> int:
        """Bad samples since the last `reset`."""
        return self._sensor.rejected

    @property
    def zero(self) -> TravelZero:
        """Where depth counts from."""
        return self._needle.zero

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as estimated now.

        Before the needle meets tissue they are those of the insertion before, unless
        `begin_insertion` or `tare` was called.
        """
        return self._needle.layers

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
        return self._process(self._sensor.update, q, dq, tau, dt_s)

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
        update = self._sensor.update_external_torque
        return self._process(update, q, dq, external_torque, dt_s)

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
        self._needle.begin_tare()
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
        self._needle.begin_tare()

    def start_tare_recording(self) -> None:
        """Record free motion anew for the next `tare`.

        Estimates are `NOT_TARED` until then.
        """
        self._sensor.start_tare_recording()

    def follow(
        self,
        plan: "PlanMatch | None",
        *,
        path: PlannedPath | None = None,
        surroundings: "NeedleSurroundings | None" = None,
    ) -> None:
        """Match the ruptures from now on with a plan: see `SessionEstimate.plan`.

        With a path every estimate states how far the needle is off it; see
        `SessionEstimate.deviation`.

        Args:
            plan: A `needleforce.anatomy.PlanMatch`; None to follow none.
            path: The planned path in the robot's base; None where the plan's depths
                count from where the session's do.
            surroundings: A `needleforce.anatomy.NeedleSurroundings`; with it and a path
                every estimate states how near the needle comes to structures at risk.

        Raises:
            InsertionError: For anything but a plan.
        """
        if plan is not None and not hasattr(plan, "fingerprint"):
            raise InsertionError(
                f"plan is a {type(plan).__name__}, expected a PlanMatch of anatomy"
            )
        self._needle.plan = PlanFollower(plan, path, surroundings)
        self._needle.plan.begin(self.zero)

    def begin_insertion(self) -> None:
        """Count depth from here and, in free air, forget the layers.

        Tare and channels stay. In tissue, in a channel that the needle has cut, or in
        front of it, layers and friction stay as well.
        """
        if self._needle.is_in_tissue:
            self._needle.move_zero_here()
        else:
            self._needle.remember_channel()
            self._needle.begin_here()
            self._needle.go_on_in_channel()

    def forget_channels(self) -> None:
        """Forget the channels of earlier insertions: the tissue has moved.

        A needle in tissue keeps what it knows of its own channel.
        """
        self._needle.channels = ()
        if not self._needle.is_in_tissue:
            self._needle.begin_anew()

    def reset(self) -> None:
        """Forget everything, the tare and the channels included."""
        self._sensor.reset()
        self._needle.reset()

    def snapshot(self) -> SessionSnapshot:
        """Return the complete state of the session; `write_snapshot` stores it."""
        identifier = self._identifier
        if identifier.is_save_due:
            identifier.save(self._needle.time_s)
        return SessionSnapshot(
            sensor=self._sensor.snapshot(),
            identifier=identifier.identifier.snapshot(),
            checkpoints=(identifier.older, identifier.newer),
            unused_s=identifier.unused_s,
            course=self._needle.state(),
            plan=self._needle.plan.memory,
            air=self._zero_watch.air,
            speed_lag_s=self._speed_lag_s,
        )

    def restore(self, snapshot: SessionSnapshot) -> None:
        """Continue, bit for bit, from where ``snapshot`` was taken.

        An error changes nothing.

        Raises:
            InsertionError: Not a snapshot of a session, or one of another speed lag or
                plan.
            residual.SnapshotError: A damaged one, or of another robot or settings of
                the sensor.
            identification.IdentificationError: One of other settings of the identifier.
        """
        if not isinstance(snapshot, SessionSnapshot):
            raise InsertionError(
                f"expected a SessionSnapshot, got {type(snapshot).__name__}", SAME_KIND
            )
        plan = self._needle.plan
        for name, stored, own in (
            ("speed_lag_s", snapshot.speed_lag_s, self._speed_lag_s),
            ("plan", snapshot.plan.fingerprint, plan.memory.fingerprint),
        ):
            if stored != own:
                raise InsertionError(
                    f"the snapshot is of {name} {stored!r}, this session has {own!r}",
                    SAME_SETTINGS,
                )
        Identifier(self._identifier_config).restore(snapshot.identifier)
        # The last step that can fail; where it does, the sensor has not changed either.
        self._sensor.restore(snapshot.sensor)
        self._identifier.restore(
            snapshot.identifier, snapshot.checkpoints, snapshot.unused_s
        )
        self._zero_watch.air = snapshot.air
        self._needle.restore(snapshot.course)
        plan.resume(snapshot.plan)
        if snapshot.course.is_started:
            plan.compare_with(self._sensor.kinematics)

    def _process(
        self, update: Callable[..., WrenchEstimate], *sample: Any
    ) -> SessionEstimate:
        """Update the sensor and identify; count depth from where a tare has ended."""
        was_taring = self.taring
        estimate = self._follow_needle(update(*sample))
        if was_taring and self.tared:
            self._needle.begin_where_tared()
        return estimate

    def _follow_needle(self, wrench: WrenchEstimate) -> SessionEstimate:
        """Follow the needle and, where the force is usable, identify."""
        sensor = self._sensor
        needle = self._needle
        identifier = self._identifier
        if identifier.is_save_due:
            identifier.save(needle.time_s)
        if wrench.status is Status.REJECTED:
            return self._estimate(wrench, is_used=False)
        elapsed_s = sensor.elapsed_s
        is_spoilt = sensor.is_measuring_jump
        needle.advance(sensor.velocity_rad_s, elapsed_s, sensor.filter_lag_s)
        warnings = wrench.warnings
        # Without any, the test of a flag, which takes a microsecond, is left out.
        is_unusable = warnings is not SensorWarning.NONE and bool(warnings & UNUSABLE)
        if wrench.status is not Status.OK or is_unusable or is_spoilt:
            return self._skip_sample(wrench, elapsed_s, is_spoilt=is_spoilt)
        is_resuming = identifier.unused_s > 0.0
        is_outside = False
        if self._is_watched:
            is_outside = needle.find_insertion(is_resuming=is_resuming)
        # The warnings of a push come from periodic checks, which may miss one that is
        # still there: a gap ends only once a check of this very sample shows none.
        if is_resuming and sensor.recheck(wrench).warnings & PUSHED:
            return self._skip_sample(wrench, elapsed_s)
        self._zero_watch.watch(wrench, elapsed_s, is_outside=is_outside)
        # The identifier gets the force before smoothing, since it filters on its own.
        # That force lags by the observer only; depth and speed are delayed to match.
        # `axial_std` is the deviation of the smoothed force: error of the tare, drift,
        # uncertain torque of motion, what the lag hides, noise that smoothing leaves.
        # The identifier wants just this slow error: it learns the sample noise itself,
        # and a wrong scale of the torques scales all that it finds alike.
        identification = identifier.use(
            needle.travel.delayed_depth_m,
            needle.travel.delayed_speed_m_s,
            wrench.axial_unsmoothed,
            elapsed_s,
            needle.time_s,
            sensor.std_of_bias_N(wrench),
        )
        alarm = identification.rupture or identification.provisional
        if alarm is not None:
            # A push on the arm looks like a rupture, even before the periodic checks
            # detect it.
            wrench = sensor.recheck(wrench)
            if wrench.warnings & PUSHED:
                # The identifier has used this sample, so its time is not added here.
                # The rewind that follows undoes that and counts it as unused.
                return self._skip_sample(wrench, elapsed_s=0.0)
        self._accept(identification, wrench)
        needle.judge_speed(sensor.lag_s, elapsed_s)
        return self._estimate(wrench, is_used=identification.status.is_used)

    def _accept(self, identification: Estimate, wrench: WrenchEstimate) -> None:
        """Keep what was identified with a sample; match it with plan and channel."""
        needle = self._needle
        identifier = self._identifier
        identifier.accept(identification, needle.time_s)
        needle.plan.match(
            identification, needle.travel.delayed_depth_m, identifier.contact_m
        )
        channel = needle.insertion.channel
        if channel is not None:
            needle.check_channel(channel, wrench)

    def _skip_sample(
        self, wrench: WrenchEstimate, elapsed_s: float, *, is_spoilt: bool = False
    ) -> SessionEstimate:
        """Leave a valid sample out of the identification.

        Rewind if a push begins, or if samples before it are spoilt in another way.
        """
        is_spoilt = is_spoilt or bool(wrench.warnings & PUSHED)
        self._identifier.skip(elapsed_s, self._needle.time_s, is_spoilt=is_spoilt)
        return self._estimate(wrench, is_used=False)

    def _estimate(self, wrench: WrenchEstimate, *, is_used: bool) -> SessionEstimate:
        """Put the estimate together, with the contact as known after this sample."""
        if not is_used:
            self._identifier.end_events()
        needle = self._needle
        plan = needle.plan
        entry_m = plan.entry_depth_m
        if entry_m is None:
            entry_m = self._identifier.contact_m
        depth_m = needle.travel.depth_m
        wrench = self._zero_watch.widen(wrench)
        if needle.insertion.is_too_fast:
            wrench = _with_too_fast(wrench, self._sensor.lag_s)
        return SessionEstimate(
            wrench=wrench,
            depth_m=depth_m,
            speed_m_s=needle.travel.speed_m_s,
            identification=self._identifier.last,
            status=wrench.status,
            used_for_identification=is_used,
            time_s=needle.time_s,
            depth_in_tissue_m=None if entry_m is None else depth_m - entry_m,
            channel=needle.insertion.channel_state,
            plan=plan.reported_state,
            deviation=plan.deviation,
            clearances=plan.clearances,
            plan_events=plan.take_events(),
        )


def _with_too_fast(wrench: WrenchEstimate, lag_s: float) -> WrenchEstimate:
    """Return the force with the warning that the needle has outrun it.

    Args:
        wrench: The force.
        lag_s: Time by which it is late; 0 where the robot estimates the torques.
    """
    reason = "the needle has outrun the force: advance slower"
    if lag_s > 0.0:  # the torques may have come another way when the needle was fast
        max_mm_s = 1e3 * MAX_TRAVEL_IN_LAG_M / lag_s
        reason += f", by at most {max_mm_s:.0f} mm/s in tissue"
    return wrench._replace(
        warnings=wrench.warnings | SensorWarning.TOO_FAST,
        message="; ".join(filter(None, (wrench.message, reason))),
    )
