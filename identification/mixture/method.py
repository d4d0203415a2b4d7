"""The method over time: blocks of samples, ruptures, layers, estimates.

A block's work is spread over samples: the one that fills it lets every component of the
mixture learn from its force; the next reports ruptures; the one after that begins
components of new events and drops the least likely. Where a rupture is raised, or a
layer is due, one more comes between. Where the needle does not advance, the one that
fills a block reports as well. One more may look for moving tissue.
"""

import math
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from foundation.records import (
    as_record,
    from_record,
    read_column,
    read_element,
    read_field,
)
from identification.config import MixtureConfig
from identification.estimate import (
    NO_EVENTS,
    NO_SAMPLE,
    Events,
    HardContact,
    LayerEstimate,
    Outputs,
    Rupture,
    RuptureState,
    Sample,
    TissueWarning,
    widen_forces,
)
from identification.mixture.block import Block
from identification.mixture.decisions import (
    RuptureCount,
    count_ruptures,
    may_be_braking,
    speed_lag,
)
from identification.mixture.disturbances import BREATHING_HZ, HEARTBEAT_HZ
from identification.mixture.evidence import MM_PER_M, Evidence, weigh_evidence
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
from identification.mixture.force_split import (
    LAYER_COLUMNS,
    estimate_sample,
    update_sample,
)
from identification.mixture.hard_contact import HardContactState
from identification.mixture.innovation_watch import InnovationWatch
from identification.mixture.layer_report import (
    Alarm,
    contact_std_mm,
    friction_of_last_layer,
    friction_of_layer_before,
    report_layer,
    report_rupture,
    with_doubt,
    with_friction,
)
from identification.mixture.mixture import (
    MAX_KEPT,
    MIN_BRANCH_MM,
    SMALL_RELEASE_PENALTY,
    MixtureMemory,
    MixtureState,
    ProcessNoise,
    correct,
    first_mixture,
    penalise_implausible,
    predict,
)
from identification.mixture.needle_contact import (
    NeedleContact,
    begin_block,
    shift_depth,
)
from identification.mixture.needle_pull import ONSET_S, NeedlePull, NetForce
from identification.mixture.needle_swing import MIN_HALF_S
from identification.mixture.noise_levels import (
    NO_DIFFERENCES,
    NoiseLevels,
    Texture,
)
from identification.mixture.rest_force import (
    NEVER_AT_REST,
    HeldForce,
    RestForce,
)
from identification.mixture.shaft_posterior import (
    ShaftPosterior,
    update_posterior,
)
from identification.mixture.speed_filter import (
    FIRST_SPEED_FILTER,
    SpeedFilter,
    filter_speed,
)
from identification.mixture.tissue_motion import Motion, TissueMotion
from identification.mixture.tissue_pull import REMEMBERED_S, TissuePull

TIP_STD = 5
"""Index of the deviation of the tip's force in `Outputs`."""

CUTTING_DRIFT = 0.05
"""Relative change of the cutting force, per square root of a mm."""

MIN_CUTTING_N = 0.02
"""Cutting force that this refers to, at least."""

MAX_CUTTING_PER_SLOPE_MM = 2.0
"""Cutting force that it refers to at most, over the growth of the force."""

MIN_SLOPE_N_PER_MM = 0.004
"""Growth of the force that motion of the tissue is seen by, at least."""

RESUMED_MM = 0.6
"""Travel over which friction is as it was before a rest: twice that of presliding."""

REVERSAL = 0.3
"""What a reversal leaves, where a rest leaves 1: it is over in half the travel."""

MIN_SLIDING_DEFLECTION = 0.9
"""Presliding deflection from which on all of the shaft slides inwards."""

SETTLED = 0.1
"""Of a rest or reversal so much is left in the friction when that counts as back."""

MIN_RESUMED = 1e-9
"""What is left of a rest, at least, for the logarithm."""

GAP_BLOCKS = 10.0
"""A block is a gap only if it is longer than so many of the blocks before."""

USUAL_S = 10.0
"""The usual speed is the highest of so much time."""

USUAL_MM = 3.0
"""And of so much travel: the approach may be quick."""

CREEP_MM_S = 0.05
"""A needle advances if it is faster than this, beyond the noise of the speed."""

MIN_ADVANCING_FRACTION = 0.15
"""And faster than this part of the usual speed."""

MIN_BRANCHING_FRACTION = 0.3
"""Part of the usual speed from which on new components begin: at a stop the force falls
without any rupture."""

CHANNEL_MM = 0.02
"""Behind the deepest point by more than this and its noise the tip is in its own
channel."""

CHANNEL_SIGMAS = 4.0
"""Standard deviations of the depth that count as its noise there."""

SPEED_DEADBAND_SIGMAS = 3.0
"""Deviations of the speed's noise within which it is the same, in moving tissue."""

UNSETTLED_FRACTION = 0.3
"""Error of friction while presliding turns or after a rest, as part of the force."""

RETRACTING_PROBABILITY = 0.9
"""Probability of fewer ruptures at which an alarm is retracted."""

UNLIKELY_PROBABILITY = 0.5
"""Probability of one more rupture below which a provisional alarm is retracted."""

EXPECTING_PROBABILITY = 0.5
"""Probability of one more rupture at which it is expected."""

PROVISIONAL_M = 1e-3
"""Travel after a rupture at which its layer is reported."""

FINAL_M = 3e-3
"""Travel after a rupture at which its layer is final."""

REVISE_S = 0.1
"""Time between two revisions of the last layer."""

UNKNOWN_MOTION_MM = 0.1
"""Motion of tissue with the heart, one standard deviation, if the beat is not known."""

SERIES_S = 1.5
"""Time between two alarms that a heart may have raised: 40 beats a minute."""

FAR_MM = 1e9
"""The deepest point before the first block lies so far in front."""

GAP_RUPTURE_FRACTIONS = (0.5, 0.1)
"""Parts of a gap before its end at which something may have happened: half way, and
near the end."""

MIN_WHITE_VARIANCE_N2 = 1e-8
"""Variance of a block's force by white noise, at least."""

MIN_STIFFNESS_SQUARE = 1e-4
"""Square of the growth of the force that shows the tissue's motion, at least
[N²/mm²]."""

MAX_HEARTBEAT_MM2 = 1.0
"""Variance of the tissue's place with the heartbeat, at most."""

MAX_BREATHING_MM2 = 4.0
"""The same with breathing."""

MAX_TISSUE_SPEED_VARIANCE = 25.0
"""Variance of the tissue's own speed, at most [mm²/s²]."""

OUTSIDE_MM = 2.0
"""Way in front of the first contact from which on a needle is out of the tissue: its
surface was pushed in, and is known that well."""

FRICTION_SIGMAS = 2.0
"""Standard deviations by which the friction that remains may be below that known."""

MIN_FRICTION_FRACTION = 0.5
"""And the part of that which remains at least: its model errs by so much."""

STOPPED_S = 1.0
"""A needle that comes to rest so soon after an alarm was stopped by it."""

UNDONE_S = 3.0
"""Time after an alarm in which a force that jumps back shows that a hand has let go."""

