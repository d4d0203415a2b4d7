"""Landmarks, touches and soft skin in one estimate; a patient who moves is found."""

import numpy as np
import pytest
from scipy.spatial.transform import Rotation
from scipy.special import ndtri

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("igl")

from needleforce.anatomy import (  # noqa: E402
    RegistrationError,
    SkinLandmarks,
    Surface,
    fit_landmarks,
    fit_surface,
    require_lps,
)
from needleforce.anatomy.patient_motion import _misfits  # noqa: E402

LANDMARK_STD_m = 1.5e-3
TARGET_m = np.array([0.02, 0.03, 0.01])


def trunk():
    """A body as large as a trunk, with bulges: nothing spins or slides."""
    mesh = trimesh.creation.icosphere(5, 0.15)
    x, y, z = (mesh.vertices / 0.15).T
    bulge = 1.0 + 0.12 * x + 0.15 * y**2 + 0.12 * x * z + 0.08 * np.sin(4.0 * z)
    mesh.vertices *= bulge[:, None] * [1.0, 0.7, 1.1]
    return mesh


MESH = trunk()
SKIN = Surface("skin", np.array(MESH.vertices), MESH.faces)
WAYS = [[0, -1, 0], [-1, -1, 0], [1, -1, 0.2], [0.2, -1, 1], [0, -1, -1], [-1, -1, -1]]
LANDMARKS_m = MESH.vertices[[int((MESH.vertices @ way).argmax()) for way in WAYS]]
FRONT_m = MESH.vertices[(MESH.vertices @ [0.0, -1.0, 0.0]).argmax()]


def touch(rng, indentation_m=0.0, radius_m=0.11, move=None, first=0, slips_m=None):
    """Landmarks and touches in the base, and where the target lies at the end."""
    rotation = Rotation.random(random_state=int(rng.integers(1 << 30))).as_matrix()
    shift_m = 0.5 * rng.normal(size=3)
    is_near = np.linalg.norm(MESH.triangles_center - FRONT_m, axis=1) < radius_m
    is_near &= MESH.face_normals[:, 1] < -0.35
    chosen = rng.choice(np.flatnonzero(is_near), 40)
    points_m = np.einsum(
        "nk,nkj->nj", rng.dirichlet([1, 1, 1], 40), MESH.triangles[chosen]
    )
    pressed_m = indentation_m * (1.0 + 0.4 * rng.uniform(-1.0, 1.0, (40, 1)))
    if slips_m is not None:
        pressed_m = pressed_m - slips_m
    points_m = points_m - pressed_m * MESH.face_normals[chosen]
    target_m = TARGET_m
    if move is not None:
        points_m[first:] += move
        target_m = target_m + move
    landmarks_m = LANDMARKS_m @ rotation.T + shift_m
    landmarks_m = landmarks_m + LANDMARK_STD_m * rng.normal(size=landmarks_m.shape)
    touches_m = points_m @ rotation.T + shift_m + 0.5e-3 * rng.normal(size=(40, 3))
    return landmarks_m, touches_m, rotation @ target_m + shift_m


def fit(landmarks_m, touches_m):
    rough = fit_landmarks(
        LANDMARKS_m, landmarks_m, std_m=LANDMARK_STD_m, is_std_known=True
    )
    return rough, fit_surface(SKIN, touches_m, rough, softness_m=3e-3)


@pytest.mark.parametrize("indentation_m", [0.5e-3, 3e-3])
def test_skin_that_gives_way_leaves_the_target_in_its_region(indentation_m):
    rng = np.random.default_rng(1000)
    inside = []
    errors_m = []
    for _ in range(15):
        landmarks_m, touches_m, target_m = touch(rng, indentation_m)
        _, registration = fit(landmarks_m, touches_m)
        inside.append(registration.region_contains(TARGET_m, target_m))
        errors_m.append(np.linalg.norm(registration.to_robot(TARGET_m) - target_m))

    assert sum(inside) >= 12
    assert np.median(errors_m) < 1.5e-3
    assert registration.indentation_m == pytest.approx(indentation_m, abs=1.5e-3)


@pytest.mark.parametrize("first", [0, 20])
def test_a_patient_who_moves_by_a_centimetre_is_found(first):
    rng = np.random.default_rng(1001)
    missed = 0
    for number in range(6):
        move = 0.01 * np.eye(3)[number % 3]
        landmarks_m, touches_m, target_m = touch(rng, 1.5e-3, move=move, first=first)
        try:
            _, registration = fit(landmarks_m, touches_m)
        except RegistrationError as error:
            missed += "moved" not in str(error)
        else:
            missed += not registration.region_contains(TARGET_m, target_m)

    assert missed == 0


def test_a_patient_who_moves_by_5_mm_before_the_touches_is_found_or_covered():
    rng = np.random.default_rng(1001)
    missed = 0
    for number in range(24):
        move = 0.005 * np.eye(3)[number % 3]
        landmarks_m, touches_m, target_m = touch(rng, 1.5e-3, move=move)
        try:
            _, registration = fit(landmarks_m, touches_m)
        except RegistrationError as error:
            missed += "moved" not in str(error)
        else:
            missed += not registration.region_contains(TARGET_m, target_m)

    assert missed <= 1


def test_touches_close_together_are_no_worse_than_landmarks_alone():
    rng = np.random.default_rng(1002)
    errors_m = []
    for _ in range(12):
        landmarks_m, touches_m, target_m = touch(rng, 1e-3, radius_m=0.03)
        errors_m.append(
            [
                np.linalg.norm(one.to_robot(TARGET_m) - target_m)
                for one in fit(landmarks_m, touches_m)
            ]
        )

    alone_m, together_m = np.sqrt(np.mean(np.square(errors_m), axis=0))
    assert together_m < 1.1 * alone_m


def test_last_touches_that_slipped_are_no_patient_who_moved():
    rng = np.random.default_rng(12)
    refused = 0
    for _ in range(10):
        slips_m = np.zeros((40, 1))
        slips_m[[36, 37, 38], 0] = rng.uniform(-0.02, 0.02, 3)
        landmarks_m, touches_m, _ = touch(rng, 1.5e-3, slips_m=slips_m)
        try:
            fit(landmarks_m, touches_m)
        except RegistrationError:
            refused += 1

    assert refused <= 1


def test_landmarks_of_another_ct_are_refused():
    landmarks = SkinLandmarks(LANDMARKS_m * 1.8, SKIN)

    with pytest.raises(RegistrationError, match="belong to another CT"):
        require_lps(landmarks)


def test_a_softness_in_millimetres_is_refused():
    landmarks_m, touches_m, _ = touch(np.random.default_rng(1003))
    rough = fit_landmarks(LANDMARKS_m, landmarks_m, std_m=LANDMARK_STD_m)

    with pytest.raises(RegistrationError, match=r"softness_m=3\.0.*in metres"):
        fit_surface(SKIN, touches_m, rough, softness_m=3.0)


def test_touches_that_are_off_as_usual_count_and_slipped_ones_no_further():
    std_m = 0.6e-3
    usual_m = std_m * ndtri((np.arange(400) + 0.5) / 400)
    # All touches half a standard deviation further off: a logarithm of 1/8 each, of
    # which nine tenths are left where any touch may have slipped.
    near, off = _misfits(np.abs([usual_m, usual_m + 0.5 * std_m]), std_m**2)
    assert off - near == pytest.approx(400 / 8, rel=0.12)

    near, far = _misfits(np.array([[6.0], [30.0]]) * std_m, std_m**2)
    assert far - near < 1e-3
    assert far == pytest.approx(4.5, abs=0.1)
