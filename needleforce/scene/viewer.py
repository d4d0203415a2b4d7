"""The page: the scene, forces over time and depth, the tip force as a bar, a time line.

Rows come in any number at a time. While `live` is set the page shows the newest. When
the time line is moved back, the page hides what had not happened yet: the arm, the
forces and the marks of ruptures are those of that time.
"""

import errno
import socket
import threading
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.depth_zero import PLANNED_ENTRY
from needleforce.plots import require_matplotlib
from needleforce.scene import nodes
from needleforce.scene.clinician_view import card_html, find_bearing
from needleforce.scene.export_page import (
    MIN_FILM_s,
    describe_banners,
    film_times_s,
    force_section,
    rupture_section,
    slice_section,
    write_scene_page,
)
from needleforce.scene.force_arrow import ForceArrow
from needleforce.scene.force_plots import COLUMN, ForcePlots
from needleforce.scene.guarded_server import PageAccess, open_server, stop_server
from needleforce.scene.legend import legend_html, legend_lines
from needleforce.scene.page_text import text_html
from needleforce.scene.row_text import (
    BANNER,
    CANNOT_TELL,
    banner_of,
    headline,
    layer_names,
    next_layer_name,
    rupture_label,
    rupture_text,
    state_lines,
)
from needleforce.scene.scan_slices import PIXELS, TITLES, ScanSlices
from needleforce.scene.state_ring import (
    EVENTS,
    FIELDS,
    FREE_PORT,
    SceneError,
    ViewRow,
)
from needleforce.scene.structure_list import StructureList, add_surfaces
from needleforce.scene.time_panel import TimePanel
from needleforce.scene.title_bar import NOTE, TitleBar
from urdf import Robot

FULL_BAR_N = 4.0
"""Tip force at which the bar is full."""

ENLARGED = 2
"""Pixels of the screen for each of the CT's slices; these fill their panel then."""

KEPT_RATE_HZ = 50.0
"""So many rows a second are kept, and those with events."""


class Mark(NamedTuple):
    """A detected rupture in the scene.

    Attributes:
        time_s: When it was detected.
        number: Of the layer that ruptured.
        text: Of its label.
        ring: In the scene.
        place_m: Of the rupture in the robot's base, shape (3,).
        until_s: When the alarm was retracted.
    """

    time_s: float
    number: float
    text: str
    ring: nodes.Ring
    place_m: Array
    until_s: float = np.inf

    def is_known_at(self, time_s: float) -> bool:
        """Return whether it stood at a time."""
        return self.time_s <= time_s < self.until_s


