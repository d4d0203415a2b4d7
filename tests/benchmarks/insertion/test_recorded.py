"""Benchmarks on real recordings: known-good figures, broken files."""

import json
import math

import numpy as np
import pytest

from benchmarks import DataError
from benchmarks.campaign import run_job
from benchmarks.insertion.methods import joint_residual
from benchmarks.insertion.recorded import panda, ur10e
from benchmarks.insertion.recorded.bovine import depth_metrics
from benchmarks.insertion.recorded.liver import at_drops, force_drops, read_arrays
from benchmarks.insertion.signals import JointSignals
from benchmarks.jobs import Job


def values(benchmark, data, seed=0):
    result = run_job(Job(benchmark=benchmark, plant="recording", data=data, seed=seed))

    assert not result.failure

    rows = result.rows.set_index(["source", "method", "metric"])
    return rows["value"].to_dict()


def test_the_pandas_residual_is_as_small_as_known(recordings_dir):
    numbers = values("panda-real", recordings_dir)
    reached = [
        numbers["virtual", "ours", f"residual_rms_J{joint}_Nm"] for joint in range(1, 8)
    ]
    floors = [math.floor(100.0 * value) / 100.0 for value in reached]

    assert floors == pytest.approx([0.37, 0.76, 0.37, 0.39, 0.14, 0.10, 0.06])


@pytest.mark.slow
def test_the_chain_runs_on_real_torques_and_tissue(recordings_dir):
    numbers = values("panda-liver", recordings_dir, seed=1)
    ours_N = numbers["virtual", "ours", "wrench_rmse_N"]

    assert ours_N < 0.1 * numbers["virtual", "published-one-setting", "wrench_rmse_N"]
    # Turned round, the force would be off by twice its mean of 1.4 N.
    assert abs(numbers["virtual", "ours", "wrench_bias_N"]) < 1.0
    assert numbers["ft", "ours", "drop_recall"] == 1.0
    assert numbers["ft", "ours", "ruptures_at_drops"] > 0.8
    assert numbers["virtual", "ours", "ruptures_per_insertion"] <= 3.0


def test_the_weight_on_the_ur10e_is_found(recordings_dir):
    numbers = values("ur10e-payload", recordings_dir)

    assert numbers["virtual", "ours", "force_up_unloaded_N"] == pytest.approx(
        -1.7, abs=1
    )
    assert numbers["virtual", "ours", "force_up_loaded_N"] == pytest.approx(
        -25.3, abs=1.5
    )
    assert 1.05 < numbers["virtual", "ours", "torque_scale"] < 1.2
    assert abs(numbers["virtual", "ours", "weight_error_pct"]) < 10.0


@pytest.mark.slow
def test_real_liver_has_a_row_for_every_method(recordings_dir, monkeypatch):
    monkeypatch.setattr("benchmarks.insertion.recorded.liver.NUMBERS", (0, 18, 34))
    numbers = values("liver-real", recordings_dir)

    assert 5.0 < numbers["ft", "rule-of-thumb", "pullout_error_median_pct"] < 30.0
    assert ("ft", "rule-of-thumb", "ruptures_per_insertion") not in numbers
    assert numbers["ft", "ours", "drop_recall"] > 0.5
    assert 0.0 < numbers["ft", "ours", "pullout_coverage_42mm"] <= 1.0


def test_the_four_ruptures_of_bovine_liver_are_found(recordings_dir):
    numbers = values("bovine-real", recordings_dir)

    assert numbers["ft", "ours", "ruptures_missed"] == 0.0
    assert numbers["ft", "ours", "rupture_depth_error_mm"] < 1.0


@pytest.mark.parametrize("name", ["panda-real", "panda-liver", "ur10e-payload"])
def test_an_empty_folder_fails_in_one_line(tmp_path, name):
    failure = run_job(Job(benchmark=name, plant="recording", data=tmp_path)).failure

    assert failure.startswith("DataError: cannot read ")
    assert "\n" not in failure


def test_broken_recordings_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, good=np.ones(3), empty=np.zeros(0), bad=np.array([1.0, np.nan]))

    assert read_arrays(path, ["good"])[0].tolist() == [1.0, 1.0, 1.0]

    for names, word in (
        (["t_s", "good"], "t_s"),
        (["empty"], "empty"),
        (["bad"], "bad"),
    ):
        with pytest.raises(DataError, match=word):
            read_arrays(path, names)
    path.write_bytes(path.read_bytes()[:500])

    with pytest.raises(DataError, match=path.name):
        read_arrays(path, ["good"])


@pytest.mark.parametrize(
    ("read", "folder"),
    [(panda.read_panda, panda.FOLDER), (ur10e.read_ur10e, ur10e.FOLDER)],
)
def test_a_model_that_lacks_something_is_refused(read, folder, tmp_path):
    (tmp_path / folder).mkdir()
    names = ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    np.savez(
        tmp_path / folder / "free_motion.npz", **{n: np.zeros((2, 7)) for n in names}
    )
    (tmp_path / folder / "model.json").write_text(json.dumps({"torque": 1}))

    with pytest.raises(DataError, match=r"model\.json"):
        read(tmp_path)


def test_a_plain_observer_needs_velocities(lwr):
    still = np.zeros((3, 7))
    signals = JointSignals(t_s=np.arange(3.0), q_rad=still, dq_rad_s=None, tau_Nm=still)

    with pytest.raises(DataError, match="velocities"):
        joint_residual(lwr, signals, 50.0)


def test_annotated_ruptures_are_found_missed_or_invented():
    numbers = depth_metrics([10.2, 20.4, 33.0], [10.0, 20.3, 32.9], [10.0, 20.0, 30.0])

    assert (numbers["ruptures_missed"], numbers["ruptures_false"]) == (1.0, 1.0)
    assert numbers["rupture_depth_error_mm"] == pytest.approx(0.4)
    assert numbers["estimated_depth_error_mm"] == pytest.approx(0.3)
    assert depth_metrics([], [], [10.0]) == {
        "ruptures_missed": 1.0,
        "ruptures_false": 0.0,
    }


def test_only_sudden_drops_before_the_end_are_found():
    depth_m = np.linspace(0.0, 0.08, 16_001)
    force_N = 20.0 * depth_m
    for at_m, travel_m, drop_N in (
        (0.02, 1e-3, 0.4),
        (0.04, 1e-2, 0.4),
        (0.079, 1e-3, 0.8),
    ):
        force_N -= drop_N * np.clip((depth_m - at_m) / travel_m, 0.0, 1.0)
    (drop,) = force_drops(depth_m, force_N)

    assert drop.from_m == pytest.approx(0.02, abs=2e-4)
    assert drop.to_m == pytest.approx(0.021, abs=2e-4)
    assert at_drops([0.019, 0.0201, 0.0205, 0.0213, 0.03], [drop]) == (3, 1)
    assert at_drops([0.0205], []) == at_drops([], [drop]) == (0, 0)
    assert [len(force_drops(depth_m, force_N, least)) for least in (0.3, 0.5)] == [1, 0]
