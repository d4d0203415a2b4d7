"""`python -m residual LOG`: the forces it writes are those that were put into the log."""

import subprocess
import sys

import numpy as np
import pinocchio as pin
import pytest
from residual_command_log import AXIAL_N, CONTACT_S, SMALL_ARM, insertion, write_insertion

from needleforce.cli.force import main
from recordings import read_log, read_table, write_table
from residual import SensorWarning
from urdf import load_urdf

TARE = ["--tare", "0:2.5"]


@pytest.fixture(scope="module")
def log(lwr, tmp_path_factory):
    return str(write_insertion(tmp_path_factory.mktemp("log") / "insertion.csv", lwr))


@pytest.fixture
def run(tmp_path, capsys):
    """Run the command with an output file; return its columns and what it printed."""

    def run(*argv, name="forces.csv"):
        path = tmp_path / name
        code = main([*argv, "-o", str(path)])
        printed = capsys.readouterr()
        assert code == 0, printed.err
        return read_table(path).columns, printed.out

    return run


def settled_contact(columns):
    start_s = columns["t_s"][0]
    return columns["t_s"] > start_s + CONTACT_S + 0.3


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--mode", "point"],
        ["--mode", "full", "--alignment", "trapezoid"],
        ["--gain", "30"],
        ["--external-torque"],
    ],
    ids=" ".join,
)
def test_axial_force_is_the_true_one_with_its_standard_deviation(log, run, options):
    columns, _ = run(log, *TARE, *options)
    contact = settled_contact(columns)
    error = columns["axial_N"][contact] - AXIAL_N
    assert np.abs(error).max() < 0.15
    assert abs(error.mean()) < 0.05
    std = columns["axial_std_N"][contact]
    assert (std > 0.0).all()
    assert np.mean(np.abs(error) < 3.0 * std) > 0.95
    free = (columns["t_s"] > 2.6) & (columns["t_s"] < CONTACT_S)
    assert np.abs(columns["axial_N"][free]).max() < 0.1


def test_the_paper_and_a_log_without_velocity_find_the_force_too(log, run, lwr, tmp_path):
    columns, printed = run(log, *TARE, "--paper")
    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.2)
    assert "K = 5 1/s" in printed
    bare = write_insertion(tmp_path / "bare.npz", lwr, only=("t_s", "q_rad", "tau_Nm"))
    columns, printed = run(str(bare), *TARE)
    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.1)
    assert "velocity estimated" in printed


def test_rows_and_times_are_those_of_the_log(log, run):
    columns, _ = run(log, *TARE, name="forces.npz")
    np.testing.assert_array_equal(columns["t_s"], read_log(log).t_s)
    status = columns["force_status"]
    assert status[0] == 2
    assert set(status[columns["t_s"] > 2.5]) == {0}
    assert 1 in status[columns["t_s"] < 2.5]


@pytest.mark.parametrize(("mode", "components"), [("axial", 3), ("point", 6), ("full", 12)])
def test_every_column_says_its_unit_and_the_vector_agrees_with_the_axial_force(
    log, run, mode, components
):
    columns, _ = run(log, *TARE, "--mode", mode)
    assert len(columns) == 7 + components
    plain = ("model_mismatch", "force_warnings", "force_status")
    for name in columns:
        assert name in plain or name.rsplit("_", 1)[1] in ("s", "m", "N", "Nm"), name
    force = np.stack([columns[f"force_{xyz}_in_base_N"] for xyz in "xyz"], axis=1)
    assert np.linalg.norm(force[-1]) == pytest.approx(AXIAL_N, abs=0.2)


def test_travel_is_that_of_the_tip(run, lwr, tmp_path):
    columns = insertion(lwr, seconds=0.6)
    path = tmp_path / "log.npz"
    write_table(path, columns)
    found, _ = run(str(path), "--no-tare")
    data = lwr.create_data()

    def tip(k):
        pin.forwardKinematics(lwr.model, data, columns["q_rad"][k])
        return pin.updateFramePlacement(lwr.model, data, lwr.tool_frame_id).copy()

    expected = tip(0).rotation[:, 2] @ (tip(-1).translation - tip(0).translation)
    assert found["travel_m"][-1] == pytest.approx(expected, abs=1e-12)
    assert found["travel_m"][0] == 0.0


def test_a_choice_is_made_and_told_when_none_was_given(log, run):
    columns, printed = run(log)
    (line,) = [line for line in printed.splitlines() if line.startswith("tare")]
    start_s, end_s = float(line.split()[1]), float(line.split()[3])
    assert end_s - start_s == pytest.approx(2.0)
    assert columns["force_status"][columns["t_s"] > end_s].max() == 0
    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)


def test_without_a_tare_no_row_claims_to_be_tared(log, run):
    columns, printed = run(log, "--no-tare")
    assert 0 not in columns["force_status"]
    assert "tare         none" in printed


