"""What an identifier reports: per sample, per rupture and per layer.

Clock and depth zero are the caller's. Every ``*_s`` here is on the clock of
`Identifier.update`: its argument ``time_s`` where the caller passes one, else the sum
of the ``dt_s`` since the reset. Every depth counts from the zero of the caller's
``depth_m``; `Rupture.contact_depth_m` is the depth of the first contact with tissue
from the same zero, so that a travel in tissue is a difference of the two.
"""

from dataclasses import dataclass
from enum import Enum, IntFlag
from typing import NamedTuple


class SampleStatus(Enum):
    """What became of a sample. Only `OK` and `TIME_GAP` samples are used."""

    OK = "ok"
    TIME_GAP = "gap in time: local predictions restart"
    NOT_A_SCALAR = "not a scalar: depth, speed, force and dt must be single numbers"
    NOT_FINITE = "not finite"
    TIME_NOT_FORWARD = "dt must be positive"
    DEPTH_JUMP = "depth jumped against its speed: the jump is removed"
    SPEED_SIGN = "speed has the sign opposite to the change of depth"
    FORCE_RANGE = "force beyond any needle's: check the unit"
    TIME_RANGE = "dt must be between 1e-12 and 1e6 s: check the unit"
    MOTION_RANGE = "depth or speed beyond any needle's: check the unit"
    NEEDLE_PULLED = (
        "no tissue exerts this force, far below zero or changed at rest: a fault of "
        "the sensor, or a push at the hub"
    )

    @property
    def is_used(self) -> bool:
        """Whether the sample went into the estimate."""
        return self is SampleStatus.OK or self is SampleStatus.TIME_GAP


class TissueWarning(IntFlag):
    """What about the tissue keeps an estimate from being what it is elsewhere.

    As text it is the names of what it holds.
    """

    def __str__(self) -> str:
        names = [str(warning.name).lower().replace("_", " ") for warning in self]
        return ", ".join(names) or "none"

    NONE = 0
    TISSUE_MOVES = 1
    """Tissue overtakes the needle, as with free breathing: ruptures are doubtful, no
    layer becomes final, and standard deviations hold half of the swing of the force."""
    HARD_CONTACT = 2
    """The tip is at something harder than soft tissue, such as bone: the force has
    grown faster per travel than `MixtureConfig.hard_contact_N_per_m`."""
    UNEXPLAINED = 4
    """No hypothesis explains the force: it differs from what all predict by more than
    the deviation stated for the tip's force. The cause has no name; deviations hold
    what is seen of it."""


class RuptureState(Enum):
    """Stage with respect to a rupture, as in the authors' framework."""

    NO_RUPTURE = "no rupture"
    EXPECTED = "expected"
    DETECTED = "detected"
    FORCE_DROP_MEASURING = "force drop measuring"
    FRICTION_IDENTIFIED = "friction identified"


