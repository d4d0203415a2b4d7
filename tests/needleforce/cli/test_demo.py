"""The first command: a simulated insertion beside its truth, in tables and a page."""

import importlib.util
import re

import pytest

from needleforce.cli import main
from tests.insertion_run import simulated

DEMO = "needleforce.cli.demos.insertion"
pytestmark = pytest.mark.slow

GEL_m = 28.2e-3  # thickness of the gel of 25 %, as its authors measured it
GEL_FRICTION_N = 113.0 * 2.3e-3  # Table I at the speed of the insertion


@pytest.fixture(scope="module")
def demo(tmp_path_factory):
    """What the command prints, and its folder; one gel instead of three, without the
    withdrawal: a fifth of the time."""
    folder = tmp_path_factory.mktemp("demo")
    said = []
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setattr(f"{DEMO}.SCENARIO", "gel-25-constant")
        patch.setattr(f"{DEMO}.simulate", simulated)
        patch.setattr(f"{DEMO}.write_out", said.append)
        assert main(["demo"]) == 0
    return "".join(said), folder / "demo" / "index.html"


def cells(printed, number):
    """Cells of the first layer in a table, counted from 0."""
    lines = re.findall(r"^ +1 .*\d$|^1 gel.*$|^ +1 .*\?$", printed, re.MULTILINE)
    return re.split(r"\s{2,}", lines[number].strip())


def test_estimates_are_printed_beside_the_truth(demo):
    printed, _ = demo
    found = cells(printed, 0)
    true = cells(printed, 1)
    end_mm, end_std_mm = map(float, found[2].split("±"))
    friction_N, std_N = map(float, found[7].strip("?").split("±"))

    assert (true[0], float(true[1]), float(true[4])) == (
        "1 gel 25 %",
        pytest.approx(1e3 * GEL_m, abs=0.1),
        pytest.approx(GEL_FRICTION_N, rel=0.02),
    )
    assert end_mm == pytest.approx(1e3 * GEL_m, abs=3.0)
    assert 0.0 < end_std_mm < 3.0
    assert abs(friction_N - GEL_FRICTION_N) < 3.0 * std_N
    assert abs(float(found[3]) - float(true[2])) < 0.1
    assert 0.01 < float(re.search(r"within (\S+) N rms", printed)[1]) < 0.15
    assert "1 rupture detected" in printed


def test_page_and_next_commands_are_named(demo):
    printed, path = demo
    page = path.read_text(encoding="utf-8")

    assert "page: demo/index.html" in printed
    assert re.findall(r"^  needleforce (identify|report|doctor)", printed, re.M) == [
        *("identify", "report", "doctor"),
    ]
    assert "not a medical device" in printed
    assert "not a medical device" in page
    assert "than in the README" in printed  # why frictions err by more
    assert {*cells(printed, 0), *cells(printed, 1)} <= {
        *re.findall(r">([^<]*)</td>", page)
    }


@pytest.mark.parametrize("module", ["mujoco", "jinja2"])
def test_a_missing_package_is_named_before_anything_is_done(
    capsys, monkeypatch, module
):
    known = importlib.util.find_spec
    monkeypatch.setattr(
        "needleforce.cli.terminal.find_spec",
        lambda name: None if name == module else known(name),
    )

    assert main(["demo"]) == 2

    (line,) = capsys.readouterr().err.splitlines()

    assert module in line
    assert "pip install 'needleforce[demo]'" in line


def test_a_place_that_is_taken_is_refused_before_the_work(
    capsys, monkeypatch, tmp_path
):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "taken").touch()
    monkeypatch.setattr(f"{DEMO}.demonstrate", lambda seed: pytest.fail("worked"))

    assert main(["demo", "--report", "taken"]) == 2
    assert "taken" in capsys.readouterr().err