def test_a_tare_may_be_counted_from_the_first_stamp_or_end_with_the_log(run, lwr, tmp_path):
    path = str(write_insertion(tmp_path / "late.npz", lwr, start_s=1000.0))
    relative, _ = run(path, "--tare", "+0:+2.5")
    absolute, _ = run(path, "--tare", ":1002.5")
    np.testing.assert_array_equal(relative["axial_N"], absolute["axial_N"])
    assert relative["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)
    calm = str(write_insertion(tmp_path / "calm.npz", lwr, seconds=2.0, contact_s=9.0))
    columns, printed = run(calm, "--tare", "+0.6:1.999")
    assert columns["force_status"].max() == 2
    assert "0.6 to 1.999 s" in printed
    late = str(write_insertion(tmp_path / "epoch.npz", lwr, start_s=1.7e9))
    assert "1700000000.000 to 1700000002.500 s" in run(late, "--tare", "+0:+2.5")[1]


def test_contact_can_be_tared_away_only_by_force(run, lwr, tmp_path, capsys):
    path = str(write_insertion(tmp_path / "early.npz", lwr, contact_s=1.0))
    assert main([path, *TARE]) == 2
    assert "--force-tare" in capsys.readouterr().err
    run(path, *TARE, "--force-tare")


def test_bad_rows_are_skipped_counted_and_leave_the_rest_right(run, lwr, tmp_path):
    columns = insertion(lwr)
    columns["q_rad"][2000:2010, 2] = np.nan
    columns["tau_Nm"][3300] = np.inf
    columns["t_s"][1500] = columns["t_s"][1490]
    keep = np.r_[0:2600, 2750:4000]
    path = tmp_path / "broken.npz"
    write_table(path, {name: values[keep] for name, values in columns.items()})
    found, printed = run(str(path), *TARE)
    skipped = np.flatnonzero(found["force_status"] == 3)
    np.testing.assert_array_equal(skipped, [1500, *range(2000, 2010), 3150])
    assert np.isnan(found["axial_N"][skipped]).all()
    sound = found["force_status"] != 3
    assert np.isfinite(np.stack([found[n][sound] for n in found])).all()
    assert found["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)
    assert "12: 10 x q is not finite" in printed
    assert "1 x time does not advance" in printed
    assert "1 longer than 0.1 s (longest 0.151 s)" in printed


def test_what_may_be_wrong_beyond_the_standard_deviation_is_told(run, lwr, tmp_path):
    columns = insertion(lwr)
    columns["tau_Nm"][3500, 2] += 80.0
    columns["tau_Nm"][3700:3800, 1] = lwr.effort_limit_Nm[1]
    write_table(tmp_path / "log.npz", columns)
    found, printed = run(str(tmp_path / "log.npz"), *TARE)
    warnings = found["force_warnings"].astype(int)
    assert warnings[3500] & SensorWarning.SPIKE
    assert found["force_status"][3500] == 3
    assert (warnings[3710:3800] & SensorWarning.SATURATED).all()
    assert not warnings[:3000].any()
    assert "x saturated" in printed
    assert 0.3 < np.median(found["model_mismatch"][found["force_status"] == 0]) < 3.0
    assert found["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.2)


def test_any_urdf_with_locked_joints_gives_forces(run, tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(SMALL_ARM)
    arm = load_urdf(urdf, tool_frame="tip", locked_joints={"gripper": 0.02})
    path = str(write_insertion(tmp_path / "arm.npz", arm, axial_N=3.0))
    robot = ["--urdf", str(urdf), "--tool-frame", "tip", "--lock", "gripper=0.02"]
    columns, printed = run(path, *robot, *TARE)
    assert "arm, 2 joints, payload 0 kg" in printed
    assert np.isfinite(columns["axial_N"]).all()


def test_a_payload_that_the_model_lacks_reads_as_its_weight_downward(log, run, tmp_path):
    light = tmp_path / "light.toml"
    light.write_text("[needle]\nsensor_mass_kg = 0.0\n")
    options = ("--no-tare", "--mode", "full")
    right, printed = run(log, *options)
    lacking, printed_lacking = run(log, *options, "--payload", str(light))
    weight_N = (right["force_z_in_base_N"] - lacking["force_z_in_base_N"])[1500]
    assert weight_N == pytest.approx(0.236 * 9.80665, abs=0.2)
    assert "payload 0.304 kg" in printed
    assert "payload 0.068 kg" in printed_lacking


def test_the_command_runs_as_a_module_and_explains_itself(log):
    command = [sys.executable, "-m", "residual"]
    done = subprocess.run([*command, log, *TARE], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    labels = [line.split("  ")[0] for line in done.stdout.splitlines()]
    expected = ["robot", "sensor", "samples", "skipped", "gaps", "warnings"]
    expected += ["tare", "axial force", "lag"]
    assert labels == expected
    told = subprocess.run([*command, "--help"], capture_output=True, text=True, check=True).stdout
    assert "first 2 s of the log" in told
    assert "--tau_ext" in told


def test_a_clock_that_was_set_back_costs_a_few_rows_and_no_more(run, lwr, tmp_path):
    columns = insertion(lwr)
    columns["t_s"] = columns["t_s"].copy()
    columns["t_s"][2600:] -= columns["t_s"][2600]
    path = tmp_path / "reset.npz"
    write_table(path, columns)
    found, _ = run(str(path), *TARE)
    skipped = np.flatnonzero(found["force_status"] == 3)
    assert 2600 in skipped
    assert 3 <= len(skipped) <= 110
    np.testing.assert_array_equal(found["t_s"], columns["t_s"])
    assert found["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)
