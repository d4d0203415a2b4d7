"""`needleforce simulate`: a simulated insertion as a recording, and the commands
after it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundtruth import SCENARIOS
from needleforce.cli import main
from needleforce.recordings import read_log, read_table
from needleforce.simulation import truth_table
from tests.insertion_run import cut, short_run

ID = "gel-25-constant"


@pytest.fixture(scope="module")
def run():
    """One simulated insertion at 500 Hz, without its withdrawal, for all tests."""
    whole = short_run()
    rows = slice(None, None, 2)
    return replace(
        whole, signals=cut(whole.signals, rows), truth=cut(whole.truth, rows)
    )


@pytest.fixture
def asked(run, monkeypatch, tmp_path):
    """What is asked of the simulation, which has been done already; an empty folder."""
    asked = []

    def simulated(chosen, *, plant, seed):
        asked.append((chosen.id, plant, seed))
        return run

    monkeypatch.setattr("needleforce.cli.logs.simulated_log.simulate", simulated)
    monkeypatch.chdir(tmp_path)
    return asked


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".mcap"])
def test_every_format_passes_both_commands_without_options(asked, capsys, suffix, run):
    assert main(["simulate", ID, "-o", f"x{suffix}"]) == 0
    assert asked == [(ID, "clean", 0)]

    next_command = capsys.readouterr().out.splitlines()[-1]
    words = next_command.removeprefix("next: needleforce ").split()

    assert words[:-1] == ["force", f"x{suffix}", "--tare", "0:13", "-o"]
    assert main(words) == 0

    capsys.readouterr()

    assert main(["identify", words[-1]]) == 0

    out, err = capsys.readouterr()
    layer = out.splitlines()[1].split()
    true = run.truth.ruptures[0]
    friction_N, std_N = map(float, layer[7].split("±"))

    assert float(layer[3]) == pytest.approx(true.onset_s, abs=0.1)
    assert friction_N == pytest.approx(true.layer_friction_N, abs=2.0 * std_N)
    assert std_N < 0.25 * friction_N
    assert len(err.splitlines()) == 1  # the rows before the tare


@pytest.mark.slow
def test_recording_holds_the_robots_signals_alone(asked, run):
    assert main(["simulate", ID, "-o", "x.mcap"]) == 0

    table = read_table("x.mcap")
    signals = run.signals
    expected = {
        "/joint_states/position": signals.q_rad,
        "/joint_states/velocity": signals.dq_rad_s,
        "/joint_states/effort": signals.tau_Nm,
        "/ft_sensor/wrench/force_xyz": signals.ft_wrench[:, :3],
        "/ft_sensor/wrench/torque_xyz": signals.ft_wrench[:, 3:],
    }

    assert table.columns.keys() == expected.keys()
    assert table.joint_names["/joint_states/effort"] == run.robot.joint_names
    for name, values in expected.items():
        np.testing.assert_array_equal(table.columns[name], values)
    np.testing.assert_allclose(read_log("x.mcap").t_s, signals.t_s, atol=5e-10, rtol=0)


def test_ground_truth_has_its_own_file(asked, run):
    assert main(["simulate", ID, "--truth", "truth.npz"]) == 0

    columns = read_table("truth.npz").columns
    (row,) = np.flatnonzero(columns["rupture"])

    np.testing.assert_array_equal(columns["axial_N"], run.truth.axial_N)
    assert (columns["t_s"][row], columns["rupture"][row]) == (
        *(pytest.approx(run.truth.rupture_s[0], abs=2e-3), 1.0),
    )
    assert read_log("truth.npz", required=["depth", "speed", "force"])


@pytest.mark.slow
def test_a_needle_without_an_arm_is_depth_and_force(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    outputs = ["-o", "needle.csv", "--truth", "truth.csv"]

    assert main(["simulate", ID, "--plant", "needle", *outputs]) == 0
    assert "next: needleforce identify needle.csv" in capsys.readouterr().out

    columns = read_table("needle.csv").columns
    truth = read_table("truth.csv").columns

    assert list(columns) == ["t_s", "depth_m", "force_N"]
    assert np.std(columns["force_N"] - truth["axial_N"]) < 0.02
    assert np.flatnonzero(truth["rupture"]).size == 1
    assert np.max(truth["layer_friction_N_1"]) == pytest.approx(0.26, abs=0.02)


def test_surface_rupture_is_marked_and_none_hides_another(run):
    first = run.truth.ruptures[0]
    together = tuple(replace(first, layer=number) for number in (0, 1, 2))
    truth = replace(run.truth, ruptures=together)
    columns = truth_table(replace(run, truth=truth))

    assert columns["rupture"][columns["rupture"] > 0].tolist() == [1, 2]
    assert np.count_nonzero(columns["surface_rupture"]) == 1


def test_options_reach_the_simulation(asked):
    options = ["--plant", "degraded", "--seed", "5", "-o", "x.npz"]

    assert main(["simulate", "stack-constant", *options]) == 0
    assert main(["simulate", "random-stack", "--plant", "fri", "-o", "y.npz"]) == 0
    assert asked == [("stack-constant", "degraded", 5), ("random-stack", "fri", 0)]


def test_list_names_every_scenario(capsys):
    assert main(["simulate", "--list"]) == 0

    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]

    assert listed == [*SCENARIOS, "random-stack", "random-tissue"]


@pytest.mark.parametrize("option", ["-o", "--truth"])
def test_a_file_that_is_there_is_replaced_only_if_asked(asked, option):
    Path("x.csv").write_text("measured once")

    assert main(["simulate", ID, option, "x.csv"]) == 2
    assert asked == []
    assert Path("x.csv").read_text() == "measured once"
    assert main(["simulate", ID, option, "x.csv", "--overwrite"]) == 0
    assert len(read_log("x.csv")) > 1000
