"""`needleforce register --transform`: a registration that another program made."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy import (
    Labels,
    Registration,
    RegistrationError,
    read_transform,
)
from needleforce.anatomy.transform_file import RigidTransform, TransformSource
from needleforce.cli.patient.case_files import case_of_plan, read_plan_fields
from needleforce.cli.patient.register_report import FitReport, skin_distances_m
from needleforce.cli.patient.register_run import (
    finish_registration,
    require_motion,
    require_std,
)
from needleforce.cli.patient.touch_file import read_touches
from needleforce.cli.terminal import CommandError, require_modules, say
from needleforce.needle_on_plan import PlannedPath

M_PER_MM = 1e-3


class StatedTransform(NamedTuple):
    """A transform, and what is known of it.

    Attributes:
        path: The file.
        source: Who wrote it.
        std_mm: Its standard deviation at the patient along each axis [mm].
        motion_mm: Of organs against the skin [mm].
        touches: Touches of the skin that it is checked with, if any.
        touch_std_mm: Of a touch [mm].
    """

    path: Path
    source: TransformSource | None
    std_mm: float | None
    motion_mm: float
    touches: Path | None
    touch_std_mm: float


def register_by_transform(
    place: Path, stated: StatedTransform, output: Path, report: Path | None
) -> int:
    """Register the patient of a plan by a transform; print a report, write the plan.

    Args:
        place: The plan.
        stated: The transform.
        output: The plan with its registration.
        report: Folder for a page, if any.

    Returns:
        The exit code.

    Raises:
        CommandError: A file or an option cannot be used, or one is missing.
        needleforce.anatomy.AnatomyError: The file holds no rigid motion, or touches of
            the skin contradict it.
    """
    require_modules("register", ("SimpleITK",))
    std_mm = _checked_std_mm(stated.std_mm)
    require_std("--touch-std", stated.touch_std_mm)
    require_motion(stated.motion_mm)
    if stated.source is None:
        raise CommandError(
            "--transform needs --transform-from slicer or itk: their files hold a "
            "motion and its inverse; see docs/how-to/segmentations.md"
        )
    fields = read_plan_fields(place)
    motion = read_transform(stated.path, stated.source)
    fit = _registration_of(motion, fields, M_PER_MM * std_mm)
    labels = case_of_plan(place).labels
    distances_m = _touch_distances_m(labels, stated, fit, std_mm)
    fit_report = FitReport(
        fit=fit,
        landmarks=(),
        touch_distances_m=tuple(distances_m.tolist()),
        entry_m=np.array(fields["entry_m"]),
        target_m=np.array(fields["target_m"]),
        motion_m=M_PER_MM * stated.motion_mm,
    )
    return finish_registration(place, fields, labels, fit_report, output, report)


def _checked_std_mm(std_mm: float | None) -> float:
    """Return the deviation of a transform, which no file states."""
    if std_mm is None:
        raise CommandError(
            "--transform needs --transform-std: its standard deviation at the patient "
            "along each axis in millimetres, which the file does not state"
        )
    require_std("--transform-std", std_mm)
    return std_mm


def _registration_of(
    motion: RigidTransform, fields: Mapping[str, Any], std_m: float
) -> Registration:
    """Return the registration of a transform with one deviation at the patient."""
    entry_m = motion.rotation @ np.array(fields["entry_m"]) + motion.translation_m
    target_m = motion.rotation @ np.array(fields["target_m"]) + motion.translation_m
    path = PlannedPath.of_std(entry_m, target_m, std_m)
    return Registration(
        rotation=motion.rotation,
        translation_m=motion.translation_m,
        covariance=path.covariance,
        pivot_m=path.pivot_m,
        degrees=np.inf,
        residual_rms_m=np.nan,
    )


def _touch_distances_m(
    labels: Labels, stated: StatedTransform, fit: Registration, std_mm: float
) -> Array:
    """Return how far touches lie from the skin under a transform, shape (n,) [m].

    Args:
        labels: The segmentation of the plan, with the body.
        stated: The transform, and the file of touches, if any.
        fit: Its registration.
        std_mm: Standard deviation of the transform along each axis [mm].

    Raises:
        CommandError: The file holds no touches of the skin.
        RegistrationError: The touches contradict the transform.
    """
    # Touches further from the skin than so many standard deviations contradict the
    # transform.
    max_stds = 3.0
    if stated.touches is None:
        say("warning: the transform was not checked: --touches FILE checks it")
        return np.zeros(0)
    touches_m = read_touches(stated.touches).skin_m()
    if not len(touches_m):
        raise CommandError(
            f"{stated.touches} holds no touches of the skin: expected one or "
            "more; without --touches the transform is not checked"
        )
    distances_m = skin_distances_m(fit, labels.skin(), touches_m)
    expected_mm = float(np.hypot(std_mm, stated.touch_std_mm))
    rms_mm = float(np.sqrt((distances_m**2).mean())) / M_PER_MM
    if rms_mm > max_stds * expected_mm:
        raise RegistrationError(
            f"the touches lie {rms_mm:.1f} mm (rms) from the skin under this "
            f"transform, and {expected_mm:.1f} mm are expected by --transform-std and "
            "--touch-std: it is the inverse, in other axes, of another patient, or "
            "less accurate than stated",
            "Name the other source if the transform may be the inverse; "
            "check that it belongs to this CT and that the patient has not "
            "moved, or register by landmarks.",
        )
    return distances_m
