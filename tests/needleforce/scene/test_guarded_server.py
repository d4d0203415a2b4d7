"""Who may open the page: its own pages on known hosts, with a token off loopback."""

import threading
import time
import tomllib
from contextlib import contextmanager
from functools import partial
from http.client import HTTPConnection
from http.server import SimpleHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path
from urllib.parse import urlsplit

import numpy as np
import pytest

from tests.chromium import needs_chromium
from tests.needleforce.scene.test_page import insertion

pytest.importorskip("viser")

from viser import __version__ as viser_version
from websockets.datastructures import Headers
from websockets.exceptions import InvalidStatus
from websockets.sync.client import connect

from needleforce import NeedleTool, load_lwr
from needleforce.scene import SceneError, Viewer, guarded_server
from needleforce.scene.guarded_server import PageAccess, is_loopback

ROOT = Path(__file__).parents[3]
LOOPBACK = "local" + "host"
PROTOCOL = f"viser-v{viser_version}"


@pytest.fixture
def viewer():
    page = Viewer(load_lwr(payload=NeedleTool()), port=8401)
    page.append(insertion())
    page.show()
    yield page
    page.stop()


@pytest.fixture
def open_to_all():
    """A page bound to every address, known by one name."""
    page = Viewer(
        load_lwr(payload=NeedleTool()),
        host="0.0.0." + "0",
        port=8411,
        further_hosts=["arm.example"],
    )
    yield page
    page.stop()


def status(url, path="/", **headers):
    """The status of a request to the page of an address, and its cookie."""
    place = urlsplit(url)
    connection = HTTPConnection("127.0.0.1", place.port, timeout=10.0)
    connection.request("GET", path, headers=headers)
    reply = connection.getresponse()
    reply.read()
    connection.close()
    return reply.status, reply.getheader("Set-Cookie")


def handshake(url, origin=None, **headers):
    """The status with which a websocket is refused; 101 where it opens."""
    port = urlsplit(url).port
    try:
        with connect(
            f"ws://127.0.0.1:{port}",
            origin=origin,
            subprotocols=[PROTOCOL],
            additional_headers=headers,
        ):
            return 101
    except InvalidStatus as refused:
        return refused.response.status_code


@pytest.mark.parametrize(
    ("origin", "expected"),
    [
        (None, 101),  # a program of this machine
        ("http://127.0.0.1:{port}", 101),
        ("http://127.0.0.1:1", 403),
        (f"http://{LOOPBACK}:{{port}}", 403),  # another origin than the host asked
        ("https://evil.example", 403),
        ("null", 403),
    ],
)
def test_a_websocket_from_a_foreign_page_is_refused(viewer, origin, expected):
    port = urlsplit(viewer.url).port
    named = None if origin is None else origin.format(port=port)

    assert handshake(viewer.url, named) == expected


@pytest.mark.parametrize(
    ("host", "expected"),
    [
        (LOOPBACK, 200),
        ("127.0.0.1:8401", 200),
        ("[::1]:8401", 200),
        ("evil.example:8401", 403),
        ("", 403),
        ("127.0.0.1.evil.example", 403),
        ("[", 403),
    ],
)
def test_a_page_by_a_foreign_name_is_refused(viewer, host, expected):
    assert status(viewer.url, Host=host)[0] == expected


def test_on_loopback_there_is_no_token(viewer):
    assert "token" not in viewer.url
    assert status(viewer.url) == (200, None)


def test_elsewhere_the_address_carries_a_token(open_to_all):
    address = urlsplit(open_to_all.url)

    assert address.hostname == "arm.example"
    assert address.query.startswith("token=")
    assert status(open_to_all.url)[0] == 403
    assert status(open_to_all.url, "/?token=wrong")[0] == 403

    code, cookie = status(open_to_all.url, f"/?{address.query}")

    assert code == 200
    assert "HttpOnly; SameSite=Strict" in cookie

    cookie = cookie.split(";")[0]

    assert handshake(open_to_all.url) == 403
    assert handshake(open_to_all.url, Cookie="a=b; " + cookie) == 101
    assert handshake(open_to_all.url, Cookie=cookie + "x") == 403
    assert status(open_to_all.url, Cookie=cookie, Host="other.example")[0] == 403
    assert status(open_to_all.url, Cookie=cookie, Host="arm.example")[0] == 200


def test_tokens_differ_and_loopback_is_known_by_its_addresses():
    one, other = (PageAccess.of_host("192.0." + "2.1") for _ in range(2))

    assert one.token != other.token
    assert is_loopback("127.0.0." + "2")
    assert is_loopback("::1")
    assert not is_loopback(f"{LOOPBACK}.example")


