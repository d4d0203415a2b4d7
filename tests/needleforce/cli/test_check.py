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
    assert lines["rate"]["text"] == "4000 rows at 1000 Hz"
    assert lines["channel tau"]["text"].startswith("tau_Nm in Nm")
    assert found["torque"]["scale"] == pytest.approx(1.0, abs=0.1)


def test_torques_of_another_unit_are_doubtful(tmp_path, capsys, columns):
    bent = columns | {"tau_Nm": 0.01 * columns["tau_Nm"]}
    code, lines, _ = check(tmp_path, capsys, bent)

    assert code == 1
    assert lines["tare"]["outcome"] == "doubtful"
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
    code, lines, _ = check(tmp_path, capsys, bent)

    assert code == 1
    assert "0.3 +/-" in lines["scale"]["text"]
    assert lines["scale"]["outcome"] == "doubtful"


def test_a_joint_of_the_other_sign_is_doubtful(tmp_path, capsys, columns):
    bent = columns | {"tau_Nm": columns["tau_Nm"] * [1, -1, 1, 1, 1, 1, 1]}
    code, lines, _ = check(tmp_path, capsys, bent)

    assert code == 1
    assert lines["order and signs"]["outcome"] == "doubtful"
    assert "joint 2" in lines["order and signs"]["text"]


def test_without_a_tare_what_is_unverified_is_said(tmp_path, capsys, columns):
    log = str(tmp_path / "log.npz")
    write_table(log, columns | {"dq_rad_s": np.zeros_like(columns["dq_rad_s"])})
    code = main(["check", log, "--no-tare"])
    table = {line[:17].strip(): line for line in capsys.readouterr().out.splitlines()}

    assert code == 1
    assert "not verified" in table["scale"]
    assert "doubtful" in table["velocities"]
