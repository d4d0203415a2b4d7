"""The plant models of the simulated arm: every number and its reason in one place.

A plant model says how far the simulated arm is from the model that the estimator has
(links, payload), and how large the errors of its sensors are. From the fact sheets of
the real arm: torque noise floor 0.03 % of the joint limit, torque sensor linearity
better than 0.5 % of range, harmonic drives 160:1 (J1-J4) and 100:1 (J5-J7), 1 kHz, no
velocity in the interface. "Limit" below is a joint's effort limit, 176 to 38 Nm.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy.signal import lfilter

from foundation.arrays import Array
from groundtruth.errors import PlantModelError

TICK_s = 1e-3  # period of controller and sensors


def coloured(white: Array, period_s: float, correlation_s: float) -> Array:
    """Return stationary noise of unit standard deviation from white noise.

    Args:
        white: White noise of unit standard deviation, shape (n, ...); filtered along
            the first axis.
        period_s: Time between samples.
        correlation_s: Time constant of the correlation; 0 for none.
    """
    if correlation_s == 0.0:
        return white
    pole = np.exp(-period_s / correlation_s)
    entering = np.sqrt(1.0 - pole * pole) * white
    entering[0] = white[0]  # as if it had gone on for ever before
    return np.asarray(lfilter([1.0], [1.0, -pole], entering, axis=0))


@dataclass(frozen=True, slots=True, kw_only=True)
class ForceNoise:
    """Noise, drift and resolution of the force sensor at the needle's base.

    The drift begins at the last zeroing.

    Attributes:
        white_std_N: Standard deviation of the noise of one sample.
        drift_std_N_per_s: Standard deviation of the drift rate, drawn once per run.
        step_N: Smallest step of the reading.
        correlation_s: Time constant of the noise if it is not white.
    """

    white_std_N: float = 0.0
    drift_std_N_per_s: float = 0.0
    step_N: float = 0.0
    correlation_s: float = 0.0

    def reading_N(
        self, force_N: Array, t_s: Array, zeroed_s: float, rng: np.random.Generator
    ) -> Array:
        """Return the reading of a true force, shape (n,), read-only.

        Args:
            force_N: True force, shape (n,).
            t_s: Times of the samples, shape (n,).
            zeroed_s: Time of the last zeroing, where the drift passes through zero.
            rng: Draws noise and drift.
        """
        white = rng.standard_normal(force_N.shape)
        period_s = float(np.median(np.diff(t_s))) if t_s.size > 1 else 1.0
        noise = self.white_std_N * coloured(white, period_s, self.correlation_s)
        drift = self.drift_std_N_per_s * rng.standard_normal() * (t_s - zeroed_s)
        reading = force_N + noise + drift
        if self.step_N > 0.0:
            reading = np.round(reading / self.step_N) * self.step_N
        reading.setflags(write=False)
        return reading


MINI45 = ForceNoise(white_std_N=0.01, drift_std_N_per_s=1.5e-4, step_N=1.0 / 256.0)
"""ATI Mini45 SI-145-5 along z, read at 1 kHz as a driver delivers it: averaged.

