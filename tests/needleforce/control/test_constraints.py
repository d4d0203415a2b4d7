"""Constraints in closed loop, shortened, and the table that the study prints."""

import json
import math
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import ResultsError, UnknownIdError
from benchmarks.campaign.workers import Workers
from benchmarks.cli import main
from benchmarks.control import constraints as control_constraints
from benchmarks.control import study as control_study
from benchmarks.control.constraints import CASES, measure
from benchmarks.control.study import (
    ControlRow,
    Figure,
    control_jobs,
    control_table,
    run_control,
)


def figures(case, plant="clean", seed=0):
    return {item.what: item for item in measure(case, plant, seed)}


def test_a_remote_centre_and_a_fixture_hold_their_targets_on_a_shorter_way(monkeypatch):
    monkeypatch.setattr(control_constraints, "PERIOD_s", 2.0)
    monkeypatch.setattr(control_constraints, "RADIUS_m", 0.005)
    monkeypatch.setattr(control_constraints, "INSERTION_m", 0.01)
    for case in ("rcm S", "rcm_elbow I", "fixture I", "decoupled S"):
        found = figures(case).values()
        judged = [item for item in found if item.target is not None]
        assert judged
        assert all(0.0 < item.value <= item.target for item in judged), judged
    assert figures("fixture S")["no fixture, user sideways, max"].value > 10.0


def test_the_published_recursion_loses_the_insertion_to_the_posture_below(monkeypatch):
    monkeypatch.setattr(control_constraints, "INSERTION_m", 0.02)
    ours = figures("fixture S")["fixture, travel of 100 mm"].value
    published = figures("fixture_published S")
    travel = published["fixture, published recursion, travel of 100 mm"].value
    assert travel < 2.0 < 18.0 < ours


def test_kinematic_error_shows_where_shared_kinematics_hide_it():
    shared = figures("decoupled S")["decoupled turn, tip"].value
    displaced = figures("decoupled_kinematic S")[
        "decoupled turn, kinematic error, tip"
    ].value
    assert displaced > 5.0 * shared


@pytest.fixture
def part(monkeypatch):
    """A part of the study that takes no time: values by seed, and a case that fails."""

    def values(case, plant, seed):
        if case == "broken":
            raise ValueError("no arm")
        worse = 10.0 if plant == "fri" else 1.0
        yield Figure("delay", "S", worse * (seed - 999), "ms", 4.0, quantile=0.5)
        yield Figure("error", "S", np.float64(worse * (seed - 999)), "mm", 2.0)
        yield Figure("contrast", "I", 90.0 + seed - 1000, "%", 85.0, at_least=True)
        yield Figure("shown", "", math.nan if seed == 1001 else 1.0, "N", 1.0)
        yield Figure("reference", "", 5.0, "N")

    module = SimpleNamespace(CASES=("usual", "broken"), measure=values, __spec__="fake")
    monkeypatch.setitem(sys.modules, "benchmarks.control.fake", module)
    monkeypatch.setattr(control_study, "PARTS", ("fake",))


def test_rows_are_the_worst_seeds_and_misses_stand_on_top(part):
    jobs = control_jobs(["control-fake"], (), None, 3)
    assert len(jobs) == 2 * 2 * 3
    done = []
    rows = run_control(jobs, Workers(workers=1), done.append)
    assert done[-1] == 1.0
    clean = {row.what: row for row in rows if row.plant == "clean"}
    assert (clean["error"].value, clean["error"].is_met, clean["error"].seeds) == (
        3.0,
        False,
        3,
    )
    assert (clean["delay"].value, clean["delay"].is_met) == (2.0, True)
    assert (clean["contrast"].value, clean["contrast"].is_met) == (90.0, True)
    assert math.isnan(clean["shown"].value)
    assert not clean["shown"].is_met
    lines = control_table(rows).lines
    failed = "broken failed: ValueError: no arm"
    assert {lines[0][1], lines[1][1], lines[2][1]} == {"shown", failed, "error"}
    assert lines[2][3:] == ("3", "30", "≤ 2", "mm", "missed")
    assert lines[-1][1:3] == ("reference", "")


def test_the_command_prints_writes_and_says_what_is_missed(part, tmp_path, capsys):
    to = tmp_path / "control.json"
    arguments = ["run", "control", "--seeds", "2", "--workers", "1", "--plant", "clean"]
    assert main([*arguments, "--json", str(to), "--strict"]) == 1
    said = capsys.readouterr().out
    assert "missed" in said
    assert "no arm" in " ".join(said.split())
    rows = {row["what"]: row for row in json.loads(to.read_text())["rows"]}
    assert rows["shown"]["value"] is None
    assert (rows["error"]["value"], rows["error"]["met"]) == (2.0, True)
    assert rows["reference"]["met"] is None


def test_rows_that_cannot_be_written_are_an_error(tmp_path):
    row = ControlRow("fake", "error", "S", "clean", 1.0, "mm", None, False, 1)
    with pytest.raises(ResultsError, match="cannot write"):
        control_study.write_control(tmp_path / "no" / "file.json", [row])


def test_every_case_has_a_part_and_both_servos():
    assert len(CASES) == len(set(CASES)) == 2 * len(control_constraints.MEASURES)
    parts = {job.part for job in control_jobs(["control"], ["clean"], None, 1)}
    assert "constraints" in parts
    with pytest.raises(UnknownIdError, match="control-constraints"):
        control_jobs(["control-magic"], [], None, 1)
