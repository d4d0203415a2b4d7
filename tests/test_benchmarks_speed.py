"""Cost of updates, soak, and long recordings through the commands."""

import sys
from functools import partial

import numpy as np
import pinocchio as pin
import pytest
from insertion_run import short_run, tare_index

from benchmarks import BenchmarkError, long_runs, speed
from benchmarks.cli import main
from benchmarks.signals import JointSignals
from identification import MULTILAYER
from identification.log_replay import ReplayStream


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


def test_subjects_see_every_sample_once_and_in_order_and_take_turns():
    seen, order = {"a": [], "b": []}, []

    def note(name, k):
        seen[name].append(k)
        order.append(name)

    subjects = {name: partial(note, name) for name in seen}
    last = 10 + 2 * speed.BLOCK
    found = speed.time_side_by_side(subjects, 10, last)
    assert seen["a"] == seen["b"] == list(range(last))
    assert order[20:] == (["a"] * speed.BLOCK + ["b"] * speed.BLOCK) * 2
    assert found["a"].shape == (2, speed.BLOCK)


def test_ratios_compare_neighbours_and_ticks_with_an_event_are_shown_apart():
    # A slow machine cancels.
    assert speed.cost_ratio(timing(2.0, 20.0, 2.0), timing(1.0, 10.0, 1.0)) == pytest.approx(2.0)
    # With numba and without.
    limits = [speed.SUBJECTS[name][1:] for name in ("observer", "sensor", "chain")]
    assert limits == [(2.0, 2.3), (3.0, 4.6), (4.5, 8.0)]
    assert speed.SUBJECTS["chain, velocity estimated"].compiled == 5.0
    raised, identified = speed.event_table(report()).lines
    assert (raised[0], raised[4:]) == ("rupture raised", ("80", "40"))
    assert (identified[0], identified[4:]) == ("layer identified", ("40", "20"))


@pytest.mark.parametrize(("compiler", "sensor"), [("numba", "missed"), ("", "met")])
def test_the_table_marks_what_is_too_slow(monkeypatch, compiler, sensor):
    monkeypatch.setattr(speed, "COMPILER", compiler)
    medians = {"dynamics of the observer": 1.0, "observer": 1.9, "observer, uneven clock": 9.0}
    medians |= {"dynamics of the sensor": 1.0, "sensor": 3.1, "sensor, uneven clock": 9.0}
    medians["chain"] = 4.5
    timings = {name: timing(median) for name, median in medians.items()}
    lines = speed.speed_table(report(times=timings)).lines
    assert [line[8] for line in lines] == ["", "met", "", "", sensor, "", "met"]
    assert [line[6] for line in lines] == ["", "1.90", "9.00", "", "3.10", "9.00", "4.50"]


def test_a_chain_update_notes_what_happened_in_it():
    run = short_run()
    update = speed.ChainUpdate(run.robot, JointSignals.of_run(run), tare_index(run))
    for k in range(tare_index(run) + 17_500):
        update(k)
    assert len(update.alarms) == 1
    assert len(update.layers) % speed.LAYER_TICKS == 0
    assert update.alarms[0] < update.layers[0] < update.layers[-1]


def test_the_bare_sensor_asks_for_a_regressor_as_often_as_the_sensor(lwr, monkeypatch):
    asked = []
    monkeypatch.setattr(pin, "computeJointTorqueRegressor", lambda *given: asked.append(given))
    still = np.zeros((200, lwr.nv))
    t_s = 1e-3 * np.arange(200)
    update = speed.bare_sensor(
        lwr, JointSignals(t_s=t_s, q_rad=still, dq_rad_s=still, tau_Nm=still)
    )
    for k in range(200):
        update(k)
    assert len(asked) == 10, "once in 20 ms"


def soaked(**changes):
    known = {"tick_us": (10.0, 11.0), "python_kB": (5.0, 25.0), "process_MB": (1.0, 1.0)}
    return long_runs.Soak(**(known | {"ruptures": (1, 2), "skipped": 0} | changes))


def test_a_soak_compares_end_with_start_and_every_cycle_is_a_whole_insertion():
    assert soaked().is_met
    bad = {"tick_us": (10.0, 11.1), "python_kB": (5.0, 106.0), "ruptures": (1, 0), "skipped": 1}
    for name, value in bad.items():
        assert not soaked(**{name: value}).is_met
    cycle = long_runs.Cycle()
    _, ruptures, skipped = cycle.time(2 * cycle.length, lambda fraction: None)
    assert (ruptures, skipped) == ((1, 1), 0)


@pytest.mark.parametrize("make", [long_runs.joint_recording, long_runs.needle_recording])
def test_a_recording_is_as_long_as_asked_smooth_and_the_same_every_time(make):
    parts = list(make(100.0, np.random.default_rng(0)))
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    assert len(parts) > 1
    assert len(whole["t_s"]) == 100_000
    np.testing.assert_allclose(np.diff(whole["t_s"]), 0.001)
    moved = whole.get("q_rad", whole.get("depth_m"))
    assert np.abs(np.diff(moved, axis=0)).max() < 1e-3
    again = next(iter(make(100.0, np.random.default_rng(0))))
    for name, values in again.items():
        np.testing.assert_array_equal(values, parts[0][name])


def test_a_process_is_watched_to_its_end():
    use = long_runs.run_python(["-c", "x = bytearray(50_000_000); import time; time.sleep(0.3)"])
    assert use.wall_s > 0.3
    assert 0.0 < use.cpu_s < use.wall_s + 0.1
    if sys.platform == "linux":
        assert max(use.memory_MB) > 50.0
    # One that says much does not block.
    talk = "import sys; sys.stderr.write('x' * 1_000_000)"
    assert long_runs.run_python(["-c", talk]).wall_s < 20.0
    with pytest.raises(BenchmarkError, match="no such thing"):
        long_runs.run_python(["-c", "raise SystemExit('no such thing')"])


STEADY = (100.0,) * 10


def test_speed_and_memory_of_a_long_recording_count():
    for cpu_s, memory_MB, is_met in (
        (4.9, STEADY, True),
        (5.1, STEADY, False),
        (4.9, (*STEADY[1:], 150.0), False),
        (4.9, (), False),
    ):
        use = long_runs.ProcessUse(wall_s=9.0, cpu_s=cpu_s, memory_MB=memory_MB)
        found = long_runs.StreamSpeed("residual", ".csv", 100.0, 200_000, use)
        assert found.is_met == is_met
        assert found.times_real == pytest.approx(100.0 / cpu_s)


def test_a_long_recording_ruptures_fresh_tissue_in_every_cycle():
    stream, ruptures_s = ReplayStream(MULTILAYER), []
    for columns in long_runs.needle_recording(230.0, np.random.default_rng(0)):
        estimates = stream.run(**columns).estimates
        assert all(estimate.status.is_used for estimate in estimates)
        ruptures_s += [e.rupture.time_s for e in estimates if e.rupture]
    assert len(ruptures_s) >= 3
    assert max(ruptures_s) > 150.0


def test_the_command_prints_both_commands_and_refuses_too_short_a_recording(capsys, tmp_path):
    assert main(["stream", "--seconds", "20", "--folder", str(tmp_path)]) == 0
    printed = capsys.readouterr().out
    assert "│ residual" in printed
    assert "│ identification │ .csv" in printed
    assert printed.count("20000") == 2
    assert not list(tmp_path.iterdir())
    assert main(["stream", "--seconds", "5"]) == 2
    assert main(["stream", "--seconds", "20", "--folder", str(tmp_path / "none")]) == 2
    assert "no recording to stream" in capsys.readouterr().err
