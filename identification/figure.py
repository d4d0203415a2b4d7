"""The picture after the paper's Figure 8."""

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from identification.errors import InvalidLogError, MissingExtraError
from identification.replay import Replay

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FORCES = (
    ("axial force", "#3b8f5a", 1.0),
    ("predicted", "#d9a21b", 0.9),
    ("enhanced", "#c8553d", 1.2),
    ("tip", "#1f5fa8", 0.9),
)
_PANELS = (
    ("stiffness_N_per_m", "stiffness_std_N_per_m", "K  N/m"),
    ("friction_Ns_per_m2", "friction_std_Ns_per_m2", "B  Ns/m²"),
    ("cumulative_friction_Ns_per_m", "cumulative_friction_std_Ns_per_m", "Σ B d  Ns/m"),
)


def check_figure(path: str | Path) -> None:
    """Find out before the work what `save_figure` would refuse after it.

    Raises:
        InvalidLogError: There is no such folder.
        MissingExtraError: matplotlib is not installed.
    """
    folder = Path(path).parent
    if not folder.is_dir():
        raise InvalidLogError(f"cannot write {path}: there is no folder {folder}")
    try:
        import matplotlib.figure  # noqa: F401
    except ImportError as error:
        raise MissingExtraError(
            "--png needs matplotlib, which is not installed; "
            "install it with: pip install 'needleforce[plots]'"
        ) from error


def save_figure(path: str | Path, result: Replay, force_N: NDArray[np.float64], title: str) -> None:
    """Draw forces above; stiffness, friction and cumulative friction below.

    Continuous vertical lines mark the dated ruptures, dashed ones the compensations.

    Args:
        path: PNG file to write.
        result: Estimates.
        force_N: Axial force as recorded, shape (n,).
        title: One line above.

    Raises:
        MissingExtraError: matplotlib is not installed.
    """
    check_figure(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(2.4, 1, 1, 1))
    _draw_forces(axes[0], result, force_N)
    axes[0].set_title(title, loc="left", fontsize=10)
    for axis, (name, spread, label) in zip(axes[1:], _PANELS, strict=True):
        _draw_panel(axis, result, name, spread)
        axis.set_ylabel(label)
    for axis in axes:
        _mark_ruptures(axis, result)
        axis.grid(alpha=0.25)
    axes[-1].set_xlabel("time  s")
    figure.savefig(path, dpi=120)


def _draw_forces(axis: "Axes", result: Replay, force_N: NDArray[np.float64]) -> None:
    rows = result.estimates
    curves = (
        force_N,
        [row.predicted_force_N for row in rows],
        [row.enhanced_force_N for row in rows],
        [row.tip_force_N for row in rows],
    )
    for values, (label, color, width) in zip(curves, _FORCES, strict=True):
        axis.plot(result.t_s, values, color=color, linewidth=width, label=label)
    axis.set_ylabel("force  N")
    axis.legend(frameon=False, fontsize=9, ncols=4)


def _draw_panel(axis: "Axes", result: Replay, name: str, spread: str) -> None:
    values = np.array([getattr(row, name) for row in result.estimates])
    axis.plot(result.t_s, values, color="#1f5fa8", linewidth=1.0)
    stds = [getattr(row, spread) for row in result.estimates]
    top = float(np.percentile(values, 99)) * 1.5
    if all(std is not None for std in stds):
        band = 2.0 * np.array(stds, dtype=float)
        low, high = np.maximum(values - band, 0.0), values + band
        axis.fill_between(result.t_s, low, high, color="#1f5fa8", alpha=0.2, linewidth=0)
    axis.set_ylim(min(0.0, float(np.percentile(values, 1))), max(top, 1e-9))


def _mark_ruptures(axis: "Axes", result: Replay) -> None:
    start = float(result.t_s[0]) - result.estimates[0].time_s
    for row, time in zip(result.estimates, result.t_s, strict=True):
        if row.rupture is not None:
            axis.axvline(start + row.rupture.time_s, color="black", linewidth=0.8)
        if row.compensated is not None:
            axis.axvline(time, color="black", linewidth=0.8, linestyle="--")
