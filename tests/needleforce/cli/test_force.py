"""`needleforce force`: the forces it writes are those that were put into the log."""

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import read_log, read_table, write_table
from residual import SensorWarning
from tests.needleforce.cli.residual_command_log import (
    AXIAL_N,
    CONTACT_S,
    SMALL_ARM,
    insertion,
    refusal,
    write_insertion,
)
from tests.residual.residual_signals import pose_of
from urdf import load_urdf

TARE = ["--tare", "0:2.5"]


@pytest.fixture(scope="module")
def log(lwr, tmp_path_factory):
    return str(write_insertion(tmp_path_factory.mktemp("log") / "insertion.csv", lwr))


@pytest.fixture
def run(tmp_path, capsys):
    """Run the command on a log or its columns; return the columns of forces and the
    summary."""

    def run(log, *argv):
        if isinstance(log, dict):
            write_table(tmp_path / "log.npz", log)
            log = str(tmp_path / "log.npz")
        path = tmp_path / "forces.csv"
        code = main(["force", log, *argv, "-o", str(path)])
        printed = capsys.readouterr()
        assert code == 0, printed.err
        return read_table(path).columns, printed.out

    return run


@pytest.mark.slow
@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--mode", "point"],
        ["--mode", "full", "--alignment", "trapezoid", "--gain", "30"],
        ["--external-torque"],
        ["--insertion-axis", "0", "0", "2"],
    ],
    ids=" ".join,
)
def test_axial_force_matches_truth_within_its_std(log, run, options):
    columns, _ = run(log, *TARE, *options)
    contact = columns["t_s"] > CONTACT_S + 0.3
    error = columns["axial_N"][contact] - AXIAL_N

    assert np.abs(error).max() < 0.15
    assert abs(error.mean()) < 0.05

    std = columns["axial_std_N"][contact]

    assert (std > 0.0).all()
    assert np.mean(np.abs(error) < 3.0 * std) > 0.95

    free = (columns["t_s"] > 2.6) & (columns["t_s"] < CONTACT_S)

    assert np.abs(columns["axial_N"][free]).max() < 0.1


@pytest.mark.slow
def test_published_method_and_missing_velocity_find_the_force(log, run, lwr):
    columns, printed = run(log, *TARE, "--published")

    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.2)
    assert "K = 5 1/s" in printed

    columns = insertion(lwr)
    columns, printed = run(
        {name: columns[name] for name in ("t_s", "q_rad", "tau_Nm")}, *TARE
    )

    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.1)
    assert "velocity estimated" in printed


@pytest.mark.slow
@pytest.mark.parametrize(
    ("mode", "components"), [("axial", 3), ("point", 6), ("full", 12)]
)
def test_columns_name_units_and_travel_is_true(log, run, lwr, mode, components):
    columns, _ = run(log, *TARE, "--mode", mode)

    assert len(columns) == 9 + components

    plain = ("model_mismatch", "force_warnings", "force_status")
    for name in columns:
        assert name in plain or name.rsplit("_", 1)[1] in ("s", "m", "N", "Nm"), name
    force = np.stack([columns[f"force_{xyz}_in_base_N"] for xyz in "xyz"], axis=1)

    assert np.linalg.norm(force[-1]) == pytest.approx(AXIAL_N, abs=0.2)
    np.testing.assert_array_equal(columns["t_s"], read_log(log).t_s)

    status = columns["force_status"]

    assert status[0] == 2
    assert set(status[columns["t_s"] > 2.5]) == {0}
    assert 1 in status[columns["t_s"] < 2.5]

    start, end = (pose_of(lwr, q) for q in insertion(lwr)["q_rad"][[0, -1]])
    travel = start.rotation[:, 2] @ (end.translation - start.translation)

    assert columns["travel_m"][[0, -1]] == pytest.approx([0.0, travel], abs=1e-12)


