"""The online identifier: one class in front of the methods."""

import math
from copy import deepcopy
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np

from identification import sample_filter as samples
from identification.config import MULTILAYER, MultilayerConfig, PublishedConfig
from identification.errors import InvalidConfigError, InvalidSnapshotError
from identification.estimate import Array, Estimate, Events, LayerEstimate, SampleStatus
from identification.multilayer.method import SwitchingMethod, SwitchingState
from identification.published.online import PublishedMethod, PublishedState

_new = tuple.__new__  # makes an `Estimate` of a tuple in a third of the time
_METHODS: dict[type, Any] = {
    MultilayerConfig: SwitchingMethod,
    PublishedConfig: PublishedMethod,
}
"""By the type of their settings. A method gets checked samples only: ``update`` uses
one, and returns the fields of `Estimate` from ``rupture_state`` on, ``report`` those of
a sample at zero depth, speed and force; ``state``, an immutable tree, is all that it
remembers, ``restore`` goes on from one, bit for bit."""
_EVENTS = -len(Events._fields)
_NO_EVENTS = Events()[:]


class Snapshot(NamedTuple):
    """Everything an `Identifier` remembers; immutable, so keeping it costs nothing.

    Attributes:
        config: Configuration it belongs to.
        samples: Memory of the sample filter.
        state: Memory of the method.
        last: Last estimate.
    """

    config: MultilayerConfig | PublishedConfig
    samples: Array
    state: PublishedState | SwitchingState
    last: Estimate


