"""The online identifier: two methods behind one class."""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

from identification import friction_compensation as multilayer_update
from identification import (
    multilayer_identifier,
    multilayer_state,
    published_identifier,
    published_update,
)
from identification.config import MULTILAYER, MultilayerConfig, PublishedConfig
from identification.errors import InvalidConfigError, InvalidSnapshotError, NoRuptureError
from identification.estimate import Estimate, Events, LayerEstimate, Sample, SampleStatus
from identification.input_validation import (
    LAST_USED,
    STATUSES,
    CheckMemory,
    CheckState,
    as_scalar,
    check_limits,
    check_sample,
    check_state,
)
from identification.multilayer_state import MultilayerState
from identification.published_identifier import PublishedState
from identification.travel_filter import TravelState, filter_travel
from needleforce.jit import jit_arguments

_new = tuple.__new__
"""Makes an `Estimate` of a tuple in a third of the time."""
_AT_REST = (0.0, 0.0, 0.0, 0.0)


@dataclass(frozen=True, slots=True)
class _Method:
    """One way of identifying, as pure functions."""

    initial: Callable[[Any], Any]  # State before the first sample
    begin: Callable[[Any, Any], Any]  # Before a sample, where one is due
    # What every sample asks; mostly that is all
    update: Callable[..., tuple[bool, tuple[Any, ...], tuple[Any, ...]]]
    step: Callable[[Any, Any, Sample, Any], Any]  # What else a sample asks, where it does
    outputs: Callable[..., tuple[Any, ...]]  # What to report of the state after a sample
    arguments: Callable[[Any, Any], tuple[Any, ...]]  # What the two read of the state
    plain: Callable[[Any], tuple[Any, ...]]  # The state's memory as compiled code takes it
    memory: Callable[[tuple[Any, ...]], Any]  # The same back
    is_filtered: bool  # Whether it takes depth and speed from the travel filter, or as they come


def _multilayer_arguments(state: MultilayerState, config: MultilayerConfig) -> tuple[Any, ...]:
    coefficients = multilayer_state.multilayer_coefficients(state, config)
    friction = (layer.friction for layer in state.traversed)
    return (
        jit_arguments(multilayer_update.MultilayerCoefficients, coefficients),
        jit_arguments(multilayer_update.LayerFriction, *friction),
    )


def _published_arguments(state: PublishedState, config: PublishedConfig) -> tuple[Any, ...]:
    coefficients = published_identifier.published_coefficients(state, config)
    return (jit_arguments(published_update.PublishedCoefficients, coefficients),)


# Functions by name, since an identifier can be pickled.
def _as_it_is(state: Any, _config: Any) -> Any:
    return state


def _plain_memory(memory: published_update.PublishedMemory) -> Any:
    return memory.plain


_METHODS: dict[type, _Method] = {
    MultilayerConfig: _Method(
        initial=multilayer_state.initial_multilayer_state,
        begin=_as_it_is,
        update=multilayer_update.update_multilayer,
        step=multilayer_identifier.multilayer_step,
        outputs=multilayer_update.multilayer_outputs,
        arguments=_multilayer_arguments,
        plain=tuple,
        memory=multilayer_update.MultilayerMemory._make,
        is_filtered=True,
    ),
    PublishedConfig: _Method(
        initial=published_identifier.initial_published_state,
        begin=published_identifier.begin_published_sample,
        update=published_update.update_published,
        step=published_identifier.published_step,
        outputs=published_update.published_outputs,
        arguments=_published_arguments,
        plain=_plain_memory,
        memory=published_update.PublishedMemory.of,
        is_filtered=False,
    ),
}
"""By the type of their settings."""


class Snapshot(NamedTuple):
    """Everything an `Identifier` remembers; immutable, so keeping it costs nothing.

    Attributes:
        config: Configuration it belongs to.
        check: Memory of the sample check.
        travel: Memory of the travel filter.
        state: Memory of the method.
        last: Last estimate.
    """

    config: MultilayerConfig | PublishedConfig
    check: CheckState
    travel: TravelState
    state: MultilayerState | PublishedState
    last: Estimate