@dataclass(frozen=True, slots=True, kw_only=True)
class Rupture:
    """The tip leaves a layer. Raised at the alarm; a false one is retracted later.

    Attributes:
        layer: Number of the layer that ends, from 1.
        alarm_s: Time of the sample that raised the alarm.
        alarm_depth_m: Depth at the alarm.
        time_s: Estimated instant t_r, not later than the alarm.
        depth_m: Depth at that instant.
        force_N: Axial force at that instant.
        speed_m_s: Speed at that instant.
        probability: That the tissue ruptured there and it is no chance of the signal, 0
            to 1; of a retracted one, what is left of it.
        is_final: Whether it is settled: while False it may still be retracted.
        contact_depth_m: Depth of first contact: found by the mixture, known
            beforehand in `published`.
        contact_depth_std_m: Standard deviation of that depth, None in `published`.
    """

    layer: int
    alarm_s: float
    alarm_depth_m: float
    time_s: float
    depth_m: float
    force_N: float
    speed_m_s: float
    probability: float
    is_final: bool = False
    contact_depth_m: float
    contact_depth_std_m: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerEstimate:
    """A layer that has been traversed, as known now.

    The mixture reports a layer twice: provisionally, a millimetre after its
    rupture, and finally, some millimetres later. The values are those at the rupture's
    speed. Standard deviations are None where the method states none (`published`).

    Attributes:
        layer: Number from 1.
        is_final: Whether the measurement of its rupture has ended: False in a
            provisional estimate, which a final one follows unless the alarm is
            retracted. `Identifier.layers` goes on refining final estimates with what
            later layers reveal about their friction.
        start_depth_m: Depth at which it begins.
        thickness_m: d_i, travel from there to its rupture.
        end_depth_std_m: Standard deviation of the depth at which it ends, from the
            caller's zero; below the first contact the deviation of that adds to it.
        rupture: How it ended.
        force_drop_N: Elastic force released.
        force_drop_std_N: Standard deviation of the force drop.
        stiffness_N_per_m: K_i.
        stiffness_std_N_per_m: Standard deviation of K_i.
        stiffness_identified: Whether the data determine K_i.
        friction_Ns_per_m2: B_i (for `kv` in Ns/m).
        friction_std_Ns_per_m2: Standard deviation of B_i.
        friction_identified: Whether the data determine B_i.
        friction_N: Friction of this layer on the shaft at its rupture, B_i d_i v.
        friction_std_N: Standard deviation of that friction.
        coulomb_N_per_m: Part of the friction that does not depend on speed, per
            embedded length; None for `published`, which knows viscous friction only.
        coulomb_std_N_per_m: Standard deviation of the Coulomb part.
        coulomb_identified: Whether the motion separated it from the viscous part.
        viscous_Ns_per_m2: Part of the friction in proportion to the speed, per embedded
            length; None for `published`.
        viscous_std_Ns_per_m2: Standard deviation of the viscous part.
        viscous_identified: Whether the motion separated it from the Coulomb part.
    """

    layer: int
    is_final: bool
    start_depth_m: float
    thickness_m: float
    end_depth_std_m: float | None = None
    rupture: Rupture
    force_drop_N: float
    force_drop_std_N: float | None = None
    stiffness_N_per_m: float
    stiffness_std_N_per_m: float | None = None
    stiffness_identified: bool
    friction_Ns_per_m2: float
    friction_std_Ns_per_m2: float | None = None
    friction_identified: bool
    friction_N: float
    friction_std_N: float | None = None
    coulomb_N_per_m: float | None = None
    coulomb_std_N_per_m: float | None = None
    coulomb_identified: bool = False
    viscous_Ns_per_m2: float | None = None
    viscous_std_Ns_per_m2: float | None = None
    viscous_identified: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class HardContact:
    """The tip meets something harder than soft tissue, such as bone.

    Attributes:
        alarm_s: Time of the sample that showed it.
        depth_m: Depth of the tip at that sample.
        force_N: Axial force at that sample.
        growth_N_per_m: Growth of the force per travel before it.
    """

    alarm_s: float
    depth_m: float
    force_N: float
    growth_N_per_m: float


