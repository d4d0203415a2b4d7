"""Ctrl-C as a request to finish what was begun."""

import signal
import threading
from types import FrameType


class StopRequest:
    """While it is entered, the first Ctrl-C is remembered; the second interrupts."""

    def __init__(self) -> None:
        self.is_set = False

    def __call__(self) -> bool:
        """Return whether Ctrl-C was pressed."""
        return self.is_set

    def __enter__(self) -> "StopRequest":
        """Listen. Only a process's first thread hears Ctrl-C."""
        self._listens = threading.current_thread() is threading.main_thread()
        if self._listens:
            self._before = signal.signal(signal.SIGINT, self._hear)
        return self

    def __exit__(self, *_: object) -> None:
        """Leave Ctrl-C as it was."""
        if self._listens:
            signal.signal(signal.SIGINT, self._before)

    def _hear(self, _number: int, _frame: FrameType | None) -> None:
        if self.is_set:
            raise KeyboardInterrupt
        self.is_set = True
