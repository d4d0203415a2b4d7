"""All faults, one after the other, on the same insertion."""

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from benchmarks.faults.fault import FaultResult, feed, judge
from benchmarks.faults.fault_stream import FaultStream, stream_of, tare_index
from benchmarks.faults.motion_faults import motion_results
from benchmarks.faults.pose_faults import heavier, pushed_aside, stretched, wrist_at_limit
from benchmarks.faults.signal_faults import SIGNAL_FAULTS
from benchmarks.faults.tare_fault import tare_in_contact, wrong_payload
from benchmarks.methods.sensor_settings import on_lwr
from groundtruth import Run, simulate
from insertion import InsertionSession, SessionSnapshot
from residual import DEFAULT

SCENARIO, ARM = "gel-70-constant", "realistic"
DEPTH_M = 20e-3
"""Where the faults strike: in the gel, which ends at 32 mm."""
LEAD, BEYOND = 300, 3000
"""Samples before a fault, and after the end of the layer."""


class FaultStudy:
    """One insertion, undisturbed, and what it needs to be repeated with a fault.

    Args:
        progress: Told the share of the simulation that is done.
        with_velocity: Whether the arm sends velocities.
        through_layer: Whether every repetition goes on to the end of the layer, so that its rupture
            must be found, or only a little beyond the fault.
    """

    def __init__(
        self,
        progress: Callable[[float], None] = lambda share: None,
        *,
        with_velocity: bool = True,
        through_layer: bool = True,
    ) -> None:
        self._with_velocity, self._through = with_velocity, through_layer
        self.run: Run = simulate(SCENARIO, ARM, 0, progress)
        truth = self.run.truth
        self.at = int(np.argmax(truth.depth_m > DEPTH_M))
        self._tare = tare_index(self.run)
        end = int(np.argmax(truth.layer > 1)) if through_layer else self.at
        self._last = end + BEYOND
        session = InsertionSession(self.run.robot, on_lwr(DEFAULT))
        forces = self._go_on(session, 0, self._tare)
        session.tare()
        self._tared = session.snapshot()
        forces += self._go_on(session, self._tare, self.at - LEAD)
        self._inserted = session.snapshot()
        forces += self._go_on(session, self.at - LEAD, self._last)
        self._undisturbed_N = np.array(forces)

    def results(self) -> Iterator[FaultResult]:
        """Every fault's result, in the order of the table."""
        yield from self.signal_results()
        yield from self.pose_results()
        yield tare_in_contact(self.run, self.at)
        yield wrong_payload(self.run)
        yield from motion_results(ARM, with_velocity=self._with_velocity)

    def signal_results(self) -> Iterator[FaultResult]:
        """What sensors, wires and clocks do."""
        good = self._part(self.at - LEAD, self._last, self._undisturbed_N)
        for name, inject in SIGNAL_FAULTS.items():
            yield self._result(name, inject(good, LEAD), self._inserted)

    def pose_results(self) -> Iterator[FaultResult]:
        """What poses and loads do."""
        good = self._part(self.at - LEAD, self._last, self._undisturbed_N)
        free = self._part(self._tare, self._tare + BEYOND, self._undisturbed_N)
        run = self.run
        for name, stream, start in (
            ("wrist pressed to its limit, 1 s", wrist_at_limit(run, free), self._tared),
            ("arm stretched along the needle, 1 s", stretched(run, free), self._tared),
            ("50 g hung on the tool, 2 s", heavier(run, good, LEAD), self._inserted),
            ("pushed aside with 1 N, 2 s", pushed_aside(run, good, LEAD), self._inserted),
        ):
            yield self._result(name, stream, start)

    def _result(self, name: str, stream: FaultStream, start: SessionSnapshot) -> FaultResult:
        session = InsertionSession(self.run.robot, on_lwr(DEFAULT))
        session.restore(start)
        found = feed(session, stream, with_velocity=self._with_velocity)
        result = judge(name, stream, found)
        ruptures = sum(e.identification.rupture is not None for e in found)
        expected = int(start is self._inserted and self._through)
        note = "" if ruptures == expected else f"{ruptures} ruptures raised, {expected} true"
        return replace(result, note=note)

    def _part(self, first: int, last: int, reference_N: np.ndarray) -> FaultStream:
        return stream_of(self.run, first, last, reference_N)

    def _go_on(self, session: InsertionSession, first: int, last: int) -> list[float]:
        stream = self._part(first, last, self.run.truth.axial_N)
        found = feed(session, stream, with_velocity=self._with_velocity)
        return [estimate.wrench.axial for estimate in found]