JUMP_BACK_FRACTION = 0.5
"""Part of the fall by which it jumps back at least."""

UNDONE_FRACTION = 0.3
"""Part of a fall whose return at rest shows that it was no rupture."""

MIN_RUPTURE_SPEED_MM_S = 1e-3
"""Speed of a rupture that a layer's viscous friction refers to, at least."""


class Stage(Enum):
    """What is left to do with the mixture, for the last block."""

    DONE = "nothing"
    BRANCH = "begin components of new events, then drop the least likely"
    PRUNE = "drop the least likely components"
    FIND_MOTION = "look for motion of the tissue"


DONE = Stage.DONE
"""The stage of most samples: its own name is found in a fourth of the time."""


@dataclass(slots=True)
class MixtureMethodState:
    """All that the method remembers. Its parts are immutable: a copy shares them.

    Mixture, contact and posterior are those of a snapshot: at work the method keeps
    them in records that compiled functions write into.

    Attributes:
        mixture: Of hypotheses.
        contact: What every sample changes.
        posterior: What the mixture knew of the shaft at the last block.
        levels: Noise of the force.
        tissue: Its motion by itself.
        speed_filter: Of the needle's own speed.
        texture: Of the tissue.
        block: The last one.
        stage: What is left to do with the mixture for that block.
        is_report_due: Whether ruptures are to be reported first.
        is_layer_due: Whether the layer traversed is to be reported first.
        deepest_mm: Deepest point so far.
        branched_mm: Depth at which components began last.
        resumed: How much of a rest or reversal is left in the friction, 0 to 1.
        force_std_in_air_N: Of the force's slow error before the contact.
        pull: Whether the force pulls at the needle.
        rest_force: Whether it changes at a needle that rests.
        tissue_pull: Whether tissue that moves has pulled at the needle.
        hard_contact: What a hard contact is found by.
        watch: Of the innovations.
        tip_std_N: Deviation of the tip's force that was stated last.
        model_errors_N: Largest `Block.model_error_N` since the last layer, and the one
            before, were reported.
        ruptures: In the components that the last report followed.
        alarm: The last one raised and not retracted.
        provisional: The provisional alarm that is neither confirmed nor retracted.
        rupture_probability: Of one rupture more than were reported.
        layers: Those traversed.
        rupture_state: What is reported.
        contact_std_mm: Standard deviation of the depth of first contact, the largest
            until the first rupture.
    """

    mixture: MixtureState
    contact: NeedleContact
    posterior: ShaftPosterior
    levels: NoiseLevels
    tissue: TissueMotion
    speed_filter: SpeedFilter
    texture: Texture
    block: Block
    stage: Stage
    is_report_due: bool
    is_layer_due: bool
    deepest_mm: float
    branched_mm: float
    resumed: float
    force_std_in_air_N: float
    pull: NeedlePull
    rest_force: RestForce
    tissue_pull: TissuePull
    hard_contact: HardContactState
    watch: InnovationWatch
    tip_std_N: float
    model_errors_N: tuple[float, float]
    ruptures: int
    alarm: Rupture | None
    provisional: Rupture | None
    rupture_probability: float
    layers: tuple[LayerEstimate, ...]
    rupture_state: RuptureState
    contact_std_mm: float = 0.0

    @property
    def is_at_work(self) -> bool:
        """Whether something is left to do for the last block."""
        return self.is_report_due or self.is_layer_due or self.stage is not Stage.DONE


def first_state() -> MixtureMethodState:
    """Return the state before the first sample."""
    return MixtureMethodState(
        mixture=first_mixture().state,
        contact=NeedleContact(),
        posterior=ShaftPosterior(),
        levels=NoiseLevels(),
        tissue=TissueMotion(),
        speed_filter=FIRST_SPEED_FILTER,
        texture=Texture(),
        block=Block(),
        stage=Stage.DONE,
        is_report_due=False,
        is_layer_due=False,
        deepest_mm=-FAR_MM,
        branched_mm=-FAR_MM,
        resumed=0.0,
        force_std_in_air_N=0.0,
        pull=NeedlePull(),
        rest_force=NEVER_AT_REST,
        tissue_pull=TissuePull(),
        hard_contact=HardContactState(),
        watch=InnovationWatch(),
        tip_std_N=0.0,
        model_errors_N=(0.0, 0.0),
        ruptures=0,
        alarm=None,
        provisional=None,
        rupture_probability=0.0,
        layers=(),
        rupture_state=RuptureState.NO_RUPTURE,
    )


class Likeliest(NamedTuple):
    """What the likeliest component says.

    Attributes:
        mean: Of its unknowns, 20 numbers.
        assumptions: What it takes for granted.
    """

    mean: list[float]
    assumptions: Assumptions

    def damping(self, depth_mm: float) -> float:
        """Return viscous friction of the whole shaft [N/(mm/s)]."""
        length_mm = max(depth_mm - self.assumptions.layer_start_mm, 0.0)
        return self.mean[TRAVERSED_VISCOUS] + self.mean[LAYER_VISCOUS] * length_mm


