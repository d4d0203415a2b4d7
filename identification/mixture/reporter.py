"""What is reported: alarms raised and retracted, layers, and when they are final.

The mixture's hypotheses become reports here: how likely one more rupture is, an alarm
or a provisional one, its retraction; a layer a millimetre after the rupture that ended
it, revised from then on, and final some millimetres later. `evidence` says how
likely a rupture is and whether braking explains it, `layer_report` makes the records.
The forces of every sample are left to `force_split`.
"""

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from foundation.arrays import WrittenMatrix
from foundation.records import read_column
from identification.config import MixtureConfig
from identification.estimate import (
    LayerEstimate,
    Rupture,
    RuptureState,
    Sample,
)
from identification.mixture.block import MM_PER_M
from identification.mixture.evidence import (
    Evidence,
    RuptureCount,
    count_recent_in_full,
    count_ruptures,
    may_be_braking,
    weigh_evidence,
)
from identification.mixture.layer_report import (
    contact_std_mm,
    friction_of_layer,
    report_layer,
    report_rupture,
    with_doubt,
    with_friction,
)
from identification.mixture.mixture import SMALL_RELEASE_PENALTY, Mixture
from identification.mixture.tissue_doubt import REMEMBERED_S

if TYPE_CHECKING:
    from identification.mixture.force_watch import ForceWatch
    from identification.mixture.learner import Learner


@dataclass(slots=True)
class ReporterState:
    """What has been reported, and what is due. Its parts are immutable.

    Attributes:
        is_due: Whether ruptures are to be reported.
        is_layer_due: Whether the layer traversed is to be reported.
        ruptures: In the components that the last report followed.
        alarm: The last one raised and not retracted.
        provisional: The provisional alarm that is neither confirmed nor retracted.
        rupture_probability: Of one rupture more than were reported.
        rupture_state: What is reported.
        layers: Those traversed.
        contact_std_mm: Standard deviation of the depth of first contact, the largest
            until the first rupture.
        force_std_in_air_N: Of the force's slow error before the contact.
        model_errors_N: Largest `Block.model_error_N` since the last layer, and the one
            before, were reported.
    """

    is_due: bool = False
    is_layer_due: bool = False
    ruptures: int = 0
    alarm: Rupture | None = None
    provisional: Rupture | None = None
    rupture_probability: float = 0.0
    rupture_state: RuptureState = RuptureState.NO_RUPTURE
    layers: tuple[LayerEstimate, ...] = ()
    contact_std_mm: float = 0.0
    force_std_in_air_N: float = 0.0
    model_errors_N: tuple[float, float] = (0.0, 0.0)


