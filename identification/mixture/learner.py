"""What the mixture learns from a block of samples, and what it learns beside it.

A block is taken (`take_block`) and predicted by every component (`Learner.predict`).
Where the needle cuts, or has met no tissue yet, noise and components learn from its
force (`learn_noise`, `correct`); elsewhere nothing does (`pause`). Then it is kept as
the last one (`keep`). In later samples components of new events begin and the least
likely are dropped (`branch_and_prune`), and the tissue's motion is looked for
(`find_motion`).

Lengths are in mm, speeds in mm/s, forces in N.
"""

import math
from dataclasses import dataclass, field, replace
from typing import NamedTuple

from foundation.records import from_record, read_column, read_element
from identification.estimate import Sample
from identification.mixture.block import MM_PER_M, Block
from identification.mixture.disturbances import BREATHING_HZ, HEARTBEAT_HZ
from identification.mixture.force_model import (
    AIR,
    HELD,
    LAYER_COULOMB,
    LAYER_VISCOUS,
    MODEL_ERROR_FRACTION,
    OFFSET,
    STIFFENING,
    STIFFNESS,
    TRAVERSED_COULOMB,
    TRAVERSED_ERROR_FRACTION,
    TRAVERSED_VISCOUS,
    Assumptions,
    regressor,
)
from identification.mixture.mixture import (
    MAX_KEPT,
    MIN_BRANCH_MM,
    MixtureMemory,
    correct,
    penalise_implausible,
    predict,
)
from identification.mixture.needle_contact import NeedleContact, begin_block
from identification.mixture.needle_swing import MIN_HALF_S
from identification.mixture.noise_levels import (
    NoiseLevels,
    SecondDifferences,
    Texture,
)
from identification.mixture.speed_filter import (
    FIRST_SPEED_FILTER,
    SpeedFilter,
    filter_speed,
)
from identification.mixture.tissue_motion import TissueMotion

MIN_BRANCHING_FRACTION = 0.3
"""Part of the usual speed from which on new components begin: at a stop the force falls
without any rupture."""

RESUMED_MM = 0.6
"""Travel over which friction is as it was before a rest: twice that of presliding."""

FAR_MM = 1e9
"""The deepest point before the first block lies so far in front."""


@dataclass(slots=True)
class LearnerState:
    """What the learner remembers beside the mixture. Its parts are immutable.

    Attributes:
        levels: Noise of the force.
        tissue: Its motion by itself.
        speed_filter: Of the needle's own speed.
        texture: Of the tissue.
        block: The last one.
        deepest_mm: Deepest point so far.
        branched_mm: Depth at which components began last.
        resumed: How much of a rest or reversal is left in the friction, 0 to 1.
        is_branching_due: Whether components of new events begin before the next
            pruning.
        is_pruning_due: Whether the least likely components are still to be dropped.
        is_motion_due: Whether motion of the tissue is to be looked for.
    """

    levels: NoiseLevels = field(default_factory=NoiseLevels)
    tissue: TissueMotion = field(default_factory=TissueMotion)
    speed_filter: SpeedFilter = FIRST_SPEED_FILTER
    texture: Texture = field(default_factory=Texture)
    block: Block = field(default_factory=Block)
    deepest_mm: float = -FAR_MM
    branched_mm: float = -FAR_MM
    resumed: float = 0.0
    is_branching_due: bool = False
    is_pruning_due: bool = False
    is_motion_due: bool = False


class Travel(NamedTuple):
    """How the needle has moved in a block.

    Attributes:
        is_gap: Whether the block is a gap in the samples.
        is_advancing: Whether the needle cuts further.
        fresh_mm: Travel beyond the deepest point so far.
    """

    is_gap: bool
    is_advancing: bool
    fresh_mm: float


