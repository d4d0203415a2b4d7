"""Settings of this toolkit's own identification: one set for every recording."""

import math
from dataclasses import dataclass, field

from identification.errors import InvalidConfigError
from identification.input_validation import CheckConfig, check_kind, check_positive


@dataclass(frozen=True, slots=True, kw_only=True)
class MultilayerConfig:
    """Physical priors and wanted error rates; nothing here depends on a sensor or a tissue.

    Attributes:
        false_alarm_interval_s: Wanted mean time between false alarms: an hour of insertion, some
            hundred insertions.
        noise_memory_s: How far back the noise is learned; an insertion's noise may change.
        block_s: Length of the detector's blocks: an eighth of the delay wanted.
        rest_speed_m_s: Slower than this the needle rests; ruptures need travel.
        expected_share: Share of the threshold at which a rupture is expected.
        speed_smoothing_s: Time constant of the speed that decides on rest and turns friction into
            force; short against any change of speed by a hand or a robot.
        track_step_m: Travel between kept points; a release of 0.1 mm still spans a few.
        row_m: Travel over which points are averaged before they count as data of a layer.
        presliding_m: Travel over which friction turns after a reversal: gel clings for a fifth,
            soft tissue for half a millimetre.
        cutting_onset_m: Travel over which the cutting force of a fresh layer builds up: about a
            needle diameter (18G: 1.27 mm).
        cutting_reach_m: That force, give or take as much, as the travel over which the layer's
            growing force reaches it: a needle diameter or so. Free air grows no force.
        provisional_window_m: Travel after a rupture at which its friction is first identified (the
            published k_v).
        second_look_m: Travel at which it is identified for good.
        model_error_share: Relative error of a linear law, correlated over `model_error_m`.
        model_error_m: Travel over which the error of the linear law stays the same.
        friction_share: Share of friction in a layer's growing force before anything is known.
        friction_share_std: Its standard deviation.
        tear_travel_m: Travel of a release that is as likely a tear as the end of a layer: gels and
            layers let go within 0.1 to 0.5 mm, tears within liver take 0.5 to 2 mm.
        tear_share: Share of friction in the force that a tear leaves: it is least then, and the
            share larger than the two thirds of an insertion into liver as a whole.
        tear_share_std: Its standard deviation.
        coulomb_speed_m_s: Speed at which Coulomb and viscous friction are equal, before the motion
            tells: 1.5 mm/s in gels (Table I at two speeds), 7.5 mm/s in liver; their middle.
        coulomb_speed_factor: Factor by which that speed may differ, one standard deviation.
        check: Limits of a believable sample.
    """

    false_alarm_interval_s: float = 3_600.0
    noise_memory_s: float = 4.0
    block_s: float = 5e-3
    rest_speed_m_s: float = 1e-4
    expected_share: float = 0.6
    speed_smoothing_s: float = 0.02
    track_step_m: float = 2e-5
    row_m: float = 2.5e-4
    presliding_m: float = 0.3e-3
    cutting_onset_m: float = 1e-3
    cutting_reach_m: float = 1.5e-3
    provisional_window_m: float = 1e-3
    second_look_m: float = 3e-3
    model_error_share: float = 0.03
    model_error_m: float = 5e-3
    friction_share: float = 0.5
    friction_share_std: float = 0.2
    tear_travel_m: float = 0.4e-3
    tear_share: float = 0.8
    tear_share_std: float = 0.15
    coulomb_speed_m_s: float = 3.4e-3
    coulomb_speed_factor: float = 2.2
    check: CheckConfig = field(default_factory=CheckConfig)

    def __post_init__(self) -> None:
        """Check the figures.

        Raises:
            InvalidConfigError: A figure is not positive and finite, or the looks are unordered.
        """
        check_kind("check", self.check, CheckConfig)
        for name in self.__slots__:
            if name != "check":
                check_positive(name, getattr(self, name))
        if self.second_look_m <= self.provisional_window_m:
            raise InvalidConfigError(
                f"second_look_m ({self.second_look_m}) must exceed provisional_window_m "
                f"({self.provisional_window_m})"
            )

    def coulomb_share(self, speed_m_s: float) -> float:
        """Share of Coulomb friction at a speed, before the motion tells."""
        return self.coulomb_speed_m_s / (self.coulomb_speed_m_s + abs(speed_m_s))

    def coulomb_share_std(self, speed_m_s: float) -> float:
        """Standard deviation of that share."""
        share = self.coulomb_share(speed_m_s)
        return share * (1.0 - share) * math.log(self.coulomb_speed_factor)


MULTILAYER = MultilayerConfig()
"""The one configuration for simulated and real, F/T and virtual sensors."""
