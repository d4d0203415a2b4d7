"""A needle without an arm: the tip follows the motion exactly, the base feels the tissue."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from groundtruth.errors import NoiseError, RunError
from groundtruth.force_noise import NOISES, ForceNoise
from groundtruth.scenario import Scenario
from groundtruth.scenarios import scenario as scenario_named
from groundtruth.tissue_force import TissueForce, TissueLaw
from groundtruth.tissue_truth import TissueTruth, collect_truth

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class NeedleRun:
    """Signals and truth of one needle-only insertion; all arrays are read-only, n samples.

    Attributes:
        scenario: What was run.
        seed: Of the sensor noise.
        t_s: Time, shape (n,).
        depth_m: Travel of the tip since first contact, negative above the surface, shape (n,).
        speed_m_s: Its rate, shape (n,).
        force_N: Reading of the sensor, zeroed at the end of the tare stroke, shape (n,).
        tare_end_s: Contact has not happened before this time; all that a user knows of it.
        truth: What only the simulation knows.
    """

    scenario: Scenario
    seed: int
    t_s: Array
    depth_m: Array
    speed_m_s: Array
    force_N: Array
    tare_end_s: float
    truth: TissueTruth


def insert_needle(
    scenario: Scenario | str,
    *,
    seed: int = 0,
    rate_hz: float = 1000.0,
    substeps: int = 1,
    noise: ForceNoise | str = "mini45",
) -> NeedleRun:
    """Carry out a scenario with the needle alone.

    Args:
        scenario: A scenario or the name of a catalogued one.
        seed: Seed of the sensor noise; the same seed gives the same run.
        rate_hz: Samples per second.
        substeps: Steps of the tissue law per sample.
        noise: A noise model, `mini45` or `clean`.

    Raises:
        ScenarioError: There is no scenario of that name.
        NoiseError: There is no noise model of that name.
        RunError: The rate or the number of sub-steps is unusable.
    """
    chosen = scenario_named(scenario) if isinstance(scenario, str) else scenario
    sensor = _noise_named(noise)
    t_s, fine_s = _clock(chosen.motion.duration_s, rate_hz, substeps)
    depth, speed = chosen.motion.position_m(fine_s), chosen.motion.speed_m_s(fine_s)
    law = chosen.new_tissue()
    forces = _drive(law, depth, speed, 1.0 / (rate_hz * substeps), substeps)
    depth_m, speed_m_s = depth[::substeps].copy(), speed[::substeps].copy()
    truth = collect_truth(law, t_s, depth_m, forces)
    tare_end_s = chosen.motion.tare_end_s
    rng = np.random.default_rng(seed)
    for array in (t_s, depth_m, speed_m_s):
        array.setflags(write=False)
    return NeedleRun(
        scenario=chosen,
        seed=seed,
        t_s=t_s,
        depth_m=depth_m,
        speed_m_s=speed_m_s,
        force_N=sensor.reading_N(truth.axial_N, t_s, tare_end_s, rng),
        tare_end_s=tare_end_s,
        truth=truth,
    )


def _noise_named(noise: ForceNoise | str) -> ForceNoise:
    if isinstance(noise, ForceNoise):
        return noise
    if noise not in NOISES:
        raise NoiseError(f"no noise model {noise!r}; known: {', '.join(NOISES)}, or a ForceNoise")
    return NOISES[noise]


def _clock(duration_s: float, rate_hz: float, substeps: int) -> tuple[Array, Array]:
    """Times of the samples, and of the sub-steps between the first and the last of them."""
    if not (np.isfinite(rate_hz) and rate_hz > 0.0):
        raise RunError(f"rate_hz is {rate_hz!r}; give samples per second, above zero")
    if not (isinstance(substeps, int) and substeps >= 1):
        raise RunError(f"substeps is {substeps!r}; give a whole number from 1 up")
    count = round(duration_s * rate_hz) + 1
    fine = np.arange((count - 1) * substeps + 1) / (rate_hz * substeps)
    return fine[::substeps].copy(), fine


def _drive(
    law: TissueLaw, depth_m: Array, speed_m_s: Array, dt_s: float, substeps: int
) -> list[TissueForce]:
    """The law's answer at every sample, stepping it at every sub-step."""
    step = law.step
    forces = [step(z, v, dt_s) for z, v in zip(depth_m.tolist(), speed_m_s.tolist(), strict=True)]
    return forces[::substeps]
