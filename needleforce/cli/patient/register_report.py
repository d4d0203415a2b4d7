"""What `needleforce register` reports: residuals, and the region at the target."""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np
from scipy.special import fdtri

from foundation.arrays import Array
from needleforce.anatomy import Registration
from needleforce.anatomy.landmarks import MIN_VERIFIED, LandmarkResidual
from needleforce.anatomy.registration import MAX_DEGREES
from needleforce.anatomy.surface import Surface
from needleforce.cli.patient.plan_table import NOT_MEDICAL
from needleforce.cli.terminal import aligned
from needleforce.plots import PAGE, Page, PageTable, Section, write_page

LEVEL = 0.95
"""Of the region at the target."""

M_TO_MM = 1e3


class FitReport(NamedTuple):
    """A registration, and how well everything fits.

    Attributes:
        fit: The registration.
        landmarks: How far each landmark lies from where the others put it.
        touch_distances_m: Of the touches from the skin, positive outside.
        entry_m: Of the plan, (3,) in LPS.
        target_m: Of the plan, (3,).
        motion_m: Standard deviation of organs against the skin.
    """

    fit: Registration
    landmarks: tuple[LandmarkResidual, ...]
    touch_distances_m: tuple[float, ...]
    entry_m: Array
    target_m: Array
    motion_m: float

    @property
    def axis(self) -> Array:
        """Direction of the path in the robot's base, (3,)."""
        way_m = self.fit.to_robot(self.target_m) - self.fit.to_robot(self.entry_m)
        return way_m / np.linalg.norm(way_m)

    @property
    def offset_std_m(self) -> float:
        """Deviation of the layers along the needle, with the motion of organs."""
        std_m = self.fit.std_along_m(self.axis, self.target_m)
        return float(np.hypot(std_m, self.motion_m))

    @property
    def region_m(self) -> Array:
        """Half axes of the region that holds the target with 95 %, largest first."""
        variances_m2 = np.linalg.eigvalsh(self.fit.covariance_at(self.target_m))[::-1]
        degrees = min(self.fit.degrees, MAX_DEGREES)
        quantile = 3.0 * fdtri(3, degrees, LEVEL)
        return np.sqrt(np.maximum(variances_m2, 0.0) * quantile)


def skin_distances_m(fit: Registration, skin: Surface, touches_m: Array) -> Array:
    """Return how far touches lie from the skin, positive outside, shape (n,).

    Args:
        fit: The registration.
        skin: Of the CT.
        touches_m: In the robot's base, (n, 3).
    """
    points_m = fit.to_model(touches_m)
    nearest_m, normals = skin.nearest(points_m)
    signed_m = ((points_m - nearest_m) * normals).sum(axis=1)
    return np.copysign(np.linalg.norm(points_m - nearest_m, axis=1), signed_m)


def describe_fit(report: FitReport) -> str:
    """Return a registration as a table in words."""
    return f"{aligned(_rows(report))}{NOT_MEDICAL}\n"


def describe_doubts(residuals: Sequence[LandmarkResidual]) -> list[str]:
    """Return in words which landmark is probably off, or that none can be verified."""
    if len(residuals) < MIN_VERIFIED:
        return [
            f"{len(residuals)} landmarks cannot be verified: one that is off shows "
            f"only with {MIN_VERIFIED} or more"
        ]
    worst = min(residuals, key=lambda one: one.probability)
    if not worst.is_doubtful:
        return []
    return [
        f"landmark {worst.name!r} lies {M_TO_MM * worst.left_out_m:.1f} mm from where "
        f"the others put it (p = {worst.probability:.2g}): touch it again"
    ]


def _describe_residual(one: LandmarkResidual) -> str:
    """Return the residual of a landmark in words."""
    text = f"residual {M_TO_MM * one.left_m:.1f} mm"
    if np.isfinite(one.left_out_m):
        text += f", {M_TO_MM * one.left_out_m:.1f} mm from where the others put it"
    if np.isfinite(one.probability):
        text += f" (p = {one.probability:.2g})"
    return text


def write_fit_page(report: FitReport, folder: Path) -> None:
    """Write the page of a registration into a folder."""
    touches = [
        (str(number), f"{M_TO_MM * distance_m:+.2f}")
        for number, distance_m in enumerate(report.touch_distances_m, 1)
    ]
    tables = (
        PageTable(caption="Registration", head=("what", "value"), rows=_rows(report)),
        PageTable(
            caption="Touches of the skin",
            head=("touch", "distance from the skin [mm], positive outside"),
            rows=tuple(touches),
        ),
    )
    section = Section(heading="Registration", anchor="registration", tables=tables)
    page = Page(title="Registration", lead=(NOT_MEDICAL,), sections=(section,))
    write_page(folder / PAGE, page)


def _rows(report: FitReport) -> tuple[tuple[str, str], ...]:
    """Return label and text of every line."""
    rows = [
        (f"landmark {one.name}", _describe_residual(one)) for one in report.landmarks
    ]
    if report.touch_distances_m:
        distances_mm = M_TO_MM * np.abs(report.touch_distances_m)
        rows.append(
            (
                f"{len(distances_mm)} touches of the skin",
                f"half within {np.median(distances_mm):.1f} mm, 9 of 10 within "
                f"{np.quantile(distances_mm, 0.9):.1f} mm, largest "
                f"{distances_mm.max():.1f} mm (touch {int(distances_mm.argmax()) + 1})",
            )
        )
    if report.fit.indentation_std_m > 1e-6:  # of a surface that is not hard
        rows.append(
            (
                "touches press the skin in",
                f"by {M_TO_MM * report.fit.indentation_m:.1f} ± "
                f"{M_TO_MM * report.fit.indentation_std_m:.1f} mm",
            )
        )
    target_mm = M_TO_MM * report.fit.to_robot(report.target_m)
    error_mm = M_TO_MM * report.fit.tre_m(report.target_m)
    region_mm = M_TO_MM * report.region_m
    rows += [
        (
            "target in the robot's base",
            f"{', '.join(f'{value:.1f}' for value in target_mm)} mm",
        ),
        (
            "expected error at the target",
            f"{error_mm:.1f} mm rms",
        ),
        (
            "it lies with 95 % within",
            f"{' x '.join(f'{value:.1f}' for value in region_mm)} mm (half axes)",
        ),
        (
            "layers along the needle",
            f"± {M_TO_MM * report.offset_std_m:.1f} mm (one standard deviation, with "
            f"the organs' motion of {M_TO_MM * report.motion_m:g} mm)",
        ),
    ]
    return tuple(rows)
