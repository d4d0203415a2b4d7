"""Registration by landmarks and touches: its error as stated, and what is refused."""

from dataclasses import replace

import numpy as np
import pytest
import trimesh
from hypothesis import given
from hypothesis import strategies as st
from scipy import stats
from scipy.spatial.transform import Rotation

from needleforce.anatomy import (
    Registration,
    RegistrationError,
    Surface,
    fit_landmarks,
    fit_surface,
    judge_landmarks,
    require_lps,
)
from tests.needleforce.anatomy.made_files import refused_if

FRONT_m = 1e-3 * np.array(
    [[-90, -60, 60], [110, 5, -75], [0, -110, 40], [-120, 10, -80], [85, -65, 70],
     [10, -105, -90]]
)  # fmt: skip
TARGET_m = np.array([-0.03, 0.0, 0.01])
RAS = np.array([-1.0, -1.0, 1.0])


def touched(points_m, rng, std_m=0.5e-3):
    """Points in the base of a robot, with noise, and where the patient lies in it."""
    rotation = Rotation.random(rng=rng).as_matrix()
    shift_m = 0.5 * rng.normal(size=3)
    places_m = points_m @ rotation.T + shift_m + std_m * rng.normal(size=points_m.shape)
    return places_m, (rotation, shift_m)


@pytest.mark.parametrize(
    ("count", "chi_squared", "is_known", "degrees", "stated"),
    [
        (3, 3.0, True, np.inf, None),
        (4, 6.0, True, 6.5, 0.5),
        (6, 12.0, False, 12.0, 0.0),
        # So much is left that one of them is taken to be off.
        (3, 15.0, True, 3.0, 0.0),
        (6, 30.0, True, 3.0, 0.0),
    ],
)
def test_the_stated_error_is_fitzpatricks(
    count, chi_squared, is_known, degrees, stated
):
    """TRE^2 = 3 s^2 / n (1 + sum of (d_k / f_k)^2 / 3): distances of the target, and
    root mean square ones of the landmarks, from their principal axes (1998)."""
    model_m = FRONT_m[:count]
    robot_m, _ = touched(model_m, np.random.default_rng(2))
    squares_m2 = count * fit_landmarks(model_m, robot_m, std_m=2e-3).residual_rms_m ** 2
    std_m = np.sqrt(squares_m2 / chi_squared)
    fit = fit_landmarks(model_m, robot_m, std_m=std_m, is_std_known=is_known)
    variance_m2 = (
        std_m**2
        if stated is None
        else (squares_m2 + stated * std_m**2) / (3 * count - 6 + stated)
    )
    middle_m = model_m.mean(axis=0)
    _, _, axes = np.linalg.svd(model_m - middle_m)

    def beside_m2(points_m):
        along_m = points_m @ axes.T
        return (points_m**2).sum(axis=-1, keepdims=True) - along_m**2

    ratios = beside_m2(TARGET_m - middle_m) / beside_m2(model_m - middle_m).mean(axis=0)
    expected_m2 = 3.0 * variance_m2 / count * (1.0 + ratios.sum() / 3.0)

    assert fit.degrees == degrees
    assert fit.tre_m(TARGET_m) == pytest.approx(np.sqrt(expected_m2), rel=1e-6)


@pytest.mark.parametrize("degrees", [3.0, 6.5, np.inf])
def test_a_region_ends_where_hotellings_law_says(degrees):
    covariance = np.diag([0.0, 0.0, 0.0, 1e-6, 4e-6, 9e-6])
    fit = Registration(np.eye(3), np.zeros(3), covariance, np.zeros(3), degrees, 0.0)
    quantile = stats.f.ppf(0.9, 3, degrees) if degrees < np.inf else 6.2514 / 3.0
    for axis, std_m in zip(np.eye(3), (1e-3, 2e-3, 3e-3), strict=True):
        edge_m = TARGET_m + np.sqrt(3.0 * quantile) * std_m * axis

        assert [
            fit.region_contains(TARGET_m, edge_m + off_m * axis, 0.9)
            for off_m in (-1e-6, 1e-6)
        ] == [True, False]


