"""The online identifier: check a sample, filter its travel, ask the method, report.

The methods stand in `identification.mixture` and `identification.published`.
"""

import math
from collections.abc import Sequence
from copy import deepcopy
from dataclasses import replace
from typing import Any, NamedTuple, Protocol

from foundation.jit import compile_waiting
from foundation.records import as_record, from_record, read_field
from foundation.state import SAME_KIND
from identification.config import MIXTURE, MixtureConfig, PublishedConfig
from identification.errors import InvalidConfigError, InvalidSnapshotError
from identification.estimate import (
    Estimate,
    LayerEstimate,
    Rupture,
    Sample,
    SampleStatus,
)
from identification.mixture.method import MixtureMethod, MixtureMethodState
from identification.published.online import PublishedState
from identification.sample_check import STATUSES, CheckState, as_scalar
from identification.travel_filter import TravelState, process_sample


class Method(Protocol):
    """What an `Identifier` needs of a method, which gets checked samples only."""

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        ...

    @property
    def contact_depth_m(self) -> float | None:
        """Depth at which tissue was met first; None where that is not known."""
        ...

    @property
    def state(self) -> Any:
        """Everything that it remembers, as an immutable tree."""
        ...

    def first_estimate(self) -> Estimate:
        """Return the estimate before the first sample."""
        ...

    def use(self, sample: Sample, status: SampleStatus) -> Estimate:
        """Use one sample; return the estimate after it."""
        ...

    def restore(self, state: Any) -> None:
        """Resume from a state, bit for bit."""
        ...

    def doubt_zero(self, std_N: float) -> None:
        """Take the zero of the force for changed, by a standard deviation."""
        ...

    def doubt_ruptures(self, age_s: float) -> None:
        """Take ruptures of the last time for less likely than none."""
        ...


def make_method(config: MixtureConfig | PublishedConfig) -> Method:
    """Return a new method of a configuration.

    Raises:
        InvalidConfigError: Another type of configuration.
    """
    if type(config) is MixtureConfig:
        return MixtureMethod(config)
    if type(config) is PublishedConfig:
        # Imported here: what only it needs is compiled when it is asked for.
        from identification.published.online import PublishedMethod

        return PublishedMethod(config)
    raise InvalidConfigError(
        "config must be one of MixtureConfig, PublishedConfig, got "
        f"{type(config).__name__}"
    )


class Snapshot(NamedTuple):
    """Everything an `Identifier` remembers; nothing changes it.

    Attributes:
        config: Configuration it belongs to.
        check: State of the sample check.
        travel: State of the travel filter.
        state: State of the method.
        last: Last estimate.
    """

    config: MixtureConfig | PublishedConfig
    check: CheckState
    travel: TravelState
    state: PublishedState | MixtureMethodState
    last: Estimate


