"""The arms, as named levels of dishonesty: every number and its reason in one place.

A level says by how much the simulated arm differs from what the estimator believes (links, payload)
and how much its sensors lie. Fact sheets of the real arm: torque noise floor 0.03 % of the joint limit,
torque sensor linearity < 0.5 % of range, harmonic drives 160:1 (joints 1-4) and 100:1 (joints 5-7), no
velocity in the interface, 1 kHz. "Limit" below is the joint's effort limit (176 ... 38 Nm).
"""

from dataclasses import dataclass, field

from groundtruth.errors import ArmLevelError

_ZERO_7 = (0.0,) * 7
_ZERO_6 = (0.0,) * 6


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmLevel:
    """Everything in which a simulated arm and its sensors differ from the estimator's beliefs.

    Joint-wise tuples are ordered J1..J7, six-tuples force x, y, z then torque x, y, z in sensor axes.
    A zero switches the effect off.
    """

    name: str

    cad_share: float
    """Share a of the CAD link table in the plant, (1-a) nominal + a CAD. 0.1 shifts gravity torques by
    0.15 Nm rms at J2 (0.3 N at the flange), 0.3 by 0.45 Nm (0.9 N): the disagreement of two published
    tables of the same arm, hence of the size a user has to expect."""

    payload_error: float
    """Relative error of the tool's mass as the estimator knows it; its sign is drawn per seed.
    A kitchen scale and a cable that is sometimes held: 2 %; a tool taken from its data sheet: 5 %."""

    payload_com_spread_m: float
    """Std, per axis, of the tool's centre-of-mass error. Relative mass error x the 50 mm size of an F/T
    sensor with its adapter: 1 mm and 2.5 mm."""

    torque_noise_std_Nm: tuple[float, ...]
    """White noise per sample. 0.03 % of limit, the published floor of the joint torque sensors (quoted
    after an 8 Hz filter; taken here as per-sample white noise, which every filter then reduces)."""

    torque_bias_min_Nm: tuple[float, ...]
    """Smallest magnitude of the constant offset per joint; magnitude uniform, sign drawn per seed."""

    torque_bias_max_Nm: tuple[float, ...]
    """Largest magnitude of the offset. 0.1-1 Nm and 0.05-0.3 Nm: the offsets a published identification
    of a real LWR 4+ soaked up as 'Coulomb friction'."""

    torque_drift_std_per_min: float
    """Std of the linear drift rate, as a share of limit per minute. 1e-4: a strain-gauge sensor (ATI Mini45)
    drifts 0.115 N in 4 min on a range of 290 N, that is 0.04 % of range in 4 min."""

    torque_walk_std_per_sqrt_min: float
    """Random walk on top, as a share of limit after one minute. 3e-5, a third of the linear part:
    drift is never quite straight, and its curvature is small over the two minutes of an insertion."""

    torque_ripple: float
    """Amplitude, as a share of limit, of the torque sensor's ripple periodic in joint position through the
    gear: the elliptic wave generator passes twice per motor turn, sin(2 N q). 1e-4: one fiftieth of
    the sensor's 0.5 % linearity, most of which is calibrated away per joint."""

    torque_hysteresis: float
    """Half-width, as a share of limit, of the torque sensor's play (output lags until the input has moved by
    this much). 1e-4: strain gauges on metal are specified at this order, well within 0.5 %."""

    position_noise_std_rad: float
    """White noise of the reported position. 1e-5: float32 and the motor encoder seen through the gear;
    the absolute link-side sensor (1.75e-4) would be the worst case."""

    position_step_rad: float
    """Step to which the position is rounded after the noise; as large as the noise."""

    velocity_noise_std_rad_s: float | None
    """White noise of the reported velocity, None if none is reported (as over FRI). 2e-4: an 18-bit
    motor encoder behind 160:1 (1.5e-7 rad) differenced over one period of the 3 kHz joint loop,
    1.5e-7 x 3000 / sqrt(6) = 1.8e-4."""

    clock_jitter_std_s: float
    """Std of the error of the time stamps, cut at 40 % of the tick so that time stays monotone. 5e-5: stamps
    taken on arrival by a PC without a tuned real-time kernel."""

    drop_probability: float
    """Probability, per sample, that a loss begins. 1e-3: UDP over a shared switch."""

    drop_max_samples: int
    """A loss takes 1 ... this many consecutive samples, uniformly."""

    ft_noise_std: tuple[float, ...]
    """White noise per sample of the reference F/T sensor, N and Nm: one sample of a measured ATI Mini45
    SI-145-5 (0.020, 0.019, 0.050 N; 0.53, 0.53, 0.50 mNm)."""

    ft_drift_std_per_min: tuple[float, ...]
    """Std of the F/T sensor's linear drift rate, N/min and Nm/min: 0.115 N in 4 min along z, the other
    axes in proportion to their range (145 N, 5 Nm)."""

    gear_ratio: tuple[float, ...] = field(default=(160.0, 160.0, 160.0, 160.0, 100.0, 100.0, 100.0))
    """Harmonic-drive ratios, J4 taken as 160 (sources: 60 or 160)."""


