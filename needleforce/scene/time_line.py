"""The time line of a page: it follows the newest, plays, and jumps to ruptures."""

import threading
import time
from collections.abc import Callable
from typing import Any

FRAME_s = 0.05
"""Time from picture to picture when a recording is played."""


class TimeLine:
    """The time line with its buttons.

    Args:
        gui: Of the page.
        show: Shows the state at a time.

    Attributes:
        slider: The time line.
        live: Box that is set while the page follows the newest.
        play: Button that plays, and pauses.
        speed: How fast.
    """

    def __init__(self, gui: Any, show: Callable[[float], None]) -> None:
        self._gui = gui
        self._show = show
        self._is_playing = threading.Event()
        self.slider = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0)
        self.play = gui.add_button("Play")
        speeds = ("0.25", "0.5", "1", "2", "4", "8")
        self.speed = gui.add_dropdown("speed", speeds, initial_value="1")
        self.live = gui.add_checkbox("live", True)
        self._jumps = gui.add_folder("Ruptures: jump to", visible=False)
        self.slider.on_update(self._follow_slider)
        self.play.on_click(self._toggle)

    def set_span(self, start_s: float, end_s: float) -> None:
        """Let the time line begin and end at a time."""
        self.slider.max = max(end_s, start_s + 0.01)
        self.slider.min = start_s

    def add_jump(self, time_s: float, text: str) -> None:
        """Add a button that jumps to a time."""
        self._jumps.visible = True
        with self._jumps:
            button = self._gui.add_button(f"{time_s:.1f} s: {text}")
        button.on_click(lambda _event: self.jump(time_s))

    def jump(self, time_s: float) -> None:
        """Show a time, and stop there."""
        self._is_playing.clear()
        self.live.value = False
        self.slider.value = round(time_s, 2)
        self._show(time_s)

    def _follow_slider(self, event: Any) -> None:
        """Show the time that somebody has moved the time line to."""
        if event.client is not None:  # by hand, not by the program
            self.jump(self.slider.value)

    def _toggle(self, _event: Any) -> None:
        """Play, or pause."""
        if self._is_playing.is_set():
            self._is_playing.clear()
            return
        self._is_playing.set()
        threading.Thread(target=self._run, daemon=True).start()

    def _run(self) -> None:
        """Play from where the time line stands to its end; from its end anew."""
        self.live.value = False
        self.play.label = "Pause"
        shown_s = float(self.slider.value)
        if shown_s >= self.slider.max - FRAME_s:
            shown_s = float(self.slider.min)
        before_s = time.monotonic()
        while self._is_playing.is_set() and shown_s < self.slider.max:
            time.sleep(FRAME_s)
            now_s = time.monotonic()
            shown_s += float(self.speed.value) * (now_s - before_s)
            before_s = now_s
            shown_s = min(shown_s, self.slider.max)
            self.slider.value = round(shown_s, 2)
            self._show(shown_s)
        self._is_playing.clear()
        self.play.label = "Play"