class Identifier:
    """Finds ruptures and identifies stiffness and friction of each layer, sample by
    sample.

    Depth grows into the tissue, speed is its rate, force is positive when tissue pushes
    back. Depths in what it reports have the zero of the depths it is given, see
    `estimate`.
    """

    __copy__ = deepcopy  # A shallow copy would share what every sample changes

    def __init__(self, config: MultilayerConfig | PublishedConfig = MULTILAYER) -> None:
        """Choose the method by its configuration.

        Args:
            config: `MULTILAYER` or `PUBLISHED`, or one of these with changed fields.

        Raises:
            InvalidConfigError: Another type of configuration.
        """
        if type(config) not in _METHODS:
            known = ", ".join(kind.__name__ for kind in _METHODS)
            raise InvalidConfigError(
                f"config must be one of {known}, got {type(config).__name__}"
            )
        self._limits = samples.check_limits(config.check)
        self._config = config
        self.reset()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        shift_m = float(self._samples[samples.SHIFT])
        return tuple(_in_callers_depth(layer, shift_m) for layer in self._method.layers)

    @property
    def contact_depth_m(self) -> float | None:
        """Depth at which tissue was met first, as known now; None before.

        Always None for the published method, which does not look for it.
        """
        contact_m = self._method.contact_depth_m
        return (
            None
            if contact_m is None
            else contact_m + float(self._samples[samples.SHIFT])
        )

    def reset(self) -> None:
        """Forget everything: a new insertion begins, its clock at 0."""
        self._method = _METHODS[type(self._config)](self._config)
        self._samples = np.zeros(samples.SAMPLE_MEMORY)
        self._last = Estimate(0.0, SampleStatus.OK, *self._method.report())

    def update(
        self,
        depth_m: float,
        speed_m_s: float | None,
        force_N: float,
        dt_s: float,
        time_s: float | None = None,
        force_std_N: float = 0.0,
    ) -> Estimate:
        """Use one sample.

        A sample that cannot be trusted (see `SampleStatus`) is reported and skipped:
        the estimate then repeats the last one with the new status.

        Args:
            depth_m: Travel of the tip along the insertion axis [m].
            speed_m_s: Rate of depth [m/s]; None where nobody measures it: it is then
                estimated from the depths.
            force_N: Axial force, positive when tissue pushes back [N].
            dt_s: Time since the previous sample [s].
            time_s: Time of the sample on the clock on which estimates and events are to
                be reported [s]; None for the sum of ``dt_s`` since the reset.
            force_std_N: Standard deviation of the force's slow error, as a virtual
                sensor states it [N]. What it grows by after the contact is no part of
                the friction, and widens its deviation; while the needle accelerates, a
                force counts the less the larger it is. What is no number, below zero or
                beyond any plausible force counts as not stated.
        """
        is_measured = speed_m_s is not None
        speed = speed_m_s if is_measured else 0.0
        if (
            not (type(depth_m) is type(speed) is type(force_N) is type(dt_s) is float)
            or type(force_std_N) is not float
            or (
                time_s is not None
                and not (type(time_s) is float and math.isfinite(time_s))
            )
        ):
            raw = (depth_m, speed, force_N, dt_s)
            return self._update_raw(raw, is_measured, time_s, force_std_N)
        method = self._method
        number, elapsed_s, clock_s, place_m, motion = samples.take_sample(
            depth_m, speed, force_N, dt_s, is_measured, self._samples, self._limits
        )
        if time_s is None:
            time_s = clock_s
        if number > samples.LAST_USED:
            return self._reject(samples.STATUSES[number], time_s)
        if not method.takes_filtered_travel:
            motion = (place_m, speed if is_measured else motion[1], 0.0, 0.0)
        std = force_std_N if 0.0 <= force_std_N <= self._limits[-1] else 0.0
        found = method.update(
            (time_s, elapsed_s, *motion, force_N, std, place_m, clock_s)
        )
        if found[_EVENTS:] != _NO_EVENTS:
            shift_m = float(self._samples[samples.SHIFT])
            events = (_in_callers_depth(event, shift_m) for event in found[_EVENTS:])
            found = (*found[:_EVENTS], *events)
        self._last = _new(Estimate, (time_s, samples.STATUSES[number], *found))
        return self._last

    def snapshot(self) -> Snapshot:
        """Everything needed to resume exactly here."""
        return Snapshot(
            self._config, np.array(self._samples), self._method.state, self._last
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Resume where `snapshot` was taken, bit for bit.

        Raises:
            InvalidSnapshotError: Not a snapshot, one of another configuration, or a
                damaged one. Nothing has then changed.
        """
        if not isinstance(snapshot, Snapshot) or snapshot.config != self._config:
            raise InvalidSnapshotError(
                f"expected a Snapshot taken with {self._config}, got {type(snapshot).__name__}"
            )
        check_state(snapshot.state, _METHODS[type(self._config)](self._config).state)
        check_state(snapshot.samples, np.zeros(samples.SAMPLE_MEMORY), "samples")
        self.resume(snapshot)

    def resume(self, snapshot: Snapshot) -> None:
        """As `restore`, of a snapshot this identifier has taken itself, which needs
        no check.
        """
        self._method.restore(snapshot.state)
        self._samples = snapshot.samples.copy()
        self._last = snapshot.last

    def _update_raw(
        self,
        values: tuple[Any, ...],
        is_measured: bool,
        time_s: object,
        force_std_N: object,
    ) -> Estimate:
        """As `update`, for values of any type; the speed is measured or estimated."""
        numbers: list[Any] = [samples.as_scalar(value) for value in values]
        time = samples.as_scalar(0.0 if time_s is None else time_s)
        if time is not None and math.isfinite(time) and None not in numbers:
            numbers[1] = numbers[1] if is_measured else None
            clock_s = None if time_s is None else time
            std = samples.as_scalar(force_std_N) or 0.0
            return self.update(*numbers, time_s=clock_s, force_std_N=std)
        # Handled as one that is not finite: its time passes, if it has one.
        dt_s = math.nan if numbers[-1] is None else numbers[-1]
        samples.take_sample(
            math.nan, 0.0, 0.0, dt_s, is_measured, self._samples, self._limits
        )
        is_odd = time is None or None in numbers
        status = SampleStatus.NOT_A_SCALAR if is_odd else SampleStatus.NOT_FINITE
        if time is None or not math.isfinite(time):
            time = self._last.time_s
        return self._reject(
            status, float(self._samples[samples.TIME]) if time_s is None else time
        )

    def _reject(self, status: SampleStatus, time_s: float) -> Estimate:
        """A sample that is not used: the last estimate, its events over."""
        self._last = self._last.without_events()._replace(time_s=time_s, status=status)
        return self._last


def _in_callers_depth(event: Any, shift_m: float) -> Any:
    """An event with the jumps that were removed from the depth: in the caller's
    depth.
    """
    if event is None or shift_m == 0.0:
        return event
    if isinstance(event, LayerEstimate):
        rupture = _in_callers_depth(event.rupture, shift_m)
        return replace(
            event, start_depth_m=event.start_depth_m + shift_m, rupture=rupture
        )
    names = ("depth_m", "alarm_depth_m", "contact_depth_m")
    return replace(event, **{name: getattr(event, name) + shift_m for name in names})


def check_state(state: Any, initial: Any, place: str = "state") -> None:
    """Refuse a damaged state, before compiled code reads beyond its arrays or a solver
    fails.

    `initial` is the state before the first sample, or None where it has no such part.

    Raises:
        InvalidSnapshotError: A part is of another type, an array of another kind or
            shape, or the covariance of a recursive least squares not positive
            semi-definite.
    """
    if isinstance(state, np.ndarray) or isinstance(initial, np.ndarray):
        _check_array(state, initial, place)
    elif hasattr(initial, "_fields") and type(state) is not type(initial):
        raise InvalidSnapshotError(
            f"{place} is {state!r:.80}, expected {type(initial).__name__}"
        )
    elif damage := getattr(state, "damage", ""):  # it checks itself
        raise InvalidSnapshotError(f"the snapshot is damaged: {place}: {damage}")
    elif isinstance(state, tuple):
        names = getattr(state, "_fields", None) or [f"[{k}]" for k in range(len(state))]
        for name, part in zip(names, state, strict=True):
            check_state(part, getattr(initial, name, None), f"{place}.{name}")


def _check_array(array: Any, initial: Any, place: str) -> None:
    is_array = isinstance(array, np.ndarray) and array.dtype == np.float64
    if not is_array or not array.flags.c_contiguous:
        raise InvalidSnapshotError(
            f"{place} is {array!r:.80}, expected an array of floats"
        )
    if not np.isfinite(array).all():
        raise InvalidSnapshotError(
            f"{place} has numbers that are not finite: {array!r:.80}"
        )
    # Of a history that is empty at first the rows are free, and so are hypotheses.
    free = initial is None or not len(initial) or ".bank." in place
    if initial is not None and array.shape[free:] != initial.shape[free:]:
        raise InvalidSnapshotError(
            f"{place} has shape {array.shape}, expected {initial.shape}"
        )
