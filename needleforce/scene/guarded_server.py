"""The server of the page, which answers its own page and no other.

viser answers whatever reaches its port: also a page from elsewhere that is open in a
browser of this machine. Here a request must name a host that is known, a websocket must
come from a page of that host, and where the server is bound to more than loopback every
request needs the token of the page's address. The first browser steers; others look.
"""

import asyncio
import hashlib
import ipaddress
import secrets
import threading
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, redirect_stdout, suppress
from http import HTTPStatus
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple
from urllib.parse import parse_qs, urlsplit

from foundation.extras import install_command
from needleforce.scene.page_policy import VISERS_LOADER, page_policy, with_nonce
from needleforce.scene.page_text import sound_script, text_html
from needleforce.scene.state_ring import SceneError

LOOPBACK_NAMES = frozenset(("local" + "host", "127.0.0.1", "::1"))
"""Hosts by which a page of this machine is opened; the first is written in two parts
because no file may name a machine."""

TOKEN_BYTES = 16
"""Of randomness in a token."""

KNOWN_VISER = ("1", "1")
"""Version of viser, first and second number, of which is known where requests and
messages pass; the range of the extra `scene` in pyproject.toml is the same."""

_serve_lock = threading.Lock()
"""Held while viser's call of `serve` is replaced."""


def is_loopback(host: str) -> bool:
    """Return whether an address is one that only this machine reaches."""
    if host.lower() in LOOPBACK_NAMES:
        return True
    with suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return False


class PageAccess(NamedTuple):
    """Who may open the page.

    Attributes:
        hosts: Names by which it is opened, in lower case.
        token: What its address must carry; empty on loopback.
    """

    hosts: frozenset[str]
    token: str = ""

    @classmethod
    def of_host(cls, host: str, further_hosts: Sequence[str] = ()) -> "PageAccess":
        """Return the access to a page that is bound to an address.

        Args:
            host: The address.
            further_hosts: Other names by which the page is opened.

        Raises:
            SceneError: One of them is no name or address alone.
        """
        for name in further_hosts:
            _require_bare_name(name)
        names = {host.lower(), *map(str.lower, further_hosts)} | LOOPBACK_NAMES
        token = "" if is_loopback(host) else secrets.token_urlsafe(TOKEN_BYTES)
        return cls(frozenset(names), token)

    @property
    def cookie_name(self) -> str:
        """Name of the cookie that carries the token; of each token another one."""
        return f"needleforce-{hashlib.sha256(self.token.encode()).hexdigest()[:8]}"

    def refusal(self, path: str, headers: Any) -> str:
        """Return why a request is refused; empty if it is not.

        Args:
            path: Of the request, with its query.
            headers: Of the request, with `get_all`.
        """
        hosts = headers.get_all("Host")
        host = hosts[0] if len(hosts) == 1 else ""
        name = _name_of(f"//{host}")
        if not name:
            return f"host {host!r} is no name or address: open the page by one"
        if name not in self.hosts:
            return f"host {name!r} is not known here: --allow-host {name} adds it"
        origins = headers.get_all("Origin")
        if any(urlsplit(origin).netloc != host for origin in origins):
            return f"a page of {origins[0]!r} may not speak with this one"
        if self.token and not self._has_token(path, headers):
            return "the address lacks its token: open the one that was printed"
        return ""

    def _has_token(self, path: str, headers: Any) -> bool:
        """Return whether a request carries the token in its address or its cookie."""
        given = parse_qs(urlsplit(path).query).get("token", [])
        for cookies in headers.get_all("Cookie"):
            pairs = (cookie.strip().partition("=") for cookie in cookies.split(";"))
            given += [value for name, _, value in pairs if name == self.cookie_name]
        return any(
            secrets.compare_digest(value.encode(), self.token.encode())
            for value in given
        )

    def address(self, host: str, port: int) -> str:
        """Return the address of the page, with its token."""
        shown = f"[{host}]" if ":" in host else host
        query = f"/?token={self.token}" if self.token else ""
        return f"http://{shown}:{port}{query}"


def _require_bare_name(name: str) -> None:
    """Refuse a name of a host that comes with a scheme, a port or a path.

    Raises:
        SceneError: It does, or it is empty; requests would never match it.
    """
    shown = f"[{name}]" if name.count(":") > 1 else name
    if not name or _name_of(f"//{shown}") != name.lower():
        bare = _name_of(name if "//" in name else f"//{name}")
        raise SceneError(
            f"browsers name no host {name!r}: expected {bare or 'such as robot.lab'}",
            "Give a name or an address alone, without scheme and port.",
        )


def _name_of(address: str) -> str:
    """Return the name of the host in an address; empty if there is none."""
    with suppress(ValueError):
        return urlsplit(address).hostname or ""
    return ""


def open_server(host: str, port: int, label: str, access: PageAccess) -> Any:
    """Open a viser server that answers only whom an access admits.

    Args:
        host: Address to listen on.
        port: Where; another one is taken if it is busy.
        label: Of the page.
        access: Who may open it.

    Raises:
        SceneError: viser is not installed, or in a version that cannot be guarded.
    """
    try:
        import viser
    except ImportError as error:
        raise SceneError(
            "viser is not installed", f"Install it: {install_command('scene')}"
        ) from error

    _require_known(viser.__version__)
    build = Path(viser.__file__).parent / "client" / "build"
    page = (build / "index.html").read_text(encoding="utf-8")
    if VISERS_LOADER not in page:
        raise _unguarded(viser.__version__, f"its page has no {VISERS_LOADER}")
    page = page.replace("</body>", f"<script>{sound_script()}</script></body>")
    # viser's banner is no result, and names an address without its token.
    with redirect_stdout(StringIO()), _guarded_serve(access, page) as calls:
        server = viser.ViserServer(host=host, port=port, label=label, verbose=False)
    reason = "" if calls else "it does not call websockets' serve"
    try:
        Steering(server)
    except AttributeError as error:
        reason = str(error)
    if reason:
        stop_server(server)
        raise _unguarded(viser.__version__, reason)
    # Otherwise any browser could ask for a tunnel to the internet.
    server.gui.configure_theme(show_logo=False, show_share_button=False)
    return server


