"""A page in headless Chromium that is driven over the DevTools protocol."""

import itertools
import json
import subprocess
import tempfile
import time
from contextlib import contextmanager
from pathlib import Path
from urllib.request import urlopen

from tests.chromium import FLAGS, PROGRAM

UNWANTED = (
    "--dump-dom",
    "--virtual-time-budget=10000",
    "--window-size=1280,900",
    "--disable-gpu",
)
START_s = 60.0


class OpenPage:
    """A tab: evaluate, look at the console, take a picture."""

    def __init__(self, socket):
        self._numbers = itertools.count(1)
        self._socket = socket
        self.errors = []
        for method in ("Page.enable", "Runtime.enable", "Log.enable"):
            self.call(method)

    def call(self, method, **parameters):
        """The result of a command; events that come meanwhile are kept."""
        number = next(self._numbers)
        self._socket.send(
            json.dumps({"id": number, "method": method, "params": parameters})
        )
        while True:
            message = json.loads(self._socket.recv(timeout=START_s))
            if message.get("id") == number:
                return message.get("result", {})

            event = message.get("params", {})
            kind = event.get("type") or event.get("entry", {}).get("level")
            if kind == "error" or message.get("method") == "Runtime.exceptionThrown":
                self.errors.append(str(event)[:300])

    def evaluate(self, expression):
        """The value of an expression in the page."""
        reply = self.call("Runtime.evaluate", expression=expression, returnByValue=True)
        return reply.get("result", {}).get("value")

    def wait_for(self, expression, seconds=START_s):
        """Whether an expression becomes true in time."""
        end_s = time.monotonic() + seconds
        while time.monotonic() < end_s:
            if self.evaluate(expression):
                return True

            time.sleep(0.2)

        return False

    def set_size(self, size):
        """Give the page a size that the window of a browser would not take."""
        self.call(
            "Emulation.setDeviceMetricsOverride",
            width=size[0],
            height=size[1],
            deviceScaleFactor=1,
            mobile=False,
        )


@contextmanager
def browse(url, size=(1400, 900)):
    """A page in a browser of its own, which ends with the block."""
    from websockets.sync.client import connect

    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as profile:
        command = [
            *(
                PROGRAM,
                *(flag for flag in FLAGS if flag not in UNWANTED),
                f"--window-size={size[0]},{size[1]}",
                "--remote-debugging-port=0",
            ),
            *(f"--user-data-dir={profile}", "about:blank"),
        ]
        browser = subprocess.Popen(
            command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL
        )
        try:
            place = Path(profile) / "DevToolsActivePort"
            end_s = time.monotonic() + START_s
            while not (place.exists() and place.read_text().count("\n")):
                assert time.monotonic() < end_s, "the browser has not started"
                time.sleep(0.1)

            port = place.read_text().splitlines()[0]
            with urlopen(f"http://127.0.0.1:{port}/json/list") as reply:
                tabs = [tab for tab in json.load(reply) if tab["type"] == "page"]

            with connect(tabs[0]["webSocketDebuggerUrl"], max_size=1 << 26) as socket:
                page = OpenPage(socket)
                page.call("Page.navigate", url=url)
                yield page
        finally:
            browser.kill()
            browser.wait()
