"""Joint signals into a file, from a process of its own: the loop that hands them over never waits.

Fifty samples take a bag some milliseconds to write, more than the millisecond in which an arm wants
its answer.
"""

import multiprocessing
import os
import signal
from contextlib import suppress
from multiprocessing.connection import Connection
from pathlib import Path
from queue import Empty
from types import TracebackType
from typing import Any, Self

import numpy as np

from needleforce.cli.terminal import CommandError
from needleforce.devices import ArmSample
from needleforce.recordings.output import check_writable, open_table
from needleforce.recordings.table import Labels

CHUNK = 50  # Samples written at a time
END_s = 60.0  # For what is still to be written when the samples end
COLUMNS = {
    "q_rad": "q_rad",
    "dq_rad_s": "dq_rad_s",
    "tau_Nm": "tau_Nm",
    "external_Nm": "tau_ext_Nm",
    "current_A": "current_A",
}
"""Columns of a recording, by the fields of `ArmSample`; those that are None are left out."""


class Recorder:
    """A recording that is written while samples come; for the ``with`` statement.

    Attributes:
        rows: Samples that it was given.
        time_s: Time stamp of the last one: the first has 0.
    """

    def __init__(self, path: Path, joint_names: tuple[str, ...]) -> None:
        """Start the process; the file is not touched before there are samples.

        Raises:
            needleforce.recordings.RecordingError: The file cannot be written. Whatever goes wrong
                later is raised by `put` or at the end.
        """
        check_writable(path)
        self.rows, self.time_s = 0, 0.0
        self._chunk: list[tuple[float, ArmSample]] = []
        context = multiprocessing.get_context("spawn")
        self._queue, (self._pipe, other) = context.Queue(), context.Pipe(duplex=False)
        given = (self._queue, other, path, joint_names)
        self._process = context.Process(target=_write, args=given)
        self._process.start()
        other.close()

    def put(self, sample: ArmSample) -> None:
        """Take a sample; it takes microseconds."""
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
            columns: dict[str, Any] = {"t_s": np.array(times)}
            for field, name in COLUMNS.items():
                values = [getattr(sample, field) for sample in samples]
                if values[0] is not None:
                    columns[name] = np.array(values)
            self._queue.put(columns)
            self._chunk = []

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: object, trace: TracebackType | None
    ) -> None:
        self._hand_over()
        self._queue.put(None)
        self._queue.cancel_join_thread()  # Else a writer that died would hold this process.
        is_over = self._pipe.poll(END_s)
        self._process.kill()
        self._process.join()
        if kind is None:
            if not is_over:
                raise CommandError(f"the recording was not written within {END_s:g} s")
            self._raise()


def _write(queue: Any, pipe: Connection, path: Path, joint_names: tuple[str, ...]) -> None:
    """The process: into the pipe goes None when all is written, or what was wrong."""
    with suppress(OSError, AttributeError):  # Real-time priority is the loop's alone.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.SIG_IGN)  # They are for the loop, which ends this one.
    parent, is_over, wrong = multiprocessing.parent_process(), False, None
    try:
        with open_table(path, is_live=True, labels=lambda: Labels(joint_names=joint_names)) as to:
            while not is_over:
                with suppress(Empty):
                    columns = queue.get(timeout=1.0)
                    is_over = columns is None
                    if not is_over:
                        to.append(columns)
                    continue
                is_over = parent is None or not parent.is_alive()
    except Exception as error:
        wrong = error
    with suppress(OSError):  # Where the loop was killed nobody listens.
        pipe.send(wrong)
