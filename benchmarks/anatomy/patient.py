"""Registering a patient: soft skin, touches that slipped, patients who move.

Two bodies, half of the runs on each: an analytic torso, and the body in the CT. Six
landmarks and 40 touches around the entry, as `needleforce register` gets them.
"""

import tempfile
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from benchmarks.anatomy import CT_FOLDER, draw_on, rms
from benchmarks.jobs import Figure, Job, make_figures
from foundation.arrays import Array
from needleforce.anatomy import (
    RegistrationError,
    Surface,
    fit_landmarks,
    fit_surface,
    read_labels,
    read_volume,
)
from needleforce.anatomy.markups import read_markup
from needleforce.simulation.torso_case import write_torso_case

RUNS = 200
"""Of a case on each of the bodies."""

LANDMARK_STD_m = 1.5e-3
TOUCH_STD_m = 0.5e-3
"""Along each axis; both are stated to the registration."""


class Case(NamedTuple):
    """What is simulated.

    Attributes:
        pressed_mm: How far touches press the skin in, each by this, +- 40 %.
        slipped: Part of the touches that slipped off by 5 to 20 mm.
        radius_m: Touches lie so near to the entry.
        shift_mm: The patient moves by so much in any direction, ...
        turn_deg: ... or turns about any axis through the target, ...
        first: ... before the touch of this number, 0 for before all of them.
        is_along: The shift is one to the head, where the skin says least.
    """

    pressed_mm: float = 1.5
    slipped: float = 0.0
    radius_m: float = 0.11
    shift_mm: float = 0.0
    turn_deg: float = 0.0
    first: int = 0
    is_along: bool = False


RIGHT = {
    "pressed 0 mm": Case(pressed_mm=0.0),
    "pressed 0.5 mm": Case(pressed_mm=0.5),
    "pressed 1 mm": Case(pressed_mm=1.0),
    "pressed 2 mm": Case(pressed_mm=2.0),
    "pressed 3 mm": Case(pressed_mm=3.0),
    "one in ten slipped": Case(slipped=0.1),
    "within 30 mm": Case(radius_m=0.03),
}
MOVED = {
    f"{name} {when}": case._replace(first=first)
    for name, case in {
        "5 mm": Case(shift_mm=5.0),
        "10 mm": Case(shift_mm=10.0),
        "20 mm": Case(shift_mm=20.0),
        "5 degrees": Case(turn_deg=5.0),
    }.items()
    for when, first in (("before the touches", 0), ("half-way", 20))
}
MOVED["5 mm to the head half-way"] = Case(shift_mm=5.0, first=20, is_along=True)


class Body(NamedTuple):
    """A body with a plan.

    Attributes:
        skin: Its surface.
        landmarks_m: On the skin, (6, 3).
        entry_m: On the skin, (3,).
        target_m: In the liver, (3,).
    """

    skin: Surface
    landmarks_m: Array
    entry_m: Array
    target_m: Array


class Drawn(NamedTuple):
    """What is measured in a run, and the truth.

    Attributes:
        landmarks_m: In the robot's base, (6, 3).
        touches_m: Of the skin, (40, 3).
        truth_m: Where the target lies at the end, (3,).
    """

    landmarks_m: Array
    touches_m: Array
    truth_m: Array


CASES = (*RIGHT, *MOVED)
"""A job each, so that an interrupted run goes on."""


@cache
def _bodies(data: Path | None) -> list[Body]:
    """Return the bodies, read once in a process."""
    bodies = [_torso()]
    if data is not None:
        bodies.append(_scanned_body(data / CT_FOLDER))
    return bodies


