"""Benchmarks on real recordings: known-good figures, broken files, regressions."""

import json
import math

import numpy as np
import pytest

from benchmarks import DataError
from benchmarks.catalogue import run_job
from benchmarks.insertion.methods import joint_residual
from benchmarks.insertion.recorded import (
    bovine,
    liver,
    on_arm,
    panda,
    ur10e,
)
from benchmarks.insertion.recorded.bovine import depth_metrics
from benchmarks.insertion.recorded.liver import at_drops, force_drops, read_arrays
from benchmarks.insertion.recorded.liver_bound import predict_by_line
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Job
from benchmarks.results import Figure
from tests.benchmarks.benchmark_cases import silent


def values(run, benchmark, data, **more):
    job = Job(benchmark=benchmark, plant="recording", data=data, **more)
    return {(item.method, item.metric): item.value for item in run(job, silent)}


def test_the_pandas_residual_is_as_small_as_known(recordings_dir):
    numbers = values(panda.run, "panda-real", recordings_dir)
    known = (0.37, 0.76, 0.37, 0.39, 0.14, 0.10, 0.06)
    reached = [numbers["ours", f"residual_rms_J{joint}_Nm"] for joint in range(1, 8)]

    assert [math.floor(100.0 * value) / 100.0 for value in reached] == pytest.approx(
        known
    )


def test_the_chain_runs_on_real_torques_and_tissue(recordings_dir, tmp_path):
    options = {"data": recordings_dir, "drawings": tmp_path}
    job = Job(benchmark="panda-liver", plant="recording", seed=1, **options)
    measured = [
        item for item in panda.run_with_liver(job, silent) if isinstance(item, Figure)
    ]
    numbers = {(item.source, item.method, item.metric): item.value for item in measured}
    rmse = "wrench_rmse_N"

    assert (
        numbers["virtual", "ours", rmse]
        < 0.1 * numbers["virtual", "published-one-setting", rmse]
    )
    # Turned round, the force would be off by twice its mean of 1.4 N.
    assert abs(numbers["virtual", "ours", "wrench_bias_N"]) < 1.0
    assert list(tmp_path.glob("panda-liver-recording-1-*.svg"))
    # The force itself at the arm's uneven clock: as in liver-real.
    assert numbers["ft", "ours", "drop_recall"] == 1.0
    assert numbers["ft", "ours", "ruptures_at_drops"] > 0.8
    # Its drops are smaller than this arm's noise: what matters is that noise raises few
    # alarms.
    assert numbers["virtual", "ours", "ruptures_per_insertion"] <= 3.0

    off = "enhanced_against_ft_rmse_N"

    assert (
        numbers["virtual", "ours", off]
        < 0.3 * numbers["virtual", "published-one-setting", off]
    )
    assert np.isfinite(list(numbers.values())).all()


def test_the_simulated_arm_feels_a_recorded_liver(recordings_dir):
    job = Job(benchmark="liver-on-arm", plant="clean", seed=1, data=recordings_dir)
    measured = on_arm.run_liver(job, silent)
    numbers = {(item.source, item.metric): item.value for item in measured}

    assert numbers["virtual", "wrench_rmse_N"] < 0.06
    assert numbers["virtual", "wrench_coverage_2sigma"] > 0.9
    assert numbers["ft", "drop_recall"] == 1.0
    # One of five alarms lies beside the drops: over three recordings 0.84 do not.
    assert numbers["ft", "ruptures_at_drops"] > 0.7
    assert abs(numbers["ft", "pullout_error_mean_N"]) < 0.5
    assert np.isfinite(list(numbers.values())).all()


def test_the_weight_on_the_ur10e_is_found(recordings_dir):
    numbers = values(ur10e.run, "ur10e-payload", recordings_dir)

    assert numbers["ours", "force_up_unloaded_N"] == pytest.approx(-1.7, abs=1.0)
    assert numbers["ours", "force_up_loaded_N"] == pytest.approx(-25.3, abs=1.5)
    assert 1.05 < numbers["ours", "torque_scale"] < 1.2
    assert abs(numbers["ours", "weight_error_pct"]) < 10.0


@pytest.mark.parametrize("name", ["panda-real", "panda-liver", "ur10e-payload"])
def test_an_empty_folder_fails_in_one_line(tmp_path, name):
    outcome = run_job(Job(benchmark=name, plant="recording", data=tmp_path), silent)

    assert outcome.rows == ()
    assert outcome.failure is not None
    assert outcome.failure.startswith("DataError: cannot read ")
    assert "\n" not in outcome.failure

    nowhere = run_job(Job(benchmark=name, plant="recording"), silent)

    assert nowhere.failure == f"DataError: {name} needs recordings"


