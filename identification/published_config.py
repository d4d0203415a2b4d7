"""Settings of the published method (Section VI and the authors' framework)."""

import numbers
from dataclasses import dataclass, field

from identification.errors import InvalidConfigError
from identification.input_validation import CheckConfig, check_finite, check_kind, check_positive
from identification.interaction_model import Model


@dataclass(frozen=True, slots=True, kw_only=True)
class PublishedConfig:
    """Everything the published identification needs; the defaults are the published figures.

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
        least_speed_m_s: Below this speed T_drop has no meaning and no rupture is looked for.
        most_windows: Reset windows kept per layer before neighbours are merged (27 minutes of
            one layer merge to half the reset frequency four times).
        check: Limits of a believable sample.
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
        """Check the figures.

        Raises:
            InvalidConfigError: A figure is not positive, or sigma1 does not exceed sigma0.
        """
        if not (isinstance(self.model, str) and self.model in ("ml", "kv")):
            raise InvalidConfigError(f"unknown model {self.model!r}; choose 'ml' or 'kv'")
        check_kind("check", self.check, CheckConfig)
        check_kind("most_windows", self.most_windows, numbers.Integral)
        any_sign = ("contact_depth_m", "derivative_rise_N_per_s")
        for name in self.__slots__:
            if name not in ("model", "check"):
                check = check_finite if name in any_sign else check_positive
                check(name, getattr(self, name))
        if self.sigma1_N <= self.sigma0_N:
            raise InvalidConfigError(
                f"sigma1_N ({self.sigma1_N}) must exceed sigma0_N ({self.sigma0_N}): "
                "the abrupt change is the noisier case"
            )


PUBLISHED = PublishedConfig()
"""The multi-layer model with the published settings."""

PUBLISHED_KV = PublishedConfig(model="kv")
"""The Kelvin-Voigt model with the published settings (blue line of Figure 8)."""
