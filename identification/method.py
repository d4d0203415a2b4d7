"""The two methods behind one face: pure functions that the identifier calls."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from identification.default_config import DefaultConfig
from identification.default_layers import default_layers
from identification.default_standing import default_standing
from identification.default_state import initial_default_state
from identification.default_step import begin_default_sample, default_step
from identification.default_tick import default_figures, default_tick
from identification.estimate import LayerEstimate
from identification.paper_config import PaperConfig
from identification.paper_standing import paper_standing
from identification.paper_step import (
    begin_paper_sample,
    initial_paper_state,
    paper_layers,
    paper_step,
)
from identification.paper_tick import paper_figures, paper_tick
from identification.sample import Sample


@dataclass(frozen=True, slots=True)
class Method:
    """One way of identifying.

    Attributes:
        initial: State before the first sample.
        begin: Before a sample, where one is due.
        tick: What every sample asks; mostly that is all.
        step: What else a sample asks, where it does.
        standing: What `tick` reads of the state.
        figures: What is told of the state after a sample.
        layers: Layers left so far.
    """

    initial: Callable[[Any], Any]
    begin: Callable[[Any, Any], Any]
    tick: Callable[..., tuple[bool, tuple[Any, ...], tuple[Any, ...]]]
    step: Callable[[Any, Any, Sample, Any], Any]
    standing: Callable[[Any, Any], Any]
    figures: Callable[..., tuple[Any, ...]]
    layers: Callable[[Any], tuple[LayerEstimate, ...]]

    def absorb(
        self,
        before: tuple[Any, Any, tuple[Any, ...]],
        sample: Sample,
        done: tuple[tuple[Any, ...], tuple[Any, ...]],
        config: Any,
    ) -> tuple[Any, Any, tuple[Any, ...]]:
        """Absorb a sample that asks more than `tick`.

        Args:
            before: A state, what stands of it, and the fields of its tick before the sample: those
                in the state may be older.
            sample: The sample.
            done: What `tick` made of it: fields and figures.
            config: Settings.

        Returns:
            The state after it, what stands of that, and the figures to tell.
        """
        (state, standing, last), (fields, figures) = before, done
        _, dt_s, depth_m, speed_m_s, force_N = sample
        if standing.is_due:
            state = self.begin(state._replace(tick=state.tick.of(last)), config)
            if not standing.holds(state):
                standing = self.standing(state, config)
                _, fields, figures = self.tick(
                    depth_m, speed_m_s, force_N, dt_s, state.tick.plain, standing.numbers
                )
        state = self.step(state, state.tick.of(fields), sample, config)
        if not standing.holds(state):
            standing = self.standing(state, config)
            figures = self.figures(depth_m, speed_m_s, force_N, state.tick.plain, standing.numbers)
        return state, standing, figures


METHODS: dict[type, Method] = {
    DefaultConfig: Method(
        initial=initial_default_state,
        begin=begin_default_sample,
        tick=default_tick,
        step=default_step,
        standing=default_standing,
        figures=default_figures,
        layers=default_layers,
    ),
    PaperConfig: Method(
        initial=initial_paper_state,
        begin=begin_paper_sample,
        tick=paper_tick,
        step=paper_step,
        standing=paper_standing,
        figures=paper_figures,
        layers=paper_layers,
    ),
}
"""By the type of their settings."""