White: one raw sample at 2 kHz has 0.05 N, the mean over 0.1 s still 0.0155 N (coloured
noise). The paper found 0.01 N on this sensor (its σ₀), and the liver recordings have
0.007 N above 20 Hz. Drift: warmed up, 0.055 N between minute 4 and minute 10 after
switching on. Step: the converter's 1/16 N, averaged over 16 samples that the raw noise
dithers.
"""


@dataclass(frozen=True, slots=True, kw_only=True)
class PlantModel:
    """All differences between a simulated arm and the estimator's model of it.

    They are those of the arm and those of its sensors.

    Joint-wise tuples are ordered J1..J7; six-tuples are force x, y, z, torque x, y, z
    in sensor axes. The default of every number is zero: no such error.

    Attributes:
        name: Name of the plant model.
        cad_fraction: Fraction a of the CAD link table in the arm, (1 - a) nominal + a
            CAD. Two published tables of one arm disagree by 1.5 Nm rms at J2; 0.1 of
            that (0.15 Nm, 0.3 N at the flange) stands for a model identified with care,
            0.3 (0.45 Nm, 0.9 N) for one taken over from elsewhere.
        payload_error: Relative error of the tool's mass as the estimator knows it; the
            sign is drawn. 0.02: weighed without its cable; 0.05: from data sheets.
        payload_com_spread_m: Standard deviation, per axis, of the error of the tool's
            centre of mass: the mass error times the 50 mm size of an F/T sensor with
            its adapters.
        kinematic_error_m: Standard deviation, per joint and axis, of the error of where
            the estimator's model has the joint's frame.
        kinematic_error_rad: The same of how that frame is turned.
        torque_noise_std_Nm: Noise of one sample: 0.03 % of limit.
        torque_noise_correlation_s: Time constant of that noise, zero for white. The
            source states the 0.03 % after an 8 Hz filter: 1 / (2 pi 8 Hz) = 20 ms.
            `clean` takes the number per sample, which is kinder.
        torque_bias_min_Nm: Least magnitude of the constant offset; the magnitude is
            drawn uniformly, the sign too.
        torque_bias_max_Nm: Greatest magnitude. Up to 1 Nm (J1-J5) and 0.3 Nm (J6-J7):
            what an identification of a real LWR 4+ had to attribute to its friction
            offsets.
        torque_drift_std_per_min: Standard deviation of the linear drift rate, as a
            fraction of limit per minute. 1e-4: the zero of a strain-gauge sensor (ATI
            Mini45) drifts by 0.115 N of 290 N, 4e-4, in 4 minutes.
        torque_random_walk_std_per_sqrt_min: Random walk on top, as a fraction of limit
            after one minute. 3e-5, a third of the linear part: real drift is not
            straight, but nearly so over the two minutes of an insertion.
        torque_warm_up: Part of the zero, as a fraction of limit, that fades while the
            sensor warms up; the sign is drawn. Chosen: 1e-3 over a minute, some times
            the 4e-4 in 4 minutes of the sensor above.
        warm_up_s: Time constant of that.
        torque_ripple: Amplitude, as a fraction of limit, of a ripple periodic in joint
            position: the elliptic wave generator passes the sensor twice per motor
            turn, sin(2 N q) with gear ratio N. 1e-4, one fiftieth of the 0.5 %
            linearity, most of which is smooth and calibrated away.
        torque_hysteresis: Half-width, as a fraction of limit, of the torque sensor's
            backlash: the output lags until the torque has moved by this much. 1e-4, one
            fiftieth of the linearity as well.
        torque_nonlinearity: Greatest smooth deviation of a torque sensor from a
            straight line, as a fraction of limit. The data sheet promises less than 0.5
            %.
        joint_coulomb: Coulomb friction between torque sensor and link, as a fraction of
            limit, see `groundtruth.arm_plant.BearingFriction`. No source states it;
            calibrated, see `FRI`.
        joint_viscous_Nms_per_rad: Viscous friction there.
        size_spread: Friction and drift of each joint are drawn within this factor of
            their stated size.
        position_noise_std_rad: White noise of the reported position. 1e-5: a motor
            encoder seen through the gear; the absolute sensor on the link (1.75e-4)
            would be the worst case.
        position_step_rad: Step to which the position is rounded after the noise; as
            large as the noise.
        velocity_noise_std_rad_s: White noise of the reported velocity, None if none is
            reported (as over FRI). 2e-4: an 18-bit motor encoder behind 160:1, a step
            of 1.5e-7 rad, differenced at the 3 kHz of the joint loop: 1.5e-7 x 3000 /
            sqrt(6) = 1.8e-4.
        clock_jitter_std_s: Error of the time stamps, cut at 0.4 ticks so that they keep
            their order. 5e-5: stamps taken on arrival by a PC without a tuned real-time
            kernel.
        ticks_per_sample: Ticks between samples of the interface: 1 for 1 kHz, 5 for 200
            Hz.
        drop_probability: Probability, at each sample, that a loss begins. 1e-3: UDP
            through a shared switch.
        drop_max_samples: A loss takes 1 to this many samples in a row, each number
            equally likely.
        ft_noise_std: White noise of one sample of the reference F/T sensor, N and Nm.
            Along z that of `MINI45`; the other axes in proportion to raw samples of
            one: 20, 19, 50 mN; 0.53, 0.53, 0.50 mNm.
        ft_noise_correlation_s: Time constant of that noise, zero for white.
        ft_drift_std_per_min: Standard deviation of its linear drift rate, N/min and
            Nm/min. Along z that of `MINI45`; the other axes in proportion to their
            range: 145, 145, 290 N; 5 Nm.
    """

    name: str
    cad_fraction: float = 0.0
    payload_error: float = 0.0
    payload_com_spread_m: float = 0.0
    kinematic_error_m: float = 0.0
    kinematic_error_rad: float = 0.0
    torque_noise_std_Nm: tuple[float, ...] = (0.0,) * 7
    torque_noise_correlation_s: float = 0.0
    torque_bias_min_Nm: tuple[float, ...] = (0.0,) * 7
    torque_bias_max_Nm: tuple[float, ...] = (0.0,) * 7
    torque_drift_std_per_min: float = 0.0
    torque_random_walk_std_per_sqrt_min: float = 0.0
    torque_warm_up: float = 0.0
    warm_up_s: float = 60.0
    torque_ripple: float = 0.0
    torque_hysteresis: float = 0.0
    torque_nonlinearity: float = 0.0
    joint_coulomb: float = 0.0
    joint_viscous_Nms_per_rad: tuple[float, ...] = (0.0,) * 7
    size_spread: float = 1.0
    position_noise_std_rad: float = 0.0
    position_step_rad: float = 0.0
    velocity_noise_std_rad_s: float | None = 0.0
    clock_jitter_std_s: float = 0.0
    ticks_per_sample: int = 1
    drop_probability: float = 0.0
    drop_max_samples: int = 1
    ft_noise_std: tuple[float, ...] = (0.0,) * 6
    ft_noise_correlation_s: float = 0.0
    ft_drift_std_per_min: tuple[float, ...] = (0.0,) * 6


def drawn_factors(
    plant_model: PlantModel, shape: tuple[int, ...], rng: np.random.Generator
) -> Array:
    """Return factors on stated sizes, equal chance per octave.

    They lie within the plant model's `size_spread` of 1.
    """
    if plant_model.size_spread == 1.0:  # keeps what is drawn afterwards
        return np.ones(shape)
    return plant_model.size_spread ** rng.uniform(-1.0, 1.0, shape)


_FT_NOISE = tuple(
    MINI45.white_std_N * raw / 0.050
    for raw in (0.020, 0.019, 0.050, 5.3e-4, 5.3e-4, 5.0e-4)
)
_FT_DRIFT = tuple(
    MINI45.drift_std_N_per_s * 60.0 * span / 290.0
    for span in (145.0, 145.0, 290.0, 5.0, 5.0, 5.0)
)

IDEAL = PlantModel(name="ideal")
"""The estimator's parameters, clean signals: proves algebra only."""