@pytest.mark.parametrize(
    ("count", "is_known", "degrees"),
    [(3, False, 3.0), (3, True, np.inf), (4, False, 6.0), (4, True, 6.5)],
)
def test_an_exact_fit_returns_the_pose_and_its_residuals(count, is_known, degrees):
    robot_m, (rotation, shift_m) = touched(FRONT_m, np.random.default_rng(0), 0.0)
    fit = fit_landmarks(FRONT_m[:count], robot_m[:count], is_std_known=is_known)

    np.testing.assert_allclose(fit.rotation, rotation, atol=1e-12)
    np.testing.assert_allclose(fit.translation_m, shift_m, atol=1e-12)
    np.testing.assert_allclose(fit.to_model(fit.to_robot(FRONT_m)), FRONT_m, atol=1e-12)
    assert fit.residual_rms_m < 1e-8
    is_finite = np.isfinite(fit.tre_m(TARGET_m))
    assert (fit.degrees, is_finite) == (degrees, is_known or count > 3)


@given(lever=st.tuples(*[st.floats(-0.2, 0.2)] * 3))
def test_an_error_grows_with_the_distance_from_the_pivot(lever):
    covariance = np.diag([1e-4, 0.0, 0.0, 1e-6, 4e-6, 0.0])
    fit = Registration(np.eye(3), np.zeros(3), covariance, np.zeros(3), np.inf, 0.0)
    _, y_m, z_m = lever
    # A turn of 10 mrad about x moves y by -z and z by y times as much.
    expected_m2 = np.diag([1e-6, 4e-6, 0.0])
    expected_m2[1:, 1:] += 1e-4 * np.outer([-z_m, y_m], [-z_m, y_m])

    largest_m2 = max(np.linalg.eigvalsh(expected_m2)[-1], 4e-6)

    np.testing.assert_allclose(fit.covariance_at(lever), expected_m2, atol=1e-15)
    assert [
        fit.tre_m(lever),
        fit.std_along_m([0, 3.0, 0], lever),
        fit.largest_std_m([np.zeros(3), lever, np.zeros(3)]),
    ] == pytest.approx(np.sqrt([np.trace(expected_m2), expected_m2[1, 1], largest_m2]))


ROBOT_m, _ = touched(FRONT_m, np.random.default_rng(1))


@pytest.mark.parametrize(
    "robot_m",
    [
        1e3 * ROBOT_m,
        ROBOT_m * [-1, 1, 1],
        ROBOT_m[[0, 3, 2, 1, 4, 5]],
        ROBOT_m[[1, 2, 0, 3, 4, 5]],
        1.1 * ROBOT_m,
        ROBOT_m + 0.03 * np.eye(6, 3, -2),
        ROBOT_m[:2],
        np.full_like(ROBOT_m, np.nan),
        np.zeros_like(ROBOT_m),
    ],
)
def test_wrong_landmarks_are_refused(robot_m):
    with pytest.raises(RegistrationError):
        fit_landmarks(FRONT_m, robot_m)


@pytest.mark.parametrize(
    ("model_m", "word"),
    [
        (FRONT_m[:2], "few"),
        (np.outer(np.linspace(0.0, 0.2, 5), [1.0, 0.5, 0.0]), "collinear"),
        (0.1 * np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]), "order"),
        (1e-3 * np.array([[0, 0, 0], [120, 0, 0], [50, 40, 0], [52.6, -40, 0]]), "ord"),
    ],
)
def test_landmarks_that_fix_no_pose_are_refused(model_m, word):
    with pytest.raises(RegistrationError, match=word):
        fit_landmarks(model_m, model_m, std_m=1e-3)


def test_another_order_that_fits_less_well_is_no_doubt():
    """Landmarks 3 and 4 exchanged leave 10.9 variances: the limit is 10."""
    places_m = 1e-3 * np.array([[0, 0, 0], [120, 0, 0], [50, 40, 0], [52.8, -40, 0]])
    found_m = fit_landmarks(places_m, places_m, std_m=1e-3).to_robot(places_m)

    assert found_m == pytest.approx(places_m, abs=1e-9)