@pytest.mark.parametrize(
    ("given", "expected"),
    [
        ("robot.lab:8080", "expected robot[.]lab"),
        ("http://robot.lab/", "expected robot[.]lab"),
        ("", "such as robot[.]lab"),
    ],
)
def test_a_host_that_browsers_never_name_is_refused(given, expected):
    with pytest.raises(SceneError, match=expected) as caught:
        PageAccess.of_host("127.0.0.1", [given])
    assert "without scheme and port" in caught.value.advice


def test_the_name_that_a_refusal_offers_is_one_that_is_taken():
    headers = Headers()
    headers["Host"] = "Robot.lab:8080"
    refusal = PageAccess.of_host("127.0.0.1").refusal("/", headers)
    offered = refusal.partition("--allow-host ")[2].split()[0]

    assert PageAccess.of_host("127.0.0.1", [offered]).refusal("/", headers) == ""


def test_further_hosts_may_be_addresses():
    hosts = PageAccess.of_host("127.0.0.1", ["fe80::1", "Robot.lab"]).hosts

    assert {"fe80::1", "robot.lab"} <= hosts


def test_a_viser_that_cannot_be_guarded_is_not_served(monkeypatch):
    unguarded = contextmanager(lambda *_: iter(([],)))
    monkeypatch.setattr(guarded_server, "_guarded_serve", unguarded)

    with pytest.raises(SceneError, match="foreign pages: it does not call"):
        Viewer(load_lwr(), port=8421)

    with pytest.raises(ConnectionRefusedError):
        status("http://127.0.0.1:8421")


@pytest.mark.parametrize("version", ["1.0.30", "1.2.0", "2.0.0", "1.10.0"])
def test_another_viser_is_refused_with_what_to_install(version, monkeypatch):
    monkeypatch.setattr("viser.__version__", version)

    with pytest.raises(SceneError, match=f"viser {version} .*: only 1.1 is") as caught:
        Viewer(load_lwr(), port=8422)

    assert "pip install 'needleforce[scene]'" in caught.value.advice


def test_the_extra_installs_the_viser_that_is_guarded():
    project = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    extra = project["project"]["optional-dependencies"]["scene"]
    first, second = map(int, guarded_server.KNOWN_VISER)

    assert f"viser>={first}.{second},<{first}.{second + 1}" in extra


@pytest.mark.slow
@needs_chromium
def test_the_first_browser_steers_the_second_looks(viewer):
    from tests.needleforce.scene.scene_page import open_page

    has_slider = "document.querySelectorAll('[role=slider]').length > 0"
    press = (
        "(() => { const s = document.querySelector('[role=slider]'); s.focus();"
        "for (const k of ['Home']) s.dispatchEvent(new KeyboardEvent('keydown',"
        "{key: k, code: k, bubbles: true})); })()"
    )
    with open_page(viewer.url) as first, open_page(viewer.url) as second:
        assert first.wait_for(has_slider)
        assert second.wait_for(has_slider)
        assert second.wait_for("document.body.innerText.includes('You look.')")
        assert "You look." not in first.evaluate("document.body.innerText")
        before = viewer.time.slider.value
        second.evaluate(press)
        time.sleep(1.0)

        assert viewer.time.slider.value == before

        first.evaluate(press)
        end_s = time.monotonic() + 10.0
        while viewer.time.slider.value == before and time.monotonic() < end_s:
            time.sleep(0.1)

        assert viewer.time.slider.value != before


@pytest.mark.slow
@needs_chromium
def test_a_page_of_another_server_gets_no_connection(viewer, tmp_path):
    from tests.needleforce.scene.scene_page import open_page

    port = urlsplit(viewer.url).port
    (tmp_path / "index.html").write_text(
        "<!DOCTYPE html><title>waiting</title><script>"
        f"const s = new WebSocket('ws://127.0.0.1:{port}', ['{PROTOCOL}']);"
        "s.onopen = () => document.title = 'open';"
        "s.onerror = () => document.title = 'refused';</script>"
    )
    handler = partial(SimpleHTTPRequestHandler, directory=tmp_path)
    other = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    threading.Thread(target=other.serve_forever, daemon=True).start()
    try:
        with open_page(f"http://127.0.0.1:{other.server_port}/index.html") as page:
            assert page.wait_for("document.title != 'waiting' && document.title != ''")
            assert page.evaluate("document.title") == "refused"
    finally:
        other.shutdown()
        other.server_close()
    assert np.isfinite(viewer.time.slider.value)
