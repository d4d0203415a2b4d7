"""A viewer beside a control loop: a process of its own, fed through shared memory.

In a thread of the loop's own process the page would cost it a millisecond now and then;
here the loop writes a row and goes on.
"""

import multiprocessing
import os
from contextlib import suppress
from multiprocessing.connection import Connection
from time import monotonic
from typing import Any

from numpy.typing import ArrayLike

from needleforce.scene.nodes import EMPTY, PlanScene
from needleforce.scene.state_ring import (
    FREE_PORT,
    Closing,
    SceneError,
    StateRing,
    view_row,
)
from needleforce.scene.viewer import Viewer
from urdf import Robot

UPDATE_RATE_HZ = 34.0
"""Thirty updates a second are promised, and timers wake late."""

START_S = 60.0
"""So long the page's process may take to start on a busy machine."""

END_S = 5.0
"""So long it may take to end."""


class LiveView(Closing):
    """A page in another process; made by `open_viewer`.

    Attributes:
        url: Where the page is.
    """

    def __init__(
        self, ring: StateRing, process: Any, pipe: Connection, url: str
    ) -> None:
        self._ring = ring
        self._process = process
        self._pipe = pipe
        self.url = url

    def put(self, estimate: Any, q_rad: ArrayLike) -> None:
        """Hand over a tick; never waits.

        Args:
            estimate: A `SessionEstimate`.
            q_rad: Joint positions, shape (n,).
        """
        self._ring.put(view_row(estimate, q_rad))

    def close(self) -> None:
        """End the page and its process."""
        with suppress(OSError):
            self._pipe.send("stop")

        self._process.join(END_S)
        self._process.kill()
        self._ring.close()


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
    ring = StateRing(robot.nv)
    pipe, other_end = context.Pipe()
    process = context.Process(
        target=_serve,
        args=(other_end, ring.name, robot, plan, settings),
        daemon=True,
    )
    process.start()
    other_end.close()
    answer: str | SceneError = "its process has not started"
    with suppress(EOFError, OSError):
        if pipe.poll(START_S):
            answer = pipe.recv()

    if isinstance(answer, SceneError) or not answer.startswith("http"):
        process.kill()
        ring.close()
        reason = f"no page: {answer}"
        if isinstance(answer, SceneError):
            raise answer.reworded(reason)
        raise SceneError(reason, FREE_PORT)

    return LiveView(ring, process, pipe, answer)


def _serve(
    pipe: Connection,
    ring_name: str,
    robot: Robot,
    plan: PlanScene,
    settings: dict[str, Any],
) -> None:
    """Run the page's process: show what has come, thirty times a second or more.

    It sends the address of the page, or why there is none, and ends when something
    comes back.
    """
    with suppress(OSError, AttributeError):
        # A child inherits real-time priority, and would take it from the loop.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))

    try:
        viewer = Viewer(robot, plan, **settings)
    except SceneError as error:
        pipe.send(error)
        return
    except OSError as error:
        pipe.send(str(error))
        return

    ring = StateRing(robot.nv, ring_name)
    period_s = 1.0 / UPDATE_RATE_HZ
    count = 0
    due_s = monotonic()
    pipe.send(viewer.url)
    while not pipe.poll(max(due_s - monotonic(), 0.0)):
        due_s = max(due_s, monotonic() - period_s) + period_s
        count, rows = ring.since(count)
        viewer.append(rows)
        viewer.follow()
    ring.close()
    # viser would wait five seconds for a browser, and end in a traceback.
    os._exit(0)
