"""A page opened in headless Chromium: what it logs and what it measures."""

import json
import re
import shutil
import subprocess
import tempfile
from html import unescape
from pathlib import Path

import pytest

PROGRAM = shutil.which("chromium") or shutil.which("chromium-browser")
FLAGS = (
    "--headless",
    "--no-sandbox",
    "--disable-gpu",
    "--disable-quic",
    "--no-first-run",
    "--disable-background-networking",
    "--disable-component-update",
    "--disable-sync",
    "--disable-dev-shm-usage",
    "--enable-logging=stderr",
    "--virtual-time-budget=10000",
    "--dump-dom",
    "--window-size=1280,900",
)
SECONDS = 120.0

PHONE = (390, 844)  # width and height of a window
needs_chromium = pytest.mark.skipif(
    PROGRAM is None, reason="no chromium on this machine: apt-get install chromium"
)

POLICY = "style-src 'unsafe-inline'"
MEASURE = """<script>
addEventListener("load", () => {
  const found = {
    content: document.scrollingElement.scrollWidth,
    images: [...document.images].map(image => image.getBoundingClientRect().height),
    wide: [...document.querySelectorAll("body *")].filter(item =>
      item.getBoundingClientRect().right > innerWidth + 1
      && !item.closest(".scroll, pre")
    ).map(item => item.tagName),
  };
  parent.postMessage(JSON.stringify(found), "*");
});
</script>"""
# In a frame: the window of a browser without a screen is never as narrow as a phone.
FRAME = """<!DOCTYPE html><title>frame</title><body><script>
addEventListener("message", event => document.body.append("<<" + event.data + ">>"));
</script><iframe src="copy.html" width="{width}" height="{height}"></iframe>"""


def _run(page):
    with tempfile.TemporaryDirectory() as profile:
        command = [
            PROGRAM,
            *FLAGS,
            f"--user-data-dir={profile}",
            Path(page).resolve().as_uri(),
        ]
        return subprocess.run(
            command, capture_output=True, text=True, timeout=SECONDS, check=True
        )


def logged(page):
    """What the page writes to the browser's console, as it is delivered."""
    return [line for line in _run(page).stderr.splitlines() if "CONSOLE" in line]


def measured(page, size):
    """Sizes in a window: of a copy of the page that measures itself, for the page
    has no script."""
    text = Path(page).read_text(encoding="utf-8")
    assert POLICY in text
    assert "<script" not in text
    text = text.replace(POLICY, f"{POLICY}; script-src 'unsafe-inline'")
    with tempfile.TemporaryDirectory() as folder:
        copy = Path(folder) / "copy.html"
        frame = Path(folder) / "frame.html"
        copy.write_text(text.replace("</body>", f"{MEASURE}</body>"), encoding="utf-8")
        frame.write_text(FRAME.format(width=size[0], height=size[1]), encoding="utf-8")
        said = _run(frame).stdout
    found = re.search(r"&lt;&lt;(.*)&gt;&gt;", said, re.DOTALL)
    assert found, said[-2000:]
    return json.loads(unescape(found.group(1)))
