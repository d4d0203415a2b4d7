"""The exported page: film, CT, forces, ruptures, warnings, in one file."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from tests.chromium import PHONE, needs_chromium
from tests.needleforce.scene.test_page import insertion, plan
from tests.needleforce.scene.test_panel import scanned

pytest.importorskip("viser")

from needleforce import NeedleTool, load_lwr
from needleforce.plots import Chart, Curve, LineStyle, Panel, draw_svg
from needleforce.scene import PlanScene, Viewer
from needleforce.scene.export_page import SceneWords, slice_strips, write_scene_page
from needleforce.scene.film import Film, FilmFrame, FilmRupture, film_times_s
from needleforce.scene.legend import legend_html, legend_lines
from needleforce.scene.plan_scene import export_plan
from needleforce.scene.scan_slices import SlicePictures
from needleforce.scene.state_ring import FIELDS

WARNING = "no labels beside the plan: <b>clearance</b> not checked"

FILM = "document.getElementById('scene').contentDocument"
NOW = "document.getElementById('now').textContent"
BANNER = "document.getElementById('banner')"
SLIDER = f"{FILM}?.querySelector('[role=slider]')"
HAS_PLAYER = f"Boolean({SLIDER})"


@pytest.fixture(scope="module")
def page(tmp_path_factory):
    """An exported page with a CT and a warning, which ends off the plan."""
    places = plan()
    scene = scanned(np.array([0.0, 0.0, 0.02]))._replace(
        surfaces=places.surfaces,
        layers=places.layers,
        entry_m=places.entry_m,
        target_m=places.target_m,
        warnings=(WARNING,),
    )
    viewer = Viewer(load_lwr(payload=NeedleTool()), scene, port=8461)
    rows = insertion()
    rows[150:, FIELDS.index("aside_is_off_plan")] = 1.0
    viewer.append(rows)
    path = viewer.export(tmp_path_factory.mktemp("scene") / "scene.html", frames=12)
    viewer.stop()
    return path


@pytest.mark.slow
@needs_chromium
def test_the_page_shows_film_ct_forces_and_what_it_is(page):
    from tests.needleforce.scene.scene_page import open_page

    assert page.stat().st_size < 3_000_000

    with open_page(page.as_uri()) as opened:
        assert opened.wait_for(f"{FILM}?.querySelectorAll('canvas').length > 0")
        text = opened.evaluate("document.querySelector('header').innerText")
        assert "not a medical device" in text
        assert f"Warning: {WARNING}" in text
        sizes = opened.evaluate(
            "JSON.stringify([...document.images].map(i => i.naturalWidth > 100)"
            ".concat([...document.querySelectorAll('.slice')].map(s =>"
            " s.getBoundingClientRect().width > 200 && s.style.backgroundImage"
            ".startsWith('url(\"data:image/jpeg'))))"
        )
        assert json.loads(sizes) == [True] * 5  # two charts, three planes
        assert opened.wait_for(f"!{NOW}.startsWith('0.0 s')")  # the film plays
        assert opened.errors == []


@pytest.mark.slow
@needs_chromium
def test_jumps_move_film_and_page_and_off_plan_is_announced(page):
    from tests.needleforce.scene.scene_page import open_page

    with open_page(page.as_uri()) as opened:
        assert opened.wait_for(HAS_PLAYER)

        opened.evaluate("document.querySelector('[data-time]').click()")

        assert opened.wait_for(f"{NOW}.startsWith('6.0 s, 12.0 mm')")
        assert opened.wait_for(
            f"Math.abs({SLIDER}.getAttribute('aria-valuenow') - 6.0) < 0.01"
        )
        assert opened.evaluate(f"{BANNER}.hidden")

        place = "document.querySelector('.cursor').style.left"
        before = opened.evaluate(place)
        opened.evaluate(
            "(() => { const c = document.querySelector('.chart');"
            "const b = c.getBoundingClientRect();"
            "c.dispatchEvent(new MouseEvent('click', {clientX: b.left + 0.95 * b.width,"
            "bubbles: true})); })()"
        )

        assert opened.wait_for(f"!{BANNER}.hidden")
        assert opened.evaluate(f"{BANNER}.checkVisibility()")
        assert opened.evaluate(place) != before


@pytest.mark.slow
@needs_chromium
def test_on_a_phone_all_but_the_scene_is_folded(page):
    from tests.needleforce.scene.scene_page import open_page

    with open_page(page.as_uri(), PHONE) as opened:
        opened.set_size(PHONE)
        opened.call("Page.reload")
        assert opened.wait_for(HAS_PLAYER)
        found = opened.evaluate(
            "JSON.stringify({open: [...document.querySelectorAll('details')]"
            ".filter(d => d.open).length, width: document.scrollingElement.scrollWidth,"
            "height: document.getElementById('scene').getBoundingClientRect().height})"
        )
        found = json.loads(found)

        assert found["open"] == 0
        assert found["width"] <= PHONE[0]
        assert found["height"] > 0.4 * PHONE[1]

        opened.evaluate("document.querySelectorAll('summary')[2].click()")

        assert opened.wait_for("document.querySelector('.slice').checkVisibility()")


def test_a_plan_becomes_a_page_with_its_warnings(tmp_path):
    place = export_plan(plan()._replace(warnings=(WARNING,)), tmp_path / "plan.html")
    text = place.read_text(encoding="utf-8")

    assert "not a medical device" in text
    assert "&lt;b&gt;clearance" in text
    assert "planned boundary" in text
    assert "rupture detected" not in text


def test_each_rupture_has_a_picture_of_its_own():
    times_s = film_times_s(np.linspace(2.0, 12.0, 500), [7.123, 12.0], 6)

    assert np.allclose(times_s, [2.0, 4.0, 6.0, 7.123, 8.0, 10.0, 12.0])
    assert film_times_s(np.array([1.0]), [], 1).tolist() == [1.0, 1.05]


@needs_chromium
def test_alarms_that_are_to_come_or_retracted_are_pale(tmp_path):
    from tests.needleforce.scene.scene_page import open_page

    frame = FilmFrame(0.0, 5.0, 12.0, "5.0 s", (), banner="", card="", slices=-1)
    times_s = {"retracted": (1.0, 3.0), "stands": (4.0, np.inf), "later": (6.0, 7.0)}
    ruptures = [FilmRupture(*times, name) for name, times in times_s.items()]
    path = write_scene_page(
        tmp_path / "scene.html",
        "<p></p>",
        SceneWords("needleforce", (), ()),
        Film([frame], ruptures, ()),
    )
    with open_page(path.as_uri()) as opened:
        assert opened.wait_for(f"{NOW} === '5.0 s'")
        pale = "[...document.querySelectorAll('#ruptures .unknown')]"
        texts = opened.evaluate(f"JSON.stringify({pale}.map(l => l.innerText.trim()))")

    assert json.loads(texts) == ["1.0 s: retracted", "6.0 s: later"]


def test_pictures_of_a_plane_stand_in_rows_of_twelve():
    one = np.zeros((8, 8, 3), np.uint8)
    film = Film((), (), [SlicePictures(one, one, one)] * 13)
    strips = slice_strips(film)

    assert [(strip.columns, strip.rows) for strip in strips] == [(12, 2)] * 3
    assert slice_strips(Film((), (), ())) == ()


def test_the_legend_names_what_is_shown():
    surface = SimpleNamespace(name="left_kidney", colour=(1.0, 0.0, 0.0))
    alone = [line.text for line in legend_lines(PlanScene())]
    texts = [line.text for line in legend_lines(plan()._replace(surfaces=[surface]))]

    assert "planned path" not in alone
    assert "rupture detected" in alone
    assert texts[-1] == "left kidney"
    assert "rgb(255, 0, 0)" in legend_html(legend_lines(PlanScene([surface])))


def test_a_drawn_chart_states_where_its_axis_stands():
    curve = Curve(
        style=LineStyle(color="#000000"),
        x=np.array([0.0, 10.0]),
        y=np.array([0.0, 1.0]),
        label="force",
    )
    chart = Chart(
        title="Force",
        x_label="time [s]",
        panels=(Panel(y_label="force [N]", curves=(curve,)),),
        x_limits=(0.0, 10.0),
    )
    drawn = draw_svg(chart)

    assert drawn.svg.lstrip().startswith("<?xml")
    assert drawn.x_limits == (0.0, 10.0)
    assert 0.0 < drawn.left < 0.3
    assert 0.9 < drawn.right < 1.0
    assert 0.0 < drawn.top < 0.3
    assert 0.6 < drawn.bottom < 0.95