class Identifier:
    """Finds ruptures and identifies stiffness and friction of each layer, sample by sample.

    Depth grows into the tissue, speed is its rate, force is positive when tissue pushes back.
    Depths in what it reports have the zero of the depths it is given, see `estimate`.
    """

    def __init__(self, config: MultilayerConfig | PublishedConfig = MULTILAYER) -> None:
        """Choose the method by its configuration.

        Args:
            config: `MULTILAYER` or `PUBLISHED`, or one of these with changed fields.

        Raises:
            InvalidConfigError: Another type of configuration.
        """
        method = _METHODS.get(type(config))
        if method is None:
            known = ", ".join(kind.__name__ for kind in _METHODS)
            raise InvalidConfigError(f"config must be one of {known}, got {type(config).__name__}")
        self._config, self._method, self._method_update = config, method, method.update
        self._limits = check_limits(config.check)
        self.reset()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        layers, shift_m = self._state.known_layers, self._check[_SHIFT]
        return tuple(_in_callers_depth(layer, shift_m) for layer in layers)

    def reset(self) -> None:
        """Forget everything: a new insertion begins, its clock at 0."""
        config, method = self._config, self._method
        state = method.initial(config)
        memory, arguments = method.plain(state.memory), method.arguments(state, config)
        outputs = method.outputs(_AT_REST, 0.0, memory, *arguments)
        last = Estimate(0.0, SampleStatus.OK, state.rupture_state, *outputs, *state.events)
        self._resume(Snapshot(config, CheckState(), TravelState(), state, last))

    def update(
        self,
        depth_m: float,
        speed_m_s: float,
        force_N: float,
        dt_s: float,
        time_s: float | None = None,
    ) -> Estimate:
        """Use one sample.

        A sample that cannot be trusted (see `SampleStatus`) is reported and skipped: the estimate
        then repeats the last one with the new status.

        Args:
            depth_m: Travel of the tip along the insertion axis [m].
            speed_m_s: Rate of depth [m/s].
            force_N: Axial force, positive when tissue pushes back [N].
            dt_s: Time since the previous sample [s].
            time_s: Time of the sample on the clock on which estimates and events are to be
                reported [s]; None for the sum of ``dt_s`` since the reset.
        """
        if not (type(depth_m) is type(speed_m_s) is type(force_N) is type(dt_s) is float) or (
            time_s is not None and not (type(time_s) is float and math.isfinite(time_s))
        ):
            return self._update_raw((depth_m, speed_m_s, force_N, dt_s), time_s)
        number, elapsed_s, depth_m, check = check_sample(
            depth_m, speed_m_s, force_N, dt_s, self._check, self._limits
        )
        if time_s is None:
            time_s = check[0]
        if number > LAST_USED:
            return self._reject(STATUSES[number], time_s, check)
        motion, self._travel = filter_travel(depth_m, speed_m_s, elapsed_s, self._travel)
        if not self._method.is_filtered:
            motion = depth_m, speed_m_s, 0.0, 0.0
        is_all, memory, outputs = self._method_update(
            motion, force_N, elapsed_s, self._memory, *self._arguments
        )
        if not is_all:
            sample = Sample(time_s, elapsed_s, motion, force_N)
            return self._step(sample, memory, outputs, STATUSES[number], check)
        self._check, self._memory = check, memory
        estimate = self._last = _new(
            Estimate, (time_s, STATUSES[number], self._rupture_state, *outputs, None, None, None)
        )
        return estimate

    def undo_rupture(self) -> None:
        """Take back the last update, which raised a rupture: as if its sample had never come.

        Raises:
            NoRuptureError: The last update raised none.
        """
        if self._before is None or self._last.rupture is None:
            raise NoRuptureError("the last update raised no rupture: there is none to undo")
        self._resume(self._before)

    def snapshot(self) -> Snapshot:
        """Everything needed to resume exactly here."""
        state = self._state._replace(memory=self._method.memory(self._memory))
        check, travel = CheckState(*self._check), TravelState.of(self._travel)
        return Snapshot(self._config, check, travel, state, self._last)

    def restore(self, snapshot: Snapshot) -> None:
        """Resume where `snapshot` was taken, bit for bit.

        Raises:
            InvalidSnapshotError: Not a snapshot, one of another configuration, or a damaged one.
                Nothing has then changed.
        """
        if not isinstance(snapshot, Snapshot) or snapshot.config != self._config:
            raise InvalidSnapshotError(
                f"expected a Snapshot taken with {self._config}, got {type(snapshot).__name__}"
            )
        check_state(snapshot.state, self._method.initial(self._config))
        check_state(snapshot.check, CheckState())
        check_state(snapshot.travel, TravelState())
        self._resume(snapshot)

    def _resume(self, snapshot: Snapshot) -> None:
        _, check, travel, state, last = snapshot
        self._keep(state, self._method.arguments(state, self._config))
        self._check, self._travel = check[:], travel.plain
        self._last, self._before = last, None

    def _keep(self, state: Any, arguments: tuple[Any, ...]) -> None:
        """Keep a state, and at hand what ordinary samples need of it."""
        self._memory, self._rupture_state = self._method.plain(state.memory), state.rupture_state
        self._state, self._arguments = state, arguments

    def _step(
        self,
        sample: Sample,
        memory: tuple[Any, ...],
        outputs: tuple[Any, ...],
        status: SampleStatus,
        check: CheckMemory,
    ) -> Estimate:
        """A sample that asks more than `_Method.update`, which has given memory and outputs."""
        method, state, arguments = self._method, self._state, self._arguments
        _, dt_s, motion, force_N = sample
        if state.is_due:
            # The memory in the state is older than the one at hand, its events are over.
            fresh = state._replace(memory=method.memory(self._memory), events=Events())
            begun = method.begin(fresh, self._config)
            if _coefficients_change(state, begun):
                arguments = method.arguments(begun, self._config)
                before = method.plain(begun.memory)
                _, memory, outputs = method.update(motion, force_N, dt_s, before, *arguments)
            state = begun
        new = method.step(state, method.memory(memory), sample, self._config)
        if _coefficients_change(state, new):
            arguments = method.arguments(new, self._config)
            memory = method.plain(new.memory)
            outputs = method.outputs(motion, force_N, memory, *arguments)
        self._before = None if new.events.rupture is None else self.snapshot()
        self._keep(new, arguments)
        self._check = check
        events = (_in_callers_depth(event, check[_SHIFT]) for event in new.events)
        estimate = (sample.time_s, status, self._rupture_state, *outputs, *events)
        self._last = _new(Estimate, estimate)
        return self._last

    def _update_raw(self, values: tuple[object, ...], time_s: object) -> Estimate:
        """As `update`, for values of any type."""
        *numbers, time = map(as_scalar, (*values, 0.0 if time_s is None else time_s))
        if time is not None and math.isfinite(time) and None not in numbers:
            return self.update(*numbers, time_s=None if time_s is None else time)  # type: ignore
        # Handled as one that is not finite: its time passes, if it has one.
        dt_s = math.nan if numbers[-1] is None else numbers[-1]
        *_, check = check_sample(math.nan, 0.0, 0.0, dt_s, self._check, self._limits)
        is_odd = time is None or None in numbers
        status = SampleStatus.NOT_A_SCALAR if is_odd else SampleStatus.NOT_FINITE
        if time is None or not math.isfinite(time):
            time = self._last.time_s
        return self._reject(status, check[0] if time_s is None else time, check)

    def _reject(self, status: SampleStatus, time_s: float, check: CheckMemory) -> Estimate:
        """A sample that is not used: the last estimate, its events over."""
        self._check = check
        self._last = self._last._replace(time_s=time_s, status=status, **Events()._asdict())
        return self._last


_SHIFT = CheckState._fields.index("depth_shift_m")


def _coefficients_change(before: Any, after: Any) -> bool:
    """Whether another state asks for other coefficients."""
    pairs = zip(before.sources, after.sources, strict=True)
    return any(one is not other for one, other in pairs)


def _in_callers_depth(event: Any, shift_m: float) -> Any:
    """An event with the jumps that were removed from the depth: in the caller's depth."""
    if event is None or shift_m == 0.0:
        return event
    if isinstance(event, LayerEstimate):
        return replace(
            event,
            start_depth_m=event.start_depth_m + shift_m,
            rupture=_in_callers_depth(event.rupture, shift_m),
        )
    return replace(
        event,
        depth_m=event.depth_m + shift_m,
        alarm_depth_m=event.alarm_depth_m + shift_m,
        contact_depth_m=event.contact_depth_m + shift_m,
    )
