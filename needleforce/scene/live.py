"""A viewer beside a control loop: a process of its own, fed through a pipe.

In the loop's own process the page would cost it a millisecond now and then; here the
loop packs a moment fifty times a second, a thread sends it, and the loop never waits.
"""

import multiprocessing
import os
import pickle
import threading
from collections import deque
from contextlib import AbstractContextManager, suppress
from multiprocessing.connection import Connection
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needleforce.scene.moment import FREE_PORT, Moment, SceneError, is_kept
from needleforce.scene.nodes import EMPTY, PlanScene
from needleforce.scene.viewer import Viewer
from urdf import Robot

PERIOD_s = 1.0 / 34.0
"""Thirty updates a second are promised, and timers wake late."""


class LiveView(AbstractContextManager[Any]):
    """A page in another process; made by `open_viewer`.

    Attributes:
        url: Where the page is.
    """

    def __init__(self, process: Any, pipe: Connection, url: str) -> None:
        self._process = process
        self._pipe = pipe
        self.url = url
        self._latest_s = -np.inf
        # A page that hangs loses the oldest, not the loop's time or memory.
        self._waiting: deque[bytes] = deque(maxlen=1000)
        self._is_closed = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def put(self, estimate: Any, q_rad: ArrayLike) -> None:
        """Hand over a tick; never waits.

        Args:
            estimate: A `SessionEstimate`.
            q_rad: Joint positions, shape (n,).
        """
        if is_kept(estimate, self._latest_s):
            self._latest_s = estimate.time_s
            moment = Moment(np.array(q_rad, dtype=float), estimate)
            self._waiting.append(pickle.dumps(moment))

    def _send(self) -> None:
        """Send what waits, until the end."""
        with suppress(OSError):
            while not self._is_closed.wait(PERIOD_s):
                while self._waiting:
                    self._pipe.send_bytes(self._waiting.popleft())

    def __exit__(self, *error: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """End the page and its process."""
        self._is_closed.set()
        self._thread.join(1.0)
        self._pipe.close()
        self._process.join(5.0)
        self._process.kill()


def open_viewer(robot: Robot, plan: PlanScene = EMPTY, **settings: Any) -> LiveView:
    """Open a page beside a loop.

    Args:
        robot: The arm with its tool.
        plan: Anatomy and plan, if any.
        settings: Keywords of `Viewer`.

    Raises:
        SceneError: The page could not be opened.
    """
    context = multiprocessing.get_context("spawn")
    pipe, other_end = context.Pipe()
    process = context.Process(
        target=_serve, args=(other_end, robot, plan, settings), daemon=True
    )
    process.start()
    other_end.close()
    answer = "error: its process has not started"
    with suppress(EOFError, OSError):
        if pipe.poll(60.0):  # seconds to start on a busy machine
            answer = pipe.recv()
    if not answer.startswith("http"):
        process.kill()
        raise SceneError(f"no page: {answer}", FREE_PORT)
    return LiveView(process, pipe, answer)


def _serve(
    pipe: Connection, robot: Robot, plan: PlanScene, settings: dict[str, Any]
) -> None:
    """Run the page's process: show what has come, until the pipe is closed.

    It sends the address of the page, or why there is none.
    """
    with suppress(OSError, AttributeError):
        # A child inherits real-time priority, and would take it from the loop.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        viewer = Viewer(robot, plan, **settings)
    except (SceneError, OSError) as error:
        pipe.send(f"error: {error}")
        return
    pipe.send(viewer.url)
    with suppress(EOFError, OSError):
        while True:
            moments = [pickle.loads(pipe.recv_bytes())]
            while pipe.poll():
                moments.append(pickle.loads(pipe.recv_bytes()))
            viewer.append(moments)
            viewer.follow()
    # viser would wait five seconds for a browser, and end in a traceback.
    os._exit(0)
