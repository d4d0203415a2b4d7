"""The online identifier: plumbing around pure steps."""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from identification.errors import InvalidConfigError, InvalidSnapshotError, NoRuptureError
from identification.estimate import Estimate, LayerEstimate
from identification.friction_compensation import multilayer_outputs, multilayer_update
from identification.input_validation import (
    LAST_ABSORBED,
    STATUSES,
    CheckMemory,
    CheckState,
    Sample,
    SampleStatus,
    as_scalar,
    check_step,
    packed_limits,
)
from identification.multilayer_config import MULTILAYER, MultilayerConfig
from identification.multilayer_identifier import begin_default_sample, multilayer_step
from identification.multilayer_state import (
    MultilayerState,
    initial_default_state,
    multilayer_coefficients,
    multilayer_layers,
)
from identification.published_config import PublishedConfig
from identification.published_identifier import (
    begin_paper_sample,
    initial_paper_state,
    published_coefficients,
    published_layers,
    published_step,
)
from identification.published_update import paper_figures, published_update
from identification.slope_change_detector import check_detector

# The two methods behind one face: pure functions that the identifier calls.


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
    MultilayerConfig: Method(
        initial=initial_default_state,
        begin=begin_default_sample,
        tick=multilayer_update,
        step=multilayer_step,
        standing=multilayer_coefficients,
        figures=multilayer_outputs,
        layers=multilayer_layers,
    ),
    PublishedConfig: Method(
        initial=initial_paper_state,
        begin=begin_paper_sample,
        tick=published_update,
        step=published_step,
        standing=published_coefficients,
        figures=paper_figures,
        layers=published_layers,
    ),
}
"""By the type of their settings."""


_new = tuple.__new__
"""Makes an `Estimate` of a tuple in a third of the time."""


class Snapshot(NamedTuple):
    """Everything an `Identifier` remembers; immutable, so keeping it costs nothing.

    Attributes:
        config: Configuration it belongs to.
        check: Memory of the sample check.
        state: Memory of the method.
        last: Last estimate.
    """

    config: object
    check: CheckState
    state: Any
    last: Estimate


