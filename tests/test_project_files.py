"""Files that forges, indexes and catalogues read agree with each other."""

import re
import tomllib
from importlib import import_module

import pytest
from ruamel.yaml import YAML

from tests.source_files import PACKAGE_SOURCES, PACKAGES, ROOT, name_of, text_files

SETTINGS = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
PROJECT = SETTINGS["project"]
FORGE = ROOT / ".github"
MINOR_VERSIONS = ["3.11", "3.12", "3.13"]


def read_yaml(path):
    return YAML(typ="safe").load(path.read_text(encoding="utf-8"))


def test_version_and_date_are_those_of_the_changelog_and_the_citation():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    released = re.search(r"^## \[([\d.]+)\] – (\S+)$", changelog, re.M).groups()
    citation = read_yaml(ROOT / "CITATION.cff")

    assert released == (citation["version"], str(citation["date-released"]))
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]


def test_the_workflow_runs_the_checks_on_every_supported_python():
    (job,) = read_yaml(FORGE / "workflows" / "ci.yml")["jobs"].values()

    assert job["strategy"]["matrix"]["python"] == MINOR_VERSIONS
    assert [step["run"] for step in job["steps"] if "run" in step][-1] == ".ci/run"

    classifiers = [item.rpartition(" :: ")[2] for item in PROJECT["classifiers"]]

    assert [item for item in classifiers if re.match(r"3\.\d", item)] == MINOR_VERSIONS
    assert PROJECT["requires-python"] == ">=3.11,<3.14"


@pytest.mark.parametrize("package_name", PACKAGES)
def test_every_public_name_is_there(package_name):
    package = import_module(package_name)
    names = getattr(package, "__all__", [])

    assert [name for name in names if not hasattr(package, name)] == []


def test_the_project_file_lists_every_package_on_disk():
    on_disk = {
        ".".join(path.parent.relative_to(ROOT).parts)
        for path in PACKAGE_SOURCES
        if path.name == "__init__.py" and "benchmarks" not in path.parts
    }

    assert set(SETTINGS["tool"]["setuptools"]["packages"]) == on_disk


def test_every_dependency_has_a_range_and_a_reason():
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    wanted = [*PROJECT["dependencies"]]
    for extra in PROJECT["optional-dependencies"].values():
        wanted += [item for item in extra if not item.startswith("needleforce[")]

    for item in wanted:
        assert re.search(r">=[\d.]+,<[\d.]+(; sys_platform == .*)?$", item), item
        assert re.search(rf'"{re.escape(item)}", +# \w', text), item


# Written so that these lines do not match themselves.
PRIVATE = re.compile(
    r"(?<![\w.>])/(?:home|root|work|tmp|opt|mnt|srv|var|builds|Users)/"
    r"|\b[A-Z]:\\\w"
    r"|\b(?:pypi|pythonhosted|npmjs)[.]org\b|\blocalhos[t]\b"
    r"|(?<![\d.])(?!127[.]|0[.]0[.]0)\d{1,3}(?:[.]\d{1,3}){3}(?![\d.])"
    r"|https?://(?:[\w.-]+[.])?(?:internal|local|corp|lan)\b"
)


def test_no_file_names_a_machine_or_a_place_on_it():
    found = [
        f"{name_of(path)}: {hit.group()}"
        for path, text in text_files()
        for hit in PRIVATE.finditer(text)
    ]

    assert found == []
