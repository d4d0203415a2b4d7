"""The command on a real recording: a Franka Panda in free motion, another robot's description."""

import numpy as np
import pytest

from needleforce.cli.force import main
from recordings import read_table
from urdf import MissingPackageError, example_robot_path

FRICTION = """
[sigmoid]
amplitude_Nm = [0.54615, 0.87224, 0.64068, 1.2794, 0.83904, 0.30301, 0.56489]
slope_s_rad = [5.1181, 9.0657, 10.136, 5.5903, 8.3469, 17.133, 10.336]
shift_rad_s = [0.039533, 0.025882, -0.04607, 0.036194, 0.026226, -0.021047, 0.0035526]
"""


@pytest.fixture
def command(recordings_dir, tmp_path):
    log = recordings_dir / "panda_gaz2019" / "free_motion.npz"
    if not log.is_file():
        pytest.skip(f"no {log.name} of the Panda")
    try:
        urdf = example_robot_path("panda")
    except MissingPackageError as error:
        pytest.skip(str(error))
    (tmp_path / "friction.toml").write_text(FRICTION)
    robot = ["--urdf", str(urdf), "--tool-frame", "panda_hand_tcp"]
    fingers = ["--lock", "panda_finger_joint1", "panda_finger_joint2"]
    return [str(log), *robot, *fingers, "--friction", str(tmp_path / "friction.toml")]


def test_a_real_arm_in_free_motion_reads_no_more_force_than_its_model_is_off(
    command, tmp_path, capsys
):
    path = tmp_path / "forces.csv"
    assert main([*command, "--tare", ":10", "--force-tare", "-o", str(path)]) == 0
    columns = read_table(path).columns
    tared = columns["force_status"] == 0
    axial_N, std_N = columns["axial_N"][tared], columns["axial_std_N"][tared]
    assert tared.sum() > 10_000
    # The public model is wrong by up to 0.75 Nm rms per joint, a few N at the hand.
    assert np.sqrt(np.mean(axial_N**2)) < 4.0
    assert np.mean(np.abs(axial_N) < 2.0 * std_N) > 0.7
    assert "panda, 7 joints, payload 0 kg" in capsys.readouterr().out


def test_fingers_that_are_not_in_the_log_must_be_locked(command, capsys):
    argv = [item for item in command if not item.startswith(("--lock", "panda_finger"))]
    assert main([*argv, "--no-tare"]) == 2
    told = capsys.readouterr().err
    assert "mimics" in told
    assert "lock it with --lock" in told
