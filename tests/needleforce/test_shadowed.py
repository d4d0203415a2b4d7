"""A user's file with the name of one of our packages is named, with the cure."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.source_files import ROOT


def run_python(*arguments, folder, **variables):
    """What Python does in a folder, with the project on its path behind that folder."""
    environment = {**os.environ, "PYTHONPATH": str(ROOT)} | variables
    return subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env=environment,
        capture_output=True,
        text=True,
        check=False,
    )


@pytest.mark.parametrize(
    "name", ["foundation.py", "urdf/__init__.py", "residual.py", "groundtruth.py"]
)
def test_a_file_that_hides_a_package_is_named_by_the_import(tmp_path, name):
    file = tmp_path / name
    file.parent.mkdir(exist_ok=True)
    file.write_text("")
    done = run_python("-m", "needleforce", "--version", folder=tmp_path)

    assert done.returncode == 1
    assert done.stdout == ""
    assert f"ImportError: {tmp_path / name.split('/')[0]} hides" in done.stderr


@pytest.mark.slow
def test_a_folder_of_data_that_hides_nothing_is_no_obstacle(tmp_path):
    (tmp_path / "urdf").mkdir()
    code = "import needleforce, urdf; print(urdf.__file__)"
    path = os.pathsep.join(map(str, (tmp_path, ROOT)))
    done = run_python("-c", code, folder=tmp_path, PYTHONPATH=path)

    assert done.returncode == 0
    assert Path(done.stdout.strip()) == ROOT / "urdf" / "__init__.py"
