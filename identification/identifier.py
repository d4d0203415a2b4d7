"""The online identifier: plumbing around pure steps."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, NamedTuple

from identification.default_config import DEFAULT, DefaultConfig
from identification.default_report import DefaultReport, layers_now
from identification.default_state import initial_default_state
from identification.default_step import default_step
from identification.errors import InvalidConfigError, InvalidSnapshotError
from identification.estimate import Estimate, LayerEstimate
from identification.paper_config import PaperConfig
from identification.paper_report import paper_layers, report_paper
from identification.paper_step import initial_paper_state, paper_step
from identification.sample import Sample
from identification.sample_check import CheckState, SampleStatus, check_step, raw_check_step


@dataclass(frozen=True, slots=True)
class _Method:
    initial: Callable[[Any], Any]
    step: Callable[[Any, Sample, Any], Any]
    reporter: Callable[[], Callable[[Any, Sample, SampleStatus, Any], Estimate]]
    layers: Callable[[Any], tuple[LayerEstimate, ...]]


_METHODS: dict[type, _Method] = {
    DefaultConfig: _Method(initial_default_state, default_step, DefaultReport, layers_now),
    PaperConfig: _Method(initial_paper_state, paper_step, lambda: report_paper, paper_layers),
}


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

    def __init__(self, config: DefaultConfig | PaperConfig = DEFAULT) -> None:
        """Choose the method by its configuration.

        Args:
            config: `DEFAULT` or `PAPER`, or one of these with changed fields.

        Raises:
            InvalidConfigError: Not a configuration of this room.
        """
        method = _METHODS.get(type(config))
        if method is None:
            known = ", ".join(kind.__name__ for kind in _METHODS)
            raise InvalidConfigError(f"config must be one of {known}, got {type(config).__name__}")
        self._config = config
        self._method, self._step, self._report = method, method.step, method.reporter()
        self.reset()

    @property
    def layers(self) -> tuple[LayerEstimate, ...]:
        """Layers left so far, in order, as known now."""
        return self._method.layers(self._state)

    def reset(self) -> None:
        """Forget everything: a new insertion begins."""
        self._check = CheckState()
        self._state = self._method.initial(self._config)
        start = Sample(0.0, 0.0, 0.0, 0.0, 0.0)
        self._last = self._report(self._state, start, SampleStatus.OK, self._config)

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
        values, config = (depth_m, speed_m_s, force_N, dt_s), self._config
        is_plain = type(depth_m) is type(speed_m_s) is type(force_N) is type(dt_s) is float
        check = check_step if is_plain else raw_check_step
        self._check, sample, status = check(self._check, values, config.check)
        if sample is None:
            self._last = self._last._replace(
                time_s=self._check.time_s,
                status=status,
                rupture=None,
                compensated=None,
                withdrawn=None,
            )
            return self._last
        state = self._state = self._step(self._state, sample, config)
        estimate = self._last = self._report(state, sample, status, config)
        return estimate

    def snapshot(self) -> Snapshot:
        """Everything needed to resume exactly here."""
        return Snapshot(self._config, self._check, self._state, self._last)

    def restore(self, snapshot: Snapshot) -> None:
        """Resume where `snapshot` was taken, bit for bit.

        Raises:
            InvalidSnapshotError: Not a snapshot, or one of another configuration.
        """
        if not isinstance(snapshot, Snapshot) or snapshot.config != self._config:
            raise InvalidSnapshotError(
                f"expected a Snapshot taken with {self._config}, got {type(snapshot).__name__}"
            )
        _, self._check, self._state, self._last = snapshot
