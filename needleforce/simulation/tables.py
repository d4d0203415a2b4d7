"""A simulated insertion as tables, whose names carry the units, for recordings."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth import NeedleRun, Run
from groundtruth.tissue import Rupture, TissueTruth


def signal_table(run: Run) -> dict[str, NDArray]:
    """Return what the robot and its F/T sensor measured, one row per sample.

    Names carry the unit. Time stamps begin at zero at the earliest; an arm that reports
    no velocities has no column of them.
    """
    signals = run.signals
    table = {"t_s": signals.t_s + _shift_s(run), "q_rad": signals.q_rad}
    if signals.dq_rad_s is not None:
        table["dq_rad_s"] = signals.dq_rad_s
    table["tau_Nm"] = signals.tau_Nm
    table["ft_force_N"] = signals.ft_wrench[:, :3]
    table["ft_torque_Nm"] = signals.ft_wrench[:, 3:]
    return table


def needle_table(run: NeedleRun) -> dict[str, Array]:
    """Return depth and reading of the force sensor, one row per sample."""
    return {"t_s": run.t_s, "depth_m": run.depth_m, "force_N": run.force_N}


def tissue_table(
    truth: TissueTruth, t_s: Array, depth_m: Array, speed_m_s: Array
) -> dict[str, NDArray]:
    """Return what happened in the tissue, one row per sample.

    `rupture` is the number of the layer that the tip begins to leave at a row, counted
    from 1, else 0; of two that rupture within one row the second stands in the next.
    `surface_rupture` is 1 where a membrane on the surface ruptures.
    """
    table: dict[str, NDArray] = {"t_s": t_s, "depth_m": depth_m, "speed_m_s": speed_m_s}
    for name in ("axial_N", "tip_N", "friction_N", "layer"):
        table[name] = getattr(truth, name)
    table["rupture"] = _rupture_marks(truth.ruptures, t_s, on_surface=False)
    table["surface_rupture"] = _rupture_marks(truth.ruptures, t_s, on_surface=True)
    if truth.layer_friction_N.shape[1]:
        table["layer_friction_N"] = truth.layer_friction_N
    return table


def truth_table(run: Run) -> dict[str, NDArray]:
    """Return the ground truth at the same samples; see `groundtruth.Truth`."""
    truth = run.truth
    table = tissue_table(truth, truth.t_s, truth.depth_m, truth.speed_m_s)
    table["t_s"] = truth.t_s + _shift_s(run)
    table["tau_ext_Nm"] = truth.external_torque_Nm
    return table


def _shift_s(run: Run) -> float:
    """Return what makes the first time stamp zero or more [s], as bags need.

    A clock with jitter may begin below zero.
    """
    return max(0.0, -float(run.signals.t_s[0]))


def _rupture_marks(
    ruptures: Sequence[Rupture], t_s: Array, *, on_surface: bool
) -> NDArray[np.int64]:
    """Return the number of the layer on the row where its rupture begins, else 0."""
    marks = np.zeros(len(t_s), dtype=np.int64)
    for rupture in ruptures:
        if (rupture.layer == 0) is not on_surface:
            continue
        row = int(np.searchsorted(t_s, rupture.onset_s))
        while row < len(marks) and marks[row]:
            row += 1
        marks[row : row + 1] = rupture.layer or 1
    return marks