def _torso() -> Body:
    """Return the analytic torso of `needleforce demo abdomen`."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        write_torso_case(folder, seed=0)
        labels = read_labels(folder / "labels.nii.gz", folder / "labels.json")
        skin = labels.with_body(read_volume(folder / "ct.nii.gz"), fat=True).skin()
        landmarks = read_markup(folder / "landmarks.mrk.json")
    return _body(skin, landmarks.points_m, labels.centroid_m("liver"))


def _scanned_body(folder: Path) -> Body:
    """Return the body in the CT."""
    labels = read_labels(folder / "labels.nii.gz")
    skin = labels.with_body(read_volume(folder / "ct.nii.gz"), fat=True).skin()
    low_m = skin.vertices_m.min(axis=0)
    high_m = skin.vertices_m.max(axis=0)
    # Fractions of half the width and height, as the torso has them.
    left = np.array([0.0, 0.0, -0.6, 0.55, -0.6, 0.6])
    up = np.array([0.6, -0.6, 0.4, 0.35, -0.6, -0.55])
    places = np.column_stack([left, np.zeros(6), up])
    wanted_m = 0.5 * (low_m + high_m) + 0.5 * (high_m - low_m) * places
    front_m = skin.vertices_m[np.asarray(skin.mesh.vertex_normals)[:, 1] < -0.2]
    away_m = np.linalg.norm((front_m - wanted_m[:, None])[..., [0, 2]], axis=-1)
    return _body(skin, front_m[away_m.argmin(axis=1)], labels.centroid_m("liver"))


def _body(skin: Surface, landmarks_m: Array, target_m: Array) -> Body:
    """Return a body whose entry is the point of the front skin nearest to a target."""
    front_m = skin.vertices_m[np.asarray(skin.mesh.vertex_normals)[:, 1] < -0.3]
    nearest = np.linalg.norm(front_m - target_m, axis=1).argmin()
    return Body(skin, landmarks_m, front_m[nearest], target_m)


def draw(body: Body, case: Case, rng: np.random.Generator) -> Drawn:
    """Draw what is measured on a patient who lies anywhere."""
    rotation = Rotation.random(rng=rng).as_matrix()
    place_m = 0.5 * rng.normal(size=3)
    mesh: Any = body.skin.mesh
    axis = body.target_m - body.entry_m
    axis = axis / np.linalg.norm(axis)
    is_near = np.linalg.norm(mesh.triangles_center - body.entry_m, axis=1)
    is_touched = (is_near < case.radius_m) & (mesh.face_normals @ -axis > 0.35)
    areas_m2 = mesh.area_faces * is_touched
    count = 40
    points_m, normals = draw_on(mesh, areas_m2, count, rng)
    off_m = -1e-3 * case.pressed_mm * (1.0 + 0.4 * rng.uniform(-1.0, 1.0, count))
    has_slipped = rng.random(count) < case.slipped
    slips_m = rng.choice([-1.0, 1.0], count) * rng.uniform(5e-3, 20e-3, count)
    points_m = points_m + (off_m + has_slipped * slips_m)[:, None] * normals
    ways = rng.normal(size=(2, 3))
    ways /= np.linalg.norm(ways, axis=1, keepdims=True)
    turn = Rotation.from_rotvec(np.radians(case.turn_deg) * ways[0])
    shift_m = 1e-3 * case.shift_mm * ways[1]
    if case.is_along:
        shift_m = np.array([0.0, 0.0, 1e-3 * case.shift_mm])
    moved_m = turn.apply(points_m - body.target_m) + body.target_m + shift_m
    points_m[case.first :] = moved_m[case.first :]
    touches_m = points_m @ rotation.T + place_m
    landmarks_m = body.landmarks_m @ rotation.T + place_m
    return Drawn(
        landmarks_m + LANDMARK_STD_m * rng.normal(size=landmarks_m.shape),
        touches_m + TOUCH_STD_m * rng.normal(size=touches_m.shape),
        rotation @ (body.target_m + shift_m) + place_m,
    )


def run(job: Job) -> Iterator[Figure]:
    """Yield what becomes of the runs of a case."""
    name = job.case
    case = (RIGHT | MOVED)[name]
    bodies = _bodies(job.data)
    count = RUNS * len(bodies)
    rng = np.random.default_rng([job.seed, 11, CASES.index(name)])
    errors_m = []
    stated_m = []
    alone_m = []
    inside = []
    for body in bodies:
        for _ in range(RUNS):
            drawn = draw(body, case, rng)
            rough = fit_landmarks(
                body.landmarks_m,
                drawn.landmarks_m,
                std_m=LANDMARK_STD_m,
                is_std_known=True,
            )
            try:
                fit = fit_surface(
                    body.skin,
                    drawn.touches_m,
                    rough,
                    touch_std_m=TOUCH_STD_m,
                    softness_m=3e-3,
                )
            except RegistrationError:
                continue
            error_m = fit.to_robot(body.target_m) - drawn.truth_m
            errors_m.append(np.linalg.norm(error_m))
            stated_m.append(fit.tre_m(body.target_m))
            rough_m = rough.to_robot(body.target_m) - drawn.truth_m
            alone_m.append(np.linalg.norm(rough_m))
            inside.append(fit.region_contains(body.target_m, drawn.truth_m))
    if name in MOVED:
        missed = len(inside) - sum(inside)
        values = {
            "motion_found_pct": 100.0 * (1.0 - missed / count),
            "motion_refused_pct": 100.0 * (1.0 - len(inside) / count),
        }
    else:
        error_rms_m = rms(errors_m)
        values = {
            "patient_accepted_pct": 100.0 * len(inside) / count,
            "patient_region_coverage_95": np.mean(inside),
            "patient_error_rms_mm": 1e3 * error_rms_m,
            "patient_stated_ratio": rms(stated_m) / error_rms_m,
            "patient_to_landmarks_ratio": error_rms_m / rms(alone_m),
        }
    yield from make_figures(values, name)
