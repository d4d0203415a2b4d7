"""How many files one update of a session passes.

A newcomer who wants to understand one update has to open every file that it passes.
What numba compiles is not seen here; with ``NUMBA_DISABLE_JIT=1`` it is.
"""

import sys
from functools import partial
from pathlib import Path

import numpy as np
import pytest

from tests.insertion_run import resumed_after, short_run
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
    near_its_end = int(np.searchsorted(run.signals.t_s, run.truth.rupture_s[0] - 0.1))
    session, samples = resumed_after(near_its_end, 1000)
    passed = [files_passed(partial(session.update, *sample)) for sample in samples]
    busiest = max(passed, key=len)

    assert "needleforce/session.py" in busiest
    assert len(busiest) <= MAX_FILES, "\n".join(sorted(busiest))
