"""The page: the scene, forces over time and depth, the tip force as a bar, a time line.

Rows come in any number at a time. While `live` is set the page shows the newest. When
the time line is moved back, the page hides what had not happened yet: the arm, the
forces and the marks of ruptures are those of that time.
"""

import errno
import socket
import sys
import threading
import time
from collections.abc import Sequence
from contextlib import redirect_stdout
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.files import whole_file
from needleforce.scene import nodes
from needleforce.scene.guarded_server import PageAccess, open_server
from needleforce.scene.row_text import (
    BANNER,
    layer_names,
    next_layer_name,
    rupture_text,
    state_lines,
)
from needleforce.scene.state_ring import FIELDS, SceneCode, SceneError, ViewRow
from urdf import Robot

NOTE = "Simulation and research only: not a medical device."

FULL_BAR_N = 4.0
"""Tip force at which the bar is full."""

MAX_CURVE_POINTS = 500
"""Of a curve; longer ones are thinned."""

KEPT_RATE_HZ = 50.0
"""So many rows a second are kept, and those with ruptures."""

MAX_ROWS = 30_000
"""When more are kept, every second one is dropped."""

FRAME_S = 0.05
"""Time from picture to picture when a recording is played."""

TIME_STEP_S = 0.01
"""Of the time line."""

MIN_SPAN_S = 0.01
"""The time line is never shorter."""

MAX_PORT = 65535

M_TO_MM = 1e3

TIME_LABEL = "time [s]"
DEPTH_LABEL = "depth, counted as above [mm]"


class ForceCurve(NamedTuple):
    """A force in the plots.

    Attributes:
        name: In the legend.
        field: Of a row, with its values.
        std_field: Of a row, with their standard deviations.
        color: Red, green and blue.
    """

    name: str
    field: str
    std_field: str
    color: str


CURVES = (
    ForceCurve("force", "force_N", "force_std_N", "42, 157, 111"),
    ForceCurve("tip force", "tip_N", "tip_std_N", "138, 58, 185"),
)

LINE_WIDTH = 2.0  # pixels
BAND_WIDTH = 0.3  # pixels, of the two lines that bound a band

COLUMN = {name: column for column, name in enumerate(FIELDS)}
"""Columns of rows by the names of their fields."""


class Mark(NamedTuple):
    """A detected rupture in the scene.

    Attributes:
        time_s: When it was detected.
        number: Of the layer that ruptured.
        text: Of its label.
        ring: In the scene.
        until_s: When the alarm was retracted.
    """

    time_s: float
    number: float
    text: str
    ring: nodes.Ring
    until_s: float = np.inf


