"""What an identifier reports: per sample, per rupture and per layer.

Clock and depth zero are the caller's. Every ``*_s`` here is on the clock of
`Identifier.update`: its argument ``time_s`` where the caller passes one, else the sum
of the ``dt_s`` since the reset. Every depth counts from the zero of the caller's
``depth_m``; `Rupture.contact_depth_m` is the depth of the first contact with tissue
from the same zero, so that a travel in tissue is a difference of the two.
"""

from dataclasses import dataclass
from enum import Enum
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]


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

    @property
    def is_used(self) -> bool:
        """Whether the sample went into the estimate."""
        return self is SampleStatus.OK or self is SampleStatus.TIME_GAP


class RuptureState(Enum):
    """Where the identifier stands with respect to a rupture (the authors'
    framework).
    """

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
        contact_depth_m: Depth of first contact: found by the multi-layer method, known
            beforehand in `published`.
        partial_rupture_probability: That it was partial and not the layer's end, None
            where the method does not distinguish them.
    """

    layer: int
    alarm_s: float
    alarm_depth_m: float
    time_s: float
    depth_m: float
    force_N: float
    speed_m_s: float
    probability: float
    is_final: bool = (
        False  # whether it is settled: while False it may still be retracted
    )
    contact_depth_m: float
    partial_rupture_probability: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class LayerEstimate:
    """A layer that has been traversed, as known now.

    The multi-layer method reports a layer twice: provisionally, a millimetre after its
    rupture, and finally, some millimetres later. A field with ``_std_`` in its name is
    the standard deviation of the one before it, None where the method states none
    (`published`); one that ends in ``_identified`` is whether the data determine the
    value.

    The values are those at the rupture's speed.

    Attributes:
        layer: Number from 1.
        is_final: Whether the measurement of its rupture has ended: False in a
            provisional estimate, which a final one follows unless the alarm is
            retracted. `Identifier.layers` goes on refining final estimates with what
            later layers reveal about their friction.
        start_depth_m: Depth at which it begins.
        thickness_m: d_i, travel from there to its rupture.
        rupture: How it ended.
        force_drop_N: Elastic force released.
        stiffness_N_per_m: K_i.
        friction_Ns_per_m2: B_i (for `kv` in Ns/m).
        friction_N: Friction of this layer on the shaft at its rupture, B_i d_i v.
        coulomb_N_per_m: Per embedded length the part of the friction that does not
            depend on speed, and the part in proportion to it; None for `published`,
            which knows viscous friction only. Identified where the motion separated the
            two.
    """

    layer: int
    is_final: bool
    start_depth_m: float
    thickness_m: float
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


class Estimate(NamedTuple):
    """State of knowledge after one sample. Every number is finite.

    A named tuple, unlike the others: it is made anew at every sample, and a frozen
    dataclass of as many fields takes ten times as long. Change a field with
    ``_replace``.

    Fields with ``_std_`` and ``_identified`` in their names are as in `LayerEstimate`.

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
            Its deviation, as that of the tip force, holds the noise of the force too.
        tip_force_N: Axial force less all friction of the shaft; in tissue never
            negative.
        shaft_friction_N: All shaft friction; opposes motion, negative during
            withdrawal.
        predicted_force_N: Axial force the model expected at this sample.
        stiffness_N_per_m: K of the current layer.
        friction_Ns_per_m2: B of the current layer, at the present speed (for `kv` in
            Ns/m).
        cumulative_friction_Ns_per_m: Sum of B_j d_j over the traversed layers, at the
            speed of their ruptures.
        rupture: The rupture raised by this sample, or None.
        identified_layer: The layer whose friction was identified at this sample,
            provisionally or finally (see `LayerEstimate.is_final`), or None.
        retracted: The rupture, raised before, that this sample showed to be a false
            alarm (the force came back; its layer goes on and is not listed), or None.
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
    rupture: Rupture | None
    identified_layer: LayerEstimate | None
    retracted: Rupture | None = None

    @property
    def has_events(self) -> bool:
        """Whether this sample raised a rupture, identified a layer or retracted an
        alarm.
        """
        return not (self.rupture is self.identified_layer is self.retracted is None)

    def without_events(self) -> "Estimate":
        """The same, its events over."""
        return self._replace(**Events()._asdict()) if self.has_events else self


Outputs = tuple[
    Any, ...
]  # The fields of an `Estimate` from ``in_contact`` up to the events


class Events(NamedTuple):
    """The last three fields of an `Estimate`."""

    rupture: Rupture | None = None
    identified_layer: LayerEstimate | None = None
    retracted: Rupture | None = None


Sample = tuple[float, float, float, float, float, float, float, float, float, float]
"""A checked sample as a method gets it; every number is finite: time on the caller's
clock, see `Identifier.update`; interval since the previous sample that was used,
positive; depth, jumps removed; its rate; standard deviations of the noise of both;
axial force; the standard deviation of its slow error; the depth before it was filtered;
time since the reset, which never goes back."""
