"""Benchmarks on real recordings: known-good figures, and broken files."""

import json
import math

import numpy as np
import pytest

from benchmarks.benchmark import Job
from benchmarks import DataError
from benchmarks.methods import joint_residual
from benchmarks.recorded.liver import NUMBERS, read_arrays, read_liver, read_table
from benchmarks.recorded.panda import FOLDER as PANDA
from benchmarks.recorded.panda import read_panda, run_panda_liver, run_panda_real
from benchmarks.recorded.ur10e import FOLDER as UR10E
from benchmarks.recorded.ur10e import read_ur10e, run_ur10e_payload
from benchmarks.runner import run_job
from benchmarks.signals import JointSignals


def values(run, benchmark, data, **more):
    job = Job(benchmark=benchmark, plant="recording", data=data, **more)
    return {
        (item.method, item.metric): item.value for item in run(job, lambda share: None).measurements
    }


def test_the_pandas_residual_is_as_small_as_known(recordings_dir):
    found = values(run_panda_real, "panda-real", recordings_dir)
    known = (0.37, 0.76, 0.37, 0.39, 0.14, 0.10, 0.06)
    reached = [found["default", f"residual_rms_J{joint}_Nm"] for joint in range(1, 8)]
    assert [math.floor(100.0 * value) / 100.0 for value in reached] == pytest.approx(known)


def test_a_liver_force_is_found_again_in_the_pandas_torques(recordings_dir, tmp_path):
    found = values(run_panda_liver, "panda-liver", recordings_dir, drawings=tmp_path)
    assert found["default", "wrench_rmse_N"] < 0.1 * found["published", "wrench_rmse_N"]
    # Turned round, the force would be off by twice its mean of 1.4 N.
    assert abs(found["default", "wrench_bias_N"]) < 0.5
    assert list(tmp_path.glob("panda-liver-recording-0-*.svg"))


def test_the_whole_chain_runs_on_real_torques_with_real_tissue(recordings_dir):
    job = Job(benchmark="panda-liver", plant="recording", data=recordings_dir, seed=1)
    found = {
        (item.source, item.method, item.metric): item.value
        for item in run_panda_liver(job, lambda share: None).measurements
    }
    names = {name for source, _, name in found if source == "ft"}
    assert {"pullout_error_42mm_median_pct", "pullout_error_78mm_median_pct"} < names
    assert {"fall_recall", "ruptures_at_falls", "ruptures_per_insertion"} < names
    # The force itself at the arm's uneven clock: as in liver-real.
    assert found["ft", "default", "fall_recall"] == 1.0
    assert found["ft", "default", "ruptures_at_falls"] > 0.8
    # Its falls are smaller than this arm's noise: what matters is that noise raises few alarms.
    assert found["virtual", "default", "ruptures_per_insertion"] <= 3.0
    off = "enhanced_against_ft_rmse_N"
    assert found["virtual", "default", off] < 0.3 * found["virtual", "published", off]
    assert np.isfinite(list(found.values())).all()


def test_the_weight_on_the_ur10e_is_found(recordings_dir):
    found = values(run_ur10e_payload, "ur10e-payload", recordings_dir)
    assert found["default", "force_up_unloaded_N"] == pytest.approx(-1.7, abs=1.0)
    assert found["default", "force_up_loaded_N"] == pytest.approx(-25.3, abs=1.5)
    assert 1.05 < found["default", "torque_scale"] < 1.2
    assert abs(found["default", "weight_error_pct"]) < 10.0


def test_every_liver_insertion_begins_at_rest_without_force(recordings_dir):
    for index in (0, len(NUMBERS) - 1):
        insertion = read_liver(recordings_dir, index)
        assert insertion.depth_m[0] < 1e-3
        assert abs(insertion.force_N[0]) < 0.1
        assert insertion.force_N.max() > 1.0


@pytest.mark.parametrize("index", [-1, len(NUMBERS)])
def test_there_are_no_more_liver_insertions(tmp_path, index):
    with pytest.raises(DataError, match="19 liver insertions"):
        read_liver(tmp_path, index)


@pytest.mark.parametrize("name", ["panda-real", "panda-liver", "ur10e-payload"])
def test_an_empty_folder_fails_the_job_in_one_line(tmp_path, name):
    outcome = run_job(Job(benchmark=name, plant="recording", data=tmp_path), lambda share: None)
    assert outcome.rows == ()
    assert outcome.failure is not None
    assert outcome.failure.startswith("DataError: cannot read ")
    assert "\n" not in outcome.failure


def test_a_job_without_a_folder_says_what_to_give():
    outcome = run_job(Job(benchmark="panda-real", plant="recording"), lambda share: None)
    assert outcome.failure == "DataError: panda-real needs recordings: give --data DIR"


def test_arrays_that_cannot_be_used_are_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, good=np.ones(3), empty=np.zeros(0), bad=np.array([1.0, np.nan]))
    assert read_arrays(path, ["good"])[0].tolist() == [1.0, 1.0, 1.0]
    with pytest.raises(DataError, match=r"lacks t_s; it has good, empty, bad"):
        read_arrays(path, ["t_s", "good"])
    with pytest.raises(DataError, match="empty or has values"):
        read_arrays(path, ["empty"])
    with pytest.raises(DataError, match="not finite"):
        read_arrays(path, ["bad"])


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04 torn off", b"no archive at all"])
def test_a_broken_archive_is_refused(tmp_path, content):
    path = tmp_path / "a.npz"
    path.write_bytes(content)
    with pytest.raises(DataError, match="cannot read"):
        read_arrays(path, ["t_s"])


def test_a_truncated_archive_is_refused(tmp_path):
    path = tmp_path / "a.npz"
    np.savez(path, t_s=np.arange(1000.0))
    path.write_bytes(path.read_bytes()[:500])
    with pytest.raises(DataError, match="cannot read"):
        read_arrays(path, ["t_s"])


@pytest.mark.parametrize(("content", "told"), [("{", "cannot read"), ("[1]", "no table")])
def test_a_broken_table_is_refused(tmp_path, content, told):
    path = tmp_path / "model.json"
    path.write_text(content)
    with pytest.raises(DataError, match=told):
        read_table(path)


@pytest.mark.parametrize(
    ("read", "folder", "arrays"),
    [
        (read_panda, PANDA, {"free_motion.npz": ("t_s", "q_rad", "dq_rad_s", "tau_Nm")}),
        (read_ur10e, UR10E, {}),
    ],
)
def test_a_model_that_lacks_a_table_is_refused(tmp_path, read, folder, arrays):
    (tmp_path / folder).mkdir()
    for name, keys in arrays.items():
        np.savez(tmp_path / folder / name, **{key: np.zeros((2, 7)) for key in keys})
    (tmp_path / folder / "model.json").write_text(json.dumps({"torque": 1}))
    with pytest.raises(DataError, match=r"model\.json lacks"):
        read(tmp_path)


def test_a_plain_observer_refuses_signals_without_velocities(lwr):
    signals = JointSignals(
        t_s=np.arange(3.0), q_rad=np.zeros((3, 7)), dq_rad_s=None, tau_Nm=np.zeros((3, 7))
    )
    with pytest.raises(DataError, match="needs joint velocities"):
        joint_residual(lwr, signals, 50.0)
