"""What no tissue does, and what no hypothesis explains: watched block by block.

Each watcher has a file of its own: a force that pulls at the needle (`needle_pull`), or
changes while it rests (`rest_force`), tissue that overtakes it (`tissue_pull`), a hard
contact (`hard_contact`), innovations (`innovation_watch`). Here they get what they look
at, and what they find becomes a warning, a wider deviation, or a doubt of ruptures.
"""

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from identification.estimate import (
    HardContact,
    Outputs,
    Rupture,
    Sample,
    TissueWarning,
    widen_forces,
)
from identification.mixture.block import Block
from identification.mixture.evidence import MM_PER_M
from identification.mixture.force_model import TRAVERSED_COULOMB, TRAVERSED_VISCOUS
from identification.mixture.hard_contact import HardContactState
from identification.mixture.innovation_watch import InnovationWatch
from identification.mixture.needle_pull import ONSET_S, NeedlePull, NetForce
from identification.mixture.rest_force import NEVER_AT_REST, HeldForce, RestForce
from identification.mixture.tissue_pull import TissuePull

if TYPE_CHECKING:
    from identification.mixture.learner import Learner


@dataclass(slots=True)
class ForceWatchState:
    """What the watchers remember. Its parts are immutable.

    Attributes:
        pull: Whether the force pulls at the needle.
        rest_force: Whether it changes at a needle that rests.
        tissue_pull: Whether tissue that moves has pulled at the needle.
        hard_contact: What a hard contact is found by.
        innovations: What they have shown.
    """

    pull: NeedlePull = field(default_factory=NeedlePull)
    rest_force: RestForce = NEVER_AT_REST
    tissue_pull: TissuePull = field(default_factory=TissuePull)
    hard_contact: HardContactState = field(default_factory=HardContactState)
    innovations: InnovationWatch = field(default_factory=InnovationWatch)


