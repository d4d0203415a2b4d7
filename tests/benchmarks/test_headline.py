"""The gate of headline figures: what is worse is named, and nothing passes by luck."""

import math

import numpy as np
import pandas as pd
import pytest

from benchmarks import ResultsError, headline
from benchmarks.cli import main
from benchmarks.headline import (
    COLUMNS,
    HEADLINE_FILE,
    compare_figures,
    insertion_figures,
    keep_lesser,
    read_headline,
    take_fastest,
    write_headline,
)
from benchmarks.performance import kdl
from benchmarks.performance.kdl import KdlAbsentError
from tests.benchmarks.benchmark_cases import make_results

JUDGED = {
    "delay": (0.0, 5.0, 0.0),
    "recall": (1.0, 0.0, 0.0),
    "error": (0.0, 0.0, 0.03),
    "coverage": (0.95, 0.01, 0.0),
    "sigma": (1.0, 0.03, 0.03),
}


def figures(unit="1", **values):
    return pd.DataFrame.from_dict(
        {kind: (value, unit, *JUDGED[kind]) for kind, value in values.items()},
        "index",
        columns=list(COLUMNS),
    )


def change(kind, old, new):
    return compare_figures(figures(**{kind: old}), figures(**{kind: new}))[
        "change"
    ].item()


@pytest.mark.parametrize(
    ("kind", "old", "just_below", "just_above"),
    [
        ("delay", 80.0, 85.0, 85.01),
        ("recall", 0.9, 0.9, 0.899),
        ("error", 0.2, 0.206, 0.2061),
        ("coverage", 0.9, 0.89, 0.889),
        ("coverage", 0.96, 0.97, 0.971),
        ("sigma", 1.5, 1.53, 1.54),
        ("sigma", 0.8, 0.77, 0.76),
    ],
)
def test_a_figure_is_worse_only_beyond_its_tolerance(kind, old, just_below, just_above):
    found = [change(kind, old, new) for new in (just_below, just_above)]
    assert found == ["same", "worse"]


def test_what_is_better_missing_or_new_is_named():
    changes = compare_figures(figures(delay=80.0), figures(error=0.1))

    assert change("sigma", 3.0, 1.1) == "better"
    assert change("delay", math.nan, math.nan) == "not finite"
    assert changes["change"].to_dict() == {"delay": "missing", "error": "new"}
    assert changes.loc["error", "unit"] == "1"


def test_figures_beside_an_absent_library_are_left_out():
    old = pd.concat([figures(headline.OF_KDL, error=0.7), figures(delay=80.0)])
    new = figures(delay=80.0)

    assert compare_figures(old, new)["change"].tolist() == ["missing", "same"]
    assert compare_figures(old, new, headline.OF_KDL)["change"].tolist() == ["same"]


def insertions(**changed):
    """Delays of all insertions of the gate, some changed by plant and source."""
    return make_results(
        *(
            {
                "scenario": scenario,
                "plant": plant,
                "seed": headline.SEED,
                "source": source,
                "metric": "rupture_delay_ms",
                "value": changed.get(f"{plant}_{source}_{k}", 10.0 * k),
            }
            for k, scenario in enumerate(headline.SCENARIOS)
            for plant in headline.PLANTS
            for source in ("ft", "virtual")
        )
    )


OTHER_SEED = pd.concat([insertions(), insertions().assign(seed=3, value=1.0)])


@pytest.mark.parametrize(
    ("results", "virtual_ms"),
    [
        (insertions(fri_virtual_3=100.0), 15.0),
        (OTHER_SEED, 15.0),
        # An insertion without a number leaves its figure without one.
        (insertions().iloc[:-1], math.nan),
    ],
)
def test_figures_sum_up_insertions_by_plant_and_force(results, virtual_ms):
    found = insertion_figures(results)["value"]

    assert [
        found[f"{force}: delay of the alarm, median"]
        for force in ("clean, ft", "fri, ft", "fri, virtual")
    ] == pytest.approx([15.0, 15.0, virtual_ms], rel=0.0, abs=0.0, nan_ok=True)


def test_the_fastest_of_three_passes_and_of_two_measurements_counts():
    passes = iter([[3.0, 1.0], [2.0, 9.0], [4.0, 4.0]])
    times = take_fastest(lambda: {"a": np.array(next(passes))})

    lesser = keep_lesser(
        figures(delay=3.0, error=math.nan), figures(delay=2.0, error=1.0)
    )

    assert times["a"].tolist() == [2.0, 1.0]
    assert lesser["value"].tolist() == pytest.approx([2.0, math.nan], nan_ok=True)


def test_a_file_is_read_as_written_one_figure_a_line(tmp_path):
    path = tmp_path / "a.json"
    write_headline(path, figures(delay=1.0 / 3.0, error=math.nan))
    found, about = read_headline(path)

    assert found["value"].tolist() == pytest.approx([0.333333, math.nan], nan_ok=True)
    assert found["tolerance"].tolist() == [5.0, 0.0]
    shape = (set(about), len(path.read_text().splitlines()))
    assert shape == ({"commit", "numpy", "pin", "numba"}, 5)

    path.write_text("{}")
    with pytest.raises(ResultsError, match="figures"):
        read_headline(path)


def test_the_file_in_the_repository_has_every_figure():
    known, _ = read_headline(HEADLINE_FILE)
    expected = insertion_figures(insertions()).drop(columns="value")
    found = known.drop(columns="value").loc[expected.index]

    pd.testing.assert_frame_equal(found, expected, check_names=False)
    assert known["value"].notna().all()


@pytest.fixture
def measured(monkeypatch):
    """Insertions and times that take no time, and no KDL."""

    def no_kdl():
        raise KdlAbsentError("no KDL here")

    results = insertions()
    monkeypatch.setattr("benchmarks.campaign.run_jobs", lambda *_, **__: (results, []))
    monkeypatch.setattr(kdl, "kdl_library", no_kdl)
    times = [figures(headline.OF_PINOCCHIO, delay=8.0) for _ in range(2)]
    monkeypatch.setattr(headline, "measure_times", lambda _: times.pop())
    return pd.concat([insertion_figures(results), times[0]])


def test_the_command_names_what_is_worse_and_fails(tmp_path, measured, capsys):
    path = tmp_path / "a.json"
    write_headline(path, measured[measured["value"].notna()].assign(value=1.0))

    assert main(["headline", "--file", str(path)]) == 1

    printed = capsys.readouterr().out

    assert "no KDL here" in printed
    assert printed.count("worse") > 4
    assert "clean, ft: delay of the alarm, median" in printed
    for options in ([str(tmp_path / "none.json")], [str(path), "--write"]):
        assert main(["headline", "--file", *options]) == 2  # not written without KDL
