"""Words on the live page: shown as they are, whatever characters a name has."""

from html import escape
from importlib.resources import files


def text_html(*lines: str) -> str:
    """Return lines as paragraphs for viser's `add_html`.

    Names come from files. In viser's Markdown an `<iframe>` in a name would run and a
    picture would be fetched; here every character is itself.
    """
    style = "margin:0 .75rem .5rem;font-size:.875rem;overflow-wrap:anywhere"
    return "".join(f'<p style="{style}">{escape(line)}</p>' for line in lines)


def sound_script() -> str:
    """Return the script by which a page tells events by sounds."""
    script = files("needleforce.scene").joinpath("page_sound.js")
    return script.read_text(encoding="utf-8")