def _require_known(version: str) -> None:
    """Refuse a version of viser that may pass requests elsewhere.

    Raises:
        SceneError: It is another than `KNOWN_VISER`.
    """
    if tuple(version.split(".")[:2]) != KNOWN_VISER:
        raise _unguarded(version, f"only {'.'.join(KNOWN_VISER)} is known")


def _unguarded(version: str, reason: str) -> SceneError:
    """Return the error of a version of viser that would answer any page."""
    return SceneError(
        f"viser {version} cannot be guarded against foreign pages: {reason}",
        f"Install it: {install_command('scene')}",
    )


def stop_server(server: Any) -> None:
    """Stop a server without viser's words on it."""
    with redirect_stdout(StringIO()):
        server.stop()


@contextmanager
def _guarded_serve(access: PageAccess, page: str) -> Iterator[list[bool]]:
    """Replace the call by which viser opens its port, which has no setting for this.

    Yields:
        An entry for every call that was guarded.
    """
    import websockets.asyncio.server as websocket_server

    serve = websocket_server.serve
    calls: list[bool] = []

    def guarded_serve(*arguments: Any, **settings: Any) -> Any:
        answer = settings.get("process_request")
        if getattr(answer, "__module__", "").startswith("viser"):
            settings["process_request"] = _guarded(answer, access, page)
            calls.append(True)
        return serve(*arguments, **settings)

    with _serve_lock:
        websocket_server.serve = guarded_serve
        try:
            yield calls
        finally:
            websocket_server.serve = serve


def _guarded(answer: Any, access: PageAccess, page: str) -> Callable[[Any, Any], Any]:
    """Return viser's answer to a request, for those whom an access admits.

    Args:
        answer: Of viser.
        access: Who may open the page.
        page: viser's page; it is sent with its policy.
    """

    def answer_admitted(connection: Any, request: Any) -> Any:
        refusal = access.refusal(request.path, request.headers)
        if refusal:
            return connection.respond(HTTPStatus.FORBIDDEN, f"{refusal}\n")
        response = answer(connection, request)
        if response is None:
            return None
        if response.headers.get("Content-Type", "").startswith("text/html"):
            nonce = secrets.token_urlsafe(TOKEN_BYTES)
            response.body = with_nonce(page, nonce).encode()
            for name in ("Content-Encoding", "Content-Length"):
                response.headers.pop(name)
            response.headers["Content-Length"] = str(len(response.body))
            # Not every browser counts the page's own websocket as 'self'.
            host = request.headers["Host"]
            policy = page_policy(nonce, "'self'", f"ws://{host}")
            response.headers["Content-Security-Policy"] = policy
        if access.token:
            cookie = f"{access.cookie_name}={access.token}"
            response.headers["Set-Cookie"] = f"{cookie}; HttpOnly; SameSite=Strict"
        return response

    return answer_admitted


class Steering:
    """Lets the browser steer that has been connected longest, and others look.

    Args:
        server: Of the page.

    Raises:
        AttributeError: This version of viser is built otherwise.
    """

    def __init__(self, server: Any) -> None:
        from viser import _messages

        self._server = server
        self._sockets = server._websock_server
        self._update = _messages.GuiUpdateMessage
        self._harmless = _messages.ViewerCameraMessage
        self._sharing = (_messages.ShareUrlRequest, _messages.ShareUrlDisconnect)
        self._connections: dict[int, Any] = self._sockets._live_connections
        self._inputs: dict[str, Any] = server.gui._gui_input_handle_from_uuid
        self._handle = self._sockets._handle_incoming_message
        self._sockets._handle_incoming_message = self._handle_steering
        self._notices: dict[int, Any] = {}
        server.on_client_connect(self._greet)
        server.on_client_disconnect(self._pass_on)

    @property
    def driver(self) -> int | None:
        """Number of the browser that steers; None without a browser."""
        return min(self._connections, default=None)

    async def _handle_steering(self, client: int, message: Any) -> None:
        """Handle a message of a browser, if it may send it."""
        if isinstance(message, self._sharing):
            return
        if client == self.driver or isinstance(message, self._harmless):
            await self._handle(client, message)
        elif isinstance(message, self._update):
            await asyncio.sleep(0.0)
            self._take_back(client, message)

    def _take_back(self, client: int, message: Any) -> None:
        """Show a browser that does not steer the value that it tried to change."""
        handle = self._inputs.get(message.uuid)
        browser = self._server.get_clients().get(client)
        if handle is None or browser is None:
            return
        values = {name: getattr(handle._impl, name) for name in message.updates}
        interface = browser.gui._websock_interface
        interface.queue_message(self._update(message.uuid, values))

    def _greet(self, browser: Any) -> None:
        """Tell a browser that does not steer."""
        if browser.client_id != self.driver:
            text = text_html(
                "You look. Another browser opened this page first and steers it; when "
                "it leaves, this one does."
            )
            notice = browser.gui.add_html(text, order=-1.0)
            self._notices[browser.client_id] = notice

    def _pass_on(self, browser: Any) -> None:
        """Let the next browser steer after one has left."""
        self._notices.pop(browser.client_id, None)
        notice = (
            self._notices.pop(self.driver, None) if self.driver is not None else None
        )
        if notice is not None:
            notice.remove()
