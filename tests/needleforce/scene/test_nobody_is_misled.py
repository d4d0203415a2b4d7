"""What a page says of the needle: deepest point, sides of the patient, tissue."""

import re
from base64 import b64decode
from io import BytesIO

import numpy as np
import pytest

from tests.needleforce.scene.test_clinician_view import on_plan, words_of
from tests.needleforce.scene.test_page import HOME, plan, planned, row
from tests.needleforce.scene.test_panel import scanned

pytest.importorskip("viser")

from PIL import Image, ImageDraw

from needleforce import NeedleTool, load_lwr
from needleforce.plots.needle_view import NeedleView, patient_side
from needleforce.scene import Viewer
from needleforce.scene.scan_slices import NEEDLE_COLOR, PIXELS, TIP_ROW

ADVANCED = HOME + np.array([0.0, 0.1, 0.0, 0.0, 0.0, 0.0, 0.0])


def past_target():
    """An insertion 9.9 mm past its target and back, whose depth began deeper."""
    beyond = {"aside_to_target_m": -9.9e-3, "aside_is_past_target": 1.0}
    return np.array(
        [
            row(0.0, 0.2, is_good=0.0),
            row(1.0, 0.0, **on_plan()),
            row(2.0, 0.08, q=ADVANCED, is_good=0.0, **on_plan(**beyond)),
            row(3.0, 0.0, **on_plan(aside_to_target_m=84.5e-3)),
        ]
    )


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """The exported page of that insertion, with a CT."""
    viewer = Viewer(load_lwr(payload=NeedleTool()), port=8601)
    tip_m, axis = viewer._arm.needle_at(ADVANCED)
    viewer.stop()
    # The CT lies about the deepest point, its back along the needle.
    rotation = np.column_stack([np.cross(axis, [0.0, 1.0, 0.0]), axis, [0.0, 1.0, 0.0]])
    rotation[:, 0] /= np.linalg.norm(rotation[:, 0])
    rotation[:, 2] = np.cross(rotation[:, 0], axis)
    scene = scanned(np.zeros(3))._replace(
        rotation=rotation,
        translation_m=tip_m,
        entry_m=np.array([0.0, -0.04, 0.0]),
        target_m=np.array([0.0, -0.0099, 0.0]),
        layers=plan().layers,
    )
    viewer = Viewer(load_lwr(payload=NeedleTool()), scene, port=8601)
    viewer.append(past_target())
    path = viewer.export(tmp_path_factory.mktemp("scene") / "scene.html", frames=3)
    viewer.stop()
    return path.read_text(encoding="utf-8")


def test_the_deepest_point_counts_from_the_tare_also_where_it_is_doubtful(exported):
    card = exported[exported.index("was deepest") : exported.index("<iframe")]

    assert "PAST TARGET" in card
    assert ">9.9</div>" in card


def slices_of(page):
    """The three pictures of the CT in a page."""
    pictures = re.findall(r"data:image/png;base64,([^\"]+)", page)
    return [
        np.asarray(Image.open(BytesIO(b64decode(one))))[..., :3] for one in pictures
    ]


def test_the_ct_of_an_export_shows_the_needle_where_it_was_deepest(exported):
    side, head, _probe = slices_of(exported)
    middle = PIXELS // 2

    # The bright place lies at the tip, which is there in the deepest row alone.
    for picture in (side, head):
        assert tuple(picture[TIP_ROW - 10, middle]) == NEEDLE_COLOR
        assert picture[TIP_ROW + 1, middle].min() > 200


def letter_picture(letter):
    image = Image.new("RGB", (12, 12))
    ImageDraw.Draw(image).text((6, 0), letter, NEEDLE_COLOR, anchor="ma")
    return np.asarray(image) == NEEDLE_COLOR


def test_slices_name_the_patient_s_sides_at_their_edges(exported):
    for picture, (left, right) in zip(
        slices_of(exported), ("RL", "FH", "RL"), strict=True
    ):
        rows = slice(PIXELS // 2 - 5, PIXELS // 2 + 7)
        for letter, columns in ((left, slice(0, 12)), (right, slice(-12, None))):
            is_letter = (picture[rows, columns] == NEEDLE_COLOR).all(axis=2)
            assert (is_letter == letter_picture(letter).all(axis=2)).all(), letter


@pytest.mark.parametrize(
    ("axis", "right", "up"),
    [
        ([0.0, 1.0, 0.0], "L", "H"),  # from the front, as a scanner shows it
        ([0.0, -1.0, 0.0], "R", "H"),  # from the back
        ([-1.0, 0.0, 0.0], "P", "H"),  # from the patient's left
        ([0.0, 0.0, 1.0], "R", "P"),  # along the body
    ],
)
def test_the_sides_of_a_view_are_those_of_the_patient(axis, right, up):
    view = NeedleView.along(np.array(axis))

    assert patient_side(view.side) == right
    assert patient_side(view.up) == up
    assert set(patient_side(view.side) + patient_side(-view.side)) in (
        {"L", "R"},
        {"A", "P"},
    )


def test_the_bullseye_names_left_and_right_of_the_patient(exported):
    sides = dict(re.findall(r'data-side="(\w+)"[^>]*>(\w)<', exported))

    assert sides == {"left": "R", "right": "L", "up": "H"}


@pytest.mark.parametrize(
    ("state", "tissue"),
    [
        (planned(1, 30.0), "in liver (93 %)"),
        (planned(-1, 2.0), "in outside (93 %)"),
        ({}, "tissue at the tip not known"),
        (planned(1, 30.0) | {"aside_is_off_plan": 1.0}, "tissue at the tip not known"),
    ],
)
def test_the_first_card_names_the_tissue_at_the_tip_with_its_probability(state, tissue):
    viewer = Viewer(load_lwr(payload=NeedleTool()), plan(), port=8603)
    viewer.append(np.array([row(1.0, 0.02, **on_plan(**state))]))
    viewer.show()
    words = words_of(viewer._card.content)
    viewer.stop()

    assert tissue in words