def take_block(
    contacts: list[NeedleContact], last: Block, since_reset_s: float
) -> Block:
    """Return means of the block that is full, and begin the next one."""
    contact = from_record(NeedleContact, contacts)
    swing = contact.swing
    begin_block(contacts)
    duration_s = contact.block_s
    depth_std_mm = MM_PER_M * contact.depth_std_m
    speed_std_mm_s = MM_PER_M * contact.speed_std_m_s
    speed_mm_s = MM_PER_M * contact.travel_m / duration_s
    # The usual speed is the highest of ten seconds and of 3 mm: the approach may be
    # quick.
    forgotten = math.exp(-duration_s / 10.0 - abs(speed_mm_s) * duration_s / 3.0)
    mean_N = contact.force_N_s / duration_s
    square_N2 = contact.force_squared_N2_s / duration_s
    is_swing = swing.is_swinging and duration_s > 2.0 * MIN_HALF_S
    usual_speed_mm_s = max(last.usual_speed_mm_s * forgotten, speed_mm_s)
    if is_swing and not last.is_swing:
        # What the swing has added to the speed so far is not usual.
        usual_speed_mm_s = max(speed_mm_s, MM_PER_M * swing.mean_m_s)
    if is_swing:
        # The travel filter takes a swing for noise; the mean speed has none of it.
        noise_std_mm_s = MM_PER_M * math.sqrt(swing.noise_variance)
        speed_std_mm_s = min(speed_std_mm_s, noise_std_mm_s)
    # By how much the speed may be late: a travel filter that leaves so much noise in
    # depth and speed is about as slow as three times their ratio.
    lag_s = 3.0 * depth_std_mm / max(speed_std_mm_s, 1e-9)
    return Block(
        time_s=since_reset_s - 0.5 * duration_s,
        duration_s=duration_s,
        depth_mm=MM_PER_M * contact.depth_m_s / duration_s,
        speed_mm_s=speed_mm_s,
        deflection=contact.deflection_s / duration_s,
        force_N=mean_N,
        unfiltered_depth_mm=MM_PER_M * contact.unfiltered_depth_m_s / duration_s,
        speed_lag_s=min(max(lag_s, 0.1), 0.3),
        usual_speed_mm_s=usual_speed_mm_s,
        force_before_N=last.force_N,
        depth_std_mm=depth_std_mm,
        speed_std_mm_s=speed_std_mm_s,
        # Over a swing the accelerations cancel.
        motion_variance_N2=(
            0.0 if is_swing else contact.motion_variance_N2_s / duration_s
        ),
        is_swing=is_swing,
        swing_std_N=math.sqrt(max(square_N2 - mean_N**2, 0.0)) if is_swing else 0.0,
    )


