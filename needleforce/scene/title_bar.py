"""What a page always shows, also a narrow one: off plan, warnings, what it is.

It stands in the title bar as a picture, for buttons there vanish in a menu on a narrow
screen, and the panel folds.
"""

from base64 import b64encode
from html import escape
from typing import Any

from needleforce.scene.row_text import BANNER

NOTE = "Simulation and research only: not a medical device."
SHORT_NOTE = "Not a medical device"

WIDTH_PX = 260
HEIGHT_PX = 28
BANNER_PX = 88
BADGE_PX = 20
"""Sizes of the picture and its parts; the width fits a phone."""

PICTURE = (
    '<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" '
    'viewBox="0 0 {width} {height}" font-family="sans-serif" font-size="13">'
    "{parts}</svg>"
)
BANNER_PART = (
    '<rect x="0" y="2" width="84" height="24" rx="3" fill="#b3261e"/>'
    '<text x="42" y="19" fill="#fff" font-weight="bold" text-anchor="middle">'
    "{text}</text>"
)
BADGE_PART = (
    '<rect x="{x}" y="4" width="20" height="20" rx="10" fill="#e69f00"/>'
    '<text x="{middle}" y="19" fill="#000" font-weight="bold" text-anchor="middle">'
    "{text}</text>"
)
NOTE_PART = '<text x="{x}" y="19" fill="#111">{text}</text>'


class TitleBar:
    """The title bar of a page.

    Args:
        server: Of the page.
        warnings: What is wrong with the plan, or could not be checked.
    """

    def __init__(self, server: Any, warnings: tuple[str, ...]) -> None:
        self._gui = server.gui
        self._warnings = warnings
        self._is_off_plan: bool | None = None
        self._is_hidden = False
        self.show(is_off_plan=False)

    def show(self, *, is_off_plan: bool) -> None:
        """Show whether the needle is off the plan; nothing is sent if that is known."""
        if self._is_hidden or is_off_plan is self._is_off_plan:
            return
        self._is_off_plan = is_off_plan
        picture = _draw(len(self._warnings), is_off_plan=is_off_plan)
        # Otherwise any browser could ask for a tunnel to the internet.
        self._gui.configure_theme(
            titlebar_content={
                "buttons": (),
                "image": {
                    "image_url_light": picture,
                    "image_url_dark": None,
                    "image_alt": self._describe(is_off_plan=is_off_plan),
                    "href": None,
                },
            },
            show_logo=False,
            show_share_button=False,
        )

    def hide(self) -> None:
        """Show no title bar, in a page that says the same around the scene."""
        self._is_off_plan = None
        self._is_hidden = True
        self._gui.configure_theme(
            titlebar_content=None, show_logo=False, show_share_button=False
        )

    def restore(self, *, is_off_plan: bool) -> None:
        """Show the title bar again, after `hide`."""
        self._is_hidden = False
        self.show(is_off_plan=is_off_plan)

    def _describe(self, *, is_off_plan: bool) -> str:
        """Return the same in words."""
        warnings = tuple(f"Warning: {warning}." for warning in self._warnings)
        banner = (f"{BANNER}: no layer is named.",) if is_off_plan else ()
        return " ".join((*banner, NOTE, *warnings))


def _draw(warnings: int, *, is_off_plan: bool) -> str:
    """Return the picture as the address of an image."""
    parts: list[str] = []
    x = 0
    if is_off_plan:
        parts.append(BANNER_PART.format(text=BANNER))
        x += BANNER_PX
    if warnings:
        parts.append(
            BADGE_PART.format(x=x, middle=x + BADGE_PX // 2, text=f"{warnings}!")
        )
        x += BADGE_PX + 4
    parts.append(NOTE_PART.format(x=x, text=escape(SHORT_NOTE)))
    svg = PICTURE.format(width=WIDTH_PX, height=HEIGHT_PX, parts="".join(parts))
    return f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
