"""The command names joints and reason where velocities are not the rate of positions."""

import numpy as np
from residual_command_log import insertion

from needleforce.cli.force import main
from recordings import write_table
from residual import SensorWarning

DEGREES = 180.0 / np.pi


def test_the_command_names_joints_and_reason(lwr, tmp_path, capsys):
    columns = insertion(lwr)
    columns["dq_rad_s"] = DEGREES * columns["dq_rad_s"]
    log = tmp_path / "log.npz"
    write_table(log, columns)
    assert main([str(log), "--tare", "0:2.5"]) == 2
    refused = capsys.readouterr().err
    assert "is 57.3 times the rate of q: is it in deg/s? " in refused
    assert "--force-tare" in refused
    assert "--dq dq_*:deg/s" in refused
    assert main([str(log), "--tare", "0:2.5", "--dq", "dq_rad_s:deg/s"]) == 0
    assert "velocity" not in capsys.readouterr().out.replace("velocity from the log", "")
    out = tmp_path / "forces.npz"
    assert main([str(log), "--tare", "0:2.5", "--force-tare", "-o", str(out)]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert any(line.startswith("warnings ") and "x velocity" in line for line in lines)
    assert any(line.startswith("velocity ") and "is it in deg/s?" in line for line in lines)
    warnings = np.load(out)["force_warnings"].astype(int)
    assert (warnings[-1000:] & SensorWarning.VELOCITY).all()
