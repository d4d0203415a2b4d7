"""The commands read recordings from pipes and while they grow."""

import subprocess
import sys

import numpy as np
import pytest
from bag_samples import grow, in_pieces
from residual_command_log import write_insertion

from identification import __main__ as command
from needleforce.recordings import write_table

ROWS = np.arange(5000)
COLUMNS = {"t_s": ROWS / 1000, "depth_m": 1e-6 * ROWS, "force_N": 1e-3 * ROWS**0.5}


@pytest.mark.parametrize("name", ["identification", "residual"])
def test_the_commands_follow_a_bag(tmp_path, lwr, name):
    path, out, expected = (tmp_path / file for file in ("log.mcap", "out.csv", "expected.csv"))
    if name == "residual":
        write_insertion(tmp_path / "whole.mcap", lwr)
    else:
        write_table(tmp_path / "whole.mcap", COLUMNS)
    command = [sys.executable, "-m", name]
    options = ["--tare", "0:2.5"] if name == "residual" else []
    whole = [*command, str(tmp_path / "whole.mcap"), *options, "-o", str(expected)]
    subprocess.run(whole, check=True, capture_output=True)
    writer = grow(path, in_pieces((tmp_path / "whole.mcap").read_bytes(), 20), pause_s=0.1)
    argv = [*command, str(path), "--follow", *options, "-o", str(out)]
    done = subprocess.run(argv, capture_output=True, check=False, timeout=120)
    writer.join()
    assert done.returncode == 0, done.stderr
    assert out.read_bytes() == expected.read_bytes()


def test_a_bag_that_is_piped_into_the_command_gives_the_bytes_of_the_file(tmp_path):
    path, out = tmp_path / "log.mcap", tmp_path / "out.csv"
    write_table(path, COLUMNS)
    assert command.main([str(path), "-o", str(out)]) == 0
    argv = [sys.executable, "-m", "identification", "-", "-o", "-"]
    done = subprocess.run(argv, input=path.read_bytes(), capture_output=True, check=False)
    assert (done.returncode, done.stdout) == (0, out.read_bytes())
    assert b"standard input is mcap, not text" in done.stderr


def test_what_only_begins_as_a_recording_is_reported_in_one_line(tmp_path):
    argv = [sys.executable, "-m", "identification", "-"]
    for data, message in ((b"PK\x03\x04\x00", b"not an npz"), (b"\x89MCAP0\r\n", b"no messages")):
        done = subprocess.run(argv, input=data, capture_output=True, check=False)
        assert done.returncode == 2
        warning, error = done.stderr.splitlines()
        assert warning.startswith(b"warning: ")
        assert error.startswith(b"error: ")
        assert b"standard input" in error
        assert message in error, error
