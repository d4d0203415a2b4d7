"""``panda-real``: the residual's noise floor on a real arm without contact."""

import numpy as np

from benchmarks.benchmark import Findings
from benchmarks.job import Job, Progress
from benchmarks.methods.joint_residual import joint_residual
from benchmarks.metrics.measurement import Measurement
from benchmarks.recorded.panda import read_panda

GAIN_per_s = 30.0
"""That of the known-good figures."""
SETTLING_LAGS = 5.0
"""After these the observer has forgotten its start to 1 %."""


def run_panda_real(job: Job, progress: Progress) -> Findings:
    """Root mean square of the settled residual, per joint.

    Raises:
        DataError: The recording is missing or broken.
    """
    panda = read_panda(job.recordings)
    signals = panda.signals
    residual = joint_residual(panda.robot, signals, GAIN_per_s, friction=panda.friction)
    settled = signals.t_s - signals.t_s[0] >= SETTLING_LAGS / GAIN_per_s
    rms = np.sqrt(np.mean(residual[settled] ** 2, axis=0))
    progress(1.0)
    return Findings(
        [
            Measurement("virtual", "default", f"residual_rms_J{joint}_Nm", float(value))
            for joint, value in enumerate(rms, 1)
        ]
    )
