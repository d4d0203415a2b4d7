"""The exported page: film, CT, forces, ruptures, warnings, in one file."""

import json
import re
from types import SimpleNamespace

import numpy as np
import pytest

from tests.chromium import PHONE, needs_chromium
from tests.needleforce.scene.test_page import insertion, plan
from tests.needleforce.scene.test_panel import scanned

pytest.importorskip("viser")

from needleforce import NeedleTool, load_lwr
from needleforce.scene import PlanScene, Viewer
from needleforce.scene.export_page import (
    describe_banners,
    film_times_s,
    rupture_section,
)
from needleforce.scene.legend import legend_html, legend_lines
from needleforce.scene.plan_scene import export_plan
from needleforce.scene.state_ring import FIELDS

WARNING = "no labels beside the plan: <b>clearance</b> not checked"

FILM = "document.getElementById('scene').contentDocument"
HAS_PLAYER = f"Boolean({FILM}?.querySelector('[role=slider]'))"


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
@pytest.mark.parametrize("size", [(1280, 900), PHONE])
def test_the_page_shows_film_ct_forces_and_what_it_is(page, size):
    from tests.needleforce.scene.scene_page import open_page

    assert page.stat().st_size < 3_000_000

    with open_page(page.as_uri()) as opened:
        opened.set_size(size)
        opened.call("Page.reload")
        assert opened.wait_for(f"{FILM}?.querySelectorAll('canvas').length > 0")
        assert opened.wait_for(HAS_PLAYER)
        text = opened.evaluate("document.body.innerText")
        assert "not a medical device" in text
        assert f"Warning: {WARNING}" in text
        assert re.search(
            r"Warning: OFF PLAN from \d+\.\d to \d+\.\d s of the film", text
        )
        assert "rupture 1 at" in text
        assert "planned boundary" in text
        found = json.loads(
            opened.evaluate(
                "JSON.stringify({wide: document.scrollingElement.scrollWidth,"
                "images: [...document.images].map(i => i.naturalWidth),"
                "height: document.getElementById('scene').offsetHeight})"
            )
        )
        assert found["wide"] <= size[0]
        assert min(found["images"]) > 100
        assert len(found["images"]) == 5  # two charts, three planes
        assert found["height"] > 0.5 * size[1]
        assert opened.errors == []


def test_the_page_begins_with_the_clinicians_view_where_the_needle_was_deepest(page):
    text = page.read_text(encoding="utf-8")
    card = text[text.index("Where the needle was deepest") : text.index("<iframe")]

    assert "⚠ OFF PLAN" in card
    assert 'data-part="target"' in card
    assert 'data-part="bullseye"' in card
    assert "Sound" not in card  # a page that is read afterwards is silent


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


def test_a_retracted_alarm_is_named_with_its_end():
    section = rupture_section([(1.0, 3.0, "first"), (4.0, np.inf, "second")])

    assert section.tables[0].rows == (
        ("1.0", "first; retracted at 3.0 s"),
        ("4.0", "second"),
    )
    assert rupture_section([]).paragraphs == ("None was detected.",)


def test_each_stretch_off_the_plan_is_named():
    banners = ["", "OFF PLAN", "OFF PLAN", "", "PAST TARGET"]
    texts = describe_banners(np.arange(5.0), banners)

    assert [text.partition(" of the film")[0] for text in texts] == [
        "OFF PLAN from 1.0 to 2.0 s",
        "PAST TARGET from 4.0 to 4.0 s",
    ]


def test_the_legend_names_what_is_shown():
    surface = SimpleNamespace(name="left_kidney", colour=(1.0, 0.0, 0.0))
    alone = [line.text for line in legend_lines(PlanScene())]
    texts = [line.text for line in legend_lines(plan()._replace(surfaces=[surface]))]

    assert "planned path" not in alone
    assert "rupture detected" in alone
    assert texts[-1] == "left kidney"
    assert "rgb(255, 0, 0)" in legend_html(legend_lines(PlanScene([surface])))
