"""The page: the scene, forces over time and depth, the tip force as a bar, a time line.

Rows come in any number at a time. While `live` is set the page shows the newest; moving the time
line back takes back what had not happened yet: the arm, the forces, the marks of ruptures.
"""

import threading
import time
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from needleforce.scene.nodes import EMPTY, FOUND, ArmNodes, PlanScene, add_anatomy, add_ring
from needleforce.scene.state_ring import FIELDS
from urdf import Robot

Array = NDArray[np.float64]

LOOPBACK = "127.0.0.1"
MOST_N = 4.0
"""Force at which the bar is full."""
POINTS = 500
"""Of a curve; older ones are thinned."""
KEPT_HZ = 50.0
MOST_ROWS = 30_000
NOTE = "Simulation and research only: not a medical device."
COLORS = {"force": "#2a9d6f", "tip force": "#8a3ab9"}
AT = {name: column for column, name in enumerate(FIELDS)}


class Mark(NamedTuple):
    """A detected rupture in the scene."""

    time_s: float
    text: str
    handles: list[Any]


class SceneError(Exception):
    """A page that cannot be opened or written."""


class Viewer:
    """A page that shows an insertion.

    Args:
        robot: The arm with its tool.
        plan: Anatomy and plan, if any.
        urdf_path: The arm's description, for its shapes.
        host: Address to listen on.
        port: Where; another is taken if it is busy, see `url`.

    Raises:
        SceneError: viser is not installed.
    """

    def __init__(
        self,
        robot: Robot,
        plan: PlanScene = EMPTY,
        *,
        urdf_path: Path | None = None,
        host: str = LOOPBACK,
        port: int = 8080,
    ) -> None:
        try:
            import viser
        except ImportError as error:
            raise SceneError("viser is not installed; pip install viser") from error
        self._server = viser.ViserServer(host=host, port=port, label="needleforce", verbose=False)
        self._server.scene.set_up_direction("+z")
        self._plan, self._rows = plan, np.empty((0, len(FIELDS) + robot.nv))
        self._marks: list[Mark] = []
        self._lock = threading.Lock()
        self._arm = ArmNodes(self._server, robot, urdf_path)
        add_anatomy(self._server, plan)
        self._server.scene.add_grid("/floor", width=2.0, height=2.0, cell_size=0.1)
        self._shown_s = -1.0
        self._add_panel()
        self._has_camera = False

    @property
    def url(self) -> str:
        """Where the page is."""
        return f"http://{self._server.get_host()}:{self._server.get_port()}"

    @property
    def marks(self) -> tuple[Mark, ...]:
        """The ruptures shown, past and to come."""
        return tuple(self._marks)

    def _add_panel(self) -> None:
        gui = self._server.gui
        gui.add_markdown(f"**needleforce** – {NOTE}")
        self._text = gui.add_markdown("waiting for the first sample")
        self._bar = gui.add_progress_bar(0.0, color="violet")
        self._events = gui.add_markdown("")
        with gui.add_folder("Time"):
            self._slider = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0)
            self._live = gui.add_checkbox("live", True)
            self._play = gui.add_button("Play")
        self._plots = {name: self._add_plot(name) for name in ("time [s]", "depth [mm]")}
        self._slider.on_update(lambda event: self._scrubbed(event))
        self._play.on_click(lambda _: threading.Thread(target=self._replay, daemon=True).start())

    def _add_plot(self, x_label: str) -> Any:
        from viser import uplot

        nothing = tuple(np.zeros(1) for _ in range(5))
        series = (
            uplot.Series(label=x_label),
            uplot.Series(label="force [N]", stroke=COLORS["force"], width=1.5),
            uplot.Series(label="upper, 2 std", stroke=COLORS["force"], width=0.3),
            uplot.Series(label="lower", stroke=COLORS["force"], width=0.3),
            uplot.Series(label="tip force [N]", stroke=COLORS["tip force"], width=2.0),
        )
        band = uplot.Band(series=(2, 3), fill="rgba(42, 157, 111, 0.18)")
        scales = {"x": uplot.Scale(time=False, auto=True), "y": uplot.Scale(auto=True)}
        return self._server.gui.add_uplot(
            nothing,
            series,
            title=f"force [N] over {x_label}",
            bands=(band,),
            scales=scales,
            aspect=1.6,
        )

    def append(self, rows: Array) -> None:
        """Take further rows, (n, fields and joints), in the order of time."""
        rows = np.asarray(rows, dtype=float)
        if not len(rows):
            return
        with self._lock:
            for row in rows[rows[:, AT["rupture"]] > 0.0]:
                self._mark(row)
            step_s = 1.0 / KEPT_HZ
            slots = np.floor(rows[:, 0] / step_s)
            last = np.floor(self._rows[-1, 0] / step_s) if len(self._rows) else -np.inf
            fresh = np.diff(slots, prepend=last) > 0.0
            self._rows = np.vstack([self._rows, rows[fresh]])
            if len(self._rows) > MOST_ROWS:
                self._rows = self._rows[::2]

    def _mark(self, row: Array) -> None:
        tip, axis = self._arm.update(row[len(FIELDS) :])
        back = row[AT["depth_m"]] - row[AT["rupture_depth_m"]]
        text = f"rupture {row[AT['rupture']]:.0f} at {1e3 * row[AT['rupture_depth_m']]:.1f} mm"
        name = f"/ruptures/{len(self._marks) + 1}"
        handles = add_ring(self._server, name, tip - back * axis, axis, FOUND, text)
        for handle in handles:
            handle.visible = False  # until its time is shown
        self._marks.append(Mark(float(row[0]), text, handles))

    def show(self, time_s: float | None = None) -> None:
        """Show the state at a time, by default the newest."""
        with self._lock:
            if not len(self._rows):
                return
            times = self._rows[:, 0]
            now_s = float(times[-1]) if time_s is None else float(time_s)
            at = int(np.clip(np.searchsorted(times, now_s, "right") - 1, 0, len(times) - 1))
            if times[at] == self._shown_s:
                return
            self._shown_s = float(times[at])
            self._draw(at)

    def follow(self) -> None:
        """Show the newest, unless somebody has moved the time line."""
        if self._live.value:
            self.show()

    def _draw(self, at: int) -> None:
        row = self._rows[at]
        with self._server.atomic():
            tip, _ = self._arm.update(row[len(FIELDS) :])
            for mark in self._marks:
                for handle in mark.handles:
                    handle.visible = mark.time_s <= row[0]
            self._slider.max = max(float(self._rows[-1, 0]), 0.01)
            if self._live.value:
                self._slider.value = round(float(row[0]), 2)
            self._text.content = self._words(row)
            past = [mark.text for mark in self._marks if mark.time_s <= row[0]]
            self._events.content = "\n".join(f"- {text}" for text in past)
            self._bar.value = float(np.clip(100.0 * row[AT["tip_N"]] / MOST_N, 0.0, 100.0))
            self._draw_curves(at)
        if not self._has_camera:
            self._has_camera = True
            self._server.initial_camera.look_at = tuple(tip)
            self._server.initial_camera.position = tuple(tip + np.array([0.45, -0.55, 0.25]))

    def _words(self, row: Array) -> str:
        value = {name: row[column] for name, column in AT.items()}
        tared = "" if value["is_good"] else " (not tared, or doubtful)"
        lines = (
            f"**{value['time_s']:.1f} s** at {1e3 * value['depth_m']:.1f} mm, "
            f"layer {value['layer']:.0f}",
            f"force {value['force_N']:.2f} ± {2.0 * value['force_std_N']:.2f} N{tared}",
            f"**tip force {value['tip_N']:.2f} N**, shaft friction {value['friction_N']:.2f} N; "
            f"the bar is full at {MOST_N:g} N",
        )
        return "\n\n".join(lines)

    def _draw_curves(self, at: int) -> None:
        rows = self._rows[: at + 1]
        good = rows[rows[:, AT["is_good"]] > 0.0]
        if len(good) < 2:
            return
        good = good[:: max(len(good) // POINTS, 1)]
        force, std = good[:, AT["force_N"]], good[:, AT["force_std_N"]]
        tip = good[:, AT["tip_N"]]
        curves = (force, force + 2.0 * std, force - 2.0 * std, tip)
        self._plots["time [s]"].data = (good[:, 0], *curves)
        # A curve over depth runs forth and back: only what is deeper than all before.
        depth = good[:, AT["depth_m"]]
        deeper = depth >= np.maximum.accumulate(depth)
        self._plots["depth [mm]"].data = tuple(values[deeper] for values in (1e3 * depth, *curves))

    def _scrubbed(self, event: Any) -> None:
        if event.client is not None:  # by hand, not by the program
            self._live.value = False
            self.show(self._slider.value)

    def _replay(self) -> None:
        """From where the time line stands to its end, in real time."""
        self._live.value = False
        self._play.disabled = True
        start_s, begin_s = float(self._slider.value), time.monotonic()
        start_s = 0.0 if start_s >= self._slider.max - 0.05 else start_s
        now_s = start_s
        while now_s < self._slider.max:
            now_s = min(start_s + time.monotonic() - begin_s, self._slider.max)
            self._slider.value = round(now_s, 2)
            self.show(now_s)
            time.sleep(1.0 / 20.0)
        self._play.disabled = False

    def export(self, path: str | Path, *, frames: int = 120) -> Path:
        """Write the scene as one page that needs nothing else, with the insertion as a film.

        Raises:
            SceneError: Nothing was shown yet, or the file cannot be written.
        """
        if len(self._rows) < 2:
            raise SceneError("nothing to export: no rows have come")
        serializer = self._server.get_scene_serializer()
        times = np.linspace(self._rows[0, 0], self._rows[-1, 0], frames)
        for now_s in times:
            self.show(float(now_s))
            serializer.insert_sleep(float(times[1] - times[0]))
        place = Path(path)
        try:
            place.write_text(serializer.as_html(), encoding="utf-8")
        except OSError as error:
            raise SceneError(f"cannot write {path}: {error.strerror}") from error
        return place

    def stop(self) -> None:
        """Close the page."""
        self._server.stop()
