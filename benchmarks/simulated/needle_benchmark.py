"""A simulated needle without an arm: the identification alone, at half a second a run."""

from dataclasses import replace

import numpy as np

from benchmarks.benchmark import Findings
from benchmarks.charts.run_drawings import identification_drawings
from benchmarks.job import Job, Progress
from benchmarks.metrics.identification_metrics import Signals, identification_metrics, identify_all
from benchmarks.signals.insertion_truth import truth_of_needle
from benchmarks.signals.needle_signal import NeedleSignal
from groundtruth import ForceNoise, NeedleRun, Scenario, insert_needle
from groundtruth.force_noise import MINI45

NEEDLE = "needle"
"""The plant of a needle-only simulation."""
NOISE_FACTOR = (0.5, 2.0)
"""Range of the noise of drawn runs, of white noise and drift each: a better and a worse sensor."""


def run_needle(job: Job, chosen: Scenario, progress: Progress, *, is_drawn: bool) -> Findings:
    """Insert, identify by both methods, measure, draw.

    Args:
        job: What to do; its seed is that of the noise.
        chosen: The scenario; without tissue there is nothing to identify.
        progress: Told the share done.
        is_drawn: Whether the noise level is drawn with the scenario.
    """
    if not chosen.layers:
        return Findings([])
    noise = drawn_noise(np.random.default_rng([job.seed, 1])) if is_drawn else MINI45
    run = insert_needle(chosen, seed=job.seed, noise=noise)
    progress(0.2)
    truth, signal = truth_of_needle(run), _signal(run)
    signals: Signals = {"default": signal, "paper": signal}
    identified = identify_all(signals, truth)
    measured = list(identification_metrics(signals, identified, truth))
    if job.drawings is None:
        return Findings(measured)
    found = [(signals, identified)]
    commanded = chosen.motion.speed_m_s(truth.t_s)
    return Findings(measured, identification_drawings(job, job.drawings, truth, commanded, found))


def drawn_noise(rng: np.random.Generator) -> ForceNoise:
    """A sensor somewhat better or worse than the catalogued one."""
    white, drift = np.exp(rng.uniform(*np.log(NOISE_FACTOR), size=2)).tolist()
    return replace(
        MINI45,
        white_std_N=white * MINI45.white_std_N,
        drift_std_N_per_s=drift * MINI45.drift_std_N_per_s,
    )


def _signal(run: NeedleRun) -> NeedleSignal:
    """The zero of depth is where the tare ended: a user does not know the surface."""
    zero = run.depth_m[int(np.searchsorted(run.t_s, run.tare_end_s))]
    return NeedleSignal(
        source="ft",
        t_s=run.t_s,
        depth_m=run.depth_m - zero,
        speed_m_s=run.speed_m_s,
        force_N=run.force_N,
    )
