"""The page: the scene, forces over time and depth, the tip force as a bar, a time line.

Rows come in any number at a time. While `live` is set the page shows the newest; moving
the time line back takes back what had not happened yet: the arm, the forces, the marks
of ruptures.
"""

import errno
import socket
import threading
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import Any, NamedTuple

import numpy as np

from needleforce.files import whole_file
from needleforce.scene import nodes
from needleforce.scene.state_ring import FIELDS, Array, SceneError
from urdf import Robot

MOST_N = 4.0  # force at which the bar is full
POINTS = 500  # of a curve; older ones are thinned
KEPT_HZ = 50.0
MOST_ROWS = 30_000
FRAME_s = 0.05
NOTE = "Simulation and research only: not a medical device."
CURVES = {
    "force": ("force_N", "force_std_N", "42, 157, 111"),
    "tip force": ("tip_N", "tip_std_N", "138, 58, 185"),
}  # name, fields of the rows, colour
AT = {name: column for column, name in enumerate(FIELDS)}


class Mark(NamedTuple):
    """A detected rupture in the scene.

    Attributes:
        number: Of the layer that ruptured.
        until_s: When it was taken back.
    """

    time_s: float
    number: float
    text: str
    handles: list[Any]
    until_s: float = np.inf


class _Seen(SimpleNamespace):
    """A row by the names of its fields, in words; behind ± stand two standard
    deviations.
    """

    def __init__(self, row: Array, plan: nodes.PlanScene) -> None:
        super().__init__(**dict(zip(FIELDS, row.tolist(), strict=False)))
        self.names = {-1: "outside"} | {
            k: layer.name for k, layer in enumerate(plan.layers)
        }
        self.next_name = self.names.get(self.plan_layer + 1.0, "")

    def event(self) -> str:
        """The rupture of this row."""
        text = f"rupture {self.rupture:.0f} at {1e3 * self.rupture_depth_m:.1f} mm"
        if np.isnan(self.plan_matched):
            return text
        into = self.names.get(self.plan_matched, "")
        where = f"into {into}" if self.plan_matched >= 0.0 else "a false alarm"
        return f"{text}: {where} ({100.0 * self.plan_matched_probability:.0f} %)"

    def lines(self) -> Iterator[str]:
        """What is known."""
        tared = "" if self.is_good else " (not tared, or doubtful)"
        place = f"at {1e3 * self.depth_m:.1f} mm, layer {self.layer:.0f}"
        yield f"**{self.time_s:.1f} s** {place}"
        yield f"force {self.force_N:.2f} ± {2.0 * self.force_std_N:.2f} N{tared}"
        tip = f"**tip force {self.tip_N:.2f} ± {2.0 * self.tip_std_N:.2f} N**"
        yield f"{tip}, shaft friction {self.friction_N:.2f} N; the bar is full at {MOST_N:g} N"
        if np.isnan(self.plan_layer):
            return
        name = self.names.get(self.plan_layer, "")
        certain = 100.0 * self.plan_probability
        here = f"in **{name}** ({certain:.0f} %)"
        next_mm = f"{1e3 * self.plan_next_m:.1f} ± {2e3 * self.plan_next_std_m:.1f} mm"
        yield f"{here}, {self.next_name} at {next_mm}" if self.next_name else here
        off = f"{1e3 * self.plan_offset_m:+.1f} ± {2e3 * self.plan_offset_std_m:.1f} mm"
        yield f"all lies {off} deeper than planned"


def check_address(host: str, port: int) -> None:
    """Raise `SceneError` where nothing can listen: viser would wait for ever. Busy
    is no fault.
    """
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        socket.create_server((host, port), family=family).close()
    except (OSError, OverflowError, UnicodeError) as error:
        # Of a busy port viser takes the next; behind the last it would wait for ever,
        # too.
        if getattr(error, "errno", None) != errno.EADDRINUSE or port == 65535:
            how = "expected an address of this machine, and a port of 0 to 65535"
            raise SceneError(f"{host}, port {port}: {error}; {how}") from error


