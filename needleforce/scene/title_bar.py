"""What a page always shows, also a narrow one: off plan, warnings, what it is.

It stands in the title bar as a picture, for buttons there vanish in a menu on a narrow
screen, and the panel folds.
"""

from base64 import b64encode
from typing import Any

from needleforce.scene.row_text import MEANINGS

NOTE = "Simulation and research only: not a medical device."


class TitleBar:
    """The title bar of a page.

    Args:
        server: Of the page.
        warnings: What is wrong with the plan, or could not be checked.
    """

    def __init__(self, server: Any, warnings: tuple[str, ...]) -> None:
        self._gui = server.gui
        self._warnings = warnings
        self._banner: str | None = None
        self._is_hidden = False
        self.show("")

    def show(self, banner: str) -> None:
        """Show a banner, or none if it is empty; nothing is sent if it is shown."""
        if self._is_hidden or banner == self._banner:
            return
        self._banner = banner
        picture = _draw(len(self._warnings), banner)
        # Otherwise any browser could ask for a tunnel to the internet.
        self._gui.configure_theme(
            titlebar_content={
                "buttons": (),
                "image": {
                    "image_url_light": picture,
                    "image_url_dark": None,
                    "image_alt": self._describe(banner),
                    "href": None,
                },
            },
            show_logo=False,
            show_share_button=False,
        )

    def hide(self) -> None:
        """Show no title bar, in a page that says the same around the scene."""
        self._banner = None
        self._is_hidden = True
        self._gui.configure_theme(
            titlebar_content=None, show_logo=False, show_share_button=False
        )

    def restore(self, banner: str) -> None:
        """Show the title bar again, after `hide`."""
        self._is_hidden = False
        self.show(banner)

    def _describe(self, banner: str) -> str:
        """Return the same in words."""
        warnings = tuple(f"Warning: {warning}." for warning in self._warnings)
        lines = (f"{banner}: {MEANINGS[banner]}.",) if banner else ()
        return " ".join((*lines, NOTE, *warnings))


def _draw(warnings: int, banner: str) -> str:
    """Return the picture as the address of an image."""
    width_px = 260  # fits a phone
    height_px = 28
    parts: list[str] = []
    x = 0
    if banner:
        parts.append(
            '<rect x="0" y="2" width="106" height="24" rx="3" fill="#b3261e"/>'
            '<text x="53" y="19" fill="#fff" font-weight="bold" text-anchor="middle">'
            f"{banner}</text>"
        )
        x += 110
    if warnings:
        parts.append(
            f'<rect x="{x}" y="4" width="20" height="20" rx="10" fill="#e69f00"/>'
            f'<text x="{x + 10}" y="19" fill="#000" font-weight="bold" '
            f'text-anchor="middle">{warnings}!</text>'
        )
        x += 24
    parts.append(f'<text x="{x}" y="19" fill="#111">Not a medical device</text>')
    svg = (
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{width_px}" '
        f'height="{height_px}" viewBox="0 0 {width_px} {height_px}" '
        f'font-family="sans-serif" font-size="13">{"".join(parts)}</svg>'
    )
    return f"data:image/svg+xml;base64,{b64encode(svg.encode()).decode()}"
