"""What no tissue does, and what no hypothesis explains: watched block by block.

A force that pulls at the needle, or changes while it rests, is in `foreign_force`;
tissue that overtakes it, a hard contact and innovations are in `tissue_doubt`. Here
they get what they look at, and what they find becomes a warning, a wider deviation, or
a doubt of ruptures.
"""

import math
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

from identification.estimate import (
    Estimate,
    HardContact,
    Rupture,
    Sample,
    TissueWarning,
)
from identification.mixture.block import MM_PER_M, Block
from identification.mixture.force_model import TRAVERSED_COULOMB, TRAVERSED_VISCOUS
from identification.mixture.foreign_force import (
    ONSET_S,
    NeedlePull,
    NetForce,
    RestForce,
)
from identification.mixture.needle_stop import SLIDING_DEFLECTION
from identification.mixture.tissue_doubt import (
    HardContactState,
    InnovationWatch,
    TissuePull,
)

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
    rest_force: RestForce = field(default_factory=RestForce)
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

    def widen(self, estimate: Estimate) -> Estimate:
        """Return an estimate with what is in doubt in its deviations.

        In a swing tip force and friction go up and down about their means. Where tissue
        moves, neither friction nor stiffness counts as identified.
        """
        doubt_N = self.doubt_N
        is_moving = self.state.tissue_pull.doubt_N > 0.0
        return estimate._replace(
            enhanced_force_std_N=math.hypot(
                estimate.enhanced_force_std_N or 0.0, doubt_N
            ),
            tip_force_std_N=math.hypot(estimate.tip_force_std_N or 0.0, doubt_N),
            shaft_friction_std_N=math.hypot(
                estimate.shaft_friction_std_N or 0.0, doubt_N
            ),
            stiffness_identified=estimate.stiffness_identified and not is_moving,
            friction_identified=estimate.friction_identified and not is_moving,
        )

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
        old = self.state.pull
        force = self._net_force(
            block, sample, net_N, contact_m, is_advancing=is_advancing
        )
        pull = old.with_force(force)
        alarm_age_s = math.inf if alarm is None else sample.time_s - alarm.time_s
        if pull.is_pulled and not old.is_pulled:
            doubted_s.append(block.time_s - pull.peak_s + ONSET_S)
        elif alarm is not None and self._is_undone(alarm, sample, old.recent_N, net_N):
            pull = pull._replace(is_foreign=True)
            doubted_s.append(alarm_age_s + ONSET_S)
        if pull.is_new_zero(block.time_s):
            self._learner.doubt_zero(pull.peak_N - pull.low_N)
            pull = NeedlePull(highest_N=pull.highest_N)
        self.state.pull = pull
        if is_advancing:
            self.state.rest_force = RestForce()
        elif contact_m is not None and self._watch_rest(block, sample, alarm, net_N):
            doubted_s.append(alarm_age_s + ONSET_S)
        return doubted_s

    def _is_undone(
        self, alarm: Rupture, sample: Sample, recent_N: float, net_N: float
    ) -> bool:
        """Return whether a force that fell below zero at the last alarm jumps back.

        A rupture leaves friction, and what it has released does not come back at once:
        a hand has let go.
        """
        if recent_N >= 0.0 or sample.time_s - alarm.alarm_s > 3.0:
            return False
        fall_N = alarm.force_N - self._learner.zero_N - recent_N
        return net_N - recent_N > 0.5 * fall_N > 0.0

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
        """Return the least friction of the layers traversed, at the present speed.

        Half of it remains at least: its model errs by so much.
        """
        store = self._learner.memory.store
        coulomb_and_viscous = slice(TRAVERSED_COULOMB, TRAVERSED_VISCOUS + 1)
        speed = max(block.speed_mm_s, 0.0)
        coulomb, viscous = store.means[0, coulomb_and_viscous].tolist()
        (coulomb_N2, cross_N2), (_, viscous_N2) = store.covariances[
            0, coulomb_and_viscous, coulomb_and_viscous
        ].tolist()
        variance_N2 = coulomb_N2 + 2.0 * speed * cross_N2 + speed**2 * viscous_N2
        std_N = math.sqrt(max(variance_N2, 0.0))
        return 0.5 * max(coulomb + speed * viscous - 2.0 * std_N, 0.0)

    def _watch_rest(
        self, block: Block, sample: Sample, alarm: Rupture | None, net_N: float
    ) -> bool:
        """Judge whether the force on a needle at rest only relaxes.

        Returns:
            Whether the fall of the last alarm goes on at rest, or is undone there.
        """
        old = self.state.rest_force
        alarm_age_s = math.inf if alarm is None else sample.time_s - alarm.alarm_s
        # A needle that comes to rest so soon after an alarm was stopped by it.
        has_ruptured = alarm_age_s - old.rest_s < 1.0
        new = old.with_force(
            block, net_N, sample.force_std_N, has_ruptured=has_ruptured
        )
        self.state.rest_force = new
        if alarm is None or old.is_foreign or not new.is_foreign:
            return False
        # A third of a fall that comes back at rest shows that it was no rupture.
        fall_N = alarm.force_N - self._learner.zero_N - new.mean_N
        return new.falls_on or new.change_N > 0.3 * fall_N > 0.0

    def watch_motion(self, sample: Sample, *, is_met: bool, is_even: bool) -> bool:
        """Look with the last block for tissue that overtakes the needle.

        `is_even`: the needle has advanced evenly.

        Returns:
            Whether more of the force is in doubt than before.
        """
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
            and block.deflection > SLIDING_DEFLECTION
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
