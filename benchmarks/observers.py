"""``observers``: three observers of the external torque on the same samples, at equal noise.

Each is judged at the best of a few settings of its own, on the axial force of one insertion (the
paper's Figure 5), by what noise and lag leave: errors slower than 3 s, the offset's, are the same
for all and taken out.
"""

from collections.abc import Iterable

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter1d

from benchmarks.benchmark import Findings, Job, Progress
from benchmarks.metric_catalogue import Measurement
from benchmarks.signals import tool_jacobians
from groundtruth import PLANT_MODELS, PlantModel, Run, simulate
from residual import KalmanObserver, MomentumObserver

SCENARIO = "gel-70-constant"
SLOW_SAMPLES = 3001
GAINS_per_s = (20.0, 30.0, 50.0, 70.0)
WALKS_per_sqrt_s = (1.0, 2.0, 4.0)
"""Random walk of the external torque in units of a joint's torque noise, for the Kalman form."""

Array = NDArray[np.float64]


def run_observers(job: Job, progress: Progress) -> Findings:
    """Best error of every observer; nothing on an arm without velocities or without noise."""
    level = PLANT_MODELS[job.plant]
    if not level.velocity_noise_std_rad_s:
        progress(1.0)
        return Findings([])
    run = simulate(SCENARIO, job.plant, job.seed)
    weights = _axial_weights(run, np.array(level.torque_noise_std_Nm))
    progress(0.3)
    found = []
    for k, (name, observers) in enumerate(_observers(run, level).items()):
        errors = [_error(run, weights, observer) for observer in observers]
        found.append(
            Measurement("virtual", "default", f"observer_{name}_rmse_N", float(min(errors)))
        )
        progress(0.3 + 0.7 * (k + 1) / 3)
    return Findings(found)


def _observers(
    run: Run, level: PlantModel
) -> dict[str, Iterable[MomentumObserver | KalmanObserver]]:
    robot, noise = run.robot, np.array(level.torque_noise_std_Nm)
    speed_noise = level.velocity_noise_std_rad_s or 0.0
    smoothed = [MomentumObserver(robot, gain, alignment="hold") for gain in GAINS_per_s]
    for observer in smoothed:
        observer.smooth_momentum(np.full(robot.nv, speed_noise), run.signals.q_rad[0])
    return {
        "momentum": [MomentumObserver(robot, gain, alignment="hold") for gain in GAINS_per_s],
        "smoothed": smoothed,
        "kalman": [
            KalmanObserver(
                robot,
                torque_noise_Nm=noise,
                velocity_noise_rad_s=speed_noise,
                walk_Nm_per_sqrt_s=walk * noise,
                alignment="hold",
            )
            for walk in WALKS_per_sqrt_s
        ],
    }


def _axial_weights(run: Run, noise: Array) -> Array:
    """Weights of the joints in the axial force at every sample, shape (n, 7)."""
    weights = []
    for along in tool_jacobians(run.robot, run.signals.q_rad)[:, 2]:
        pushed = -along / noise**2
        weights.append(pushed / (pushed @ -along))
    return np.array(weights)


def _error(run: Run, weights: Array, observer: MomentumObserver | KalmanObserver) -> float:
    """Root mean square of the quick part of the axial error in contact [N]."""
    sent, truth = run.signals, run.truth
    assert sent.dq_rad_s is not None, "this arm sends velocities"
    samples = zip(sent.q_rad, sent.dq_rad_s, sent.tau_Nm, strict=True)
    torque = np.array([observer.update(*sample, 1e-3) for sample in samples])
    error = np.vecdot(weights, torque) - truth.axial_N
    quick = error - uniform_filter1d(error, SLOW_SAMPLES)
    touching = (truth.t_s >= run.contact_s) & (truth.t_s <= run.withdrawn_s)
    return float(np.sqrt(np.mean(quick[touching] ** 2)))
