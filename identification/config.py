"""Settings of the two methods, and the check of every one of their values."""

import numbers
from dataclasses import dataclass, field, fields
from typing import Literal, get_args

from identification.errors import InvalidConfigError

Model = Literal["ml", "kv"]
"""`ml`: multi-layer, equation (3); `kv`: Kelvin-Voigt, equation (2)."""


def _check_values(config: object, of_any_sign: tuple[str, ...] = ()) -> None:
    """Refuse numbers that are not finite, or not positive where they must be."""
    for item in fields(config):  # type: ignore[arg-type]
        value = getattr(config, item.name)
        if item.name == "check":
            is_valid = isinstance(value, CheckConfig)
        elif item.name == "model":
            is_valid = isinstance(value, str) and value in get_args(Model)
        else:
            kind = numbers.Integral if item.type is int else numbers.Real
            is_number = isinstance(value, kind) and not isinstance(value, bool)
            least = -1e300 if item.name in of_any_sign else 0.0
            is_valid = is_number and least < value < 1e300
        if not is_valid:
            raise InvalidConfigError(
                f"{item.name} cannot be {value!r}: numbers must be finite and most of "
                "them positive, most_windows whole, model 'ml' or 'kv', check a "
                "CheckConfig"
            )


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckConfig:
    """Limits of a plausible sample.

    Attributes:
        gap_s: An interval longer than this, and than ten usual ones, is a gap: local
            predictions restart.
        jump_m: Change of depth beyond what speed explains that counts as a jump; a
            needle at a surgical 100 mm/s moves a tenth of this between samples at 1
            kHz.
        sign_memory_s: Memory of the travel by depth and the travel by speed that are
            compared.
        sign_travel_m: Both travels must exceed this, with opposite signs, to be
            contradictory.
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
class MixtureConfig:
    """Settings of the mixture; its physical priors stand where they act.

    Attributes:
        alarm_probability: Of one more rupture, at which an alarm is raised. Chosen: if
            the model were exact, at most 2 of 100 alarms at 0.98 would be false; how
            many are is measured, see docs/reference/results.md. A lower one is earlier.
        provisional_probability: The same for a provisional alarm, at most as large.
        hard_contact_N_per_m: Growth of the force per travel beyond which a contact is
            hard, as bone: twice what a tip of 18 G meets in cartilage, see
            `mixture.tissue_doubt`.
        check: Limits of a plausible sample.
    """

    alarm_probability: float = 0.98
    provisional_probability: float = 0.9
    hard_contact_N_per_m: float = 4000.0
    check: CheckConfig = field(default_factory=CheckConfig)

    def __post_init__(self) -> None:
        """Raise `InvalidConfigError` unless 0.5 <= provisional <= alarm < 1."""
        _check_values(self)
        if not 0.5 <= self.alarm_probability < 1.0:
            raise InvalidConfigError(
                "alarm_probability must be from 0.5 to below 1, got "
                f"{self.alarm_probability!r}"
            )
        if not 0.5 <= self.provisional_probability <= self.alarm_probability:
            raise InvalidConfigError(
                "provisional_probability must be from 0.5 to alarm_probability, got "
                f"{self.provisional_probability!r}"
            )


MIXTURE = MixtureConfig()
"""For simulated and real, force-torque and virtual sensors alike."""


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedConfig:
    """Settings of the published identification; the defaults are the published values.

    They are those of Section VI and of the authors' framework.

    Attributes:
        model: `ml`, equation (3), or `kv`, equation (2).
        sigma0_N: Standard deviation of the error in the standard case, equation (9).
        sigma1_N: The same at an abrupt change, equation (9).
        derivative_threshold_N_per_s: beta; below -beta a rupture is expected.
        derivative_rise_N_per_s: How much beta grows at each detection.
        derivative_time_constant_s: Of the derivative's low-pass. Not published: at this
            value 10 mN of noise leave 0.05 N/s, just below beta.
        reset_frequency_Hz: f_CR of the covariance resetting.
        drop_travel_m: k_v of T_drop = k_v / v; published as 1 with speeds in mm/s.
        var_stiffness: sigma^2_K,0 of Psi_0.
        var_friction: sigma^2_B,0 of Psi_0.
        contact_depth_m: Of the first contact, which the method assumes known.
        least_speed_m_s: Below it T_drop has no meaning and no rupture is detected.
        most_windows: Reset windows kept per layer before neighbours are merged (27
            minutes of one layer merge to half the reset frequency four times).
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
        """Raise `InvalidConfigError` unless every value is plausible."""
        _check_values(self, ("contact_depth_m", "derivative_rise_N_per_s"))
        if self.sigma1_N <= self.sigma0_N:
            raise InvalidConfigError(
                f"sigma1_N ({self.sigma1_N}) must exceed sigma0_N ({self.sigma0_N}): "
                "the abrupt change is the noisier case"
            )


PUBLISHED = PublishedConfig()
"""The multi-layer model of the paper with the published settings."""

PUBLISHED_KV = PublishedConfig(model="kv")
"""The Kelvin-Voigt model with the published settings (blue line of Figure 8)."""
