"""What tests of the toolkit share: quick starts of processes that it runs beside it."""

import contextlib
import multiprocessing
from multiprocessing import forkserver
from pathlib import Path
from types import SimpleNamespace

import pytest

EMULATOR = "needleforce.devices.emulators.process"
IMPORTED = ["needleforce.devices.emulators", "needleforce.cli"]
ROOT = Path(__file__).parents[2]


@pytest.fixture(autouse=True, scope="session")
def forked_processes():
    """Emulators are forked from a process that has imported
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
        patch.setattr(f"{EMULATOR}.multiprocessing", quick)
        yield
