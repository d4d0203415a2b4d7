"""Text as HTML."""

import re
from html import escape

_CODE = re.compile(r"`([^`]+)`")


def inline(text: str) -> str:
    """Escape text; what stands between backticks becomes code, a line end a line break."""
    return _CODE.sub(r"<code>\1</code>", escape(text)).replace("\n", "<br>")
