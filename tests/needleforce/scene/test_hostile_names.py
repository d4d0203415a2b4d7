"""Names from files that are markup: nothing in them runs, nothing is fetched."""

import threading
import time
from contextlib import contextmanager
from functools import partial
from http.client import HTTPConnection
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from types import SimpleNamespace
from urllib.parse import urlsplit

import numpy as np
import pytest

from tests.chromium import needs_chromium
from tests.needleforce.scene.test_page import plan, planned, row

pytest.importorskip("viser")

from needleforce import NeedleTool, load_lwr
from needleforce.plots import Page, PageTable, Section, write_page
from needleforce.scene import Viewer
from needleforce.scene.plan_scene import export_plan

HAS_RUN = "Boolean(window.hasRun)"
SETTLE_S = 3.0
"""So long a page may fetch what it should not."""


class CountingHandler(BaseHTTPRequestHandler):
    def __init__(self, paths, *arguments):
        self.paths = paths
        super().__init__(*arguments)

    def do_GET(self):
        self.paths.append(self.path)
        self.send_response(200)
        self.send_header("Access-Control-Allow-Origin", "*")
        self.end_headers()

    def log_message(self, *_):
        pass


@contextmanager
def counting_server():
    """A server that notes what is fetched from it: its address, and the paths."""
    paths = []
    server = ThreadingHTTPServer(("127.0.0.1", 0), partial(CountingHandler, paths))
    threading.Thread(target=server.serve_forever, daemon=True).start()
    try:
        yield f"http://127.0.0.1:{server.server_port}", paths
    finally:
        server.shutdown()
        server.server_close()


def hostile(place, url):
    """A name that runs and fetches wherever markup of a name is not escaped."""
    get = f"{url}/{place}"
    run = f"top.hasRun=true;fetch(`{get}-fetch`)"
    return (
        f'<iframe srcdoc="<script>{run}</script>"></iframe>'
        f"<iframe src={get}-frame></iframe><script>{run}</script>"
        f'<img src="{get}-image" onerror="{run}"><svg onload="{run}"></svg>'
        f"![picture]({get}-markdown.png) [link]({get}-link) **bold** {{{run}}} "
        f'<link rel=stylesheet href="{get}-style">'
        f'<meta http-equiv=refresh content="0;url={get}-refresh">{place}'
    )


def hostile_plan(url):
    """A plan whose layers, structures and warnings have hostile names."""
    places = plan()
    named = partial(hostile, url=url)
    return places._replace(
        surfaces=[
            SimpleNamespace(**{**vars(one), "name": named(f"structure-{one.name}")})
            for one in places.surfaces
        ],
        layers=[
            SimpleNamespace(**{**vars(one), "name": named(f"layer-{one.name}")})
            for one in places.layers
        ],
        warnings=(named("warning"),),
    )


def in_layers():
    """Rows in each planned layer, with a rupture that the plan names."""
    return np.array(
        [
            row(0.0, **planned(0, 22.0)),
            row(1.0, 0.0221, 1.0, **planned(1, 52.0, 1)),
            row(2.0, 0.03, **planned(1, 52.0)),
        ]
    )


@pytest.fixture
def served():
    """The live page of a hostile plan, with its counting server."""
    with counting_server() as (url, paths):
        viewer = Viewer(load_lwr(payload=NeedleTool()), hostile_plan(url), port=8471)
        viewer.append(in_layers())
        viewer.show()
        yield viewer, paths
        viewer.stop()


@needs_chromium
def test_hostile_names_in_the_live_page_are_text(served):
    from tests.needleforce.scene.scene_page import open_page

    viewer, paths = served
    with open_page(viewer.url) as page:
        shown = "document.body.innerText"
        assert page.wait_for(f"{shown}.includes('layer-liver')")
        assert page.wait_for("document.querySelectorAll('canvas').length > 0")
        time.sleep(SETTLE_S)

        assert "<iframe srcdoc=" in page.evaluate(shown)
        page.click(
            "[...document.querySelectorAll('*')].findLast("
            "e => e.textContent.trim() === 'Structures')"
        )
        assert page.wait_for(f"{shown}.includes('structure-rib')")
        time.sleep(SETTLE_S)
        assert not page.evaluate(HAS_RUN)
        assert page.evaluate("document.querySelectorAll('iframe').length") == 0
        assert page.errors == []
    assert paths == []


@needs_chromium
def test_markup_that_got_into_the_live_page_neither_runs_nor_fetches(served):
    from tests.needleforce.scene.scene_page import open_page

    viewer, paths = served
    with open_page(viewer.url) as page:
        assert page.wait_for("document.body.innerText.includes('layer-liver')")
        # As if a name had not been escaped.
        viewer._events.content = viewer._plan.warnings[0].partition("<meta")[0]
        assert page.wait_for("document.querySelectorAll('iframe').length > 0")
        time.sleep(SETTLE_S)

        assert not page.evaluate(HAS_RUN)
    assert paths == []


@needs_chromium
@pytest.mark.parametrize("with_film", [True, False])
def test_hostile_names_in_an_exported_scene_are_text(with_film, tmp_path):
    from tests.needleforce.scene.scene_page import open_page

    path = tmp_path / "scene.html"
    with counting_server() as (url, paths):
        if with_film:
            viewer = Viewer(load_lwr(), hostile_plan(url), port=8481)
            viewer.append(in_layers())
            viewer.export(path, frames=3)
            viewer.stop()
        else:
            export_plan(hostile_plan(url), path)
        with open_page(path.as_uri()) as page:
            frame = "document.getElementById('scene').contentDocument"
            assert page.wait_for(f"{frame}?.querySelectorAll('canvas').length > 0")
            time.sleep(SETTLE_S)

            assert "structure-rib" in page.evaluate("document.body.textContent")
            assert not page.evaluate(HAS_RUN)
            assert page.evaluate("document.querySelectorAll('iframe').length") == 1
            assert page.errors == []
        assert paths == []


@needs_chromium
def test_hostile_names_in_a_report_are_text(tmp_path):
    from tests.needleforce.scene.scene_page import open_page

    with counting_server() as (url, paths):
        named = partial(hostile, url=url)
        table = PageTable(
            caption=named("caption"), head=(named("joint"),), rows=((named("file"),),)
        )
        section = Section(
            heading=named("heading"),
            anchor=named('anchor" onclick="'),
            paragraphs=(named("text"),),
            command=named("command"),
            tables=(table,),
        )
        page = Page(
            title=named("title"), lead=(named("lead"),), sections=(section,) * 3
        )
        path = write_page(tmp_path / "index.html", page)
        with open_page(path.as_uri()) as opened:
            assert opened.wait_for("document.body.innerText.includes('command')")
            time.sleep(SETTLE_S)

            assert not opened.evaluate(HAS_RUN)
            assert opened.evaluate("document.querySelectorAll('iframe').length") == 0
        assert paths == []


def test_the_live_page_is_sent_with_its_policy(served):
    place = urlsplit(served[0].url)
    policies = []
    for _ in range(2):
        connection = HTTPConnection("127.0.0.1", place.port, timeout=10.0)
        connection.request("GET", "/", headers={"Accept-Encoding": "gzip"})
        policies.append(connection.getresponse().getheader("Content-Security-Policy"))
        connection.close()

    assert all(policy.startswith("default-src 'none'; ") for policy in policies)
    assert policies[0] != policies[1]  # the nonce of a page cannot be known before
