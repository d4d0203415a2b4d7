"""The rules of the project: names, public names, docstrings, nothing private."""

import ast
import pkgutil
import re
import tomllib
from dataclasses import fields, is_dataclass
from importlib import import_module

import numpy as np
import pytest

from foundation.errors import CodedError
from tests.source_files import (
    LIBRARIES,
    PACKAGE_SOURCES,
    PACKAGES,
    ROOT,
    SOURCES,
    TESTS,
    functions,
    name_of,
    project_files,
    syntax,
    text_files,
)

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
MAX_PUBLIC_NAMES = 26
VAGUE_NAMES = {"utils.py", "util.py", "common.py", "helpers.py", "misc.py"}


def test_no_file_has_a_name_that_says_nothing():
    assert [name_of(path) for path in project_files() if path.name in VAGUE_NAMES] == []


def test_no_function_or_class_has_the_name_of_a_module_beside_it():
    packages = {}
    for path in SOURCES:
        if path.relative_to(ROOT).parts[0] not in ("tests", "examples"):
            packages.setdefault(path.parent, []).append(path)
    found = {}
    for files in packages.values():
        modules = {path.stem for path in files}
        for path in files:
            names = {node.name for node in syntax(path).body if hasattr(node, "name")}
            if names & modules:
                found[name_of(path)] = sorted(names & modules)

    assert found == {}


@pytest.mark.parametrize("package_name", PACKAGES)
def test_the_public_face_is_sorted_small_and_resolves(package_name):
    package = import_module(package_name)

    assert package.__doc__

    names = getattr(package, "__all__", [])

    # Constants first, then classes, then functions, as the formatter sorts them.
    assert names == sorted(
        names, key=lambda n: (not n.isupper(), not n[0].isupper(), n)
    )
    assert len(names) <= MAX_PUBLIC_NAMES
    assert [name for name in names if not hasattr(package, name)] == []


INNER = sorted(
    path.parent.relative_to(ROOT).as_posix()
    for path in PACKAGE_SOURCES
    if path.name == "__init__.py"
    and path.parent.parent != ROOT
    and path.parent.name != "data"
)


@pytest.mark.parametrize("folder", [*PACKAGES, *INNER])
def test_the_docstring_of_a_folder_says_with_which_files_to_begin(folder):
    package = import_module(folder.replace("/", "."))
    _, order, listed = package.__doc__.partition("Reading order: ")

    assert order

    names = [name for name in re.findall(r"`(\w+)`", listed) if name.islower()]
    names = [name for name in names if name not in PACKAGES]

    assert len(names) > 1

    places = {name: ROOT / folder / name for name in names}

    assert [
        name
        for name, place in places.items()
        if not (place.with_suffix(".py").is_file() or (place / "__init__.py").is_file())
    ] == []


@pytest.mark.parametrize("package_name", LIBRARIES)
def test_a_library_has_a_public_face_types_and_one_base_error(package_name):
    package = import_module(package_name)
    module = import_module(f"{package_name}.errors")
    own = [
        value
        for value in vars(module).values()
        if isinstance(value, type) and value.__module__ == module.__name__
    ]
    errors = [value for value in own if issubclass(value, Exception)]
    bases = [error for error in errors if error.__bases__ == (CodedError,)]

    assert len(bases) == 1
    assert all(issubclass(error, bases[0]) for error in errors)
    assert bases[0].__name__ in package.__all__
    assert (ROOT / package_name / "py.typed").is_file()


def with_arrays():
    """Every dataclass of the estimators with a field that is an array."""
    for package in map(import_module, ("identification", "residual")):
        for info in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            module = None if "__main__" in info.name else import_module(info.name)
            for kind in vars(module).values() if module else ():
                is_own = isinstance(kind, type) and kind.__module__ == info.name
                if (
                    is_own
                    and is_dataclass(kind)
                    and re.search("[aA]rray", str(fields(kind)))
                ):
                    yield kind


