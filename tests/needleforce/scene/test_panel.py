"""The panel beside the scene: time line, jumps, structures, CT, off plan."""

import time

import numpy as np
import pytest

from tests.chromium import PHONE, needs_chromium
from tests.needleforce.scene.test_page import HOME, insertion, plan, row

pytest.importorskip("viser")

from needleforce import NeedleTool, load_lwr
from needleforce.anatomy import Grid, Volume
from needleforce.plan_file import crop_scan
from needleforce.scene import PlanScene, Viewer
from needleforce.scene.nodes import NeedlePose, free_shift_m, label_shifts_m
from needleforce.scene.scan_slices import PIXELS, TIP_ROW, ScanSlices
from needleforce.scene.state_ring import FIELDS
from needleforce.scene.structure_list import usual_opacity
from needleforce.scene.title_bar import TitleBar


def scanned(bright_m):
    """A plan with a CT of air that has one bright place, in axes of its own."""
    grid = Grid((61, 61, 61), np.full(3, -0.06), 2e-3 * np.eye(3))
    values = np.full(grid.shape, -1000, np.int16)
    i, j, k = np.rint(grid.indices(bright_m)).astype(int)
    values[i - 1 : i + 2, j - 1 : j + 2, k - 1 : k + 2] = 1000
    rotation = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, 1.0], [0.0, -1.0, 0.0]])
    return PlanScene(
        rotation=rotation,
        translation_m=np.array([0.6, 0.0, 0.3]),
        scan=Volume(values, grid),
    )


@pytest.fixture
def viewer():
    """A recording with a plan, which ends off the plan."""
    page = Viewer(load_lwr(payload=NeedleTool()), plan(), port=8431)
    rows = insertion()
    rows[150:, FIELDS.index("aside_is_off_plan")] = 1.0
    page.append(rows)
    page.open_recording()
    yield page
    page.stop()


def wait_until(condition, seconds=10.0):
    """Whether a condition becomes true in time."""
    end_s = time.monotonic() + seconds
    while not condition() and time.monotonic() < end_s:
        time.sleep(0.05)
    return condition()


def test_a_recording_opens_at_its_start(viewer):
    viewer.follow()

    assert viewer.time.slider.value == 0.0
    assert "0.0 s at" in viewer._text.content
    assert not viewer.time.live.visible


@pytest.mark.slow
def test_a_recording_plays_faster_if_asked(viewer):
    viewer.time.speed.value = "8"
    begin_s = time.monotonic()
    viewer.time._toggle(None)

    assert wait_until(lambda: viewer.time.slider.value > 4.0)

    lasted_s = time.monotonic() - begin_s
    shown_s = viewer.time.slider.value

    assert shown_s / lasted_s > 2.0

    viewer.time._toggle(None)

    assert wait_until(lambda: viewer.time.play.label == "Play")


def test_labels_keep_their_distance():
    shifts_m = label_shifts_m([0.02, 0.022, 0.05])

    assert np.allclose(shifts_m, [-0.008, 0.0, 0.0])
    assert label_shifts_m([]) == []


def test_a_label_moves_inwards_past_those_that_stand():
    assert free_shift_m(0.02, []) == 0.0
    assert free_shift_m(0.02, [0.0, 0.05]) == 0.0
    assert free_shift_m(0.02, [0.03, 0.022]) == pytest.approx(0.02)


def test_what_surrounds_all_others_is_faint():
    assert usual_opacity("subcutaneous_fat") < 0.1
    assert usual_opacity("skin") < 0.1
    assert usual_opacity("liver") > 0.2
    assert usual_opacity("fatty_lesion") > 0.2


def test_a_bright_place_stands_where_it_lies_in_each_slice():
    bright_m = np.array([0.0, 0.0, 0.02])  # to the head of the model's origin
    scene = scanned(bright_m)
    axis = scene.rotation @ np.array([0.0, 1.0, 0.0])  # to the back
    tip_m = scene.to_robot(np.array([0.0, -0.01, 0.0]))
    slices = ScanSlices(scene)
    side, head, probe = slices.draw(NeedlePose(tip_m, axis))
    middle = PIXELS // 2

    # 10 mm behind the tip, 20 mm to the head, pixels of 0.8 mm.
    assert side[:, 15 : middle - 5].max() == 0  # beside the letter of a side
    assert tuple(head[TIP_ROW + 12, middle + 25]) == (255, 255, 255)
    assert head[TIP_ROW + 12, middle - 25].max() == 0
    assert probe[15 : middle - 10].max() == 0  # the bright place is deeper than the tip

    *_, probe = slices.draw(NeedlePose(tip_m + 0.01 * axis, axis))

    assert tuple(probe[middle - 25, middle]) == (255, 255, 255)
    assert slices.draw(NeedlePose(tip_m + 0.0101 * axis, axis)) is None


