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
        self._waiting: SimpleQueue[dict[str, Any] | None] = SimpleQueue()
        self._error: Exception | None = None
        self._written_s = 0.0  # stamp of the latest row in the file
        self._thread = Thread(target=self._write, daemon=True)
        self._usual_interval_s = sys.getswitchinterval()

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
            self._raise_error()

    def _raise_error(self) -> None:
        """Raise what has gone wrong in the thread, if anything."""
        if self._error is not None:
            raise self._error

    def _hand_over(self) -> None:
        """Give the samples that were put to the thread."""
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

    def _load_writer(self) -> None:
        """Import what the format needs, by writing a row that is thrown away.

        It takes a second, in which the loop would wait.
        """
        joints = len(self._labels.joint_names)
        row = {"t_s": np.zeros(1), "q_rad": np.zeros((1, joints))}
        # To standard output: CSV.
        writer = WRITERS.get(self._path.suffix.lower(), csv_writer)
        with writer(BytesIO(), self._labels, row) as append:
            append(row)

    def __enter__(self) -> Self:
        self._load_writer()
        # The loop waits so long for the thread at most, a tenth of its cycle.
        interval_s = 1e-4
        sys.setswitchinterval(interval_s)
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._hand_over()
        self._waiting.put(None)
        self._thread.join()
        sys.setswitchinterval(self._usual_interval_s)
        if kind is None:
            self._raise_error()

    def _write(self) -> None:
        """Write what is handed over until None comes; runs in the thread."""
        leave_real_time()
        try:
            with open_table(
                self._path,
                is_live=True,
                overwrites=self._overwrites,
                labels=lambda: self._labels,
            ) as table:
                while (columns := self._waiting.get()) is not None:
                    table.append(columns)
                    self._written_s = columns["t_s"][-1]
        except NeedleforceError as error:
            is_growing = self._path.suffix.lower() in (".csv", ".mcap")
            held_s = self._written_s if is_growing else 0.0
            self._error = error
            if self._written_s > 0.0:
                self._error = error.reworded(
                    f"{error}; {held_s:.3f} s of the recording are in it"
                )
        except Exception as error:
            self._error = error


def leave_real_time() -> None:
    """Go on with ordinary priority: a thread inherits that of the loop."""
    with suppress(OSError, AttributeError):
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
