"""An arm's samples in a recording, written by a process of its own, whatever ends
it."""

import collections
import itertools
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from contextlib import suppress
from pathlib import Path

import pytest

from needleforce.cli import main
from needleforce.devices import ArmReading, FriArm
from needleforce.recorder import Recorder, RecorderError
from needleforce.recordings import FileAccessError, FormatError, read_log
from tests.needleforce.devices.test_links import PATIENCE_S, ROWS, measurement

pytestmark = pytest.mark.slow


@pytest.mark.parametrize(
    ("number", "sends"),
    [(signal.SIGINT, False), (signal.SIGTERM, True), (signal.SIGHUP, False)],
)
def test_a_signal_ends_recording_also_in_silence(
    number, sends, tmp_path, monkeypatch, capsys
):
    path = tmp_path / "x.mcap"

    class AskedArm(FriArm):
        """An arm that another thread has an end put to once it is listened to."""

        def __iter__(self):
            asking.start()
            yield from super().__iter__()

    arm = AskedArm(port=0, give_up_s=PATIENCE_S)
    old_handler = signal.signal(signal.SIGINT, signal.default_int_handler)

    def ask():
        with socket.socket(type=socket.SOCK_DGRAM) as box:
            end_s = time.monotonic() + PATIENCE_S
            count = 0
            while sends and arm.report.used <= 350 and time.monotonic() < end_s:
                count += 1
                box.sendto(measurement(count=count), arm.address)
                time.sleep(1e-3)

        if not sends:
            time.sleep(0.5)  # it waits in silence by then

        signal.pthread_kill(threading.main_thread().ident, number)

    asking = threading.Thread(target=ask)
    monkeypatch.setattr("needleforce.devices.arm_names.FriArm", lambda **_: arm)
    code = main(["record", "fri:0", "-o", str(path)])
    asking.join()
    signal.signal(signal.SIGINT, old_handler)

    assert code == (0 if sends else 2)
    assert (
        f" s in {path}" if sends else "error: no sample came from"
    ) in capsys.readouterr().err
    assert not sends or len(read_log(path)) == arm.report.used > 350


def test_a_recording_begins_with_what_comes_once_its_writer_is_ready(
    tmp_path, monkeypatch
):
    path = tmp_path / "x.csv"
    box = socket.socket(type=socket.SOCK_DGRAM)

    def send(counts, position_rad):
        for count in counts:
            packet = measurement(count=count, position_rad=position_rad)
            box.sendto(packet, arm.address)
            time.sleep(1e-3)

    class HeardArm(FriArm):
        """An arm that sends once it is listened to."""

        def __iter__(self):
            sending.start()
            yield from super().__iter__()

    class SlowRecorder(Recorder):
        """A recorder that gets ready while the arm sends."""

        def __enter__(self):
            send(range(114), 0.0)
            return super().__enter__()

    arm = HeardArm(port=0, give_up_s=0.5)
    sending = threading.Thread(target=send, args=(range(114, 314), 1.0))
    monkeypatch.setattr("needleforce.devices.arm_names.FriArm", lambda **_: arm)
    monkeypatch.setattr("needleforce.cli.arms.arm_recording.Recorder", SlowRecorder)

    assert main(["record", "fri:0", "-o", str(path)]) == 0

    sending.join()
    box.close()
    log = read_log(path)

    assert set(log.channels["q_rad"].ravel().tolist()) == {1.0}
    assert len(log) > 100


RECORDING = """
import multiprocessing, os, signal, sys, time
from pathlib import Path

import numpy as np

from needleforce.recorder import Recorder
from needleforce.devices import ArmReading

q_rad = np.zeros(7)
sample = ArmReading(1e-3, q_rad, q_rad, q_rad, q_rad, 0, accepts_commands=False)
if __name__ == "__main__":
    with Recorder(Path(sys.argv[1]), tuple("abcdefg")) as recorder:
        (writer,) = multiprocessing.active_children()
        os.kill(writer.pid, signal.SIGSTOP)
        for _ in range(2000):
            recorder.put(sample)
        time.sleep(0.5)  # the rows go into the pipe
        print(writer.pid, flush=True)
        time.sleep(60.0)
"""


@pytest.mark.parametrize("suffix", ["csv", "mcap", "parquet", "npz"])
def test_a_killed_recording_has_lost_a_tenth_of_a_second(tmp_path, suffix):
    """Also where its writer was two seconds late."""
    path = tmp_path / f"x.{suffix}"
    script = tmp_path / "script.py"
    script.write_text(RECORDING)
    process = subprocess.Popen(
        [sys.executable, str(script), str(path)],
        stdout=subprocess.PIPE,
        start_new_session=True,
    )
    writer = int(process.stdout.readline())
    process.kill()
    process.wait()
    os.kill(writer, signal.SIGCONT)
    end_s = time.monotonic() + PATIENCE_S
    while processes_of(process.pid) and time.monotonic() < end_s:
        time.sleep(0.05)

    assert processes_of(process.pid) == []
    assert len(read_log(path)) >= 1900


