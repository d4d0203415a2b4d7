"""The picture after the paper's Figure 8."""

from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from identification.command.result import IdentificationResult
from identification.errors import InvalidLogError, MissingExtraError

Columns = Mapping[str, NDArray[np.float64]]

if TYPE_CHECKING:
    from matplotlib.axes import Axes

_FORCES = (
    ("force_N", "axial force", "#3b8f5a", 1.0),
    ("predicted_force_N", "predicted", "#d9a21b", 0.9),
    ("enhanced_force_N", "enhanced", "#c8553d", 1.2),
    ("tip_force_N", "tip", "#1f5fa8", 0.9),
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


def save_figure(path: str | Path, result: IdentificationResult) -> None:
    """Draw forces above; stiffness, friction and cumulative friction below.

    Continuous vertical lines mark the dated ruptures, dashed ones the compensations.

    Args:
        path: PNG file to write.
        result: With an overview.

    Raises:
        InvalidLogError: The file cannot be written.
        MissingExtraError: matplotlib is not installed.
    """
    check_figure(path)
    from matplotlib.figure import Figure

    figure = Figure(figsize=(9, 9), layout="constrained")
    axes = figure.subplots(4, 1, sharex=True, height_ratios=(2.4, 1, 1, 1))
    _draw_forces(axes[0], result.overview)
    axes[0].set_title(f"{result.log}, method {result.method}", loc="left", fontsize=10)
    for axis, (name, spread, label) in zip(axes[1:], _PANELS, strict=True):
        _draw_panel(axis, result.overview, name, spread)
        axis.set_ylabel(label)
    for axis in axes:
        for time_s in result.ruptures_s:
            axis.axvline(time_s, color="black", linewidth=0.8)
        for time_s in result.compensations_s:
            axis.axvline(time_s, color="black", linewidth=0.8, linestyle="--")
        axis.grid(alpha=0.25)
    axes[-1].set_xlabel("time  s")
    try:
        figure.savefig(path, format="png", dpi=120)
    except OSError as error:
        raise InvalidLogError(f"cannot write {path}: {error.strerror or error}") from error


def _draw_forces(axis: "Axes", rows: Columns) -> None:
    for name, label, color, width in _FORCES:
        axis.plot(rows["t_s"], rows[name], color=color, linewidth=width, label=label)
    axis.set_ylabel("force  N")
    axis.legend(frameon=False, fontsize=9, ncols=4)


def _draw_panel(axis: "Axes", rows: Columns, name: str, spread: str) -> None:
    values, band = rows[name], 2.0 * rows[spread]
    axis.plot(rows["t_s"], values, color="#1f5fa8", linewidth=1.0)
    top = float(np.percentile(values, 99)) * 1.5
    if np.isfinite(band).all():
        low, high = np.maximum(values - band, 0.0), values + band
        axis.fill_between(rows["t_s"], low, high, color="#1f5fa8", alpha=0.2, linewidth=0)
    axis.set_ylim(min(0.0, float(np.percentile(values, 1))), max(top, 1e-9))
