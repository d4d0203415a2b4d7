"""Commands on pipes and growing files, and what signals, full disks and gone readers
leave."""

import contextlib
import os
import signal
import subprocess
import sys
import threading
import time
from pathlib import Path

import numpy as np
import pytest

from groundtruth import insert_needle
from identification.log_replay import ReplayStream
from needleforce.cli import main
from needleforce.cli.terminal import run_command, stop_request
from needleforce.files import whole_file
from needleforce.recordings import read_table, write_table
from needleforce.sensor_replay import SensorReplay
from tests.needleforce.cli.residual_command_log import refusal, write_insertion
from tests.needleforce.recordings.bag_samples import grow, in_pieces

PROGRAM = [sys.executable, "-m", "needleforce"]
OPTIONS = {"force": ["--tare", "0:2.5"], "identify": []}
FIRST_COLUMNS = {"force": b"t_s,travel_m,", "identify": b"t_s,enhanced_force_N,"}
SUMMARY = {"force": "axial force", "identify": "friction N"}
PATIENCE_S = 60.0


@pytest.fixture(scope="module")
def logs(lwr, tmp_path_factory):
    """A log for each command, one of them without the speed that is then derived."""
    folder = tmp_path_factory.mktemp("log")
    run = insert_needle("gel-50-constant", seed=1, rate_hz=150.0)
    names = ("t_s", "depth_m", "force_N", "speed_m_s")
    whole = {name: getattr(run, name) for name in names}
    rows = slice(
        *np.searchsorted(run.t_s, (run.tare_end_s, run.truth.rupture_s[0] + 4.0))
    )
    columns = {name: values[rows] for name, values in whole.items()}
    write_table(folder / "whole.csv", whole)
    write_table(folder / "identify.csv", columns)
    write_table(folder / "derived.csv", {name: columns[name] for name in names[:3]})
    write_insertion(folder / "force.csv", lwr)
    return folder


@pytest.fixture(scope="module", params=["force", "identify", "derived"])
def case(request, logs):
    """A command with its log, and what it writes for the whole file."""
    name = "identify" if request.param == "derived" else request.param
    path = logs / f"{request.param}.csv"
    table = logs / f"{request.param}-expected.csv"
    assert main([name, str(path), *OPTIONS[name], "-o", str(table)]) == 0
    return name, path, table.read_bytes()


def wait_for(condition):
    until = time.monotonic() + PATIENCE_S
    while not condition():
        assert time.monotonic() < until
        time.sleep(0.05)


@contextlib.contextmanager
def start(*argv):
    command = [*PROGRAM, *map(str, argv)]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdout=pipe, stderr=pipe) as process:
        try:
            yield process
        except BaseException:
            process.kill()  # else nobody would end it
            raise


def piped(name, data):
    argv = [*PROGRAM, name, "-", *OPTIONS[name], "-o", "-"]
    return subprocess.run(argv, input=data, capture_output=True, check=False)


@pytest.mark.slow
def test_pipes_give_the_bytes_of_the_file(case, tmp_path):
    name, path, expected = case
    process = piped(name, path.read_bytes())

    assert (process.returncode, process.stdout) == (0, expected), process.stderr
    assert SUMMARY[name].encode() in process.stderr

    (tmp_path / "table.csv").write_bytes(expected)
    written_s, logged_s = (
        read_table(p).columns["t_s"] for p in (tmp_path / "table.csv", path)
    )

    np.testing.assert_array_equal(written_s, logged_s)


@pytest.mark.slow
def test_output_never_replaces_its_own_standard_input(logs, tmp_path):
    log = tmp_path / "log.csv"
    write_table(log, read_table(logs / "force.csv").columns)
    content = log.read_bytes()
    argv = ["force", "-", *OPTIONS["force"], "-o", str(log)]
    with log.open("rb") as stream:
        process = subprocess.run(
            [*PROGRAM, *argv], stdin=stream, capture_output=True, check=False
        )

    assert (process.returncode, log.read_bytes() == content) == (2, True)

    message = f"cannot write {log}: it is the log itself."

    assert process.stderr.decode().startswith(f"error: {message}")


@pytest.mark.slow
def test_bag_may_grow_or_come_piped(logs, tmp_path):
    log, expected, out = (
        tmp_path / file for file in ("log.mcap", "expected.csv", "out.csv")
    )
    columns = read_table(logs / "identify.csv").columns
    write_table(log, dict(sorted(columns.items(), key=lambda item: -item[1].ndim)))

    assert main(["identify", str(log), "-o", str(expected)]) == 0

    data = log.read_bytes()
    process = piped("identify", data)

    assert (process.returncode, process.stdout) == (0, expected.read_bytes()), (
        process.stderr
    )

    writer = grow(tmp_path / "growing.mcap", in_pieces(data, 20), pause_s=0.05)
    argv = ["identify", str(tmp_path / "growing.mcap"), "--follow", "-o", str(out)]

    assert main(argv) == 0

    writer.join()

    assert out.read_bytes() == expected.read_bytes()


