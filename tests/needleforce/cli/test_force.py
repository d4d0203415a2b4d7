"""`needleforce force` and `check`: the forces are those that were put into the log."""

import json
import re

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import read_log, read_table, write_table
from tests.needleforce.cli.residual_command_log import (
    AXIAL_N,
    CONTACT_S,
    SMALL_ARM,
    insertion,
    write_insertion,
)
from tests.residual.residual_signals import pose_of
from urdf import load_urdf

pytestmark = pytest.mark.slow

TARE = ["--tare", "0:2.5"]


@pytest.fixture(scope="module")
def log(lwr, tmp_path_factory):
    return str(write_insertion(tmp_path_factory.mktemp("log") / "insertion.csv", lwr))


@pytest.fixture
def run(tmp_path, capsys):
    """Run the command on a log or its columns; return the columns of forces, the
    summary by its labels, and the warnings."""

    def run(log, *argv):
        if isinstance(log, dict):
            write_table(tmp_path / "log.npz", log)
            log = str(tmp_path / "log.npz")
        path = tmp_path / "forces.csv"
        code = main(["force", log, *argv, "-o", str(path)])
        printed = capsys.readouterr()
        assert code == 0, printed.err
        summary = {line[:11].strip(): line[13:] for line in printed.out.splitlines()}
        return read_table(path).columns, summary, printed.err

    return run


@pytest.mark.parametrize(
    "options",
    [
        [],
        ["--mode", "axial"],
        ["--mode", "full", "--alignment", "trapezoid", "--gain", "30"],
        ["--external-torque"],
        ["--insertion-axis", "0", "0", "2"],
        ["--dq", "none"],
    ],
    ids=" ".join,
)
def test_axial_force_matches_truth_within_its_std(log, run, options):
    columns, *_ = run(log, *TARE, *options)
    contact = columns["t_s"] > CONTACT_S + 0.3
    free = (columns["t_s"] > 2.6) & (columns["t_s"] < CONTACT_S)
    error = columns["axial_N"][contact] - AXIAL_N
    std = columns["axial_std_N"][contact]

    assert np.abs(error).max() < 0.15
    assert abs(error.mean()) < 0.05
    assert np.mean(np.abs(error) < 3.0 * std) > 0.95
    assert np.abs(columns["axial_N"][free]).max() < 0.1


@pytest.mark.parametrize(
    ("mode", "components"), [("axial", 3), ("point", 6), ("full", 12)]
)
def test_columns_name_units_and_travel_is_true(log, run, lwr, mode, components):
    columns, *_ = run(log, *TARE, "--mode", mode)
    plain = {"model_mismatch", "force_warnings", "force_status"}
    force = np.stack([columns[f"force_{xyz}_in_base_N"] for xyz in "xyz"], axis=1)
    start, end = (pose_of(lwr, q) for q in insertion(lwr)["q_rad"][[0, -1]])
    travel = start.rotation[:, 2] @ (end.translation - start.translation)
    status = columns["force_status"]
    is_tared = columns["t_s"] > 2.5

    assert len(columns) == 9 + components
    assert {name.rsplit("_", 1)[1] for name in columns.keys() - plain} <= {
        *("s", "m", "N", "Nm")
    }
    assert force[-1] @ end.rotation[:, 2] == pytest.approx(-AXIAL_N, abs=0.2)
    np.testing.assert_array_equal(columns["t_s"], read_log(log).t_s)
    assert (status[0], {*status[~is_tared]}, {*status[is_tared]}) == (2, {1, 2}, {0})
    assert columns["travel_m"][[0, -1]] == pytest.approx([0.0, travel], abs=1e-12)


def test_automatic_tare_is_the_first_2_s_of_settled_motion(log, run):
    columns, summary, _ = run(log)
    start_s, end_s = map(float, summary["tare"].split(" s ")[0].split(" to "))

    assert end_s - start_s == pytest.approx(2.0)
    assert columns["force_status"][columns["t_s"] > end_s].max() == 0
    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)


