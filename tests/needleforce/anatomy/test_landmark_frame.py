"""Landmarks in RAS taken for LPS, also on a body that is alike in front and back."""

import numpy as np
import pytest

from needleforce.anatomy import (
    RegistrationError,
    SkinLandmarks,
    Surface,
    fit_landmarks,
    require_lps,
)
from tests.needleforce.anatomy.test_registration import touched

trimesh = pytest.importorskip("trimesh")

HALF_m = np.array([0.16, 0.11, 0.2])
RAS = np.array([-1.0, -1.0, 1.0])
ENTRY_m = np.array([-0.08, -0.095, 0.02])


def torso():
    mesh = trimesh.creation.icosphere(4, 1.0)
    return Surface("skin", mesh.vertices * HALF_m, mesh.faces)


def on_front(left, up):
    """Point of the front skin by fractions of half width and height."""
    return HALF_m * [left, -np.sqrt(1.0 - left**2 - up**2), up]


MODEL_m = np.array(
    [
        on_front(0.0, 0.5),
        on_front(0.1, -0.45),
        on_front(-0.6, 0.2),
        on_front(0.55, 0.1),
        on_front(-0.5, -0.5),
    ]
)
NAMES = ("xiphoid", "navel", "rib right", "rib left", "crest right")


def touches_about_the_entry(rng):
    points = [on_front(*rng.uniform([-0.85, -0.4], [-0.1, 0.5])) for _ in range(40)]
    return np.array(points)


def carried_by(landmarks_m, rng):
    """The touches, carried into the CT by landmarks that may be in the wrong frame."""
    robot, (rotation, shift) = touched(MODEL_m, rng, 1e-3)
    fit = fit_landmarks(landmarks_m, robot, std_m=1e-3)
    return fit.to_model(touches_about_the_entry(rng) @ rotation.T + shift)


def test_touches_about_the_entry_show_the_frame_on_a_symmetric_body():
    rng = np.random.default_rng(1000)
    skin = torso()
    for _ in range(20):
        wrong_m = carried_by(MODEL_m * RAS, rng)
        wrong = SkinLandmarks(MODEL_m * RAS, skin, (), wrong_m, ENTRY_m)
        with pytest.raises(RegistrationError, match=r"holds RAS.*--negate-xy"):
            require_lps(wrong)

        right_m = carried_by(MODEL_m, rng)
        right = SkinLandmarks(MODEL_m, skin, (), right_m, ENTRY_m)

        assert require_lps(right) == []


def test_names_with_a_side_show_the_frame():
    skin = torso()

    assert require_lps(SkinLandmarks(MODEL_m, skin, NAMES)) == []
    with pytest.raises(RegistrationError, match=r"'rib right'.*holds RAS"):
        require_lps(SkinLandmarks(MODEL_m * RAS, skin, NAMES))


def test_what_cannot_show_the_frame_is_said():
    doubts = require_lps(SkinLandmarks(MODEL_m, torso(), ("a", "b", "c", "d", "e")))

    assert "not verified" in doubts[0]


def test_a_body_that_is_not_symmetric_shows_the_frame_by_itself():
    skin = torso()
    shift_m = np.array([0.03, 0.05, 0.0])
    moved = Surface("skin", skin.vertices_m + shift_m, skin.triangles)

    assert require_lps(SkinLandmarks(MODEL_m + shift_m, moved)) == []
    with pytest.raises(RegistrationError, match="from the skin"):
        require_lps(SkinLandmarks((MODEL_m + shift_m) * RAS, moved))


def test_touches_far_from_the_entry_are_doubted():
    touches_m = np.tile(on_front(0.7, 0.6), (20, 1))
    doubts = require_lps(
        SkinLandmarks(MODEL_m, torso(), NAMES, touches_m, on_front(-0.5, -0.6))
    )

    assert "from the planned entry" in doubts[0]
