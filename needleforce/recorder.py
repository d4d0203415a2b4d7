"""A recording written by a thread of its own: the loop with the arm never waits.

    with Recorder(Path("arm.mcap"), robot.joint_names) as recorder:
        for sample in arm:
            recorder.put(sample)

Fifty samples take a bag some milliseconds to write, more than the millisecond in which
an arm needs its answer.
"""

import os
import sys
from contextlib import suppress
from dataclasses import replace
from io import BytesIO
from pathlib import Path
from queue import SimpleQueue
from threading import Thread
from typing import Self

import numpy as np

from foundation.errors import NeedleforceError
from needleforce.devices import ArmReading
from needleforce.recordings.errors import FileAccessError
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

NO_LABELS = TableLabels()
"""Of a recording that does not show the arm."""


class RecorderError(NeedleforceError, RuntimeError):
    """A recording that cannot go on; what was put before is in its file."""


class Recorder:
    """A recording that is written while samples come; for the ``with`` statement.

    Whatever goes wrong in its thread is raised by `put` or at the end. A file of text
    (.csv) or a bag (.mcap) grows meanwhile; other kinds are written at the end.

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
        self._path = path
        self._labels = replace(labels, joint_names=joint_names)
        self._overwrites = overwrites
        self._chunk: list[tuple[float, ArmReading]] = []
        self._fields: list[str] = []
        self._waiting: SimpleQueue[list[tuple[float, ArmReading]]] = SimpleQueue()
        self._error: Exception | None = None
        self._thread = Thread(target=self._write, daemon=True)
        self._usual_interval_s = sys.getswitchinterval()

    def put(self, sample: ArmReading) -> None:
        """Take a sample, in microseconds."""
        # What has not been handed over is lost if this process is killed.
        max_held_s = 0.045
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
        if self.time_s - self._chunk[0][0] >= max_held_s:
            self._hand_over()
            if self._error is not None:
                raise self._error

    def _hand_over(self) -> None:
        """Give the samples that were put to the thread; none end it."""
        self._waiting.put(self._chunk)
        self._chunk = []

    def __enter__(self) -> Self:
        # What the format needs is imported by writing a row that is thrown away: later
        # the loop would wait for it, a second.
        row = {
            "t_s": np.zeros(1),
            "q_rad": np.zeros((1, len(self._labels.joint_names))),
        }
        writer = WRITERS.get(self._path.suffix.lower(), csv_writer)
        with writer(BytesIO(), self._labels, row) as append:
            append(row)
        # The loop waits so long for the thread at most, a tenth of its cycle.
        interval_s = 1e-4
        sys.setswitchinterval(interval_s)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        if self._chunk:
            self._hand_over()
        self._hand_over()
        self._thread.join()
        sys.setswitchinterval(self._usual_interval_s)
        if kind is None and self._error is not None:
            raise self._error

    def _write(self) -> None:
        """Write what is handed over until nothing comes; runs in the thread."""
        # A thread inherits the priority of the loop, which is real time.
        with suppress(OSError, AttributeError):
            os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
        written_s = 0.0
        try:
            with open_table(
                self._path,
                is_live=True,
                overwrites=self._overwrites,
                labels=lambda: self._labels,
            ) as table:
                for chunk in iter(self._waiting.get, []):
                    times_s, samples = zip(*chunk, strict=True)
                    columns = {"t_s": np.array(times_s)}
                    for field in self._fields:
                        signal = [getattr(sample, field) for sample in samples]
                        columns[COLUMNS[field]] = np.array(signal)
                    try:
                        table.append(columns)
                    except FileAccessError as error:  # such as a full disk
                        raise error.reworded(
                            f"{error}; {written_s:.3f} s of it are written"
                        ) from error
                    written_s = times_s[-1]
        except Exception as error:
            self._error = error