def test_a_cropped_scan_is_the_same_scan():
    scan = scanned(np.array([0.0, 0.0, 0.02])).scan
    wide = Grid((300, 61, 61), scan.grid.origin_m, scan.grid.axes_m)
    values = np.zeros(wide.shape, np.int16)
    values[:61] = scan.values
    cropped = crop_scan(Volume(values, wide), np.zeros(3), np.array([0.0, 0.0, 0.02]))
    outside = np.full(3, 2.0)

    assert crop_scan(scan, outside, outside + 0.05) is None

    index = np.rint(cropped.grid.indices([0.0, 0.0, 0.02])).astype(int)

    assert cropped.values.shape[0] < 100
    assert cropped.values[tuple(index)] == 1000


def test_the_title_bar_says_off_plan_and_warnings(viewer):
    sent = []

    class Gui:
        def configure_theme(self, **theme):
            content = theme["titlebar_content"]
            sent.append(content and content["image"]["image_alt"])

    class Server:
        gui = Gui()

    bar = TitleBar(Server(), ("no labels",))
    bar.show("")
    bar.show("OFF PLAN")
    bar.hide()
    bar.show("")
    bar.restore("")

    on_plan = "Simulation and research only: not a medical device. Warning: no labels."
    off_plan = f"OFF PLAN: no layer is named from the plan. {on_plan}"
    assert sent == [on_plan, off_plan, None, on_plan]


KEY = (
    "(() => {{ const s = document.querySelectorAll('[role=slider]')[{number}];"
    "s.focus(); s.dispatchEvent(new KeyboardEvent('keydown',"
    "{{key: '{key}', code: '{key}', bubbles: true}})); }})()"
)
CLICK = (
    "[...document.querySelectorAll('button, .mantine-Paper-root')]"
    ".filter(b => b.innerText.startsWith('{text}'))[0].click()"
)
TITLE = "document.images[0].alt"


@pytest.mark.slow
@needs_chromium
def test_slider_jump_opacity_and_banner_work_in_a_browser(viewer):
    from tests.needleforce.scene.scene_page import open_page

    liver = viewer._surfaces["liver"]
    with open_page(viewer.url) as page:
        assert page.wait_for("document.body.innerText.includes('6.0 s: rupture 1')")
        assert "not a medical device" in page.evaluate(TITLE)

        page.evaluate(CLICK.format(text="6.0 s: rupture 1"))

        assert page.wait_for("document.body.innerText.includes('rupture 1 at 12.0 mm')")
        assert viewer.time.slider.value == 6.0

        page.evaluate(KEY.format(number=0, key="End"))

        assert page.wait_for(f"{TITLE}.startsWith('OFF PLAN: no layer is named')")

        page.evaluate(KEY.format(number=0, key="Home"))

        assert page.wait_for(f"!{TITLE}.includes('OFF PLAN')")
        assert viewer.time.slider.value == 0.0

        page.click(
            "[...document.querySelectorAll('[role=tab]')]"
            ".filter(e => e.innerText == 'Structures')[0]"
        )
        assert page.wait_for("document.body.innerText.includes('opacity')")
        page.evaluate(
            KEY.format(number=0, key="Home").replace(
                "document.querySelectorAll('[role=slider]')",
                "[...document.querySelectorAll('[role=slider]')]"
                ".filter(e => e.checkVisibility())",
            )
        )

        assert wait_until(lambda: liver.opacity == 0.0)
        page.evaluate(
            "document.getElementById([...document.querySelectorAll('label')]"
            ".filter(e => e.innerText == 'liver')[0].htmlFor).click()"
        )

        assert wait_until(lambda: not liver.visible)
        assert page.errors == []


@pytest.mark.slow
@needs_chromium
def test_on_a_phone_the_panel_is_folded_at_first():
    from tests.needleforce.scene.scene_page import open_page

    warned = plan()._replace(warnings=("no labels beside the plan",))
    viewer = Viewer(load_lwr(payload=NeedleTool()), warned, port=8451)
    viewer.append(insertion())
    viewer.open_recording()
    above = (
        "[...document.querySelectorAll('p')].filter(e => e.innerText.includes("
        "'0.0 s, 0.0 mm'))[0].getBoundingClientRect().top"
    )
    slider = "document.querySelector('[role=slider]')"
    try:
        with open_page(viewer.url, PHONE) as page:
            page.set_size(PHONE)
            assert page.wait_for("document.body.innerText.includes('0.0 s, 0.0 mm')")
            assert page.wait_for(
                "document.body.innerText.includes('no labels beside the plan')"
            )
            assert page.evaluate(above) > 0.6 * PHONE[1]
            assert not page.evaluate(f"{slider}?.checkVisibility() ?? false")

            page.click("document.querySelector('[aria-label^=\"Expand panel\"]')")

            assert page.wait_for(f"{slider}?.checkVisibility() ?? false")
    finally:
        viewer.stop()


def test_a_live_page_follows_the_newest():
    page = Viewer(load_lwr(payload=NeedleTool()), port=8441)
    page.append(np.array([row(0.0), row(1.0, 0.01, q=HOME)]))
    page.follow()

    assert page.time.slider.value == 1.0

    page.stop()
