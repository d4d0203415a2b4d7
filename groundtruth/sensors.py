"""Sensors and wire of the arm.

They are torque, position, velocity, wrench, time stamps and lost samples.

Every function takes true signals at all ticks, a plant model that says how large the
errors are, and the generator that they are drawn from.
"""

from itertools import accumulate

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth.plant_model import PlantModel, TICK_s, coloured, drawn_factors
from urdf import LWR_GEAR_RATIO

SECONDS_PER_MINUTE = 60.0


def measured_torque(
    tau_Nm: Array,
    q_rad: Array,
    limit_Nm: Array,
    plant_model: PlantModel,
    rng: np.random.Generator,
) -> Array:
    """Return link-side joint torques as strain gauges report them, shape (n, 7).

    Args:
        tau_Nm: True torques, shape (n, 7).
        q_rad: True positions, shape (n, 7).
        limit_Nm: Ranges of the gauges, shape (7,).
        plant_model: States the errors.
        rng: Draws them.
    """
    sensor = TorqueSensor(tau_Nm.shape, limit_Nm, plant_model, rng)
    lagging = tau_Nm
    if plant_model.torque_hysteresis > 0.0:
        lagging = backlash(tau_Nm, sensor.backlash_Nm)
    return sensor.reading(tau_Nm, lagging, q_rad, slice(None))


class TorqueSensor:
    """The strain gauges of all joints, with everything that is drawn for n ticks.

    Attributes:
        backlash_Nm: Half-width of their hysteresis, shape (7,); zero for none.
    """

    def __init__(
        self,
        shape: tuple[int, int],
        limit_Nm: Array,
        plant_model: PlantModel,
        rng: np.random.Generator,
    ) -> None:
        """Draw errors of shape (n, 7) for joints of these effort limits."""
        # Drawn in this order: another order gives other errors for the same seed.
        joints = shape[1]
        bias = rng.uniform(
            plant_model.torque_bias_min_Nm, plant_model.torque_bias_max_Nm
        )
        self._bias_Nm = bias * rng.choice((-1.0, 1.0), bias.shape)
        self._phase_rad = rng.uniform(0.0, 2.0 * np.pi, joints)
        # Linear drift, a random walk and the warming up, as fractions of the limit.
        minutes = np.arange(shape[0]) * (TICK_s / SECONDS_PER_MINUTE)
        rate = plant_model.torque_drift_std_per_min * rng.standard_normal(joints)
        minute_walk = plant_model.torque_random_walk_std_per_sqrt_min
        step = minute_walk * np.sqrt(TICK_s / SECONDS_PER_MINUTE)
        walk = np.cumsum(step * rng.standard_normal(shape), axis=0)
        factor = drawn_factors(plant_model, (joints,), rng)
        drift = factor * (minutes[:, None] * rate + walk - walk[0])
        if plant_model.torque_warm_up != 0.0:
            cold = np.exp(-np.arange(shape[0]) * TICK_s / plant_model.warm_up_s)
            sign = rng.choice((-1.0, 1.0), joints)
            drift = drift + plant_model.torque_warm_up * sign * cold[:, None]
        self._drift_Nm = limit_Nm * drift
        white = rng.standard_normal(shape)
        noise = coloured(white, TICK_s, plant_model.torque_noise_correlation_s)
        self._noise_Nm = np.array(plant_model.torque_noise_std_Nm) * noise
        self._plant_model = plant_model
        self._limit_Nm = limit_Nm
        self.backlash_Nm = plant_model.torque_hysteresis * limit_Nm
        if plant_model.torque_nonlinearity > 0.0:
            size = rng.uniform(size=joints)
            bow = rng.uniform(-1.0, 1.0, joints)
            self._bend = size * rng.choice((-1.0, 1.0), joints), bow

    def reading(
        self, tau_Nm: Array, lagging_Nm: Array, q_rad: Array, ticks: int | slice
    ) -> Array:
        """Return the gauges' report at some of the n ticks.

        Args:
            tau_Nm: True torques, shape (7,) or (n, 7) like the result.
            lagging_Nm: The same behind the hysteresis, see `backlash`.
            q_rad: True positions.
            ticks: Which of the n ticks.
        """
        reading_Nm = lagging_Nm
        plant_model = self._plant_model
        if plant_model.torque_ripple > 0.0:
            angle = 2.0 * np.array(LWR_GEAR_RATIO) * q_rad + self._phase_rad
            ripple_Nm = plant_model.torque_ripple * self._limit_Nm
            reading_Nm = reading_Nm + ripple_Nm * np.sin(angle)
        if plant_model.torque_nonlinearity > 0.0:
            # A smooth deviation from a straight line, at most 1 for loads from -1 to 1:
            # bow and S, Chebyshev polynomials of second and third degree, in parts
            # given by the bow.
            load = tau_Nm / self._limit_Nm
            size, bow = self._bend
            bent = bow * (2.0 * load**2 - 1.0)
            bent = size * (bent + (1.0 - np.abs(bow)) * (4.0 * load**3 - 3.0 * load))
            bend_Nm = plant_model.torque_nonlinearity * self._limit_Nm
            reading_Nm = reading_Nm + bend_Nm * bent
        return (
            reading_Nm + self._bias_Nm + self._drift_Nm[ticks] + self._noise_Nm[ticks]
        )


