"""Runs the Python sessions of a documentation page."""

import doctest
from pathlib import Path


def session_failures(page: Path) -> str:
    """What the ``>>>`` lines of the page give otherwise than the page shows."""
    text = page.read_text(encoding="utf-8")
    session = doctest.DocTestParser().get_doctest(text, {}, page.name, str(page), 0)
    assert len(session.examples) > 10
    differences = []
    doctest.DocTestRunner(verbose=False).run(session, out=differences.append)
    return "".join(differences)
