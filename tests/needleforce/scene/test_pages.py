"""Pages: served, beside a loop, exported; names from files stay text in each."""

import errno
import os
import signal
import time
from pathlib import Path

import numpy as np
import pytest

from needleforce import NeedleTool, load_lwr
from needleforce.cli import main
from needleforce.plots import Page, PageTable, Section, write_page
from needleforce.recordings import write_table
from needleforce.scene import PlanScene, SceneError, Viewer, export_plan, open_viewer
from needleforce.simulation import signal_table
from tests.chromium import PHONE, needs_chromium
from tests.insertion_run import short_run
from tests.needleforce.scene.insertions import (
    HOME,
    deviation,
    insertion,
    moment,
    plan,
    planned,
    tick,
)
from tests.needleforce.scene.scene_page import browse

POINT = PlanScene(entry_m=np.zeros(3), target_m=np.zeros(3))
FILM = "document.getElementById('scene').contentDocument"
SETTLE_s = 1.0
"""So long a page may fetch what it should not."""


@pytest.fixture(scope="module")
def exported(tmp_path_factory):
    """A page of two ruptures, one of which was none."""
    scene = plan()._replace(warnings=("<b>unchecked",))
    viewer = Viewer(load_lwr(payload=NeedleTool()), scene, port=8621)
    viewer.append(
        [
            moment(1.0, 0.0, deviation=deviation()),
            moment(2.0, 0.02, rupture=1, deviation=deviation()),
            moment(2.5, 0.03, rupture=2, deviation=deviation()),
            moment(4.0, 0.05, retracted=2, deviation=deviation()),
        ]
    )
    path = viewer.export(tmp_path_factory.mktemp("scene") / "scene.html", frames=3)
    viewer.stop()
    return path


def test_an_export_names_ruptures_warnings_and_what_it_is(exported):
    text = exported.read_text(encoding="utf-8")

    assert text.count("; retracted") == 1
    for part in (
        "1.5 s: rupture of layer 2 at 30.0 mm",
        "&lt;b&gt;unchecked",
        "not a medical device",
        "rupture detected",
    ):
        assert part in text


@pytest.mark.slow
@needs_chromium
@pytest.mark.parametrize("size", [(1280, 900), PHONE])
def test_an_export_plays_in_a_browser(exported, size):
    assert exported.stat().st_size < 3_000_000
    with browse(exported.as_uri()) as page:
        page.set_size(size)
        page.call("Page.reload")
        assert page.wait_for(f"{FILM}?.querySelectorAll('canvas').length > 0")
        assert page.wait_for(f"Boolean({FILM}?.querySelector('[role=slider]'))")
        assert page.evaluate("document.scrollingElement.scrollWidth") <= size[0]
        assert page.errors == []


