"""How many files one update of a session passes.

A newcomer who wants to understand one update has to open every file that it passes.
What numba compiles is not seen here; with ``NUMBA_DISABLE_JIT=1`` it is.
"""

import sys
from pathlib import Path

import pytest

from needleforce import InsertionSession
from tests.insertion_run import samples, short_run, tare_index
from tests.source_files import INSTALLED, ROOT

MAX_FILES = 35


def files_passed(work):
    """Files of the product whose Python functions a call enters."""
    codes = set()
    sys.setprofile(lambda frame, *_: codes.add(frame.f_code))
    try:
        work()
    finally:
        sys.setprofile(None)
    paths = [Path(code.co_filename) for code in codes]
    names = {path.relative_to(ROOT) for path in paths if path.is_relative_to(ROOT)}
    return {str(name) for name in names if name.parts[0] in INSTALLED}


@pytest.mark.slow
def test_one_update_of_the_chain_passes_few_files():
    run = short_run()
    session = InsertionSession(run.robot)
    tare = tare_index(run)
    busiest = set()
    for k, sample in samples(run):
        if k == tare:
            session.tare()
        if run.signals.t_s[k] < run.truth.contact_s or k % 10:
            session.update(*sample)
            continue
        files = files_passed(lambda sample=sample: session.update(*sample))
        busiest = max(busiest, files, key=len)

    assert "needleforce/session.py" in busiest
    assert len(busiest) <= MAX_FILES, "\n".join(sorted(busiest))