class Learner:
    """Lets every component of the mixture predict blocks of force, and learn from them.

    Attributes:
        memory: Of the mixture.
        state: What it remembers beside that.
    """

    def __init__(
        self, memory: MixtureMemory, state: LearnerState, gap_s: float
    ) -> None:
        self.memory = memory
        self.state = replace(state)
        self._gap_s = gap_s

    @property
    def zero_N(self) -> float:
        """The force's zero, as the likeliest component has it."""
        return float(self.memory.store.means[0, OFFSET])

    @property
    def zero_variance_N2(self) -> float:
        """Its variance."""
        return float(self.memory.store.covariances[0, OFFSET, OFFSET])

    @property
    def is_settled(self) -> bool:
        """Whether friction is back from the last rest or reversal."""
        return self.state.resumed < 0.1

    def has_settled_since(self, depth_mm: float) -> bool:
        """Return whether the needle advances, and went on cutting before a depth.

        Or friction is back since: a stop lets the force fall.
        """
        since_mm = self.state.block.depth_mm - depth_mm
        resumed_mm = -RESUMED_MM * math.log(max(self.state.resumed, 1e-9))
        return resumed_mm > 0.0 and (since_mm < resumed_mm or self.is_settled)

    def doubt_zero(self, std_N: float) -> None:
        """Take the zero of the force for changed, in every component alike."""
        store = self.memory.store
        store.covariances[: self.memory.size, OFFSET, OFFSET] += std_N * std_N

    def seen_by_tissue(self, sample: Sample) -> Sample:
        """Return a sample as the tissue, which moves, meets the needle."""
        place_mm, tissue_mm_s = self.state.tissue.motion_at(sample.clock_s)
        place_m = place_mm / MM_PER_M
        return sample._replace(
            depth_m=sample.depth_m - place_m,
            speed_m_s=sample.speed_m_s - tissue_mm_s / MM_PER_M,
            raw_depth_m=sample.raw_depth_m - place_m,
        )

    def judge_travel(self, means: Block) -> Travel:
        """Return how the needle has moved in a block."""
        # A block is a gap only if it is longer than ten of the blocks before.
        gap_s = max(self._gap_s, 10.0 * self.state.block.duration_s)
        is_gap = means.duration_s > gap_s
        fresh_mm = 0.0
        if self.state.deepest_mm != -FAR_MM:
            fresh_mm = max(means.depth_mm - self.state.deepest_mm, 0.0)
        return Travel(is_gap, not is_gap and self._is_advancing(means), fresh_mm)

    def _is_advancing(self, means: Block) -> bool:
        """Return whether the needle cuts further.

        A needle that swings does if the mean place of a swing lies deeper than that of
        the swing before.
        """
        creep_mm_s = 0.05
        last = self.state.block
        slow_mm_s = 0.15 * means.usual_speed_mm_s
        if means.is_swing and last.is_swing:
            # From the middle of the last swing to that of this one. Depths before the
            # filter show it, which takes a swing for noise.
            travel_mm = means.unfiltered_depth_mm - last.unfiltered_depth_mm
            mean_speed = travel_mm / (means.time_s - last.time_s)
            return mean_speed > max(creep_mm_s, slow_mm_s)
        min_speed = max(creep_mm_s + 2.0 * means.speed_std_mm_s, slow_mm_s)
        # Farther back, and by more than its noise, the tip is in its own channel.
        channel_mm = self.state.deepest_mm - 0.02 - 4.0 * means.depth_std_mm
        return means.speed_mm_s > min_speed and means.depth_mm > channel_mm

    def predict(self, means: Block, travel: Travel, since_reset_s: float) -> Block:
        """Let every component predict the force of a block.

        Returns:
            The block with the needle's own speed, and the noise of its force.
        """
        state = self.state
        last = state.block
        if means.is_swing is not last.is_swing:
            # Blocks of another length show other noise.
            state.levels = state.levels._replace(differences=SecondDifferences())
        levels = state.levels.beside(state.tissue, since_reset_s)
        own_speed = self._own_speed(means, is_gap=travel.is_gap)
        added_N = self._damping(means.depth_mm) * (own_speed - last.speed_mm_s)
        block = means._replace(
            speed_mm_s=own_speed,
            noise_std_N=levels.noise_std_N,
            force_by_speed_N=last.force_by_speed_N + added_N,
        )
        state.deepest_mm = max(state.deepest_mm, block.depth_mm)
        self._move_on(block, travel.fresh_mm, levels)
        state.is_motion_due = state.tissue.is_due(since_reset_s)
        return block

    @property
    def _mean(self) -> list[float]:
        """The unknowns of the likeliest component, 20 numbers."""
        return self.memory.store.means[0].tolist()

    @property
    def _assumptions(self) -> Assumptions:
        """What the likeliest component takes for granted."""
        return read_element(Assumptions, self.memory.store.assumptions, 0)

    def _damping(self, depth_mm: float) -> float:
        """Return viscous friction of the whole shaft [N/(mm/s)]."""
        mean = self._mean
        length_mm = max(depth_mm - self._assumptions.layer_start_mm, 0.0)
        return mean[TRAVERSED_VISCOUS] + mean[LAYER_VISCOUS] * length_mm

    def _own_speed(self, means: Block, *, is_gap: bool) -> float:
        """Return the needle's own speed, less jitter and the tissue's speed."""
        tissue = self.state.tissue
        place_mm, tissue_mm_s = tissue.motion_at(means.time_s)
        own_speed, self.state.speed_filter = filter_speed(
            FIRST_SPEED_FILTER if is_gap else self.state.speed_filter,
            means.unfiltered_depth_mm + place_mm,
            means.speed_mm_s + tissue_mm_s,
            means.depth_std_mm,
            means.speed_std_mm_s,
            means.duration_s,
        )
        if not tissue.is_known:
            return own_speed
        # The tissue's speed is an estimate as well: only what noise does not explain is
        # a change.
        deadband = 3.0 * means.speed_std_mm_s
        relative = own_speed - tissue_mm_s
        return min(
            max(self.state.block.speed_mm_s, relative - deadband), relative + deadband
        )

    def _move_on(self, block: Block, fresh_mm: float, levels: NoiseLevels) -> None:
        """Let the unknowns of every component go on by a block, beside events.

        Errors of the force model are the same for all components: one that claimed less
        would be believed more.
        """
        mean = self._mean
        slope = mean[STIFFNESS] + mean[LAYER_COULOMB]
        slope = max(slope + mean[LAYER_VISCOUS] * block.speed_mm_s, 0.004)  # N/mm
        # The cutting force changes by a twentieth of itself per square root of a mm.
        cutting_N = min(max(mean[HELD], 0.02), 2.0 * slope)
        traversed_N = block.deflection * mean[TRAVERSED_COULOMB]
        traversed_N = traversed_N + block.speed_mm_s * mean[TRAVERSED_VISCOUS]
        tip_N = abs(block.force_N - mean[OFFSET] - traversed_N)
        error_N = MODEL_ERROR_FRACTION * (
            tip_N + TRAVERSED_ERROR_FRACTION * abs(traversed_N)
        )
        heartbeat_N2 = levels.variances.heartbeat
        if self._assumptions.medium != AIR and not self.state.tissue.is_known:
            # Before a few beats have been seen nobody knows whether the tissue moves.
            heartbeat_N2 = max(heartbeat_N2, (0.1 * slope) ** 2)  # 0.1 mm
        predict(
            self.memory.store,
            self.memory.size,
            block.duration_s,
            fresh_mm,
            fresh_mm * (0.05 * cutting_N) ** 2,
            levels.variances.coloured,
            heartbeat_N2,
            levels.variances.breathing,
            error_N * error_N,
        )

    def learn_noise(
        self,
        block: Block,
        travel: Travel,
        filtered_speed: float,
        since_reset_s: float,
        *,
        is_met: bool,
        is_releasing: bool,
    ) -> Block:
        """Learn noise and texture from a block's force; return it with its noise.

        A force that a rupture is releasing is no noise, nor is what the speed does;
        beats are. The speed here is that of the travel filter.
        """
        state = self.state
        force_N = block.force_N - block.force_by_speed_N
        state.resumed *= math.exp(-travel.fresh_mm / RESUMED_MM)
        if is_releasing:
            state.levels = state.levels.restarted()
        else:
            state.levels = state.levels.with_force(
                force_N, block.duration_s, filtered_speed
            )
        in_tissue_mm = travel.fresh_mm if is_met else 0.0
        state.texture = state.texture.with_force(force_N, in_tissue_mm)
        levels = state.levels.beside(state.tissue, since_reset_s)
        return block._replace(noise_std_N=levels.noise_std_N)

    def correct(self, block: Block, *, is_advancing: bool) -> tuple[float, float]:
        """Let every component learn from a block's force.

        Returns:
            By what the force differed from the prediction, and the variance that was
            predicted of it.
        """
        last = self.state.block
        levels = self.state.levels
        # A speed is as late as its filter: where it changes it is off by a block's
        # change.
        speed_change = block.speed_mm_s - last.speed_mm_s
        speed_std = math.hypot(2.0 * block.speed_std_mm_s, speed_change)
        damping = self._damping(block.depth_mm)
        white_N2 = levels.variances.white * levels.differences.step / block.duration_s
        variance_N2 = max(white_N2, 1e-8) + (damping * speed_std) ** 2
        variance_N2 = variance_N2 + block.motion_variance_N2
        if self._assumptions.medium != AIR:
            turning = 1.0 - block.deflection
            if block.is_swing and last.is_swing:
                # From one swing to the next only its change is not settled.
                turning = abs(block.deflection - last.deflection)
            # Friction errs while presliding turns or after a rest: by 0.3 of the force.
            unsettled = max(turning, self.state.resumed)
            net_N = block.force_N - self.zero_N
            variance_N2 += (0.3 * unsettled * net_N) ** 2
        innovation = correct(self.memory.store, self.memory.size, block, variance_N2)
        penalise_implausible(self.memory.store, self.memory.size, block, is_advancing)
        self.state.is_branching_due = is_advancing
        self.state.is_pruning_due = True
        return innovation

    def forget_course(self) -> None:
        """Compare no later force with those so far: nothing is learnt from a block."""
        self.state.levels = self.state.levels.restarted()
        self.state.texture = self.state.texture.restarted()

    def pause(self, block: Block, travel: Travel, reported: int) -> None:
        """Learn nothing from a block: after a gap, at rest, in the own channel."""
        self.forget_course()
        slow_mm = MIN_BRANCHING_FRACTION * block.speed_mm_s * block.duration_s
        if travel.is_gap and travel.fresh_mm > slow_mm > 0.0:
            self._branch_in_gap(block, travel.fresh_mm, reported)
            return
        # Tissue that overtakes a needle which goes on turns its friction, but relaxes
        # nothing.
        tissue = self.state.tissue
        _, tissue_mm_s = tissue.motion_at(block.time_s)
        own_speed = block.speed_mm_s + tissue_mm_s
        is_slow = own_speed < MIN_BRANCHING_FRACTION * block.usual_speed_mm_s
        is_rest = travel.is_gap or not tissue.is_known or is_slow
        # A reversal leaves less than a rest does: it is over in half the travel.
        self.state.resumed = 1.0 if is_rest else max(self.state.resumed, 0.3)

    def _branch_in_gap(self, block: Block, fresh_mm: float, reported: int) -> None:
        """Begin components of what may have happened in a gap while the needle went on.

        Something may have happened half way or near the end, dated alike, so that
        either may prove right without retracting an alarm. The next block prunes.
        """
        end_s = block.time_s + 0.5 * block.duration_s
        store = self.memory.store
        ago_s = 0.0
        depth_mm = block.depth_mm
        for fraction in (0.5, 0.1):  # of the gap before its end
            ago_s = fraction * block.duration_s
            depth_mm = block.depth_mm - block.speed_mm_s * ago_s
            row = regressor(store.assumptions[0], block._replace(depth_mm=depth_mm))
            part = block._replace(
                time_s=end_s,
                duration_s=2.0 * ago_s,
                force_before_N=float(row @ store.means[0]),
            )
            self._branch(part, reported)
        rupture_s = read_column(store.history, "rupture_s")
        rupture_mm = read_column(store.history, "rupture_mm")
        is_new = rupture_mm > block.depth_mm - fresh_mm
        rupture_s[is_new] = end_s - ago_s
        rupture_mm[is_new] = depth_mm

    def keep(self, block: Block, force_std_N: float) -> None:
        """Take a block for the last one."""
        net_N = block.force_N - self.zero_N
        model_error_N = self.state.texture.model_error(net_N, force_std_N)
        self.state.block = block._replace(
            model_error_N=model_error_N, force_std_N=force_std_N
        )

    def branch_and_prune(self, reported: int, since_reset_s: float) -> None:
        """Begin components of the last block's travel, and drop the least likely."""
        state = self.state
        if state.is_branching_due and self.memory.size <= MAX_KEPT:
            self._branch(state.block, reported)
        self.memory.prune(state.block.depth_mm)
        state.is_branching_due = False
        state.is_pruning_due = False
        state.is_motion_due = state.tissue.is_due(since_reset_s)

    def _branch(self, block: Block, reported: int) -> None:
        travel_mm = block.speed_mm_s * block.duration_s
        begin = block._replace(depth_mm=block.depth_mm - 0.5 * travel_mm)
        is_fast = block.speed_mm_s > MIN_BRANCHING_FRACTION * block.usual_speed_mm_s
        before_mm = self.state.branched_mm
        if is_fast and begin.depth_mm - before_mm >= MIN_BRANCH_MM:
            tissue_speed_std = self._tissue_speed_std(block)
            self.memory.branch(begin, before_mm, tissue_speed_std, reported)
            self.state.branched_mm = begin.depth_mm

    def _tissue_speed_std(self, block: Block) -> float:
        """Return the standard deviation of the tissue's own speed [mm/s].

        The force that is seen of it says so.
        """
        variances = self.state.levels.beside(self.state.tissue, block.time_s).variances
        mean = self._mean
        travel_mm = max(block.depth_mm - self._assumptions.tip_start_mm, 0.0)
        slope = mean[STIFFNESS] + 2.0 * mean[STIFFENING] * travel_mm
        slope += (
            mean[LAYER_COULOMB] * block.deflection
            + mean[LAYER_VISCOUS] * block.speed_mm_s
        )
        # Hardly any growth of the force shows no motion.
        square = max(slope, 0.0) ** 2 + 1e-4  # N²/mm²
        damping = max(self._damping(block.depth_mm), 0.0)
        variance = 0.0
        for force_N2, frequency_hz, max_mm2 in (
            (variances.heartbeat, HEARTBEAT_HZ, 1.0),
            (variances.breathing, BREATHING_HZ, 4.0),
        ):
            rate = 2.0 * math.pi * frequency_hz
            response = square + (rate * damping) ** 2
            variance += rate**2 * min(force_N2 / response, max_mm2)
        return min(math.sqrt(variance), 5.0)

    def find_motion(self, since_reset_s: float) -> float:
        """Do a unit of the search for the tissue's motion.

        Returns:
            By how much the needle is deeper in the tissue that is now known to be
            elsewhere; it stays where it is.
        """
        state = self.state
        state.is_motion_due = False
        old_tissue = state.tissue
        if not old_tissue.is_due(since_reset_s):
            return 0.0  # a rupture, or the way out of the tissue, has ended its window
        state.tissue = old_tissue.worked(since_reset_s)
        if state.tissue.fit is old_tissue.fit:
            return 0.0
        old_place_mm, _ = old_tissue.motion_at(since_reset_s)
        place_mm, _ = state.tissue.motion_at(since_reset_s)
        by_mm = old_place_mm - place_mm
        state.deepest_mm += by_mm
        state.branched_mm += by_mm
        return by_mm
