"""`needleforce register`: where the patient of a plan lies in the robot's base."""

from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from scipy.special import fdtri

from foundation.arrays import Array
from needleforce.anatomy import (
    FreeSpace,
    Labels,
    PlanError,
    Registration,
    RegistrationError,
    Surface,
    fit_landmarks,
    fit_surface,
    read_transform,
    require_clear_path,
    require_lps,
)
from needleforce.anatomy.landmarks import (
    MIN_VERIFIED,
    LandmarkResidual,
    judge_landmarks,
)
from needleforce.anatomy.markups import RAS_TO_LPS, read_markup
from needleforce.anatomy.registration import MAX_DEGREES
from needleforce.anatomy.surface_fit import MIN_TOUCHES
from needleforce.cli.patient.case_files import (
    MODULES,
    NOT_MEDICAL,
    TouchFile,
    case_of_plan,
    read_plan_fields,
    read_touches,
    relative_path,
    write_plan_fields,
)
from needleforce.cli.patient.options import RegisterOptions
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

MAX_STD_mm = 50.0
"""Larger ones are not in millimetres."""


def register_plan(place: Path, options: RegisterOptions, output: Path) -> int:
    """Register the patient of a plan by landmarks and touches, or by a transform.

    Args:
        place: The plan.
        options: What the registration rests on.
        output: The plan with its registration.

    Returns:
        The exit code.

    Raises:
        CommandError: A file or an option cannot be used.
        needleforce.anatomy.AnatomyError: Landmarks or touches do not fit, or the file
            holds no rigid motion; the path comes too near to an obstacle.
    """
    require_modules("register", MODULES)
    _require_mm("--landmark-std", options.landmark_std, 1e-3)
    _require_mm("--touch-std", options.touch_std, 1e-3)
    _require_mm("--motion", options.motion)
    _require_mm("--softness", options.softness)
    fields = read_plan_fields(place)
    touched = TouchFile(version=1)
    if options.touches is not None:
        touched = read_touches(options.touches)
    touches_m = np.array(touched.touches_m, dtype=float).reshape(-1, 3)
    residuals: list[LandmarkResidual] = []
    if options.transform is not None:
        fit = _fit_of_transform(fields, options)
        labels = case_of_plan(place).labels
        skin = labels.skin()
        _require_touched_skin(fit, skin, touches_m, options)
    else:
        rough, residuals, model_m = _fit_by_landmarks(touched, options)
        if options.landmarks_only:
            touches_m = touches_m[:0]
        elif len(touches_m) < MIN_TOUCHES:
            raise CommandError(
                f"{len(touches_m)} touches of the skin: expected {MIN_TOUCHES} or "
                "more; --landmarks-only goes without, by the landmarks alone"
            )
        labels = case_of_plan(place).labels
        skin = labels.skin()
        names = [one.name for one in residuals]
        touched_m = rough.to_model(touches_m)
        entry_m = np.array(fields["entry_m"])
        shown = require_lps(model_m, skin, names, touches_m=touched_m, entry_m=entry_m)
        warn([*shown, *_doubts(residuals)])
        fit = rough
        if not options.landmarks_only:
            with progress_bar("fitting the touches to the skin"):
                fit = fit_surface(
                    skin,
                    touches_m,
                    rough,
                    touch_std_m=M_PER_MM * options.touch_std,
                    softness_m=M_PER_MM * options.softness,
                )
    distances_m = _skin_distances_m(fit, skin, touches_m)
    motion_m = M_PER_MM * options.motion
    added = _fit_fields(fields, fit, residuals, distances_m, motion_m)
    rows = _rows(fit, residuals, distances_m, added)
    write_out(f"{aligned(rows.items())}{NOT_MEDICAL}\n")
    _require_clear_path(fields, labels, fit)
    folder = place if place.is_dir() else place.parent
    moved = {
        key: relative_path(folder / fields[key], output.parent)
        for key in ("ct", "labels", "structures")
        if isinstance(fields.get(key), str) and fields[key]
    }
    write_plan_fields(output, {**fields, **added, **moved})
    write_out(f"{output}\n")
    say(f"next: needleforce live ARM --plan {output} --view")
    return 0


def _require_mm(option: str, value_mm: float, low: float = 0.0) -> None:
    """Refuse a length that is too small, or not in millimetres.

    Raises:
        CommandError: It is.
    """
    if not low <= value_mm < MAX_STD_mm:
        raise CommandError(
            f"{option} {value_mm:g}: expected millimetres, from {low:g} to "
            f"{MAX_STD_mm:g}"
        )


def _fit_by_landmarks(
    touched: TouchFile, options: RegisterOptions
) -> tuple[Registration, list[LandmarkResidual], Array]:
    """Return the fit of the landmarks that were touched, and their places in the CT."""
    if options.touches is None or options.landmarks is None:
        raise CommandError("expected --landmarks and --touches, or --transform")
    markup = read_markup(options.landmarks)
    place_by_name = dict(zip(markup.names, markup.points_m, strict=True))
    names = [one.name for one in touched.landmarks]
    if len({*names}) < len(names) or not place_by_name.keys() >= {*names}:
        raise CommandError(
            f"{options.touches} has landmarks {', '.join(names)}: expected each once, "
            f"of those in {options.landmarks}: {', '.join(markup.names)}"
        )
    model_m = np.array([place_by_name[name] for name in names]).reshape(-1, 3)
    if options.negate_xy:
        model_m = model_m * RAS_TO_LPS
    robot_m = np.array([one.place_m for one in touched.landmarks]).reshape(-1, 3)
    std_m = M_PER_MM * options.landmark_std
    fit = fit_landmarks(model_m, robot_m, std_m=std_m, is_std_known=True)
    return fit, judge_landmarks(model_m, robot_m, std_m, names), model_m


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


