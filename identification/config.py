"""Settings of the two methods, and the check of every one of their values."""

import math
import numbers
from dataclasses import dataclass, field
from typing import Literal

from identification.errors import InvalidConfigError

Model = Literal["ml", "kv"]
"""`ml`: multi-layer, equation (3); `kv`: Kelvin-Voigt, equation (2)."""


def _is_finite(value: object) -> bool:
    if not isinstance(value, numbers.Real) or isinstance(value, bool):
        return False
    try:
        return math.isfinite(value)
    except OverflowError:
        return False


def _check_values(config: object, others: tuple[str, ...] = ()) -> None:
    """Refuse a setting that is not a finite number above zero, `others` aside."""
    for name in config.__slots__:  # type: ignore[attr-defined]
        value = getattr(config, name)
        if name == "check":
            _check_kind(name, value, CheckConfig)
        elif name not in others and not (_is_finite(value) and value > 0):
            raise InvalidConfigError(f"{name} must be positive and finite, got {value!r}")


def _check_kind(name: str, value: object, kind: type) -> None:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidConfigError(f"{name} must be of type {kind.__name__}, got {value!r}")


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckConfig:
    """Limits of a plausible sample.

    Attributes:
        gap_s: An interval longer than this, and than ten usual ones, is a gap.
        jump_m: Change of depth beyond what speed explains that counts as a jump; a needle at
            a surgical 100 mm/s moves a tenth of this between samples at 1 kHz.
        sign_memory_s: Time constant over which travel from depth and from speed are compared.
        sign_travel_m: Both must exceed this, with opposite signs, to be called contradictory.
        force_limit_N: Largest plausible axial force; needles buckle far below.
    """

    gap_s: float = 0.25
    jump_m: float = 1e-3
    sign_memory_s: float = 0.2
    sign_travel_m: float = 5e-5
    force_limit_N: float = 200.0

    def __post_init__(self) -> None:
        """Raise `InvalidConfigError` unless every limit is positive and finite."""
        _check_values(self)


@dataclass(frozen=True, slots=True, kw_only=True)
class MultilayerConfig:
    """Physical priors and required error rates; nothing here depends on a sensor or a tissue.

    Attributes:
        false_alarm_interval_s: Required mean time between false alarms: an hour of insertion, some
            hundred insertions.
        noise_memory_s: How far back the noise is learned; an insertion's noise may change.
        block_s: Length of the detector's blocks: an eighth of the required delay.
        rest_speed_m_s: Slower than this the needle rests; ruptures need travel.
        expected_fraction: Fraction of the threshold at which a rupture is expected.
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
        provisional_window_m: Travel after a rupture over which the provisional estimate of its
            layer is measured (the published k_v).
        final_window_m: Travel over which the final estimate is measured.
        model_error_fraction: Relative error of a linear law, correlated over `model_error_m`.
        model_error_m: Travel over which the error of the linear law stays the same.
        friction_fraction: Fraction of friction in a layer's growing force, before data.
        friction_fraction_std: Standard deviation of the fraction, here and below.
        partial_rupture_travel_m: Travel of a release that is as likely a partial rupture as the
            end of a layer: gels and layers release within 0.1 to 0.5 mm, partial ruptures within
            liver take 0.5 to 2 mm.
        partial_rupture_friction_fraction: Fraction of friction in the force that a partial rupture
            leaves: the tip force is least then, and the fraction larger than the two thirds of an
            insertion into liver as a whole.
        partial_rupture_friction_fraction_std: As above.
        coulomb_speed_m_s: Speed at which Coulomb and viscous friction are equal, before data:
            1.5 mm/s in gels (Table I at two speeds), 7.5 mm/s in liver; their middle.
        coulomb_speed_factor: Factor by which that speed may differ, one standard deviation.
        check: Limits of a plausible sample.
    """

    false_alarm_interval_s: float = 3_600.0
    noise_memory_s: float = 4.0
    block_s: float = 5e-3
    rest_speed_m_s: float = 1e-4
    expected_fraction: float = 0.6
    speed_smoothing_s: float = 0.02
    track_step_m: float = 2e-5
    row_m: float = 2.5e-4
    presliding_m: float = 0.3e-3
    cutting_onset_m: float = 1e-3
    cutting_reach_m: float = 1.5e-3
    provisional_window_m: float = 1e-3
    final_window_m: float = 3e-3
    model_error_fraction: float = 0.03
    model_error_m: float = 5e-3
    friction_fraction: float = 0.5
    friction_fraction_std: float = 0.2
    partial_rupture_travel_m: float = 0.4e-3
    partial_rupture_friction_fraction: float = 0.8
    partial_rupture_friction_fraction_std: float = 0.15
    coulomb_speed_m_s: float = 3.4e-3
    coulomb_speed_factor: float = 2.2
    check: CheckConfig = field(default_factory=CheckConfig)

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InvalidConfigError: One is not positive and finite, or the windows are unordered.
        """
        _check_values(self)
        if self.final_window_m <= self.provisional_window_m:
            raise InvalidConfigError(
                f"final_window_m ({self.final_window_m}) must exceed provisional_window_m "
                f"({self.provisional_window_m})"
            )

    def coulomb_fraction(self, speed_m_s: float) -> float:
        """Fraction of Coulomb friction at a speed, before data."""
        return self.coulomb_speed_m_s / (self.coulomb_speed_m_s + abs(speed_m_s))

    def coulomb_fraction_std(self, speed_m_s: float) -> float:
        """Standard deviation of that fraction."""
        fraction = self.coulomb_fraction(speed_m_s)
        return fraction * (1.0 - fraction) * math.log(self.coulomb_speed_factor)


MULTILAYER = MultilayerConfig()
"""The one configuration for simulated and real, F/T and virtual sensors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SwitchingConfig:
    """Settings of the switching filter; its physical priors stand where they are used.

    Attributes:
        alarm_probability: Probability of one more rupture at which an alarm is raised.
        check: Limits of a plausible sample.
    """

    alarm_probability: float = 0.98
    check: CheckConfig = field(default_factory=CheckConfig)

    def __post_init__(self) -> None:
        """Raise `InvalidConfigError` unless the probability lies between 0.5 and 1."""
        _check_values(self)
        if not 0.5 <= self.alarm_probability < 1.0:
            raise InvalidConfigError(
                f"alarm_probability must be from 0.5 to below 1, got {self.alarm_probability!r}"
            )


