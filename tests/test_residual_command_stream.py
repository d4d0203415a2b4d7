"""`python -m residual` on pipes and growing files: rows as they come, and as those of the file."""

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
from residual_command_log import insertion, write_insertion

from needleforce.cli import force_replay as replay
from needleforce.cli.force import main
from needleforce.cli.force_report import save_picture
from recordings import read_table, write_table

TARE = ["--tare", "0:2.5"]
COMMAND = [sys.executable, "-m", "residual"]
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def log(lwr, tmp_path_factory):
    return write_insertion(tmp_path_factory.mktemp("log") / "insertion.csv", lwr)


@pytest.fixture(scope="module")
def expected(log):
    """What the command writes for the whole file."""
    path = log.with_name("expected.csv")
    assert main([str(log), *TARE, "-o", str(path)]) == 0
    return path.read_bytes()


def run_piped(data, *argv):
    """Run with data on standard input."""
    return subprocess.run([*COMMAND, "-", *argv], input=data, capture_output=True, check=False)


def wait_for(condition):
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


def test_a_pipe_in_and_out_gives_the_bytes_of_the_file(log, expected):
    done = run_piped(log.read_bytes(), *TARE, "-o", "-")
    assert done.returncode == 0, done.stderr
    assert done.stdout == expected
    assert done.stderr.startswith(b"robot ")


@pytest.mark.parametrize("suffix", ["npz", "csv.gz"])
def test_the_bytes_do_not_depend_on_the_format_of_the_log(lwr, expected, tmp_path, suffix):
    path = write_insertion(tmp_path / f"log.{suffix}", lwr)
    assert main([str(path), *TARE, "-o", str(tmp_path / "out.csv")]) == 0
    assert (tmp_path / "out.csv").read_bytes() == expected


