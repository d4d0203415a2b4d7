"""What tests of the toolkit share: quick starts of processes that it runs beside it."""

import contextlib
import multiprocessing
from multiprocessing import forkserver
from pathlib import Path
from types import SimpleNamespace

import pytest

RECORDER = "needleforce.recorder"
EMULATOR = "needleforce.devices.emulators.process"
IMPORTED = [RECORDER, "needleforce.devices.emulators", "needleforce.cli"]
ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True, scope="session")
def forked_processes():
    """Writers of recordings and emulators are forked from a process that has imported
    what they need.

    "spawn" has each import all again: a second of processor time. Programs that tests
    run as a whole do spawn.
    """
    forked = multiprocessing.get_context("forkserver")
    forked.set_forkserver_preload(IMPORTED)

    def get_context(_method):
        with contextlib.chdir(ROOT):  # where the first one looks for modules
            forkserver.ensure_running()
        return forked

    quick = SimpleNamespace(get_context=get_context)
    with pytest.MonkeyPatch.context() as patch:
        for module in (RECORDER, EMULATOR):
            patch.setattr(f"{module}.multiprocessing", quick)
        yield