def test_a_failing_export_leaves_the_older_page(tmp_path, monkeypatch, open_page):
    def full(_handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    path = tmp_path / "page.html"
    path.write_text("old")
    with pytest.raises(SceneError, match="nothing"):
        open_page().export(path)
    monkeypatch.setattr(os, "fsync", full)
    with pytest.raises(SceneError, match="space"):
        open_page(*insertion(2)).export(path, frames=2)

    assert [item.read_text() for item in tmp_path.iterdir()] == ["old"]


def test_a_plan_becomes_a_page_without_a_needle(tmp_path):
    text = export_plan(plan(), tmp_path / "plan.html").read_text(encoding="utf-8")
    words = ("not a medical device", "planned boundary", "rupture detected")

    assert [word in text for word in words] == [True, True, False]


# Names that are markup


NOWHERE = "http://127.0.0.1:9"
"""Where nobody listens: what is fetched from there is an error of the page."""


def hostile(place):
    """A name that runs and fetches wherever markup of a name is not escaped."""
    get = f"{NOWHERE}/{place}"
    run = f"top.hasRun=true;fetch(`{get}-fetch`)"
    return (
        f'<iframe srcdoc="<script>{run}</script>"></iframe>'
        f"<iframe src={get}-frame></iframe><script>{run}</script>"
        f'<img src="{get}-image" onerror="{run}"><svg onload="{run}"></svg>'
        f"![picture]({get}-markdown.png) [link]({get}-link) **bold** {{{run}}} "
        f'<link rel=stylesheet href="{get}-style">'
        f'<meta http-equiv=refresh content="0;url={get}-refresh">{place}'
    )


def hostile_scene():
    """A plan with hostile names everywhere, and a rupture into one of its layers."""
    scene = plan()
    for one in (*scene.surfaces, *scene.layers):
        one.name = hostile(one.name)
    names = dict.fromkeys(("name", "next_name", "matched_name"), scene.layers[1].name)
    state = planned(1, 0.052, 1)._replace(**names)
    return (
        scene._replace(warnings=(hostile("warning"),), watched=(hostile("watched"),)),
        moment(1.0, 0.022, rupture=1, plan=state, deviation=deviation()),
    )


@needs_chromium
@pytest.mark.parametrize("kind", ["live", "film", "report"])
def test_names_in_a_page_are_text(kind, tmp_path, open_page):
    path = tmp_path / "page.html"
    scene, rupture = hostile_scene()
    viewer = open_page(moment(0.0), rupture, scene=scene)
    if kind == "film":
        viewer.export(path, frames=3)
    else:
        write_report(path)
    with browse(viewer.url if kind == "live" else path.as_uri()) as page:
        text = "document.body.textContent"
        assert page.wait_for(f"{text}.includes('warning')")
        if kind != "report":
            views = "document" if kind == "live" else FILM
            assert page.wait_for(f"{views}?.querySelectorAll('canvas').length > 0")
        time.sleep(SETTLE_s)
        assert "<iframe srcdoc=" in page.evaluate(text)
        assert not page.evaluate("Boolean(window.hasRun)")
        frames = page.evaluate("document.querySelectorAll('iframe').length")
        assert (frames, page.errors) == (kind == "film", [])


def write_report(path):
    """A page whose every text has a hostile name in it."""
    table = PageTable(
        caption=hostile("caption"),
        head=(hostile("joint"),),
        rows=((hostile("file"),),),
    )
    section = Section(
        heading=hostile("heading"),
        anchor=hostile('anchor" onclick="'),
        paragraphs=(hostile("text"),),
        tables=(table,),
    )
    lead = (hostile("warning"),)
    page = Page(title=hostile("title"), lead=lead, sections=(section,) * 3)
    write_page(path, page)


@pytest.mark.slow
@needs_chromium
def test_the_page_is_used_in_a_browser(open_page):
    viewer = open_page(*insertion())
    viewer.open_recording()
    text = "document.body.innerText"
    with browse(viewer.url) as page:
        assert page.wait_for(f"{text}.includes('6.0 s: rupture 1')")
        assert "not a medical device" in page.evaluate(text)
        page.evaluate(
            "[...document.querySelectorAll('button')]"
            ".find(b => b.innerText.startsWith('6.0 s: rupture 1')).click()"
        )
        assert page.wait_for(f"{text}.includes('rupture of layer 1 at 12.0 mm')")
        assert viewer.slider.value == 6.0
        page.evaluate(
            "(() => { const s = document.querySelector('[role=slider]'); s.focus();"
            "s.dispatchEvent(new KeyboardEvent('keydown', {key: 'Home',"
            "code: 'Home', bubbles: true})); })()"
        )
        assert page.wait_for(f"!{text}.includes('rupture of layer 1 at 12.0 mm')")
        assert page.errors == []
    with browse(viewer.url, PHONE) as page:
        page.set_size(PHONE)
        assert page.wait_for(f"{text}.includes('0.0 s, 0.0 mm')")
        # All of the card is seen, nothing is cut.
        box = "document.querySelector('.needle-card').getBoundingClientRect()"
        assert page.evaluate(f"{box}.right") <= PHONE[0]
        assert page.evaluate(f"{box}.top") > 0


# Beside a loop, and commands


@pytest.mark.slow
@needs_chromium
def test_a_loop_hands_ticks_to_a_page_process():
    with open_viewer(load_lwr(payload=NeedleTool()), port=8661) as view:
        for k in range(1000):
            view.put(tick(1e-3 * k, 1e-5 * k, rupture=1 if k == 500 else None), HOME)
        with browse(view.url) as page:
            text = "document.body.innerText"
            assert page.wait_for(f"{text}.includes('rupture of layer 1 at 5.0 mm')")
            assert page.wait_for(f"{text}.includes('1.0 s, 9.')")
    assert not view._process.is_alive()


@pytest.mark.slow
def test_a_page_that_hangs_holds_no_loop_up():
    with open_viewer(load_lwr(), port=8681) as view:
        os.kill(view._process.pid, signal.SIGSTOP)
        start_s = time.monotonic()
        for k in range(3000):
            view.put(tick(0.02 * k), HOME)
        assert time.monotonic() - start_s < 2.0
    assert not view._process.is_alive()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("scene", "port", "word"),
    [(PlanScene(), 70000, "70000"), (POINT, 8671, "two points")],
)
def test_a_page_that_cannot_open_is_reported(scene, port, word):
    with pytest.raises(SceneError, match=word):
        open_viewer(load_lwr(), scene, port=port)


@pytest.mark.slow
@pytest.mark.parametrize(
    ("tare_s", "warning", "expected"),
    [
        ("0.5", "", (0, "a.html\n", [True])),
        ("60", "no tare", (0, "a.html\n", [True])),
        ("nan", "nan", (2, "", [])),
    ],
)
def test_a_recording_is_exported_by_the_command(
    tare_s, warning, expected, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    table = signal_table(short_run())
    names = ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    write_table("a.npz", {name: table[name][:2001] for name in names})
    code = main(["view", "a.npz", "--tare", tare_s, "--export", "a.html"])
    said, warned = capsys.readouterr()

    are_large = [page.stat().st_size > 500_000 for page in Path().glob("*.html")]
    assert (code, said, are_large) == expected
    assert warning in warned


@pytest.mark.parametrize(
    ("arguments", "word"),
    [
        (["log.csv", "--export", "log.csv"], ".html"),
        (["log.csv", "--export", "link.html"], "link.html"),
        (["log.csv", "--export", "no/page.html"], "no"),
        (["log.csv", "--anatomy", "."], "plan.json"),
    ],
)
def test_an_export_or_a_plan_that_cannot_be_is_refused_early(
    arguments, word, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("t,q_1\n0,0\n")
    Path("link.html").symlink_to("log.csv")

    assert main(["view", *arguments]) == 2
    assert word in capsys.readouterr().err
    assert Path("log.csv").read_text() == "t,q_1\n0,0\n"