class MixtureMethod:
    """The mixture of event hypotheses, sample by sample.

    Attributes:
        layers: Those traversed.
        rupture_probability: Of one rupture more than the alarms have reported, now.
        rupture_state: Where it stands with respect to a rupture.
        events: What happened at the last sample.
        contact_depth_m: Depth at which tissue was met first, as known now; None before.
        is_pulled: Whether no tissue exerts the force, not even one that moves.
        warnings: What about the tissue keeps the estimate from being what it is
            elsewhere.
    """

    def __init__(self, config: MixtureConfig) -> None:
        self._config = config
        self._gap_s = config.check.gap_s
        self.restore(first_state())

    @property
    def state(self) -> MixtureMethodState:
        """All that it remembers."""
        return replace(
            self._state,
            mixture=self._memory.mixture.state,
            contact=from_record(NeedleContact, self._contact),
            posterior=from_record(ShaftPosterior, self._posterior),
        )

    @property
    def rupture_state(self) -> RuptureState:
        """Where it stands with respect to a rupture."""
        return self._state.rupture_state

    @property
    def rupture_probability(self) -> float:
        """Probability of one rupture more than the alarms have reported, now."""
        return self._state.rupture_probability

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed."""
        return self._state.layers

    @property
    def _is_tissue_moving(self) -> bool:
        """Whether tissue overtakes the needle of late."""
        return self._state.tissue_pull.is_moving(self._state.block.time_s)

    def restore(self, state: MixtureMethodState) -> None:
        """Go on from a state."""
        mean, covariance, innovation = state.speed_filter
        self._state = replace(
            state,
            speed_filter=SpeedFilter(np.array(mean), np.array(covariance), innovation),
        )
        self._memory = MixtureMemory(state.mixture.mixture)
        self._contact = as_record(state.contact)
        self._posterior = as_record(state.posterior)
        self.events = NO_EVENTS
        self._read_contact()
        self._keep_layers(state.layers)
        self._summarise_faults()

    def _read_contact(self) -> None:
        """Keep the depth of first contact, which callers want at every sample."""
        is_met = read_field(self._posterior, "in_contact")
        depth_m = float(read_field(self._posterior, "contact_depth_m"))
        self.contact_depth_m = depth_m if is_met else None

    def _summarise_faults(self) -> None:
        """Keep what is wrong with force and tissue since the last block."""
        self.is_pulled = (
            self._state.pull.is_foreign or self._state.rest_force.is_foreign
        )
        self.warnings = TissueWarning.NONE
        if self._is_tissue_moving:
            self.warnings |= TissueWarning.TISSUE_MOVES
        if self._state.hard_contact.is_hard:
            self.warnings |= TissueWarning.HARD_CONTACT
        if self._state.watch.doubt_at(self._state.block.time_s) > 0.0:
            self.warnings |= TissueWarning.UNEXPLAINED

    def _keep_layers(self, layers: tuple[LayerEstimate, ...]) -> None:
        """Take these layers for those traversed, with what every sample needs."""
        self._state.layers = layers
        self._layer_rows = np.zeros((len(layers), LAYER_COLUMNS))
        for row, layer in zip(self._layer_rows, layers, strict=True):
            coulomb_N = (layer.coulomb_N_per_m or 0.0) * layer.thickness_m
            coulomb_N = min(coulomb_N, layer.friction_N)
            speed = max(MM_PER_M * layer.rupture.speed_m_s, MIN_RUPTURE_SPEED_MM_S)
            viscous = (layer.friction_N - coulomb_N) / speed
            row[:] = (layer.start_depth_m, layer.thickness_m, coulomb_N, viscous)

    def report(self) -> Outputs:
        """Return what there is to report without a sample."""
        return self._estimate(NO_SAMPLE)

    def update(self, sample: Sample) -> Outputs:
        """Use one sample; return what to report of it beside the events."""
        arm_m_s = sample.speed_m_s
        if self._state.tissue.is_known:
            sample = self._seen_by_tissue(sample)
        is_full, outputs = update_sample(
            self._posterior,
            self._contact,
            self._layer_rows,
            sample.depth_m,
            sample.speed_m_s,
            sample.depth_std_m,
            sample.speed_std_m_s,
            arm_m_s,
            sample.force_N,
            sample.force_std_N,
            sample.raw_depth_m,
            sample.dt_s,
            sample.raw_speed_m_s,
        )
        self.events = NO_EVENTS
        if not (
            is_full
            or self._state.is_report_due
            or self._state.is_layer_due
            or self._state.stage is not DONE
        ):
            return self._with_doubt(outputs)
        self._work(sample, is_full=is_full)
        return self._estimate(sample)

    def doubt_zero(self, std_N: float) -> None:
        """Take the zero of the force for changed, in every component alike."""
        store = self._memory.store
        store.covariances[: self._memory.size, OFFSET, OFFSET] += std_N * std_N

    def doubt_ruptures(self, age_s: float) -> None:
        """Count no ruptures of the last time, and take them for unlikely."""
        self._doubt_ruptures(age_s, math.inf)

    def _doubt_ruptures(self, age_s: float, most: float) -> None:
        """Do the same; at most so many ruptures remain in the components that change.

        A component may count several ruptures of that time; it knows that of the last.
        """
        mixture = self._memory.mixture
        rupture_s = read_column(mixture.history, "rupture_s")
        ruptures = read_column(mixture.assumptions, "ruptures")
        is_recent = (rupture_s > self._state.block.time_s - age_s) & (ruptures > 0.0)
        mixture.log_weights[is_recent] -= SMALL_RELEASE_PENALTY
        ruptures[is_recent] = np.minimum(ruptures[is_recent] - 1.0, most)
        self._state.is_report_due = True

    def _estimate(self, sample: Sample) -> Outputs:
        """Return what to report of a sample by what is known now."""
        outputs = estimate_sample(
            self._posterior,
            self._contact,
            self._layer_rows,
            sample.depth_m,
            sample.speed_m_s,
            sample.force_N,
        )
        self._state.tip_std_N = outputs[TIP_STD] or 0.0
        return self._with_doubt(outputs)

    def _with_doubt(self, outputs: Outputs) -> Outputs:
        """Return outputs with what moving tissue, a swing and innovations put in doubt.

        In a swing tip force and friction go up and down about their means.
        """
        unexplained_N = self._state.watch.doubt_at(self._state.block.time_s)
        if unexplained_N > 0.0:
            outputs = widen_forces(outputs, unexplained_N)
        if self._state.tissue_pull.doubt_N > 0.0:
            outputs = self._state.tissue_pull.widen(outputs)
        if self._state.block.swing_std_N > 0.0:
            outputs = widen_forces(outputs, self._state.block.swing_std_N)
        return outputs

    def _seen_by_tissue(self, sample: Sample) -> Sample:
        """Return a sample as the tissue, which moves, meets the needle."""
        motion = self._state.tissue.motion_at(sample.clock_s)
        place_m = motion.place_mm / MM_PER_M
        return sample._replace(
            depth_m=sample.depth_m - place_m,
            speed_m_s=sample.speed_m_s - motion.speed_mm_s / MM_PER_M,
            raw_depth_m=sample.raw_depth_m - place_m,
        )

    def _work(self, sample: Sample, *, is_full: bool) -> None:
        """Do the next part of the last block's work; if a block is full, all of it."""
        if not is_full:
            self._do_next_part(sample)
            return
        while self._state.is_at_work:  # blocks are of one or two samples
            self._do_next_part(sample)
        self._use_block(sample)
        if not self._state.is_report_due:
            # The needle does not advance: the next sample has nothing to add.
            self._report(sample)

    def _do_next_part(self, sample: Sample) -> None:
        """Do the next part of what is left to do for the last block."""
        if self._state.is_report_due:
            self._state.is_report_due = False
            self._report(sample)
        elif self._state.is_layer_due:
            self._state.is_layer_due = False
            if self._state.alarm is not None:
                self._report_layer(self._state.alarm, sample.force_std_N)
        elif self._state.stage is Stage.FIND_MOTION:
            self._state.stage = Stage.DONE
            self._find_motion(sample.clock_s)
        else:
            if self._state.stage is Stage.BRANCH and self._memory.size <= MAX_KEPT:
                self._branch()
            self._memory.prune(self._state.block.depth_mm)
            self._state.stage = self._stage_after_pruning(sample.clock_s)

    def _stage_after_pruning(self, since_reset_s: float) -> Stage:
        """Return what is left to do for a block once its mixture is pruned."""
        is_due = self._state.tissue.is_due(since_reset_s)
        return Stage.FIND_MOTION if is_due else Stage.DONE

    def _find_motion(self, since_reset_s: float) -> None:
        """Do a unit of the search for the tissue's motion."""
        old_tissue = self._state.tissue
        if not old_tissue.is_due(since_reset_s):
            return  # a rupture, or the way out of the tissue, has ended its window
        self._state.tissue = old_tissue.worked(since_reset_s)
        if self._state.tissue.fit is not old_tissue.fit:
            # The needle stays where it is in the tissue that is now known to be
            # elsewhere.
            old_place_mm = old_tissue.motion_at(since_reset_s).place_mm
            place_mm = self._state.tissue.motion_at(since_reset_s).place_mm
            by_mm = old_place_mm - place_mm
            shift_depth(self._contact, by_mm / MM_PER_M)
            self._state.deepest_mm = self._state.deepest_mm + by_mm
            self._state.branched_mm = self._state.branched_mm + by_mm

    def _branch(self) -> None:
        """Begin components of what may have happened in the block's travel."""
        block = self._state.block
        travel_mm = block.speed_mm_s * block.duration_s
        begin = block._replace(depth_mm=block.depth_mm - 0.5 * travel_mm)
        is_fast = block.speed_mm_s > MIN_BRANCHING_FRACTION * block.usual_speed_mm_s
        if is_fast and begin.depth_mm - self._state.branched_mm >= MIN_BRANCH_MM:
            levels = self._state.levels.beside(self._state.tissue, block.time_s)
            tissue_speed_std = self._tissue_speed_std(block, levels)
            self._memory.branch(
                begin, self._state.branched_mm, tissue_speed_std, self._state.ruptures
            )
            self._state.branched_mm = begin.depth_mm

    def _use_block(self, sample: Sample) -> None:
        """Let every component predict the force of the block, and learn from it."""
        clock_s = sample.clock_s
        last = self._state.block
        filtered = self._take_block(clock_s, last)
        is_gap = filtered.duration_s > max(self._gap_s, GAP_BLOCKS * last.duration_s)
        is_met = bool(read_field(self._posterior, "in_contact"))
        is_advancing = not is_gap and self._is_advancing(filtered)
        fresh_mm = self._fresh_travel_mm(filtered)
        if filtered.is_swing is not last.is_swing:
            # Blocks of another length show other noise.
            self._state.levels = self._state.levels._replace(differences=NO_DIFFERENCES)
        likeliest = self._likeliest()
        levels = self._state.levels.beside(self._state.tissue, clock_s)
        block = self._with_own_speed(filtered, levels, likeliest, is_gap=is_gap)
        self._state.deepest_mm = max(self._state.deepest_mm, block.depth_mm)
        self._predict(block, fresh_mm, levels, likeliest)
        self._state.stage = self._stage_after_pruning(clock_s)
        is_cutting = (is_advancing or not is_met) and not is_gap
        if not is_gap:
            self._watch_pull(block, sample, is_advancing=is_cutting)
        if is_cutting and self._state.pull.is_pulled:
            self._state.levels = self._state.levels.restarted()
            self._state.texture = self._state.texture.restarted()
            if self._state.pull.is_foreign:
                # No motion of the tissue can be read there.
                self._state.tissue = self._state.tissue.restarted(clock_s)
        elif is_cutting:
            in_tissue_mm = fresh_mm if is_met else 0.0
            block = self._learn_from(
                block,
                likeliest,
                fresh_mm,
                in_tissue_mm,
                filtered.speed_mm_s,
                clock_s,
                sample.force_std_N,
            )
            penalise_implausible(
                self._memory.store, self._memory.size, block, is_advancing
            )
            self._state.stage = Stage.BRANCH if is_advancing else Stage.PRUNE
        else:
            self._pause(block, fresh_mm, is_gap=is_gap)
        if not is_met:
            self._state.force_std_in_air_N = sample.force_std_N
        net_N = block.force_N - float(self._memory.store.means[0, OFFSET])
        model_error_N = self._state.texture.model_error(net_N, sample.force_std_N)
        self._state.block = block._replace(model_error_N=model_error_N)
        if not is_gap:
            is_even = is_advancing and self._state.resumed < SETTLED
            self._watch_tissue(sample, is_met=is_met, is_even=is_even)
            self._state.tissue = self._state.tissue.with_block(filtered, is_met=is_met)
        self._summarise_faults()

    def _learn_from(
        self,
        block: Block,
        likeliest: Likeliest,
        fresh_mm: float,
        in_tissue_mm: float,
        filtered_speed: float,
        clock_s: float,
        force_std_N: float,
    ) -> Block:
        """Let noise, texture and mixture learn from the force of a block.

        Returns:
            The block with the noise of its force.
        """
        self._state.resumed *= math.exp(-fresh_mm / RESUMED_MM)
        levels = self._learn_noise(block, filtered_speed, clock_s)
        block = block._replace(noise_std_N=levels.noise_std_N)
        self._correct(block, levels, likeliest.assumptions, force_std_N)
        self._state.is_report_due = True
        force_N = block.force_N - block.force_by_speed_N
        self._state.texture = self._state.texture.with_force(force_N, in_tissue_mm)
        return block

    def _watch_pull(self, block: Block, sample: Sample, *, is_advancing: bool) -> None:
        """Judge whether tissue exerts the force; doubt ruptures where it does not.

        What has pulled for long is a new zero.
        """
        store = self._memory.store
        value_N = block.force_N - float(store.means[0, OFFSET])
        old_pull = self._state.pull
        was_pulled = old_pull.is_pulled
        self._state.pull = old_pull.with_force(
            self._net_force(block, sample, value_N, is_advancing=is_advancing)
        )
        if self._state.pull.is_pulled and not was_pulled:
            self._doubt_fall(sample, block.time_s - self._state.pull.peak_s + ONSET_S)
        elif self._is_fall_undone(sample, old_pull.recent_N, value_N):
            self._state.pull = self._state.pull._replace(is_foreign=True)
            self._doubt_alarm(sample)
        if self._state.pull.is_new_zero(block.time_s):
            self.doubt_zero(self._state.pull.fall_N)
            self._state.pull = self._state.pull.restarted()
        if is_advancing:
            self._state.rest_force = NEVER_AT_REST
        elif read_field(self._posterior, "in_contact"):
            self._watch_rest(block, sample, value_N)

    def _is_fall_undone(self, sample: Sample, recent_N: float, value_N: float) -> bool:
        """Return whether a force that fell below zero at the last alarm jumps back.

        A rupture leaves friction, and what it has released does not come back at once.
        """
        alarm = self._state.alarm
        if alarm is None or recent_N >= 0.0:
            return False
        if sample.time_s - alarm.alarm_s > UNDONE_S:
            return False
        zero_N = float(self._memory.store.means[0, OFFSET])
        fall_N = alarm.force_N - zero_N - recent_N
        return value_N - recent_N > JUMP_BACK_FRACTION * fall_N > 0.0

    def _doubt_alarm(self, sample: Sample) -> None:
        """Take the rupture of the last alarm for less likely than none."""
        if self._state.alarm is not None:
            self._doubt_fall(sample, sample.time_s - self._state.alarm.time_s + ONSET_S)

    def _doubt_fall(self, sample: Sample, age_s: float) -> None:
        """Take ruptures of a fall for less likely than none, that of an alarm too."""
        alarm = self._state.alarm
        is_alarm = alarm is not None and sample.time_s - alarm.time_s < age_s
        self._doubt_ruptures(age_s, self._state.ruptures - is_alarm)

    def _net_force(
        self, block: Block, sample: Sample, value_N: float, *, is_advancing: bool
    ) -> NetForce:
        """Return the force of a block without its zero, and how it was come by."""
        store = self._memory.store
        variance_N2 = (
            store.covariances[0, OFFSET, OFFSET]
            + block.noise_std_N**2
            + sample.force_std_N**2
            + block.motion_variance_N2
        )
        contact_m = self.contact_depth_m
        return NetForce(
            value_N=value_N,
            std_N=math.sqrt(variance_N2),
            time_s=block.time_s,
            duration_s=block.duration_s,
            is_advancing=is_advancing,
            behind_mm=self._state.deepest_mm - block.depth_mm,
            is_met=contact_m is not None,
            is_outside=contact_m is not None
            and block.depth_mm < MM_PER_M * contact_m - OUTSIDE_MM,
            friction_N=self._least_friction_N(block),
        )

    def _least_friction_N(self, block: Block) -> float:
        """Return the least friction of the layers traversed, at the present speed."""
        store = self._memory.store
        mean = store.means[0]
        covariance = store.covariances[0]
        speed = max(block.speed_mm_s, 0.0)
        friction_N = mean[TRAVERSED_COULOMB] + speed * mean[TRAVERSED_VISCOUS]
        variance_N2 = (
            covariance[TRAVERSED_COULOMB, TRAVERSED_COULOMB]
            + 2.0 * speed * covariance[TRAVERSED_COULOMB, TRAVERSED_VISCOUS]
            + speed**2 * covariance[TRAVERSED_VISCOUS, TRAVERSED_VISCOUS]
        )
        std_N = math.sqrt(max(variance_N2, 0.0))
        least_N = float(friction_N) - FRICTION_SIGMAS * std_N
        return MIN_FRICTION_FRACTION * max(least_N, 0.0)

    def _watch_rest(self, block: Block, sample: Sample, value_N: float) -> None:
        """Judge whether the force on a needle at rest only relaxes.

        The last alarm is doubted where its fall goes on at rest, or is undone there.
        """
        alarm = self._state.alarm
        was_foreign = self._state.rest_force.is_foreign
        alarm_age_s = math.inf if alarm is None else sample.time_s - alarm.alarm_s
        self._state.rest_force = self._state.rest_force.with_force(
            HeldForce(
                value_N,
                block.noise_std_N,
                sample.force_std_N,
                block.depth_mm,
                block.depth_std_mm,
                block.duration_s,
                has_ruptured=alarm_age_s - self._state.rest_force.rest_s < STOPPED_S,
            )
        )
        if alarm is None or was_foreign or not self._state.rest_force.is_foreign:
            return
        zero_N = block.force_N - value_N
        fall_N = alarm.force_N - zero_N - self._state.rest_force.mean_N
        is_undone = self._state.rest_force.change_N > UNDONE_FRACTION * fall_N > 0.0
        if self._state.rest_force.falls_on or is_undone:
            self._doubt_alarm(sample)

    def _fresh_travel_mm(self, block: Block) -> float:
        """Return the travel of a block beyond the deepest point so far."""
        if self._state.deepest_mm == -FAR_MM:
            return 0.0
        return max(block.depth_mm - self._state.deepest_mm, 0.0)

    def _watch_tissue(self, sample: Sample, *, is_met: bool, is_even: bool) -> None:
        """Look for tissue that pulls, and for a hard contact, with the last block.

        Args:
            sample: The last one.
            is_met: Whether the needle is in tissue.
            is_even: Whether the needle has advanced evenly.
        """
        block = self._state.block
        store = self._memory.store
        zero_N = float(store.means[0, OFFSET])
        zero_variance_N2 = float(store.covariances[0, OFFSET, OFFSET])
        variance_N2 = (
            self._state.levels.variances.white
            + sample.force_std_N**2
            + block.motion_variance_N2
        )
        doubt_N = self._state.tissue_pull.doubt_N
        levels = self._state.levels.beside(self._state.tissue, block.time_s)
        self._state.tissue_pull = self._state.tissue_pull.with_zero(
            zero_N, zero_variance_N2, is_met=is_met
        ).with_force(
            block,
            variance_N2,
            self._state.tissue.amplitude_mm,
            levels.variances.breathing,
            is_sliding=is_even
            and block.deflection > MIN_SLIDING_DEFLECTION
            and not self._state.pull.is_foreign,
        )
        if self._state.tissue_pull.doubt_N > doubt_N:
            self._doubt_layers(sample.time_s)
        self._state.hard_contact = self._state.hard_contact.with_force(
            block,
            block.force_N - zero_N,
            self._config.hard_contact_N_per_m / MM_PER_M,
            is_even=is_even and is_met and not self._is_tissue_moving,
        )
        if self._state.hard_contact.is_new:
            contact = HardContact(
                alarm_s=sample.time_s,
                depth_m=sample.depth_m,
                force_N=block.force_N,
                growth_N_per_m=MM_PER_M * self._state.hard_contact.growth_N_per_mm,
            )
            self.events = self.events._replace(hard_contact=contact)

    def _doubt_layers(self, time_s: float) -> None:
        """Take back that layers are final whose ruptures motion may have made."""
        doubt_N = self._state.tissue_pull.doubt_N
        self._keep_layers(
            tuple(
                with_doubt(layer, doubt_N)
                if time_s - layer.rupture.alarm_s < REMEMBERED_S
                else layer
                for layer in self.layers
            )
        )

    def _take_block(self, since_reset_s: float, last: Block) -> Block:
        """Return means of the block that is full, and begin the next one."""
        contact = from_record(NeedleContact, self._contact)
        swing = contact.swing
        begin_block(self._contact)
        duration_s = contact.block_s
        depth_std_mm = MM_PER_M * contact.depth_std_m
        speed_std_mm_s = MM_PER_M * contact.speed_std_m_s
        speed_mm_s = MM_PER_M * contact.travel_m / duration_s
        forgotten = math.exp(
            -duration_s / USUAL_S - abs(speed_mm_s) * duration_s / USUAL_MM
        )
        mean_N = contact.force_N_s / duration_s
        square_N2 = contact.force_squared_N2_s / duration_s
        is_swing = swing.is_swinging and duration_s > 2.0 * MIN_HALF_S
        usual_speed_mm_s = max(last.usual_speed_mm_s * forgotten, speed_mm_s)
        if is_swing:
            if not last.is_swing:
                # What the swing has added to the speed so far is not usual.
                mean_speed_mm_s = MM_PER_M * swing.mean_m_s
                usual_speed_mm_s = max(speed_mm_s, mean_speed_mm_s)
            # The travel filter takes a swing for noise; the mean speed has none of it.
            noise_std_mm_s = MM_PER_M * math.sqrt(swing.noise_variance)
            speed_std_mm_s = min(speed_std_mm_s, noise_std_mm_s)
        return Block(
            time_s=since_reset_s - 0.5 * duration_s,
            duration_s=duration_s,
            depth_mm=MM_PER_M * contact.depth_m_s / duration_s,
            speed_mm_s=speed_mm_s,
            deflection=contact.deflection_s / duration_s,
            force_N=mean_N,
            unfiltered_depth_mm=MM_PER_M * contact.unfiltered_depth_m_s / duration_s,
            # A filter that leaves so much noise in both is as slow as their ratio.
            speed_lag_s=speed_lag(depth_std_mm, speed_std_mm_s),
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

    def _is_advancing(self, block: Block) -> bool:
        """Return whether the needle cuts further.

        A needle that swings does if the mean place of a swing lies deeper than that of
        the swing before.
        """
        if block.is_swing and self._state.block.is_swing:
            mean_speed = self._mean_speed_of_swings(block)
            usual_speed = MIN_ADVANCING_FRACTION * block.usual_speed_mm_s
            return mean_speed > max(CREEP_MM_S, usual_speed)
        creep = CREEP_MM_S + 2.0 * block.speed_std_mm_s
        min_speed = max(creep, MIN_ADVANCING_FRACTION * block.usual_speed_mm_s)
        channel_mm = (
            self._state.deepest_mm - CHANNEL_MM - CHANNEL_SIGMAS * block.depth_std_mm
        )
        return block.speed_mm_s > min_speed and block.depth_mm > channel_mm

    def _mean_speed_of_swings(self, block: Block) -> float:
        """Return the speed from the middle of the last swing to that of this one.

        Depths before the filter show it, which takes a swing for noise.
        """
        last = self._state.block
        travel_mm = block.unfiltered_depth_mm - last.unfiltered_depth_mm
        return travel_mm / (block.time_s - last.time_s)

    def _with_own_speed(
        self,
        block: Block,
        levels: NoiseLevels,
        likeliest: Likeliest,
        *,
        is_gap: bool,
    ) -> Block:
        """Return a block with the needle's own speed, and the noise of its force."""
        last = self._state.block
        own_speed = self._own_speed(block, is_gap=is_gap)
        speed_change = own_speed - last.speed_mm_s
        added_N = likeliest.damping(block.depth_mm) * speed_change
        return block._replace(
            speed_mm_s=own_speed,
            noise_std_N=levels.noise_std_N,
            force_by_speed_N=last.force_by_speed_N + added_N,
        )

    def _own_speed(self, block: Block, *, is_gap: bool) -> float:
        """Return the needle's own speed, less jitter and the tissue's speed."""
        tissue = self._state.tissue
        motion = Motion(0.0, 0.0)
        if tissue.is_known:
            motion = tissue.motion_at(block.time_s)
        own_speed, self._state.speed_filter = filter_speed(
            FIRST_SPEED_FILTER if is_gap else self._state.speed_filter,
            block.unfiltered_depth_mm + motion.place_mm,
            block.speed_mm_s + motion.speed_mm_s,
            block.depth_std_mm,
            block.speed_std_mm_s,
            block.duration_s,
        )
        if not tissue.is_known:
            return own_speed
        # The tissue's speed is an estimate as well: only what noise does not explain is
        # a change.
        deadband = SPEED_DEADBAND_SIGMAS * block.speed_std_mm_s
        relative = own_speed - motion.speed_mm_s
        return min(
            max(self._state.block.speed_mm_s, relative - deadband), relative + deadband
        )

    def _likeliest(self) -> Likeliest:
        """Return what the likeliest component says."""
        store = self._memory.store
        assumptions = read_element(Assumptions, store.assumptions, 0)
        return Likeliest(store.means[0].tolist(), assumptions)

    def _predict(
        self,
        block: Block,
        fresh_mm: float,
        levels: NoiseLevels,
        likeliest: Likeliest,
    ) -> None:
        """Move the mixture on to a block.

        Errors of the force model are the same for all components: one that claimed less
        would be believed more.
        """
        mean = likeliest.mean
        slope = mean[STIFFNESS] + mean[LAYER_COULOMB]
        slope = slope + mean[LAYER_VISCOUS] * block.speed_mm_s
        slope = max(slope, MIN_SLOPE_N_PER_MM)
        cutting_N = max(mean[HELD], MIN_CUTTING_N)
        cutting_N = min(cutting_N, MAX_CUTTING_PER_SLOPE_MM * slope)
        traversed_N = block.deflection * mean[TRAVERSED_COULOMB]
        traversed_N = traversed_N + block.speed_mm_s * mean[TRAVERSED_VISCOUS]
        tip_N = abs(block.force_N - mean[OFFSET] - traversed_N)
        error_N = MODEL_ERROR_FRACTION * (
            tip_N + TRAVERSED_ERROR_FRACTION * abs(traversed_N)
        )
        heartbeat_N2 = levels.variances.heartbeat
        if likeliest.assumptions.medium != AIR and not self._state.tissue.is_known:
            # Before a few beats have been seen nobody knows whether the tissue moves.
            heartbeat_N2 = max(heartbeat_N2, (UNKNOWN_MOTION_MM * slope) ** 2)
        noise = ProcessNoise(
            duration_s=block.duration_s,
            fresh_travel_mm=fresh_mm,
            held_variance=fresh_mm * (CUTTING_DRIFT * cutting_N) ** 2,
            coloured_variance=levels.variances.coloured,
            heartbeat_variance=heartbeat_N2,
            breathing_variance=levels.variances.breathing,
            model_error_variance=error_N * error_N,
        )
        predict(self._memory.store, self._memory.size, noise)

    def _learn_noise(
        self, block: Block, filtered_speed: float, since_reset_s: float
    ) -> NoiseLevels:
        """Learn the noise from a block, and return the levels beside the motion.

        A force that is being released is no noise, nor is what the speed does; beats
        are.
        """
        if self._is_layer_open and not self._is_series:
            self._state.levels = self._state.levels.restarted()
        else:
            force_N = block.force_N - block.force_by_speed_N
            self._state.levels = self._state.levels.with_force(
                force_N, block.duration_s, filtered_speed
            )
        return self._state.levels.beside(self._state.tissue, since_reset_s)

    def _correct(
        self,
        block: Block,
        levels: NoiseLevels,
        assumptions: Assumptions,
        force_std_N: float,
    ) -> None:
        """Update the mixture with a block's force, and watch how it had erred."""
        mean = self._memory.store.means[0].tolist()  # those that the block predicts
        likeliest = Likeliest(mean, assumptions)
        # A speed is as late as its filter: where it changes it is off by a block's
        # change.
        speed_change = block.speed_mm_s - self._state.block.speed_mm_s
        speed_std = math.hypot(2.0 * block.speed_std_mm_s, speed_change)
        damping = likeliest.damping(block.depth_mm)
        step_s = levels.differences.step
        white_N2 = levels.variances.white * step_s / block.duration_s
        variance_N2 = max(white_N2, MIN_WHITE_VARIANCE_N2) + (damping * speed_std) ** 2
        variance_N2 = variance_N2 + block.motion_variance_N2
        if assumptions.medium != AIR:
            unsettled = max(self._unsettled_deflection(block), self._state.resumed)
            net_N = block.force_N - mean[OFFSET]
            variance_N2 += (UNSETTLED_FRACTION * unsettled * net_N) ** 2
        innovation_N, predicted_N2 = correct(
            self._memory.store, self._memory.size, block, variance_N2
        )
        if read_field(self._posterior, "in_contact") and not self._is_layer_open:
            self._state.watch = self._state.watch.with_innovation(
                innovation_N,
                predicted_N2,
                block.time_s,
                block.duration_s,
                max(self._state.tip_std_N, force_std_N),
            )

    def _unsettled_deflection(self, block: Block) -> float:
        """Return how far a block's presliding is from what the force model holds for.

        From one swing to the next only its change is.
        """
        if block.is_swing and self._state.block.is_swing:
            return abs(block.deflection - self._state.block.deflection)
        return 1.0 - block.deflection

    def _pause(self, block: Block, fresh_mm: float, *, is_gap: bool) -> None:
        """Learn nothing from a block: after a gap, at rest, in the own channel."""
        self._state.levels = self._state.levels.restarted()
        self._state.texture = self._state.texture.restarted()
        slow_mm = MIN_BRANCHING_FRACTION * block.speed_mm_s * block.duration_s
        if is_gap and fresh_mm > slow_mm > 0.0:
            self._branch_in_gap(block, fresh_mm)
            return
        # Tissue that overtakes a needle which goes on turns its friction, but relaxes
        # nothing.
        tissue_speed = -math.inf
        if self._state.tissue.is_known:
            tissue_speed = self._state.tissue.motion_at(block.time_s).speed_mm_s
        own_speed = block.speed_mm_s + tissue_speed
        is_slow = own_speed < MIN_BRANCHING_FRACTION * block.usual_speed_mm_s
        is_rest = is_gap or is_slow
        self._state.resumed = 1.0 if is_rest else max(self._state.resumed, REVERSAL)

    def _branch_in_gap(self, block: Block, fresh_mm: float) -> None:
        """Begin components of what may have happened in a gap while the needle went on.

        Something may have happened half way or near the end, dated alike, so that
        either may prove right without retracting an alarm. The next block prunes.
        """
        end_s = block.time_s + 0.5 * block.duration_s
        store = self._memory.store
        ago_s = 0.0
        depth_mm = block.depth_mm
        for fraction in GAP_RUPTURE_FRACTIONS:
            ago_s = fraction * block.duration_s
            depth_mm = block.depth_mm - block.speed_mm_s * ago_s
            row = regressor(store.assumptions[0], block._replace(depth_mm=depth_mm))
            self._state.block = block._replace(
                time_s=end_s,
                duration_s=2.0 * ago_s,
                force_before_N=float(row @ store.means[0]),
            )
            self._branch()
        rupture_s = read_column(store.history, "rupture_s")
        rupture_mm = read_column(store.history, "rupture_mm")
        is_new = rupture_mm > block.depth_mm - fresh_mm
        rupture_s[is_new] = end_s - ago_s
        rupture_mm[is_new] = depth_mm

    def _tissue_speed_std(self, block: Block, levels: NoiseLevels) -> float:
        """Return the standard deviation of the tissue's own speed [mm/s].

        The force that is seen of it says so.
        """
        likeliest = self._likeliest()
        mean = likeliest.mean
        assumptions = likeliest.assumptions
        travel_mm = max(block.depth_mm - assumptions.tip_start_mm, 0.0)
        slope = mean[STIFFNESS] + 2.0 * mean[STIFFENING] * travel_mm
        slope += (
            mean[LAYER_COULOMB] * block.deflection
            + mean[LAYER_VISCOUS] * block.speed_mm_s
        )
        slope = max(slope, 0.0)
        damping = max(likeliest.damping(block.depth_mm), 0.0)
        variance = 0.0
        for force_N2, frequency_hz, max_mm2 in (
            (levels.variances.heartbeat, HEARTBEAT_HZ, MAX_HEARTBEAT_MM2),
            (levels.variances.breathing, BREATHING_HZ, MAX_BREATHING_MM2),
        ):
            rate = 2.0 * math.pi * frequency_hz
            response = slope**2 + MIN_STIFFNESS_SQUARE + (rate * damping) ** 2
            variance += rate**2 * min(force_N2 / response, max_mm2)
        return math.sqrt(min(variance, MAX_TISSUE_SPEED_VARIANCE))

    @property
    def _is_layer_open(self) -> bool:
        """Whether the layer of the last alarm is not among the layers yet."""
        if self._state.alarm is None:
            return False
        return layers_traversed(self.layers) < self._state.alarm.layer

    @property
    def _is_series(self) -> bool:
        """Whether the last alarm came so soon that a heart may have raised both."""
        if self._state.alarm is None:
            return False
        times_before_s = [
            layer.rupture.time_s
            for layer in self.layers
            if layer.layer < self._state.alarm.layer
        ]
        if not times_before_s:
            return False
        return self._state.alarm.time_s - times_before_s[-1] < SERIES_S

    def _report(self, sample: Sample) -> None:
        """Raise or retract an alarm, and summarise the mixture for the next samples."""
        alarm = self._state.alarm
        evidence = weigh_evidence(self._memory.mixture, alarm, self._state.ruptures)
        count = count_ruptures(evidence, self._state.ruptures, self._state.block)
        self._state.rupture_probability = min(count.more, 1.0)
        if self._is_layer_open:
            self._state.rupture_state = RuptureState.FORCE_DROP_MEASURING
        elif count.more > EXPECTING_PROBABILITY:
            self._state.rupture_state = RuptureState.EXPECTED
        else:
            self._state.rupture_state = RuptureState.NO_RUPTURE
        if self._is_rupture(evidence, count, sample.clock_s):
            self._raise_alarm(evidence, sample, count)
            # The next sample reports again: this one has had enough to do.
            self._state.is_report_due = True
            return
        if alarm is not None and count.fewer > RETRACTING_PROBABILITY:
            self._retract(alarm, count)
        elif alarm is not None and self.events.rupture is None:
            self._state.is_layer_due = (
                self._state.is_layer_due or self._is_layer_report_due(alarm)
            )
        self._update_provisional(evidence, sample, count)
        rupture = self._state.alarm
        if rupture is None and self.layers:
            rupture = self.layers[-1].rupture
        update_posterior(
            self._posterior,
            evidence,
            self._state.block,
            self._state.ruptures,
            layers_traversed(self.layers) + self._is_layer_open,
            0.0 if rupture is None else MM_PER_M * rupture.speed_m_s,
        )
        self._read_contact()
        self._learn_contact_std(evidence)

    def _learn_contact_std(self, evidence: Evidence) -> None:
        """Keep how well the depth of first contact was known, the worst since then.

        Farther on components tell it apart by errors of the force model alone.
        """
        if self.contact_depth_m is None:
            self._state.contact_std_mm = 0.0
        elif self._state.ruptures == 0:
            std_mm = contact_std_mm(evidence, self._state.block)
            self._state.contact_std_mm = max(self._state.contact_std_mm, std_mm)

    def _is_rupture(
        self, evidence: Evidence, count: RuptureCount, since_reset_s: float
    ) -> bool:
        """Return whether to raise an alarm."""
        component = count.likeliest_with_more
        if count.more <= self._config.alarm_probability or self._state.pull.may_pull:
            return False
        mixture = evidence.mixture
        rupture_mm = float(read_column(mixture.history, "rupture_mm")[component])
        if not self._is_settled(rupture_mm):
            return False
        tissue = self._state.tissue
        return not may_be_braking(
            mixture, component, self._state.block, since_reset_s, tissue
        )

    def _is_settled(self, rupture_mm: float) -> bool:
        """Return whether the needle advances, and far enough since a stop.

        A stop lets the force fall.
        """
        since_mm = self._state.block.depth_mm - rupture_mm
        resumed_mm = -RESUMED_MM * math.log(max(self._state.resumed, MIN_RESUMED))
        is_before_stop = since_mm < resumed_mm
        return resumed_mm > 0.0 and (is_before_stop or self._state.resumed < SETTLED)

    def _raise_alarm(
        self, evidence: Evidence, sample: Sample, count: RuptureCount
    ) -> None:
        """Report a rupture, and with it the layer before as final."""
        layers = self.layers
        identified_layer = self.events.identified_layer
        if layers and not (layers[-1].is_final or self._is_tissue_moving):
            identified_layer = replace(layers[-1], is_final=True)
            self._keep_layers((*layers[:-1], identified_layer))
        self._state.alarm = report_rupture(
            evidence,
            count.likeliest_with_more,
            layers_traversed(layers) + 1,
            count.more,
            Alarm(sample.time_s, sample.clock_s, sample.depth_m),
            self._state.contact_std_mm,
        )
        self._state.ruptures = int(evidence.ruptures[count.likeliest_with_more])
        self._state.model_errors_N = (0.0, self._state.model_errors_N[0])
        self._state.watch = self._state.watch.restarted()
        self._state.provisional = None
        self._state.rupture_state = RuptureState.DETECTED
        self.events = Events(self._state.alarm, identified_layer)
        # Every beat may raise an alarm until it is known: then the window has to grow
        # across them.
        if not self._is_series or self._state.tissue.is_known:
            self._state.tissue = self._state.tissue.restarted(sample.clock_s)

    def _update_provisional(
        self, evidence: Evidence, sample: Sample, count: RuptureCount
    ) -> None:
        """Raise a provisional alarm, or retract the one raised.

        Unlike an alarm it does not wait until the speed shows whether the needle
        brakes.
        """
        if self._state.provisional is not None:
            if count.more < UNLIKELY_PROBABILITY:
                retracted = replace(self._state.provisional, probability=count.more)
                self.events = self.events._replace(provisional_retracted=retracted)
                self._state.provisional = None
            return
        component = count.likeliest_with_more
        if count.more <= self._config.provisional_probability:
            return
        history = evidence.mixture.history
        if not self._is_settled(float(read_column(history, "rupture_mm")[component])):
            return
        self._state.provisional = report_rupture(
            evidence,
            component,
            layers_traversed(self.layers) + self._is_layer_open + 1,
            count.more,
            Alarm(sample.time_s, sample.clock_s, sample.depth_m),
            self._state.contact_std_mm,
        )
        self.events = self.events._replace(provisional=self._state.provisional)

    def _retract(self, alarm: Rupture, count: RuptureCount) -> None:
        """Retract an alarm: the force has come back, and no rupture was there."""
        retracted = replace(alarm, probability=1.0 - count.fewer)
        self.events = self.events._replace(retracted=retracted)
        self._keep_layers(self.layers if self._is_layer_open else self.layers[:-1])
        self._state.ruptures = min(count.likeliest, self._state.ruptures - 1)
        before_N = self._state.model_errors_N[1]
        self._state.model_errors_N = (before_N, before_N)
        self._state.alarm = None

    def _is_layer_final(self, alarm: Rupture) -> bool:
        """Return whether the last layer is final now, so far behind its rupture."""
        if self._is_tissue_moving:
            return False
        travel_m = self._state.block.depth_mm / MM_PER_M - alarm.depth_m
        is_far = not 0.0 <= travel_m < FINAL_M
        return is_far and not self._is_layer_open and not self.layers[-1].is_final

    def _is_layer_report_due(self, alarm: Rupture) -> bool:
        """Return whether the last layer is reported or revised now."""
        if self._is_layer_open:
            travel_m = self._state.block.depth_mm / MM_PER_M - alarm.depth_m
            return travel_m >= PROVISIONAL_M
        is_revised = self._state.block.time_s % REVISE_S < self._state.block.duration_s
        return is_revised or self._is_layer_final(alarm)

    def _report_layer(self, alarm: Rupture, force_std_N: float) -> None:
        """Report the layer that the last rupture ended, or revise it."""
        evidence = weigh_evidence(self._memory.mixture, alarm, self._state.ruptures)
        # What the force's slow error grew by since the air is in the friction, and the
        # force model's: its largest, since what a later tissue shows of it is not that
        # of the layer.
        grown_N2 = max(force_std_N**2 - self._state.force_std_in_air_N**2, 0.0)
        doubt_N = math.hypot(
            self._state.tissue_pull.doubt_N,
            self._state.block.swing_std_N,
            self._state.watch.doubt_at(self._state.block.time_s),
        )
        last_N, before_N = self._state.model_errors_N
        last_N = max(last_N, self._state.block.model_error_N)
        before_N = max(before_N, self._state.block.model_error_N)
        self._state.model_errors_N = (last_N, before_N)
        common_N2 = grown_N2 + doubt_N**2
        variance_N2 = common_N2 + last_N**2
        if self._is_layer_open:
            self._report_new_layer(alarm, evidence, variance_N2)
        else:
            variance_before_N2 = common_N2 + before_N**2
            self._revise_layers(alarm, evidence, variance_N2, variance_before_N2)

    def _report_new_layer(
        self, alarm: Rupture, evidence: Evidence, variance_N2: float
    ) -> None:
        """Report the layer that the last rupture ended, provisionally."""
        friction = friction_of_last_layer(evidence, self._state.ruptures, variance_N2)
        if friction is None:
            return
        layer = report_layer(
            evidence, alarm, self._state.ruptures, friction, self._state.block
        )
        if layer is not None:
            if self._state.tissue_pull.doubt_N > 0.0:
                layer = with_doubt(layer, self._state.tissue_pull.doubt_N)
            self._keep_layers((*self.layers, layer))
            self.events = self.events._replace(identified_layer=layer)
            self._state.rupture_state = RuptureState.FRICTION_IDENTIFIED

    def _revise_layers(
        self,
        alarm: Rupture,
        evidence: Evidence,
        variance_N2: float,
        variance_before_N2: float,
    ) -> None:
        """Revise the last two layers, and report the last one once it is final."""
        layers = list(self.layers)
        is_final = self._is_layer_final(alarm)
        friction = friction_of_last_layer(evidence, self._state.ruptures, variance_N2)
        if friction is not None:
            layers[-1] = with_friction(layers[-1], friction)
        if is_final:
            rupture = replace(layers[-1].rupture, is_final=True)
            layers[-1] = replace(layers[-1], is_final=True, rupture=rupture)
            self.events = self.events._replace(identified_layer=layers[-1])
        friction = friction_of_layer_before(
            evidence, self._state.ruptures, variance_before_N2
        )
        if friction is not None and len(layers) > 1:
            layers[-2] = with_friction(layers[-2], friction)
        self._keep_layers(tuple(layers))


def layers_traversed(layers: tuple[LayerEstimate, ...]) -> int:
    """Return how many layers were traversed, those no longer kept included."""
    return layers[-1].layer if layers else 0