@pytest.mark.parametrize("std_m", [np.nan, np.inf, 0.0, -1e-3, 1.0])
def test_deviations_that_are_none_are_refused(std_m):
    with pytest.raises(RegistrationError, match="std_m"):
        fit_landmarks(FRONT_m, FRONT_m, std_m=std_m)
    for options in ({"touch_std_m": std_m}, {"softness_m": std_m or -1.0}):
        with pytest.raises(RegistrationError, match=next(iter(options))):
            fit_surface(SKIN, MESH.vertices, START, **options)


def test_a_landmark_that_is_off_is_named():
    rng = np.random.default_rng(1000)
    named = 0
    for _ in range(60):
        robot_m, _ = touched(FRONT_m, rng, 1e-3)
        way = rng.normal(size=3)
        robot_m[2] += 8e-3 * way / np.linalg.norm(way)
        residuals = judge_landmarks(FRONT_m, robot_m, 1e-3, "abcdef")
        worst = min(residuals, key=lambda one: one.probability)
        named += (worst.name, worst.is_doubtful) == ("c", True)
        assert max(worst.left_m, 3e-3) < worst.left_out_m < 15e-3

    assert named >= 54
    few = judge_landmarks(FRONT_m[:4], robot_m[:4], 1e-3)
    assert [
        (np.isfinite(one.probability), np.isfinite(one.left_out_m)) for one in few
    ] == [(False, True)] * 4


def test_probabilities_of_good_landmarks_are_evenly_spread():
    rng = np.random.default_rng(1001)
    good = [
        one.probability
        for _ in range(60)
        for one in judge_landmarks(FRONT_m, touched(FRONT_m, rng, 1e-3)[0], 1e-3)
    ]
    assert stats.kstest(good, "uniform").statistic < 0.1


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
START = fit_landmarks(LANDMARKS_m, LANDMARKS_m)
LANDMARK_STD_m = 1.5e-3
INSIDE_m = np.array([0.02, 0.03, 0.01])
COUNT = 40


def points_on(mesh, rng, is_touched, count=COUNT):
    """Points on some triangles of a surface, and the normals there."""
    chosen = rng.choice(np.flatnonzero(is_touched), count)
    corners = rng.dirichlet([1, 1, 1], count)
    points_m = np.einsum("nk,nkj->nj", corners, mesh.triangles[chosen])
    return points_m, mesh.face_normals[chosen]


def touch(rng, pressed_m=0.0, radius_m=0.11, move_m=(0, 0, 0), first=0, slips_m=0.0):
    """Landmarks and touches in the base, and where the target lies at the end."""
    front_m = MESH.vertices[MESH.vertices[:, 1].argmin()]
    is_near = np.linalg.norm(MESH.triangles_center - front_m, axis=1) < radius_m
    points_m, normals = points_on(
        MESH, rng, is_near & (MESH.face_normals[:, 1] < -0.35)
    )
    off_m = slips_m - pressed_m * (1.0 + 0.4 * rng.uniform(-1.0, 1.0, COUNT))
    points_m += off_m[:, None] * normals
    points_m[first:] += move_m
    places_m, (rotation, shift_m) = touched(points_m, rng)
    noise_m = LANDMARK_STD_m * rng.normal(size=LANDMARKS_m.shape)
    landmarks_m = LANDMARKS_m @ rotation.T + shift_m + noise_m
    return landmarks_m, places_m, rotation @ (INSIDE_m + move_m) + shift_m


def fit_both(landmarks_m, touches_m):
    rough = fit_landmarks(
        LANDMARKS_m, landmarks_m, std_m=LANDMARK_STD_m, is_std_known=True
    )
    return rough, fit_surface(SKIN, touches_m, rough, softness_m=3e-3)


SLIPS_m = np.pad([0.015, -0.008, 0.02], (36, 1))
"""Touches that slipped off or in: the last ones but one."""


