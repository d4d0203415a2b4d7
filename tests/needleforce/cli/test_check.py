"""`needleforce check`: what a log and its tare verify, as a table and as JSON."""

import json

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import write_table
from tests.needleforce.cli.residual_command_log import insertion

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
    bent = columns | {"tau_Nm": 0.3 * columns["tau_Nm"]}
    code, lines, found = check(tmp_path, capsys, bent)

    assert code == 1
    assert lines["tare"]["outcome"] == "doubtful"
    assert "NF-SENSOR-TORQUE-SCALE" in lines["tare"]["text"]
    assert "--tau tau_Nm:Nm:3.3" in lines["tare"]["text"]
    assert found["torque"]["codes"] == ["NF-SENSOR-TORQUE-SCALE"]
    # The mass that would explain these torques is none that is missing.
    assert lines["payload"]["outcome"] == "not verified"
    assert "kg" not in lines["payload"]["text"]
    # The rows after the refused tare were read, too.
    assert lines["rejected"]["outcome"] == "verified"
    assert lines["rate"]["text"].startswith("4000 rows")


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

    assert f"--tau {expected};" in lines["tare"]["text"]
    assert lines["order and signs"]["outcome"] == "doubtful"


def test_without_a_tare_what_is_unverified_is_said(tmp_path, capsys, columns):
    log = str(tmp_path / "log.npz")
    write_table(log, columns | {"dq_rad_s": np.zeros_like(columns["dq_rad_s"])})
    code = main(["check", log, "--no-tare"])
    table = {line[:17].strip(): line for line in capsys.readouterr().out.splitlines()}

    assert code == 1
    assert "not verified" in table["scale"]
    assert "doubtful" in table["velocities"]
