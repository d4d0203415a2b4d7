"""`needleforce check`: what a log and its tare verify, as a table and as JSON."""

import json
import shlex

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import write_table
from tests.needleforce.cli.residual_command_log import insertion
from tests.residual.residual_signals import swing
from urdf import load_example

pytestmark = pytest.mark.slow


TARE = ["--tare", "0:2.5"]


@pytest.fixture(scope="module")
def columns(lwr):
    return insertion(lwr)


def check(tmp_path, capsys, columns, *options):
    """Exit code, lines by their topic, and the whole of what JSON has."""
    log = str(tmp_path / "log.npz")
    write_table(log, columns)
    code = main(["check", log, *TARE, *options, "--json"])
    found = json.loads(capsys.readouterr().out)
    return code, {line["topic"]: line for line in found["lines"]}, found


def test_a_sound_log_is_verified(tmp_path, capsys, columns):
    code, lines, found = check(tmp_path, capsys, columns)

    assert code == 0
    assert lines["velocities"]["outcome"] == "verified"
    assert lines["scale"]["outcome"] == "verified"
    assert lines["tare"]["outcome"] == "verified"
    assert "joints" in lines["order and signs"]["text"]
    assert "at 1000 Hz" in lines["rate"]["text"]
    assert lines["channel tau"]["text"].startswith("tau_Nm in Nm")
    assert found["torque"]["scale"] == pytest.approx(1.0, abs=0.1)
    assert found["torque"]["rated_payload_kg"] == 7.0


def test_a_doubt_is_named_with_the_option_that_cures_it(tmp_path, capsys, columns):
    bent = columns | {"tau_Nm": 0.01 * columns["tau_Nm"]}
    code, lines, found = check(tmp_path, capsys, bent)

    assert code == 1
    assert lines["tare"]["outcome"] == "doubtful"
    assert "--tau tau_Nm:Nm:100" in lines["tare"]["text"]
    assert found["torque"]["advice"] == "unit"
    assert not {"order and signs", "scale", "payload"} & {
        topic for topic, line in lines.items() if line["outcome"] == "verified"
    }
    # The mass that would explain these torques is none that is missing.
    assert lines["payload"]["outcome"] == "not verified"
    assert "kg" not in lines["payload"]["text"]
    # The rows after the refused tare were read, too.
    assert lines["rejected"]["outcome"] == "verified"
    assert lines["rate"]["text"].startswith("4000 rows")


def test_a_factor_that_is_no_unit_is_measured_and_not_advised(
    tmp_path, capsys, columns
):
    bent = columns | {"tau_Nm": 0.3 * columns["tau_Nm"]}
    code, lines, found = check(tmp_path, capsys, bent)

    assert code == 1
    assert "--tau" not in lines["tare"]["text"]
    assert "0.3 +/-" in lines["scale"]["text"]
    assert lines["scale"]["outcome"] == "doubtful"
    assert found["torque"]["advice"] == ""


def signals_of_ur5e(middle=(0.3, -1.2, 1.4, -1.0, -1.3, 0.4), amplitude=0.2):
    """Columns of a UR5e without a payload that swings freely."""
    t, q, dq, tau = swing(
        load_example("ur5e"),
        seconds=4.0,
        rate_hz=250,
        middle=middle,
        amplitude=amplitude,
    )
    tau = tau + 0.02 * np.random.default_rng(1000).normal(size=tau.shape)
    return {"t_s": t, "q_rad": q, "dq_rad_s": dq, "tau_Nm": tau}


def test_a_wrong_arm_is_named_and_nothing_else_advised(tmp_path, capsys):
    _, lines, _ = check(tmp_path, capsys, signals_of_ur5e(), "--robot", "ur5")

    assert "give --robot ur5e" in lines["tare"]["text"]
    assert "--payload" not in lines["tare"]["text"]
    assert "--tau" not in lines["tare"]["text"]


def test_a_payload_and_a_factor_do_not_make_up_for_a_wrong_arm(tmp_path, capsys):
    payload = tmp_path / "payload.toml"
    payload.write_text("mass_kg = 2.44\ncom_m = [-0.001, 0.001, -0.041]\n")
    # Hardly any motion: the wrong arm with both is within what the tare allows.
    middle = [0.3, -1.428, 1.545, -1.779, -1.669, 0.088]
    write_table(tmp_path / "ur5e.npz", signals_of_ur5e(middle, amplitude=0.12))
    options = ["--payload", str(payload), "--tau", "tau_Nm:Nm:1.33", *TARE]
    code = main(["force", str(tmp_path / "ur5e.npz"), "--robot", "ur5", *options])
    printed = capsys.readouterr()

    assert code == 2
    assert "tau times 1.33 with ur5" in printed.err
    assert "--robot ur5e" in printed.err
    assert printed.out == ""


def test_joints_sorted_by_name_are_put_in_order_by_the_advice(tmp_path, capsys):
    columns = signals_of_ur5e()
    for name in ("q_rad", "dq_rad_s", "tau_Nm"):
        columns[name] = columns[name][:, [2, 1, 0, 3, 4, 5]]
    _, lines, _ = check(tmp_path, capsys, columns, "--robot", "ur5e")
    options = lines["tare"]["text"].partition(". Give ")[2].partition(". ")[0]

    assert options.startswith("--q ")
    assert lines["order and signs"]["outcome"] == "doubtful"

    words = shlex.split(options)
    code, lines, _ = check(tmp_path, capsys, columns, "--robot", "ur5e", *words)

    assert code == 0
    assert lines["order and signs"]["outcome"] == "verified"


def test_a_joint_of_the_other_sign_is_doubtful(tmp_path, capsys, columns):
    bent = columns | {"tau_Nm": columns["tau_Nm"] * [1, -1, 1, 1, 1, 1, 1]}
    code, lines, _ = check(tmp_path, capsys, bent)

    assert code == 1
    assert lines["order and signs"]["outcome"] == "doubtful"
    assert "joint 2" in lines["order and signs"]["text"]
    assert "follows gravity" not in lines["order and signs"]["text"]


def test_exchanged_joints_are_listed_by_column_in_the_robots_order(
    tmp_path, capsys, columns
):
    order = [0, 3, 2, 1, 4, 5, 6]
    bent = {name: columns[name] for name in ("t_s", "q_rad", "dq_rad_s")}
    for joint, source in enumerate(order):
        bent[f"torque{joint + 1}"] = columns["tau_Nm"][:, source]
    _, lines, _ = check(tmp_path, capsys, bent)
    expected = "torque1,torque4,torque3,torque2,torque5,torque6,torque7"

    assert f"--tau {expected}." in lines["tare"]["text"]
    assert lines["order and signs"]["outcome"] == "doubtful"


def test_without_a_tare_what_is_unverified_is_said(tmp_path, capsys, columns):
    log = str(tmp_path / "log.npz")
    write_table(log, columns | {"dq_rad_s": np.zeros_like(columns["dq_rad_s"])})
    code = main(["check", log, "--no-tare"])
    table = {line[:17].strip(): line for line in capsys.readouterr().out.splitlines()}

    assert code == 1
    assert "not verified" in table["scale"]
    assert "doubtful" in table["velocities"]
