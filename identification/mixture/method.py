"""The method, sample by sample: what is due for the last block, and what is reported.

Every sample is split by what the mixture knew at the last block (`force_split`). One
that fills a block lets every component of the mixture learn from its force (`learner`),
beside those who watch the force (`force_watch`). The next reports ruptures
(`reporter`); the one after that begins components of new events and drops the least
likely. Where a rupture is raised, or a layer is due, one more comes between. Where the
needle does not advance, the one that fills a block reports as well. One more may look
for moving tissue.
"""

from dataclasses import dataclass, field, replace

from foundation.arrays import Array
from foundation.records import as_record, from_record, read_field
from identification.config import MixtureConfig
from identification.estimate import (
    Estimate,
    LayerEstimate,
    Outputs,
    Sample,
    SampleStatus,
)
from identification.mixture.block import MM_PER_M, Block
from identification.mixture.force_split import TIP_STD, estimate_sample, update_sample
from identification.mixture.force_watch import ForceWatch, ForceWatchState
from identification.mixture.learner import (
    Learner,
    LearnerState,
    Travel,
    take_block,
)
from identification.mixture.mixture import MixtureMemory, first_mixture
from identification.mixture.needle_contact import NeedleContact, shift_depth
from identification.mixture.reporter import Reporter, ReporterState
from identification.mixture.shaft_posterior import ShaftPosterior, update_posterior


@dataclass(slots=True)
class MixtureMethodState:
    """All that the method remembers, as a snapshot holds it.

    Attributes:
        mixture: Of hypotheses, see `Mixture.state`.
        contact: What every sample changes.
        posterior: What the mixture knew of the shaft at the last block.
        learner: What is learnt beside the mixture.
        watch: What the watchers of the force remember.
        reporter: What has been reported.
        tip_std_N: Deviation of the tip's force that was stated last.
    """

    mixture: tuple[Array, ...] = field(default_factory=lambda: first_mixture().state)
    contact: NeedleContact = field(default_factory=NeedleContact)
    posterior: ShaftPosterior = field(default_factory=ShaftPosterior)
    learner: LearnerState = field(default_factory=LearnerState)
    watch: ForceWatchState = field(default_factory=ForceWatchState)
    reporter: ReporterState = field(default_factory=ReporterState)
    tip_std_N: float = 0.0


