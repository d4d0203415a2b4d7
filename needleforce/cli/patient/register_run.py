"""`needleforce register`: where the patient of a plan lies in the robot's base."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any, Literal

import numpy as np
from scipy.special import fdtri

from foundation.arrays import Array
from needleforce import anatomy
from needleforce.anatomy import PlanError, Registration, RegistrationError, Surface
from needleforce.anatomy.markups import read_markup
from needleforce.anatomy.registration import (
    MAX_DEGREES,
    MIN_VERIFIED,
    LandmarkResidual,
    RigidTransform,
    judge_landmarks,
)
from needleforce.anatomy.surface_fit import MIN_TOUCHES
from needleforce.anatomy.volume import RAS_TO_LPS
from needleforce.cli.options import PointOptions, RegistrationOptions
from needleforce.cli.patient import case_files
from needleforce.cli.terminal import (
    CommandError,
    aligned,
    progress_bar,
    require_modules,
    say,
    warn,
    write_out,
)
from needleforce.needle_on_plan import PlannedPath

M_PER_MM = 1e-3


def register_plan(
    place: Path,
    output: Path,
    *,
    landmark_file: Path | None,
    touch_file: Path | None,
    transform: Path | None,
    transform_from: Literal["slicer", "itk"] | None,
    transform_std_mm: float | None,
    points: PointOptions,
    errors: RegistrationOptions,
    landmarks_only: bool,
    negate_xy: bool,
) -> int:
    """Register the patient of a plan by landmarks and touches, or by a transform.

    Args:
        place: The plan.
        output: The plan with its registration.
        landmark_file: Points of the CT.
        touch_file: What was touched.
        transform: In place of landmarks: from the CT to the robot's base.
        transform_from: Who wrote it.
        transform_std_mm: Its deviation at the patient along each axis.
        points: What a file of points or a matrix may leave unsaid.
        errors: Of landmarks, touches and organs.
        landmarks_only: Whether touches of the skin are left out.
        negate_xy: Whether x and y of the landmarks are negated.

    Returns:
        The exit code.

    Raises:
        CommandError: A file or an option cannot be used.
        needleforce.anatomy.AnatomyError: Landmarks or touches do not fit, or the file
            holds no rigid motion; the path comes too near to an obstacle.
    """
    require_modules("register", case_files.MODULES)
    fields = case_files.read_plan_fields(place)
    touched = case_files.read_touches(touch_file, points.unit)
    touches_m = np.array(touched.touches_m, dtype=float).reshape(-1, 3)
    names = [one.name for one in touched.landmarks]
    residuals: list[LandmarkResidual] = []
    model_m = np.zeros((0, 3))
    if transform is None and landmark_file is not None and touch_file is not None:
        if landmarks_only:
            touches_m = touches_m[:0]
        elif len(touches_m) < MIN_TOUCHES:
            raise CommandError(
                f"{len(touches_m)} touches of the skin: expected {MIN_TOUCHES} or "
                "more; --landmarks-only goes without, by the landmarks alone"
            )
        model_m = _places_of(names, landmark_file, points, negate_xy=negate_xy)
        robot_m = np.array([one.place_m for one in touched.landmarks]).reshape(-1, 3)
        std_m = M_PER_MM * errors.landmark_std
        fit = anatomy.fit_landmarks(model_m, robot_m, std_m=std_m, is_std_known=True)
        residuals = judge_landmarks(model_m, robot_m, std_m, names)
    elif (
        transform is None
        or transform_from is None
        or transform_std_mm is None
        or landmark_file is not None
        or negate_xy
        or landmarks_only
    ):
        raise CommandError(
            "expected --landmarks and --touches; or, without --landmarks, --negate-xy "
            "and --landmarks-only, --transform, --transform-from slicer or itk, whose "
            "files hold a motion and its inverse, and --transform-std, its deviation "
            "at the patient in mm; see docs/how-to/segmentations.md"
        )
    else:
        motion = anatomy.read_transform(transform, transform_from, points.unit)
        fit = _fit_of_transform(fields, motion, M_PER_MM * transform_std_mm)
    folder = place if place.is_dir() else place.parent
    labels = case_files.case_of_plan(fields, folder).labels
    skin = labels.skin()
    if transform is None:
        touched_m = fit.to_model(touches_m)
        entry_m = np.array(fields["entry_m"])
        shown = anatomy.require_lps(
            model_m, skin, names, touches_m=touched_m, entry_m=entry_m
        )
        warn([*shown, *_doubts(residuals)])
        if len(touches_m):
            with progress_bar("fitting the touches to the skin"):
                fit = anatomy.fit_surface(
                    skin,
                    touches_m,
                    fit,
                    touch_std_m=M_PER_MM * errors.touch_std,
                    softness_m=M_PER_MM * errors.softness,
                )
    distances_m = _skin_distances_m(fit, skin, touches_m)
    if transform is not None:
        expected_mm = np.hypot(transform_std_mm or 0.0, errors.touch_std)
        _require_touched_skin(distances_m, M_PER_MM * expected_mm.item())
    added = _fit_fields(fields, fit, residuals, distances_m, M_PER_MM * errors.motion)
    report = aligned(_rows(fit, residuals, distances_m, added))
    write_out(f"{report}{case_files.NOT_MEDICAL}\n")
    _require_clear_path(fields, labels, fit)
    moved = {
        key: case_files.relative_path(folder / fields[key], output.parent)
        for key in ("ct", "labels", "structures")
        if isinstance(fields.get(key), str) and fields[key]
    }
    case_files.write_plan_fields(output, {**fields, **added, **moved})
    write_out(f"{output}\n")
    say(f"next: needleforce live ARM --plan {output} --view")
    return 0


def _places_of(
    names: Sequence[str], file: Path, points: PointOptions, *, negate_xy: bool
) -> Array:
    """Return the places in the CT of landmarks that were touched, shape (n, 3)."""
    markup = read_markup(file, points.unit, points.frame)
    place_by_name = dict(zip(markup.names, markup.points_m, strict=True))
    if len({*names}) < len(names) or not place_by_name.keys() >= {*names}:
        raise CommandError(
            f"landmarks {', '.join(names)} were touched: expected each once, of those "
            f"in {file}: {', '.join(markup.names)}"
        )
    places_m = np.array([place_by_name[name] for name in names]).reshape(-1, 3)
    return places_m * RAS_TO_LPS if negate_xy else places_m


def _fit_of_transform(
    fields: Mapping[str, Any], motion: RigidTransform, std_m: float
) -> Registration:
    """Return the registration of a transform with one deviation at the patient."""
    ends_m = np.array([fields["entry_m"], fields["target_m"]])
    entry_m, target_m = motion.to_robot(ends_m)
    path = PlannedPath.of_std(entry_m, target_m, std_m)
    return Registration(
        rotation=motion.rotation,
        translation_m=motion.translation_m,
        covariance=path.covariance,
        pivot_m=path.pivot_m,
        degrees=np.inf,
        residual_rms_m=np.nan,
    )


def _doubts(residuals: Sequence[LandmarkResidual]) -> Iterator[str]:
    """Yield in words which landmark is probably off, or that none can be verified."""
    worst = min(residuals, key=lambda one: one.probability)
    if len(residuals) < MIN_VERIFIED:
        yield (
            f"{len(residuals)} landmarks cannot be verified: one that is off shows "
            f"only with {MIN_VERIFIED} or more"
        )
    elif worst.is_doubtful:
        yield (
            f"landmark {worst.name!r} lies {worst.left_out_m / M_PER_MM:.1f} mm from "
            f"where the others put it (p = {worst.probability:.2g}): touch it again"
        )


def _require_touched_skin(distances_m: Array, expected_m: float) -> None:
    """Refuse touches of the skin that contradict a transform."""
    # Touches further from the skin than so many standard deviations do.
    max_stds = 3.0
    if not len(distances_m):
        say("warning: the transform was not checked: --touches FILE checks it")
        return
    rms_m = float(np.sqrt((distances_m**2).mean()))
    if rms_m > max_stds * expected_m:
        raise RegistrationError(
            f"the touches lie {rms_m / M_PER_MM:.1f} mm (rms) from the skin under this "
            f"transform, and {expected_m / M_PER_MM:.1f} mm are expected by "
            "--transform-std and --touch-std: it is the inverse (--transform-from), in "
            "other axes, of another patient, or less accurate than stated"
        )


def _skin_distances_m(fit: Registration, skin: Surface, touches_m: Array) -> Array:
    """Return how far touches lie from the skin, positive outside, shape (n,)."""
    if not len(touches_m):
        return np.zeros(0)
    points_m = fit.to_model(touches_m)
    nearest_m, normals = skin.nearest(points_m)
    signed_m = ((points_m - nearest_m) * normals).sum(axis=1)
    return np.copysign(np.linalg.norm(points_m - nearest_m, axis=1), signed_m)


def _fit_fields(
    fields: Mapping[str, Any],
    fit: Registration,
    residuals: Sequence[LandmarkResidual],
    distances_m: Array,
    motion_m: float,
) -> dict[str, Any]:
    """Return what a registration adds to the plan's file."""
    entry_m = np.array(fields["entry_m"])
    target_m = np.array(fields["target_m"])
    way_m = fit.to_robot(target_m) - fit.to_robot(entry_m)
    return {
        "rotation": fit.rotation,
        "translation_m": fit.translation_m,
        "offset_std_m": float(np.hypot(fit.std_along_m(way_m, target_m), motion_m)),
        "covariance": fit.covariance,
        "pivot_m": fit.pivot_m,
        "registration": {
            "landmark_residuals_m": {one.name: one.left_m for one in residuals},
            "touch_distances_m": distances_m,
            "entry_in_base_m": fit.to_robot(entry_m),
            "target_in_base_m": fit.to_robot(target_m),
            "entry_error_rms_m": fit.tre_m(entry_m),
            "target_error_rms_m": fit.tre_m(target_m),
            "motion_std_m": motion_m,
            "degrees": min(fit.degrees, MAX_DEGREES),
            "indentation_m": fit.indentation_m,
            "indentation_std_m": fit.indentation_std_m,
        },
    }