def test_a_growing_file_gives_rows_at_once_and_all_of_them_in_the_end(log, expected, tmp_path):
    data = log.read_bytes()
    growing, out = tmp_path / "growing.csv", tmp_path / "out.csv"
    half = data.index(b"\n", len(data) // 2) - 5
    growing.write_bytes(data[:half])
    argv = [*COMMAND, str(growing), "--follow", *TARE, "-o", str(out)]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        wait_for(lambda: out.is_file() and out.read_bytes().count(b"\n") > 1900)
        assert expected.startswith(out.read_bytes())
        with growing.open("ab") as stream:
            stream.write(data[half:])
        wait_for(lambda: len(out.read_bytes()) == len(expected))
        process.send_signal(signal.SIGINT)
        printed, said = process.communicate(timeout=PATIENCE_S)
    assert process.returncode == 0, said
    assert out.read_bytes() == expected
    assert b"axial force" in printed
    assert said == b""


def test_following_ends_by_itself_when_nothing_comes(log, expected, tmp_path, capsys):
    out = tmp_path / "out.csv"
    assert main([str(log), "--follow", "--idle", "0.3", *TARE, "-o", str(out)]) == 0
    assert out.read_bytes() == expected
    assert "axial force" in capsys.readouterr().out


@pytest.fixture
def interrupted_after_first_rows(monkeypatch):
    """Ctrl-C while the first rows are estimated."""
    run = replay.Replay.run

    def run_and_interrupt(self, signals):
        os.kill(os.getpid(), signal.SIGINT)
        return run(self, signals)

    monkeypatch.setattr(replay.Replay, "run", run_and_interrupt)


@pytest.mark.usefixtures("interrupted_after_first_rows")
@pytest.mark.parametrize("suffix", ["csv", "npz"])
def test_ctrl_c_keeps_what_was_done(log, tmp_path, capsys, suffix):
    path = tmp_path / f"out.{suffix}"
    assert main([str(log), *TARE, "-o", str(path)]) == 130
    printed = capsys.readouterr()
    assert "interrupted: the results are those of the rows read so far" in printed.err
    assert "tare         none" in printed.out
    rows = len(read_table(path).columns["t_s"])
    assert 0 < rows < 4000
    assert list(tmp_path.iterdir()) == [path]


def test_ctrl_c_before_there_is_a_log_is_an_interruption(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    argv = [*COMMAND, str(pipe), "--no-tare"]
    process = subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    # Opening waits until the command has opened it too.
    with process, pipe.open("wb") as stream:
        stream.write(b"t,q1\n")
        stream.flush()
        process.send_signal(signal.SIGINT)
        printed, said = process.communicate(timeout=PATIENCE_S)
    assert (process.returncode, printed, said) == (130, b"", b"interrupted\n")


def test_a_reader_that_goes_away_ends_the_command_quietly(log):
    argv = [*COMMAND, str(log), "--no-tare", "-o", "-"]
    with subprocess.Popen(argv, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as process:
        assert process.stdout.readline().startswith(b"t_s,travel_m,")
        process.stdout.close()
        said = process.stderr.read()
    assert process.returncode == 141
    assert said == b""


@pytest.mark.skipif(not Path("/dev/full").exists(), reason="the system has no /dev/full")
@pytest.mark.parametrize("output", [[], ["-o", "-"]])
def test_a_full_disk_is_told(log, output):
    with open("/dev/full", "wb") as full:
        done = subprocess.run(
            [*COMMAND, str(log), "--no-tare", *output],
            stdout=full,
            stderr=subprocess.PIPE,
            check=False,
        )
    assert done.returncode == 2
    (line,) = done.stderr.splitlines()
    assert line == b"error: cannot write standard output: No space left on device"


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", b"standard input: it is empty"),
        (b"\n\n", b"standard input: it is empty"),
        (bytes(range(256)) * 20, b"standard input: it is not text"),
        (b"t,q1,tau1\n", b"a header but no rows"),
        (b"t,f\n0,1\n1,2\n", b"no column found for q"),
    ],
)
def test_standard_input_without_a_log_is_one_clear_line(data, message):
    done = run_piped(data, "--no-tare", "-o", "-")
    assert (done.returncode, done.stdout) == (2, b"")
    (line,) = done.stderr.splitlines()
    assert line.startswith(b"error: ")
    assert message in line


def test_the_log_is_not_overwritten(log, capsys):
    before = log.read_bytes()
    assert main([str(log), "-o", str(log)]) == 2
    assert "it is the log itself" in capsys.readouterr().err
    assert log.read_bytes() == before


def test_a_whole_file_that_fails_leaves_the_old_table_a_stream_what_it_gave(lwr, tmp_path, capsys):
    early = write_insertion(tmp_path / "early.csv", lwr, contact_s=1.0)
    out = tmp_path / "out.csv"
    out.write_text("old\n1\n")
    assert main([str(early), *TARE, "-o", str(out)]) == 2
    assert out.read_text() == "old\n1\n"
    assert main([str(early), "--follow", "--idle", "0.1", *TARE, "-o", str(out)]) == 2
    assert "--force-tare" in capsys.readouterr().err
    columns = read_table(out).columns
    assert 1000 < len(columns["t_s"]) <= 2500
    assert columns["force_status"].min() == 1


def test_a_window_beyond_the_log_is_told_when_the_log_has_ended(lwr, tmp_path, capsys):
    path = write_insertion(tmp_path / "short.csv", lwr, seconds=1.2, contact_s=9.0)
    out = tmp_path / "out.csv"
    assert main([str(path), "--tare", "0.6:5", "-o", str(out)]) == 2
    assert "lies outside the log, which runs from 0 to 1.199 s" in capsys.readouterr().err
    assert not out.exists()
    assert main([str(path), "--tare=-3:-1", "-o", str(out)]) == 2
    assert "lies outside the log, which starts at 0 s; expected" in capsys.readouterr().err


def test_stamps_in_another_unit_are_told_and_no_tare_is_blamed(lwr, tmp_path, capsys):
    columns = insertion(lwr, seconds=1.2)
    columns["t_s"] = 1_700_000_000_000_000_000 + np.rint(1e9 * columns["t_s"]).astype(np.int64)
    write_table(tmp_path / "log.npz", {"time": columns.pop("t_s"), **columns})
    assert main([str(tmp_path / "log.npz"), "--tare", "+0:+1"]) == 2
    told = capsys.readouterr().err
    assert "if the file is in ns, say unit = 'ns'" in told
    assert "--tare +0:+1 does not fit the log, whose first stamp is 1.7e+18 s" in told


def test_a_transposed_array_is_told(lwr, tmp_path, capsys):
    columns = insertion(lwr)
    write_table(tmp_path / "log.npz", columns)
    np.savez(tmp_path / "log.npz", **{name: values.T for name, values in columns.items()})
    assert main([str(tmp_path / "log.npz"), "--no-tare"]) == 2
    told = capsys.readouterr().err
    assert "t_s 2048 or more, q_rad 7" in told
    assert "q_rad has 7 rows of 4000: is it transposed?" in told


def test_the_picture_of_a_long_log_keeps_its_spikes(lwr, tmp_path, monkeypatch):
    pytest.importorskip("matplotlib")
    columns = insertion(lwr, seconds=4.0)
    path = tmp_path / "log.npz"
    write_table(path, columns)
    monkeypatch.setattr("recordings.command.row_overview.RowOverview.__init__.__defaults__", (400,))
    drawn = []
    monkeypatch.setattr(
        "needleforce.cli.force.save_picture",
        lambda png, result: (drawn.append(result), save_picture(png, result)),
    )
    argv = [str(path), *TARE, "-o", str(tmp_path / "out.npz"), "--png", str(tmp_path / "f.png")]
    assert main(argv) == 0
    table, overview = read_table(tmp_path / "out.npz").columns, drawn[0].overview
    assert len(overview.t_s) <= 400
    for least in (np.min, np.max):
        assert least(overview.axial_N) == least(table["axial_N"])
    assert overview.t_s[0] == table["t_s"][0]
    assert set(overview.status) == set(table["force_status"].astype(int))
    assert (tmp_path / "f.png").read_bytes().startswith(b"\x89PNG")