class Estimate(NamedTuple):
    """State of knowledge after one sample. Every number is finite.

    A named tuple, unlike the others: it is made anew at every sample, and a frozen
    dataclass of as many fields takes ten times as long. Change a field with
    ``_replace``.

    Standard deviations are None where the method states none (`published`).

    Attributes:
        time_s: Time of the sample on the caller's clock.
        status: What became of the sample; anything but `OK` and `TIME_GAP` was not
            used.
        rupture_state: State of the rupture machine.
        in_contact: Whether the needle has met the first layer (and not lost contact
            again).
        layer: Number of the layer the tip is in, from 1; 0 in free air in front of the
            tissue.
        enhanced_force_N: Axial force less the friction of the layers already traversed.
        enhanced_force_std_N: Its standard deviation, the noise of the force included.
        tip_force_N: Axial force less all friction of the shaft; in tissue never
            negative.
        tip_force_std_N: Its standard deviation, the noise of the force included.
        shaft_friction_N: All shaft friction; opposes motion, negative during
            withdrawal.
        shaft_friction_std_N: Its standard deviation.
        predicted_force_N: Axial force the model expected at this sample.
        stiffness_N_per_m: K of the current layer.
        stiffness_std_N_per_m: Its standard deviation.
        stiffness_identified: Whether the data determine K.
        friction_Ns_per_m2: B of the current layer, at the present speed (for `kv` in
            Ns/m).
        friction_std_Ns_per_m2: Its standard deviation.
        friction_identified: Whether the data determine B.
        cumulative_friction_Ns_per_m: Sum of B_j d_j over the traversed layers, at the
            speed of their ruptures.
        cumulative_friction_std_Ns_per_m: Its standard deviation.
        rupture: The rupture raised by this sample, or None.
        identified_layer: The layer whose friction was identified at this sample,
            provisionally or finally (see `LayerEstimate.is_final`), or None.
        retracted: The rupture, raised before, that this sample showed to be a false
            alarm (the force came back; its layer goes on and is not listed), or None.
        provisional: The provisional alarm raised by this sample, or None. `rupture` in
            a later sample confirms it, `provisional_retracted` retracts it. Of a
            rupture that is certain at once there is none; nor in `published`.
        provisional_retracted: The provisional alarm that this sample made improbable,
            or None.
        rupture_probability: Probability, now, of one rupture more than the alarms have
            reported; None in `published`.
        hard_contact: The hard contact that this sample showed, or None.
        warnings: Motion of the tissue, or something hard at the tip.
    """

    time_s: float
    status: SampleStatus
    rupture_state: RuptureState
    in_contact: bool
    layer: int
    enhanced_force_N: float
    enhanced_force_std_N: float | None
    tip_force_N: float
    tip_force_std_N: float | None
    shaft_friction_N: float
    shaft_friction_std_N: float | None
    predicted_force_N: float
    stiffness_N_per_m: float
    stiffness_std_N_per_m: float | None
    stiffness_identified: bool
    friction_Ns_per_m2: float
    friction_std_Ns_per_m2: float | None
    friction_identified: bool
    cumulative_friction_Ns_per_m: float
    cumulative_friction_std_Ns_per_m: float | None
    rupture: Rupture | None = None
    identified_layer: LayerEstimate | None = None
    retracted: Rupture | None = None
    provisional: Rupture | None = None
    provisional_retracted: Rupture | None = None
    rupture_probability: float | None = None
    hard_contact: HardContact | None = None
    warnings: TissueWarning = TissueWarning.NONE

    @property
    def has_events(self) -> bool:
        """Whether this sample brought any of the `EVENTS`."""
        return (
            self.rupture is not None
            or self.identified_layer is not None
            or self.retracted is not None
            or self.provisional is not None
            or self.provisional_retracted is not None
            or self.hard_contact is not None
        )

    def without_events(self) -> "Estimate":
        """Return the same estimate, its events over."""
        return self._replace(**dict.fromkeys(EVENTS)) if self.has_events else self


EVENTS = (
    "rupture",
    "identified_layer",
    "retracted",
    "provisional",
    "provisional_retracted",
    "hard_contact",
)
"""Fields of an `Estimate` that say what happened at its sample; of most they are
None."""


Outputs = tuple[
    bool,  # in_contact
    int,  # layer
    float,  # enhanced_force_N
    float | None,  # enhanced_force_std_N
    float,  # tip_force_N
    float | None,  # tip_force_std_N
    float,  # shaft_friction_N
    float | None,  # shaft_friction_std_N
    float,  # predicted_force_N
    float,  # stiffness_N_per_m
    float | None,  # stiffness_std_N_per_m
    bool,  # stiffness_identified
    float,  # friction_Ns_per_m2
    float | None,  # friction_std_Ns_per_m2
    bool,  # friction_identified
    float,  # cumulative_friction_Ns_per_m
    float | None,  # cumulative_friction_std_Ns_per_m
]
"""What a method calculates at every sample: the fields of an `Estimate` from
``in_contact`` to the events. A plain tuple, since compiled code that returns a named
one costs a microsecond."""


class Sample(NamedTuple):
    """A checked sample, as a method gets it; every number is finite, 0 before one.

    Attributes:
        time_s: Time on the caller's clock, see `Identifier.update`.
        dt_s: Time since the previous sample that was used, positive.
        depth_m: Filtered depth, jumps removed.
        speed_m_s: Filtered speed.
        depth_std_m: Standard deviation that noise of the samples leaves in the depth.
        speed_std_m_s: The same of the speed.
        force_N: Axial force.
        force_std_N: Standard deviation of its slow error.
        raw_depth_m: Depth, jumps removed, not filtered.
        raw_speed_m_s: Speed as measured; the filtered one where nobody measures it.
        clock_s: Time since the reset, which never goes back.
    """

    time_s: float = 0.0
    dt_s: float = 0.0
    depth_m: float = 0.0
    speed_m_s: float = 0.0
    depth_std_m: float = 0.0
    speed_std_m_s: float = 0.0
    force_N: float = 0.0
    force_std_N: float = 0.0
    raw_depth_m: float = 0.0
    raw_speed_m_s: float = 0.0
    clock_s: float = 0.0