@pytest.mark.slow
def test_automatic_tare_is_chosen_and_reported(log, run):
    columns, printed = run(log)
    (line,) = [line for line in printed.splitlines() if line.startswith("tare")]
    start_s = float(line.split()[1])
    end_s = float(line.split()[3])

    assert end_s - start_s == pytest.approx(2.0)
    assert columns["force_status"][columns["t_s"] > end_s].max() == 0
    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)

    columns, printed = run(log, "--no-tare")

    assert 0 not in columns["force_status"]
    assert "tare         none" in printed


@pytest.mark.slow
def test_tare_counts_from_the_first_stamp(run, lwr):
    late = insertion(lwr, start_s=1000.0)
    relative, _ = run(late, "--tare", "+0:+2.5")
    absolute, _ = run(late, "--tare", ":1002.5")

    np.testing.assert_array_equal(relative["axial_N"], absolute["axial_N"])
    assert relative["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)

    printed = run(insertion(lwr, start_s=1.7e9), "--tare", "+0:+2.5")[1]

    assert "1700000000 to 1700000002.5 s" in printed
    assert "  0 to 2.5 s of the log" in run(insertion(lwr), "--tare", "-100:2.5")[1]


@pytest.mark.slow
def test_bad_rows_are_counted_and_harm_no_others(run, lwr):
    columns = insertion(lwr)
    columns["q_rad"][2000:2010, 2] = np.nan
    columns["tau_Nm"][3300] = np.inf
    columns["t_s"][1500] = columns["t_s"][1490]
    keep = np.r_[0:2600, 2750:4000]
    forces, printed = run(
        {name: values[keep] for name, values in columns.items()}, *TARE
    )
    rejected = np.flatnonzero(forces["force_status"] == 3)

    np.testing.assert_array_equal(rejected, [*range(1999, 2009), 3149])
    assert np.isnan(forces["axial_N"][rejected]).all()

    valid = forces["force_status"] != 3

    assert np.isfinite(np.stack([forces[n][valid] for n in forces])).all()
    assert forces["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)
    assert "12: 10 x q is not finite" in printed
    assert "1 x bad time stamp" in printed
    assert "1 longer than 0.1 s (longest 0.151 s)" in printed


@pytest.mark.parametrize(
    ("step_s", "gaps"),
    [
        (0.1, "none longer than 0.1 s"),  # but for rounding
        (
            0.10002,
            "longer than 0.1 s (longest 0.10002 s): filters restart after each; "
            "too few",
        ),
    ],
)
def test_gaps_are_not_decided_by_rounding(run, lwr, step_s, gaps):
    columns = insertion(lwr)
    thinned = {name: columns[name][::10] for name in ("q_rad", "tau_Nm")}

    assert gaps in run({"t_s": np.arange(400) * step_s, **thinned}, "--no-tare")[1]


@pytest.mark.slow
def test_warnings_beyond_the_std_are_reported(run, lwr):
    columns = insertion(lwr)
    columns["tau_Nm"][3500, 2] += 80.0
    columns["tau_Nm"][3700:3800, 1] = lwr.effort_limit_Nm[1]
    forces, printed = run(columns, *TARE)
    warnings = forces["force_warnings"].astype(int)

    assert warnings[3500] & SensorWarning.SPIKE
    assert forces["force_status"][3500] == 3
    assert (warnings[3710:3800] & SensorWarning.SATURATED).all()
    assert not warnings[:3000].any()
    assert "x saturated" in printed
    assert 0.3 < np.median(forces["model_mismatch"][forces["force_status"] == 0]) < 3.0
    assert forces["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.2)


@pytest.mark.slow
@pytest.mark.parametrize(("first_row", "warns"), [(2500, True), (3900, False)])
def test_torques_that_stay_unlike_the_arms_are_a_warning_in_words(
    lwr, tmp_path, capsys, first_row, warns
):
    columns = insertion(lwr)
    rows = len(columns["t_s"]) - first_row
    columns["tau_Nm"][first_row:, [1, 2]] += np.linspace([0, 0], [8, -8], rows)
    log = str(tmp_path / "log.npz")
    write_table(log, columns)

    assert main(["force", log, *TARE]) == 0
    # Of 1499 rows after the tare; a tenth of them is allowed.
    assert ("warning: model mismatch in " in capsys.readouterr().err) is warns


@pytest.mark.slow
@pytest.mark.parametrize("row", [100, 2000, 3000])
def test_a_bad_stamp_costs_its_row_only(run, lwr, row):
    columns = insertion(lwr)
    t_s = columns["t_s"].copy()
    columns["t_s"][row] += 20.0
    forces, printed = run(columns, *TARE)

    assert "rejected     1: 1 x bad time stamp" in printed
    assert "tare         0 to 2.5 s of the log, kind" in printed
    np.testing.assert_array_equal(forces["t_s"], np.delete(t_s, row))
    assert forces["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)


@pytest.mark.slow
def test_the_tare_window_is_reported_as_it_was_used(run, lwr):
    columns = insertion(lwr)
    columns["t_s"][1500:] += 3600.0
    _, printed = run(columns, *TARE)

    assert "tare         0 to 1.499 s of the log (of 0 to 2.5 s;" in printed


@pytest.mark.slow
def test_velocities_in_degrees_are_refused_with_reason(run, lwr, tmp_path, capsys):
    columns = insertion(lwr)
    columns["dq_rad_s"] = np.degrees(columns["dq_rad_s"])
    log = str(tmp_path / "log.npz")
    write_table(log, columns)
    refused = refusal(["force", log, *TARE], capsys)
    for text in (
        "rate of q: is it in deg/s?",
        "--force-tare",
        "Give unit and factor",
    ):
        assert text in refused
    _, printed = run(log, *TARE, "--dq", "dq_rad_s:rad/s:0.0174533")

    assert "velocity" not in printed.replace("velocity from the log", "")

    forces, printed = run(log, *TARE, "--force-tare")
    lines = printed.splitlines()

    assert any(line.startswith("warnings ") and "x velocity" in line for line in lines)
    assert any(
        line.startswith("velocity ") and "is it in deg/s?" in line for line in lines
    )
    assert (forces["force_warnings"][-1000:].astype(int) & SensorWarning.VELOCITY).all()


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joint", "value", "fault"),
    [
        (slice(None), 0.0, "stands still while q moves"),
        (1, np.nan, "dq has no finite value at joint 2"),
    ],
    ids=["zeros", "NaN"],
)
def test_velocities_not_sent_are_named_with_the_option_that_works(
    run, lwr, tmp_path, capsys, joint, value, fault
):
    columns = insertion(lwr)
    columns["dq_rad_s"][:, joint] = value
    log = str(tmp_path / "log.npz")
    write_table(log, columns)
    refused = refusal(["force", log, *TARE], capsys)

    assert fault in refused
    assert "--dq none" in refused

    mapping = tmp_path / "map.toml"
    mapping.write_text('dq = "none"\n')
    for options in (["--dq", "none"], ["--mapping", str(mapping)]):
        forces, printed = run(log, *TARE, *options)

        assert "velocity estimated" in printed
        assert forces["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)


@pytest.mark.slow
def test_velocities_lost_later_are_counted_with_advice(run, lwr):
    columns = insertion(lwr)
    columns["dq_rad_s"][3000:, 0] = np.nan
    _, printed = run(columns, *TARE)

    assert "1000 x dq is not finite at joint 1; --dq none" in printed


@pytest.mark.parametrize(
    ("options", "advice"),
    [
        (
            "1:1.01",
            "s of it). Choose a longer window with --tare START:END, without gaps",
        ),
    ],
)
def test_refused_tare_advises_options_and_no_code(log, capsys, options, advice):
    said = refusal(["force", log, "--tare", *options.split()], capsys)
    assert (advice in said, "update()" in said) == (True, False), said


@pytest.mark.slow
def test_urdf_with_locks_or_missing_link_gives_forces(lwr, run, tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(SMALL_ARM)
    arm = insertion(
        load_urdf(urdf, tool_frame="tip", locked_joints={"gripper": 0.02}), axial_N=3.0
    )
    robot = ["--urdf", str(urdf), "--tool-frame", "tip"]
    columns, printed = run(arm, *robot, "--lock", "gripper=0.02", *TARE)

    assert "arm, 2 joints, payload 0 kg" in printed
    assert np.isfinite(columns["axial_N"]).all()

    offset = ["--without", "finger", "--tip-offset", "0", "0", "0.1"]
    columns, printed = run(arm, *robot, *offset, "--no-tare")

    assert "arm, 2 joints" in printed
    assert "point force at tool" in printed

    # A known arm is loaded by its name.
    columns = insertion(lwr, seconds=0.6)
    six = {"t_s": columns["t_s"]} | {
        name: columns[name][:, :6] for name in ("q_rad", "tau_Nm")
    }

    assert "6 joints, payload 0 kg" in run(six, "--robot", "ur10e", "--no-tare")[1]


@pytest.mark.slow
def test_missing_payload_reads_as_its_weight(log, run, tmp_path):
    light = tmp_path / "light.toml"
    light.write_text("[needle]\nsensor_mass_kg = 0.0\n")
    options = ("--no-tare", "--mode", "full")
    right, printed = run(log, *options)

    assert run(log, *options, "--robot", "lwr4plus")[1] == printed

    lacking, printed_lacking = run(log, *options, "--payload", str(light))
    weight_N = (right["force_z_in_base_N"] - lacking["force_z_in_base_N"])[1500]

    assert weight_N == pytest.approx(0.236 * 9.80665, abs=0.2)
    assert "payload 0.304 kg" in printed
    assert "payload 0.068 kg" in printed_lacking


@pytest.mark.slow
@pytest.mark.parametrize(
    ("options", "suffix"),
    [
        (["--tare", "+0:+2.5", "--mode", "full"], "pdf"),
        (
            ["--tare", "+0:+2.5", "--mode", "point", "--over", "depth", "--from", "1"],
            "svg",
        ),
        (["--no-tare", "--from", "1", "--to", "1.5"], "png"),
    ],
    ids=str,
)
def test_figure_is_written_for_every_mode(run, lwr, tmp_path, options, suffix):
    start_s = 0.0 if suffix == "png" else 1.7e9
    columns = insertion(lwr, seconds=3.0, start_s=start_s)
    columns["tau_Nm"][2600:2650] = np.nan
    keep = np.r_[0:1500, 1700:3000]
    path = tmp_path / f"picture.{suffix}"
    columns = {name: values[keep] for name, values in columns.items()}
    run(columns, *options, "--figure", str(path))
    content = path.read_bytes()

    assert content.startswith(
        {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF"}[suffix]
    )
    assert len(content) > 5_000


@pytest.mark.slow
def test_log_without_valid_row_has_figures(lwr, tmp_path, capsys):
    columns = insertion(lwr, seconds=0.1)
    columns["q_rad"][:, 0] = np.nan
    write_table(tmp_path / "$\\frac{$.npz", columns)
    path = tmp_path / "forces.png"
    argv = ["force", str(tmp_path / "$\\frac{$.npz"), "--no-tare", "--png", str(path)]
    for over in ("time", "depth"):
        assert main([*argv, "--over", over]) == 0
        assert path.is_file()
        assert "no sample was valid" in capsys.readouterr().out

    assert main(["report", argv[1], str(tmp_path / "page"), "--no-tare"]) == 0
    assert "no sample was valid" in capsys.readouterr().out
    assert "$\\frac{$" in (tmp_path / "page" / "index.html").read_text()

    path.unlink()
    for window in (["--from", "90"], ["--from", "90", "--to", "99"], ["--to", "-1"]):
        assert main([*argv, *window]) == 2
        printed = capsys.readouterr()
        assert (
            "time of the log [s], runs from 0 to 0.099; expected --from and"
            in printed.err
        )
        assert ("no sample was valid" in printed.out, path.exists()) == (True, False)
