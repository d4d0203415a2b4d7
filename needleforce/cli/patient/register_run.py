"""`needleforce register`: where the patient of a plan lies in the robot's base."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.anatomy import (
    FreeSpace,
    Labels,
    PlanError,
    Registration,
    SkinLandmarks,
    fit_landmarks,
    fit_surface,
    require_clear_path,
    require_lps,
)
from needleforce.anatomy.clearance import STDS
from needleforce.anatomy.landmarks import LandmarkResidual, judge_landmarks
from needleforce.anatomy.markups import RAS_TO_LPS, Markup, read_markup
from needleforce.anatomy.registration import MAX_DEGREES
from needleforce.anatomy.surface import Surface
from needleforce.anatomy.surface_fit import MIN_TOUCHES
from needleforce.cli.patient.case_files import (
    case_of_plan,
    read_plan_fields,
    relative_path,
    write_plan_fields,
)
from needleforce.cli.patient.register_report import (
    FitReport,
    describe_doubts,
    describe_fit,
    skin_distances_m,
    write_fit_page,
)
from needleforce.cli.patient.touch_file import TouchFile, read_touches
from needleforce.cli.terminal import (
    CommandError,
    require_modules,
    say,
    staged_progress,
    write_out,
)
from needleforce.plan_file import PLAN
from needleforce.plots import PAGE, whole_folder

MODULES = ("SimpleITK", "nibabel", "skimage", "manifold3d", "trimesh", "igl")
"""Modules of extras that the command needs."""

M_PER_MM = 1e-3

MAX_STD_mm = 50.0
"""Larger ones are not in millimetres."""


class Evidence(NamedTuple):
    """What a registration rests on.

    Attributes:
        landmarks: Points of the CT.
        touches: What was touched.
        landmark_std_mm: Of a landmark along each axis [mm].
        touch_std_mm: Of a touch of the skin [mm].
        softness_mm: By up to so much touches press the skin in [mm].
        motion_mm: Of organs against the skin [mm].
        landmarks_only: The touches of the skin are left out.
        is_xy_negated: The landmarks' file says LPS and holds RAS, or the reverse.
    """

    landmarks: Path
    touches: Path
    landmark_std_mm: float
    touch_std_mm: float
    softness_mm: float
    motion_mm: float
    landmarks_only: bool
    is_xy_negated: bool

    def check(self) -> None:
        """Raise `CommandError` for a deviation that cannot be."""
        require_std("--landmark-std", self.landmark_std_mm)
        require_std("--touch-std", self.touch_std_mm)
        require_motion(self.motion_mm)
        if not 0.0 <= self.softness_mm < 20.0:
            raise CommandError(
                f"--softness {self.softness_mm:g}: expected millimetres, 0 for what "
                "does not give way, and below 20"
            )


def require_std(option: str, std_mm: float) -> None:
    """Refuse a standard deviation [mm] that is not positive, or not in millimetres.

    Raises:
        CommandError: It is not.
    """
    if not 0.0 < std_mm < MAX_STD_mm:
        raise CommandError(
            f"{option} {std_mm:g}: expected millimetres, above 0 and below "
            f"{MAX_STD_mm:g}"
        )


def require_motion(motion_mm: float) -> None:
    """Refuse a motion of organs [mm] that is negative, or not in millimetres.

    Raises:
        CommandError: It is not zero or more, in millimetres.
    """
    if not 0.0 <= motion_mm < MAX_STD_mm:
        raise CommandError(
            f"--motion {motion_mm:g}: expected millimetres, 0 or more and below "
            f"{MAX_STD_mm:g}"
        )


class _Pairs(NamedTuple):
    """Landmarks in both frames.

    Attributes:
        names: Of the landmarks.
        model_m: In the CT, (n, 3).
        robot_m: In the robot's base, (n, 3).
    """

    names: tuple[str, ...]
    model_m: Array
    robot_m: Array


def register_plan(
    place: Path, evidence: Evidence, output: Path, report: Path | None
) -> int:
    """Register the patient of a plan; print the report and write the plan.

    Args:
        place: The plan.
        evidence: What the registration rests on.
        output: The plan with its registration.
        report: Folder for a page, if any.

    Returns:
        The exit code.

    Raises:
        CommandError: A file or an option cannot be used.
        needleforce.anatomy.RegistrationError: Landmarks or touches do not fit.
    """
    require_modules("register", MODULES)
    evidence.check()
    fields = read_plan_fields(place)
    touched = read_touches(evidence.touches)
    pairs = _pair_landmarks(read_markup(evidence.landmarks), touched, evidence)
    landmark_std_m = M_PER_MM * evidence.landmark_std_mm
    rough = fit_landmarks(
        pairs.model_m, pairs.robot_m, std_m=landmark_std_m, is_std_known=True
    )
    residuals = judge_landmarks(
        pairs.model_m, pairs.robot_m, landmark_std_m, pairs.names
    )
    fit = rough
    touches_m = touched.skin_m()
    if not evidence.landmarks_only:
        _require_touches(touches_m)
    labels = case_of_plan(place).labels
    skin = labels.skin()
    landmarks = SkinLandmarks(
        points_m=pairs.model_m,
        skin=skin,
        names=pairs.names,
        touches_m=rough.to_model(touches_m),
        entry_m=np.array(fields["entry_m"]),
    )
    for doubt in require_lps(landmarks):
        say(f"warning: {doubt}")
    if not evidence.landmarks_only:
        with staged_progress("fitting the touches to the skin"):
            fit = fit_surface(
                skin,
                touches_m,
                rough,
                touch_std_m=M_PER_MM * evidence.touch_std_mm,
                softness_m=M_PER_MM * evidence.softness_mm,
            )
    touched_m = touches_m[:0] if evidence.landmarks_only else touches_m
    fit_report = _report_of(fit, residuals, skin, touched_m, fields, evidence)
    for warning in describe_doubts(residuals):
        say(f"warning: {warning}")
    return finish_registration(place, fields, labels, fit_report, output, report)


def finish_registration(
    place: Path,
    fields: Mapping[str, Any],
    labels: Labels,
    fit_report: FitReport,
    output: Path,
    report: Path | None,
) -> int:
    """Print the report of a registration, judge the path, and write plan and page.

    Args:
        place: The plan.
        fields: What stands in it.
        labels: The segmentation of the plan.
        fit_report: The registration.
        output: The plan with its registration.
        report: Folder for a page, if any.

    Returns:
        The exit code.

    Raises:
        PlanError: The path comes too near to an obstacle for this registration.
    """
    write_out(describe_fit(fit_report))
    _require_clear_path(fields, labels, fit_report)
    source = place / PLAN if place.is_dir() else place
    folder = source.parent
    moved = {
        key: relative_path(folder / fields[key], output.parent)
        for key in ("ct", "labels", "structures")
        if isinstance(fields.get(key), str) and fields[key]
    }
    write_plan_fields(output, {**fields, **moved, **_fit_fields(fit_report)})
    write_out(f"{output}\n")
    with whole_folder(report) as page_folder:
        if page_folder is not None:
            write_fit_page(fit_report, page_folder)
    if report is not None:
        write_out(f"{report / PAGE}\n")
    say(f"next: needleforce live ARM --plan {output} --view")
    return 0


def _require_clear_path(
    fields: Mapping[str, Any], labels: Labels, report: FitReport
) -> None:
    """Refuse what `live` would: obstacles nearer than this registration asks for.

    `plan` judged them before any registration, without its deviation.
    """
    std_m = report.fit.largest_std_m(np.array([report.entry_m, report.target_m]))
    space = FreeSpace(fields["needle_radius_m"], fields["margin_m"], std_m)
    accepted = fields.get("accepted_obstacles", ())
    clearances = labels.clearances(report.entry_m, report.target_m)
    try:
        require_clear_path(clearances, space, accepted)
    except PlanError as error:
        gaps_m = [
            one.distance_m
            for one in clearances
            if one.is_obstacle and one.name not in accepted
        ]
        free_m = min(gaps_m) - space._replace(std_m=0.0).needed_m
        raise PlanError(
            f"{error}. This path bears a registration with a std of up to "
            f"{max(free_m / STDS, 0.0) / M_PER_MM:.2f} mm, and this one has "
            f"{std_m / M_PER_MM:.2f} mm: register again with more touches around the "
            "entry and landmarks further apart, or plan a path with more space "
            "(--margin, --choose)"
        ) from error


def _pair_landmarks(markup: Markup, touched: TouchFile, evidence: Evidence) -> _Pairs:
    """Return the landmarks that are in both files, by their names."""
    place_by_name = dict(zip(markup.names, markup.points_m, strict=True))
    names = tuple(one.name for one in touched.landmarks)
    if len(set(names)) < len(names):
        raise CommandError(
            f"{evidence.touches}: a landmark was touched twice: {', '.join(names)}",
        )
    unknown = [name for name in names if name not in place_by_name]
    if unknown:
        raise CommandError(
            f"{evidence.touches} has landmarks {', '.join(unknown)} that are not in "
            f"{evidence.landmarks}: there are {', '.join(markup.names)}",
        )
    model_m = np.array([place_by_name[name] for name in names]).reshape(-1, 3)
    if evidence.is_xy_negated:
        model_m = model_m * RAS_TO_LPS
    robot_m = np.array([one.place_m for one in touched.landmarks]).reshape(-1, 3)
    return _Pairs(names, model_m, robot_m)


def _require_touches(touches_m: Array) -> None:
    """Refuse too few touches of the skin before the CT is read."""
    if len(touches_m) < MIN_TOUCHES:
        raise CommandError(
            f"{len(touches_m)} touches of the skin: expected {MIN_TOUCHES} or more; "
            "--landmarks-only goes without, by the landmarks alone",
        )


def _report_of(
    fit: Registration,
    residuals: Sequence[LandmarkResidual],
    skin: Surface,
    touches_m: Array,
    fields: Mapping[str, Any],
    evidence: Evidence,
) -> FitReport:
    """Return what is reported of a registration."""
    distances_m: Sequence[float] = ()
    if len(touches_m):
        distances_m = skin_distances_m(fit, skin, touches_m).tolist()
    return FitReport(
        fit=fit,
        landmarks=tuple(residuals),
        touch_distances_m=tuple(distances_m),
        entry_m=np.array(fields["entry_m"]),
        target_m=np.array(fields["target_m"]),
        motion_m=M_PER_MM * evidence.motion_mm,
    )


def _fit_fields(report: FitReport) -> dict[str, Any]:
    """Return what a registration adds to the plan's file."""
    fit = report.fit
    return {
        "rotation": fit.rotation,
        "translation_m": fit.translation_m,
        "offset_std_m": report.offset_std_m,
        "covariance": fit.covariance,
        "pivot_m": fit.pivot_m,
        "registration": {
            "landmark_residuals_m": {one.name: one.left_m for one in report.landmarks},
            "touch_distances_m": report.touch_distances_m,
            "entry_in_base_m": fit.to_robot(report.entry_m),
            "target_in_base_m": fit.to_robot(report.target_m),
            "entry_error_rms_m": fit.tre_m(report.entry_m),
            "target_error_rms_m": fit.tre_m(report.target_m),
            "motion_std_m": report.motion_m,
            "degrees": min(fit.degrees, MAX_DEGREES),
            "indentation_m": fit.indentation_m,
            "indentation_std_m": fit.indentation_std_m,
        },
    }