def test_broken_recordings_models_and_missing_velocities_are_refused(tmp_path, lwr):
    path = tmp_path / "a.npz"
    np.savez(path, good=np.ones(3), empty=np.zeros(0), bad=np.array([1.0, np.nan]))

    assert read_arrays(path, ["good"])[0].tolist() == [1.0, 1.0, 1.0]

    for names, message in (
        (["t_s", "good"], r"lacks t_s; it has good, empty, bad"),
        (["empty"], "empty or has values"),
        (["bad"], "not finite"),
    ):
        with pytest.raises(DataError, match=message):
            read_arrays(path, names)
    path.write_bytes(path.read_bytes()[:500])

    with pytest.raises(DataError, match="cannot read"):
        read_arrays(path, ["good"])

    for read, folder in (
        (panda.read_panda, panda.FOLDER),
        (ur10e.read_ur10e, ur10e.FOLDER),
    ):
        (tmp_path / folder).mkdir()
        arrays = {
            key: np.zeros((2, 7)) for key in ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
        }
        np.savez(tmp_path / folder / "free_motion.npz", **arrays)
        (tmp_path / folder / "model.json").write_text(json.dumps({"torque": 1}))
        with pytest.raises(DataError, match=r"model\.json lacks"):
            read(tmp_path)
    still = np.zeros((3, 7))
    signals = JointSignals(t_s=np.arange(3.0), q_rad=still, dq_rad_s=None, tau_Nm=still)

    with pytest.raises(DataError, match="needs joint velocities"):
        joint_residual(lwr, signals, 50.0)


def test_annotated_ruptures_are_found_missed_or_invented():
    values = depth_metrics([10.2, 20.4, 33.0], [10.0, 20.3, 32.9], [10.0, 20.0, 30.0])

    assert (values["ruptures_missed"], values["ruptures_false"]) == (1.0, 1.0)
    assert values["rupture_depth_error_mm"] == pytest.approx(0.4)
    assert values["estimated_depth_error_mm"] == pytest.approx(0.3)
    assert depth_metrics([], [], [10.0]) == {
        "ruptures_missed": 1.0,
        "ruptures_false": 0.0,
    }


def test_only_sudden_drops_before_the_end_are_found():
    depth = np.linspace(0.0, 0.08, 16_001)
    force = 20.0 * depth
    force -= 0.4 * np.clip((depth - 0.02) / 1e-3, 0.0, 1.0)
    force -= 0.4 * np.clip((depth - 0.04) / 1e-2, 0.0, 1.0)
    force -= 0.8 * np.clip((depth - 0.079) / 1e-3, 0.0, 1.0)
    (drop,) = force_drops(depth, force)

    assert drop.from_m == pytest.approx(0.02, abs=2e-4)
    assert drop.to_m == pytest.approx(0.021, abs=2e-4)
    assert at_drops([0.0205], [drop]) == at_drops([0.0213], [drop]) == (1, 1)
    assert at_drops([0.019, 0.03], [drop]) == (0, 0)
    assert at_drops([0.019, 0.0201, 0.0205, 0.03], [drop]) == (2, 1)
    assert at_drops([0.0205], []) == at_drops([], [drop]) == (0, 0)
    assert [len(force_drops(depth, force, smallest)) for smallest in (0.3, 0.5)] == [
        1,
        0,
    ]


def test_real_liver_has_a_row_for_every_method(recordings_dir, monkeypatch):
    monkeypatch.setattr(
        "benchmarks.insertion.recorded.liver.NUMBERS", (0, 8, 18, 26, 34)
    )
    by_key = values(liver.run, "liver-real", recordings_dir)

    assert 5.0 < by_key["rule-of-thumb", "pullout_error_median_pct"] < 30.0
    assert ("rule-of-thumb", "ruptures_per_insertion") not in by_key
    assert by_key["ours", "drop_recall"] > 0.5
    assert 0.0 < by_key["ours", "pullout_coverage_42mm"] <= 1.0
    assert 0.0 <= by_key["ours", "friction_above_force_at_rest"] < 0.2
    assert (
        "published-one-setting",
        "pullout_coverage_42mm",
    ) not in by_key  # it states no deviation
    assert np.isfinite(list(by_key.values())).all()


def test_a_line_predicts_a_recording_that_it_was_not_fitted_to():
    """All but the last lie on a line, which it therefore misses."""
    known = np.array([[1.0], [2.0], [3.0], [4.0]])
    truth_N = 0.5 + 0.2 * known
    truth_N[-1] = 2.0

    assert predict_by_line(truth_N, known)[-1] == pytest.approx(0.5 + 0.2 * 4.0)


def test_the_four_ruptures_of_bovine_liver_are_found(recordings_dir):
    by_key = values(bovine.run, "bovine-real", recordings_dir)

    assert by_key["ours", "ruptures_missed"] == 0.0
    assert by_key["ours", "rupture_depth_error_mm"] < 1.0
    # Of what else it reports one is no drop of the curve: the force only flattens.
    assert by_key["ours", "ruptures_without_drop"] <= 1.0
