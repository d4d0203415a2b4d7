"""An arm's samples in a recording, whatever ends it; and what a lost arm looks like."""

import itertools
import re
import resource
import signal
import socket
import subprocess
import sys
import time
from contextlib import ExitStack, suppress
from functools import partial

import numpy as np
import pytest

from needleforce import Recorder, RecorderError
from needleforce.cli import main
from needleforce.devices import ArmReading, Emulator, FriArm, FriSettings, emulate_fri
from needleforce.recordings import FileAccessError, RecordingError, read_log
from tests.needleforce.devices.scripted_arms import lwr_measurement

SIGNAL = np.linspace(-1.0, 1.0, 7)
SAMPLE = ArmReading(1e-3, SIGNAL, None, SIGNAL, None, 0, accepts_commands=False)
SUFFIXES = ["csv", "mcap", "parquet", "npz"]


def put_all(recorder, samples):
    """Record samples."""
    with recorder:
        for sample in samples:
            recorder.put(sample)


@pytest.fixture
def arms(monkeypatch):
    """The arms that commands open: 2000 measurements are sent to each, then none."""
    opened = []
    rows = SIGNAL[None]
    with ExitStack() as controllers:

        def open_arm(*address, **settings):
            arm = FriArm(*address, **settings, give_up_s=0.6)
            opened.append(arm)
            port = arm.address.port
            sent = FriSettings(port=port, q_rad=rows, tau_Nm=rows, cycles=2000)
            controllers.enter_context(Emulator(emulate_fri, sent))
            return arm

        monkeypatch.setattr("needleforce.devices.arm_names.FriArm", open_arm)
        yield opened


@pytest.mark.slow
@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_lost_arm_is_an_error_and_the_recording_kept(suffix, arms, tmp_path, capsys):
    path = tmp_path / f"x.{suffix}"
    assert main(["record", "fri:0", "-o", str(path)]) == 2
    said = capsys.readouterr().err.splitlines()
    log = read_log(path)

    assert "silent 0.1 s" in said
    assert "silent for 0.6 s" in said[-1]
    assert "0.6" in str(arms[0].report)
    assert f"{log.t_s[-1] - log.t_s[0]:.3f} s" in said[-1]
    assert len(log) == arms[0].report.used >= 300
    assert np.allclose(log.channels["tau_Nm"], SIGNAL)


@pytest.mark.slow
@pytest.mark.usefixtures("arms")
def test_live_says_silence_at_once_and_ends_with_an_error(capsys):
    assert main(["live", "fri:0"]) == 2
    said = capsys.readouterr().err.splitlines()

    assert "silent 0.1 s" in said
    assert "silent for 0.6 s" in said[-1]
    assert "s the longest gap" in said[-1]


@pytest.mark.slow
@pytest.mark.parametrize("command", ["record", "live"])
def test_an_arm_that_never_sends_is_an_error(command, tmp_path, capsys, monkeypatch):
    hasty = partial(FriArm, give_up_s=0.6)
    monkeypatch.setattr("needleforce.devices.arm_names.FriArm", hasty)
    to = ["-o", str(tmp_path / "x.csv")] if command == "record" else []

    assert main([command, "fri:0", *to]) == 2
    assert "127.0.0.1" in capsys.readouterr().err.splitlines()[-1]
    assert list(tmp_path.iterdir()) == []


def rows_of(path):
    """How many rows a recording has while it is written; none before the first."""
    with suppress(RecordingError, OSError, ValueError):
        return len(read_log(path))
    return 0