def check_address(host: str, port: int) -> None:
    """Raise `SceneError` where nothing can listen: viser would wait for ever.

    That another program listens there is no fault: viser takes the next port.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except (OSError, OverflowError, UnicodeError) as error:
        is_busy = getattr(error, "errno", None) == errno.EADDRINUSE
        # Behind the last port viser would wait for ever, too.
        if not is_busy or port == MAX_PORT:
            raise SceneError(
                f"{host}, port {port}: {error}; expected an address of this machine, "
                f"and a port of 0 to {MAX_PORT}",
                SceneCode.PAGE,
            ) from error


class Viewer:
    """A page that shows an insertion.

    Args:
        robot: The arm with its tool.
        plan: Anatomy and plan, if any.
        urdf_path: The arm's description, for its shapes.
        host: Address to listen on.
        port: Where; another is taken if it is busy, see `url`.
        further_hosts: Names beside the address and loopback by which it is opened.

    Attributes:
        url: Where the page is; with a token unless it is bound to loopback.
        marks: The ruptures shown, past and to come.

    Raises:
        SceneError: viser is not installed, nothing can listen there, or the plan has no
            way.
    """

    def __init__(
        self,
        robot: Robot,
        plan: nodes.PlanScene = nodes.EMPTY,
        *,
        urdf_path: Path | None = None,
        host: str = "127.0.0.1",
        port: int = 8080,
        further_hosts: Sequence[str] = (),
    ) -> None:
        check_address(host, port)
        access = PageAccess.of_host(host, further_hosts)
        self._server = open_server(host, port, "needleforce", access)
        shown_host = next(iter(further_hosts), host)
        self.url = access.address(shown_host, self._server.get_port())
        self.marks: list[Mark] = []
        self._rows = np.empty((0, len(FIELDS) + robot.nv))
        self._names = layer_names(plan)
        self._lock = threading.Lock()
        self._shown_s: float | None = None  # time of the row that is shown
        self._add_scene(robot, plan, urdf_path)
        self._add_panel(plan.warnings)

    def _add_scene(
        self, robot: Robot, plan: nodes.PlanScene, urdf_path: Path | None
    ) -> None:
        """Add the arm, anatomy and plan, and the ring at the next boundary."""
        scene = self._server.scene
        scene.set_up_direction("+z")
        self._arm = nodes.ArmNodes(self._server, robot, urdf_path)
        nodes.add_anatomy(self._server, plan)
        upright = nodes.NeedlePose(np.zeros(3), np.array([0.0, 0.0, 1.0]))
        self._ahead = nodes.add_ring(
            self._server, "/ahead", upright, nodes.EXPECTED, ""
        )
        self._off_plan = scene.add_label("/off_plan", BANNER)
        self._off_plan.visible = False
        scene.add_grid("/floor", width=2.0, height=2.0, cell_size=0.1)

    def _add_panel(self, plan_warnings: tuple[str, ...]) -> None:
        """Add the state in words, the time line and the plots beside the scene."""
        gui = self._server.gui
        gui.add_markdown(f"**needleforce** – {NOTE}")
        self._banner = gui.add_markdown("")
        for warning in plan_warnings:
            gui.add_markdown(f"Warning: {warning}")
        self._text = gui.add_markdown("waiting for the first sample")
        self._bar = gui.add_progress_bar(0.0, color="violet")
        self._events = gui.add_markdown("")
        with gui.add_folder("Time"):
            self._slider = gui.add_slider(TIME_LABEL, 0.0, 1.0, TIME_STEP_S, 0.0)
            self._live = gui.add_checkbox("live", True)
            self._play = gui.add_button("Play")

        self._plots = {
            label: self._add_plot(label) for label in (TIME_LABEL, DEPTH_LABEL)
        }
        self._slider.on_update(self._show_slider_time)
        self._play.on_click(
            lambda _: threading.Thread(target=self._replay, daemon=True).start()
        )

    def _add_plot(self, x_label: str) -> Any:
        """Add a plot of the curves, each with a band of two standard deviations."""
        from viser import uplot

        series = [uplot.Series(label=x_label)]
        bands = []
        for curve in CURVES:
            stroke = f"rgb({curve.color})"
            upper = len(series) + 1
            bands.append(
                uplot.Band(series=(upper, upper + 1), fill=f"rgba({curve.color}, 0.18)")
            )
            series += [
                uplot.Series(
                    label=f"{curve.name} [N]", stroke=stroke, width=LINE_WIDTH
                ),
                uplot.Series(label="+ 2 std", stroke=stroke, width=BAND_WIDTH),
                uplot.Series(label="- 2 std", stroke=stroke, width=BAND_WIDTH),
            ]

        return self._server.gui.add_uplot(
            tuple(np.zeros(1) for _ in series),
            tuple(series),
            title=f"force [N] over {x_label}",
            bands=tuple(bands),
            scales={
                "x": uplot.Scale(time=False, auto=True),
                "y": uplot.Scale(auto=True),
            },
            aspect=1.6,
        )

    def append(self, rows: Array) -> None:
        """Add further rows of `view_row`, shape (n, k), in the order of time."""
        rows = np.asarray(rows, dtype=float)
        if not len(rows):
            return

        with self._lock:
            events = rows[:, [COLUMN["rupture"], COLUMN["retracted"]]]
            has_event = (events > 0.0).any(axis=1)
            for row in rows[has_event]:
                self._mark(row)

            # Of rows without an event the first of each slot of time is kept.
            slots = np.floor(rows[:, COLUMN["time_s"]] * KEPT_RATE_HZ)
            is_kept = has_event | (np.diff(slots, prepend=self._latest_slot()) > 0.0)
            self._rows = np.vstack([self._rows, rows[is_kept]])
            if len(self._rows) > MAX_ROWS:
                self._rows = self._rows[::2]

    def _latest_slot(self) -> float:
        """Return the slot of time of the latest row kept."""
        if not len(self._rows):
            return -np.inf

        return float(np.floor(self._rows[-1, COLUMN["time_s"]] * KEPT_RATE_HZ))

    def _mark(self, row_values: Array) -> None:
        """Mark the rupture of a row, or retract the latest one."""
        row = _view_row_of(row_values)
        if self.marks and self.marks[-1].number == row.retracted:
            self.marks[-1] = self.marks[-1]._replace(until_s=row.time_s)
        if not row.rupture:
            return

        needle = self._arm.update(_joints_of(row_values))
        rupture_m = needle.tip_m + (row.rupture_depth_m - row.depth_m) * needle.axis
        text = rupture_text(row, self._names)
        ring = nodes.add_ring(
            self._server,
            f"/ruptures/{len(self.marks)}",
            nodes.NeedlePose(rupture_m, needle.axis),
            nodes.DETECTED,
            text,
        )
        ring.set_visible(False)  # until its time is shown
        self.marks.append(Mark(row.time_s, row.rupture, text, ring))

    def show(self, time_s: float | None = None) -> None:
        """Show the state at a time, by default the newest."""
        with self._lock:
            if not len(self._rows):
                return

            times_s = self._rows[:, COLUMN["time_s"]]
            shown_s = times_s[-1] if time_s is None else time_s
            index = int(np.searchsorted(times_s, shown_s, "right")) - 1
            index = max(index, 0)
            if times_s[index] == self._shown_s:
                return

            self._draw(index)
            self._shown_s = float(times_s[index])

    def follow(self) -> None:
        """Show the newest, unless somebody has moved the time line."""
        if self._live.value:
            self.show()

    def _draw(self, index: int) -> None:
        """Draw the row of an index, and what had happened until then."""
        row_values = self._rows[index]
        row = _view_row_of(row_values)
        with self._server.atomic():
            needle = self._arm.update(_joints_of(row_values))
            self._draw_marks(row)
            self._draw_expected(row, needle)
            self._draw_banner(row, needle)
            latest_s = float(self._rows[-1, COLUMN["time_s"]])
            self._slider.max = max(latest_s, MIN_SPAN_S)
            if self._live.value:
                self._slider.value = round(row.time_s, 2)

            lines = state_lines(row, self._names, FULL_BAR_N)
            self._text.content = "\n\n".join(lines)
            percent = 100.0 * row.tip_N / FULL_BAR_N
            self._bar.value = float(np.clip(percent, 0.0, 100.0))
            self._draw_curves(index)

        if self._shown_s is None:
            camera = self._server.initial_camera
            camera.look_at = tuple(needle.tip_m)
            camera.position = tuple(needle.tip_m + nodes.CAMERA_M)

    def _draw_marks(self, row: ViewRow) -> None:
        """Show the ruptures known at a row, and hide the others."""
        texts = []
        for mark in self.marks:
            is_known = mark.time_s <= row.time_s < mark.until_s
            mark.ring.set_visible(is_known)
            if is_known:
                texts.append(f"- {mark.text}")

        self._events.content = "\n".join(texts)

    def _draw_expected(self, row: ViewRow, needle: nodes.NeedlePose) -> None:
        """Show where the next boundary is expected, if one is."""
        is_expected = bool(np.isfinite(row.plan_next_m)) and not row.is_off_plan
        self._ahead.set_visible(is_expected)
        if is_expected:
            distance_m = row.plan_next_m - row.depth_m
            self._ahead.move(needle.tip_m + distance_m * needle.axis, needle.axis)
            next_name = next_layer_name(row, self._names)
            self._ahead.label.text = f"{next_name}, expected"

    def _draw_banner(self, row: ViewRow, needle: nodes.NeedlePose) -> None:
        """Turn the needle red and say so while it is off the plan."""
        self._arm.show_off_plan(row.is_off_plan)
        self._off_plan.visible = row.is_off_plan
        self._off_plan.position = tuple(needle.tip_m)
        self._banner.content = ""
        if row.is_off_plan:
            self._banner.content = f"# ⚠ {BANNER}\n\nNo layer is named from it."

    def _draw_curves(self, index: int) -> None:
        """Draw the forces until a row, where they were good."""
        rows = self._rows[: index + 1]
        rows = rows[rows[:, COLUMN["is_good"]] > 0.0]
        rows = rows[:: max(len(rows) // MAX_CURVE_POINTS, 1)]
        curves = []
        for curve in CURVES:
            force_N = rows[:, COLUMN[curve.field]]
            band_N = 2.0 * rows[:, COLUMN[curve.std_field]]
            curves += [force_N, force_N + band_N, force_N - band_N]

        time_s = rows[:, COLUMN["time_s"]]
        self._plots[TIME_LABEL].data = (time_s, *curves)

        # A curve over depth runs forth and back: only what is deeper than all before.
        depth_m = rows[:, COLUMN["depth_m"]] - self._rows[index, COLUMN["zero_m"]]
        is_deepest = depth_m >= np.maximum.accumulate(depth_m)
        self._plots[DEPTH_LABEL].data = tuple(
            values[is_deepest] for values in (M_TO_MM * depth_m, *curves)
        )

    def _show_slider_time(self, event: Any) -> None:
        """Show the time that somebody has moved the time line to."""
        if event.client is not None:  # by hand, not by the program
            self._live.value = False
            self.show(self._slider.value)

    def _replay(self) -> None:
        """Play from where the time line stands to its end, in real time."""
        self._live.value = False
        self._play.disabled = True
        start_s = float(self._slider.value)
        end_s = self._slider.max
        if start_s >= end_s - FRAME_S:
            start_s = 0.0

        begin_s = time.monotonic() - start_s
        while (shown_s := time.monotonic() - begin_s) < end_s + FRAME_S:
            self._slider.value = round(min(shown_s, end_s), 2)
            self.show(shown_s)
            time.sleep(FRAME_S)

        self._play.disabled = False

    def export(self, path: str | Path, *, frames: int = 120) -> Path:
        """Write the scene as one page that needs nothing else, with a film.

        Args:
            path: Of the page.
            frames: Pictures of the film, from the first row to the last.

        Raises:
            SceneError: Nothing was shown yet, or the file cannot be written.
        """
        if not len(self._rows):
            raise SceneError("nothing to export: no rows have come")

        serializer = self._server.get_scene_serializer()
        times_s = self._rows[:, COLUMN["time_s"]]
        start_s = float(times_s[0])
        end_s = max(float(times_s[-1]), start_s + FRAME_S)
        frame_times_s, step_s = np.linspace(start_s, end_s, frames, retstep=True)
        for shown_s in frame_times_s.tolist():
            self.show(shown_s)
            serializer.insert_sleep(float(step_s))

        try:
            with whole_file(path) as file:
                file.write(serializer.as_html().encode())
        except OSError as error:
            raise SceneError(
                f"cannot write {path}: {error.strerror}", SceneCode.WRITE
            ) from error

        return Path(path)

    def stop(self) -> None:
        """Close the page."""
        with redirect_stdout(sys.stderr):
            self._server.stop()


def _view_row_of(row_values: Array) -> ViewRow:
    """Return the fields of a row of numbers."""
    return ViewRow(*row_values[: len(FIELDS)].tolist())


def _joints_of(row_values: Array) -> Array:
    """Return the joint positions of a row of numbers, shape (n,) [rad]."""
    return row_values[len(FIELDS) :]