class MixtureMethod:
    """The mixture of event hypotheses, sample by sample.

    Attributes:
        contact_depth_m: Depth at which tissue was met first, as known now; None before.
    """

    def __init__(self, config: MixtureConfig) -> None:
        self._config = config
        self.restore(MixtureMethodState())

    @property
    def state(self) -> MixtureMethodState:
        """All that it remembers."""
        return MixtureMethodState(
            mixture=self._learner.memory.mixture.state,
            contact=from_record(NeedleContact, self._contact),
            posterior=from_record(ShaftPosterior, self._posterior),
            learner=replace(self._learner.state),
            watch=replace(self._watch.state),
            reporter=replace(self._reporter.state),
            tip_std_N=self._tip_std_N,
        )

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed."""
        return self._reporter.state.layers

    @property
    def _is_at_work(self) -> bool:
        """Whether something is left to do for the last block."""
        reporter = self._reporter.state
        learner = self._learner.state
        is_reporting = reporter.is_due or reporter.is_layer_due
        return is_reporting or learner.is_pruning_due or learner.is_motion_due

    def restore(self, state: MixtureMethodState) -> None:
        """Go on from a state."""
        config = self._config
        memory = MixtureMemory(state.mixture)
        learner = Learner(memory, state.learner, config.check.gap_s)
        watch = ForceWatch(learner, state.watch, config.hard_contact_N_per_m)
        self._learner = learner
        self._watch = watch
        self._reporter = Reporter(learner, watch, state.reporter, config)
        self._contact = as_record(state.contact)
        self._posterior = as_record(state.posterior)
        self._tip_std_N = state.tip_std_N
        self._read_contact()
        self._read_state()

    def _read_contact(self) -> None:
        """Keep the depth of first contact, which callers want at every sample."""
        is_met = read_field(self._posterior, "in_contact")
        depth_m = float(read_field(self._posterior, "contact_depth_m"))
        self.contact_depth_m = depth_m if is_met else None

    def _read_state(self) -> None:
        """Keep what every sample asks for, and only work on a block changes."""
        self._is_tissue_known = self._learner.state.tissue.is_known
        self._is_pulled = self._watch.is_foreign
        self._is_in_doubt = self._watch.doubt_N > 0.0
        self._warnings = self._watch.warnings

    def first_estimate(self) -> Estimate:
        """Return the estimate before the first sample."""
        sample = Sample()
        return self._estimate(sample, SampleStatus.OK, self._split(sample))

    def use(self, sample: Sample, status: SampleStatus) -> Estimate:
        """Use one sample; return the estimate after it."""
        arm_m_s = sample.speed_m_s
        if self._is_tissue_known:
            sample = self._learner.seen_by_tissue(sample)
        is_full, outputs = update_sample(
            self._posterior,
            self._contact,
            self._reporter.layer_rows,
            sample.depth_m,
            sample.speed_m_s,
            sample.depth_std_m,
            sample.speed_std_m_s,
            arm_m_s,
            sample.force_N,
            sample.force_std_N,
            sample.raw_depth_m,
            sample.raw_speed_m_s,
            sample.dt_s,
        )
        self._reporter.events = {}
        if is_full or self._is_at_work:
            if is_full:
                self._use_block(sample)
            else:
                self._do_next_part(sample)
            self._read_state()
            outputs = self._split(sample)
        return self._estimate(sample, status, outputs)

    def doubt_zero(self, std_N: float, age_s: float) -> None:
        """Take the zero of the force for changed, and ruptures since for unlikely."""
        self._learner.doubt_zero(std_N)
        self._reporter.doubt_ruptures(age_s)

    def _split(self, sample: Sample) -> Outputs:
        """Return what the force of a sample is, by what is known now."""
        outputs = estimate_sample(
            self._posterior,
            self._contact,
            self._reporter.layer_rows,
            sample.depth_m,
            sample.speed_m_s,
            sample.force_N,
        )
        self._tip_std_N = outputs[TIP_STD] or 0.0
        return outputs

    def _estimate(
        self, sample: Sample, status: SampleStatus, outputs: Outputs
    ) -> Estimate:
        """Put the estimate together, its deviations as wide as what is in doubt."""
        reporter = self._reporter
        estimate = Estimate(
            sample.time_s,
            SampleStatus.NEEDLE_PULLED if self._is_pulled else status,
            reporter.state.rupture_state,
            *outputs,
            **reporter.events,
            rupture_probability=reporter.state.rupture_probability,
            warnings=self._warnings,
        )
        return self._watch.widen(estimate) if self._is_in_doubt else estimate

    def _use_block(self, sample: Sample) -> None:
        """Do what is left for the last block, then use the one that is full."""
        while self._is_at_work:  # blocks are of one or two samples
            self._do_next_part(sample)
        self._learn(sample)
        if not self._reporter.state.is_due:
            # The needle does not advance: the next sample has nothing to add.
            self._report(sample)

    def _do_next_part(self, sample: Sample) -> None:
        """Do the next part of what is left to do for the last block."""
        learner = self._learner
        due = self._reporter.state
        if due.is_due:
            self._report(sample)
        elif due.is_layer_due:
            self._reporter.report_layer(sample.force_std_N)
        elif learner.state.is_pruning_due:
            learner.branch_and_prune(due.ruptures, sample.clock_s)
        else:
            shift_depth(self._contact, learner.find_motion(sample.clock_s) / MM_PER_M)

    def _learn(self, sample: Sample) -> None:
        """Let every component predict the force of the block, and learn from it."""
        learner = self._learner
        reporter = self._reporter
        clock_s = sample.clock_s
        is_met = self.contact_depth_m is not None
        means = take_block(self._contact, learner.state.block, clock_s)
        travel = learner.judge_travel(means)
        block = learner.predict(means, travel, clock_s)
        is_cutting = travel.is_advancing or not (is_met or travel.is_gap)
        if not travel.is_gap:
            for age_s in self._watch.watch_force(
                block,
                sample,
                reporter.state.alarm,
                self.contact_depth_m,
                is_advancing=is_cutting,
            ):
                reporter.doubt_fall(age_s, sample.time_s)
        if is_cutting:
            block = self._learn_from(block, means, travel, sample, is_met=is_met)
        else:
            learner.pause(block, travel, reporter.state.ruptures)
        if not is_met:
            reporter.state.force_std_in_air_N = sample.force_std_N
        learner.keep(block, sample.force_std_N)
        if not travel.is_gap:
            is_even = travel.is_advancing and learner.is_settled
            self._watch_tissue(sample, is_met=is_met, is_even=is_even)
            tissue = learner.state.tissue
            learner.state.tissue = tissue.with_block(means, is_met=is_met)

    def _learn_from(
        self,
        block: Block,
        means: Block,
        travel: Travel,
        sample: Sample,
        *,
        is_met: bool,
    ) -> Block:
        """Let noise, texture and mixture learn, unless no tissue exerts the force.

        Returns:
            The block with the noise of its force.
        """
        learner = self._learner
        reporter = self._reporter
        clock_s = sample.clock_s
        pull = self._watch.state.pull
        if pull.is_pulled:
            learner.forget_course()
            if pull.is_foreign:
                # No motion of the tissue can be read there.
                learner.state.tissue = learner.state.tissue.restarted(clock_s)
            return block
        is_layer_open = reporter.is_layer_open
        block = learner.learn_noise(
            block,
            travel,
            means.speed_mm_s,
            clock_s,
            is_met=is_met,
            is_releasing=is_layer_open and not reporter.is_series,
        )
        innovation = learner.correct(block, is_advancing=travel.is_advancing)
        if is_met and not is_layer_open:
            stated_N = max(self._tip_std_N, sample.force_std_N)
            state = self._watch.state
            state.innovations = state.innovations.with_innovation(
                *innovation, block, stated_N
            )
        reporter.state.is_due = True
        return block

    def _watch_tissue(self, sample: Sample, *, is_met: bool, is_even: bool) -> None:
        """Look for tissue that overtakes the needle, and for a hard contact."""
        reporter = self._reporter
        if self._watch.watch_motion(sample, is_met=is_met, is_even=is_even):
            reporter.doubt_layers(sample.time_s)
        contact = self._watch.find_hard_contact(sample, is_even=is_even and is_met)
        if contact is not None:
            reporter.events["hard_contact"] = contact

    def _report(self, sample: Sample) -> None:
        """Report ruptures, and summarise the mixture for the next samples."""
        reporter = self._reporter
        evidence = reporter.report_ruptures(sample)
        if evidence is None:
            return
        update_posterior(
            self._posterior,
            evidence,
            self._learner.state.block,
            reporter.state.ruptures,
            reporter.traversed,
            MM_PER_M * reporter.last_rupture_m_s,
        )
        self._read_contact()
        reporter.learn_contact_std(evidence, is_met=self.contact_depth_m is not None)
