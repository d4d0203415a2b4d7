"""Timing: subjects take turns over the same samples, and the ratio is that of neighbours."""

import gc

import numpy as np
import pinocchio as pin
import pytest
from insertion_run import short_run, tare_index

from benchmarks.signals import JointSignals
from benchmarks.soak import Cycle, Soak
from benchmarks.speed import (
    BLOCK,
    LIMITS,
    LAYER_TICKS,
    ChainUpdate,
    GcPauses,
    SpeedReport,
    Timing,
    bare_sensor,
    event_table,
    pause_line,
    rerun_table,
    slab,
    speed_table,
    time_side_by_side,
)


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
        "chain",
    )
    timings = dict(zip(names, map(timing, (1.0, 1.9, 9.0, 1.0, 3.1, 9.0, 5.0)), strict=True))
    marks = list(speed_table(timings).columns[-1].cells)
    met, missed = "[green]met[/green]", "[red]missed[/red]"
    assert marks == ["", met, "", "", missed, "", met]
    assert (LIMITS["observer"], LIMITS["sensor"]) == (2.0, 3.0)
    assert LIMITS["chain"] == LIMITS["chain, velocity estimated"] == 5.0


def report(**changed):
    pauses = GcPauses()
    known = {
        "timings": {
            "dynamics of the sensor": timing(2.0),
            "sensor": timing(6.0),
            "chain": Timing(tick_us=np.array([[10.0, 11.0, 80.0], [10.0, 40.0, 10.0]])),
        },
        "alarms": {"chain": (2,)},
        "reruns": {"chain": (4, 100)},
        "pauses": pauses,
    }
    return SpeedReport(**(known | changed))


def test_ticks_with_an_event_are_told_apart():
    table = event_table(report())
    assert list(table.columns[0].cells) == ["rupture raised", "layer identified"]
    assert list(table.columns[4].cells) == ["80", "40"]
    assert list(table.columns[5].cells) == ["40", "20"]


def test_the_tick_that_identifies_a_layer_counts_the_sensor_too():
    table = rerun_table(report(), {("default", 10.0): 54.0, ("published", 60.0): 1000.0})
    assert list(table.columns[2].cells) == ["60", "1006"]
    assert list(table.columns[5].cells) == ["[green]met[/green]", "[red]missed[/red]"]


def test_garbage_collections_are_timed_while_it_is_entered():
    with GcPauses() as pauses:
        gc.collect()
    assert len(pauses.pauses_us) >= 1
    assert min(pauses.pauses_us) > 0.0
    count = len(pauses.pauses_us)
    gc.collect()
    assert len(pauses.pauses_us) == count
    assert str(count) in pause_line(pauses)
    assert "No garbage" in pause_line(GcPauses())


def test_a_chain_tick_notes_what_happened_in_it():
    run = short_run()
    sent = run.signals
    signals = JointSignals(
        t_s=sent.t_s, q_rad=sent.q_rad, dq_rad_s=sent.dq_rad_s, tau_Nm=sent.tau_Nm
    )
    tick = ChainUpdate(run.robot, signals, tare_index(run))
    for k in range(tare_index(run) + 17_500):
        tick(k)
    assert len(tick.alarms) == 1
    assert len(tick.layers) % LAYER_TICKS == 0
    assert tick.alarms[0] < tick.layers[0] < tick.layers[-1]


def test_a_slab_takes_its_time():
    motion = slab(10.0).motion
    time = np.arange(0.0, motion.duration_s, 1e-2)
    inside = np.array([0.0 < motion.position_m(t) < slab(10.0).thickness_m for t in time])
    assert np.sum(inside[time < motion.insertion_end_s]) * 1e-2 == pytest.approx(10.0, abs=0.5)


def soaked(**changes):
    known = {"first_us": 10.0, "last_us": 11.0, "first_kB": 5.0, "last_kB": 25.0}
    known |= {"first_rss_MB": 1.0, "last_rss_MB": 1.0, "ruptures": (1, 2), "skipped": 0}
    return Soak(**(known | changes))


def test_a_soak_compares_end_with_start():
    assert soaked().cost_share == pytest.approx(1.1)
    assert soaked().growth_kB == pytest.approx(20.0)


def test_a_soak_that_idles_is_told():
    assert soaked().is_busy
    assert not soaked(ruptures=(1, 0)).is_busy
    assert not soaked(skipped=1).is_busy


def test_every_cycle_of_a_soak_is_an_insertion_of_which_nothing_is_skipped():
    cycle = Cycle()
    _, ruptures, skipped = cycle.time(2 * cycle.length, lambda share: None)
    assert (ruptures, skipped) == ((1, 1), 0)


def test_the_bare_sensor_asks_for_a_regressor_as_often_as_the_sensor(lwr, monkeypatch):
    asked = []
    monkeypatch.setattr(pin, "computeJointTorqueRegressor", lambda *given: asked.append(given))
    still = np.zeros((200, lwr.nv))
    t_s = 1e-3 * np.arange(200)
    tick = bare_sensor(lwr, JointSignals(t_s=t_s, q_rad=still, dq_rad_s=still, tau_Nm=still))
    for k in range(200):
        tick(k)
    assert len(asked) == 10, "once in 20 ms"
