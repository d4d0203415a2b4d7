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
from needleforce.scene.state_ring import Closing, SceneError, StateRing, view_row
from needleforce.scene.viewer import Viewer
from urdf import Robot

# timers wake late: thirty a second are promised
UPDATES_HZ = 34.0
START_s = 60.0


class LiveView(Closing):
    """A page in another process, to be found at `url`; made by `open_viewer`."""

    def __init__(
        self, ring: StateRing, process: Any, pipe: Connection, url: str
    ) -> None:
        self._ring = ring
        self._process = process
        self._pipe = pipe
        self.url = url

    def put(self, now: Any, q_rad: ArrayLike) -> None:
        """Hand over a tick: the session's estimate and the joint positions. Never
        waits.
        """
        self._ring.put(view_row(now, q_rad))

    def close(self) -> None:
        """End the page and its process."""
        with suppress(OSError):
            self._pipe.send("stop")
        self._process.join(5.0)
        self._process.kill()
        self._ring.close()


def open_viewer(robot: Robot, plan: PlanScene = EMPTY, **settings: Any) -> LiveView:
    """Open a page beside a loop; arguments and keywords as of `Viewer`.

    Raises:
        SceneError: The page could not be opened.
    """
    context = multiprocessing.get_context("spawn")
    ring = StateRing(robot.nv)
    pipe, other = context.Pipe()
    given = (other, ring.name, robot, plan, settings)
    process = context.Process(target=_serve, args=given, daemon=True)
    process.start()
    other.close()
    answer = "its process has not started"
    with suppress(EOFError, OSError):
        answer = pipe.recv() if pipe.poll(START_s) else answer
    if not answer.startswith("http"):
        process.kill()
        ring.close()
        raise SceneError(f"no page: {answer}")
    return LiveView(ring, process, pipe, answer)


def _serve(
    pipe: Connection,
    ring_name: str,
    robot: Robot,
    plan: PlanScene,
    settings: dict[str, Any],
) -> None:
    """The page's process: thirty times a second, or more, what has come."""
    with suppress(OSError, AttributeError):
        # A child inherits real-time priority, and would take it from the loop.
        os.sched_setscheduler(0, os.SCHED_OTHER, os.sched_param(0))
    try:
        viewer = Viewer(robot, plan, **settings)
    except (SceneError, OSError) as error:
        pipe.send(str(error))
        return
    ring = StateRing(robot.nv, ring_name)
    count = 0
    due_s = monotonic()
    pipe.send(viewer.url)
    while not pipe.poll(max(due_s - monotonic(), 0.0)):
        due_s = max(due_s, monotonic() - 1.0 / UPDATES_HZ) + 1.0 / UPDATES_HZ
        count, rows = ring.since(count)
        viewer.append(rows)
        viewer.follow()