class Reporter:
    """Turns what the mixture says into alarms and layers.

    Attributes:
        state: What has been reported, and what is due.
        events: What happened at the last sample.
        layer_rows: Layers traversed, as `force_split.split_force` takes them.
    """

    def __init__(
        self,
        learner: "Learner",
        watch: "ForceWatch",
        state: ReporterState,
        config: MixtureConfig,
    ) -> None:
        self.state = replace(state)
        self.events: dict[str, Any] = {}
        self._learner = learner
        self._watch = watch
        self._config = config
        self._keep_layers(state.layers)

    @property
    def is_layer_open(self) -> bool:
        """Whether the layer of the last alarm is not among the layers yet."""
        alarm = self.state.alarm
        return alarm is not None and self._listed < alarm.layer

    @property
    def traversed(self) -> int:
        """Layers traversed, that of the last alarm included."""
        return self._listed + self.is_layer_open

    @property
    def last_rupture_m_s(self) -> float:
        """Speed at the last rupture reported; 0 before the first."""
        rupture = self.state.alarm
        if rupture is None and self.state.layers:
            rupture = self.state.layers[-1].rupture
        return 0.0 if rupture is None else rupture.speed_m_s

    @property
    def is_series(self) -> bool:
        """Whether the last alarm came so soon that a heart may have raised both."""
        alarm = self.state.alarm
        return alarm is not None and any(
            alarm.time_s - layer.rupture.time_s < 1.5  # 40 beats a minute
            for layer in self.state.layers
            if layer.layer < alarm.layer
        )

    @property
    def _listed(self) -> int:
        """How many layers were listed, those no longer kept included."""
        return self.state.layers[-1].layer if self.state.layers else 0

    def _keep_layers(self, layers: tuple[LayerEstimate, ...]) -> None:
        """Take these layers for those traversed, with what every sample needs."""
        self.state.layers = layers
        self.layer_rows: WrittenMatrix = np.zeros((len(layers), 4))
        for row, layer in zip(self.layer_rows, layers, strict=True):
            coulomb_N = (layer.coulomb_N_per_m or 0.0) * layer.thickness_m
            coulomb_N = min(coulomb_N, layer.friction_N)
            speed = max(MM_PER_M * layer.rupture.speed_m_s, 1e-3)
            viscous = (layer.friction_N - coulomb_N) / speed
            row[:] = (layer.start_depth_m, layer.thickness_m, coulomb_N, viscous)

    def doubt_ruptures(self, age_s: float, most: float = math.inf) -> None:
        """Count no ruptures of the last time, and take them for unlikely.

        A component may count several ruptures of that time; it knows that of the last.
        At most so many remain in the components that change.
        """
        mixture = self._learner.memory.mixture
        rupture_s = read_column(mixture.history, "rupture_s")
        ruptures = read_column(mixture.assumptions, "ruptures")
        begin_s = self._learner.state.block.time_s - age_s
        is_recent = (rupture_s > begin_s) & (ruptures > 0.0)
        mixture.log_weights[is_recent] -= SMALL_RELEASE_PENALTY
        ruptures[is_recent] = np.minimum(ruptures[is_recent] - 1.0, most)
        self.state.is_due = True

    def doubt_fall(self, age_s: float, time_s: float) -> None:
        """Take ruptures of a fall for less likely than none, that of an alarm too."""
        alarm = self.state.alarm
        is_alarm = alarm is not None and time_s - alarm.time_s < age_s
        self.doubt_ruptures(age_s, self.state.ruptures - is_alarm)

    def doubt_layers(self, time_s: float) -> None:
        """Take back that layers are final whose ruptures motion may have made."""
        doubt_N = self._watch.state.tissue_pull.doubt_N
        self._keep_layers(
            tuple(
                with_doubt(layer, doubt_N)
                if time_s - layer.rupture.alarm_s < REMEMBERED_S
                else layer
                for layer in self.state.layers
            )
        )

    def report_ruptures(self, sample: Sample) -> Evidence | None:
        """Raise or retract an alarm.

        Returns:
            What the mixture says after that; None where an alarm was raised: the next
            sample has to report again, this one has had enough to do.
        """
        state = self.state
        alarm = state.alarm
        evidence = weigh_evidence(self._learner.memory.mixture, alarm, state.ruptures)
        learnt = self._learner.state
        levels = learnt.levels.beside(learnt.tissue, learnt.block.time_s)
        recent = count_recent_in_full(evidence, levels.variances.noise_fraction)
        count = count_ruptures(recent, state.ruptures, learnt.block)
        state.is_due = False
        state.rupture_probability = min(count.more, 1.0)
        state.rupture_state = (
            RuptureState.FORCE_DROP_MEASURING
            if self.is_layer_open
            else RuptureState.EXPECTED
            if count.more > 0.5
            else RuptureState.NO_RUPTURE
        )
        if self._is_rupture(evidence, count, sample.clock_s):
            self._raise_alarm(evidence, sample, count)
            state.is_due = True
            return None
        if alarm is not None and count.fewer > 0.9:  # chosen
            self._retract(alarm, count)
        elif alarm is not None and "rupture" not in self.events:
            state.is_layer_due = state.is_layer_due or self._is_layer_report_due(alarm)
        self._report_provisional(evidence, sample, count)
        return evidence

    def learn_contact_std(self, evidence: Evidence, *, is_met: bool) -> None:
        """Keep how well the depth of first contact was known, the worst since then.

        Farther on components tell it apart by errors of the force model alone.
        """
        if not is_met:
            self.state.contact_std_mm = 0.0
        elif self.state.ruptures == 0:
            std_mm = contact_std_mm(evidence, self._learner.state.block)
            self.state.contact_std_mm = max(self.state.contact_std_mm, std_mm)

    def _is_rupture(
        self, evidence: Evidence, count: RuptureCount, since_reset_s: float
    ) -> bool:
        """Return whether to raise an alarm."""
        component = count.likeliest_with_more
        may_pull = self._watch.state.pull.may_pull
        if count.more <= self._config.alarm_probability or may_pull:
            return False
        mixture = evidence.mixture
        learnt = self._learner.state
        return self._has_settled(mixture, component) and not may_be_braking(
            mixture, component, learnt.block, since_reset_s, learnt.tissue
        )

    def _has_settled(self, mixture: Mixture, component: int) -> bool:
        """Return whether friction is back, or went on, since a component's rupture."""
        rupture_mm = read_column(mixture.history, "rupture_mm")[component]
        return self._learner.has_settled_since(float(rupture_mm))

    def _raise_alarm(
        self, evidence: Evidence, sample: Sample, count: RuptureCount
    ) -> None:
        """Report a rupture, and with it the layer before as final."""
        state = self.state
        layers = state.layers
        identified_layer = self.events.get("identified_layer")
        is_moving = self._watch.is_tissue_moving
        if layers and not (layers[-1].is_final or is_moving):
            identified_layer = replace(layers[-1], is_final=True)
            self._keep_layers((*layers[:-1], identified_layer))
        state.alarm = report_rupture(
            evidence,
            count.likeliest_with_more,
            self._listed + 1,
            count.more,
            sample,
            state.contact_std_mm,
        )
        state.ruptures = int(evidence.ruptures[count.likeliest_with_more])
        state.model_errors_N = (0.0, state.model_errors_N[0])
        state.provisional = None
        state.rupture_state = RuptureState.DETECTED
        self.events = {"rupture": state.alarm, "identified_layer": identified_layer}
        watched = self._watch.state
        watched.innovations = watched.innovations.restarted()
        # Every beat may raise an alarm until it is known: then the window has to grow
        # across them.
        learnt = self._learner.state
        if not self.is_series or learnt.tissue.is_known:
            learnt.tissue = learnt.tissue.restarted(sample.clock_s)

    def _report_provisional(
        self, evidence: Evidence, sample: Sample, count: RuptureCount
    ) -> None:
        """Raise a provisional alarm, or retract the one raised.

        Unlike an alarm it does not wait until the speed shows whether the needle
        brakes, nor whether a low force will pull.
        """
        state = self.state
        if state.provisional is not None:
            if count.more < 0.5:
                retracted = replace(state.provisional, probability=count.more)
                self.events["provisional_retracted"] = retracted
                state.provisional = None
            return
        component = count.likeliest_with_more
        if count.more <= self._config.provisional_probability or not self._has_settled(
            evidence.mixture, component
        ):
            return
        state.provisional = report_rupture(
            evidence,
            component,
            self.traversed + 1,
            count.more,
            sample,
            state.contact_std_mm,
        )
        self.events["provisional"] = state.provisional

    def _retract(self, alarm: Rupture, count: RuptureCount) -> None:
        """Retract an alarm: the force has come back, and no rupture was there."""
        state = self.state
        self.events["retracted"] = replace(alarm, probability=1.0 - count.fewer)
        self._keep_layers(state.layers if self.is_layer_open else state.layers[:-1])
        state.ruptures = min(count.likeliest, state.ruptures - 1)
        before_N = state.model_errors_N[1]
        state.model_errors_N = (before_N, before_N)
        state.alarm = None

    def _travel_since(self, alarm: Rupture) -> float:
        """Return the travel since a rupture [m]."""
        return self._learner.state.block.depth_mm / MM_PER_M - alarm.depth_m

    def _is_layer_final(self, alarm: Rupture) -> bool:
        """Return whether the last layer is final now, so far behind its rupture."""
        if self._watch.is_tissue_moving or self.is_layer_open:
            return False
        is_far = not 0.0 <= self._travel_since(alarm) < 3e-3
        return is_far and not self.state.layers[-1].is_final

    def _is_layer_report_due(self, alarm: Rupture) -> bool:
        """Return whether the last layer is reported or revised now."""
        if self.is_layer_open:
            return self._travel_since(alarm) >= 1e-3
        block = self._learner.state.block
        is_revised = block.time_s % 0.1 < block.duration_s  # ten times a second
        return is_revised or self._is_layer_final(alarm)

    def report_layer(self, force_std_N: float) -> None:
        """Report the layer that the last rupture ended, or revise it."""
        state = self.state
        state.is_layer_due = False
        alarm = state.alarm
        if alarm is None:
            return
        evidence = weigh_evidence(self._learner.memory.mixture, alarm, state.ruptures)
        # What the force's slow error grew by since the air is in the friction, and the
        # force model's: its largest, since what a later tissue shows of it is not that
        # of the layer.
        grown_N2 = max(force_std_N**2 - state.force_std_in_air_N**2, 0.0)
        block = self._learner.state.block
        last_N, before_N = (max(n, block.model_error_N) for n in state.model_errors_N)
        state.model_errors_N = (last_N, before_N)
        common_N2 = grown_N2 + self._watch.doubt_N**2
        variance_N2 = common_N2 + last_N**2
        if not self.is_layer_open:
            self._revise_layers(alarm, evidence, variance_N2, common_N2 + before_N**2)
            return
        layer = report_layer(evidence, alarm, state.ruptures, variance_N2, block)
        if layer is not None:
            doubt_N = self._watch.state.tissue_pull.doubt_N
            layer = with_doubt(layer, doubt_N) if doubt_N > 0.0 else layer
            self._keep_layers((*state.layers, layer))
            self.events["identified_layer"] = layer
            state.rupture_state = RuptureState.FRICTION_IDENTIFIED

    def _revise_layers(
        self,
        alarm: Rupture,
        evidence: Evidence,
        variance_N2: float,
        variance_before_N2: float,
    ) -> None:
        """Revise the last two layers, and report the last one once it is final."""
        ruptures = self.state.ruptures
        layers = list(self.state.layers)
        is_final = self._is_layer_final(alarm)
        last = friction_of_layer(evidence, ruptures, variance_N2, is_last=True)
        if last is not None:
            layers[-1] = with_friction(layers[-1], *last)
        if is_final:
            rupture = replace(layers[-1].rupture, is_final=True)
            layers[-1] = replace(layers[-1], is_final=True, rupture=rupture)
            self.events["identified_layer"] = layers[-1]
        before = friction_of_layer(
            evidence, ruptures, variance_before_N2, is_last=False
        )
        if before is not None and len(layers) > 1:
            layers[-2] = with_friction(layers[-2], *before)
        self._keep_layers(tuple(layers))
