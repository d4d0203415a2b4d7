"""Files that forges, indexes and catalogues read agree with each other."""

import re
import tomllib

from ruamel.yaml import YAML

from tests.source_files import ROOT

PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))[
    "project"
]
FORGE = ROOT / ".github"
MINOR_VERSIONS = ["3.11", "3.12", "3.13"]


def read_yaml(path):
    return YAML(typ="safe").load(path.read_text(encoding="utf-8"))


def test_the_citation_names_this_version_and_the_paper():
    citation = read_yaml(ROOT / "CITATION.cff")

    assert citation["cff-version"] == "1.2.0"
    assert citation["version"] == PROJECT["version"]
    assert citation["license"] == PROJECT["license"]

    (paper,) = citation["references"]

    assert paper["title"].startswith("Online needle-tissue interaction model")
    assert [author["family-names"] for author in paper["authors"]] == [
        "Ferro",
        "Gaz",
        "Anzidei",
        "Vendittelli",
    ]


def test_version_and_date_are_those_of_the_changelog():
    changelog = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    version, date = re.search(r"^## \[([\d.]+)\] – (\S+)$", changelog, re.M).groups()
    citation = read_yaml(ROOT / "CITATION.cff")

    assert version == PROJECT["version"]
    assert str(citation["date-released"]) == date


def test_the_workflow_runs_the_checks_on_every_supported_python():
    (job,) = read_yaml(FORGE / "workflows" / "ci.yml")["jobs"].values()

    assert job["strategy"]["matrix"]["python"] == MINOR_VERSIONS
    assert [step["run"] for step in job["steps"] if "run" in step][-1] == ".ci/run"

    classifiers = [item.rpartition(" :: ")[2] for item in PROJECT["classifiers"]]

    assert [item for item in classifiers if re.match(r"3\.\d", item)] == MINOR_VERSIONS
    assert PROJECT["requires-python"] == f">={MINOR_VERSIONS[0]}"


def test_a_bug_report_asks_for_the_doctors_findings():
    template = (FORGE / "ISSUE_TEMPLATE" / "bug_report.md").read_text(encoding="utf-8")

    assert "needleforce doctor --json" in template
    assert "No data of patients" in template