@pytest.mark.slow
def test_growing_file_gives_rows_at_once(logs, tmp_path):
    log = logs / "force.csv"
    growing = tmp_path / "growing.csv"
    out = tmp_path / "out.csv"
    whole = tmp_path / "whole.csv"

    assert main(["force", str(log), *OPTIONS["force"], "-o", str(whole)]) == 0

    data = log.read_bytes()
    expected = whole.read_bytes()
    half = data.index(b"\n", len(data) // 2) - 5
    growing.write_bytes(data[:half])
    with start("force", growing, "--follow", *OPTIONS["force"], "-o", out) as process:
        wait_for(lambda: out.is_file() and out.read_bytes().count(b"\n") > 1900)
        assert expected.startswith(out.read_bytes())
        with growing.open("ab") as stream:
            stream.write(data[half:])
        wait_for(lambda: len(out.read_bytes()) == len(expected))
        process.send_signal(signal.SIGINT)
        printed, said = process.communicate(timeout=PATIENCE_S)

    assert (process.returncode, said, b"axial force" in printed) == (0, b"", True)
    assert out.read_bytes() == expected


@pytest.mark.slow
def test_following_ends_by_itself_when_nothing_comes(case, tmp_path, capsys):
    name, path, expected = case
    out = tmp_path / "out.csv"
    argv = [
        name,
        str(path),
        "--follow",
        "--idle",
        "0.3",
        *OPTIONS[name],
        "-o",
        str(out),
    ]

    assert main(argv) == 0
    assert out.read_bytes() == expected
    assert SUMMARY[name] in capsys.readouterr().out


@pytest.fixture
def interrupted(monkeypatch):
    """Ctrl-C while the first rows are estimated."""
    for kind in (SensorReplay, ReplayStream):

        def run(self, *columns, before=kind.run):
            with contextlib.suppress(KeyboardInterrupt):  # of the second time
                signal.raise_signal(signal.SIGINT)
            return before(self, *columns)

        monkeypatch.setattr(kind, "run", run)


@pytest.mark.slow
@pytest.mark.usefixtures("interrupted")
@pytest.mark.parametrize(("name", "suffix"), [("force", "csv"), ("identify", "npz")])
def test_ctrl_c_keeps_rows_and_names_replaced_table(
    logs, tmp_path, capsys, name, suffix
):
    log = logs / {"force": "force.csv", "identify": "whole.csv"}[name]
    path = tmp_path / f"out.{suffix}"
    argv = [name, str(log), *OPTIONS[name], "-o", str(path)]

    assert main(argv) == 130

    printed = capsys.readouterr()

    assert "interrupted: the results are those of the rows read so far" in printed.err
    assert "replaced" not in printed.err

    outcome = {"force": "tare         none", "identify": "no rupture detected"}

    assert outcome[name] in printed.out

    rows = len(read_table(path).columns["t_s"])

    assert 0 < rows < len(read_table(log).columns["t_s"])
    assert list(tmp_path.iterdir()) == [path]
    assert main(argv) == 130

    replaced = f"{path} holds these rows only; the table that was there is replaced"

    assert replaced in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("kind", "code", "has_writer"),
    [(signal.SIGINT, 130, True), (signal.SIGTERM, 143, False)],
)
def test_signal_before_any_log_ends_the_command(
    tmp_path, capsys, kind, code, has_writer
):
    pipe = tmp_path / "pipe.csv"
    os.mkfifo(pipe)
    handle = os.open(pipe, os.O_RDWR) if has_writer else None
    with start("force", pipe, "--no-tare", "-o", tmp_path / "o.npz") as process:
        # Until the handlers are set and the pipe is open.
        wait_for(lambda: _is_open(process.pid, pipe))
        time.sleep(0.2)
        process.send_signal(kind)
        printed, said = process.communicate(timeout=PATIENCE_S)
    if handle is not None:
        os.close(handle)
    word = b"interrupted\n" if kind is signal.SIGINT else b"terminated\n"

    assert (process.returncode, printed, said) == (code, b"", word)
    assert [path.name for path in tmp_path.iterdir()] == ["pipe.csv"]

    if not has_writer:
        argv = ["force", str(pipe), "--no-tare", "--idle", "0.3"]
        assert "it is empty" in refusal(argv, capsys)


