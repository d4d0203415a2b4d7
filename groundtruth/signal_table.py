"""A run as a table: what a robot's own recording would hold, and apart from it, what was true."""

import numpy as np
from numpy.typing import NDArray

from groundtruth.run import Run

Columns = dict[str, NDArray]


def signal_table(run: Run) -> Columns:
    """Return what the robot and its F/T sensor gave; n rows, units in the names.

    Args:
        run: The run.

    Returns:
        Time stamps (from zero on, like those of the truth), joint signals of shape (n, 7) (no
        velocities from an arm that reports none), force and torque of the sensor in its axes of
        shape (n, 3).
    """
    signals = run.signals
    columns: Columns = {"t_s": signals.t_s + _shift_s(run), "q_rad": signals.q_rad}
    if signals.dq_rad_s is not None:
        columns["dq_rad_s"] = signals.dq_rad_s
    columns["tau_Nm"] = signals.tau_Nm
    columns["ft_force_N"] = signals.ft_wrench[:, :3]
    columns["ft_torque_Nm"] = signals.ft_wrench[:, 3:]
    return columns


def truth_table(run: Run) -> Columns:
    """Return what was true at the same samples; see `Truth` for the meaning.

    `rupture` is the number of the layer that the tip begins to leave at a row, counted from 1, else
    0; of two that give way within one row the second is told at the next. `surface_rupture` is 1
    where a membrane on the surface gives way.

    Args:
        run: The run.
    """
    truth = run.truth
    columns: Columns = {
        "t_s": truth.t_s + _shift_s(run),
        "depth_m": truth.depth_m,
        "speed_m_s": truth.speed_m_s,
        "axial_N": truth.axial_N,
        "tip_N": truth.tip_N,
        "friction_N": truth.friction_N,
        "layer": truth.layer,
        "rupture": _ruptures(run, on_surface=False),
        "surface_rupture": _ruptures(run, on_surface=True),
        "tau_ext_Nm": truth.external_torque_Nm,
    }
    if truth.layer_friction_N.shape[1]:
        columns["layer_friction_N"] = truth.layer_friction_N
    return columns


def _shift_s(run: Run) -> float:
    """What makes the first stamp of a clock with jitter no less than zero, as bags want it."""
    return max(0.0, -float(run.signals.t_s[0]))


def _ruptures(run: Run, *, on_surface: bool) -> NDArray[np.int64]:
    marks = np.zeros(len(run.truth.t_s), dtype=np.int64)
    for rupture in run.truth.ruptures:
        if (rupture.layer == 0) is not on_surface:
            continue
        row = int(np.searchsorted(run.truth.t_s, rupture.onset_s))
        while row < len(marks) and marks[row]:
            row += 1
        if row < len(marks):
            marks[row] = rupture.layer or 1
    return marks
