"""Follows the needle: its depth, where an insertion begins and ends, old channels.

In free air a turn, a retreat followed by an advance, or a move aside ends an insertion;
a move aside that no tissue allows ends it anywhere.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, NamedTuple

from foundation.arrays import Array, Vector
from foundation.jit import compiled
from foundation.linear_algebra import dot
from identification import LayerEstimate
from identification.channel import (
    continue_channel,
    has_cut,
    read_friction,
)
from needleforce.needle_channels import (
    MIN_LENGTH_M,
    NEEDLE_DIAMETER_M,
    ChannelState,
    NeedleChannel,
    OldChannel,
    add_channel,
    find_channel,
    remove_channel,
)
from needleforce.plan_follower import PlanFollower
from needleforce.tip_travel import (
    Needle,
    TipTravel,
    TravelZero,
    place_tip,
    tip_speed,
)

if TYPE_CHECKING:
    from needleforce.rewinding import RewindingIdentifier
    from needleforce.zero_watch import ZeroWatch
    from residual import WrenchEstimate
    from residual.tool_kinematics import ToolKinematics

MAX_TURN_COSINE = math.cos(math.radians(3.0))
"""Cosine of the turn in free air from which on depth counts along the new axis: its
projection on the old one is off by a part in a thousand there."""


LEFT_M = 1.5 * NEEDLE_DIAMETER_M
"""Distance from its channel from which on the needle in free air has left it: more than
that within which it meets one, lest it alternates."""

FAR_TURN_RAD = math.radians(20.0)
"""Turn that no needle does in tissue."""

FAR_TURN_COSINE = math.cos(FAR_TURN_RAD)
"""Cosine of that turn."""

ASIDE_M = 3e-3
"""Move aside that begins another approach, and that no needle does in tissue, ..."""

ASIDE_PER_TRAVEL = math.tan(FAR_TURN_RAD)
"""... unless it is no more than such a turn about the entry makes of the travel."""


MAX_TRAVEL_IN_LAG_M = 0.3e-3
"""Travel within the lag of the force beyond which the needle is too fast for it. A
rupture of a gel takes 0.1 to 0.5 mm: the fall is then lost in the rise that follows
it."""


@dataclass
class InsertionProgress:
    """Course of an insertion, from the approach on; changes with every sample.

    Attributes:
        line: Place of the tip and direction of the needle when tissue was met; before,
            where the approach began.
        line_depth_m: Depth of that place.
        is_met: Whether tissue has been met.
        deepest_m: Largest depth so far.
        highest_m: Smallest depth since the deepest point.
        layers_before: Layers of the insertion before, which are reported until tissue
            is met.
        channel_state: Whether it goes on in an earlier channel.
        channel: That channel; None where there is none.
        too_fast_s: Time for which the needle has outrun the force; time in which it has
            not is subtracted.
        is_too_fast: Whether that has lasted, see `SensorWarning.TOO_FAST`.
    """

    line: TravelZero
    line_depth_m: float = 0.0
    is_met: bool = False
    deepest_m: float = 0.0
    highest_m: float = 0.0
    layers_before: tuple[LayerEstimate, ...] = ()
    channel_state: ChannelState = ChannelState.FRESH
    channel: OldChannel | None = None
    too_fast_s: float = 0.0
    is_too_fast: bool = False

    def move_to(self, depth_m: float) -> None:
        """Note that the tip is at a depth."""
        if depth_m > self.deepest_m:
            self.deepest_m = depth_m
            self.highest_m = depth_m
        self.highest_m = min(self.highest_m, depth_m)

    def has_retreated(self, depth_m: float, contact_m: float | None) -> bool:
        """Return whether the needle has gone back in free air and advances again.

        Args:
            depth_m: Depth of the tip.
            contact_m: Depth of first contact; None where tissue has not been met.
        """
        # Advance after a retreat with which the next approach begins
        advance_m = 0.5e-3
        # Retreat in free air that ends an insertion or an approach: more than tissue
        # rises with the needle that leaves it
        retreat_m = 3e-3
        last_m = self.deepest_m if contact_m is None else contact_m
        is_back = self.highest_m < last_m - retreat_m
        return is_back and depth_m > self.highest_m + advance_m

    def move_depths(self, by_m: float) -> None:
        """Count depths from another zero."""
        self.line_depth_m += by_m
        self.deepest_m += by_m
        self.highest_m += by_m
        if self.channel is not None:
            self.channel = self.channel.with_depths_moved(by_m)


class CourseState(NamedTuple):
    """State of an `InsertionCourse`.

    Attributes:
        zero: Where depth counts from.
        travel: Depth and speed of the tip.
        time_s: See `SessionEstimate`.
        insertion: Course of this insertion.
        channels: Those that earlier insertions have cut.
        is_started: Whether a valid sample has come.
    """

    zero: TravelZero
    travel: TipTravel
    time_s: float
    insertion: InsertionProgress
    channels: tuple[NeedleChannel, ...]
    is_started: bool


NeedleMotion = tuple[float, float, bool, bool, bool]
"""What `follow_needle` returns: a plain tuple, which its one caller unpacks at once; a
named one would cost it a microsecond."""


@compiled
def follow_needle(
    axis: Vector, line_start: Vector, line_axis: Vector, needle: Needle, dq: Vector
) -> NeedleMotion:
    """Return how the needle moves, and whether it has left the line of its insertion.

    Args:
        axis: Direction of depth in base axes, length one, shape (3,).
        line_start: Beginning of the line in the base [m], shape (3,).
        line_axis: Direction of the line in base axes, length one, shape (3,).
        needle: `residual.ToolKinematics.needle`.
        dq: Joint velocities [rad/s], shape (n,).

    Returns:
        Position of the tip along the direction of depth [m]; its speed along the needle
        [m/s]; whether the needle has turned away from the direction of depth; whether
        it has moved from the line as none does in tissue; whether the tip is beside its
        channel.
    """
    tip = place_tip(needle)
    height_m = 0.0
    for i in range(3):
        height_m += line_axis[i] * (tip.position_m[i] - line_start[i])
    aside_m2 = 0.0
    for i in range(3):
        aside_m2 += (tip.position_m[i] - line_start[i] - height_m * line_axis[i]) ** 2
    aside_m = math.sqrt(aside_m2)
    allowed_m = max(ASIDE_M, ASIDE_PER_TRAVEL * abs(height_m))
    is_turned_far = dot(line_axis, tip.direction) < FAR_TURN_COSINE
    return (
        dot(axis, tip.position_m),
        tip_speed(tip, needle, dq),
        dot(axis, tip.direction) < MAX_TURN_COSINE,
        aside_m > allowed_m or is_turned_far,
        aside_m > LEFT_M,
    )


class InsertionCourse:
    """Follows the needle, and tells identifier and plan where an insertion begins.

    Args:
        tool: Places the needle.
        identifier: Begins anew, or goes on, with every insertion.
        zero_watch: Begins with every insertion.
        speed_lag_s: Time constant of a low-pass on the speed [s].

    Attributes:
        plan: Follows a plan beside the insertion.
        time_s: The session's clock, see `SessionEstimate`.
        zero: Where depth counts from.
        travel: Depth and speed of the tip.
        insertion: Its course.
        channels: Those that earlier insertions have cut.
        is_started: Whether a valid sample has come.
    """

    channels: tuple[NeedleChannel, ...]

    def __init__(
        self,
        tool: "ToolKinematics",
        identifier: "RewindingIdentifier",
        zero_watch: "ZeroWatch",
        speed_lag_s: float,
    ) -> None:
        self._identifier = identifier
        self._zero_watch = zero_watch
        self._speed_lag_s = speed_lag_s
        self._tool = tool
        self.plan = PlanFollower(None, None)
        self.reset()

    def reset(self) -> None:
        """Forget everything, the channels included."""
        self.time_s = 0.0
        self.channels = ()
        self.is_started = False
        self._zero_watch.begin_tare()
        self.begin_here()

    def state(self) -> CourseState:
        """Return what `restore` continues from; the plan has a state of its own."""
        values = {name: getattr(self, name) for name in CourseState._fields}
        return CourseState(**values)._replace(insertion=replace(self.insertion))

    def restore(self, state: CourseState) -> None:
        """Continue from a state."""
        self._count_depth_from(state.zero)
        vars(self).update(state._asdict())
        self.insertion = replace(state.insertion)

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far; before the contact those of the insertion before."""
        before = () if self.insertion.is_met else self.insertion.layers_before
        return self._identifier.identifier.layers or before

    @property
    def _line(self) -> TravelZero:
        """Where the tip is now, and the needle's direction."""
        return TravelZero(
            start_in_base_m=self._tool.pose[:3, 3].copy(),
            axis_in_base=self._tool.axis_in_base.copy(),
        )

    @property
    def _is_in_air(self) -> bool:
        """Whether the tip is in front of the tissue, or none has been met."""
        contact_m = self._identifier.contact_m
        return contact_m is None or self.travel.depth_m < contact_m

    @property
    def is_in_tissue(self) -> bool:
        """Whether tip and force are where tissue has been met.

        A contact that the force does not show may be none.
        """
        # Deviations of a force that shows that the tip is in tissue
        tissue_sigmas = 3.0
        if self._is_in_air:
            return False
        identification = self._identifier.last
        net_N = identification.tip_force_N + identification.shaft_friction_N
        std_N = identification.tip_force_std_N or 0.0
        return abs(net_N) > tissue_sigmas * std_N or self._length_to_remember_m > 0.0

    def advance(
        self, velocity_rad_s: Array, elapsed_s: float, force_lag_s: float
    ) -> None:
        """Follow the needle to a valid sample; the first one sets zero depth.

        Args:
            velocity_rad_s: Of the joints, shape (n,).
            elapsed_s: Time since the last valid sample. It includes the steps of
                samples rejected in between, but not the jump of a clock that was set.
            force_lag_s: Lag of the force.
        """
        if self.is_started:
            self.time_s += elapsed_s
        else:
            self.begin_where_tared()
            self.is_started = True
        line = self.insertion.line
        position_m, speed_m_s, self._is_turned, self._is_aside, self._is_off_line = (
            follow_needle(
                self.zero.axis_in_base,
                line.start_in_base_m,
                line.axis_in_base,
                self._tool.needle,
                velocity_rad_s,
            )
        )
        self.travel = self.travel.advanced(
            position_m - self._start_m,
            speed_m_s,
            elapsed_s,
            speed_lag_s=self._speed_lag_s,
            force_lag_s=force_lag_s,
        )
        self.plan.compare_with(self._tool)

    def judge_speed(self, force_lag_s: float, dt_s: float) -> None:
        """Note for the whole insertion if the needle outruns the force in tissue.

        Args:
            force_lag_s: Time by which the force follows the torques.
            dt_s: Since the sample before.
        """
        # An estimated speed is noisy: one that is seldom above the limit is slower.
        min_excess_s = 0.05
        insertion = self.insertion
        if self._is_in_air or insertion.is_too_fast:
            return
        is_fast = self.travel.speed_m_s * force_lag_s > MAX_TRAVEL_IN_LAG_M
        excess_s = insertion.too_fast_s + (dt_s if is_fast else -dt_s)
        insertion.too_fast_s = max(excess_s, 0.0)
        insertion.is_too_fast = excess_s > min_excess_s

    def find_insertion(self, *, is_resuming: bool) -> bool:
        """Begin another insertion where the needle has left the last.

        Args:
            is_resuming: Whether samples before this one were not used, in which the
                needle may have gone anywhere.

        Returns:
            Whether nothing touches the needle for sure, no old channel either.
        """
        # In front of the first contact the tissue is left behind for sure
        outside_m = 2e-3
        self._begin_where_left(is_resuming=is_resuming)
        if self.insertion.channel is not None:
            return False
        contact_m = self._identifier.contact_m
        return contact_m is None or self.travel.depth_m < contact_m - outside_m

    def _begin_where_left(self, *, is_resuming: bool) -> None:
        """Begin another insertion where the needle has left the last."""
        depth_m = self.travel.depth_m
        contact_m = self._identifier.contact_m
        insertion = self.insertion
        insertion.move_to(depth_m)
        is_met = contact_m is not None
        if insertion.is_met != is_met:
            # Tissue is met here, or has turned out not to have been met.
            insertion.line = self._line
            insertion.line_depth_m = depth_m
            insertion.is_met = is_met
            self._is_aside = False
            self._is_off_line = False
        if contact_m is not None and depth_m >= contact_m:
            if not self._is_aside:
                return
            # No tissue lets a needle move so: none was met, if every sample was used.
            insertion.is_met = is_resuming
            self._leave_insertion()
        elif (
            self._is_aside
            or insertion.has_retreated(depth_m, contact_m)
            or (is_met and self._is_off_line)
            or self._is_turned
        ):
            self._leave_insertion()
        if self.channels and not self.insertion.is_met:
            self.go_on_in_channel()

    def _leave_insertion(self) -> None:
        """Remember the channel and begin anew, along the needle's axis if it turned."""
        self.remember_channel()
        if self._is_turned:
            self._count_depth_from(self._line)
        self.begin_anew()

    def begin_anew(self) -> None:
        """Begin an insertion here; layers stay until tissue is met."""
        self._begin(self._line, self.travel.depth_m, self.layers)

    def begin_here(self) -> None:
        """Begin an insertion with depth zero here."""
        self._count_depth_from(self._line)
        self._begin(self.zero, 0.0)

    def begin_tare(self) -> None:
        """Begin an insertion where a tare says that there is free air."""
        if self._is_in_air:
            self.remember_channel()
        self._zero_watch.begin_tare()
        self.begin_here()

    def begin_where_tared(self) -> None:
        """Count depth from here at the end of a tare, or at the start.

        No sample was used since the insertion began.
        """
        self._zero_watch.begin_tare()
        self._count_depth_from(self._line)
        self.insertion = InsertionProgress(self.zero)
        self._identifier.date(self.time_s)
        self.plan.begin(self.zero)

    def _begin(
        self,
        line: TravelZero,
        depth_m: float,
        layers_before: tuple[LayerEstimate, ...] = (),
    ) -> None:
        """Begin an insertion at a depth: forget what was identified."""
        self.insertion = InsertionProgress(
            line,
            line_depth_m=depth_m,
            deepest_m=depth_m,
            highest_m=depth_m,
            layers_before=layers_before,
        )
        self._identifier.begin(self.time_s)
        self._zero_watch.begin_insertion()
        self.plan.begin(self.zero)

    def move_zero_here(self) -> None:
        """Count depth from here; what is known of the tissue stays."""
        travel = self.travel
        moved_m = -travel.depth_m
        self._count_depth_from(self._line)
        self.travel = travel._replace(
            depth_m=0.0, delayed_depth_m=travel.delayed_depth_m + moved_m
        )
        self.insertion.move_depths(moved_m)
        self._identifier.move_zero(moved_m, self.time_s)
        self.plan.move_zero(self.zero, moved_m)

    def _count_depth_from(self, zero: TravelZero) -> None:
        """Count depth from a place, along a direction; the tip is taken to be there."""
        self._start_m = float(zero.axis_in_base.dot(zero.start_in_base_m))
        self.zero = zero
        self.travel = TipTravel()

    @property
    def _length_to_remember_m(self) -> float:
        """Length of the channel that this insertion has cut; 0 if it has cut none."""
        contact_m = self._identifier.contact_m
        if contact_m is None or not self.insertion.is_met:
            return 0.0
        length_m = self.insertion.deepest_m - contact_m
        is_long = length_m >= MIN_LENGTH_M
        known = self._identifier.identifier.snapshot()
        return length_m if is_long and has_cut(known) else 0.0

    def remember_channel(self) -> None:
        """Remember the channel that this insertion has cut, if it has cut one."""
        contact_m = self._identifier.contact_m
        length_m = self._length_to_remember_m
        if contact_m is None or length_m == 0.0:
            return
        start_m, axis = self.insertion.line
        entry_m = start_m + (contact_m - self.insertion.line_depth_m) * axis
        channel = NeedleChannel(
            entry=TravelZero(entry_m, axis),
            length_m=length_m,
            entry_depth_m=contact_m,
            left_s=self.time_s,
            identifier=self._identifier.identifier.snapshot(),
        )
        self.channels = add_channel(self.channels, channel)

    def go_on_in_channel(self) -> None:
        """Go on in a channel that the needle comes to, or is in."""
        channel = find_channel(self.channels, self._line)
        friction = None if channel is None else read_friction(channel.identifier)
        if channel is None or friction is None:
            return
        start_m, zero_axis = self.zero
        entry_depth_m = float(zero_axis.dot(channel.entry.start_in_base_m - start_m))
        end_m = entry_depth_m + channel.length_m
        depth_m = self.travel.depth_m
        in_air = self._identifier.identifier.snapshot()
        known = continue_channel(
            channel.identifier,
            in_air,
            moved_m=entry_depth_m - channel.entry_depth_m,
            passed_s=self.time_s - channel.left_s,
        )
        self._identifier.go_back(known, self.time_s, self.time_s)
        old = OldChannel(
            begin_m=entry_depth_m,
            end_m=end_m,
            friction=friction,
            in_air_s=self.time_s,
            in_air=in_air,
            checked_m=depth_m,
        )
        self.insertion = InsertionProgress(
            line=channel.entry,
            line_depth_m=entry_depth_m,
            is_met=True,
            deepest_m=end_m,
            highest_m=depth_m,
            channel_state=ChannelState.REMEMBERED,
            channel=old,
        )
        layers = self._identifier.identifier.layers
        self.plan.begin(self.zero, (layer.rupture for layer in layers))

    def check_channel(self, old: OldChannel, wrench: "WrenchEstimate") -> None:
        """Compare the force with the friction of the channel; drop it if they differ.

        Args:
            old: The channel in which the needle goes on.
            wrench: Force of a sample that was used.
        """
        identification = self._identifier.last
        friction_N = identification.predicted_force_N
        excess_N = wrench.axial_unsmoothed - friction_N
        old = old.compared(self.travel, excess_N, wrench.axial_std)
        self.insertion.channel = old
        if old.is_contradicted(
            self.travel.delayed_speed_m_s,
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
        line = self.insertion.line
        self.channels = remove_channel(
            self.channels, line, length_m=old.end_m - old.begin_m
        )
        self._identifier.go_back(old.in_air, old.in_air_s, self.time_s)
        depth_m = self.travel.depth_m
        self.insertion = InsertionProgress(
            line=line,
            line_depth_m=old.begin_m,
            deepest_m=depth_m,
            highest_m=depth_m,
            channel_state=ChannelState.CONTRADICTED,
        )
        self.plan.begin(self.zero)