def _twice(values: tuple[float, ...]) -> tuple[float, ...]:
    return tuple(2.0 * value for value in values)


_TORQUE_NOISE_Nm = (0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011)
_FT_NOISE = (0.020, 0.019, 0.050, 5.3e-4, 5.3e-4, 5.0e-4)
_FT_DRIFT_PER_MIN = (0.014, 0.014, 0.029, 5e-4, 5e-4, 5e-4)
_BIAS_MIN_Nm = (0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05)
_BIAS_MAX_Nm = (1.0, 1.0, 1.0, 1.0, 1.0, 0.3, 0.3)

TEXTBOOK = ArmLevel(
    name="textbook",
    cad_share=0.0,
    payload_error=0.0,
    payload_com_spread_m=0.0,
    torque_noise_std_Nm=_ZERO_7,
    torque_bias_min_Nm=_ZERO_7,
    torque_bias_max_Nm=_ZERO_7,
    torque_drift_std_per_min=0.0,
    torque_walk_std_per_sqrt_min=0.0,
    torque_ripple=0.0,
    torque_hysteresis=0.0,
    position_noise_std_rad=0.0,
    position_step_rad=0.0,
    velocity_noise_std_rad_s=0.0,
    clock_jitter_std_s=0.0,
    drop_probability=0.0,
    drop_max_samples=1,
    ft_noise_std=_ZERO_6,
    ft_drift_std_per_min=_ZERO_6,
)
"""The estimator's own parameters and clean signals: proves algebra only."""

REALISTIC = ArmLevel(
    name="realistic",
    cad_share=0.1,
    payload_error=0.02,
    payload_com_spread_m=0.001,
    torque_noise_std_Nm=_TORQUE_NOISE_Nm,
    torque_bias_min_Nm=_BIAS_MIN_Nm,
    torque_bias_max_Nm=_BIAS_MAX_Nm,
    torque_drift_std_per_min=1e-4,
    torque_walk_std_per_sqrt_min=3e-5,
    torque_ripple=0.0,
    torque_hysteresis=0.0,
    position_noise_std_rad=1e-5,
    position_step_rad=1e-5,
    velocity_noise_std_rad_s=2e-4,
    clock_jitter_std_s=0.0,
    drop_probability=0.0,
    drop_max_samples=1,
    ft_noise_std=_FT_NOISE,
    ft_drift_std_per_min=_FT_DRIFT_PER_MIN,
)
"""A well-kept arm with an identified model."""

HARD = ArmLevel(
    name="hard",
    cad_share=0.3,
    payload_error=0.05,
    payload_com_spread_m=0.0025,
    torque_noise_std_Nm=_twice(_TORQUE_NOISE_Nm),
    torque_bias_min_Nm=_BIAS_MIN_Nm,
    torque_bias_max_Nm=_BIAS_MAX_Nm,
    torque_drift_std_per_min=1e-4,
    torque_walk_std_per_sqrt_min=3e-5,
    torque_ripple=1e-4,
    torque_hysteresis=1e-4,
    position_noise_std_rad=2e-5,
    position_step_rad=2e-5,
    velocity_noise_std_rad_s=None,
    clock_jitter_std_s=5e-5,
    drop_probability=1e-3,
    drop_max_samples=3,
    ft_noise_std=_twice(_FT_NOISE),
    ft_drift_std_per_min=_FT_DRIFT_PER_MIN,
)
"""A neglected arm seen through its bare research interface."""

ARM_LEVELS = {level.name: level for level in (TEXTBOOK, REALISTIC, HARD)}
"""The levels by name."""


def arm_level(name: str) -> ArmLevel:
    """Look a level up by name.

    Args:
        name: ``textbook``, ``realistic`` or ``hard``.

    Returns:
        The level.

    Raises:
        ArmLevelError: There is no such level.
    """
    try:
        return ARM_LEVELS[name]
    except (KeyError, TypeError):
        raise ArmLevelError(
            f"unknown arm level {name!r}; choose one of {', '.join(ARM_LEVELS)}"
        ) from None