@pytest.mark.parametrize(
    ("case", "worst_mm", "refused"),
    [
        ({"pressed_m": 0.5e-3}, 3.0, 0),
        ({"pressed_m": 3e-3}, 3.0, 0),
        ({"pressed_m": 1e-3, "radius_m": 0.03}, 5.0, 0),
        # Last touches that slipped are no patient who moved.
        ({"pressed_m": 1.5e-3, "slips_m": SLIPS_m}, 3.5, 1),
        # One who moves is found, or covered.
        ({"pressed_m": 1.5e-3, "move_m": (0.0, 0.0, 0.01)}, 9.0, 6),
        ({"pressed_m": 1.5e-3, "move_m": (0.01, 0.0, 0.0), "first": 20}, 9.0, 6),
        ({"pressed_m": 1.5e-3, "move_m": (0.0, 0.005, 0.0)}, 6.0, 6),
    ],
)
def test_the_target_lies_in_its_region_or_the_patient_moved(case, worst_mm, refused):
    rng = np.random.default_rng(1000)
    errors_m = []
    inside = []
    refusals = []
    for _ in range(6):
        landmarks_m, touches_m, target_m = touch(rng, **case)
        try:
            rough, fit = fit_both(landmarks_m, touches_m)
        except RegistrationError as error:
            refusals.append(str(error))
            continue
        places_m = [one.to_robot(INSIDE_m) for one in (rough, fit)]
        errors_m.append(np.linalg.norm(np.array(places_m) - target_m, axis=1))
        inside.append(fit.region_contains(INSIDE_m, target_m))
        if refused < 6:
            assert fit.indentation_m == pytest.approx(case["pressed_m"], abs=1.5e-3)
            assert 0.1e-3 < fit.indentation_std_m < 1e-3
            assert 0.2e-3 < fit.residual_rms_m < 8e-3
            assert fit.tre_m(INSIDE_m) < 6e-3

    assert len(refusals) <= refused
    assert all("moved" in one for one in refusals)
    assert sum(inside) >= len(inside) - 1
    if errors_m:
        alone_m, together_m = np.sqrt(np.mean(np.square(errors_m), axis=0))
        assert 1e3 * np.max(np.array(errors_m)[:, 1]) < worst_mm
        assert refused == 6 or together_m < 1.1 * alone_m


BALL = trimesh.creation.icosphere(4, 0.06)
TUBE = trimesh.creation.cylinder(0.04, 0.2, sections=48).subdivide().subdivide()
BOX = trimesh.creation.box((0.12, 0.1, 0.08)).subdivide().subdivide()
PARTS = {
    "organ": (
        trimesh.Trimesh(0.4 * MESH.vertices, MESH.faces),
        lambda n: n[:, 1] < 2.0,
    ),
    "sphere": (BALL, lambda n: n[:, 1] < 2.0),
    "half sphere": (BALL, lambda n: n[:, 1] < 0.0),
    "cylinder": (TUBE, lambda n: np.abs(n[:, 2]) < 0.5),
    "plane": (BOX, lambda n: n[:, 1] < -0.5),
}
"""A body without symmetry, and parts of such as slide or spin on themselves."""


def touch_part(name, rng, outliers):
    """A surface, 100 touches of the side that looks to the front, a start some degrees
    and millimetres off that says nothing, and where the model lies."""
    mesh, is_part = PARTS[name]
    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces[is_part(mesh.face_normals)])
    points_m, normals = points_on(mesh, rng, mesh.face_normals[:, 1] < -0.1, 100)
    slips_m = (rng.random((100, 1)) < outliers) * rng.uniform(5e-3, 20e-3, (100, 1))
    touches_m, (rotation, shift_m) = touched(points_m + slips_m * normals, rng)
    turned = rotation @ Rotation.from_rotvec(rng.normal(0.0, 0.05, 3)).as_matrix()
    middle_m = points_m.mean(axis=0)
    start_m = (
        rotation @ middle_m + shift_m + rng.normal(0.0, 5e-3, 3) - turned @ middle_m
    )
    return (
        Surface(name, mesh.vertices, mesh.faces),
        touches_m,
        Registration(turned, start_m, np.eye(6), np.zeros(3), 9.0, 0.0),
        shift_m,
    )


