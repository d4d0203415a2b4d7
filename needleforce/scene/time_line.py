"""The time line of a page: it follows the newest, and jumps to ruptures."""

from collections.abc import Callable
from typing import Any


class TimeLine:
    """The time line with its buttons.

    Args:
        gui: Of the page.
        show: Shows the state at a time.

    Attributes:
        slider: The time line.
        live: Box that is set while the page follows the newest.
    """

    def __init__(self, gui: Any, show: Callable[[float], None]) -> None:
        self._gui = gui
        self._show = show
        self.slider = gui.add_slider("time [s]", 0.0, 1.0, 0.01, 0.0)
        self.live = gui.add_checkbox("live", True)
        self._jumps = gui.add_folder("Ruptures: jump to", visible=False)
        self.slider.on_update(self._follow_slider)

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
        self.live.value = False
        self.slider.value = round(time_s, 2)
        self._show(time_s)

    def _follow_slider(self, event: Any) -> None:
        """Show the time that somebody has moved the time line to."""
        if event.client is not None:  # by hand, not by the program
            self.jump(self.slider.value)
