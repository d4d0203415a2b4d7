"""Landmarks, touches, and the plan that ruptures correct."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

trimesh = pytest.importorskip("trimesh")
pytest.importorskip("SimpleITK")

from needleforce.anatomy import (  # noqa: E402
    Layer,
    PlanError,
    PlanMatch,
    Registration,
    RegistrationError,
    Surface,
    fit_landmarks,
    fit_surface,
)
from needleforce.anatomy.rupture_model import find_chances  # noqa: E402

FRONT = np.array(
    [
        [-90, -60, 60],
        [85, -65, 70],
        [0, -110, 40],
        [-120, 10, -80],
        [110, 5, -75],
        [10, -105, -90],
    ]
)
FRONT_m = 1e-3 * FRONT
TARGET_m = np.array([-0.03, 0.0, 0.01])


def pose(rng):
    return Rotation.random(
        random_state=int(rng.integers(1 << 30))
    ).as_matrix(), rng.normal(size=3)


def touched(points, rng, std=0.5e-3):
    rotation, shift = pose(rng)
    return points @ rotation.T + shift + std * rng.normal(size=points.shape), (
        rotation,
        shift,
    )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("count", "is_known"), [(3, True), (4, True), (4, False), (6, False)]
)
def test_the_error_at_the_target_is_as_stated(count, is_known):
    rng = np.random.default_rng(count)
    inside = []
    errors = []
    stated = []
    for _ in range(1500):
        robot, (rotation, shift) = touched(FRONT_m[:count], rng)
        registration = fit_landmarks(
            FRONT_m[:count], robot, std_m=0.5e-3, is_std_known=is_known
        )
        truth = rotation @ TARGET_m + shift
        errors.append(np.linalg.norm(registration.to_robot(TARGET_m) - truth))
        stated.append(registration.tre_m(TARGET_m))
        inside.append(registration.region_contains(TARGET_m, truth))

    assert np.mean(inside) == pytest.approx(0.95, abs=0.02)

    rms = [np.sqrt(np.mean(np.square(values))) for values in (errors, stated)]

    assert rms[0] == pytest.approx(rms[1], rel=0.05)
    assert np.allclose(registration.to_model(registration.to_robot(TARGET_m)), TARGET_m)


def test_three_landmarks_claim_nothing_from_their_residuals():
    robot, _ = touched(FRONT_m[:3], np.random.default_rng(0))

    assert np.isnan(fit_landmarks(FRONT_m[:3], robot).tre_m(TARGET_m))
    assert np.isfinite(
        fit_landmarks(FRONT_m[:3], robot, is_std_known=True).tre_m(TARGET_m)
    )


def swapped(points):
    points = points.copy()
    points[[1, 3]] = points[[3, 1]]
    return points


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p: 1e3 * p, "millimetres for metres"),
        (lambda p: p * [-1, 1, 1], "mirror image"),
        (swapped, "landmarks 2 and 4 are swapped"),
        (lambda p: 1.1 * p, "a scale of 1.[01]"),
        (lambda p: p + np.eye(6, 3, -2) * 0.03, "do not fit|landmark 3"),
        (lambda p: p[:2], r"expected \(n, 3\) twice"),
        (lambda p: np.full_like(p, np.nan), "not finite"),
    ],
)
def test_wrong_landmarks_are_refused_by_name(change, says):
    robot, _ = touched(FRONT_m, np.random.default_rng(1))
    with pytest.raises(RegistrationError, match=says):
        fit_landmarks(FRONT_m, change(robot))


def test_too_few_and_collinear_landmarks_are_refused():
    with pytest.raises(RegistrationError, match="too few"):
        fit_landmarks(FRONT_m[:2], FRONT_m[:2])

    line = np.outer(np.linspace(0.0, 0.2, 5), [1.0, 0.5, 0.0])

    with pytest.raises(RegistrationError, match="collinear"):
        fit_landmarks(line, line)


def organ():
    """A body without symmetry."""
    mesh = trimesh.creation.icosphere(4, 0.05)
    x, y, z = mesh.vertices.T
    bulge = 1.0 + 0.25 * x / 0.05 + 0.3 * (y / 0.05) ** 2 + 0.2 * x * z / 0.05**2
    mesh.vertices *= bulge[:, None] * [1.0, 0.8, 1.2]
    return mesh


def touch(mesh, count, rng, outliers=0.1):
    looks_up = mesh.area_faces * (mesh.face_normals[:, 1] < -0.1)
    chosen = rng.choice(len(looks_up), count, p=looks_up / looks_up.sum())
    points = np.einsum(
        "nk,nkj->nj", rng.dirichlet([1, 1, 1], count), mesh.triangles[chosen]
    )
    points = points + 0.5e-3 * rng.normal(size=points.shape)
    slipped = rng.random(count) < outliers
    away = rng.uniform(5e-3, 20e-3, (slipped.sum(), 1))
    points[slipped] += away * mesh.face_normals[chosen[slipped]]
    return points


def rough(points, robot, truth, rng, size=1.0):
    """A start some degrees and millimetres off."""
    turned = (
        truth[0] @ Rotation.from_rotvec(size * rng.normal(0.0, 0.05, 3)).as_matrix()
    )
    middle = points.mean(axis=0)
    shift = (
        truth[0] @ middle + truth[1] - turned @ middle + size * rng.normal(0.0, 5e-3, 3)
    )
    return Registration(turned, shift, np.eye(6), np.zeros(3), np.inf, 0.0)


def test_touches_find_the_surface_among_those_that_slipped():
    rng = np.random.default_rng(2)
    mesh = organ()
    inside = []
    surface = Surface("organ", mesh.vertices, mesh.faces)
    for _ in range(12):
        points = touch(mesh, 100, rng)
        robot, truth = touched(points, rng, 0.0)
        registration = fit_surface(
            surface, robot, rough(points, robot, truth, rng), check=False
        )
        place = truth[0] @ np.zeros(3) + truth[1]
        assert np.linalg.norm(registration.to_robot(np.zeros(3)) - place) < 1e-3
        inside.append(registration.region_contains(np.zeros(3), place))
        assert registration.std_along_m([0.0, 0.0, 1.0], np.zeros(3)) < 1e-3

    assert np.mean(inside) > 0.8


@pytest.mark.parametrize("shape", ["sphere", "half sphere", "cylinder", "plane"])
def test_surfaces_that_slide_or_spin_are_refused(shape):
    rng = np.random.default_rng(3)
    if "sphere" in shape:
        mesh = trimesh.creation.icosphere(4, 0.06)
        is_touchable = mesh.face_normals[:, 1] < (0.0 if "half" in shape else 2.0)
    elif shape == "cylinder":
        mesh = trimesh.creation.cylinder(0.04, 0.2, sections=48).subdivide().subdivide()
        is_touchable = np.abs(mesh.face_normals[:, 2]) < 0.5
    else:
        mesh = (
            trimesh.creation.box((0.12, 0.1, 0.08)).subdivide().subdivide().subdivide()
        )
        is_touchable = mesh.face_normals[:, 1] < -0.5

    mesh = trimesh.Trimesh(mesh.vertices, mesh.faces[is_touchable])
    points = touch(mesh, 100, rng, 0.0)
    robot, truth = touched(points, rng, 0.0)
    surface = Surface("organ", mesh.vertices, mesh.faces)
    start = rough(points, robot, truth, rng)

    with pytest.raises(RegistrationError, match="slides or spins"):
        fit_surface(surface, robot, start)


def test_touches_that_cannot_register_are_refused():
    rng = np.random.default_rng(4)
    mesh = organ()
    surface = Surface("organ", mesh.vertices, mesh.faces)
    points = touch(mesh, 100, rng)
    robot, truth = touched(points, rng, 0.0)
    good = rough(points, robot, truth, rng)
    fit_surface(surface, robot, good)

    with pytest.raises(RegistrationError, match="too few touches: 10"):
        fit_surface(surface, robot[:10], good)
    with pytest.raises(RegistrationError, match="finite"):
        fit_surface(surface, robot * np.nan, good)

    away = mesh.vertices.mean(axis=0) - [0.0, 0.2, 0.0] + rng.normal(0.0, 5e-3, (60, 3))
    wild = np.vstack([robot[:40], away @ truth[0].T + truth[1]])

    with pytest.raises(RegistrationError):
        fit_surface(surface, wild, good)


@pytest.mark.slow
def test_touches_after_the_patient_has_moved_are_refused():
    rng = np.random.default_rng(5)
    mesh = organ()
    surface = Surface("organ", mesh.vertices, mesh.faces)
    wrong = 0
    for _ in range(10):
        points = touch(mesh, 100, rng, 0.0)
        robot, truth = touched(points, rng, 0.0)
        start = rough(points, robot, truth, rng)
        fit_surface(surface, robot, start, check=False)
        away = rng.normal(size=3)
        robot[:45] += 0.01 * away / np.linalg.norm(away)
        try:
            registration = fit_surface(surface, robot, start, check=False)
        except RegistrationError:
            continue
        wrong += not registration.region_contains(np.zeros(3), truth[1])

    assert wrong < 2


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda p: 1e3 * p, "millimetres for metres"),
        (lambda p: np.tile(p[0], (20, 1)), "near a point or a line"),
        (lambda p: np.linspace(p[0], p[0] + 0.1, 20), "near a point or a line"),
    ],
)
def test_narrow_or_millimetre_touches_are_refused(change, says):
    mesh = organ()
    start = Registration(np.eye(3), np.zeros(3), np.eye(6), np.zeros(3), 1.0, 0.0)
    for check in (True, False):
        with pytest.raises(RegistrationError, match=says):
            fit_surface(
                Surface("organ", mesh.vertices, mesh.faces),
                change(mesh.vertices),
                start,
                check=check,
            )


@pytest.mark.parametrize("std_m", [np.nan, np.inf, 0.0, -1e-3, 1.0])
def test_deviations_of_touches_that_are_none_are_refused(std_m):
    mesh = organ()
    start = Registration(np.eye(3), np.zeros(3), np.eye(6), np.zeros(3), 1.0, 0.0)
    surface = Surface("organ", mesh.vertices, mesh.faces)

    with pytest.raises(
        RegistrationError, match=r"std_m=.*standard deviation in metres"
    ):
        fit_landmarks(FRONT_m, FRONT_m, std_m=std_m)
    with pytest.raises(
        RegistrationError, match=r"touch_std_m=.*standard deviation in metres"
    ):
        fit_surface(surface, mesh.vertices, start, touch_std_m=std_m)


NAMES = ("fat", "muscle", "gland", "lesion", "gland")


def plan(*depths_mm, std_mm=0.5):
    edges = [0.0, *depths_mm, depths_mm[-1] + 50.0]
    return [
        Layer(
            *(NAMES[k], 1e-3 * edges[k], 1e-3 * edges[k + 1]),
            *(1e-3 * std_mm * (k > 0), 1e-3 * std_mm, False),
        )
        for k in range(len(depths_mm) + 1)
    ]


def test_ruptures_move_the_plan_and_name_the_layer():
    match = PlanMatch(plan(20, 35, 60), 3e-3)

    assert match.state(0.005).name == "fat"

    first = match.state(0.024, [0.024])

    assert (first.name, first.next_name) == ("muscle", "gland")
    assert 1e-3 < first.offset_m < 4e-3  # or a membrane gave way late

    second = match.state(0.039, [0.024, 0.039])

    assert second.offset_m == pytest.approx(4e-3, abs=0.5e-3)
    assert second.offset_std_m < 1.2e-3
    assert second.next_m == pytest.approx(0.064, abs=1e-3)
    assert second.matched == 2

    low, high = match.interval_m(0.039, [0.024, 0.039])

    assert low < 4e-3 < high
    assert match.state(0.064, [0.024, 0.039, 0.064]).next_name == ""
    assert match.state(0.0).offset_m == pytest.approx(0.0, abs=2e-4)

    moved = match.state(0.139, [0.124, 0.139], entry_depth_m=0.1)

    assert moved.next_m == pytest.approx(second.next_m + 0.1)
    assert moved.offset_m == pytest.approx(second.offset_m)


@pytest.mark.parametrize(("rupture_m", "name"), [(0.028, "muscle"), (0.03, "gland")])
def test_one_boundary_in_five_is_passed_unnoticed(rupture_m, name):
    """Planned at 20 and 30 mm, give or take 3 mm."""
    layers = plan(20, 30, 60)
    layers[0] = replace(layers[0], name="lesion")  # behind fat three in five would be
    state = PlanMatch(layers, 3e-3).state(rupture_m + 1e-3, [rupture_m])

    assert state.name == state.matched_name == name


def test_where_the_surface_was_met_counts_for_half():
    match = PlanMatch(plan(20, 35, 60), 3e-3)
    # At a rupture 4 mm late a membrane gave way late, or all lies deeper: so does the
    # surface.
    deeper, late = (
        match.state(0.024, [0.024], contact_m=contact) for contact in (4e-3, 0.0)
    )
    unknown = match.state(0.024, [0.024])

    assert late.offset_m < unknown.offset_m < deeper.offset_m
    assert deeper.offset_m == pytest.approx(4e-3, abs=0.2e-3)
    assert deeper.offset_std_m < unknown.offset_std_m

    # Organs move beneath a skin that lies where it was: two ruptures outvote it.
    ruptures = [0.024, 0.039]
    beneath = match.state(0.039, ruptures, contact_m=0.0)

    assert beneath.offset_m == pytest.approx(4e-3, abs=0.5e-3)

    low, high = match.interval_m(0.039, ruptures, contact_m=4e-3)

    assert high - low < np.subtract(*match.interval_m(0.039, ruptures)[::-1])

    moved = match.state(0.139, [0.124, 0.139], contact_m=0.1, entry_depth_m=0.1)

    assert moved.offset_m == pytest.approx(beneath.offset_m)


def test_air_before_the_skin_is_no_layer():
    layers = [
        replace(layer, name=name)
        for layer, name in zip(plan(20, 35), NAMES[:3], strict=True)
    ]
    moved = [
        replace(layer, entry_m=layer.entry_m + 0.015, exit_m=layer.exit_m + 0.015)
        for layer in layers
    ]
    air = Layer("unlabelled", 0.0, 0.015, 0.0, 0.0, False)
    without = PlanMatch(layers, 3e-3)
    match = PlanMatch([air, *moved], 3e-3)
    for depth_m, ruptures_m in ((-0.005, []), (0.005, []), (0.024, [0.024])):
        contact = {"contact_m": 0.002} if depth_m > 0.002 else {}
        bare_state = without.state(depth_m, ruptures_m, **contact)
        state = match.state(depth_m, ruptures_m, **contact, entry_depth_m=-0.015)
        assert (state.layer, state.name) == (bare_state.layer + 1, bare_state.name)
        assert state.next_name == bare_state.next_name
        assert state.next_m == pytest.approx(bare_state.next_m)
        assert state.offset_m == pytest.approx(bare_state.offset_m)
        assert state.matched == bare_state.matched + (bare_state.matched >= 0)

    bare = PlanMatch([air, *(replace(layer, name="liver") for layer in moved)], 3e-3)

    assert (
        bare.state(0.01, [], contact_m=0.0).name == "unlabelled"
    )  # tissue without a label


def test_the_skin_ruptures_behind_where_it_was_met():
    match = PlanMatch(plan(8, 35), 5e-3)

    assert match.state(0.0085, [0.0085]).matched == 1
    assert match.state(0.0085, [0.0085], contact_m=4e-3).matched == 0


def test_an_unnoticed_boundary_is_passed_all_the_same():
    """A boundary that ruptured unnoticed is passed all the same."""
    match = PlanMatch(plan(20, 35, 60), 2e-3)

    assert match.state(0.030, [0.0200]).name == "muscle"
    assert match.state(0.050, [0.0200]).name == "gland"

    state = match.state(0.0601, [0.0200, 0.0601])

    assert state.matched == 3
    assert state.name == "lesion"


def test_a_capsule_is_expected_to_rupture_late():
    layers = plan(20, 35, 60)
    states = [
        PlanMatch([*layers[:2], replace(layers[2], name=name)], 3e-3).state(
            0.0385, [0.0385]
        )
        for name in ("gland", "liver", "Left Kidney")
    ]

    assert [state.matched for state in states] == [2, 2, 2]
    assert states[0].offset_m == pytest.approx(3e-3, abs=1e-3)

    for state in states[1:]:
        assert state.offset_m == pytest.approx(-1e-3, abs=1e-3)

    # Inside the organ there is no capsule.
    inside = [
        replace(layers[0], name="liver"),
        layers[1],
        replace(layers[2], name="liver"),
    ]
    chances = find_chances([layer.name for layer in inside])

    assert chances.late.tolist() == [1.0, 0.25, 0.25]


def test_a_false_alarm_is_no_boundary():
    state = PlanMatch(plan(20, 60), 1e-3).state(0.041, [0.0200, 0.041])

    assert state.matched == -1
    assert state.name == "muscle"


def test_what_cannot_be_a_plan_is_refused():
    with pytest.raises(PlanError, match="1 layers"):
        PlanMatch(plan(20)[:1], 1e-3)
    with pytest.raises(PlanError, match="positive standard deviation"):
        PlanMatch(plan(20), 0.0)

    for field, value in (
        *(("entry_m", bad) for bad in (float("nan"), 20.0, -0.01)),
        *(("entry_std_m", bad) for bad in (float("nan"), -1.0)),
    ):
        layers = plan(20, 35)
        layers[1] = replace(layers[1], **{field: value})
        with pytest.raises(PlanError, match="boundaries at"):
            PlanMatch(layers, 3e-3)

    with pytest.raises(PlanError, match="boundaries at"):
        PlanMatch(plan(20, 35)[::-1], 3e-3)

    match = PlanMatch(plan(20, 35), 3e-3)

    with pytest.raises(PlanError, match="finite depths"):
        match.state(float("nan"))
    with pytest.raises(PlanError, match="contact at nan m"):
        match.state(0.0, contact_m=float("nan"))
    with pytest.raises(PlanError, match="entry at nan m: expected finite"):
        match.state(0.0, entry_depth_m=float("nan"))

    for depth_m, level in ((float("nan"), 0.95), (0.0, 1.5), (0.0, float("nan"))):
        with pytest.raises(PlanError, match="a level between 0 and 1"):
            match.interval_m(depth_m, level=level)

    for bad in (float("nan"), 0.01):
        with pytest.raises(PlanError, match="rupture at"):
            match.state(0.03, [0.03, bad])
