"""`needleforce simulate`: a simulated insertion as a recording, and the commands
after it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from groundtruth import SCENARIOS
from needleforce.cli import main
from needleforce.cli.logs import simulated_log as command
from needleforce.recordings import read_log, read_table
from needleforce.simulation import truth_table
from tests.insertion_run import cut, short_run
from tests.needleforce.cli.residual_command_log import refusal

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
def quick(run, monkeypatch, tmp_path):
    """The command with the simulation done already, in an empty folder."""
    asked = []

    def simulated(chosen, *, plant, seed):
        asked.append((chosen.id, plant, seed))
        return run

    monkeypatch.setattr(command, "simulate", simulated)
    monkeypatch.chdir(tmp_path)
    return asked


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".mcap"])
def test_every_format_passes_both_commands_without_options(quick, capsys, suffix, run):
    assert main(["simulate", ID, "-o", f"x{suffix}"]) == 0
    assert quick == [(ID, "clean", 0)]

    printed = capsys.readouterr().out

    assert "without contact until 13 s" in printed
    assert f"needleforce force x{suffix} --tare 0:13 -o forces{suffix}" in printed
    assert main(["force", f"x{suffix}", "--tare", "0:13", "-o", f"forces{suffix}"]) == 0

    capsys.readouterr()

    assert main(["identify", f"forces{suffix}"]) == 0

    out, err = capsys.readouterr()
    layers, _, channels = out.partition("\n\n")
    _, row, zero = layers.splitlines()
    layer = row.split()
    true = run.truth.ruptures[0]

    assert float(layer[3]) == pytest.approx(true.onset_s, abs=0.1)

    friction_N, std_N = map(float, layer[7].split("±"))

    assert friction_N == pytest.approx(true.layer_friction_N, abs=2.0 * std_N)
    assert std_N < 0.25 * friction_N
    assert zero.startswith("Depths are below first contact")
    assert "--ignore-status takes them" in err
    assert len(err.splitlines()) == 1
    assert len(channels.splitlines()) == 7


@pytest.mark.slow
def test_recording_holds_the_robots_signals_alone(quick, run):
    assert main(["simulate", ID, "-o", "x.mcap"]) == 0

    log = read_log("x.mcap", required=["q", "tau"], optional=["dq"])

    np.testing.assert_array_equal(log["q_rad"], run.signals.q_rad)
    np.testing.assert_array_equal(log["tau_Nm"], run.signals.tau_Nm)
    np.testing.assert_allclose(log.t_s, run.signals.t_s, atol=5e-10, rtol=0)

    table = read_table("x.mcap")

    assert set(table.columns) == {
        "t_s",
        *(f"/joint_states/{field}" for field in ("position", "velocity", "effort")),
        *(f"/ft_sensor/wrench/{field}_xyz" for field in ("force", "torque")),
    }
    assert table.joint_names["/joint_states/effort"] == run.robot.joint_names

    wrench = np.hstack(
        [table.columns[f"/ft_sensor/wrench/{f}_xyz"] for f in ("force", "torque")]
    )

    np.testing.assert_array_equal(wrench, run.signals.ft_wrench)


def test_ground_truth_has_its_own_file(quick, run):
    assert main(["simulate", ID, "--truth", "truth.npz"]) == 0

    columns = read_table("truth.npz").columns

    np.testing.assert_array_equal(columns["axial_N"], run.truth.axial_N)
    np.testing.assert_array_equal(
        columns["layer_friction_N"], run.truth.layer_friction_N
    )

    (row,) = np.flatnonzero(columns["rupture"])

    assert columns["t_s"][row] == pytest.approx(run.truth.rupture_s[0], abs=2e-3)
    assert columns["rupture"][row] == 1.0

    log = read_log("truth.npz", required=["depth", "speed", "force"])

    np.testing.assert_array_equal(log["force_N"], run.truth.axial_N)


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


def test_options_reach_the_simulation(quick):
    for text in (
        "stack-constant --plant degraded --seed 5",
        "random-stack --plant ideal",
    ):
        name = f"{text.split()[0]}.npz"
        assert main(["simulate", *text.split(), "-o", name]) == 0
    assert quick == [("stack-constant", "degraded", 5), ("random-stack", "ideal", 0)]


def test_list_names_every_scenario(capsys):
    assert main(["simulate", "--list"]) == 0

    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]

    assert listed == [*SCENARIOS, "random-stack", "random-tissue"]


@pytest.mark.parametrize(
    ("options", "said"),
    [
        (ID, "nothing to write, expected -o FILE or --truth FILE"),
        ("-o x.csv", "no scenario is named; --list prints the scenarios"),
        ("gel-26 -o x.csv", "no scenario 'gel-26'; known: gel-25-constant"),
        (f"{ID} -o x.xyz", "x.xyz"),
        (f"{ID} -o x.csv --seed -1", "expected a whole number from 0 up"),
        (f"{ID} -o x.csv --truth hard.csv", "--truth"),
    ],
)
def test_bad_requests_are_one_line_before_simulation(quick, capsys, options, said):
    if "hard.csv" in options:
        Path("x.csv").touch()
        Path("hard.csv").hardlink_to("x.csv")

    assert said in refusal(["simulate", *options.split()], capsys)
    assert quick == []


def test_missing_mujoco_is_named_with_its_package(capsys, monkeypatch, tmp_path):
    monkeypatch.setattr("groundtruth.arm_plant.mujoco", None)
    message = refusal(
        ["simulate", "free-motion", "-o", str(tmp_path / "x.csv")], capsys
    )

    assert message.startswith("error: the simulated arm needs")
    assert "mujoco" in message
    assert "pip install" in message


@pytest.mark.parametrize("option", ["-o", "--truth"])
def test_a_file_that_is_there_is_replaced_only_if_asked(quick, option, capsys):
    Path("x.csv").write_text("measured once")

    assert main(["simulate", ID, option, "x.csv"]) == 2
    assert "x.csv exists" in capsys.readouterr().err
    assert quick == []
    assert Path("x.csv").read_text() == "measured once"

    assert main(["simulate", ID, option, "x.csv", "--overwrite"]) == 0
    assert len(read_log("x.csv")) > 1000
