"""Faults in a running insertion: beside this file, as `python -m benchmarks faults
--markdown` printed them."""

from pathlib import Path

import pytest

from benchmarks.faults.injection import PARTS, SIGNAL_FAULTS
from benchmarks.faults.study import FaultStudy, recovery

pytestmark = pytest.mark.slow


def documented():
    """The documented rows: worst error [N], recovery and what is reported, by fault."""
    table = Path(__file__).with_name("faults.md").read_text(encoding="utf-8")
    rows = [line.split("|")[1:-1] for line in table.splitlines()[2:]]
    return {name.strip(): [cell.strip() for cell in cells] for name, *cells in rows}


@pytest.fixture(scope="module")
def results():
    """Of every third fault of a signal: `python -m benchmarks run faults` has all."""
    with pytest.MonkeyPatch.context() as patch:
        chosen = dict(list(SIGNAL_FAULTS.items())[::3])
        patch.setattr("benchmarks.faults.study.SIGNAL_FAULTS", chosen)
        return list(FaultStudy(through_layer=False).session_results())


def test_every_kind_of_fault_is_documented():
    names = list(documented())

    assert names[: len(SIGNAL_FAULTS)] == list(SIGNAL_FAULTS)
    assert names[-len(PARTS) :] == list(PARTS)

    for word in (
        "limit",
        "stretched",
        "payload",
        "tare",
        "saturated",
        "jitter",
        "NaN",
        "frozen",
    ):
        assert any(word in name for name in names), word


def test_faults_are_recovered_from_as_documented(results):
    page = documented()
    for result in results:
        assert result.is_finite, result
        assert result.recovery_s <= 0.1, result
        worst, _, after, reported = page[result.name][:4]
        assert reported == (", ".join(result.reported) or "–"), result
        assert result.worst_N == pytest.approx(float(worst), abs=0.05, rel=0.1), result
        assert recovery(result.recovery_s).split()[-1] == after.split()[-1], result


def test_faults_that_must_be_reported_are(results):
    reported = {result.name: set(result.reported) for result in results}
    for name, words in reported.items():
        for word, warning in (
            ("spike", "SPIKE"),
            ("frozen", "FROZEN"),
            ("saturated", "SATURATED"),
        ):
            assert (word in name) == (warning in words) or "wrist" in name, name

    assert "JOINT_LIMIT" in reported["wrist pressed to its limit, 1 s"]
    assert "NEAR_SINGULAR" in reported["arm stretched along the needle, 1 s"]
    # The force across the needle is one of the three that are estimated.
    assert not reported["pushed aside with 1 N, 2 s"]
    # A weight along the needle is the only fault that raises a rupture.
    assert [result.name for result in results if result.note] == [
        "50 g hung on the tool, 2 s"
    ]
