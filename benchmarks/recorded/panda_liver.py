"""``panda-liver``: a real tissue force on a real arm.

The recorded Panda has touched nothing, the recorded needle had no robot. Both are put together: a
force F on the flange makes the joints feel ``J' F``, and what they measure less than they would
without it is just that, ``tau = tau_free - J' F``. Tissue that resists with f pushes along minus
the flange's z axis, so ``tau = tau_free + f J_z'``.

The whole chain runs on it: joint signals in, enhanced force out, beside the same force as an F/T
sensor would have read it. Only the depth is the recorded needle's: the Panda moves otherwise.
"""

from dataclasses import replace

import numpy as np

from benchmarks.benchmark import Findings
from benchmarks.charts.run_drawings import force_drawings
from benchmarks.drawing import Drawing
from benchmarks.job import Job, Progress, progress_part
from benchmarks.methods.sensor_settings import METHODS
from benchmarks.methods.virtual_force import virtual_force
from benchmarks.metrics.measurement import Measurement
from benchmarks.metrics.wrench_metrics import wrench_metrics
from benchmarks.recorded.liver import LiverInsertion, REST_s, read_liver
from benchmarks.recorded.panda import Panda, read_panda
from benchmarks.recorded.panda_liver_told import told_values
from benchmarks.signals.force_truth import ForceTruth
from benchmarks.signals.tool_jacobians import tool_jacobians

TARE_s = 4.0
"""Free motion before the tare."""
FREE_s = 1.0
"""Free motion between tare and insertion: about the rest at the start of every liver recording,
from which the identifiers learn the noise of the force. 16 s are left, 80 mm at 5 mm/s."""
NOT_TOLD = "wrench_lag_ms"
"""The force changes less than this arm's noise: its lag would be a guess."""


def run_panda_liver(job: Job, progress: Progress) -> Findings:
    """Recover axial force, ruptures and friction of one liver insertion by both methods.

    Raises:
        DataError: A recording is missing or broken.
    """
    data = job.recordings
    panda, insertion = read_panda(data), read_liver(data, job.seed, as_recorded=True)
    truth = _truth(panda, insertion)
    along = tool_jacobians(panda.robot, panda.signals.q_rad)[:, 2]
    loaded = panda.signals.tau_Nm + truth.axial_N[:, None] * along
    signals = replace(panda.signals, tau_Nm=loaded)
    readings = []
    for k, (method, config) in enumerate(METHODS.items()):
        part = progress_part(progress, k / len(METHODS), (k + 1) / len(METHODS))
        real = replace(config, friction=panda.friction)
        readings.append(virtual_force(panda.robot, signals, real, method, TARE_s, part))
    drawings: tuple[Drawing, ...] = ()
    if job.drawings is not None:
        drawings = force_drawings(job, job.drawings, truth, readings)
    found: list[Measurement] = []
    for reading in readings:
        found += [item for item in wrench_metrics(reading, truth) if item.metric != NOT_TOLD]
    found += told_values(insertion, truth, readings)
    return Findings(found, drawings)


def _truth(panda: Panda, insertion: LiverInsertion) -> ForceTruth:
    """The liver's force at the Panda's time stamps: none before the insertion."""
    t_s = panda.signals.t_s
    since = t_s - TARE_s
    force_N = insertion.force_N - np.mean(insertion.force_N[insertion.t_s < REST_s])
    return ForceTruth(
        t_s=t_s,
        depth_m=np.interp(since, insertion.t_s, insertion.depth_m, left=0.0),
        axial_N=np.interp(since, insertion.t_s, force_N, left=0.0),
        zeroed_s=TARE_s,
        start_s=TARE_s + FREE_s,
        end_s=float(t_s[-1]),
    )
