"""``python -m benchmarks stream``: recordings of any length, time and memory of the commands."""

import sys

import numpy as np
import pytest

from benchmarks.cli import main
from benchmarks import BenchmarkError
from benchmarks.soak import (
    LATE_ROWS,
    LateRows,
    StreamCase,
    StreamSpeed,
    Watched,
    joint_recording,
    late_rows,
    needle_recording,
    watch_process,
)
from identification.log_replay import ReplayStream
from identification.multilayer_config import MULTILAYER
from recordings import write_table


@pytest.mark.parametrize("make", [joint_recording, needle_recording])
def test_a_recording_is_as_long_as_asked_smooth_and_the_same_every_time(make):
    parts = list(make(100.0, np.random.default_rng(0)))
    whole = {name: np.concatenate([part[name] for part in parts]) for name in parts[0]}
    assert len(parts) > 1
    assert len(whole["t_s"]) == 100_000
    np.testing.assert_allclose(np.diff(whole["t_s"]), 0.001)
    moved = whole.get("q_rad", whole.get("depth_m"))
    steps = np.abs(np.diff(moved, axis=0))
    assert steps.max() < 1e-3
    again = next(iter(make(100.0, np.random.default_rng(0))))
    for name, values in again.items():
        np.testing.assert_array_equal(values, parts[0][name])


def test_a_process_is_watched_to_its_end():
    told = []
    watched = watch_process(["-c", "x = bytearray(50_000_000); import time; time.sleep(0.3)"])
    assert watched.wall_s > 0.3
    assert 0.0 < watched.cpu_s < watched.wall_s + 0.1
    if sys.platform == "linux":
        assert watched.peak_MB > 50.0
    watch_process(["-c", "import time; time.sleep(0.2)"], told.append)
    assert told == sorted(told)
    with pytest.raises(BenchmarkError, match="no such thing"):
        watch_process(["-c", "raise SystemExit('no such thing')"])


def test_a_process_that_says_much_does_not_block():
    much = "import sys; sys.stderr.write('x' * 1_000_000)"
    assert watch_process(["-c", much]).wall_s < 20.0


def speed(cpu_s, memory_MB, ruptures=1, skipped=0, rows=200_000):
    return StreamSpeed(
        case=StreamCase(command="residual", suffix=".csv"),
        seconds=100.0,
        rows=rows,
        watched=Watched(wall_s=9.0, cpu_s=cpu_s, memory_MB=memory_MB),
        late=LateRows(ruptures=ruptures, skipped=skipped),
    )


def test_both_targets_count_and_unknown_memory_is_a_miss():
    assert speed(4.9, (100.0,) * 10).is_met
    assert not speed(5.1, (100.0,) * 10).is_met
    assert not speed(4.9, (100.0,) * 9 + (150.0,)).is_met
    assert not speed(4.9, ()).is_met
    assert speed(4.9, (1.0,)).times_real == pytest.approx(100.0 / 4.9)


def test_a_command_that_idles_at_the_end_misses():
    memory = (100.0,) * 10
    assert not speed(4.9, memory, ruptures=0).is_met
    assert speed(4.9, memory, ruptures=0, rows=20_000).is_met
    assert speed(4.9, memory, ruptures=None).is_met
    assert not speed(4.9, memory, skipped=1).is_met


def test_a_long_recording_ruptures_fresh_tissue_in_every_cycle():
    stream, ruptures_s = ReplayStream(MULTILAYER), []
    for columns in needle_recording(230.0, np.random.default_rng(0)):
        estimates = stream.run(**columns).estimates
        assert all(estimate.status.is_absorbed for estimate in estimates)
        ruptures_s += [e.rupture.time_s for e in estimates if e.rupture]
    late_s = 230.0 - LATE_ROWS / 1000.0
    assert len(ruptures_s) >= 3
    assert max(ruptures_s) > late_s


def test_the_end_of_a_table_is_read(tmp_path):
    rows = LATE_ROWS + 5
    early = (np.arange(rows) < 5).astype(float)
    write_table(tmp_path / "a.csv", {"t_s": np.arange(rows), "force_status": 3 * early})
    assert late_rows(tmp_path / "a.csv") == LateRows(ruptures=None, skipped=0)
    late = np.where(np.arange(rows) == rows - 2, 4.0, 0.0)
    columns = {"t_s": np.arange(rows), "absorbed": 1.0 - early, "rupture": late + early}
    write_table(tmp_path / "b.csv", columns)
    assert late_rows(tmp_path / "b.csv") == LateRows(ruptures=1, skipped=0)


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
