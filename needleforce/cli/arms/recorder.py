"""Joint signals into a file, from a process of its own: the loop that hands them over
never waits.

Fifty samples take a bag some milliseconds to write, more than the millisecond in which
an arm wants its answer.
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

from needleforce.cli.terminal import CommandError
from needleforce.devices import ArmReading
from needleforce.recordings.output import check_writable, open_table
from needleforce.recordings.table import TableLabels

CHUNK = 50  # Samples written at a time


COLUMNS = {
    "q_rad": "q_rad",
    "dq_rad_s": "dq_rad_s",
    "tau_Nm": "tau_Nm",
    "external_Nm": "tau_ext_Nm",
    "current_A": "current_A",
}
"""Columns of a recording, by the fields of `ArmReading`; those that are None are left
out."""


class Recorder:
    """A recording that is written while samples come; for the ``with`` statement.

    Whatever goes wrong in its process is raised by `put` or at the end.

    Attributes:
        rows: Samples that it was given.
        time_s: Time stamp of the last one: the first has 0.

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
        self._pipe, self._other = context.Pipe(duplex=False)
        given = (self._queue, self._other, path, joint_names)
        self._process = context.Process(target=_write, args=given)

    def put(self, sample: ArmReading) -> None:
        """Take a sample; it takes microseconds."""
        fields = [field for field in COLUMNS if getattr(sample, field) is not None]
        if self.rows and fields != self._fields:
            raise CommandError(
                f"samples had {self._fields}, one has {fields}: expected the same"
            )
        self._fields = fields
        self.time_s += sample.dt_s if self.rows else 0.0
        self.rows += 1
        self._chunk.append((self.time_s, sample))
        if len(self._chunk) == CHUNK:
            self._hand_over()
            if self._pipe.poll():
                self._raise()

    def _raise(self) -> None:
        """Raise what was wrong in the process, if anything was."""
        try:
            error = self._pipe.recv()
        except EOFError:
            error = CommandError("the process that writes the recording has ended")
        if error is not None:
            raise error

    def _hand_over(self) -> None:
        if self._chunk:
            times, samples = zip(*self._chunk, strict=True)
            self._chunk = []
            columns: dict[str, Any] = {"t_s": np.array(times)}
            for field in self._fields:
                columns[COLUMNS[field]] = np.array(
                    [getattr(each, field) for each in samples]
                )
            self._queue.put(columns)

    def __enter__(self) -> Self:
        # Signals are for the loop, which then ends the process: it inherits that they
        # are blocked.
        ours = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
        before = signal.pthread_sigmask(signal.SIG_BLOCK, ours)
        try:
            self._process.start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)
        self._other.close()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._queue.cancel_join_thread()  # Else a writer that died would hold this process.
        try:
            self._hand_over()
            self._queue.put(None)
            self._process.join()
        finally:
            self._process.kill()
            self._process.join()
        if kind is None:
            self._raise()


def leave_real_time() -> None:
    """Go on with ordinary priority: a child inherits the loop's, and would take the
    loop's time.
    """
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))


def _write(
    queue: Any, pipe: Connection, path: Path, joint_names: tuple[str, ...]
) -> None:
    """The process: into the pipe goes None when all is written, or what was wrong."""
    leave_real_time()
    parent = multiprocessing.parent_process()
    wrong = None
    try:
        with open_table(
            path, is_live=True, labels=lambda: TableLabels(joint_names=joint_names)
        ) as to:
            while parent is not None and parent.is_alive():
                try:
                    columns = queue.get(timeout=1.0)
                except Empty:
                    continue
                if columns is None:
                    break
                to.append(columns)
    except Exception as error:
        wrong = error
    with suppress(OSError):  # Where the loop was killed nobody listens.
        pipe.send(wrong)
