"""The page: the scene, the card, forces over time and depth, a time line.

Moments come in any number at a time. While `live` is set the page shows the newest.
When the time line is moved back, the page hides what had not happened yet: the arm, the
forces and the marks of ruptures are those of that time.
"""

import threading
from base64 import b64encode
from bisect import bisect_right
from collections.abc import Iterable
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from foundation.extras import install_command
from needleforce.needle_on_plan import CANNOT_TELL
from needleforce.scene import nodes
from needleforce.scene.force_plots import ForcePlots
from needleforce.scene.insertion_card import card_html
from needleforce.scene.moment import FREE_PORT, Moment, SceneError
from needleforce.scene.scan_slices import PIXELS, TITLES, PIXEL_m, draw_slices
from needleforce.scene.time_line import TimeLine
from needleforce.scene.words import (
    MEANINGS,
    NOTE,
    describe_depth,
    describe_rupture,
    describe_state,
    find_banner,
    shown_name,
    text_html,
)
from urdf import Robot

HOST = "127.0.0.1"
"""The page is for this machine alone; for others, ssh forwards its port."""

MAX_MOMENTS = 30_000
"""Ten minutes of those that are kept; beyond them every second one goes."""


class Mark(NamedTuple):
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

    def __str__(self) -> str:
        """Return it in words, also whether it was retracted."""
        return self.text if np.isinf(self.until_s) else f"{self.text}; retracted"


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
    last_port = 65535  # behind it viser would look for a free one for ever
    if not 0 <= port <= last_port:
        raise SceneError(f"port {port}; expected 0 to {last_port}", FREE_PORT)
    with redirect_stdout(StringIO()):  # viser's banner is no result
        server = viser.ViserServer(host=HOST, port=port, label=label, verbose=False)
    return server


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
        time: The time line.
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
        self._tips_m: list[Array] = []
        self._lock = threading.Lock()
        self._shown_s: float | None = None
        self._is_filmed = False
        self._cut_at: nodes.NeedlePose | None = None
        self._add_scene(robot, urdf_path)
        self._add_panels()
        self._show_banner("")
        self._draw_slices(None)
        if self._path is not None:
            self._place_camera(self._path.entry_m)

    def _add_scene(self, robot: Robot, urdf_path: Path | None) -> None:
        """Add the arm, anatomy and plan, and what moves with the needle."""
        server = self._server
        scene = server.scene
        self._structures = nodes.add_plan(server, self._plan)
        self._arm = nodes.ArmNodes(server, robot, urdf_path)
        self.unread_shapes = self._arm.unread_shapes
        nowhere_m = np.zeros((2, 3))
        line = nodes.add_line
        self._trail = line(server, "/trail", nowhere_m, nodes.FORCE_COLOR, 3.0)
        self._nearest = line(server, "/nearest", nowhere_m, nodes.NEAREST_COLOR, 3.0)
        self._force_std = line(server, "/force/std", nowhere_m, nodes.STD_COLOR, 5.0)
        self._force = scene.add_arrows(
            "/force/arrow",
            nodes.segments_of(np.array([[0.0, 0.0, 0.0], [0.0, 0.0, 5e-3]])),
            nodes.FORCE_COLOR,
            shaft_radius=1.2e-3,
            head_radius=3e-3,
            head_length=5e-3,
        )
        self._expected = nodes.Ring(server, "/expected", nodes.EXPECTED_COLOR, "")
        self._warning = scene.add_label("/warning", "")
        for node in (self._trail, self._nearest, self._force_std, self._force):
            node.visible = False
        self._expected.show(False)
        self._warning.visible = False
        scene.add_grid("/floor", width=2.0, height=2.0, cell_size=0.1)

    def _add_panels(self) -> None:
        """Add card, CT, state, time line, plots and structures beside the scene.

        What must always be seen stands in the main panel; all else in a second one,
        which is folded at first on a narrow screen.
        """
        gui = self._server.gui
        plan = self._plan
        self._card = gui.add_html(card_html(None, None, plan))
        gui.add_html(text_html(*(f"Warning: {warning}" for warning in plan.warnings)))
        self._headline = gui.add_html(text_html("waiting for the first sample"))
        gui.main_panel.dock_left()
        panel = gui.add_panel()
        with panel.add_tab("Insertion"):
            gui.add_html(text_html(f"needleforce – {NOTE}"))
            self.time = TimeLine(gui, self.show)
            self._plots = ForcePlots(gui)
            self._text = gui.add_html("")
        with panel.add_tab("Structures"):
            for name, node in sorted(self._structures.items()):
                self._add_structure(name, node)
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

    def _add_structure(self, name: str, node: Any) -> None:
        """Add box and slider of a structure."""
        gui = self._server.gui
        box = gui.add_checkbox(shown_name(name), True)
        slider = gui.add_slider("opacity", 0.0, 1.0, 0.02, nodes.usual_opacity(name))

        def show(_event: Any) -> None:
            node.visible = box.value
            node.opacity = slider.value

        box.on_update(show)
        slider.on_update(show)

    def _place_camera(self, centre_m: Array) -> None:
        """Let browsers look at a place at first."""
        camera = self._server.initial_camera
        camera.look_at = centre_m
        camera.position = centre_m + np.array([0.19, -0.23, 0.11])

    def append(self, moments: Iterable[Moment]) -> None:
        """Add further moments, in the order of time."""
        with self._lock:
            for moment in moments:
                needle = self._arm.find_needle(moment.q_rad)
                self._mark(moment, needle)
                self.moments.append(moment)
                self._tips_m.append(needle.tip_m)
            if len(self.moments) > MAX_MOMENTS:
                self.moments = self.moments[::2]
                self._tips_m = self._tips_m[::2]

    def _mark(self, moment: Moment, needle: nodes.NeedlePose) -> None:
        """Mark the rupture of a moment, or retract the latest one."""
        estimate = moment.estimate
        found = estimate.identification
        if self.marks and found.retracted is not None:
            latest = self.marks[-1]
            if latest.layer == found.retracted.layer:
                self.marks[-1] = latest._replace(until_s=estimate.time_s)
        if found.rupture is None:
            return
        text = describe_rupture(estimate)
        layer = found.rupture.layer
        name = f"/ruptures/{len(self.marks)}"
        ring = nodes.Ring(self._server, name, nodes.RUPTURE_COLOR, f"rupture {layer}")
        depth_m = found.rupture.depth_m - estimate.depth_m
        ring.move(needle.tip_m + depth_m * needle.axis, needle.axis)
        ring.show(False)  # until its time is shown
        self.marks.append(Mark(estimate.time_s, layer, text, ring))
        self.time.add_jump(estimate.time_s, f"rupture {layer}")

    def show(self, time_s: float | None = None) -> None:
        """Show the state at a time, by default the newest."""
        with self._lock:
            if not self.moments:
                return
            index = len(self.moments) - 1
            if time_s is not None:
                times_s = [moment.estimate.time_s for moment in self.moments]
                index = max(bisect_right(times_s, time_s) - 1, 0)
            shown_s = self.moments[index].estimate.time_s
            if shown_s != self._shown_s:
                self._draw(index)
                self._shown_s = shown_s

    def follow(self) -> None:
        """Show the newest, unless somebody has moved the time line."""
        if self.time.live.value:
            self.show()

    def open_recording(self) -> None:
        """Show what has come from its start, as a recording that does not go on."""
        if not self.moments:
            return
        start_s = self.moments[0].estimate.time_s
        self.time.live.visible = False
        self.time.set_span(start_s, self.moments[-1].estimate.time_s)
        self.time.jump(start_s)

    def _draw(self, index: int) -> None:
        """Draw the moment of an index, and what had happened until then."""
        moment = self.moments[index]
        estimate = moment.estimate
        with self._server.atomic():
            needle = self._arm.update(moment.q_rad)
            self._draw_verdict(moment, needle)
            self._draw_marks(moment, needle)
            self._draw_nearest(moment, needle)
            self._draw_force(moment, needle)
            self._draw_trail(index)
            deviation = estimate.deviation
            is_far = deviation is not None and deviation.depth_m < -nodes.PATH_LEAD_m
            self._draw_slices(None if is_far else needle)
            self._card.content = card_html(estimate, needle, self._plan)
            tip_N = estimate.identification.tip_force_N
            self._headline.content = text_html(
                f"{estimate.time_s:.1f} s, {describe_depth(estimate)}; "
                f"tip force {tip_N:.2f} N"
            )
            known = [f"• {mark.text}" for mark in self._known_marks(estimate.time_s)]
            self._text.content = text_html(*known, *describe_state(estimate))
            self._plots.draw(self.moments[: index + 1])
            if self.time.live.value:
                self.time.set_span(0.0, estimate.time_s)
                self.time.slider.value = round(estimate.time_s, 2)
        if self._shown_s is None and self._path is None:
            self._place_camera(needle.tip_m)

    def _known_marks(self, time_s: float) -> list[Mark]:
        """Return the ruptures that stood at a time."""
        return [mark for mark in self.marks if mark.time_s <= time_s < mark.until_s]

    def _draw_verdict(self, moment: Moment, needle: nodes.NeedlePose) -> None:
        """Turn the needle red and say so while it is off the plan or too deep."""
        banner = find_banner(moment.estimate)
        is_red = banner not in ("", CANNOT_TELL)
        self._arm.needle.color = nodes.WARNING_COLOR if is_red else nodes.NEEDLE_COLOR
        self._show_banner(banner)
        self._warning.visible = bool(banner)
        self._warning.text = banner.upper()
        # So far before the tip no other label stands.
        self._warning.position = needle.tip_m - 0.1 * needle.axis

    def _show_banner(self, banner: str) -> None:
        """Show a verdict in the title bar, which a narrow screen shows, too.

        It is a picture there: buttons vanish in a menu on a narrow screen.
        """
        warnings = [f"Warning: {warning}." for warning in self._plan.warnings]
        said = [f"{banner.upper()}: {MEANINGS[banner]}."] if banner else []
        shown = banner.upper() or ("⚠ warnings" if warnings else "")
        color = "#b3261e" if banner else "#8a5a00"
        svg = (
            '<svg xmlns="http://www.w3.org/2000/svg" width="260" height="28" '
            'font-family="sans-serif" font-size="13"><text x="0" y="19" '
            f'fill="{color}" font-weight="bold">{shown}</text>'
            '<text x="110" y="19">Not a medical device</text></svg>'
        )
        picture = b64encode(svg.encode()).decode()
        image = {
            "image_url_light": f"data:image/svg+xml;base64,{picture}",
            "image_url_dark": None,
            "image_alt": " ".join((*said, NOTE, *warnings)),
            "href": None,
        }
        # A film has no title bar: what it said at the end would stand over all of it.
        content = None if self._is_filmed else {"buttons": (), "image": image}
        # Without the button any browser could ask for a tunnel to the internet.
        self._server.gui.configure_theme(
            titlebar_content=content,
            show_logo=False,
            show_share_button=False,
        )

    def _draw_marks(self, moment: Moment, needle: nodes.NeedlePose) -> None:
        """Show the ruptures known at a moment, and where the next one is expected."""
        known = self._known_marks(moment.estimate.time_s)
        for mark in self.marks:
            mark.ring.show(mark in known)
        plan = moment.estimate.plan
        is_expected = plan is not None and bool(np.isfinite(plan.next_m))
        self._expected.show(is_expected)
        if plan is not None and is_expected:
            distance_m = plan.next_m - moment.estimate.depth_m
            self._expected.move(needle.tip_m + distance_m * needle.axis, needle.axis)
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

    def _draw_force(self, moment: Moment, needle: nodes.NeedlePose) -> None:
        """Draw the tip force as an arrow beside the needle, with its deviation."""
        m_per_N = 25e-3
        min_N = 0.02  # a shorter arrow is shorter than its head is wide
        found = moment.estimate.identification
        is_valid = moment.estimate.status.value == "ok"
        is_shown = is_valid and abs(found.tip_force_N) >= min_N
        self._force.visible = is_shown
        self._force_std.visible = is_shown
        if not is_shown:
            return
        side = nodes.rotation_along(needle.axis)[:, 0]
        tissue = -m_per_N * needle.axis  # pushes the tip back
        std_N = 2.0 * (found.tip_force_std_N or 0.0)
        start_m = needle.tip_m + 6e-3 * side
        ends_m = np.outer([0.0, found.tip_force_N], tissue)
        self._force.points = nodes.segments_of(start_m + ends_m)
        bar_N = [found.tip_force_N - std_N, found.tip_force_N + std_N]
        bar_m = start_m + 3e-3 * side + np.outer(bar_N, tissue)
        self._force_std.points = nodes.segments_of(bar_m)

    def _draw_trail(self, index: int) -> None:
        """Draw the path of the tip in tissue until a moment."""
        step = index // 200 + 1
        tips_m = [
            tip_m
            for tip_m, (_, estimate) in zip(
                self._tips_m[: index + 1 : step],
                self.moments[: index + 1 : step],
                strict=True,
            )
            if estimate.depth_in_tissue_m is not None
        ]
        self._trail.visible = len(tips_m) > 1
        if len(tips_m) > 1:
            self._trail.points = nodes.segments_of(np.array(tips_m))

    def _draw_slices(self, needle: nodes.NeedlePose | None) -> None:
        """Draw the CT at the needle, or at the planned target, if anything moved."""
        if self._path is None or not self._images:
            return
        place = needle or nodes.NeedlePose(self._path.target_m, self._path.axis)
        if self._cut_at is not None:
            travel_m = np.linalg.norm(place.tip_m - self._cut_at.tip_m)
            turn_m = np.linalg.norm(place.axis - self._cut_at.axis) * PIXELS * PIXEL_m
            if max(travel_m, turn_m) < PIXEL_m:
                return
        self._cut_at = place
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
        from needleforce.scene.export_page import write_scene_page

        if not self.moments:
            raise SceneError("nothing to export: no moment has come")
        self._is_filmed = True
        self._show_banner("")
        serializer = self._server.get_scene_serializer()
        start_s = self.moments[0].estimate.time_s
        end_s = max(self.moments[-1].estimate.time_s, start_s + 0.05)
        shown_s = np.linspace(start_s, end_s, max(frames, 2))
        shown_s = np.unique([*shown_s, *(mark.time_s for mark in self.marks)])
        for time_s, step_s in zip(shown_s, np.diff(shown_s, append=end_s), strict=True):
            self.show(float(time_s))
            serializer.insert_sleep(float(step_s))
        scene = serializer.as_html()  # before the title bar is back
        self._is_filmed = False
        self._show_banner(find_banner(self.moments[-1].estimate))
        ruptures = [f"{mark.time_s - start_s:.1f} s: {mark}" for mark in self.marks]
        return write_scene_page(Path(path), scene, self._plan, ruptures)

    def stop(self) -> None:
        """Close the page."""
        stop_server(self._server)
