"""The core is light: what some users need comes with an extra named for its use."""

import ast
import subprocess
import sys
import tomllib

import pytest

from foundation.extras import EXTRA_OF_MODULE, EXTRAS
from tests.source_files import INSTALLED, ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
OF_DEVELOPERS = {"bench", "test", "dev"}
HEAVY = ("trimesh", "shapely", "lxml", "PIL", "matplotlib", "yourdfpy", "networkx")
CORE_MODULES = {
    *("pinocchio", "coal", "numpy", "pandas", "scipy", "numba", "msgspec", "cyclopts"),
}
BROUGHT_BY_CYCLOPTS = {"rich"}
OF_ROS = {
    "rclpy",
    "rcl_interfaces",
    "diagnostic_msgs",
    "geometry_msgs",
    "sensor_msgs",
    "std_msgs",
    "std_srvs",
}  # the node needs the user's own ROS 2
DISTRIBUTIONS = {
    "example_robot_data": "example-robot-data",
    "markupsafe": "jinja2",
    "skimage": "scikit-image",
    "PIL": "pillow",
    "igl": "libigl",
    "franky": "franky-control",
    "google": "protobuf",
    "rtde_receive": "ur-rtde",
    "rtde_control": "ur-rtde",
    "distributed": "dask",
}


def required(extra):
    """Names of the distributions that an extra asks for."""
    items = PROJECT["project"]["optional-dependencies"][extra]
    names = (item.split(">=")[0].split("[")[0].strip() for item in items)
    return {name.lower().replace("_", "-") for name in names}


def third_party_imports(path):
    """Top-level modules that a file imports, wherever it does, that are not ours."""
    own = set(INSTALLED) | set(sys.stdlib_module_names)
    for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom):
            names = [node.module or ""]
        else:
            continue
        yield from {name.partition(".")[0] for name in names} - own


def test_every_extra_of_a_user_is_described():
    extras = set(PROJECT["project"]["optional-dependencies"])

    assert set(EXTRAS) == extras - OF_DEVELOPERS
    assert all(EXTRAS.values())


@pytest.mark.slow
def test_each_module_that_the_product_imports_is_of_the_core_or_of_an_extra():
    known = CORE_MODULES | BROUGHT_BY_CYCLOPTS | OF_ROS | set(EXTRA_OF_MODULE)
    unknown = {
        (name, path.name)
        for package in INSTALLED
        for path in (ROOT / package).rglob("*.py")
        for name in third_party_imports(path)
        if name not in known
    }

    assert unknown == set()


@pytest.mark.parametrize(("module", "extra"), EXTRA_OF_MODULE.items())
def test_the_extra_of_a_module_brings_it(module, extra):
    assert DISTRIBUTIONS.get(module, module.lower()) in required(extra)


@pytest.mark.slow
def test_the_core_loads_none_of_the_heavy_packages(tmp_path):
    code = (
        "import sys, needleforce, needleforce.cli, needleforce.control\n"
        "needleforce.InsertionSession, needleforce.load_lwr\n"
        f"print(*sorted(set({HEAVY!r}) & set(sys.modules)))"
    )
    done = subprocess.run(
        [sys.executable, "-c", code],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={"NUMBA_DISABLE_JIT": "1", "PYTHONPATH": str(ROOT)},
        check=True,
    )

    assert done.stdout.strip() == ""