CLEAN = PlantModel(
    name="clean",
    cad_fraction=0.1,
    payload_error=0.02,
    payload_com_spread_m=0.001,
    torque_noise_std_Nm=(0.05, 0.05, 0.03, 0.03, 0.03, 0.011, 0.011),
    torque_bias_min_Nm=(0.1, 0.1, 0.1, 0.1, 0.1, 0.05, 0.05),
    torque_bias_max_Nm=(1.0, 1.0, 1.0, 1.0, 1.0, 0.3, 0.3),
    torque_drift_std_per_min=1e-4,
    torque_random_walk_std_per_sqrt_min=3e-5,
    position_noise_std_rad=1e-5,
    position_step_rad=1e-5,
    velocity_noise_std_rad_s=2e-4,
    ft_noise_std=_FT_NOISE,
    ft_drift_std_per_min=_FT_DRIFT,
)
"""A well-kept arm with an identified model."""

FRI = replace(
    CLEAN,
    name="fri",
    torque_noise_correlation_s=20e-3,
    torque_nonlinearity=0.005,
    joint_coulomb=2.1e-4,
    size_spread=2.0,
    position_noise_std_rad=5e-5,
    position_step_rad=1.75e-4,
    velocity_noise_std_rad_s=None,
    clock_jitter_std_s=5e-5,
)
"""The arm as its research interface gives it."""

DEGRADED = replace(
    FRI,
    name="degraded",
    cad_fraction=0.3,
    payload_error=0.05,
    payload_com_spread_m=0.0025,
    torque_noise_std_Nm=tuple(2.0 * std for std in CLEAN.torque_noise_std_Nm),
    torque_ripple=1e-4,
    torque_hysteresis=1e-4,
    torque_nonlinearity=0.01,
    joint_coulomb=2.0 * FRI.joint_coulomb,
    position_noise_std_rad=1.75e-4,
    drop_probability=1e-3,
    drop_max_samples=3,
    ft_noise_std=tuple(2.0 * std for std in _FT_NOISE),
)
"""A neglected arm seen through its bare research interface: twice the noise, further
errors."""

PLANT_MODELS = {model.name: model for model in (IDEAL, CLEAN, FRI, DEGRADED)}
"""Plant models by name."""


def plant_named(plant: PlantModel | str) -> PlantModel:
    """Return the plant model of that name; a plant model is returned as it is.

    `PlantModelError` if there is none of that name.
    """
    if isinstance(plant, PlantModel):
        return plant
    if plant not in PLANT_MODELS:
        raise PlantModelError(
            f"no plant model {plant!r}; known: {', '.join(PLANT_MODELS)}"
        )
    return PLANT_MODELS[plant]