def check_address(host: str, port: int) -> None:
    """Raise `SceneError` where nothing can listen: viser would wait for ever.

    That another program listens there is no fault: viser takes the next port.
    """
    last_port = 65535
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except (OSError, OverflowError, UnicodeError) as error:
        is_busy = getattr(error, "errno", None) == errno.EADDRINUSE
        # Behind the last port viser would wait for ever, too.
        if not is_busy or port == last_port:
            raise SceneError(
                f"{host}, port {port}: {error}; expected an address of this machine, "
                f"and a port of 0 to {last_port}",
                FREE_PORT,
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
        time: The time line.
        structures: The list of structures.
        unread_meshes: Meshes of the arm that cannot be read; it is shown without.

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
        self._plan = plan
        self._names = layer_names(plan)
        self._lock = threading.Lock()
        self._shown_s: float | None = None  # time of the row that is shown
        self._add_scene(robot, plan, urdf_path)
        self._add_panel(plan)
        self._slices = None if plan.scan is None else ScanSlices(plan)
        self._images = [] if plan.scan is None else self._add_images()
        self._draw_slices(None)
        if plan.path is not None:
            self._place_camera(plan.path.entry_m)

    def _add_scene(
        self, robot: Robot, plan: nodes.PlanScene, urdf_path: Path | None
    ) -> None:
        """Add the arm, anatomy and plan, and the ring at the next boundary."""
        scene = self._server.scene
        scene.set_up_direction("+z")
        self._arm = nodes.ArmNodes(self._server, robot, urdf_path)
        self.unread_meshes = self._arm.unread_meshes
        self._surfaces = add_surfaces(self._server, plan)
        nodes.add_path(self._server, plan)
        self._arrow = ForceArrow(self._server)
        self._trail = nodes.add_lines(
            self._server,
            "/trail",
            np.zeros((2, 3)),
            nodes.TRAIL_COLOR,
            nodes.TRAIL_WIDTH,
        )
        self._nearest = nodes.add_lines(
            self._server, "/nearest", np.zeros((2, 3)), nodes.NEAREST_COLOR, 3.0
        )
        self._nearest.visible = False
        upright = nodes.NeedlePose(np.zeros(3), np.array([0.0, 0.0, 1.0]))
        self._ahead = nodes.add_ring(
            self._server, "/ahead", upright, nodes.EXPECTED, ""
        )
        self._off_plan = scene.add_label("/off_plan", BANNER)
        self._off_plan.visible = False
        scene.add_grid("/floor", width=2.0, height=2.0, cell_size=0.1)

    def _add_panel(self, plan: nodes.PlanScene) -> None:
        """Add state, time line, plots and structures beside the scene.

        What must always be seen stands in the main panel; all else in a second one,
        which is folded at first on a narrow screen.
        """
        gui = self._server.gui
        self._title = TitleBar(self._server, plan.warnings)
        self._card = gui.add_html(card_html(None, plan, event=("", 0.0)))
        gui.add_html(text_html(*(f"Warning: {warning}" for warning in plan.warnings)))
        self._headline = gui.add_html(text_html("waiting for the first sample"))
        # Docked, not floating over the scene.
        gui.main_panel.dock_left()
        panel = gui.add_panel()
        with panel.add_tab("Insertion"):
            gui.add_html(text_html(f"needleforce – {NOTE}"))
            self.time = TimePanel(gui, self.show)
            gui.add_html(text_html(f"Bar: tip force; full at {FULL_BAR_N:g} N."))
            self._bar = gui.add_progress_bar(0.0, color="violet")
            has_entry = plan.path is not None
            exits_m = [0.0, *(layer.exit_m for layer in plan.layers)]
            self._plots = ForcePlots(gui, exits_m if has_entry else ())
            self._events = gui.add_html("")
            self._text = gui.add_html("")
            self._at_tip = gui.add_checkbox("camera at the tip", False)
            self._sounds = gui.add_checkbox("sound on events", True)
        with panel.add_tab("Structures"):
            if not self._surfaces:
                gui.add_html(text_html("No labels beside the plan."))
            self.structures = StructureList(self._server, self._surfaces)
        with panel.add_tab("What is what"):
            gui.add_html(legend_html(legend_lines(plan)))
        panel.dock_right()

    def _add_images(self) -> list[Any]:
        """Add the places of the CT's slices beside the scene."""
        panel = self._server.gui.add_panel()
        side = ENLARGED * PIXELS
        empty = np.zeros((side, side, 3), np.uint8)
        with panel.add_tab("CT at the needle"):
            images = [
                self._server.gui.add_image(empty, label=title) for title in TITLES
            ]
        panel.dock_below(self._server.gui.main_panel)
        return images

    def append(self, rows: Array) -> None:
        """Add further rows of `view_row`, shape (n, k), in the order of time."""
        rows = np.asarray(rows, dtype=float)
        if not len(rows):
            return

        with self._lock:
            events = rows[
                :, [COLUMN[name] for name in ("rupture", "retracted", "event")]
            ]
            has_event = (events > 0.0).any(axis=1)
            for row in rows[has_event]:
                self._mark(row)

            # Of rows without an event the first of each slot of time is kept.
            slots = np.floor(rows[:, COLUMN["time_s"]] * KEPT_RATE_HZ)
            is_kept = has_event | (np.diff(slots, prepend=self._latest_slot()) > 0.0)
            self._rows = np.vstack([self._rows, rows[is_kept]])
            if len(self._rows) > 30_000:  # ten minutes at the rate that is kept
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
            rupture_label(row, self._names),
        )
        ring.set_visible(False)  # until its time is shown
        self.marks.append(Mark(row.time_s, row.rupture, text, ring, rupture_m))
        self.time.add_jump(row.time_s, f"rupture {row.rupture:.0f}")
        self._spread_labels(needle.axis)

    def _spread_labels(self, axis: Array) -> None:
        """Shift the labels of the ruptures so that none overprints another."""
        marks = sorted(self.marks, key=lambda mark: float(mark.place_m @ axis))
        shifts_m = nodes.label_shifts_m([float(mark.place_m @ axis) for mark in marks])
        for mark, shift_m in zip(marks, shifts_m, strict=True):
            mark.ring.shift_label(shift_m)

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
        if self.time.live.value:
            self.show()

    def open_recording(self) -> None:
        """Show what has come from its start, as a recording that does not go on."""
        with self._lock:
            times_s = self._rows[:, COLUMN["time_s"]]
        if len(times_s):
            self.time.open_recording(float(times_s[0]), float(times_s[-1]))
            self.show(float(times_s[0]))

    def _draw(self, index: int) -> None:
        """Draw the row of an index, and what had happened until then."""
        row_values = self._rows[index]
        row = _view_row_of(row_values)
        with self._server.atomic():
            needle = self._arm.update(_joints_of(row_values))
            self._draw_marks(row)
            self._draw_expected(row, needle)
            self._draw_banner(row, needle)
            self._draw_nearest(row, needle)
            self._arrow.show(row, needle)
            self._draw_trail(index, row)
            is_near = row.depth_m > row.zero_m - nodes.PATH_LEAD_M
            has_entry = row.zero_name == PLANNED_ENTRY
            self._draw_slices(needle if is_near or not has_entry else None)
            self._card.content = self._card_of(index, row, needle)
            self.time.set_end(float(self._rows[-1, COLUMN["time_s"]]))
            if self.time.live.value:
                self.time.slider.value = round(row.time_s, 2)

            self._headline.content = text_html(headline(row))
            lines = state_lines(row, self._names, self._plan.watched)
            self._text.content = text_html(*lines)
            percent = 100.0 * row.tip_N / FULL_BAR_N
            self._bar.value = float(np.clip(percent, 0.0, 100.0))
            self._plots.draw(self._rows[: index + 1], row.zero_m)

        self._move_camera(needle)
        if self._shown_s is None and self._plan.path is None:
            self._place_camera(needle.tip_m)

    def _card_of(self, index: int, row: ViewRow, needle: nodes.NeedlePose) -> str:
        """Return the clinician's view of a row, with the latest event before it."""
        events = self._rows[: index + 1, COLUMN["event"]]
        places = np.flatnonzero(events)
        latest = ("", 0.0)
        if len(places):
            kind = EVENTS[int(events[places[-1]])] if self._sounds.value else ""
            latest = (kind, float(self._rows[places[-1], COLUMN["time_s"]]))
        bearing = find_bearing(row, needle, self._plan)
        return card_html(row, self._plan, bearing, latest)

    def _place_camera(self, centre_m: Array) -> None:
        """Let browsers look at a place at first."""
        camera = self._server.initial_camera
        camera.look_at = tuple(centre_m)
        camera.position = tuple(centre_m + nodes.CAMERA_M)

    def _draw_marks(self, row: ViewRow) -> None:
        """Show the ruptures known at a row, and hide the others."""
        texts = []
        for mark in self.marks:
            is_known = mark.is_known_at(row.time_s)
            mark.ring.set_visible(is_known)
            if is_known:
                texts.append(f"• {mark.text}")

        self._events.content = text_html(*texts)

    def _draw_expected(self, row: ViewRow, needle: nodes.NeedlePose) -> None:
        """Show where the next boundary is expected, if one is."""
        is_expected = bool(np.isfinite(row.plan_next_m)) and not row.is_off_plan
        self._ahead.set_visible(is_expected)
        if is_expected:
            distance_m = row.plan_next_m - row.depth_m
            place_m = needle.tip_m + distance_m * needle.axis
            self._ahead.move(place_m, needle.axis)
            depth_m = float(place_m @ needle.axis)
            taken_m = self._label_depths_m(row, needle.axis)
            self._ahead.shift_label(nodes.free_shift_m(depth_m, taken_m))
            next_name = next_layer_name(row, self._names)
            self._ahead.label.text = f"{next_name}, expected"

    def _label_depths_m(self, row: ViewRow, axis: Array) -> list[float]:
        """Return where along an axis labels of ruptures stand that a row knows."""
        return [
            float(mark.place_m @ axis) + float(mark.ring.label.position[2])
            for mark in self.marks
            if mark.is_known_at(row.time_s)
        ]

    def _draw_banner(self, row: ViewRow, needle: nodes.NeedlePose) -> None:
        """Turn the needle red and say so while it is off the plan or too deep."""
        banner = banner_of(row)
        self._arm.show_off_plan(bool(banner) and banner != CANNOT_TELL)
        self._title.show(banner)
        self._off_plan.visible = bool(banner)
        self._off_plan.text = banner or BANNER
        # So far before the tip no other label stands.
        self._off_plan.position = tuple(needle.tip_m - 0.1 * needle.axis)

    def _draw_nearest(self, row: ViewRow, needle: nodes.NeedlePose) -> None:
        """Draw a line from the needle to the nearest structure at risk."""
        place_m = np.array([row.near_x_m, row.near_y_m, row.near_z_m])
        path = self._plan.path
        self._nearest.visible = path is not None and bool(np.isfinite(place_m).all())
        if path is None or not self._nearest.visible:
            return
        # On the needle in the body, or on its way ahead as far as the target is deep.
        depth_m = float((needle.tip_m - path.entry_m) @ path.axis)
        along_m = (place_m - needle.tip_m) @ needle.axis
        least_m = -max(depth_m, 0.0)
        along_m = float(np.clip(along_m, least_m, max(path.length_m - depth_m, 0.0)))
        line_m = np.array([needle.tip_m + along_m * needle.axis, place_m])
        self._nearest.points = line_m[None].astype(np.float32)
        color = nodes.OFF_PLAN_COLOR if row.is_too_near else nodes.NEAREST_COLOR
        self._nearest.colors = np.array(color, np.uint8)

    def _draw_trail(self, index: int, row: ViewRow) -> None:
        """Draw the real path of the tip until a row, from shortly before the entry."""
        rows = self._rows[: index + 1]
        begin_m = row.zero_m - nodes.PATH_LEAD_M
        rows = rows[rows[:, COLUMN["depth_m"]] >= begin_m]
        rows = rows[:: max(len(rows) // 100, 1)]  # a line of at most 200 points
        is_shown = len(rows) > 1
        self._trail.visible = is_shown
        if is_shown:
            tips_m = np.array(
                [self._arm.needle_at(_joints_of(one)).tip_m for one in rows]
            )
            segments = np.stack([tips_m[:-1], tips_m[1:]], axis=1)
            self._trail.points = segments.astype(np.float32)

    def _draw_slices(self, needle: nodes.NeedlePose | None) -> None:
        """Draw the CT at the needle, or at the planned target, if anything moved."""
        if self._slices is None:
            return
        pictures = self._slices.draw(needle)
        if pictures is None:
            return
        for image, picture in zip(self._images, pictures, strict=True):
            image.image = picture.repeat(ENLARGED, 0).repeat(ENLARGED, 1)

    def _move_camera(self, needle: nodes.NeedlePose) -> None:
        """Let every browser look along the needle, if that is asked for."""
        if not self._at_tip.value:
            return
        frame = nodes.rotation_of_axis(needle.axis)
        away_m = 0.04  # behind the tip, and beside it
        for client in self._server.get_clients().values():
            client.camera.up_direction = tuple(frame[:, 1])
            client.camera.position = tuple(
                needle.tip_m - away_m * needle.axis + away_m * frame[:, 0]
            )
            client.camera.look_at = tuple(needle.tip_m)

    def export(self, path: str | Path, *, frames: int = 120) -> Path:
        """Write the scene as one page that needs nothing else, with a film.

        Args:
            path: Of the page.
            frames: Pictures of the film from the first row to the last, beside one for
                each rupture.

        Raises:
            SceneError: Nothing was shown yet, or the file cannot be written.
            MissingExtraError: matplotlib or jinja2 is not installed.
        """
        if not len(self._rows):
            raise SceneError("nothing to export: no rows have come")

        require_matplotlib("an exported scene")
        self._title.hide()
        serializer = self._server.get_scene_serializer()
        times_s = self._rows[:, COLUMN["time_s"]]
        start_s = float(times_s[0])
        events_s = [mark.time_s for mark in self.marks]
        shown_s = film_times_s(times_s, events_s, frames)
        steps_s = np.diff(shown_s, append=shown_s[-1] + MIN_FILM_s)
        for time_s, step_s in zip(shown_s.tolist(), steps_s.tolist(), strict=True):
            self.show(time_s)
            serializer.insert_sleep(step_s)
        scene = serializer.as_html()
        last = _view_row_of(self._rows[-1])
        deepest = self._deepest_row()
        row = _view_row_of(deepest)
        needle = self._arm.needle_at(_joints_of(deepest))
        self._draw_slices(needle)
        self._title.restore(banner_of(last))
        banners = [banner_of(_view_row_of(row)) for row in self._rows]
        ruptures = [
            (mark.time_s - start_s, mark.until_s - start_s, mark.text)
            for mark in self.marks
        ]
        sections = [
            rupture_section(ruptures),
            force_section(self._rows, last.zero_m, last.zero_name, events_s),
        ]
        if self._slices is not None and self._slices.latest is not None:
            sections.append(slice_section(self._slices.latest))
        return write_scene_page(
            Path(path),
            scene,
            "needleforce",
            warnings=(
                *self._plan.warnings,
                *describe_banners(times_s - start_s, banners),
            ),
            legend=legend_lines(self._plan),
            card=card_html(row, self._plan, find_bearing(row, needle, self._plan)),
            sections=sections,
        )

    def _deepest_row(self) -> Array:
        """Return the row in which the needle was deepest since the tare.

        At the end it may be back in the air; before the tare depth has another zero.
        """
        since = int(np.argmax(self._rows[:, COLUMN["is_good"]] == 1.0))
        rows = self._rows[since:]
        return rows[int(rows[:, COLUMN["depth_m"]].argmax())]

    def stop(self) -> None:
        """Close the page."""
        stop_server(self._server)


def _view_row_of(row_values: Array) -> ViewRow:
    """Return the fields of a row of numbers."""
    return ViewRow(*row_values[: len(FIELDS)].tolist())


def _joints_of(row_values: Array) -> Array:
    """Return the joint positions of a row of numbers, shape (n,) [rad]."""
    return row_values[len(FIELDS) :]