@pytest.mark.parametrize("kind", list(with_arrays()), ids=lambda kind: kind.__name__)
def test_frozen_dataclasses_with_arrays_are_compared_and_hashed_by_identity(kind):
    one = object.__new__(kind)
    other = object.__new__(kind)
    for made in (one, other):
        for field in fields(kind):
            object.__setattr__(made, field.name, np.ones(2))

    assert one == one
    assert one != other
    assert len({one, other}) == 2


def undocumented(tree):
    """Public classes, functions and methods without a docstring."""
    nodes = [(node, "") for node in tree.body]
    while nodes:
        node, owner = nodes.pop()
        if not isinstance(node, ast.ClassDef | ast.FunctionDef) or node.name.startswith(
            "_"
        ):
            continue
        is_overload = any(
            ast.unparse(mark) == "overload" for mark in node.decorator_list
        )
        if ast.get_docstring(node) is None and not is_overload:
            yield f"{owner}{node.name}"
        if isinstance(node, ast.ClassDef):
            nodes += [(child, f"{node.name}.") for child in node.body]


def test_everything_public_is_documented():
    missing = {
        name_of(path): names
        for path in PACKAGE_SOURCES
        if (names := list(undocumented(syntax(path))))
    }

    assert missing == {}
    assert [
        name_of(path) for path in PACKAGE_SOURCES if not ast.get_docstring(syntax(path))
    ] == []


# Written so that these lines do not match themselves.
PRIVATE = re.compile(
    r"(?<![\w.>])/(?:home|root|work|tmp|opt|mnt|srv|var|builds|Users)/"
    r"|\b[A-Z]:\\\w"
    r"|\b(?:pypi|pythonhosted|npmjs)[.]org\b|\blocalhos[t]\b|\b(?!127[.]|0[.]0[.]0)\d{1,3}(?:[.]\d{1,3}){3}\b"
    r"|https?://(?:[\w.-]+[.])?(?:internal|local|corp|lan)\b"
)


def test_no_file_names_a_machine_or_a_place_on_it():
    found = [
        f"{name_of(path)}: {hit.group()}"
        for path, text in text_files()
        for hit in PRIVATE.finditer(text)
    ]
    assert found == []


@pytest.mark.parametrize(
    "text", ["see /ho" + "me/me/x", "C:" + "\\data", "pypi." + "org", "10.0." + "0.1"]
)
def test_places_and_machines_would_be_noticed(text):
    assert PRIVATE.search(text)


def asserts(node, helpers):
    """Whether a function asserts, itself or through a function of its file."""
    for inner in ast.walk(node):
        if isinstance(inner, ast.Assert):
            return True
        if isinstance(inner, ast.Call):
            called = ast.unparse(inner.func).split(".")[-1]
            if called in ("raises", "warns") or called.startswith("assert_"):
                return True
            if called in helpers and asserts(helpers.pop(called), helpers):
                return True
    return False


@pytest.mark.parametrize("path", TESTS, ids=name_of)
def test_every_test_asserts_something(path):
    found = {node.name: node for node in functions(syntax(path))}
    helpers = {
        name: node for name, node in found.items() if not name.startswith("test")
    }
    tests = [node for name, node in found.items() if name.startswith("test")]

    assert [node.name for node in tests if not asserts(node, dict(helpers))] == []
    assert bool(tests) == path.name.startswith("test_")


def test_the_project_file_lists_every_package_on_disk():
    on_disk = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for path in PACKAGE_SOURCES
        if path.name == "__init__.py" and "benchmarks" not in path.parts
    }
    assert set(PROJECT["tool"]["setuptools"]["packages"]) == on_disk


def test_every_dependency_has_a_range_and_a_reason():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    extras = PROJECT["project"]["optional-dependencies"].values()
    wanted = [
        *PROJECT["project"]["dependencies"],
        *(item for extra in extras for item in extra),
    ]
    own = [item for item in wanted if not item.startswith("needleforce[")]

    assert len(own) > 10

    for item in own:
        assert re.search(r">=[\d.]+,<[\d.]+(; sys_platform == .*)?$", item), item
        assert re.search(rf'"{re.escape(item)}", +# \w', text), item
