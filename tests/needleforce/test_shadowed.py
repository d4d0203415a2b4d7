"""A user's file with the name of one of our packages is named, with the cure."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from tests.source_files import ROOT

CURE = "Rename it, or work in another folder"

AS_EDITABLE = """
import sys
from importlib.machinery import PathFinder
from pathlib import Path


class Editable:  # where a development install looks, after the path
    @staticmethod
    def find_spec(name, path=None, target=None):
        return None if path else PathFinder.find_spec(name, [{root!r}])


sys.path[:] = [place for place in sys.path if not Path(place, "needleforce").is_dir()]
sys.meta_path.append(Editable)
import needleforce
"""


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
    "name", ["foundation", "urdf", "residual", "identification", "groundtruth"]
)
def test_a_file_that_hides_a_package_is_named_by_the_import(tmp_path, name):
    (tmp_path / f"{name}.py").write_text("")
    done = run_python("-c", "import needleforce", folder=tmp_path)
    last = done.stderr.splitlines()[-1]

    assert done.returncode == 1
    assert last.startswith("ImportError: ")
    assert f"{tmp_path / name}.py hides the package {name!r}" in last
    assert last.endswith(CURE)


def test_a_script_that_hides_a_package_is_named(tmp_path):
    script = tmp_path / "identification.py"
    script.write_text("from needleforce import InsertionSession\n")
    done = run_python(str(script), folder=tmp_path.parent)

    assert f"{script} hides the package 'identification'" in done.stderr
    assert done.stderr.rstrip().endswith(CURE)


def test_a_module_imported_before_is_named(tmp_path):
    (tmp_path / "residual.py").write_text("")
    done = run_python("-c", "import residual, needleforce", folder=tmp_path)

    assert f"{tmp_path / 'residual.py'} hides" in done.stderr


def test_a_folder_with_an_init_is_named_as_a_folder(tmp_path):
    package = tmp_path / "groundtruth"
    package.mkdir()
    (package / "__init__.py").write_text("")
    done = run_python("-c", "import needleforce", folder=tmp_path)

    assert f"{package} hides the package 'groundtruth'" in done.stderr


def test_the_command_ends_with_it(tmp_path):
    (tmp_path / "residual.py").write_text("")
    done = run_python("-m", "needleforce", "--version", folder=tmp_path)

    assert done.returncode == 1
    assert done.stdout == ""
    last = done.stderr.splitlines()[-1]
    assert f"{tmp_path / 'residual.py'} hides the package" in last
    assert last.endswith(CURE)


def test_a_folder_of_data_hides_a_package_of_a_development_install(tmp_path):
    (tmp_path / "urdf").mkdir()
    code = AS_EDITABLE.format(root=str(ROOT))
    done = run_python("-c", code, folder=tmp_path, PYTHONPATH="")

    assert f"{tmp_path / 'urdf'} hides the package 'urdf'" in done.stderr


@pytest.mark.slow
def test_a_folder_of_data_that_hides_nothing_is_no_obstacle(tmp_path):
    (tmp_path / "urdf").mkdir()
    code = "import needleforce, urdf; print(urdf.__file__)"
    path = os.pathsep.join(map(str, (tmp_path, ROOT)))
    done = run_python("-c", code, folder=tmp_path, PYTHONPATH=path)

    assert done.returncode == 0
    assert Path(done.stdout.strip()) == ROOT / "urdf" / "__init__.py"
