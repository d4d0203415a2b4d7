"""A viewer beside a control loop: a process of its own, fed through a queue.

In the loop's own process the page would cost it a millisecond now and then; here the
loop puts a moment into the queue fifty times a second, and never waits.
"""

import multiprocessing
import os
from contextlib import AbstractContextManager, suppress
from multiprocessing.connection import Connection
from queue import Empty, Full
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from needleforce.scene.moment import FREE_PORT, Moment, SceneError, is_kept
from needleforce.scene.nodes import EMPTY, PlanScene
from needleforce.scene.viewer import Viewer
from urdf import Robot


class LiveView(AbstractContextManager[Any]):
    """A page in another process; made by `open_viewer`.

    Attributes:
        url: Where the page is.
    """

    def __init__(self, process: Any, moments: Any, url: str) -> None:
        self._process = process
        self._moments = moments
        self.url = url
        self._latest_s = -np.inf

    def put(self, estimate: Any, q_rad: ArrayLike) -> None:
        """Hand over a tick; never waits.

        Args:
            estimate: A `SessionEstimate`.
            q_rad: Joint positions, shape (n,).
        """
        if is_kept(estimate, self._latest_s):
            self._latest_s = estimate.time_s
            with suppress(Full):
                self._moments.put_nowait(Moment(np.array(q_rad, dtype=float), estimate))

    def __exit__(self, *error: object) -> None:
        """Close it."""
        self.close()

    def close(self) -> None:
        """End the page and its process."""
        self._process.kill()
        self._process.join()


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
    # So many moments wait for a page that hangs; further ones are lost, not time.
    moments = context.Queue(1000)
    moments.cancel_join_thread()  # what waits for a page that hangs holds no exit up
    pipe, other_end = context.Pipe()
    process = context.Process(
        target=_serve, args=(other_end, moments, robot, plan, settings), daemon=True
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
    return LiveView(process, moments, answer)


def _serve(
    pipe: Connection,
    queue: Any,
    robot: Robot,
    plan: PlanScene,
    settings: dict[str, Any],
) -> None:
    """Run the page's process: show what has come, until it is ended.

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
    parent = multiprocessing.parent_process()
    while parent is not None and parent.is_alive():
        moments: list[Moment] = []
        with suppress(Empty):
            moments.append(queue.get(timeout=1.0))
            while True:
                moments.append(queue.get_nowait())
        viewer.append(moments)
        viewer.follow()
    # viser would wait five seconds for a browser, and end in a traceback.
    os._exit(0)
