"""Faults in a running insertion: reported, recovered from, never infinite; docs/loop.md."""

import math
import re
from pathlib import Path

import numpy as np
import pytest

from benchmarks.fault_study import (
    FaultResult,
    FaultStudy,
    fault_table,
    is_finite,
    late,
    recovery,
)
from benchmarks.faults import PARTS, SIGNAL_FAULTS, troubled_scenario

PAGE = (Path(__file__).parents[1] / "docs" / "loop.md").read_text(encoding="utf-8")


def documented():
    """The documented rows: worst error [N], recovery and what is reported, by fault."""
    found = re.search(r"<!-- faults:begin -->\n(.*?)<!-- faults:end -->", PAGE, re.DOTALL)
    rows = [line.split("|")[1:-1] for line in found[1].splitlines()[2:]]
    return {name.strip(): [cell.strip() for cell in cells] for name, *cells in rows}


@pytest.fixture(scope="module")
def results():
    study = FaultStudy(through_layer=False)
    return list(study.session_results())


def test_every_fault_of_the_issue_is_in_the_table():
    names = list(documented())
    assert names[: len(SIGNAL_FAULTS)] == list(SIGNAL_FAULTS)
    assert names[-len(PARTS) :] == list(PARTS)
    for word in ("limit", "stretched", "payload", "tare", "saturated", "jitter", "NaN", "frozen"):
        assert any(word in name for name in names), word


def test_no_number_is_infinite_and_every_fault_is_recovered_from(results):
    for result in results:
        assert result.is_finite, result
        assert result.recovery_s <= 0.1, result


def test_what_is_reported_is_what_the_page_says(results):
    page = documented()
    for result in results:
        worst, _, after, reported = page[result.name][:4]
        assert reported == (", ".join(result.reported) or "–"), result
        assert result.worst_N == pytest.approx(float(worst), abs=0.05, rel=0.1), result
        assert recovery(result.recovery_s).split()[-1] == after.split()[-1], result


def test_faults_that_must_be_reported_are(results):
    reported = {result.name: set(result.reported) for result in results}
    for name, words in reported.items():
        for word, warning in (("spike", "SPIKE"), ("frozen", "FROZEN"), ("saturated", "SATURATED")):
            assert (word in name) == (warning in words) or "wrist" in name, name
    assert "JOINT_LIMIT" in reported["wrist pressed to its limit, 1 s"]
    assert "NEAR_SINGULAR" in reported["arm stretched along the needle, 1 s"]
    # The force across the needle is one of the three that are estimated.
    assert not reported["pushed aside with 1 N, 2 s"]


def test_a_weight_along_the_needle_is_the_only_fault_that_raises_a_rupture(results):
    assert [result.name for result in results if result.note] == ["50 g hung on the tool, 2 s"]


def test_the_troubled_insertion_does_all_it_should():
    scenario, spans = troubled_scenario()
    parts = list(PARTS)
    assert list(spans) == parts
    begin_s, end_s = spans[parts[0]]
    assert end_s - begin_s == pytest.approx(60.0)
    motion = scenario.motion
    assert motion.position_m(end_s) == motion.position_m(begin_s)
    times = np.linspace(*spans[parts[1]], 100)
    depth = np.array([motion.position_m(float(t)) for t in times])
    assert depth.max() - depth.min() == pytest.approx(5e-3, rel=1e-3)
    assert motion.position_m(spans[parts[2]][1]) < 0.0 < motion.position_m(spans[parts[3]][1])


def test_the_table_prints_what_was_found():
    bad = FaultResult(
        name="x", worst_N=1.234, worst_sigma=2.0, recovery_s=math.inf, reported=(), is_finite=False
    )
    good = FaultResult(
        name="y",
        worst_N=0.0,
        worst_sigma=0.0,
        recovery_s=0.0123,
        reported=("a", "B"),
        is_finite=True,
    )
    header, _, *rows = fault_table([bad, good]).markdown()
    assert header in PAGE
    assert rows[0].startswith("| x | 1.23 | 2 | never | – | not finite")
    assert rows[1] == "| y | 0.00 | 0 | 12 ms | a, B |  |"


def test_a_number_that_is_not_finite_is_found_anywhere():
    assert is_finite((1.0, (np.zeros(2), "text", None)))
    assert not is_finite((1.0, (np.array([0.0, np.inf]),)))
    assert not is_finite((math.nan,))


def test_a_late_force_lags_by_what_it_should():
    ramp = 1e-3 * np.arange(2000)
    assert late(ramp)[-1] == pytest.approx(ramp[-1] - 0.014, abs=1e-3)
    assert late(ramp, with_velocity=False)[-1] == pytest.approx(ramp[-1] - 0.024, abs=2e-3)