def test_touches_find_the_surface_among_those_that_slipped():
    rng = np.random.default_rng(2)
    inside = []
    for _ in range(6):
        surface, touches_m, start, shift_m = touch_part("organ", rng, 0.1)
        fit = fit_surface(surface, touches_m, start, check=False)
        assert np.linalg.norm(fit.to_robot(np.zeros(3)) - shift_m) < 1e-3
        assert 0.1e-3 < fit.std_along_m([0.0, 0.0, 1.0], np.zeros(3)) < 1e-3
        inside.append(fit.region_contains(np.zeros(3), shift_m))

    assert np.mean(inside) > 0.8
    # Where more slipped than not, it is refused.
    off_m = np.pad(0.02 * rng.normal(size=(60, 3)), ((0, 40), (0, 0)))
    with pytest.raises(RegistrationError):
        fit_surface(surface, touches_m + off_m, start)


def test_a_nearly_symmetric_organ_is_refused_half_a_turn_off():
    """There it fits as well as where it lies, or the fit turns back."""
    x, y, z = BALL.vertices.T / 0.06
    bulge = (1.0 + 0.15 * x + 0.1 * y * z)[:, None] * [0.05, 0.03, 0.07]
    mesh = trimesh.Trimesh(np.column_stack([x, y, z]) * bulge, BALL.faces)
    rng = np.random.default_rng(0)
    points_m, _ = points_on(mesh, rng, mesh.face_normals[:, 1] < -0.1, 100)
    touches_m = points_m + 0.5e-3 * rng.normal(size=points_m.shape)
    middle_m = touches_m.mean(axis=0)
    surface = Surface("organ", mesh.vertices, mesh.faces)
    for degrees, is_refused in ((5.0, False), (18.0, False), (172.0, True)):
        turn = Rotation.from_rotvec([0.0, 0.0, degrees], degrees=True).as_matrix()
        shift_m = middle_m - turn @ middle_m
        start = Registration(turn, shift_m, np.eye(6), np.zeros(3), 9.0, 0.0)
        with refused_if(is_refused, "start|fits", RegistrationError):
            fit = fit_surface(surface, touches_m, start)
            assert np.linalg.norm(fit.to_robot(np.zeros(3))) < 1.5e-3


@pytest.mark.parametrize("shape", ["sphere", "half sphere", "cylinder", "plane"])
def test_surfaces_that_slide_or_spin_are_refused(shape):
    surface, touches_m, start, _ = touch_part(shape, np.random.default_rng(3), 0.0)

    with pytest.raises(RegistrationError, match="slides"):
        fit_surface(surface, touches_m, start)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda p: 1e3 * p, "millimetres"),
        (lambda p: np.tile(p[0], (20, 1)), "point"),
        (lambda p: np.linspace(p[0], p[0] + 0.1, 20), "line"),
        (lambda p: p[:14], "14"),
        (lambda p: p * np.nan, "finite"),
        (lambda p: p[:, :2], "finite"),
    ],
)
def test_touches_that_cannot_register_are_refused(change, word):
    with pytest.raises(RegistrationError, match=word):
        fit_surface(SKIN, change(MESH.vertices), START)


@pytest.mark.parametrize(
    ("surface_factor", "touch_factor", "word"),
    [(17.0, 4.0, "millimetres"), (14.0, 17.0, "millimetres"), (14.0, 14.0, "moved")],
)
def test_lengths_beyond_five_metres_are_no_metres(surface_factor, touch_factor, word):
    """The trunk is 0.33 m high."""
    surface = replace(SKIN, vertices_m=SKIN.vertices_m * [1.0, 1.0, surface_factor])
    touches_m = MESH.vertices[::50] * [3.0, 1.0, touch_factor]
    with pytest.raises(RegistrationError, match=word):
        fit_surface(surface, touches_m, START, check=False)