def _rows(
    fit: Registration,
    residuals: Sequence[LandmarkResidual],
    distances_m: Array,
    added: Mapping[str, Any],
) -> Iterator[tuple[str, str]]:
    """Yield every line of the report: its label and its text."""
    level = 0.95  # of the region at the target
    for one in residuals:
        text = f"residual {one.left_m / M_PER_MM:.1f} mm"
        if np.isfinite(one.left_out_m):
            text += f", {one.left_out_m / M_PER_MM:.1f} mm from where the others put it"
        if np.isfinite(one.probability):
            text += f" (p = {one.probability:.2g})"
        yield f"landmark {one.name}", text
    sizes_mm = np.abs(distances_m) / M_PER_MM
    if len(sizes_mm):
        yield (
            f"{len(sizes_mm)} touches of the skin",
            f"half within {np.median(sizes_mm):.1f} mm, 9 of 10 within "
            f"{np.quantile(sizes_mm, 0.9):.1f} mm, largest {sizes_mm.max():.1f} mm "
            f"(touch {int(sizes_mm.argmax()) + 1})",
        )
    if fit.indentation_std_m > 1e-6:  # of a surface that is not hard
        yield (
            "touches press the skin in",
            f"by {fit.indentation_m / M_PER_MM:.1f} ± "
            f"{fit.indentation_std_m / M_PER_MM:.1f} mm",
        )
    place = added["registration"]
    target_mm = place["target_in_base_m"] / M_PER_MM
    covariance = fit.covariance_at(fit.to_model(place["target_in_base_m"]))
    quantile = 3.0 * fdtri(3, place["degrees"], level)
    half_axes_m2 = np.maximum(np.linalg.eigvalsh(covariance)[::-1], 0.0) * quantile
    region_mm = np.sqrt(half_axes_m2) / M_PER_MM
    yield (
        "target in the robot's base",
        f"{', '.join(f'{value:.1f}' for value in target_mm)} mm",
    )
    yield (
        "expected error at the target",
        f"{place['target_error_rms_m'] / M_PER_MM:.1f} mm rms",
    )
    yield (
        "it lies with 95 % within",
        f"{' x '.join(f'{value:.1f}' for value in region_mm)} mm (half axes)",
    )
    yield (
        "layers along the needle",
        f"± {added['offset_std_m'] / M_PER_MM:.1f} mm (one standard deviation, "
        f"with the organs' motion of {place['motion_std_m'] / M_PER_MM:g} mm)",
    )


def _require_clear_path(
    fields: Mapping[str, Any], labels: anatomy.Labels, fit: Registration
) -> None:
    """Refuse what `live` would: obstacles nearer than this registration asks for.

    `plan` judged them before any registration, without its deviation.

    Raises:
        PlanError: The path comes too near to an obstacle.
    """
    ends_m = np.array([fields["entry_m"], fields["target_m"]])
    std_m = fit.largest_std_m(ends_m)
    space = anatomy.FreeSpace(fields["needle_radius_m"], fields["margin_m"], std_m)
    accepted = fields.get("accepted_obstacles", ())
    clearances = labels.clearances(*ends_m)
    try:
        anatomy.require_clear_path(clearances, space, accepted)
    except PlanError as error:
        raise PlanError(
            f"{error}. This registration has a std of up to {std_m / M_PER_MM:.2f} mm: "
            "touch more around the entry, landmarks further apart, or plan a path with "
            "more space (--margin, --choose)"
        ) from error