@pytest.mark.slow
def test_ctrl_c_ends_waiting_for_a_pipes_reader(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    with stop_request() as is_asked:
        threading.Timer(0.5, os.kill, (os.getpid(), signal.SIGINT)).start()
        with pytest.raises(KeyboardInterrupt), whole_file(tmp_path / "pipe"):
            pass
        assert not is_asked()


def _is_open(pid, path):
    with contextlib.suppress(OSError):
        return any(
            os.readlink(link) == str(path) for link in Path(f"/proc/{pid}/fd").iterdir()
        )
    return False


def test_sigterm_counts_whatever_error_a_library_raises(capsys):
    def work():
        with contextlib.suppress(BaseException):
            signal.raise_signal(signal.SIGTERM)
        raise SystemError("returned a result with an exception set")

    assert run_command(work) == 143
    assert capsys.readouterr().err == "terminated\n"


@pytest.mark.slow
@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_sigterm_leaves_only_the_older_table(logs, tmp_path, suffix):
    out = tmp_path / f"out.{suffix}"
    files = [out]
    for _ in range(5):  # on a busy machine it may be done before it is seen at work
        write_table(out, {"t_s": [1.0, 2.0], "force_N": [3.0, 4.0]})
        with start(
            "force", logs / "force.csv", *OPTIONS["force"], "-o", out
        ) as process:
            wait_for(
                lambda: (
                    sorted(tmp_path.iterdir()) != files or process.poll() is not None
                )
            )
            process.send_signal(signal.SIGTERM)
            _, said = process.communicate(timeout=PATIENCE_S)
        if process.returncode:
            break

    # The compiler may say before that it ignores what a signal raised in a callback of
    # its own.
    assert (process.returncode, said[-11:]) == (143, b"terminated\n")
    assert sorted(tmp_path.iterdir()) == files
    assert len(read_table(out).columns["t_s"]) == 2


@pytest.mark.slow
def test_failing_log_leaves_older_table_or_streamed_rows(lwr, tmp_path, capsys):
    early = write_insertion(tmp_path / "early.csv", lwr, contact_s=1.0)
    out = tmp_path / "out.csv"
    out.write_text("old\n1\n")
    argv = ["force", str(early), *OPTIONS["force"], "-o", str(out)]

    assert main(argv) == 2
    assert out.read_text() == "old\n1\n"
    assert main([*argv, "--follow", "--idle", "0.1"]) == 2
    assert "--force-tare" in capsys.readouterr().err

    columns = read_table(out).columns

    assert 1000 < len(columns["t_s"]) <= 2500
    assert columns["force_status"].min() == 1


@pytest.mark.slow
def test_vanished_reader_ends_the_command_quietly(case):
    name, path, _ = case
    with start(name, path, "-o", "-") as process:
        assert process.stdout.readline().startswith(FIRST_COLUMNS[name])
        process.stdout.close()
        said = process.stderr.read()

    assert (process.returncode, b"Traceback" in said, b"BrokenPipe" in said) == (
        141,
        False,
        False,
    )


@pytest.mark.slow
@pytest.mark.skipif(
    not Path("/dev/full").exists(), reason="the system has no /dev/full"
)
@pytest.mark.parametrize("output", [["-o", "-"], ["--help"]])
def test_full_disk_is_reported(logs, output):
    argv = [*PROGRAM, "force", str(logs / "force.csv"), "--no-tare", *output]
    with open("/dev/full", "wb") as full:
        process = subprocess.run(argv, stdout=full, stderr=subprocess.PIPE, check=False)

    assert process.returncode == 2

    (line,) = process.stderr.splitlines()

    assert line.startswith(b"error: ")
    assert b": cannot write standard output: No space left on device." in line
    assert b"Make room on the disk" in line or b"Check the name, the permiss" in line


@pytest.mark.parametrize(
    ("command", "data", "message"),
    [
        ("force", b"", "standard input: it is empty"),
        ("force", bytes(range(256)) * 20, "standard input: it is not text"),
        (
            "identify",
            b"PK\x03\x04\x00",
            "standard input is not an npz archive, or it is cut short",
        ),
        ("identify", b"\x89MCAP0\r\n", "standard input holds no messages"),
    ],
)
def test_standard_input_without_log_is_one_line(
    command, data, message, monkeypatch, tmp_path, capsys
):
    (tmp_path / "data").write_bytes(data)
    with (tmp_path / "data").open() as stream:
        monkeypatch.setattr(sys, "stdin", stream)
        assert message in refusal([command, "-", "-o", "-"], capsys)
