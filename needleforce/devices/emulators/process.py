"""A process that emulates a device."""

import multiprocessing
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager, suppress
from multiprocessing.connection import Connection
from typing import Any

from needleforce.devices.errors import LinkError

START_S = 30.0
"""A process that imports numpy on a busy machine takes its time to start or end."""


class Emulator(AbstractContextManager["Emulator"]):
    """A process that emulates a device; for the ``with`` statement.

    Args:
        work: Module-level function: takes a connection to this process and the
            settings; sends what is `ready`, ends when something comes back, and returns
            counts.
        settings: Passed on.

    Attributes:
        ready: What the device says when it is up: its ports.

    Raises:
        LinkError: It did not start.
    """

    def __init__(self, work: Callable[..., dict[str, Any]], *settings: Any) -> None:
        context = multiprocessing.get_context("spawn")
        self._pipe, other_end = context.Pipe()
        self._process = context.Process(
            target=_run_work, args=(other_end, work, settings), daemon=True
        )
        self._process.start()
        other_end.close()
        self.ready: dict[str, Any] = self._receive(START_S)

    def _receive(self, wait_s: float | None) -> dict[str, Any]:
        """Return what the process sends next; `LinkError` if it has ended."""
        with suppress(EOFError, ConnectionError):
            if self._pipe.poll(wait_s):
                return self._pipe.recv()

        self._process.kill()
        raise LinkError(
            "the emulator has ended without an answer; its message stands above"
        )

    def counts(self, wait_s: float | None = None) -> dict[str, Any]:
        """Return what the emulator has counted, once it has ended by itself.

        Args:
            wait_s: How long it may take; None: any time.
        """
        counts = self._receive(wait_s)
        self._process.join(START_S)
        return counts

    def stop(self) -> dict[str, Any]:
        """End the emulator, unless it has ended; return what it has counted."""
        with suppress(ConnectionError):
            self._pipe.send("stop")

        return self.counts(START_S)

    def __exit__(self, *error: object) -> None:
        """End the process at once."""
        self._process.kill()
        self._process.join()


def _run_work(
    pipe: Connection, work: Callable[..., dict[str, Any]], settings: Sequence[Any]
) -> None:
    """Run an emulator in its process, and send what it has counted."""
    pipe.send(work(pipe, *settings))