class Identifier:
    """Finds ruptures and identifies stiffness and friction of each layer, sample by sample.

    Depth grows into the tissue, speed is its rate, force is positive when tissue pushes back.
    """

    def __init__(self, config: MultilayerConfig | PublishedConfig = MULTILAYER) -> None:
        """Choose the method by its configuration.

        Args:
            config: `DEFAULT` or `PUBLISHED`, or one of these with changed fields.

        Raises:
            InvalidConfigError: Not a configuration of this room.
        """
        method = METHODS.get(type(config))
        if method is None:
            known = ", ".join(kind.__name__ for kind in METHODS)
            raise InvalidConfigError(f"config must be one of {known}, got {type(config).__name__}")
        self._config, self._method, self._method_tick = config, method, method.tick
        self._limits = packed_limits(config.check)
        self.reset()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers left so far, in order, as known now."""
        return self._method.layers(self._state)

    def reset(self) -> None:
        """Forget everything: a new insertion begins."""
        config, method = self._config, self._method
        state = method.initial(config)
        figures = method.figures(
            0.0, 0.0, 0.0, state.tick.plain, method.standing(state, config).numbers
        )
        last = _new(Estimate, (0.0, SampleStatus.OK, state.rupture_state, *figures, *state.events))
        self.restore(Snapshot(config, CheckState(), state, last))

    def update(self, depth_m: float, speed_m_s: float, force_N: float, dt_s: float) -> Estimate:
        """Absorb one sample.

        A sample that cannot be trusted (see `SampleStatus`) is reported and skipped: the estimate
        then repeats the last one with the new status.

        Args:
            depth_m: Travel of the tip along the insertion axis [m].
            speed_m_s: Rate of depth [m/s].
            force_N: Axial force, positive when tissue pushes back [N].
            dt_s: Time since the previous sample [s].
        """
        if not (type(depth_m) is type(speed_m_s) is type(force_N) is type(dt_s) is float):
            return self._update_raw((depth_m, speed_m_s, force_N, dt_s))
        number, elapsed_s, depth_m, check = check_step(
            depth_m, speed_m_s, force_N, dt_s, self._check, self._limits
        )
        if number > LAST_ABSORBED:
            return self._refuse(STATUSES[number], check)
        is_calm, tick, figures = self._method_tick(
            depth_m, speed_m_s, force_N, elapsed_s, self._tick, self._numbers
        )
        if not is_calm:
            sample = Sample(check[0], elapsed_s, depth_m, speed_m_s, force_N)
            return self._absorb(sample, (tick, figures), STATUSES[number], check)
        self._check, self._tick = check, tick
        estimate = self._last = _new(
            Estimate, (check[0], STATUSES[number], self._machine, *figures, None, None, None)
        )
        return estimate

    def undo_rupture(self) -> None:
        """Take back the last update, which raised a rupture: as if its sample had never come.

        Raises:
            NoRuptureError: The last update raised none.
        """
        if self._before is None or self._last.rupture is None:
            raise NoRuptureError("the last update raised no rupture: there is none to undo")
        self.restore(self._before)

    def snapshot(self) -> Snapshot:
        """Everything needed to resume exactly here."""
        state = self._state
        state = state._replace(tick=state.tick.of(self._tick))
        return Snapshot(self._config, CheckState(*self._check), state, self._last)

    def restore(self, snapshot: Snapshot) -> None:
        """Resume where `snapshot` was taken, bit for bit.

        Raises:
            InvalidSnapshotError: Not a snapshot, one of another configuration, or a damaged one.
        """
        if not isinstance(snapshot, Snapshot) or snapshot.config != self._config:
            raise InvalidSnapshotError(
                f"expected a Snapshot taken with {self._config}, got {type(snapshot).__name__}"
            )
        _, check, state, last = snapshot
        if isinstance(state, MultilayerState):
            check_detector(state.detector)
        self._stand(state, self._method.standing(state, self._config))
        self._check, self._last, self._before = check.plain, last, None

    def _stand(self, state: Any, standing: Any) -> None:
        """Keep a state and what follows from it: what ordinary samples need, at hand."""
        self._tick, self._machine = state.tick.plain, state.rupture_state
        self._state, self._standing, self._numbers = state, standing, standing.numbers

    def _absorb(
        self,
        sample: Sample,
        done: tuple[tuple[Any, ...], tuple[Any, ...]],
        status: SampleStatus,
        check: CheckMemory,
    ) -> Estimate:
        """A sample that asks more than `Method.tick`, which has given `done`."""
        before = (self._state, self._standing, self._tick)
        state, standing, figures = self._method.absorb(before, sample, done, self._config)
        self._before = None if state.rupture is None else self.snapshot()
        self._stand(state, standing)
        self._check = check
        estimate = (sample.time_s, status, self._machine, *figures, *state.events)
        self._last = _new(Estimate, estimate)
        return self._last

    def _update_raw(self, values: tuple[object, ...]) -> Estimate:
        """As `update`, for values of any type."""
        scalars = [as_scalar(value) for value in values]
        numbers = [scalar for scalar in scalars if scalar is not None]
        if len(numbers) == len(scalars):
            return self.update(*numbers)
        # Judged as one that is not finite: its time passes, if it has one.
        dt_s = math.nan if scalars[-1] is None else scalars[-1]
        *_, check = check_step(math.nan, 0.0, 0.0, dt_s, self._check, self._limits)
        return self._refuse(SampleStatus.NOT_A_SCALAR, check)

    def _refuse(self, status: SampleStatus, check: CheckMemory) -> Estimate:
        """A sample that is not absorbed: the last estimate, its events over."""
        self._check = check
        self._last = self._last._replace(
            time_s=check[0], status=status, rupture=None, compensated=None, withdrawn=None
        )
        return self._last
