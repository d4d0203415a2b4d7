"""Identification benchmarks end to end: the needle alone, the arm's kinematics, real tissue."""

from dataclasses import replace

import numpy as np
import pytest
from gel_slice import gel_slice

from benchmarks.benchmark import Job
from benchmarks import DataError
from benchmarks.recorded.bovine import (
    FILE,
    FOLDER,
    NOISE_N,
    depth_metrics,
    read_bovine,
    run_bovine_real,
)
from benchmarks.recorded.liver import (
    alarms_at_drops,
    drops_found,
    force_drops,
    insertion_parts,
    mean_at_depth,
    run_liver_real,
)
from benchmarks.identification_metrics import VISIBLE_SIGMAS
from benchmarks.signals import JointSignals, MeasuredTravel, measured_travel, smoothed
from benchmarks.simulated import drawn_noise, run_needle
from benchmarks.tables import friction_table, rupture_table, table_one_table
from groundtruth import simulate

SHORT = gel_slice()


def silent(share):
    assert 0.0 <= share <= 1.0


@pytest.fixture(scope="module")
def found(tmp_path_factory):
    job = Job(benchmark="short", plant="needle", drawings=tmp_path_factory.mktemp("drawings"))
    return run_needle(job, SHORT, silent, is_drawn=False)


def test_a_needle_alone_gives_both_methods_on_the_ft_sensor(found):
    by_key = {(item.source, item.method, item.metric): item.value for item in found.measurements}
    assert {key[:2] for key in by_key} == {("ft", "default"), ("ft", "published")}
    assert by_key["ft", "default", "rupture_recall"] == 1.0
    assert by_key["ft", "default", "rupture_precision"] == 1.0
    assert by_key["ft", "default", "friction_error_worst_pct"] < 10.0
    true = by_key["ft", "default", "cumulative_friction_true_Ns_per_m"]
    assert true == by_key["ft", "published", "cumulative_friction_true_Ns_per_m"] > 0.0
    assert ("ft", "published", "offline_rmse_ml_N") not in by_key
    ml, kv = (by_key["ft", "default", f"offline_rmse_{model}_N"] for model in ("ml", "kv"))
    assert 0.0 < ml < kv


def test_its_charts_are_drawn_and_its_tables_have_lines(found):
    assert [drawing.path.name for drawing in found.drawings] == [
        "short-needle-0-ft-paper.svg",
        "short-needle-0-ft-default.svg",
    ]
    assert all(drawing.path.stat().st_size > 10_000 for drawing in found.drawings)
    rows = [item.row("gel-70-constant", "needle", 0) for item in found.measurements]
    for table in (friction_table(rows), rupture_table(rows), table_one_table(rows)):
        assert table is not None
        assert table.row_count == 2
    assert friction_table([]) is rupture_table([]) is table_one_table([]) is None


def test_without_tissue_there_is_nothing_to_identify():
    job = Job(benchmark="short", plant="needle")
    assert run_needle(job, replace(SHORT, layers=()), silent, is_drawn=False).measurements == []


def test_drawn_noise_stays_within_a_factor_of_two():
    levels = [drawn_noise(np.random.default_rng(k)).white_std_N for k in range(200)]
    assert 0.005 <= min(levels) < 0.006
    assert 0.019 < max(levels) <= 0.02


@pytest.mark.parametrize("arm", ["ideal", "degraded"])
def test_the_robots_kinematics_tell_the_travel_of_the_tip(arm):
    run = simulate(SHORT, arm)
    sent = run.signals
    signals = JointSignals(
        t_s=sent.t_s, q_rad=sent.q_rad, dq_rad_s=sent.dq_rad_s, tau_Nm=sent.tau_Nm
    )
    travel = measured_travel(run.robot, signals, run.tare_end_s)
    after = run.truth.t_s > run.tare_end_s
    error = (travel.depth_m - run.truth.depth_m)[after]
    assert np.std(error) < 2e-5
    # The zero is where the tare ended, 10 mm above the surface, and not the surface.
    assert np.mean(error) == pytest.approx(10e-3, abs=1e-4)
    assert np.std((travel.speed_m_s - run.truth.speed_m_s)[after]) < 1e-3


def test_a_smoothed_speed_lags_by_its_time_constant_and_leaves_the_depth_alone():
    ramp = np.linspace(0.0, 1.0, 1001)
    travel = smoothed(MeasuredTravel(ramp, ramp), np.full(1001, 1e-3), 0.02)
    assert np.array_equal(travel.depth_m, ramp)
    assert travel.speed_m_s[-1] == pytest.approx(0.98, abs=1e-3)


# Real tissue.


def test_a_recording_is_split_where_the_needle_turns():
    depth = np.concatenate(
        (np.linspace(0, 0.08, 801), np.full(100, 0.08), np.linspace(0.08, 0, 801))
    )
    parts = insertion_parts(depth)
    assert depth[parts.insertion].max() == pytest.approx(0.08, abs=2e-4)
    assert parts.withdrawal.start > 901
    assert depth[parts.withdrawal].max() < 0.0785


