"""The page: the scene, the card, forces over time and depth, a time line.

Moments come in any number at a time. While `live` is set the page shows the newest.
When the time line is moved back, the page hides what had not happened yet: the arm, the
forces and the marks of ruptures are those of that time.
"""

import threading
from bisect import bisect_right
from collections.abc import Iterable
from contextlib import redirect_stdout
from dataclasses import dataclass
from io import StringIO
from pathlib import Path
from typing import Any

import numpy as np

from foundation.arrays import Array
from foundation.extras import install_command
from needleforce.insertion_events import session_events
from needleforce.needle_on_plan import CANNOT_TELL
from needleforce.scene import nodes
from needleforce.scene.export_page import write_scene_page
from needleforce.scene.force_plots import ForcePlots
from needleforce.scene.insertion_card import card_html
from needleforce.scene.moment import FREE_PORT, Moment, SceneError
from needleforce.scene.scan_slices import PIXELS, TITLES, PIXEL_m, draw_slices
from needleforce.scene.words import (
    NOTE,
    describe_depth,
    describe_state,
    find_banner,
    shown_name,
    text_html,
)
from urdf import Robot

HOST = "127.0.0.1"
"""The page is for this machine alone; for others, ssh forwards its port."""


@dataclass(slots=True)
class Mark:
    """A detected rupture in the scene.

    Attributes:
        time_s: When it was detected.
        layer: Number of the layer that ruptured.
        text: What it was.
        ring: In the scene.
        until_s: When the alarm was retracted.
    """

    time_s: float
    layer: int
    text: str
    ring: nodes.Ring
    until_s: float = np.inf


def open_server(port: int, label: str) -> Any:
    """Open a viser server on loopback.

    Args:
        port: Where; another one is taken if it is busy, 0 for any.
        label: Of the page.

    Raises:
        SceneError: viser is not installed, or there is no such port.
    """
    try:
        import viser
    except ImportError as error:
        raise SceneError(
            "viser is not installed", f"Install it: {install_command('scene')}"
        ) from error
    # Behind the last one viser would look for a free one for ever.
    if not 0 <= port <= 65535:
        raise SceneError(f"port {port}; expected 0 to 65535", FREE_PORT)
    with redirect_stdout(StringIO()):  # viser's banner is no result
        return viser.ViserServer(host=HOST, port=port, label=label, verbose=False)


def stop_server(server: Any) -> None:
    """Stop a server without viser's words on it."""
    with redirect_stdout(StringIO()):
        server.stop()


