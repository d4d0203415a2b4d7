"""The card: verdict, tissue, distance to the target, bullseye, nearest structure."""

import re
from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.scene import PlanScene
from needleforce.scene.insertion_card import card_html
from tests.needleforce.scene.insertions import (
    clearance,
    deviation,
    plan,
    planned,
    tick,
)

RED = "#b3261e"
GREEN = "#00695c"
AMBER = "#8a5a00"
GREY = "#555"


def card(state=None, scene=None, needle=None, **more):
    """The card of a needle on its plan, or not, as HTML."""
    found = {"deviation": deviation(**(state or {}))} | more
    return card_html(tick(1.0, 0.02, **found), needle, scene or plan())


def words_of(html):
    return " ".join(re.sub("<[^>]*>", " ", html).split())


@pytest.mark.parametrize(
    ("state", "verdict", "color"),
    [
        ({}, "ON PLAN", GREEN),
        ({"is_doubtful": True}, "⚠ CANNOT TELL", AMBER),
        ({"is_past_target": True}, "⚠ PAST TARGET", RED),
        ({"is_off_plan": True, "is_past_target": True}, "⚠ OFF PLAN", RED),
    ],
)
def test_the_card_begins_with_the_verdict_in_words_and_colour(state, verdict, color):
    html = card(state)

    assert words_of(html).startswith(verdict)
    assert html.index(f"background:{color}") == html.index("background:")


def test_without_a_state_on_the_plan_nobody_can_tell():
    html = card(deviation=None)

    assert words_of(html).startswith("CANNOT TELL")
    assert "not known" in words_of(html)


@pytest.mark.parametrize(
    ("state", "number", "side", "color"),
    [
        ({}, "24.3", "to the target", "#111"),
        (
            {"to_target_m": -10.1e-3, "is_past_target": True},
            "10.1",
            "past the target",
            RED,
        ),
        ({"is_doubtful": True}, "24.3", "to the target", AMBER),
        ({"is_off_plan": True}, "24.3", "to the target", GREY),
        ({"to_target_m": np.nan}, "–", "not known", "#111"),
    ],
)
def test_the_large_number_is_the_distance_to_the_target(state, number, side, color):
    html = card(state)
    part = html[html.index('data-part="target"') : html.index("<svg")]

    assert f">{number}</div>" in part
    assert side in part
    assert ("± 0.4 mm" in part) is (number != "–")
    assert part.startswith(f'data-part="target" style="color:{color};')


@pytest.mark.parametrize(
    ("near", "words", "color"),
    [
        ((clearance(),), "Nearest: vein 12.0 ± 0.6 mm", GREEN),
        ((clearance(0.002),), "⚠ TOO NEAR: vein 2.0 ± 0.6 mm", RED),
        ((), "Watched, no distance yet: rib, vein", GREY),
    ],
)
def test_the_nearest_structure_is_told_in_words_and_colour(near, words, color):
    html = card(clearances=near)
    part = html.partition("</svg>")[2]

    assert words in words_of(part)
    assert f"background:{color};" in part
    assert words_of(html).startswith("⚠ TOO NEAR") is ("TOO NEAR" in words)


@pytest.mark.parametrize(
    ("state", "found", "tissue"),
    [
        ({}, planned(1, 0.03), "in liver (93 %)"),
        ({}, planned(-1, 0.002), "in outside (93 %)"),
        ({}, None, "tissue at the tip not known"),
        ({"is_off_plan": True}, planned(1, 0.03), "tissue at the tip not known"),
    ],
)
def test_the_first_card_names_the_tissue_at_the_tip_with_its_probability(
    state, found, tissue
):
    assert tissue in words_of(card(state, plan=found))
    assert words_of(card(state, PlanScene(layers=plan().layers), plan=found)) == tissue


@pytest.mark.parametrize(
    ("state", "aside_m", "place"),
    [
        ({}, [2e-3, 0.0, -0.04], (2.0, 0.0)),
        ({}, [0.0, 2e-3, -0.04], (0.0, -2.0)),  # up, to the back
        ({"tip_m": 0.05, "is_off_plan": True}, [0.05, 0.0, -0.04], (5.5, 0.0)),
    ],
)
def test_the_bullseye_shows_the_needle_where_it_passes_the_path(state, aside_m, place):
    # The plan goes down, to the patient's feet.
    needle = SimpleNamespace(
        tip_m=plan().path.entry_m + np.array(aside_m), axis=np.array([0.02, 0.0, -1.0])
    )
    html = card(state, needle=needle)
    (circle,) = re.findall(r'cx="(.*?)" cy="(.*?)" r="(.*?)"', html)[:1]
    x, y, radius = map(float, circle)

    assert (x, y, radius) == pytest.approx((*place, 1.0), abs=0.01)  # two deviations
    assert "1.1 ± 0.3° turned" in html
    line = re.search(r'<path d="M(.*?) (.*?)L', html[html.index("</text>") :])
    assert np.hypot(*map(float, line.groups())) == pytest.approx(1.2, abs=0.01)


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
    path = PlanScene(entry_m=np.zeros(3), target_m=0.1 * np.array(axis))
    opposite = {"L": "R", "R": "L", "P": "A", "H": "F"}
    sides = re.findall(r'data-side="(\w+)"[^>]*>(\w)<', card(scene=path))

    assert dict(sides) == {"left": opposite[right], "right": right, "up": up}