def _fit_of_transform(
    fields: Mapping[str, Any], options: RegisterOptions
) -> Registration:
    """Return the registration of a transform with one deviation at the patient."""
    if options.transform_from is None or options.transform_std is None:
        raise CommandError(
            "--transform needs --transform-from slicer or itk, whose files hold a "
            "motion and its inverse, and --transform-std, its deviation at the "
            "patient along each axis in mm; see docs/how-to/segmentations.md"
        )
    _require_mm("--transform-std", options.transform_std, 1e-3)
    if options.landmarks or options.negate_xy or options.landmarks_only:
        raise CommandError(
            "--transform stands in place of --landmarks: leave that, --negate-xy and "
            "--landmarks-only out"
        )
    motion = read_transform(str(options.transform), options.transform_from)
    ends_m = np.array([fields["entry_m"], fields["target_m"]]) @ motion.rotation.T
    ends_m = ends_m + motion.translation_m
    path = PlannedPath.of_std(ends_m[0], ends_m[1], M_PER_MM * options.transform_std)
    return Registration(
        rotation=motion.rotation,
        translation_m=motion.translation_m,
        covariance=path.covariance,
        pivot_m=path.pivot_m,
        degrees=np.inf,
        residual_rms_m=np.nan,
    )


def _require_touched_skin(
    fit: Registration, skin: Surface, touches_m: Array, options: RegisterOptions
) -> None:
    """Refuse touches of the skin that contradict a transform."""
    # Touches further from the skin than so many standard deviations do.
    max_stds = 3.0
    if not len(touches_m):
        say("warning: the transform was not checked: --touches FILE checks it")
        return
    distances_m = _skin_distances_m(fit, skin, touches_m)
    rms_mm = float(np.sqrt((distances_m**2).mean())) / M_PER_MM
    expected_mm = float(np.hypot(options.transform_std or 0.0, options.touch_std))
    if rms_mm > max_stds * expected_mm:
        raise RegistrationError(
            f"the touches lie {rms_mm:.1f} mm (rms) from the skin under this "
            f"transform, and {expected_mm:.1f} mm are expected by --transform-std and "
            "--touch-std: it is the inverse (--transform-from), in other axes, of "
            "another patient, or less accurate than stated"
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
) -> dict[str, str]:
    """Return the text of every line of the report, by its label."""
    level = 0.95  # of the region at the target
    rows: dict[str, str] = {}
    for one in residuals:
        text = f"residual {one.left_m / M_PER_MM:.1f} mm"
        if np.isfinite(one.left_out_m):
            text += f", {one.left_out_m / M_PER_MM:.1f} mm from where the others put it"
        if np.isfinite(one.probability):
            text += f" (p = {one.probability:.2g})"
        rows[f"landmark {one.name}"] = text
    sizes_mm = np.abs(distances_m) / M_PER_MM
    if len(sizes_mm):
        rows[f"{len(sizes_mm)} touches of the skin"] = (
            f"half within {np.median(sizes_mm):.1f} mm, 9 of 10 within "
            f"{np.quantile(sizes_mm, 0.9):.1f} mm, largest {sizes_mm.max():.1f} mm "
            f"(touch {int(sizes_mm.argmax()) + 1})"
        )
    if fit.indentation_std_m > 1e-6:  # of a surface that is not hard
        rows["touches press the skin in"] = (
            f"by {fit.indentation_m / M_PER_MM:.1f} ± "
            f"{fit.indentation_std_m / M_PER_MM:.1f} mm"
        )
    place = added["registration"]
    target_mm = place["target_in_base_m"] / M_PER_MM
    covariance = fit.covariance_at(fit.to_model(place["target_in_base_m"]))
    quantile = 3.0 * fdtri(3, place["degrees"], level)
    half_axes_m2 = np.maximum(np.linalg.eigvalsh(covariance)[::-1], 0.0) * quantile
    region_mm = np.sqrt(half_axes_m2) / M_PER_MM
    rows["target in the robot's base"] = (
        f"{', '.join(f'{value:.1f}' for value in target_mm)} mm"
    )
    rows["expected error at the target"] = (
        f"{place['target_error_rms_m'] / M_PER_MM:.1f} mm rms"
    )
    rows["it lies with 95 % within"] = (
        f"{' x '.join(f'{value:.1f}' for value in region_mm)} mm (half axes)"
    )
    rows["layers along the needle"] = (
        f"± {added['offset_std_m'] / M_PER_MM:.1f} mm (one standard deviation, with "
        f"the organs' motion of {place['motion_std_m'] / M_PER_MM:g} mm)"
    )
    return rows


def _require_clear_path(
    fields: Mapping[str, Any], labels: Labels, fit: Registration
) -> None:
    """Refuse what `live` would: obstacles nearer than this registration asks for.

    `plan` judged them before any registration, without its deviation.

    Raises:
        PlanError: The path comes too near to an obstacle.
    """
    ends_m = np.array([fields["entry_m"], fields["target_m"]])
    std_m = fit.largest_std_m(ends_m)
    space = FreeSpace(fields["needle_radius_m"], fields["margin_m"], std_m)
    accepted = fields.get("accepted_obstacles", ())
    clearances = labels.clearances(*ends_m)
    try:
        require_clear_path(clearances, space, accepted)
    except PlanError as error:
        raise PlanError(
            f"{error}. This registration has a std of up to {std_m / M_PER_MM:.2f} mm: "
            "touch more around the entry, landmarks further apart, or plan a path with "
            "more space (--margin, --choose)"
        ) from error