class Viewer:
    """A page that shows an insertion, on this machine.

    Args:
        robot: The arm with its tool.
        plan: Anatomy and plan, if any.
        urdf_path: The arm's description, for its shapes.
        port: Where; another is taken if it is busy, see `url`.

    Attributes:
        url: Where the page is.
        marks: The ruptures shown, past and to come.
        slider: The time line.
        live: Box that is set while the page follows the newest.
        unread_shapes: Why the arm's shapes cannot be read; it is shown as a line then.

    Raises:
        SceneError: viser is not installed, there is no such port, or the plan has no
            length.
    """

    def __init__(
        self,
        robot: Robot,
        plan: nodes.PlanScene = nodes.EMPTY,
        *,
        urdf_path: Path | None = None,
        port: int = 8080,
    ) -> None:
        self._plan = plan
        self._path = plan.path
        self._server = open_server(port, "needleforce")
        self.url = f"http://{HOST}:{self._server.get_port()}"
        self.marks: list[Mark] = []
        self.moments: list[Moment] = []
        self._lock = threading.Lock()
        self._shown_s: float | None = None
        self._add_scene(robot, urdf_path)
        self._add_panels()
        self._draw_slices(None)
        if self._path is not None:
            self._place_camera(self._path.entry_m)

    def _add_scene(self, robot: Robot, urdf_path: Path | None) -> None:
        """Add the arm, anatomy and plan, and what moves with the needle."""
        server = self._server
        nodes.add_plan(server, self._plan)
        self._arm = nodes.ArmNodes(server, robot, urdf_path)
        self.unread_shapes = self._arm.unread_shapes
        self._nearest = nodes.add_line(
            server, "/nearest", np.zeros((2, 3)), nodes.NEAREST_COLOR, 3.0
        )
        self._nearest.visible = False
        self._force = nodes.ForceArrow(server)
        self._expected = nodes.Ring(
            server, f"{nodes.NEEDLE}/expected", nodes.EXPECTED_COLOR, ""
        )
        self._warning = server.scene.add_label(
            f"{nodes.NEEDLE}/warning",
            "",
            position=(0.0, 0.0, -0.1),  # so far before the tip no other label stands
        )
        server.scene.add_grid("/floor", width=2.0, height=2.0, cell_size=0.1)

    def _add_panels(self) -> None:
        """Add card, CT, state, time line, plots and legend beside the scene.

        What must always be seen stands in the main panel; all else in a second one,
        which is folded at first on a narrow screen.
        """
        gui = self._server.gui
        # With the button any browser could ask for a tunnel to the internet.
        gui.configure_theme(show_logo=False, show_share_button=False)
        plan = self._plan
        self._card = gui.add_html(card_html(None, None, plan))
        gui.add_html(text_html(*(f"Warning: {one}" for one in plan.warnings), NOTE))
        self._headline = gui.add_html(text_html("waiting for the first sample"))
        gui.main_panel.dock_left()
        panel = gui.add_panel()
        with panel.add_tab("Insertion"):
            self.slider = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0)
            self.slider.on_update(self._follow_hand)
            self.live = gui.add_checkbox("live", True)
            self._jumps = gui.add_folder("Ruptures: jump to", visible=False)
            self._plots = ForcePlots(gui)
            self._text = gui.add_html("")
        with panel.add_tab("What is what"):
            for color, text in nodes.legend_of(plan):
                square = f'<b style="color:{color};margin-left:.75rem">■</b>'
                gui.add_html(square + text_html(text))
        panel.dock_right()
        self._images: list[Any] = []
        if plan.scan is not None:
            slices = gui.add_panel()
            empty = np.zeros((PIXELS, PIXELS, 3), np.uint8)
            with slices.add_tab("CT at the needle"):
                self._images = [gui.add_image(empty, label=title) for title in TITLES]
            slices.dock_below(gui.main_panel)
        self._cut_m = np.full((2, 3), np.nan)

    def _place_camera(self, centre_m: Array) -> None:
        """Let browsers look at a place at first."""
        camera = self._server.initial_camera
        camera.look_at = centre_m
        camera.position = centre_m + np.array([0.19, -0.23, 0.11])

    def append(self, moments: Iterable[Moment]) -> None:
        """Add further moments, in the order of time."""
        with self._lock:
            for moment in moments:
                self._mark(moment)
                self.moments.append(moment)
            # Ten minutes; beyond them every second one goes.
            if len(self.moments) > 30_000:
                del self.moments[1::2]

    def _mark(self, moment: Moment) -> None:
        """Mark the rupture of a moment, or retract the latest one."""
        estimate = moment.estimate
        found = estimate.identification
        if self.marks and found.retracted is not None:
            latest = self.marks[-1]
            if latest.layer == found.retracted.layer:
                latest.until_s = estimate.time_s
        if found.rupture is None:
            return
        needle = self._arm.find_needle(moment.q_rad)
        label = f"rupture {found.rupture.layer}"
        name = f"/ruptures/{len(self.marks)}"
        ring = nodes.Ring(self._server, name, nodes.RUPTURE_COLOR, label)
        depth_m = found.rupture.depth_m - estimate.depth_m
        ring.move(needle.tip_m + depth_m * needle.axis, needle.axis)
        ring.show(False)  # until its time is shown
        texts = {event.kind: event.text for event in session_events(estimate)}
        text = shown_name(texts["rupture"])
        self.marks.append(Mark(estimate.time_s, found.rupture.layer, text, ring))
        self._jumps.visible = True
        with self._jumps:
            button = self._server.gui.add_button(f"{estimate.time_s:.1f} s: {label}")
        button.on_click(lambda _event: self.jump(estimate.time_s))

    def jump(self, time_s: float) -> None:
        """Show a time, and stop there."""
        self.live.value = False
        self.slider.value = round(time_s, 2)
        self.show(time_s)

    def _follow_hand(self, event: Any) -> None:
        """Show the time that somebody has moved the time line to."""
        if event.client is not None:  # by hand, not by the program
            self.jump(self.slider.value)

    def show(self, time_s: float | None = None) -> None:
        """Show the state at a time, by default the newest."""
        with self._lock:
            if not self.moments:
                return
            index = len(self.moments) - 1
            if time_s is not None:
                later = bisect_right(
                    self.moments, time_s, key=lambda moment: moment.estimate.time_s
                )
                index = max(later - 1, 0)
            shown_s = self.moments[index].estimate.time_s
            if shown_s != self._shown_s:
                self._draw(index)
                self._shown_s = shown_s

    def follow(self) -> None:
        """Show the newest, unless somebody has moved the time line."""
        if self.live.value:
            self.show()

    def open_recording(self) -> None:
        """Show what has come from its start, as a recording that does not go on."""
        if not self.moments:
            return
        start_s = self.moments[0].estimate.time_s
        self.live.visible = False
        self.slider.max = max(self.moments[-1].estimate.time_s, start_s + 0.01)
        self.slider.min = start_s
        self.jump(start_s)

    def _draw(self, index: int) -> None:
        """Draw the moment of an index, and what had happened until then."""
        moment = self.moments[index]
        estimate = moment.estimate
        time_s = estimate.time_s
        with self._server.atomic():
            needle = self._arm.update(moment.q_rad)
            banner = find_banner(estimate)
            is_red = banner not in ("", CANNOT_TELL)
            color = nodes.WARNING_COLOR if is_red else nodes.NEEDLE_COLOR
            self._arm.needle.color = color
            self._warning.visible = bool(banner)
            self._warning.text = banner.upper()
            known = [
                mark for mark in self.marks if mark.time_s <= time_s < mark.until_s
            ]
            for mark in self.marks:
                mark.ring.show(mark in known)
            self._draw_expected(moment)
            self._draw_nearest(moment, needle)
            self._force.draw(estimate.identification, estimate.status.value == "ok")
            deviation = estimate.deviation
            is_far = deviation is not None and deviation.depth_m < -nodes.PATH_LEAD_m
            self._draw_slices(None if is_far else needle)
            self._card.content = card_html(estimate, needle, self._plan)
            self._headline.content = text_html(
                f"{time_s:.1f} s, {describe_depth(estimate)}; tip force "
                f"{estimate.identification.tip_force_N:.2f} N"
            )
            ruptures = [f"• {mark.text}" for mark in known]
            self._text.content = text_html(*ruptures, *describe_state(estimate))
            self._plots.draw(self.moments[: index + 1])
            if self.live.value:
                self.slider.max = max(time_s, 0.01)
                self.slider.value = round(time_s, 2)
        if self._shown_s is None and self._path is None:
            self._place_camera(needle.tip_m)

    def _draw_expected(self, moment: Moment) -> None:
        """Show where the next boundary is expected."""
        plan = moment.estimate.plan
        is_expected = plan is not None and bool(np.isfinite(plan.next_m))
        self._expected.show(is_expected)
        if plan is not None and is_expected:
            ahead_m = plan.next_m - moment.estimate.depth_m
            self._expected.line.position = (0.0, 0.0, ahead_m)
            self._expected.label.text = f"{shown_name(plan.next_name)}, expected"

    def _draw_nearest(self, moment: Moment, needle: nodes.NeedlePose) -> None:
        """Draw a line from the needle to the nearest structure at risk."""
        clearances = moment.estimate.clearances
        self._nearest.visible = bool(clearances) and self._path is not None
        if not clearances or self._path is None:
            return
        nearest = clearances[0]
        place_m = np.array([nearest.x_m, nearest.y_m, nearest.z_m])
        # On the needle in the body, or on its way ahead as far as the target is deep.
        depth_m = float((needle.tip_m - self._path.entry_m) @ self._path.axis)
        ahead_m = max(self._path.length_m - depth_m, 0.0)
        along_m = (place_m - needle.tip_m) @ needle.axis
        along_m = float(np.clip(along_m, -max(depth_m, 0.0), ahead_m))
        line_m = np.array([needle.tip_m + along_m * needle.axis, place_m])
        self._nearest.points = nodes.segments_of(line_m)
        color = nodes.WARNING_COLOR if nearest.is_too_near else nodes.NEAREST_COLOR
        self._nearest.colors = np.array(color, np.uint8)

    def _draw_slices(self, needle: nodes.NeedlePose | None) -> None:
        """Draw the CT at the needle, or at the planned target, if anything moved."""
        if self._path is None or not self._images:
            return
        place = needle or nodes.NeedlePose(self._path.target_m, self._path.axis)
        shown_m = PIXELS * PIXEL_m * place.axis
        cut_m = np.array([place.tip_m, place.tip_m - shown_m])
        if np.allclose(cut_m, self._cut_m, rtol=0.0, atol=PIXEL_m):
            return
        self._cut_m = cut_m
        pictures = draw_slices(self._plan, self._path, needle)
        for image, picture in zip(self._images, pictures, strict=True):
            image.image = picture

    def export(self, path: str | Path, *, frames: int = 120) -> Path:
        """Write the scene as one page that needs nothing else, with a film.

        Args:
            path: Of the page.
            frames: Pictures of the film from the first moment to the last, beside one
                for each rupture.

        Raises:
            SceneError: Nothing has come, or the file cannot be written.
            MissingExtraError: jinja2 is not installed.
        """
        if not self.moments:
            raise SceneError("nothing to export: no moment has come")
        serializer = self._server.get_scene_serializer()
        start_s = self.moments[0].estimate.time_s
        end_s = max(self.moments[-1].estimate.time_s, start_s + 0.05)
        shown_s = np.linspace(start_s, end_s, max(frames, 2))
        shown_s = np.unique([*shown_s, *(mark.time_s for mark in self.marks)])
        for time_s, step_s in zip(shown_s, np.diff(shown_s, append=end_s), strict=True):
            self.show(float(time_s))
            serializer.insert_sleep(float(step_s))
        ruptures = [
            f"{mark.time_s - start_s:.1f} s: {mark.text}"
            f"{'; retracted' if np.isfinite(mark.until_s) else ''}"
            for mark in self.marks
        ]
        return write_scene_page(Path(path), serializer.as_html(), self._plan, ruptures)

    def stop(self) -> None:
        """Close the page."""
        stop_server(self._server)
