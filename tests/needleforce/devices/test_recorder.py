"""An arm's samples in a recording, written by a process of its own, whatever ends
it."""

import collections
import multiprocessing
import signal
import socket
import threading
import time

import pytest

from needleforce.cli import main
from needleforce.cli.arms.recorder import Recorder
from needleforce.cli.terminal import CommandError
from needleforce.devices import ArmReading, FriArm
from needleforce.recordings import FileAccessError, read_log
from tests.needleforce.devices.test_links import PATIENCE_S, ROWS, measurement


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("sends", [False, True])
def test_a_signal_ends_recording_also_in_silence(
    number, sends, tmp_path, monkeypatch, capsys
):
    path = tmp_path / "x.mcap"
    arm = FriArm(port=0, give_up_s=PATIENCE_S)
    old_handler = signal.signal(signal.SIGINT, signal.default_int_handler)

    def ask():
        with socket.socket(type=socket.SOCK_DGRAM) as box:
            for count in range(1, 701 if sends else 1):
                box.sendto(measurement(count=count), arm.address)
                time.sleep(1e-3)

        time.sleep(0.5)
        signal.pthread_kill(threading.main_thread().ident, number)

    asking = threading.Thread(target=ask)
    monkeypatch.setattr(
        "needleforce.cli.arms.arm_connection.FriArm", lambda **_: asking.start() or arm
    )
    code = main(["record", "fri:0", "-o", str(path)])
    asking.join()
    signal.signal(signal.SIGINT, old_handler)

    assert code == (0 if sends else 2)
    assert (
        f" s in {path}" if sends else "error NF-COMMAND-ARM: no sample came from"
    ) in capsys.readouterr().err
    assert not sends or len(read_log(path)) == arm.report.used > 350


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
            CommandError, match="process that writes the recording has ended"
        ),
        recorder,
    ):
        collections.deque(map(recorder.put, samples()))

    assert recorder.rows == 50


def test_a_recorder_refuses_signals_that_come_and_go(tmp_path):
    path = tmp_path / "x.csv"
    samples = [*[SAMPLE] * 70, SAMPLE._replace(tau_Nm=None)]
    recorder = Recorder(path, ("a",) * 7)

    with pytest.raises(CommandError, match="expected the same"), recorder:
        collections.deque(map(recorder.put, samples))

    assert len(read_log(path)) == recorder.rows == 70


def test_a_recorder_that_cannot_write_says_why(tmp_path):
    with pytest.raises(FileAccessError, match="no known suffix"):
        Recorder(tmp_path / "x.txt", ())

    recorder = Recorder(tmp_path / "x.csv", ())
    (tmp_path / "x.csv").mkdir()

    with pytest.raises(FileAccessError, match=r"cannot write .*x\.csv"), recorder:
        recorder.put(SAMPLE)
