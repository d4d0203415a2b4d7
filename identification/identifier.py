"""The online identifier: check a sample, filter its travel, ask the method, report.

The methods stand in `identification.mixture` and `identification.published`.
"""

import math
from copy import deepcopy
from dataclasses import replace
from typing import Any, NamedTuple

from foundation.jit import compile_waiting
from foundation.records import as_record, from_record, read_field
from foundation.state import SAME_KIND
from identification.config import MIXTURE, MixtureConfig, PublishedConfig
from identification.errors import InvalidConfigError, InvalidSnapshotError
from identification.estimate import (
    EVENTS,
    Estimate,
    LayerEstimate,
    Sample,
    SampleStatus,
)
from identification.mixture.method import MixtureMethod, MixtureMethodState
from identification.published.online import PublishedMethod, PublishedState
from identification.sample_check import STATUSES, CheckState, as_scalar
from identification.travel_filter import TravelState, process_sample


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
        if type(config) not in (MixtureConfig, PublishedConfig):
            raise InvalidConfigError(
                "config must be one of MixtureConfig, PublishedConfig, got "
                f"{type(config).__name__}"
            )
        compile_waiting()
        self._config = config
        self._limits = as_record(config.check)
        self.reset()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers traversed so far, in order, as known now."""
        return tuple(
            count_depth_from_zero(layer, self._removed_m)
            for layer in self._method.layers
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
        self._method = (
            MixtureMethod(self._config)
            if isinstance(self._config, MixtureConfig)
            else PublishedMethod(self._config)
        )
        self._check = as_record(CheckState())
        self._removed_m = 0.0
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
        is_scalar = True
        if not (
            type(depth_m) is type(speed_m_s) is type(force_N) is type(dt_s) is float
            and type(force_std_N) is float
            and (time_s is None or (type(time_s) is float and math.isfinite(time_s)))
        ):
            stamp_s = 0.0 if time_s is None else time_s
            values = (depth_m, speed_m_s, force_N, dt_s, stamp_s)
            scalars = [as_scalar(value) for value in values]
            is_scalar = None not in scalars
            depth_m, speed_m_s, force_N, dt_s, stamp_s = (
                math.nan if scalar is None else scalar for scalar in scalars
            )
            if not math.isfinite(stamp_s):
                depth_m = math.nan  # the sample is rejected, its time passes
                time_s = self._last.time_s
            elif time_s is not None:
                time_s = stamp_s
            force_std_N = as_scalar(force_std_N) or 0.0
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
        status = STATUSES[status_number] if is_scalar else SampleStatus.NOT_A_SCALAR
        if not status.is_used:
            self._removed_m = float(read_field(self._check, "removed_m"))  # by a jump
            last = self._last.without_events()
            self._last = last._replace(time_s=time_s, status=status)
            return self._last
        if not 0.0 <= force_std_N <= self._config.check.force_limit_N:
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
            events = {name: getattr(estimate, name) for name in EVENTS}
            estimate = estimate._replace(
                **{
                    name: count_depth_from_zero(event, self._removed_m)
                    for name, event in events.items()
                }
            )
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
            self._method.doubt_zero(std_N, age_s)

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
        state: Any = snapshot.state  # of the method that the config names
        self._method.restore(state)
        self._check = as_record(snapshot.check)
        self._removed_m = snapshot.check.removed_m
        self._travel = as_record(snapshot.travel)
        self._last = snapshot.last


def count_depth_from_zero(event: Any, zero_m: float) -> Any:
    """Return an event or a layer, if any, whose depths count from a zero farther out.

    Args:
        event: A `Rupture`, a `LayerEstimate`, a `HardContact`, or None.
        zero_m: Depth of the old zero from the new one.
    """
    if event is None or zero_m == 0.0:
        return event
    names = ("depth_m", "alarm_depth_m", "contact_depth_m", "start_depth_m")
    moved = {
        name: getattr(event, name) + zero_m for name in names if hasattr(event, name)
    }
    if isinstance(event, LayerEstimate):
        moved["rupture"] = count_depth_from_zero(event.rupture, zero_m)
    return replace(event, **moved)
