"""Timing: subjects take turns over the same samples, and the ratio is that of neighbours."""

import numpy as np
import pytest

from benchmarks.speed_command import LIMITS, speed_table
from benchmarks.timing import BLOCK, Timing, time_side_by_side


def timing(*medians):
    return Timing(tick_us=np.array([[m, m, m] for m in medians]))


def test_every_subject_sees_every_sample_once_and_in_order():
    seen = {"a": [], "b": []}
    last = 10 + 2 * BLOCK
    found = time_side_by_side({name: seen[name].append for name in seen}, 10, last)
    assert seen["a"] == seen["b"] == list(range(last))
    assert found["a"].tick_us.shape == (2, BLOCK)


def test_subjects_take_turns():
    order = []
    subjects = {name: (lambda k, name=name: order.append(name)) for name in ("a", "b")}
    time_side_by_side(subjects, 0, 2 * BLOCK)
    assert order == (["a"] * BLOCK + ["b"] * BLOCK) * 2


def test_the_ratio_compares_neighbours_so_a_slow_machine_cancels():
    assert timing(2.0, 20.0, 2.0).ratio_to(timing(1.0, 10.0, 1.0)) == pytest.approx(2.0)


def test_percentiles_are_of_all_ticks():
    assert timing(1.0, 2.0, 3.0).percentile_us(50.0) == 2.0


def test_the_table_marks_what_is_too_slow():
    names = (
        "dynamics of the observer",
        "observer",
        "observer, uneven clock",
        "dynamics of the sensor",
        "sensor",
        "sensor, uneven clock",
    )
    timings = dict(zip(names, map(timing, (1.0, 1.9, 9.0, 1.0, 3.1, 9.0)), strict=True))
    marks = list(speed_table(timings).columns[-1].cells)
    assert marks == ["", "[green]met[/green]", "", "", "[red]missed[/red]", ""]
    assert LIMITS == {"observer": 2.0, "sensor": 3.0}
