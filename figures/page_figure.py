"""A figure of a page."""

from base64 import b64encode
from dataclasses import dataclass
from html import escape
from pathlib import Path

from figures.errors import WriteError
from figures.page_text import inline

MEDIA_TYPES = {".svg": "image/svg+xml", ".png": "image/png"}


@dataclass(frozen=True, slots=True, kw_only=True)
class PageFigure:
    """A figure of a page.

    Attributes:
        path: The drawing, SVG or PNG; its content goes into the page.
        alt: What it shows, for those who cannot see it.
        caption: Below it.
    """

    path: Path
    alt: str
    caption: str

    def html(self) -> str:
        """The figure, with the drawing inside.

        As an image, not as elements of the page: names inside two drawings cannot clash.

        Raises:
            WriteError: The drawing cannot be read.
        """
        try:
            content = b64encode(self.path.read_bytes()).decode()
        except OSError as error:
            raise WriteError(f"cannot read {self.path}: {error.strerror or error}") from error
        source = f"data:{MEDIA_TYPES[self.path.suffix]};base64,{content}"
        return (
            f'<figure><img src="{source}" alt="{escape(self.alt)}">'
            f"<figcaption>{inline(self.caption)}</figcaption></figure>"
        )