SAMPLE = ArmReading(1e-3, ROWS[0], None, ROWS[0], None, 0, accepts_commands=False)


def test_a_recorder_whose_process_dies_says_so(tmp_path):
    def samples():
        for process in multiprocessing.active_children():
            process.kill()
            process.join()

        yield from [SAMPLE] * 100

    recorder = Recorder(tmp_path / "x.csv", ("a",) * 7)

    with (
        pytest.raises(
            RecorderError, match="process that writes the recording has ended"
        ),
        recorder,
    ):
        collections.deque(map(recorder.put, samples()))

    assert recorder.rows == 50


def test_a_recorder_refuses_signals_that_come_and_go(tmp_path):
    path = tmp_path / "x.csv"
    samples = [*[SAMPLE] * 70, SAMPLE._replace(tau_Nm=None)]
    recorder = Recorder(path, ("a",) * 7)

    with pytest.raises(RecorderError, match="expected the same"), recorder:
        collections.deque(map(recorder.put, samples))

    assert len(read_log(path)) == recorder.rows == 70


def test_a_recorder_that_cannot_write_says_why(tmp_path):
    with pytest.raises(FileAccessError, match="no known suffix"):
        Recorder(tmp_path / "x.txt", ())

    recorder = Recorder(tmp_path / "x.csv", ())
    (tmp_path / "x.csv").mkdir()

    with pytest.raises(FileAccessError, match=r"cannot write .*x\.csv"), recorder:
        recorder.put(SAMPLE)


def count_rows(path):
    """How many rows a recording has while it is written; none before the first."""
    with suppress(FileAccessError, FormatError):
        return len(read_log(path))

    return 0


def processes_of(group):
    """Processes of a group that have not ended; zombies have."""
    running = []
    for stat in Path("/proc").glob("[0-9]*/stat"):
        with suppress(OSError):
            state, _, its_group = stat.read_text().rpartition(") ")[2].split()[:3]
            if int(its_group) == group and state != "Z":
                running.append(stat.parent.name)

    return running


def test_a_killed_recording_leaves_rows_but_no_process(tmp_path):
    path = tmp_path / "x.csv"
    with FriArm(port=0) as arm:
        address = arm.address  # a free port

    command = [sys.executable, "-m", "needleforce", "record", f"fri:{address.port}"]
    process = subprocess.Popen([*command, "-o", str(path)], start_new_session=True)
    answered = 0
    with socket.socket(type=socket.SOCK_DGRAM) as box:
        box.settimeout(1e-3)
        # Until rows are in the file: on a busy machine the command needs a minute.
        end_s = time.monotonic() + 8.0 * PATIENCE_S
        row_count = 0
        for count in itertools.count():
            box.sendto(measurement(count=count % 65536), address)
            with suppress(OSError):  # nobody listens yet
                box.recv(2048)
                answered += 1
                if answered % 50 == 0:
                    row_count = count_rows(path)

            if row_count >= 100 or time.monotonic() > end_s:
                break

    process.kill()
    process.wait()
    end_s = time.monotonic() + PATIENCE_S
    while processes_of(process.pid) and time.monotonic() < end_s:
        time.sleep(0.05)

    assert process.returncode == -signal.SIGKILL
    assert processes_of(process.pid) == []
    assert 100 <= row_count <= count_rows(path)


@pytest.mark.parametrize("suffix", [".csv", ".npz", ".parquet", ".mcap"])
def test_an_older_recording_is_refused_before_the_arm_is_waited_for(
    tmp_path, capsys, suffix
):
    path = tmp_path / f"x{suffix}"
    path.write_text("measured once")

    assert main(["record", "fri:0", "-o", str(path), "--seconds", "30"]) == 2
    assert path.read_text() == "measured once"

    said = capsys.readouterr().err

    assert f"{path} exists" in said
    assert "--overwrite" in said


def test_an_older_recording_is_overwritten_if_asked(tmp_path):
    path = tmp_path / "x.csv"
    path.write_text("measured once")
    with Recorder(path, ("a",) * 7, overwrites=True) as recorder:
        recorder.put(SAMPLE)
        recorder.put(SAMPLE)

    assert len(read_log(path)) == 2


def test_a_file_that_turns_up_before_the_first_sample_stays(tmp_path):
    path = tmp_path / "x.csv"
    recorder = Recorder(path, ("a",) * 7)

    def samples():
        path.write_text("of another program")
        yield from [SAMPLE] * 100

    with pytest.raises(FileAccessError, match="exists"), recorder:
        collections.deque(map(recorder.put, samples()))

    assert path.read_text() == "of another program"
