"""The clinician's view: distance to the target, bullseye, nearest structure, sounds."""

import re
import time

import numpy as np
import pytest

from tests.chromium import PHONE, needs_chromium
from tests.needleforce.scene.test_page import HOME, plan, row
from tests.needleforce.scene.test_panel import scanned

pytest.importorskip("viser")

from needleforce import NeedleTool, load_lwr
from needleforce.scene import PlanScene, Viewer
from needleforce.scene.clinician_view import card_html, find_bearing
from needleforce.scene.nodes import TARGET_COLOR, NeedlePose
from needleforce.scene.scan_slices import TIP_ROW, ScanSlices
from needleforce.scene.state_ring import FIELDS, ViewRow

RED, GREEN, AMBER, GREY = "#b3261e", "#00695c", "#8a5a00", "#555"
EVENT = {"rupture": 1.0, "hard_contact": 2.0, "too_near": 3.0, "past_target": 4.0}


def on_plan(**more):
    """What a row says of a needle on its plan, 24.3 mm before the target."""
    values = {
        "aside_entry_m": 1.2e-3,
        "aside_entry_std_m": 0.3e-3,
        "aside_tip_m": 2.0e-3,
        "aside_tip_std_m": 0.5e-3,
        "aside_angle_rad": 0.02,
        "aside_angle_std_rad": 0.005,
        "aside_to_target_m": 24.3e-3,
        "aside_to_target_std_m": 0.4e-3,
        "near_number": 1.0,
        "near_distance_m": 12.0e-3,
        "near_std_m": 0.6e-3,
        "zero_kind": 2.0,
    }
    return values | more


def watched_plan():
    return plan()._replace(watched=("rib", "portal_vein"))


def card(**more):
    """The card of a row, as HTML."""
    values = row(1.0, 0.02, **on_plan(**more))
    shown = ViewRow(*values[: len(FIELDS)])
    return card_html(shown, watched_plan())


def words_of(html):
    return " ".join(re.sub("<[^>]*>", " ", html).split())


@pytest.mark.parametrize(
    ("state", "verdict", "color"),
    [
        ({}, "ON PLAN", GREEN),
        ({"aside_is_doubtful": 1.0}, "⚠ CANNOT TELL the registration is not", AMBER),
        ({"aside_is_past_target": 1.0}, "⚠ PAST TARGET the tip is deeper", RED),
        ({"near_is_too_near": 1.0}, "⚠ TOO NEAR the needle, or its way", RED),
        ({"aside_is_off_plan": 1.0}, "⚠ OFF PLAN no layer is named", RED),
        ({"aside_entry_m": np.nan}, "CANNOT TELL no state of the needle", AMBER),
    ],
)
def test_the_card_begins_with_the_verdict_in_words_and_colour(state, verdict, color):
    html = card(**state)

    assert words_of(html).startswith(verdict)
    assert html.index(f"background:{color}") == html.index("background:")


@pytest.mark.parametrize(
    ("state", "number", "below", "color"),
    [
        ({}, "24.3", "± 0.4 mm to the target", "#111"),
        (
            {"aside_to_target_m": -10.1e-3, "aside_is_past_target": 1.0},
            "10.1",
            "± 0.4 mm past the target",
            RED,
        ),
        ({"aside_is_doubtful": 1.0}, "24.3", "± 0.4 mm to the target", AMBER),
        ({"aside_is_off_plan": 1.0}, "24.3", "± 0.4 mm to the target", GREY),
        (
            {"aside_to_target_m": np.nan},
            "–",
            "distance to the target not known",
            "#111",
        ),
    ],
)
def test_the_large_number_is_the_distance_to_the_target(state, number, below, color):
    html = card(**state)
    start = html.index('data-part="target"')
    part = html[start : html.index("<svg")]

    assert f">{number}</div>" in part
    assert f">{below}</div>" in part
    assert part.startswith(f'data-part="target" style="color:{color};')


@pytest.mark.parametrize(
    ("state", "words", "color"),
    [
        ({}, "Nearest: portal vein 12.0 ± 0.6 mm", GREEN),
        ({"near_is_too_near": 1.0}, "⚠ TOO NEAR: portal vein 12.0 ± 0.6 mm", RED),
        ({"near_number": np.nan}, "Watched, no distance yet: rib, portal vein", GREY),
    ],
)
def test_the_nearest_structure_is_told_in_words_and_colour(state, words, color):
    part = card(**state).partition("</svg>")[2]

    assert words in words_of(part)
    assert f"background:{color};" in part