class Viewer:
    """A page that shows an insertion.

    Args:
        robot: The arm with its tool.
        plan: Anatomy and plan, if any.
        urdf_path: The arm's description, for its shapes.
        host: Address to listen on.
        port: Where; another is taken if it is busy, see `url`.

    Attributes:
        url: Where the page is.
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
    ) -> None:
        try:
            import viser
        except ImportError as error:
            raise SceneError("viser is not installed; pip install viser") from error
        check_address(host, port)
        self._server = viser.ViserServer(
            host=host, port=port, label="needleforce", verbose=False
        )
        self.url = f"http://{self._server.get_host()}:{self._server.get_port()}"
        self._server.scene.set_up_direction("+z")
        self._rows = np.empty((0, len(FIELDS) + robot.nv))
        self._plan = plan
        self.marks: list[Mark] = []
        self._lock = threading.Lock()
        self._arm = nodes.ArmNodes(self._server, robot, urdf_path)
        nodes.add_anatomy(self._server, plan)
        at = np.zeros(3)
        up = np.array([0.0, 0.0, 1.0])
        self._ahead = nodes.add_ring(self._server, "/ahead", at, up, nodes.EXPECTED, "")
        self._server.scene.add_grid("/floor", width=2.0, height=2.0, cell_size=0.1)
        self._shown_s = -1.0
        self._add_panel()

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
        self._plots = {
            name: self._add_plot(name) for name in ("time [s]", "depth [mm]")
        }
        self._slider.on_update(self._scrubbed)
        self._play.on_click(
            lambda _: threading.Thread(target=self._replay, daemon=True).start()
        )

    def _add_plot(self, x_label: str) -> Any:
        from viser import uplot

        series = [uplot.Series(label=x_label)]
        bands = []
        for name, (_, _, color) in CURVES.items():
            pair = (len(series) + 1, len(series) + 2)
            bands.append(uplot.Band(series=pair, fill=f"rgba({color}, 0.18)"))
            for label, width in (
                (f"{name} [N]", 2.0),
                ("+ 2 std", 0.3),
                ("- 2 std", 0.3),
            ):
                series.append(
                    uplot.Series(label=label, stroke=f"rgb({color})", width=width)
                )
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
        """Take further rows, (n, fields and joints), in the order of time."""
        rows = np.asarray(rows, dtype=float)
        if not len(rows):
            return
        with self._lock:
            events = (rows[:, [AT["rupture"], AT["retracted"]]] > 0.0).any(axis=1)
            for row in rows[events]:
                self._mark(row)
            slots = np.floor(rows[:, 0] * KEPT_HZ)
            last = np.floor(self._rows[-1, 0] * KEPT_HZ) if len(self._rows) else -np.inf
            fresh = events | (np.diff(slots, prepend=last) > 0.0)
            self._rows = np.vstack([self._rows, rows[fresh]])
            if len(self._rows) > MOST_ROWS:
                self._rows = self._rows[::2]

    def _mark(self, row: Array) -> None:
        """Mark the rupture of a row, or take the last one back."""
        seen = _Seen(row, self._plan)
        if self.marks and self.marks[-1].number == seen.retracted:
            self.marks[-1] = self.marks[-1]._replace(until_s=seen.time_s)
        if not seen.rupture:
            return
        tip, axis = self._arm.update(row[len(FIELDS) :])
        place = tip + (seen.rupture_depth_m - seen.depth_m) * axis
        text = seen.event()
        name = f"/ruptures/{len(self.marks)}"
        handles = nodes.add_ring(self._server, name, place, axis, nodes.FOUND, text)
        for handle in handles:
            handle.visible = False  # until its time is shown
        self.marks.append(Mark(seen.time_s, seen.rupture, text, handles))

    def show(self, time_s: float | None = None) -> None:
        """Show the state at a time, by default the newest."""
        with self._lock:
            if not len(self._rows):
                return
            times = self._rows[:, 0]
            now_s = float(times[-1]) if time_s is None else float(time_s)
            at = int(
                np.clip(np.searchsorted(times, now_s, "right") - 1, 0, len(times) - 1)
            )
            if times[at] == self._shown_s:
                return
            self._draw(at)
            self._shown_s = float(times[at])

    def follow(self) -> None:
        """Show the newest, unless somebody has moved the time line."""
        if self._live.value:
            self.show()

    def _draw(self, at: int) -> None:
        row = self._rows[at]
        ring, label = self._ahead
        seen = _Seen(row, self._plan)
        with self._server.atomic():
            tip, axis = self._arm.update(row[len(FIELDS) :])
            past = [
                mark for mark in self.marks if mark.time_s <= seen.time_s < mark.until_s
            ]
            for mark in self.marks:
                for handle in mark.handles:
                    handle.visible = mark in past
            ring.visible = label.visible = bool(np.isfinite(seen.plan_next_m))
            if ring.visible:
                ring.position = tuple(tip + (seen.plan_next_m - seen.depth_m) * axis)
                ring.wxyz = nodes.turned_to(axis)
                label.text = f"{seen.next_name}, expected"
            self._slider.max = max(float(self._rows[-1, 0]), 0.01)
            if self._live.value:
                self._slider.value = round(seen.time_s, 2)
            self._text.content = "\n\n".join(seen.lines())
            self._events.content = "\n".join(f"- {mark.text}" for mark in past)
            self._bar.value = float(np.clip(100.0 * seen.tip_N / MOST_N, 0.0, 100.0))
            self._draw_curves(at)
        if self._shown_s < 0.0:  # the first
            self._server.initial_camera.look_at = tuple(tip)
            self._server.initial_camera.position = tuple(tip + nodes.CAMERA_m)

    def _draw_curves(self, at: int) -> None:
        rows = self._rows[: at + 1]
        good = rows[rows[:, AT["is_good"]] > 0.0]
        good = good[:: max(len(good) // POINTS, 1)]
        curves = []
        for value, std, _ in CURVES.values():
            middle = good[:, AT[value]]
            band = 2.0 * good[:, AT[std]]
            curves += [middle, middle + band, middle - band]
        self._plots["time [s]"].data = (good[:, 0], *curves)
        # A curve over depth runs forth and back: only what is deeper than all before.
        depth = good[:, AT["depth_m"]]
        deeper = depth >= np.maximum.accumulate(depth)
        self._plots["depth [mm]"].data = tuple(
            values[deeper] for values in (1e3 * depth, *curves)
        )

    def _scrubbed(self, event: Any) -> None:
        if event.client is not None:  # by hand, not by the program
            self._live.value = False
            self.show(self._slider.value)

    def _replay(self) -> None:
        """From where the time line stands to its end, in real time."""
        self._live.value = False
        self._play.disabled = True
        now_s = float(self._slider.value)
        last_s = self._slider.max
        begin_s = time.monotonic() - (0.0 if now_s >= last_s - FRAME_s else now_s)
        while (now_s := time.monotonic() - begin_s) < last_s + FRAME_s:
            self._slider.value = round(min(now_s, last_s), 2)
            self.show(now_s)
            time.sleep(FRAME_s)
        self._play.disabled = False

    def export(self, path: str | Path, *, frames: int = 120) -> Path:
        """Write the scene as one page that needs nothing else, with the insertion as a
        film.

        Raises:
            SceneError: Nothing was shown yet, or the file cannot be written.
        """
        if not len(self._rows):
            raise SceneError("nothing to export: no rows have come")
        serializer = self._server.get_scene_serializer()
        first_s, last_s = self._rows[[0, -1], 0].tolist()
        times, step_s = np.linspace(
            first_s, max(last_s, first_s + FRAME_s), frames, retstep=True
        )
        for now_s in times.tolist():
            self.show(now_s)
            serializer.insert_sleep(float(step_s))
        try:
            with whole_file(path) as file:
                file.write(serializer.as_html().encode())
        except OSError as error:
            raise SceneError(f"cannot write {path}: {error.strerror}") from error
        return Path(path)

    def stop(self) -> None:
        """Close the page."""
        self._server.stop()
