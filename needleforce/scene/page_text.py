"""Words on the live page: shown as they are, whatever characters a name has."""

from html import escape


def text_html(*lines: str) -> str:
    """Return lines as paragraphs for viser's `add_html`.

    Names come from files. In viser's Markdown an `<iframe>` in a name would run and a
    picture would be fetched; here every character is itself.
    """
    style = "margin:0 .75rem .5rem;font-size:.875rem;overflow-wrap:anywhere"
    return "".join(f'<p style="{style}">{escape(line)}</p>' for line in lines)