def test_the_bullseye_shows_the_needle_where_it_passes_the_path():
    scene = watched_plan()
    shown = ViewRow(*row(1.0, 0.02, **on_plan())[: len(FIELDS)])
    # The plan goes down; 2 mm to the left (LPS) of it, turned towards the left.
    axis = np.array([np.sin(0.02), 0.0, -np.cos(0.02)])
    needle = NeedlePose(scene.path.entry_m + np.array([2e-3, 0.0, -0.04]), axis)
    bearing = find_bearing(shown, needle, scene)

    assert np.linalg.norm(bearing.tip_m) == pytest.approx(2.0e-3)
    assert np.linalg.norm(bearing.entry_m) == pytest.approx(1.2e-3)
    assert abs(bearing.tip_m[0]) == pytest.approx(2.0e-3)

    html = card_html(shown, scene, bearing)
    x, y, radius = re.search(r'cx="(.*?)" cy="(.*?)" r="(.*?)"', html).groups()

    assert abs(float(x)) == pytest.approx(2.0)
    assert float(y) == pytest.approx(0.0)
    assert float(radius) == pytest.approx(1.0)  # two standard deviations
    assert "2.0 ± 0.5 mm aside<br>1.1 ± 0.3° turned" in html


def test_a_needle_far_aside_stands_at_the_edge_of_the_bullseye():
    scene = watched_plan()
    values = on_plan(aside_tip_m=0.05, aside_is_off_plan=1.0)
    shown = ViewRow(*row(1.0, 0.02, **values)[: len(FIELDS)])
    needle = NeedlePose(
        scene.path.entry_m + np.array([0.05, 0.0, 0.0]), np.array([0.0, 0.0, -1.0])
    )
    html = card_html(shown, scene, find_bearing(shown, needle, scene))

    assert abs(float(re.search('cx="(.*?)"', html)[1])) == pytest.approx(5.5)
    assert f'fill="{RED}"' in html


def test_before_the_first_sample_the_plan_is_shown():
    viewer = Viewer(load_lwr(payload=NeedleTool()), watched_plan(), port=8491)
    words = words_of(viewer._card.content)
    depths_mm, planned_N, *forces_N = viewer._plots.charts["depth [mm]"].data
    viewer.stop()

    assert words.startswith("PLANNED waiting for the first sample")
    assert "100.0 mm from the planned entry to the target" in words
    assert "Watched, no distance yet: rib, portal vein" in words
    assert depths_mm[planned_N > 0.0].tolist() == [0.0, 20.0, 50.0, 80.0]
    assert not any(len(force_N) for force_N in forces_N)


def test_no_number_of_the_plots_is_nan_which_would_leave_them_empty():
    viewer = Viewer(load_lwr(payload=NeedleTool()), watched_plan(), port=8497)
    try:
        for rows in ([], [row(1.0, 0.01)], [row(2.0, 0.03), row(3.0, 0.055)]):
            viewer.append(np.array(rows))
            viewer.show()
            for chart in viewer._plots.charts.values():
                assert np.isfinite(np.concatenate(chart.data)).all()

        depths_mm, planned_N, axial_N, *_ = viewer._plots.charts["depth [mm]"].data
    finally:
        viewer.stop()

    assert depths_mm[planned_N > 0.0].tolist() == [20.0, 50.0, 80.0]
    assert depths_mm[len(axial_N) - 1] == 55.0  # boundaries ahead stay in sight


def test_without_a_path_there_is_no_card():
    assert card_html(None, PlanScene()) == ""


def test_slices_show_the_planned_path_before_the_needle_comes():
    scene = scanned(np.array([0.0, 0.0, 0.02]))._replace(
        entry_m=np.array([0.0, -0.04, 0.0]), target_m=np.zeros(3)
    )
    slices = ScanSlices(scene)
    side, head, probe = slices.draw(None)

    # 40 mm in pixels of 0.8 mm above the target, which stands where a tip would.
    for picture in (side, head):
        is_path = (picture == TARGET_COLOR).all(axis=2)
        assert is_path[:, 70].nonzero()[0].tolist() == list(
            range(TIP_ROW - 50, TIP_ROW + 3)
        )
    assert tuple(probe[70, 70]) == TARGET_COLOR
    assert not (side == (255, 212, 0)).all(axis=2).any()  # no needle
    assert slices.draw(None) is None

    path = scene.path
    side, *_ = slices.draw(NeedlePose(path.entry_m, path.axis))
    is_path = (side == TARGET_COLOR).all(axis=2)

    assert is_path[TIP_ROW + 10, 70]
    assert (side[TIP_ROW - 10, 70] == (255, 212, 0)).all()


