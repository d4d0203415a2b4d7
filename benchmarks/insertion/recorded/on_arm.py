"""Recorded forces of real tissue at the tip of the simulated arm.

The arm moves as the recorded needle did, at about its speed, and feels the recorded
force at each depth. The rows of the virtual force stand beside those of the same force
as a force sensor would have read it.
"""

from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from benchmarks.insertion.methods import run_session, wrench_metrics
from benchmarks.insertion.recorded.bovine import (
    RUPTURES_mm,
    SPEED_m_s,
    depth_metrics,
    read_bovine,
)
from benchmarks.insertion.recorded.liver import (
    OF_MANY,
    LiverEstimates,
    LiverInsertion,
    REST_s,
    friction_values,
    liver_reference,
    mean_at_depth,
    read_liver,
    rupture_values,
    summarise_estimates,
)
from benchmarks.insertion.signals import ForceTruth, JointSignals
from benchmarks.jobs import Job, Progress, progress_part
from benchmarks.results import Figure, Source, make_figures
from foundation.arrays import Array
from groundtruth import scenario, simulate
from groundtruth.motion import constant_motion
from groundtruth.recorded_tissue import RecordedTissue
from identification import Estimate, replay


class ArmInsertion(NamedTuple):
    """What the arm made of a recorded force, from the tare to the deepest point.

    Attributes:
        depth_m: Depth in the recording, shape (n,).
        force_N: Force that acted on the tip, shape (n,).
        estimates: By the virtual force and by the force itself, n each.
        force_values: Metrics of the virtual force.
    """

    depth_m: Array
    force_N: Array
    estimates: dict[Source, Sequence[Estimate]]
    force_values: list[Figure]


def insert_arm(
    job: Job, tissue: RecordedTissue, speed_m_s: float, progress: Progress
) -> ArmInsertion:
    """Let the arm of a job's plant feel a recorded force; identify on both forces."""
    # From the end of the tare it is 5 mm to where the recording begins.
    motion = constant_motion(
        speed_m_s=speed_m_s, depth_m=tissue.deepest_m, standoff_m=5e-3
    )
    # The needle follows the line of this scenario, whose tissue is not met.
    chosen = replace(scenario("liver-constant"), id=job.benchmark, motion=motion)
    simulating = progress_part(progress, 0.0, 0.5)
    run = simulate(chosen, job.plant, job.seed, simulating, law=tissue)
    truth = ForceTruth(
        t_s=run.truth.t_s,
        depth_m=run.truth.depth_m,
        axial_N=run.truth.axial_N,
        zeroed_s=run.tare_end_s,
        start_s=run.tare_end_s,
        end_s=motion.withdrawal_start_s,
    )
    identifying = progress_part(progress, 0.5, 1.0)
    signals = JointSignals.of_run(run)
    session = run_session(run.robot, signals, "ours", run.tare_end_s, identifying)
    begin = len(truth.t_s) - len(session.result.estimates)
    end = int(np.searchsorted(truth.t_s, motion.withdrawal_start_s))
    judged = slice(begin, end)
    depth_m = truth.depth_m[judged]
    force_N = truth.axial_N[judged]
    by_force = replay(truth.t_s[judged], depth_m, force_N).estimates
    return ArmInsertion(
        depth_m=depth_m,
        force_N=force_N,
        estimates={
            "virtual": session.result.estimates[: end - begin],
            "ft": by_force,
        },
        force_values=wrench_metrics(session.reading, truth),
    )


def tip_coverage(
    insertion: LiverInsertion, arm: ArmInsertion, estimates: Sequence[Estimate]
) -> float:
    """Return how often the tip force lies within two deviations of force less pull-out.

    That difference is the nearest to a truth that real tissue has. While the needle
    advances; nan if it never does where the pull-out force is known.
    """
    pulled_m = insertion.depth_m[insertion.withdrawal]
    pulled_N = -insertion.force_N[insertion.withdrawal]
    deepest_m = float(insertion.depth_m.max())
    # At both ends of the channel, 5 mm, the pull-out force is not yet, or no longer,
    # that of sliding friction.
    grid_m = np.arange(5e-3, deepest_m - 5e-3, 1e-3)
    pullout_N = np.array([mean_at_depth(pulled_m, pulled_N, at) for at in grid_m])
    is_known = np.isfinite(pullout_N)
    tip_N = arm.force_N - np.interp(arm.depth_m, grid_m[is_known], pullout_N[is_known])
    is_judged = (arm.depth_m > grid_m[0]) & (arm.depth_m < grid_m[-1])
    rows = [(item.tip_force_N, item.tip_force_std_N) for item in estimates]
    estimated_N, std_N = np.array(rows, dtype=float).T
    is_inside = np.abs(estimated_N - tip_N) <= 2.0 * std_N
    return float(np.mean(is_inside[is_judged])) if is_judged.any() else float("nan")


def mean_friction_error(item: LiverEstimates) -> float:
    """Return the mean error of the friction at `DEPTHS_mm`, positive if too large."""
    errors_N = np.array(item.friction_N) - np.array(item.reference[0])
    return float(np.mean(errors_N))


def run_liver(job: Job, progress: Progress) -> Iterator[Figure]:
    """Run ``liver-on-arm``: a recorded liver force at the tip, against its pull-out."""
    insertion = read_liver(job.recordings, job.seed)
    forward = insertion.before_withdrawal
    zero_N = float(np.mean(insertion.force_N[insertion.t_s < REST_s]))
    tissue = RecordedTissue(
        insertion.t_s[forward],
        insertion.depth_m[forward],
        insertion.force_N[forward] - zero_N,
    )
    # All were inserted at 5 mm/s, as their description says.
    arm = insert_arm(job, tissue, 5e-3, progress)
    reference = liver_reference(insertion, arm.depth_m, arm.force_N)
    yield from arm.force_values
    for source, estimates in arm.estimates.items():
        item = summarise_estimates(arm.depth_m, arm.force_N, estimates, reference)
        values = dict(friction_values([item])) | dict(rupture_values([item]))
        values["pullout_error_mean_N"] = mean_friction_error(item)
        values["tip_coverage_moving_2sigma"] = tip_coverage(insertion, arm, estimates)
        del values[OF_MANY]
        yield from make_figures(values, source)


def run_bovine(job: Job, progress: Progress) -> Iterator[Figure]:
    """Run ``bovine-on-arm``: the digitised bovine force at the tip, its ruptures."""
    insertion = read_bovine(job.recordings, np.random.default_rng(job.seed))
    tissue = RecordedTissue(*insertion)
    arm = insert_arm(job, tissue, SPEED_m_s, progress)
    yield from arm.force_values
    for source, estimates in arm.estimates.items():
        alarms_mm: list[float] = []
        estimated_mm: list[float] = []
        for item, depth_m in zip(estimates, arm.depth_m, strict=True):
            if item.rupture is None:
                continue
            shift_m = depth_m - item.rupture.alarm_depth_m
            alarms_mm.append(1e3 * float(depth_m))
            estimated_mm.append(1e3 * float(item.rupture.depth_m + shift_m))
        values = depth_metrics(alarms_mm, estimated_mm, RUPTURES_mm)
        yield from make_figures(values, source)
