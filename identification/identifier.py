"""The online identifier: one class in front of the methods."""

import math
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from identification.config import MULTILAYER, MultilayerConfig, PublishedConfig
from identification.errors import InvalidConfigError, InvalidSnapshotError, NoRuptureError
from identification.estimate import Estimate, Events, LayerEstimate, Sample, SampleStatus
from identification.input_validation import (
    LAST_USED,
    STATUSES,
    CheckState,
    as_scalar,
    check_limits,
    check_sample,
    check_state,
)
from identification.published_identifier import PublishedMethod, PublishedState
from identification.switching_identifier import SwitchingMethod, SwitchingState
from identification.travel_filter import TravelState, filter_travel

_new = tuple.__new__
"""Makes an `Estimate` of a tuple in a third of the time."""


class Method(Protocol):
    """One way of identifying, made from its configuration; it gets checked samples only.

    Attributes:
        takes_filtered_travel: Whether depth and speed come from the travel filter, or as given.
        before: State before the last update that raised a rupture.
    """

    takes_filtered_travel: bool
    before: Any

    @property
    def state(self) -> Any:
        """All that it remembers: an immutable tree of named tuples, numbers and arrays."""
        ...

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, as known now."""
        ...

    def restore(self, state: Any) -> None:
        """Go on, bit for bit, from an earlier `state`."""
        ...

    def report(self) -> tuple[Any, ...]:
        """What `update` would return of a sample at zero depth, speed and force, without events."""
        ...

    def update(self, sample: Sample) -> tuple[Any, ...]:
        """Use one sample; returns the fields of `Estimate` from ``rupture_state`` on."""
        ...


_METHODS: dict[type, type[Method]] = {
    MultilayerConfig: SwitchingMethod,
    PublishedConfig: PublishedMethod,
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
    state: PublishedState | SwitchingState
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
        if type(config) not in _METHODS:
            known = ", ".join(kind.__name__ for kind in _METHODS)
            raise InvalidConfigError(f"config must be one of {known}, got {type(config).__name__}")
        self._config, self._limits = config, check_limits(config.check)
        self.reset()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        shift_m = self._check[_SHIFT]
        return tuple(_in_callers_depth(layer, shift_m) for layer in self._method.layers)

    def reset(self) -> None:
        """Forget everything: a new insertion begins, its clock at 0."""
        self._method = self._new_method()
        self._check, self._travel = CheckState()[:], TravelState()[:]
        self._last = Estimate(0.0, SampleStatus.OK, *self._method.report())
        self._before: Snapshot | None = None

    def update(
        self,
        depth_m: float,
        speed_m_s: float | None,
        force_N: float,
        dt_s: float,
        time_s: float | None = None,
    ) -> Estimate:
        """Use one sample.

        A sample that cannot be trusted (see `SampleStatus`) is reported and skipped: the estimate
        then repeats the last one with the new status.

        Args:
            depth_m: Travel of the tip along the insertion axis [m].
            speed_m_s: Rate of depth [m/s]; None where nobody measures it: it is then estimated
                from the depths.
            force_N: Axial force, positive when tissue pushes back [N].
            dt_s: Time since the previous sample [s].
            time_s: Time of the sample on the clock on which estimates and events are to be
                reported [s]; None for the sum of ``dt_s`` since the reset.
        """
        is_measured = speed_m_s is not None
        speed = speed_m_s if is_measured else self._travel[1]
        if not (type(depth_m) is type(speed) is type(force_N) is type(dt_s) is float) or (
            time_s is not None and not (type(time_s) is float and math.isfinite(time_s))
        ):
            return self._update_raw((depth_m, speed, force_N, dt_s), is_measured, time_s)
        check, travel, last = self._check, self._travel, self._last
        number, elapsed_s, depth_m, self._check = check_sample(
            depth_m, speed, force_N, dt_s, is_measured, check, self._limits
        )
        if time_s is None:
            time_s = self._check[0]
        if number > LAST_USED:
            return self._reject(STATUSES[number], time_s)
        given = speed if is_measured else math.nan
        motion, self._travel = filter_travel(depth_m, given, elapsed_s, travel)
        method = self._method
        if not method.takes_filtered_travel:
            motion = (depth_m, speed if is_measured else motion[1], 0.0, 0.0)
        found = method.update(_new(Sample, (time_s, elapsed_s, *motion, force_N)))
        estimate = self._last = _new(Estimate, (time_s, STATUSES[number], *found))
        if found[_EVENTS:] != _NO_EVENTS:
            self._before = Snapshot(
                self._config, CheckState(*check), TravelState(*travel), method.before, last
            )
            shift_m = self._check[_SHIFT]
            events = (_in_callers_depth(event, shift_m) for event in found[_EVENTS:])
            estimate = self._last = _new(Estimate, (*estimate[:_EVENTS], *events))
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
        check, travel = CheckState(*self._check), TravelState(*self._travel)
        return Snapshot(self._config, check, travel, self._method.state, self._last)

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
        check_state(snapshot.state, self._new_method().state)
        check_state(snapshot.check, CheckState())
        check_state(snapshot.travel, TravelState())
        self._resume(snapshot)

    def _new_method(self) -> Method:
        kind: Any = _METHODS[type(self._config)]
        return kind(self._config)

    def _resume(self, snapshot: Snapshot) -> None:
        _, check, travel, state, last = snapshot
        self._method.restore(state)
        self._check, self._travel = check[:], travel[:]
        self._last, self._before = last, None

    def _update_raw(self, values: tuple[Any, ...], is_measured: bool, time_s: object) -> Estimate:
        """As `update`, for values of any type; the speed is measured or estimated."""
        numbers: list[Any] = [as_scalar(value) for value in values]
        time = as_scalar(0.0 if time_s is None else time_s)
        if time is not None and math.isfinite(time) and None not in numbers:
            numbers[1] = numbers[1] if is_measured else None
            return self.update(*numbers, time_s=None if time_s is None else time)
        # Handled as one that is not finite: its time passes, if it has one.
        dt_s = math.nan if numbers[-1] is None else numbers[-1]
        *_, self._check = check_sample(
            math.nan, 0.0, 0.0, dt_s, is_measured, self._check, self._limits
        )
        is_odd = time is None or None in numbers
        status = SampleStatus.NOT_A_SCALAR if is_odd else SampleStatus.NOT_FINITE
        if time is None or not math.isfinite(time):
            time = self._last.time_s
        return self._reject(status, self._check[0] if time_s is None else time)

    def _reject(self, status: SampleStatus, time_s: float) -> Estimate:
        """A sample that is not used: the last estimate, its events over."""
        self._last = self._last._replace(time_s=time_s, status=status, **Events()._asdict())
        return self._last


_SHIFT = CheckState._fields.index("depth_shift_m")
_EVENTS = -len(Events._fields)
_NO_EVENTS = Events()[:]


def _in_callers_depth(event: Any, shift_m: float) -> Any:
    """An event with the jumps that were removed from the depth: in the caller's depth."""
    if event is None or shift_m == 0.0:
        return event
    if isinstance(event, LayerEstimate):
        rupture = _in_callers_depth(event.rupture, shift_m)
        return replace(event, start_depth_m=event.start_depth_m + shift_m, rupture=rupture)
    names = ("depth_m", "alarm_depth_m", "contact_depth_m")
    return replace(event, **{name: getattr(event, name) + shift_m for name in names})
