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


def _check_values(config: object, of_any_sign: tuple[str, ...] = ()) -> None:
    """Refuse settings that are not finite, or not positive where they must be."""
    for name in config.__slots__:  # type: ignore[attr-defined]
        value = getattr(config, name)
        if name == "check":
            _check_kind(name, value, CheckConfig)
        elif name != "model" and not (
            _is_finite(value) and (value > 0 or name in of_any_sign)
        ):
            expected = (
                "a finite number" if name in of_any_sign else "positive and finite"
            )
            raise InvalidConfigError(f"{name} must be {expected}, got {value!r}")


def _check_kind(name: str, value: object, kind: type) -> None:
    if not isinstance(value, kind) or isinstance(value, bool):
        raise InvalidConfigError(
            f"{name} must be of type {kind.__name__}, got {value!r}"
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
            `mixture.hard_contact`.
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
        if not (isinstance(self.model, str) and self.model in ("ml", "kv")):
            raise InvalidConfigError(
                f"unknown model {self.model!r}; choose 'ml' or 'kv'"
            )
        _check_kind("most_windows", self.most_windows, numbers.Integral)
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