COUNT_TONES = """(() => { window.tones = [];
const start = OscillatorNode.prototype.start;
OscillatorNode.prototype.start = function (...when) {
  window.tones.push(this.frequency.value); return start.apply(this, when); }; })()"""


def test_a_line_joins_the_needle_and_the_nearest_structure():
    robot = load_lwr(payload=NeedleTool())
    viewer = Viewer(robot, watched_plan(), port=8496)
    try:
        tip_m, axis = viewer._arm.needle_at(HOME)
        aside = np.cross(axis, [0.0, 1.0, 0.0])
        place_m = tip_m + 0.004 * axis + 0.012 * aside / np.linalg.norm(aside)
        near = dict(zip(("near_x_m", "near_y_m", "near_z_m"), place_m, strict=True))
        unknown = dict.fromkeys(near, np.nan)
        viewer.append(
            np.array(
                [
                    row(0.0, **on_plan(**unknown)),
                    row(1.0, **on_plan(**near)),
                    row(2.0, **on_plan(**near, near_is_too_near=1.0)),
                ]
            )
        )
        viewer.show(0.0)
        assert not viewer._nearest.visible
        viewer.show(1.0)
        start_m, end_m = viewer._nearest.points[0]
        assert viewer._nearest.visible
        assert np.allclose(end_m, place_m, atol=1e-6)
        # At a right angle to the needle, where the structure is nearest to it.
        assert np.allclose(start_m, tip_m + 0.004 * axis, atol=1e-6)
        viewer.show(2.0)
        assert viewer._nearest.colors.tolist() == [230, 30, 30]
    finally:
        viewer.stop()


def shown_events():
    """Rows with an event at 1, 2, 3 and 4 s."""
    rows = [row(0.0, **on_plan())]
    for time_s, number in enumerate(EVENT.values(), 1):
        rows.append(row(float(time_s), 0.001 * time_s, event=number, **on_plan()))
    return np.array(rows)


@needs_chromium
def test_events_sound_once_somebody_has_pressed_a_key():
    from tests.needleforce.scene.scene_page import open_page

    viewer = Viewer(load_lwr(payload=NeedleTool()), watched_plan(), port=8495)
    viewer.append(shown_events())
    viewer.show(0.0)
    try:
        with open_page(viewer.url, PHONE) as page:
            page.set_size(PHONE)
            shown = "document.querySelector('[data-event]')?.dataset.event"
            assert page.wait_for(f"{shown} === ''")
            page.evaluate(COUNT_TONES)
            hint = "document.querySelector('.silent')?.checkVisibility() ?? false"
            assert page.evaluate(hint)
            viewer.show(1.0)
            assert page.wait_for(f"{shown} === 'rupture'")
            time.sleep(0.3)
            assert page.evaluate("tones.length") == 0  # nobody has pressed a key

            page.click("document.querySelector('.needle-card')")
            assert page.wait_for(f"!({hint})")
            for time_s, kind, count in (
                (2.0, "hard_contact", 2),
                (3.0, "too_near", 6),
                (4.0, "past_target", 10),
            ):
                viewer.show(time_s)
                assert page.wait_for(f"{shown} === '{kind}'")
                assert page.wait_for(f"tones.length === {count}", 5.0)

            viewer.show(1.0)  # back: an event of the past makes no sound
            assert page.wait_for(f"{shown} === 'rupture'")
            viewer._sounds.value = False
            viewer.show(4.0)
            assert page.wait_for(f"{shown} === ''")
            time.sleep(0.3)
            assert page.evaluate("tones.length") == 10

            # All of the card is seen on a phone, nothing is cut.
            box = "document.querySelector('.needle-card').getBoundingClientRect()"
            assert page.evaluate(f"{box}.right") <= 390
            assert page.evaluate(f"{box}.top") > 0
            assert page.evaluate(f"{box}.bottom") <= 844
            assert page.errors == []
    finally:
        viewer.stop()
