"""Cost of updates, soak, long recordings."""

from time import sleep

import numpy as np
import pytest

from benchmarks.cli import main
from benchmarks.performance import control_speed, long_runs, speed
from tests.benchmarks.benchmark_cases import by_head


def timing(*medians):
    return np.array([[m, m, m] for m in medians])


def report(**changed):
    known = {
        "times": {
            "dynamics of the sensor": timing(2.0),
            "sensor": timing(6.0),
            "chain": np.array([[10.0, 11.0, 80.0], [10.0, 40.0, 10.0]]),
        },
        "alarms": {"chain": [2]},
        "layers": {"chain": [4, 100]},
    }
    return speed.SpeedReport(**(known | changed))


def test_ratios_compare_neighbours_and_events_stand_apart():
    # A slow machine cancels.
    assert speed.cost_ratio(
        timing(2.0, 20.0, 2.0), timing(1.0, 10.0, 1.0)
    ) == pytest.approx(2.0)

    raised, identified = by_head(speed.event_table(report()))

    assert raised["what"] == "rupture raised"
    assert raised["worst us"] == "80"
    assert raised["worst, ratio"] == "40"
    assert identified["what"] == "layer identified"
    assert identified["worst us"] == "40"
    assert identified["worst, ratio"] == "20"


@pytest.mark.parametrize(("compiler", "sensor"), [("numba", "missed"), ("", "met")])
def test_the_table_marks_what_is_too_slow(monkeypatch, compiler, sensor):
    monkeypatch.setattr(speed, "COMPILER", compiler)
    medians = {"dynamics of the observer": 1.0, "observer": 1.9}
    medians |= {"dynamics of the sensor": 1.0, "sensor": 2.6}
    medians |= {"chain": 4.3, "chain, published identifier": 3.7}
    timings = {name: timing(median) for name, median in medians.items()}
    lines = by_head(speed.speed_table(report(times=timings)))
    marks = [line["mark of target"] for line in lines]

    assert marks == ["", "met", "", sensor, "met", "met"]

    ratios = [line["ratio"] for line in lines]

    assert ratios == ["", "1.90", "", "2.60", "4.30", "3.70"]


def test_limits_of_a_tick_are_those_agreed():
    """So that nobody eases one unseen."""
    limits = {name: subject.compiled for name, subject in speed.SUBJECTS.items()}

    assert limits["observer"] == 2.0
    assert limits["sensor"] == 2.5
    assert limits["chain"] == 4.3
    assert limits["chain, published identifier"] == 3.7
    assert speed.MEAN_TICK_RATIO == 2.0
    assert (8.0 if speed.COMPILER else 25.0) == control_speed.RATIO


def test_subjects_take_turns_and_what_warms_them_up_does_not_count():
    asked = []

    def measure(update, ks):
        asked.append((update(0), ks))
        return [2.5]

    subjects = {"a": lambda k: "a", "b": lambda k: "b"}
    times = speed.take_turns(subjects, 3, 450, measure)

    assert asked == [
        ("a", range(3)),
        ("b", range(3)),
        ("a", range(3, 203)),
        ("b", range(3, 203)),
        ("a", range(203, 403)),
        ("b", range(203, 403)),
    ]
    assert times["a"] == [[2.5], [2.5]]


def test_processor_time_does_not_count_what_others_take():
    times = speed.processor_times({"sleeps": lambda k: sleep(1e-3)}, 0, 200)

    assert np.median(times["sleeps"]) < 500.0


def soaked(**changes):
    known = {
        "tick_us": (10.0, 11.0),
        "python_kB": (5.0, 25.0),
        "process_MB": (1.0, 1.0),
    }
    return long_runs.Soak(**(known | {"ruptures": (1, 2), "skipped": 0} | changes))


def test_a_soak_compares_end_with_start():
    assert soaked().is_met

    bad = {
        "tick_us": (10.0, 11.1),
        "python_kB": (5.0, 106.0),
        "ruptures": (1, 0),
        "skipped": 1,
    }
    for name, value in bad.items():
        assert not soaked(**{name: value}).is_met


STEADY = (100.0,) * 10


def test_speed_and_memory_of_a_long_recording_count():
    for cpu_s, memory_MB, is_met in (
        (4.9, STEADY, True),
        (5.1, STEADY, False),
        (4.9, (*STEADY[1:], 150.0), False),
        (4.9, (), False),
    ):
        use = long_runs.ProcessUse(wall_s=9.0, cpu_s=cpu_s, memory_MB=memory_MB)
        stream = long_runs.StreamSpeed("residual", ".csv", 100.0, 200_000, use)
        assert stream.is_met == is_met
        assert stream.times_real == pytest.approx(100.0 / cpu_s)


@pytest.mark.slow
def test_stream_times_both_commands_and_refuses_short_recordings(capsys, tmp_path):
    assert main(["stream", "--seconds", "20", "--folder", str(tmp_path)]) == 0

    printed = capsys.readouterr().out

    assert "│ residual" in printed
    assert "│ identification │ .csv" in printed
    assert printed.count("20000") == 2
    assert not list(tmp_path.iterdir())
    assert main(["stream", "--seconds", "5"]) == 2
    assert main(["stream", "--seconds", "20", "--folder", str(tmp_path / "none")]) == 2
    assert "no recording to stream" in capsys.readouterr().err