class Identifier:
    """Online identification of ruptures, and of each layer's stiffness and friction.

    Depth grows into the tissue, speed is its rate, force is positive when tissue pushes
    back. Depths in what it reports have the zero of the depths it is given, see
    `estimate`.
    """

    __copy__ = deepcopy  # A shallow copy would share what every sample changes

    def __init__(self, config: MixtureConfig | PublishedConfig = MIXTURE) -> None:
        """Choose the method by its configuration.

        Args:
            config: `MIXTURE` or `PUBLISHED`, or one of these with changed fields.

        Raises:
            InvalidConfigError: Another type of configuration.
        """
        self._method = make_method(config)
        compile_waiting()
        self._config = config
        self._limits = as_record(config.check)
        self._max_force_N = float(config.check.force_limit_N)
        self.reset()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        return tuple(
            move_layer(layer, self._removed_m) for layer in self._method.layers
        )

    @property
    def contact_depth_m(self) -> float | None:
        """Depth at which tissue was met first, as known now; None before.

        Always None for the published method, which does not look for it.
        """
        contact_m = self._method.contact_depth_m
        return None if contact_m is None else contact_m + self._removed_m

    def reset(self) -> None:
        """Forget everything: a new insertion begins, its clock at 0."""
        self._method = make_method(self._config)
        self._check = as_record(CheckState())
        self._read_removed()
        self._travel = as_record(TravelState())
        self._last = self._method.first_estimate()

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
        is_speed_measured = speed_m_s is not None
        speed_m_s = speed_m_s if is_speed_measured else 0.0
        if not (
            type(depth_m) is type(speed_m_s) is type(force_N) is type(dt_s) is float
            and type(force_std_N) is float
            and (time_s is None or (type(time_s) is float and math.isfinite(time_s)))
        ):
            values = (depth_m, speed_m_s, force_N, dt_s)
            return self._update_unchecked(
                values, is_speed_measured, time_s, force_std_N
            )
        (
            status_number,
            elapsed_s,
            clock_s,
            raw_depth_m,
            filtered_depth_m,
            filtered_speed_m_s,
            depth_std_m,
            speed_std_m_s,
        ) = process_sample(
            depth_m,
            speed_m_s,
            force_N,
            dt_s,
            is_speed_measured,
            self._limits,
            self._check,
            self._travel,
        )
        if time_s is None:
            time_s = clock_s
        status = STATUSES[status_number]
        if not status.is_used:
            return self._reject(status, time_s)
        if not 0.0 <= force_std_N <= self._max_force_N:
            force_std_N = 0.0
        speed_m_s = speed_m_s if is_speed_measured else filtered_speed_m_s
        sample = Sample(
            time_s=time_s,
            dt_s=elapsed_s,
            depth_m=filtered_depth_m,
            speed_m_s=filtered_speed_m_s,
            depth_std_m=depth_std_m,
            speed_std_m_s=speed_std_m_s,
            force_N=force_N,
            force_std_N=force_std_N,
            raw_depth_m=raw_depth_m,
            raw_speed_m_s=speed_m_s,
            clock_s=clock_s,
        )
        estimate = self._method.use(sample, status)
        if self._removed_m != 0.0 and estimate.has_events:
            estimate = move_events(estimate, self._removed_m)
        self._last = estimate
        return estimate

    def doubt_zero(self, std_N: float, age_s: float) -> None:
        """Take the zero of the force for changed a short while before the last sample.

        A step of the force since then, and at the next sample, may be one of its zero:
        it is no rupture unless more speaks for one, and an alarm is retracted. The
        published method knows no zero.

        Args:
            std_N: Standard deviation of that change; what is no positive number changes
                nothing.
            age_s: Time between that change and the last sample.
        """
        if math.isfinite(std_N) and std_N > 0.0:
            self._method.doubt_zero(std_N)
            self._method.doubt_ruptures(age_s)

    def snapshot(self) -> Snapshot:
        """Return everything needed to resume exactly here."""
        return Snapshot(
            config=self._config,
            check=from_record(CheckState, self._check),
            travel=from_record(TravelState, self._travel),
            state=self._method.state,
            last=self._last,
        )

    def restore(self, snapshot: Snapshot) -> None:
        """Resume where `snapshot` was taken, bit for bit.

        Raises:
            InvalidSnapshotError: Not a snapshot, or one of another configuration.
        """
        if not isinstance(snapshot, Snapshot) or snapshot.config != self._config:
            raise InvalidSnapshotError(
                f"expected a Snapshot taken with {self._config}, got "
                f"{type(snapshot).__name__}",
                SAME_KIND,
            )
        self.resume(snapshot)

    def resume(self, snapshot: Snapshot) -> None:
        """Resume a snapshot taken by this identifier itself; it is not checked."""
        self._method.restore(snapshot.state)
        self._check = as_record(snapshot.check)
        self._read_removed()
        self._travel = as_record(snapshot.travel)
        self._last = snapshot.last

    def _read_removed(self) -> None:
        """Keep the sum of the jumps that were removed from the depth."""
        self._removed_m = float(read_field(self._check, "removed_m"))

    def _update_unchecked(
        self,
        values: Sequence[object],
        is_speed_measured: bool,
        time_s: object,
        force_std_N: object,
    ) -> Estimate:
        """Convert values of any type to floats, and use or reject the sample.

        `values` are depth, speed, force and time step.
        """
        depth_m, speed_m_s, force_N, dt_s = map(as_scalar, values)
        time = as_scalar(0.0 if time_s is None else time_s)
        if time is None or not math.isfinite(time):
            self._pass_time(dt_s, is_speed_measured)
            status = SampleStatus.NOT_A_SCALAR
            if time is not None and None not in (depth_m, speed_m_s, force_N, dt_s):
                status = SampleStatus.NOT_FINITE
            return self._reject(status, self._last.time_s)
        if depth_m is None or speed_m_s is None or force_N is None or dt_s is None:
            self._pass_time(dt_s, is_speed_measured)
            clock_s = float(read_field(self._check, "time_s"))
            return self._reject(
                SampleStatus.NOT_A_SCALAR, clock_s if time_s is None else time
            )
        return self.update(
            depth_m,
            speed_m_s if is_speed_measured else None,
            force_N,
            dt_s,
            time_s=None if time_s is None else time,
            force_std_N=as_scalar(force_std_N) or 0.0,
        )

    def _pass_time(self, dt_s: float | None, is_speed_measured: bool) -> None:
        """Let the time of a sample pass whose values cannot be used, if it has any."""
        process_sample(
            math.nan,
            0.0,
            0.0,
            math.nan if dt_s is None else dt_s,
            is_speed_measured,
            self._limits,
            self._check,
            self._travel,
        )

    def _reject(self, status: SampleStatus, time_s: float) -> Estimate:
        """Repeat the last estimate, its events over, for a sample that is not used."""
        self._read_removed()  # a jump of the depth is such a sample
        self._last = self._last.without_events()._replace(time_s=time_s, status=status)
        return self._last


def move_rupture(rupture: Rupture | None, by_m: float) -> Rupture | None:
    """Return a rupture whose depths count from another zero."""
    if rupture is None:
        return None
    return replace(
        rupture,
        depth_m=rupture.depth_m + by_m,
        alarm_depth_m=rupture.alarm_depth_m + by_m,
        contact_depth_m=rupture.contact_depth_m + by_m,
    )


def move_layer(layer: LayerEstimate, by_m: float) -> LayerEstimate:
    """Return a layer whose depths count from another zero."""
    if by_m == 0.0:
        return layer
    return replace(
        layer,
        start_depth_m=layer.start_depth_m + by_m,
        rupture=move_rupture(layer.rupture, by_m),
    )


def move_events(estimate: Estimate, by_m: float) -> Estimate:
    """Return an estimate the depths of whose events count from another zero."""
    layer = estimate.identified_layer
    contact = estimate.hard_contact
    if contact is not None:
        contact = replace(contact, depth_m=contact.depth_m + by_m)
    return estimate._replace(
        rupture=move_rupture(estimate.rupture, by_m),
        identified_layer=None if layer is None else move_layer(layer, by_m),
        retracted=move_rupture(estimate.retracted, by_m),
        provisional=move_rupture(estimate.provisional, by_m),
        provisional_retracted=move_rupture(estimate.provisional_retracted, by_m),
        hard_contact=contact,
    )
