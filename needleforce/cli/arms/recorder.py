"""A recording written by a process of its own: the loop with the arm never waits.

Fifty samples take a bag some milliseconds to write, more than the millisecond in which
an arm needs its answer.
"""

import multiprocessing
import os
import signal
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty
from typing import Any, Self

import numpy as np

from needleforce.cli.terminal import CommandCode, CommandError
from needleforce.devices import ArmReading
from needleforce.recordings.output import check_writable, open_table
from needleforce.recordings.table import TableLabels

CHUNK = 50
"""Samples written at a time."""

POLL_S = 1.0
"""Time after which the process looks whether its parent still runs [s]."""

COLUMNS = {
    "q_rad": "q_rad",
    "dq_rad_s": "dq_rad_s",
    "tau_Nm": "tau_Nm",
    "external_Nm": "tau_ext_Nm",
    "current_A": "current_A",
}
"""Columns of a recording, by the fields of `ArmReading`; those that are None have no
column."""


class Recorder:
    """A recording that is written while samples come; for the ``with`` statement.

    Whatever goes wrong in its process is raised by `put` or at the end.

    Args:
        path: The recording.
        joint_names: Names of the joints, in the order of the signals.

    Attributes:
        rows: Samples that were put into it.
        time_s: Time stamp of the latest sample [s]; the first has 0.

    Raises:
        needleforce.recordings.FileAccessError: The file cannot be written.
    """

    def __init__(self, path: Path, joint_names: tuple[str, ...]) -> None:
        check_writable(path)
        self.rows = 0
        self.time_s = 0.0
        self._chunk: list[tuple[float, ArmReading]] = []
        self._fields: list[str] = []
        context = multiprocessing.get_context("spawn")
        self._queue = context.Queue()
        self._pipe, self._writers_pipe = context.Pipe(duplex=False)
        arguments = (self._queue, self._writers_pipe, path, joint_names)
        self._process = context.Process(target=_write, args=arguments)

    def put(self, sample: ArmReading) -> None:
        """Take a sample, in microseconds."""
        fields = [field for field in COLUMNS if getattr(sample, field) is not None]
        if self.rows and fields != self._fields:
            raise CommandError(
                f"samples had {self._fields}, one has {fields}, expected the same",
                CommandCode.ARM,
            )
        self._fields = fields
        self.time_s += sample.dt_s if self.rows else 0.0
        self.rows += 1
        self._chunk.append((self.time_s, sample))
        if len(self._chunk) == CHUNK:
            self._hand_over()
            if self._pipe.poll():
                self._raise_writers_error()

    def _raise_writers_error(self) -> None:
        """Raise the error of the writing process, if it had one."""
        try:
            error = self._pipe.recv()
        except EOFError:
            error = CommandError(
                "the process that writes the recording has ended", CommandCode.OUTPUT
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
        self._queue.put(columns)

    def __enter__(self) -> Self:
        # Signals are for the loop, which then ends the process: it inherits that they
        # are blocked.
        signals = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        mask = signal.pthread_sigmask(signal.SIG_BLOCK, signals)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, mask)
        self._writers_pipe.close()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        # Else a writer that died would hold this process.
        self._queue.cancel_join_thread()
        try:
            self._hand_over()
            self._queue.put(None)
            self._process.join()
        finally:
            self._process.kill()
            self._process.join()
        if kind is None:
            self._raise_writers_error()


def leave_real_time() -> None:
    """Go on with ordinary priority.

    A child inherits the priority of the loop, and would take the loop's time.
    """
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _write(
    queue: Any, pipe: Connection, path: Path, joint_names: tuple[str, ...]
) -> None:
    """Write what comes through the queue until None comes; runs in its own process.

    Into the pipe goes None when all is written, or the error.
    """
    leave_real_time()
    parent = multiprocessing.parent_process()
    failure: Exception | None = None
    try:
        with open_table(
            path, is_live=True, labels=lambda: TableLabels(joint_names=joint_names)
        ) as table:
            while parent is not None and parent.is_alive():
                try:
                    columns = queue.get(timeout=POLL_S)
                except Empty:
                    continue
                if columns is None:
                    break
                table.append(columns)
    except Exception as error:
        failure = error
    with suppress(OSError):  # Where the loop was killed nobody listens.
        pipe.send(failure)
