"""A recording written by a process of its own: the loop with the arm never waits.

    with Recorder(Path("arm.mcap"), robot.joint_names) as recorder:
        for sample in arm:
            recorder.put(sample)

Fifty samples take a bag some milliseconds to write, more than the millisecond in which
an arm needs its answer.
"""

import multiprocessing
import os
import signal
import threading
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from multiprocessing.connection import Connection
from pathlib import Path
from queue import SimpleQueue
from typing import Any, Self

import numpy as np

from foundation.errors import NeedleforceError
from needleforce.devices import ArmReading
from needleforce.recordings.output import check_writable, open_table
from needleforce.recordings.table import TableLabels
from needleforce.recordings.writers import WRITERS, csv_writer

COLUMNS = {
    "q_rad": "q_rad",
    "dq_rad_s": "dq_rad_s",
    "tau_Nm": "tau_Nm",
    "external_Nm": "tau_ext_Nm",
    "current_A": "current_A",
}
"""Columns of a recording, by the fields of `ArmReading`; those that are None have no
column."""

Chunks = SimpleQueue[dict[str, Any] | None]
"""Columns that wait to be sent; None after the last."""

NO_LABELS = TableLabels()
"""Of a recording that does not show the arm."""


class RecorderError(NeedleforceError, RuntimeError):
    """A recording that cannot go on; what was put before is in its file."""


class Recorder:
    """A recording that is written while samples come; for the ``with`` statement.

    Whatever goes wrong in its process is raised by `put` or at the end.

    Args:
        path: The recording.
        joint_names: Names of the joints, in the order of the signals.
        labels: What else a bag carries; by default nothing.
        overwrites: Whether a file that is there is replaced.

    Attributes:
        rows: Samples that were put into it.
        time_s: Time stamp of the latest sample [s]; the first has 0.

    Raises:
        needleforce.recordings.FileAccessError: The file cannot be written, or is there.
    """

    def __init__(
        self,
        path: Path,
        joint_names: tuple[str, ...],
        labels: TableLabels = NO_LABELS,
        *,
        overwrites: bool = False,
    ) -> None:
        check_writable(path, overwrites=overwrites)
        self.rows = 0
        self.time_s = 0.0
        self._chunk: list[tuple[float, ArmReading]] = []
        self._fields: list[str] = []
        context = multiprocessing.get_context("spawn")
        self._writers_rows, self._rows_pipe = context.Pipe(duplex=False)
        self._answers, self._writers_answers = context.Pipe(duplex=False)
        written = replace(labels, joint_names=joint_names)
        arguments = (
            self._writers_rows,
            self._writers_answers,
            path,
            written,
            overwrites,
        )
        self._process = context.Process(target=_write, args=arguments)
        self._waiting: Chunks = SimpleQueue()
        self._sender = threading.Thread(
            target=_send_waiting, args=(self._waiting, self._rows_pipe), daemon=True
        )
        with suppress(ImportError, AttributeError, OSError):  # only Linux has it
            import fcntl

            # Rows that wait in this process die with it, those in the pipe do not: it
            # holds 6 s of 1 kHz, where the usual 64 KiB hold 0.4 s.
            fcntl.fcntl(self._rows_pipe, fcntl.F_SETPIPE_SZ, 1 << 20)

    def put(self, sample: ArmReading) -> None:
        """Take a sample, in microseconds."""
        fields = [field for field in COLUMNS if getattr(sample, field) is not None]
        if self.rows and fields != self._fields:
            raise RecorderError(
                f"samples had {self._fields}, one has {fields}, expected the same",
                "Check that the arm runs, and sends the same signals in every sample.",
            )
        self._fields = fields
        self.time_s += sample.dt_s if self.rows else 0.0
        self.rows += 1
        self._chunk.append((self.time_s, sample))
        # What has not been handed over is lost if this process is killed.
        max_held_s = 0.05
        held_s = self.time_s - self._chunk[0][0] + sample.dt_s
        if held_s > max_held_s - 0.5 * sample.dt_s:
            self._hand_over()
            if self._answers.poll():
                self._take_answer()

    def _take_answer(self) -> None:
        """Wait for the writing process; raise its error, if it had one."""
        try:
            error = self._answers.recv()
        except EOFError:
            error = RecorderError(
                "the process that writes the recording has ended",
                "Make room on the disk, or give another place.",
            )
        if error is not None:
            raise error

    def _hand_over(self) -> None:
        """Send the samples that were put to the writing process."""
        if not self._chunk:
            return
        times_s, samples = zip(*self._chunk, strict=True)
        self._chunk = []
        columns: dict[str, Any] = {"t_s": np.array(times_s)}
        for field in self._fields:
            columns[COLUMNS[field]] = np.array(
                [getattr(sample, field) for sample in samples]
            )
        self._waiting.put(columns)

    def __enter__(self) -> Self:
        # A row that the arm has been answered for before the writing process runs
        # would be lost if this process were killed.
        # Signals are for the loop, which then ends the process: it inherits that they
        # are blocked.
        signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
        try:
            self._process.start()
            self._sender.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        # The writing process alone holds these ends: it meets the end of the other when
        # this process is gone, and this process when that one is.
        self._writers_rows.close()
        self._writers_answers.close()
        try:
            self._take_answer()
        except BaseException:
            self._end_process()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        try:
            self._hand_over()
            self._waiting.put(None)
            self._process.join()
        finally:
            self._end_process()
        if kind is None:
            self._take_answer()

    def _end_process(self) -> None:
        """End the writing process, unless it has ended."""
        self._process.kill()
        self._process.join()


def _send_waiting(waiting: Chunks, pipe: Connection) -> None:
    """Send what waits to the writing process until None comes, or that process ends."""
    with pipe, suppress(OSError):
        while (columns := waiting.get()) is not None:
            pipe.send(columns)


def leave_real_time() -> None:
    """Go on with ordinary priority.

    A child inherits the priority of the loop, and would take the loop's time.
    """
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _received(rows: Connection) -> Iterator[dict[str, Any]]:
    """Yield what comes through a pipe until its other end is closed.

    Where the loop was killed that may be within a chunk, which is left out.
    """
    with suppress(EOFError, OSError):
        while True:
            yield rows.recv()


def _load_writer(path: Path, labels: TableLabels) -> None:
    """Import what the format needs, by writing a row that is thrown away.

    It takes a second, in which the rows of an arm would wait in the killed process.
    """
    row = {"t_s": np.zeros(1), "q_rad": np.zeros((1, len(labels.joint_names)))}
    writer = WRITERS.get(path.suffix.lower(), csv_writer)  # to standard output: CSV
    with writer(BytesIO(), labels, row) as append:
        append(row)


def _write(
    rows: Connection,
    answers: Connection,
    path: Path,
    labels: TableLabels,
    overwrites: bool,
) -> None:
    """Write rows until the other end of their pipe is closed; runs in its own process.

    Into the other pipe go None when it is ready, then None when all is written or the
    error.
    """
    leave_real_time()
    failure: Exception | None = None
    try:
        _load_writer(path, labels)
        with open_table(
            path, is_live=True, overwrites=overwrites, labels=lambda: labels
        ) as table:
            answers.send(None)
            for columns in _received(rows):
                table.append(columns)
    except Exception as error:
        failure = error
    with suppress(OSError):  # Where the loop was killed nobody listens.
        answers.send(failure)