@pytest.mark.parametrize(
    ("start_s", "window", "shown"),
    [
        (1000.0, "+0:+2.5", "1000 to 1002.5 s"),
        (1000.0, ":1002.5", "1000 to 1002.5 s"),
        (1.7e9, "+0:+2.5", "1700000000 to 1700000002.5 s"),
        (0.0, "-100:2.5", "0 to 2.5 s"),
    ],
)
def test_a_tare_is_named_on_the_logs_clock(run, lwr, start_s, window, shown):
    columns, summary, _ = run(insertion(lwr, start_s=start_s), "--tare", window)

    assert summary["tare"].startswith(shown)
    assert columns["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)


def test_what_came_before_the_tares_window_is_not_in_it(run, lwr):
    columns = insertion(lwr)
    columns["tau_Nm"][:900, 1:4] += 4.0
    forces, *_ = run(columns, "--tare", "1.3:2.5")

    assert forces["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)


def test_bad_rows_are_counted_and_harm_no_others(run, lwr):
    columns = insertion(lwr)
    columns["q_rad"][2000:2010, 2] = np.nan
    columns["tau_Nm"][3300] = np.inf
    columns["t_s"][3600] = np.nan
    keep = np.r_[0:2600, 2750:4000]
    forces, summary, _ = run(
        {name: values[keep] for name, values in columns.items()}, *TARE
    )
    is_rejected = forces["force_status"] == 3
    rejected = np.flatnonzero(is_rejected)

    assert rejected.tolist() == [*range(2000, 2010), 3150]
    assert np.isnan(forces["axial_N"][rejected]).all()
    assert np.isfinite(np.stack([forces[n][~is_rejected] for n in forces])).all()
    assert forces["axial_N"][-1] == pytest.approx(AXIAL_N, abs=0.15)
    assert re.match("12: 10 x q .*1 x bad time stamp", summary["rejected"])
    assert summary["gaps"].startswith("1 longer than 0.1 s (longest 0.151 s)")


@pytest.mark.parametrize(("first_row", "warns"), [(2500, True), (3900, False)])
def test_torques_that_stay_unlike_the_arms_are_a_warning(lwr, run, first_row, warns):
    columns = insertion(lwr)
    rows = len(columns["t_s"]) - first_row
    columns["tau_Nm"][first_row:, [1, 2]] += np.linspace([0, 0], [8, -8], rows)
    *_, said = run(columns, *TARE)

    # Of 1499 rows after the tare; a tenth of them is allowed.
    assert ("warning: model mismatch" in said) is warns


def test_a_link_is_left_out(run, tmp_path):
    urdf = tmp_path / "arm.urdf"
    urdf.write_text(SMALL_ARM)
    arm = load_urdf(urdf, tool_frame="tip", locked_joints=["gripper"])
    options = "--tool-frame tip --without finger --tip-offset 0 0 0.1 --no-tare"
    log = insertion(arm, axial_N=3.0)
    _, summary, _ = run(log, "--urdf", str(urdf), *options.split())

    assert summary["robot"].startswith("arm, 2 joints, payload 0 kg")
    assert summary["sensor"].startswith("point force at tool")


def test_a_known_arm_is_loaded_and_without_a_tare_no_force_is_valid(lwr, run):
    log = insertion(lwr, seconds=0.6)
    six = {name: log[name][:, :6] for name in ("q_rad", "tau_Nm")}
    forces, summary, _ = run(six | {"t_s": log["t_s"]}, "--robot", "ur10e", "--no-tare")

    assert "6 joints, payload 0 kg" in summary["robot"]
    assert 0 not in forces["force_status"]
    assert summary["axial force"].endswith("not tared")


@pytest.mark.parametrize(
    ("mapping", "mass_kg"),
    [
        ("joints = []", 0.304),
        ('payload = "none"', 0.0),
        ("[payload]\nmass_kg = 1.5\ncom_m = [0, 0, 0.1]", 1.5),
        ("[payload.needle]\nsensor_mass_kg = 0.0", 0.068),
    ],
)
def test_the_payload_may_stand_in_the_mapping(log, run, tmp_path, mapping, mass_kg):
    path = tmp_path / "map.toml"
    path.write_text(mapping)
    _, summary, _ = run(log, "--mapping", str(path), "--no-tare")

    assert f"payload {mass_kg:g} kg" in summary["robot"]


@pytest.mark.parametrize(
    ("options", "magic"),
    [
        ([*TARE, "--mode", "full", "--figure", "f.pdf"], b"%PDF"),
        ([*TARE, "--over", "depth", "--figure", "f.svg"], b"<?xml"),
        (["--no-tare", "--png", "f.png"], b"\x89PNG"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_figure_is_written_for_every_mode(
    run, lwr, tmp_path, monkeypatch, options, magic
):
    monkeypatch.chdir(tmp_path)
    columns = insertion(lwr, seconds=3.0)
    columns["tau_Nm"][2600:2650] = np.nan
    run(columns, *options)
    content = (tmp_path / options[-1]).read_bytes()

    assert content.startswith(magic)
    assert len(content) > 5_000


@pytest.fixture
def folder(lwr, tmp_path):
    """A folder with one file for each signal, without headers, and a force sensor."""
    folder = tmp_path / "run"
    folder.mkdir()
    columns = insertion(lwr)
    t_s = columns["t_s"]
    axial_N = np.where(t_s > CONTACT_S, AXIAL_N, 0.0)
    sensor_N = np.column_stack([0.0 * t_s, 0.0 * t_s, 0.7 - axial_N])
    signals = {
        "Joint_Positions": (t_s, columns["q_rad"]),
        "Joint_Torques": (t_s + 0.0002, columns["tau_Nm"]),
        "Force_Sensor": (t_s[:-3] + 0.0004, sensor_N[:-3]),
    }
    for name, (stamps_s, values) in signals.items():
        rows = np.column_stack([stamps_s, values])
        np.savetxt(folder / f"gel_1_{name}.dat", rows, delimiter=",")
    return folder


@pytest.mark.parametrize("form", ["folder", "files"])
def test_the_force_sensor_of_a_folder_is_compared(folder, capsys, form):
    files = [str(path) for path in sorted(folder.iterdir())]
    assert main(["force", *(files if form == "files" else [str(folder)]), *TARE]) == 0
    printed = capsys.readouterr().out
    rms_N = float(re.search(r"force sensor +(\S+) N", printed)[1])

    assert rms_N < 0.1 * AXIAL_N
    assert "Force_Sensor[2]" in printed


def test_a_named_force_is_compared_in_its_unit(lwr, run):
    columns = insertion(lwr)
    axial_N = np.where(columns["t_s"] > CONTACT_S, AXIAL_N, 0.0)
    _, summary, _ = run(columns | {"cell": -1e3 * axial_N}, *TARE)
    assert "force sensor"[:11] not in summary
    _, summary, _ = run(
        columns | {"cell": 250.0 - 1e3 * axial_N}, *TARE, "--force", "cell:mN:-1"
    )

    assert float(summary["force sensor"[:11]].split()[0]) < 0.1 * AXIAL_N


@pytest.mark.parametrize(
    ("options", "start_s"), [(["--no-tare"], 0.0), (TARE, 2.6)], ids=["none", "nan"]
)
def test_why_a_sensor_was_not_compared_is_said(lwr, run, options, start_s):
    columns = insertion(lwr)
    force_N = np.where(columns["t_s"] < start_s, np.nan, 1.0)
    _, summary, _ = run(columns | {"cell": force_N}, *options, "--force", "cell:N")

    assert "tare" in summary["force sensor"[:11]]


def check(tmp_path, capsys, columns, *options):
    """Exit code of `check`, and what it prints as JSON."""
    log = str(tmp_path / "log.npz")
    write_table(log, columns)
    code = main(["check", log, *options, "--json"])
    return code, json.loads(capsys.readouterr().out)


def test_check_finds_nothing_doubtful_in_a_sound_log(lwr, tmp_path, capsys):
    code, found = check(tmp_path, capsys, insertion(lwr), *TARE)
    torque_scale = float(found["facts"]["torque"].split()[0])

    assert (code, found["warnings"]) == (0, [])
    assert found["facts"]["samples"].startswith("4000 in 3.999 s at 1000 Hz: ")
    assert found["channels"]["tau"].startswith("tau_Nm in Nm")
    assert torque_scale == pytest.approx(1.0, abs=0.1)


@pytest.mark.parametrize(
    ("channel", "change", "options", "fact", "word"),
    [
        ("tau_Nm", lambda tau: 1.15 * tau, TARE, "torque", "1.15 +/-"),
        (
            "tau_Nm",
            lambda tau: tau + 80 * np.eye(4000, 7, -3500),
            TARE,
            "rejected",
            "1 x",
        ),
        ("dq_rad_s", np.zeros_like, ["--no-tare"], "signals", "dq"),
        ("q_rad", lambda q: np.where(q == q[9], np.nan, q), TARE, "rejected", "1 x q"),
    ],
)
def test_check_ends_with_1_where_something_is_doubtful(
    lwr, tmp_path, capsys, channel, change, options, fact, word
):
    columns = insertion(lwr)
    columns[channel] = change(columns[channel])
    code, found = check(tmp_path, capsys, columns, *options)

    assert (code, word in found["facts"][fact]) == (1, True)