@pytest.mark.slow
@pytest.mark.parametrize(
    ("end", "suffix", "silent_s"),
    [
        (signal.SIGINT, "mcap", 0.5),
        (signal.SIGTERM, "csv", 0.0),
        (signal.SIGHUP, "mcap", 0.0),
        (signal.SIGKILL, "csv", 1.5),  # a busy machine writes later
        (signal.SIGKILL, "mcap", 1.5),
    ],
)
def test_a_recording_that_is_ended_keeps_what_has_come(tmp_path, end, suffix, silent_s):
    path = tmp_path / f"x.{suffix}"
    with FriArm(port=0) as free:
        port = free.address.port
    command = [sys.executable, "-m", "needleforce", "record", f"fri:{port}"]
    process = subprocess.Popen(
        [*command, "-o", str(path)],
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )
    answered = 0
    with socket.socket(type=socket.SOCK_DGRAM) as box:
        box.settimeout(1e-3)
        # On a busy machine the command needs a minute.
        end_s = time.monotonic() + 160.0
        for count in itertools.count():
            box.sendto(lwr_measurement(count), ("127.0.0.1", port))
            with suppress(OSError):  # nobody listens yet
                box.recv(2048)
                answered += 1
            if answered >= 600 or time.monotonic() > end_s:
                break
    time.sleep(silent_s)
    process.send_signal(end)
    said = process.communicate()[1]
    is_killed = end == signal.SIGKILL

    assert process.returncode == (-signal.SIGKILL if is_killed else 0)
    assert (f" s in {path}" in said) != is_killed
    assert rows_of(path) >= 550


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_a_full_disk_is_an_error_and_a_growing_recording_kept(tmp_path, suffix):
    path = tmp_path / f"x.{suffix}"
    old_limits = resource.getrlimit(resource.RLIMIT_FSIZE)
    old_handler = signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    recorder = Recorder(path, ("a",) * 7)
    random = np.random.default_rng(0)
    try:
        resource.setrlimit(resource.RLIMIT_FSIZE, (200_000, old_limits[1]))
        with pytest.raises(FileAccessError) as caught:
            put_all(
                recorder,
                (
                    SAMPLE._replace(q_rad=q_rad, tau_Nm=q_rad)
                    for q_rad in random.normal(size=(5000, 7))
                ),
            )
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, old_limits)
        signal.signal(signal.SIGXFSZ, old_handler)

    assert path.exists() == (suffix in ("csv", "mcap"))
    if path.exists():
        written_s = float(re.findall(r"([\d.]+) s\b", str(caught.value))[0])
        assert 1e-3 * rows_of(path) == pytest.approx(written_s, abs=0.05)
        assert rows_of(path) > 200


def test_a_recorder_refuses_signals_that_come_and_go(tmp_path):
    path = tmp_path / "x.csv"
    recorder = Recorder(path, ("a",) * 7)

    with pytest.raises(RecorderError, match="tau_Nm"):
        put_all(recorder, [*[SAMPLE] * 70, SAMPLE._replace(tau_Nm=None)])

    assert len(read_log(path)) == recorder.rows == 70
    assert recorder.time_s == pytest.approx(0.069)


def test_a_recorder_that_cannot_write_says_why(tmp_path):
    with pytest.raises(FileAccessError, match=r"x\.txt"):
        Recorder(tmp_path / "x.txt", ())

    interval_s = sys.getswitchinterval()
    recorder = Recorder(tmp_path / "x.csv", ("a",) * 7)
    (tmp_path / "x.csv").mkdir()
    with pytest.raises(FileAccessError, match=r"x\.csv"):
        put_all(recorder, [SAMPLE])

    assert sys.getswitchinterval() == interval_s


@pytest.mark.parametrize("suffix", SUFFIXES)
def test_an_older_recording_is_refused_before_the_arm_is_waited_for(
    tmp_path, capsys, suffix
):
    path = tmp_path / f"x.{suffix}"
    path.write_text("measured once")

    assert main(["record", "fri:0", "-o", str(path), "--seconds", "30"]) == 2
    assert path.read_text() == "measured once"
    assert "--overwrite" in capsys.readouterr().err


def test_an_older_recording_is_overwritten_if_asked(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("measured once")
    put_all(Recorder(path, ("a",) * 7, overwrites=True), [SAMPLE] * 2)

    assert len(read_log(path)) == 2


@pytest.mark.parametrize("suffix", ["csv", "mcap"])
def test_a_file_that_turns_up_before_the_first_sample_stays(tmp_path, suffix):
    path = tmp_path / f"x.{suffix}"
    recorder = Recorder(path, ("a",) * 7)
    path.write_text("of another program")
    with pytest.raises(FileAccessError, match="exists"):
        put_all(recorder, [SAMPLE] * 100)

    assert path.read_text() == "of another program"
