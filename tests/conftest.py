"""Fixtures shared by all tests, and where recordings are looked for."""

import os
from pathlib import Path

import pytest
from hypothesis import settings

# Before NumPy is imported: threads of BLAS, beside one worker per processor, take
# thrice the time.
os.environ.setdefault("OMP_NUM_THREADS", "1")
settings.register_profile("ci", derandomize=True, deadline=None)
settings.load_profile("ci")


def pytest_configure(config):
    """Compile before there are several workers, of which each would compile all."""
    is_worker = hasattr(config, "workerinput")
    if not is_worker and getattr(config.option, "numprocesses", None):
        from needleforce import InsertionSession
        from urdf import load_lwr

        InsertionSession(load_lwr())


@pytest.fixture(scope="session")
def lwr():
    """The LWR 4+ with F/T sensor and needle."""
    from urdf import NeedleTool, load_lwr

    return load_lwr(payload=NeedleTool())


@pytest.fixture
def dot(tmp_path):
    """The smallest picture."""
    path = tmp_path / "dot.svg"
    path.write_text(
        '<svg xmlns="http://www.w3.org/2000/svg" width="90" height="90"></svg>'
    )
    return path


@pytest.fixture(scope="session")
def recordings_dir():
    """Folder of real recordings; tests that need it skip, saying so, when it is
    absent."""
    named = os.environ.get("NEEDLEFORCE_DATA")
    beside = Path(__file__).resolve().parents[1] / ".." / "shared" / "data"
    folder = Path(named) if named else beside
    if not folder.is_dir():
        pytest.skip("no recordings: set NEEDLEFORCE_DATA to their folder")
    return folder