def test_a_mean_at_a_depth_where_the_needle_never_was_is_not_a_number():
    depth = np.linspace(0, 0.05, 501)
    assert mean_at_depth(depth, 10.0 * depth, 0.02) == pytest.approx(0.2)
    assert np.isnan(mean_at_depth(depth, depth, 0.08))


def test_annotated_ruptures_are_found_missed_or_invented():
    values = depth_metrics([10.2, 20.4, 33.0], [10.0, 20.3, 32.9], [10.0, 20.0, 30.0])
    assert (values["ruptures_missed"], values["ruptures_false"]) == (1.0, 1.0)
    assert values["rupture_depth_error_mm"] == pytest.approx(0.4)
    assert values["rupture_dated_depth_error_mm"] == pytest.approx(0.3)
    assert depth_metrics([], [], [10.0]) == {"ruptures_missed": 1.0, "ruptures_false": 0.0}


def test_a_digitised_curve_becomes_a_signal_at_its_speed(tmp_path):
    folder = tmp_path / FOLDER
    folder.mkdir()
    # The last point begins a second stroke of the pen.
    (folder / FILE).write_text("depth_m,force_N\n0,0\n0.03,3\n0.03,1\n0.06,2\n0.02,9\n")
    signal = read_bovine(tmp_path, np.random.default_rng(0))
    assert np.diff(signal.depth_m) / np.diff(signal.t_s) == pytest.approx(3e-3)
    assert signal.depth_m[-1] == pytest.approx(0.06, abs=1e-5)
    assert signal.force_N.max() < 3.1
    assert signal.force_N[-1] == pytest.approx(2.0, abs=0.05)


@pytest.mark.parametrize("text", ["", "depth_m,force_N\n0,x\n", "depth_m,force_N\n0,1,2\n1,2,3\n"])
def test_a_broken_curve_is_refused(tmp_path, text):
    (tmp_path / FOLDER).mkdir()
    (tmp_path / FOLDER / FILE).write_text(text)
    with pytest.raises(DataError):
        read_bovine(tmp_path, np.random.default_rng(0))


def test_sudden_falls_are_found_and_slow_ones_and_the_end_are_not():
    depth = np.linspace(0.0, 0.08, 16_001)
    force = 20.0 * depth
    force -= 0.4 * np.clip((depth - 0.02) / 1e-3, 0.0, 1.0)
    force -= 0.4 * np.clip((depth - 0.04) / 1e-2, 0.0, 1.0)
    force -= 0.8 * np.clip((depth - 0.079) / 1e-3, 0.0, 1.0)
    (fall,) = force_drops(depth, force)
    assert fall.from_m == pytest.approx(0.02, abs=2e-4)
    assert fall.to_m == pytest.approx(0.021, abs=2e-4)
    assert drops_found([fall], [0.0205]) == drops_found([fall], [0.0213]) == 1
    assert drops_found([fall], [0.019, 0.03]) == 0
    assert alarms_at_drops([0.019, 0.0201, 0.0205, 0.03], [fall]) == 2
    assert alarms_at_drops([0.0205], []) == 0
    assert [len(force_drops(depth, force, least)) for least in (0.3, 0.5)] == [1, 0]


def test_real_liver_has_a_row_for_every_method(recordings_dir):
    job = Job(benchmark="liver-real", plant="recording", data=recordings_dir)
    by_key = {
        (item.method, item.metric): item.value for item in run_liver_real(job, silent).measurements
    }
    # What the data's description says of the rule of thumb.
    assert by_key["guess", "pullout_error_median_pct"] == pytest.approx(14.0, abs=1.0)
    assert by_key["guess", "pullout_error_p90_pct"] == pytest.approx(42.0, abs=1.0)
    assert ("guess", "ruptures_per_insertion") not in by_key
    assert by_key["default", "fall_recall"] > 0.5
    assert np.isfinite(list(by_key.values())).all()


def test_bovine_liver_has_its_four_ruptures(recordings_dir):
    job = Job(benchmark="bovine-real", plant="recording", data=recordings_dir)
    by_key = {
        (item.method, item.metric): item.value for item in run_bovine_real(job, silent).measurements
    }
    assert by_key["default", "ruptures_missed"] == 0.0
    assert by_key["default", "rupture_depth_error_mm"] < 1.0
    # Whatever else it reports is a fall of the curve, too.
    assert by_key["default", "ruptures_without_fall"] == 0.0


def test_the_bovine_curve_falls_in_two_more_places(recordings_dir):
    """As docs/limits.md says: a dip that fills again, and the last fall before the plateau."""
    drawn = read_bovine(recordings_dir, None)
    falls = force_drops(drawn.depth_m, drawn.force_N, VISIBLE_SIGMAS * NOISE_N)
    # The first lies in free air: it is as high as the dip at 15.7 mm.
    depths = [1e3 * fall.from_m for fall in falls]
    assert depths == pytest.approx([0.1, 15.7, 19.1, 30.0, 32.7, 36.6, 38.6], abs=0.06)
    drops = [fall.drop_N for fall in falls]
    assert drops == pytest.approx([0.09, 0.09, 1.20, 0.83, 0.93, 0.74, 0.16], abs=0.01)