SWITCHING = SwitchingConfig()
"""The one configuration for simulated and real, F/T and virtual sensors."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedConfig:
    """Everything the published identification needs; the defaults are the published values.

    Settings of Section VI and of the authors' framework.

    Attributes:
        model: `ml`, equation (3), or `kv`, equation (2).
        sigma0_N: Standard deviation of the error in the standard case, equation (9).
        sigma1_N: Standard deviation of the error at an abrupt change, equation (9).
        derivative_threshold_N_per_s: beta; a filtered derivative below -beta announces a rupture.
        derivative_rise_N_per_s: How much beta grows at each detection.
        derivative_time_constant_s: Of the derivative's low-pass. Not published: at this value
            10 mN of noise leave 0.05 N/s, just below beta.
        reset_frequency_Hz: f_CR of the covariance resetting.
        drop_travel_m: k_v of T_drop = k_v / v; published as 1 with speeds in mm/s.
        var_stiffness: sigma^2_K,0 of Psi_0.
        var_friction: sigma^2_B,0 of Psi_0.
        contact_depth_m: Depth of the first contact, which the method assumes known.
        least_speed_m_s: Below this speed T_drop has no meaning and no rupture is detected.
        most_windows: Reset windows kept per layer before neighbours are merged (27 minutes of
            one layer merge to half the reset frequency four times).
        check: Limits of a plausible sample.
    """

    model: Model = "ml"
    sigma0_N: float = 0.01
    sigma1_N: float = 0.08
    derivative_threshold_N_per_s: float = 0.075
    derivative_rise_N_per_s: float = 0.025
    derivative_time_constant_s: float = 0.2
    reset_frequency_Hz: float = 40.0
    drop_travel_m: float = 1e-3
    var_stiffness: float = 1e6
    var_friction: float = 1e6
    contact_depth_m: float = 0.0
    least_speed_m_s: float = 1e-4
    most_windows: int = 4096
    check: CheckConfig = field(default_factory=CheckConfig)

    def __post_init__(self) -> None:
        """Check the values.

        Raises:
            InvalidConfigError: One is not positive, or sigma1 does not exceed sigma0.
        """
        if not (isinstance(self.model, str) and self.model in ("ml", "kv")):
            raise InvalidConfigError(f"unknown model {self.model!r}; choose 'ml' or 'kv'")
        _check_kind("most_windows", self.most_windows, numbers.Integral)
        of_any_sign = ("contact_depth_m", "derivative_rise_N_per_s")
        _check_values(self, ("model", *of_any_sign))
        for name in of_any_sign:
            if not _is_finite(getattr(self, name)):
                raise InvalidConfigError(
                    f"{name} must be a finite number, got {getattr(self, name)!r}"
                )
        if self.sigma1_N <= self.sigma0_N:
            raise InvalidConfigError(
                f"sigma1_N ({self.sigma1_N}) must exceed sigma0_N ({self.sigma0_N}): "
                "the abrupt change is the noisier case"
            )


PUBLISHED = PublishedConfig()
"""The multi-layer model with the published settings."""

PUBLISHED_KV = PublishedConfig(model="kv")
"""The Kelvin-Voigt model with the published settings (blue line of Figure 8)."""