def backlash(signal: Array, half_width: Array) -> Array:
    """Return the output of a play operator, shape (n, k).

    The output rests until the input has moved by the half-width, then follows.

    It starts on the signal, shape (n, k), and stays within the half-width, shape (k,),
    of it.
    """
    edges = zip(signal - half_width, signal + half_width, strict=True)
    rows = accumulate(edges, lambda held, edge: held.clip(*edge), initial=signal[0])
    return np.array(list(rows)[1:])


def measured_position(
    q_rad: Array, plant_model: PlantModel, rng: np.random.Generator
) -> Array:
    """Return joint positions with noise, rounded to the encoder's step, (n, 7)."""
    noisy = q_rad + plant_model.position_noise_std_rad * rng.standard_normal(
        q_rad.shape
    )
    step = plant_model.position_step_rad
    return np.round(noisy / step) * step if step > 0.0 else noisy


def measured_velocity(
    dq_rad_s: Array, plant_model: PlantModel, rng: np.random.Generator
) -> Array | None:
    """Return joint velocities with noise, shape (n, 7).

    None on an interface that reports none.
    """
    std = plant_model.velocity_noise_std_rad_s
    return None if std is None else dq_rad_s + std * rng.standard_normal(dq_rad_s.shape)


def measured_wrench(
    wrench: Array, plant_model: PlantModel, rng: np.random.Generator
) -> Array:
    """Return the reading of the F/T sensor at the needle's base, (n, 6), N and Nm.

    Noise and a linear drift from zero: the sensor was biased without load.
    """
    minutes = np.arange(len(wrench)) * (TICK_s / SECONDS_PER_MINUTE)
    rate = np.array(plant_model.ft_drift_std_per_min) * rng.standard_normal(
        wrench.shape[1]
    )
    white = rng.standard_normal(wrench.shape)
    noise = coloured(white, TICK_s, plant_model.ft_noise_correlation_s)
    return wrench + minutes[:, None] * rate + np.array(plant_model.ft_noise_std) * noise


def time_stamps(
    true_s: Array, plant_model: PlantModel, rng: np.random.Generator
) -> Array:
    """Return the time stamps of samples taken on the tick, shape (n,).

    They are the true instants but for the jitter of the clock.
    """
    # Largest error of a time stamp; below one half stamps keep their order.
    max_jitter_ticks = 0.4
    error = plant_model.clock_jitter_std_s * rng.standard_normal(true_s.shape)
    return true_s + np.clip(
        error, -max_jitter_ticks * TICK_s, max_jitter_ticks * TICK_s
    )


def received_samples(
    count: int, plant_model: PlantModel, rng: np.random.Generator
) -> NDArray[np.intp]:
    """Return the indices of the samples that arrive, ascending.

    Of `count` ticks the first and the last always do.
    """
    sent = np.arange(0, count, plant_model.ticks_per_sample)
    is_received = np.ones(len(sent), dtype=bool)
    starts = np.flatnonzero(rng.random(len(sent)) < plant_model.drop_probability)
    lengths = rng.integers(1, plant_model.drop_max_samples, len(starts), endpoint=True)
    for start, length in zip(starts, lengths, strict=True):
        is_received[start : start + length] = False
    is_received[[0, -1]] = True
    return sent[is_received]