class ForceWatch:
    """Watches the force of every block beside the mixture.

    Attributes:
        state: What the watchers remember.
    """

    def __init__(
        self, learner: "Learner", state: ForceWatchState, hard_contact_N_per_m: float
    ) -> None:
        self.state = replace(state)
        self._learner = learner
        self._hard_contact_N_per_mm = hard_contact_N_per_m / MM_PER_M

    @property
    def is_foreign(self) -> bool:
        """Whether no tissue exerts the force, not even one that moves."""
        return self.state.pull.is_foreign or self.state.rest_force.is_foreign

    @property
    def is_tissue_moving(self) -> bool:
        """Whether tissue overtakes the needle of late."""
        return self.state.tissue_pull.is_moving(self._learner.state.block.time_s)

    @property
    def unexplained_N(self) -> float:
        """Force that no hypothesis explains of late, as a deviation."""
        return self.state.innovations.doubt_at(self._learner.state.block.time_s)

    @property
    def doubt_N(self) -> float:
        """What moving tissue, a swing and innovations put in doubt, as a deviation."""
        return math.hypot(
            self.state.tissue_pull.doubt_N,
            self._learner.state.block.swing_std_N,
            self.unexplained_N,
        )

    @property
    def warnings(self) -> TissueWarning:
        """What about the tissue keeps the estimate from being what it is elsewhere."""
        warnings = TissueWarning.NONE
        if self.is_tissue_moving:
            warnings |= TissueWarning.TISSUE_MOVES
        if self.state.hard_contact.is_hard:
            warnings |= TissueWarning.HARD_CONTACT
        if self.unexplained_N > 0.0:
            warnings |= TissueWarning.UNEXPLAINED
        return warnings

    def widen(self, outputs: Outputs) -> Outputs:
        """Return outputs with what moving tissue, a swing and innovations put in doubt.

        In a swing tip force and friction go up and down about their means.
        """
        unexplained_N = self.unexplained_N
        if unexplained_N > 0.0:
            outputs = widen_forces(outputs, unexplained_N)
        if self.state.tissue_pull.doubt_N > 0.0:
            outputs = self.state.tissue_pull.widen(outputs)
        swing_std_N = self._learner.state.block.swing_std_N
        if swing_std_N > 0.0:
            outputs = widen_forces(outputs, swing_std_N)
        return outputs

    def watch_force(
        self,
        block: Block,
        sample: Sample,
        alarm: Rupture | None,
        contact_m: float | None,
        *,
        is_advancing: bool,
    ) -> list[float]:
        """Judge whether tissue exerts the force of a block, once it is predicted.

        What has pulled for long is a new zero.

        Returns:
            Times before the sample since when ruptures are less likely than none [s]:
            those of a fall that no tissue makes, and an alarm whose fall is undone.
        """
        doubted_s: list[float] = []
        net_N = block.force_N - self._learner.zero_N
        old_pull = self.state.pull
        force = self._net_force(
            block, sample, net_N, contact_m, is_advancing=is_advancing
        )
        pull = old_pull.with_force(force)
        if pull.is_pulled and not old_pull.is_pulled:
            doubted_s.append(block.time_s - pull.peak_s + ONSET_S)
        elif alarm is not None and self._is_undone(
            alarm, sample, old_pull.recent_N, net_N
        ):
            pull = pull._replace(is_foreign=True)
            doubted_s.append(sample.time_s - alarm.time_s + ONSET_S)
        if pull.is_new_zero(block.time_s):
            self._learner.doubt_zero(pull.fall_N)
            pull = pull.restarted()
        self.state.pull = pull
        if is_advancing:
            self.state.rest_force = NEVER_AT_REST
        elif contact_m is not None:
            is_doubtful = self._watch_rest(block, sample, alarm, net_N)
            if alarm is not None and is_doubtful:
                doubted_s.append(sample.time_s - alarm.time_s + ONSET_S)
        return doubted_s

    def _is_undone(
        self, alarm: Rupture, sample: Sample, recent_N: float, net_N: float
    ) -> bool:
        """Return whether a force that fell below zero at the last alarm jumps back.

        A rupture leaves friction, and what it has released does not come back at once:
        a hand has let go.
        """
        max_age_s = 3.0  # of the alarm
        jump_back_fraction = 0.5  # of the fall, at least
        if recent_N >= 0.0 or sample.time_s - alarm.alarm_s > max_age_s:
            return False
        fall_N = alarm.force_N - self._learner.zero_N - recent_N
        return net_N - recent_N > jump_back_fraction * fall_N > 0.0

    def _net_force(
        self,
        block: Block,
        sample: Sample,
        net_N: float,
        contact_m: float | None,
        *,
        is_advancing: bool,
    ) -> NetForce:
        """Return the force of a block without its zero, and how it was come by."""
        # In front of the first contact by so much a needle is out of the tissue: its
        # surface was pushed in, and is known that well.
        outside_mm = 2.0
        learner = self._learner
        variance_N2 = (
            learner.zero_variance_N2
            + block.noise_std_N**2
            + sample.force_std_N**2
            + block.motion_variance_N2
        )
        return NetForce(
            value_N=net_N,
            std_N=math.sqrt(variance_N2),
            time_s=block.time_s,
            duration_s=block.duration_s,
            is_advancing=is_advancing,
            behind_mm=learner.state.deepest_mm - block.depth_mm,
            is_met=contact_m is not None,
            is_outside=contact_m is not None
            and block.depth_mm < MM_PER_M * contact_m - outside_mm,
            friction_N=self._least_friction_N(block),
        )

    def _least_friction_N(self, block: Block) -> float:
        """Return the least friction of the layers traversed, at the present speed."""
        sigmas = 2.0  # by which the friction that remains may be below that known
        min_fraction = 0.5  # of that remains at least: its model errs by so much
        store = self._learner.memory.store
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
        return min_fraction * max(float(friction_N) - sigmas * std_N, 0.0)

    def _watch_rest(
        self, block: Block, sample: Sample, alarm: Rupture | None, net_N: float
    ) -> bool:
        """Judge whether the force on a needle at rest only relaxes.

        Returns:
            Whether the fall of the last alarm goes on at rest, or is undone there.
        """
        # A needle that comes to rest so soon after an alarm was stopped by it.
        stopped_s = 1.0
        # Part of a fall whose return at rest shows that it was no rupture
        undone_fraction = 0.3
        old = self.state.rest_force
        alarm_age_s = math.inf if alarm is None else sample.time_s - alarm.alarm_s
        new = old.with_force(
            HeldForce(
                net_N,
                block.noise_std_N,
                sample.force_std_N,
                block.depth_mm,
                block.depth_std_mm,
                block.duration_s,
                has_ruptured=alarm_age_s - old.rest_s < stopped_s,
            )
        )
        self.state.rest_force = new
        if alarm is None or old.is_foreign or not new.is_foreign:
            return False
        zero_N = block.force_N - net_N
        fall_N = alarm.force_N - zero_N - new.mean_N
        return new.falls_on or new.change_N > undone_fraction * fall_N > 0.0

    def watch_innovation(
        self, innovation_N: float, variance_N2: float, block: Block, stated_N: float
    ) -> None:
        """Look for a force in tissue that no hypothesis explains.

        Args:
            innovation_N: By what the block's force differed from the prediction.
            variance_N2: That was predicted of it.
            block: The block.
            stated_N: Deviation that is stated for the force at the tip, or for the
                force itself if that is more.
        """
        self.state.innovations = self.state.innovations.with_innovation(
            innovation_N, variance_N2, block.time_s, block.duration_s, stated_N
        )

    def watch_motion(self, sample: Sample, *, is_met: bool, is_even: bool) -> bool:
        """Look with the last block for tissue that overtakes the needle.

        `is_even`: the needle has advanced evenly.

        Returns:
            Whether more of the force is in doubt than before.
        """
        # Presliding deflection from which on all of the shaft slides inwards
        min_sliding_deflection = 0.9
        learner = self._learner
        block = learner.state.block
        variance_N2 = (
            learner.state.levels.variances.white
            + sample.force_std_N**2
            + block.motion_variance_N2
        )
        levels = learner.state.levels.beside(learner.state.tissue, block.time_s)
        old = self.state.tissue_pull
        new = old.with_zero(
            learner.zero_N, learner.zero_variance_N2, is_met=is_met
        ).with_force(
            block,
            variance_N2,
            learner.state.tissue.amplitude_mm,
            levels.variances.breathing,
            is_sliding=is_even
            and block.deflection > min_sliding_deflection
            and not self.state.pull.is_foreign,
        )
        self.state.tissue_pull = new
        return new.doubt_N > old.doubt_N

    def find_hard_contact(self, sample: Sample, *, is_even: bool) -> HardContact | None:
        """Return the hard contact that the last block shows, if it is new."""
        block = self._learner.state.block
        contact = self.state.hard_contact.with_force(
            block,
            block.force_N - self._learner.zero_N,
            self._hard_contact_N_per_mm,
            is_even=is_even and not self.is_tissue_moving,
        )
        self.state.hard_contact = contact
        if not contact.is_new:
            return None
        return HardContact(
            alarm_s=sample.time_s,
            depth_m=sample.depth_m,
            force_N=block.force_N,
            growth_N_per_m=MM_PER_M * contact.growth_N_per_mm,
        )