@pytest.mark.parametrize(
    ("move_m", "first", "numbers"),
    [
        ((0.0, 0.0, 0.0), 0, (0.0007926, 0.00199, 0.0005509, 33.93, 0.000527)),
        ((0.002, 0.0, 0.001), 0, (0.0007824, 0.002043, 0.0005515, 33.8, 0.0005375)),
        ((0.0, 0.0, 0.001), 20, (0.0007628, 0.002047, 0.0005483, 33.91, 0.0005245)),
    ],
)
def test_the_estimator_keeps_its_numbers(move_m, first, numbers):
    """A changed constant or term shows: error, indentation, degrees, residuals."""
    rng = np.random.default_rng(5)
    landmarks_m, touches_m, _ = touch(rng, 1.5e-3, move_m=move_m, first=first)
    _, fit = fit_both(landmarks_m, touches_m)

    assert (
        *(fit.tre_m(INSIDE_m), fit.indentation_m, fit.indentation_std_m),
        *(fit.degrees, fit.residual_rms_m),
    ) == pytest.approx(numbers, rel=2e-3)


HALF_m = np.array([0.16, 0.11, 0.2])
ENTRY_m = np.array([-0.08, -0.095, 0.02])
SYMMETRIC = Surface("skin", BALL.vertices / 0.06 * HALF_m, BALL.faces)


def on_front(left, up):
    """Point of the front skin by fractions of half width and height."""
    return HALF_m * [left, -np.sqrt(1.0 - left**2 - up**2), up]


PLACES = [(0.0, 0.5), (0.1, -0.45), (-0.6, 0.2), (0.55, 0.1), (-0.5, -0.5)]
MODEL_m = np.array([on_front(*place) for place in PLACES])
NAMES = ("xiphoid", "navel", "rib right", "rib left", "crest right")


def test_touches_about_the_entry_show_the_frame_on_a_symmetric_body():
    rng = np.random.default_rng(1000)
    for _ in range(10):
        robot_m, (rotation, shift_m) = touched(MODEL_m, rng, 1e-3)
        ways = rng.uniform([-0.85, -0.4], [-0.1, 0.5], (40, 2))
        touches_m = np.array([on_front(*way) for way in ways]) @ rotation.T + shift_m
        for model_m, is_wrong in ((MODEL_m, False), (MODEL_m * RAS, True)):
            carried_m = fit_landmarks(model_m, robot_m).to_model(touches_m)
            shown = {"touches_m": carried_m, "entry_m": ENTRY_m}
            with refused_if(is_wrong, "RAS", RegistrationError):
                assert require_lps(model_m, SYMMETRIC, **shown) == []


SHIFT_m = np.array([0.03, 0.05, 0.0])
ASIDE = Surface("skin", SYMMETRIC.vertices_m + SHIFT_m, SYMMETRIC.triangles)


@pytest.mark.parametrize(
    ("points_m", "skin", "names"),
    [(MODEL_m, SYMMETRIC, NAMES), (MODEL_m + SHIFT_m, ASIDE, ())],
)
def test_names_with_a_side_or_the_skin_show_the_frame(points_m, skin, names):
    assert require_lps(points_m, skin, names) == []
    with pytest.raises(RegistrationError, match="RAS"):
        require_lps(points_m * RAS, skin, names)
    assert "not verified" in require_lps(MODEL_m, SYMMETRIC, "abcde")[0]


def test_landmarks_of_another_ct_are_refused_and_far_ones_doubted():
    with pytest.raises(RegistrationError, match="another CT"):
        require_lps(LANDMARKS_m * 1.8, SKIN)
    assert require_lps(MODEL_m * 1.15, SYMMETRIC, NAMES)

    far = {"touches_m": [on_front(0.7, 0.6)], "entry_m": on_front(-0.5, -0.6)}
    (doubt,) = require_lps(MODEL_m, SYMMETRIC, NAMES, **far)
    assert "entry" in doubt
