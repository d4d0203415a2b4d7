"""One tick of the whole chain on the samples of an insertion, and what happened in it."""

from benchmarks.methods.sensor_settings import on_lwr
from benchmarks.signals.joint_signals import JointSignals
from identification import DEFAULT as DEFAULT_IDENTIFIER
from identification import DefaultConfig, PaperConfig
from insertion import InsertionSession
from residual import DEFAULT
from urdf import Robot

RERUN_TICKS = 6
"""A layer is identified anew over so many ticks at most: the last one tells it."""


class ChainTick:
    """A session fed sample by sample; called with the index of the next one.

    Args:
        robot: The arm.
        signals: What it sent.
        tare: Index of the sample before which to tare.
        identifier: Settings of the identifier.

    Attributes:
        alarms: Indices of the ticks that raised a rupture.
        reruns: Indices of the ticks that worked on identifying a layer that had been left.
    """

    def __init__(
        self,
        robot: Robot,
        signals: JointSignals,
        tare: int,
        identifier: DefaultConfig | PaperConfig = DEFAULT_IDENTIFIER,
    ) -> None:
        self._session = InsertionSession(robot, on_lwr(DEFAULT), identifier)
        # Lists: a controller has its sample at hand and need not cut it out of an array.
        count = len(signals.t_s)
        velocities = [None] * count if signals.dq_rad_s is None else list(signals.dq_rad_s)
        steps = signals.dt_s.tolist()
        self._samples = list(zip(signals.q_rad, velocities, signals.tau_Nm, steps, strict=True))
        self._tare = tare
        self.alarms: list[int] = []
        self.reruns: list[int] = []

    def __call__(self, k: int) -> None:
        """Take sample k."""
        if k == self._tare:
            self._session.tare()
        found = self._session.update(*self._samples[k]).identification
        if found.rupture is not None:
            self.alarms.append(k)
        if found.compensated is not None:
            self.reruns.extend(range(k + 1 - RERUN_TICKS, k + 1))
