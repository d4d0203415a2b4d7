"""The first command: a simulated insertion beside its truth, in tables and a page."""

import importlib.util
import re
from dataclasses import replace

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.cli.demos import insertion as insertion_page
from needleforce.cli.terminal import FAILED
from needleforce.session import InsertionSession
from needleforce.simulation.insertion import run_session
from tests.chromium import PHONE, logged, measured, needs_chromium
from tests.insertion_run import cut, simulated

pytestmark = pytest.mark.slow


GEL_m = 28.2e-3  # thickness of the gel of 25 %, as its authors measured it
GEL_FRICTION_N = 113.0 * 2.3e-3  # Table I at the speed of the insertion
GEL_STIFFNESS_N_per_m = 0.9 * 0.30 / GEL_m  # elastic part of the force at its far end


@pytest.fixture(scope="module")
def compared():
    """One gel instead of three, without the withdrawal: a fifth of the time."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(insertion_page, "SCENARIO", "gel-25-constant")
        patch.setattr(insertion_page, "simulate", simulated)
        return insertion_page.compare(seed=0)


@pytest.fixture
def command(compared, monkeypatch, tmp_path):
    """The command, on the insertion that has been simulated already."""
    monkeypatch.setattr(insertion_page, "compare", lambda seed: compared)
    monkeypatch.chdir(tmp_path)
    return lambda *options: main(["demo", *options])


def test_the_rupture_and_its_layer_are_found_near_the_truth(compared):
    (rupture,) = compared.mixture.ruptures

    assert rupture.true.layer_friction_N == pytest.approx(GEL_FRICTION_N, rel=0.02)
    assert rupture.true.onset_m == pytest.approx(GEL_m, abs=0.1e-3)

    layer = rupture.layer
    travel_m = layer.rupture.depth_m - layer.rupture.contact_depth_m

    assert travel_m == pytest.approx(GEL_m, abs=2e-3)
    assert abs(layer.friction_N - GEL_FRICTION_N) < 3.0 * layer.friction_std_N
    assert (
        abs(layer.stiffness_N_per_m - GEL_STIFFNESS_N_per_m)
        < 3.0 * layer.stiffness_std_N_per_m
    )
    assert compared.mixture.false_alarms == 0


def test_the_force_is_nearer_the_truth_than_the_published_methods(compared):
    assert compared.mixture.force_error_N < 0.15
    assert compared.mixture.force_error_N < compared.published.force_error_N
    assert compared.mixture.tip_error_N < compared.published.tip_error_N


def test_a_method_needs_the_signals_and_no_truth(compared):
    run = compared.run
    beginning = slice(int(np.searchsorted(run.signals.t_s, run.tare_end_s + 1.0)))
    blind = replace(run, signals=cut(run.signals, beginning), truth=None)
    result = run_session(blind, InsertionSession(run.robot))

    assert np.array_equal(result.force_N, compared.mixture.result.force_N[beginning])


def test_the_command_prints_tables_picture_and_what_to_try_next(command, capsys):
    assert command() == 0

    printed = capsys.readouterr()

    assert "three gels" in printed.err.splitlines()[0]
    assert "the first time" in printed.err.splitlines()[0]

    lines = printed.out.splitlines()

    assert max(map(len, lines)) <= 96

    cells = re.split(r"\s{2,}", next(line for line in lines if "1 gel 25 %" in line))

    assert cells[1] == "28.2"
    end_mm, end_std_mm = map(float, cells[2].split(" ± "))

    assert end_mm == pytest.approx(28.2, abs=2.0)
    assert 0.0 < end_std_mm < 2.0
    assert cells[3] == f"{GEL_FRICTION_N:.2f}"
    assert cells[-1].endswith(" ms")
    assert "picture: demo/index.html" in lines
    assert [line for line in lines if line.startswith("  needleforce identify")]
    assert [line for line in lines if line.startswith("  needleforce report")]
    assert "not a medical device" in printed.out


def test_the_numbers_of_the_page_are_those_printed(command, capsys, tmp_path, compared):
    command()
    printed = capsys.readouterr().out
    page = (tmp_path / "demo" / "index.html").read_text(encoding="utf-8")

    for row in insertion_page.method_rows(compared):
        for cell in row:
            assert cell in printed
            assert f">{cell}</td>" in page
    assert insertion_page.answer(compared) in page.replace("&#39;", "'")


def test_the_page_states_how_far_frictions_differ_from_the_truth(
    command, capsys, compared
):
    command()
    (rupture,) = compared.mixture.ruptures
    true_N = rupture.true.layer_friction_N
    error_N = abs(rupture.layer.friction_N - true_N)

    printed = " ".join(capsys.readouterr().out.split())
    assert f"by {100 * error_N / true_N:.0f} to" in printed
    assert f"({error_N:.2f} to" in printed


def test_a_page_of_something_else_is_not_replaced(command, capsys, tmp_path):
    page = tmp_path / "mine" / "index.html"
    page.parent.mkdir()
    page.write_text("<title>my results</title>", encoding="utf-8")

    assert command("--report", "mine") == FAILED
    assert "name another folder" in capsys.readouterr().err
    assert page.read_text(encoding="utf-8") == "<title>my results</title>"


def test_a_second_run_replaces_the_page_of_the_first(command, tmp_path):
    assert command("--report", "page") == 0
    assert command("--report", "page", "--figure", "figure.svg") == 0
    assert (tmp_path / "figure.svg").read_text(encoding="utf-8").startswith("<?xml")


def test_a_folder_that_cannot_be_made_is_refused_before_the_work(
    command, capsys, monkeypatch, tmp_path
):
    (tmp_path / "taken").write_text("")
    monkeypatch.setattr(insertion_page, "compare", lambda seed: pytest.fail("worked"))

    assert command("--report", "taken") == FAILED
    assert "cannot write to taken" in capsys.readouterr().err


def test_a_negative_seed_is_refused(command, capsys):
    assert command("--seed", "-1") == FAILED
    assert "--seed -1: expected a whole number from 0 up" in capsys.readouterr().err


@pytest.mark.parametrize("module", ["mujoco", "jinja2"])
def test_a_missing_package_is_named_before_anything_is_done(
    command, capsys, monkeypatch, module
):
    known = importlib.util.find_spec
    monkeypatch.setattr(
        "needleforce.cli.terminal.find_spec",
        lambda name: None if name == module else known(name),
    )

    assert command() == FAILED

    (line,) = capsys.readouterr().err.splitlines()

    assert f"demo needs {module}, which is not installed" in line
    assert "pip install 'needleforce[demo]'" in line


@needs_chromium
@pytest.mark.parametrize("size", [(1280, 900), PHONE])
def test_the_page_fits_the_window(command, tmp_path, size):
    command()
    page = tmp_path / "demo" / "index.html"
    found = measured(page, size)

    assert logged(page) == []
    assert found["content"] <= size[0]
    assert found["wide"] == []
    assert all(height > 100 for height in found["images"])
