"""An insertion that does everything an insertion is not supposed to do."""

import numpy as np

from benchmarks.faults.fault import FaultResult, feed, judge, late
from benchmarks.faults.fault_stream import stream_of, tare_index
from benchmarks.methods.sensor_settings import on_lwr
from groundtruth import Motion, Scenario, simulate
from groundtruth.materials import gel
from groundtruth.stroke import Profile, Stroke
from insertion import InsertionSession
from residual import DEFAULT

SPEED_M_S = 5e-3
STANDOFF_M = 5e-3
FIRST_STOP_M, TURN_M, DEEPEST_M, AGAIN_M = 15e-3, 10e-3, 42e-3, 20e-3
TARE_M, TARE_S = 100e-3, 4.0

PARTS = ("stopped for 60 s", "reversed by 5 mm and in again", "withdrawn", "inserted again")


class _Way:
    """Strokes one after the other, from above the tissue."""

    def __init__(self) -> None:
        self.strokes: list[Stroke] = []

    def go(self, to_m: float, seconds: float, profile: Profile = "quintic") -> float:
        """Go to a depth in a time; returns when the needle is there [s]."""
        start_s, start_m = 0.0, -STANDOFF_M - TARE_M
        if self.strokes:
            start_s, start_m = self.strokes[-1].end_s, self.strokes[-1].end_m
        self.strokes.append(
            Stroke(
                profile=profile,
                start_s=start_s,
                duration_s=seconds,
                start_m=start_m,
                travel_m=to_m - start_m,
            )
        )
        return self.strokes[-1].end_s

    def along(self, to_m: float) -> float:
        """Go to a depth at about `SPEED_M_S`."""
        return self.go(to_m, abs(to_m - self.strokes[-1].end_m) / SPEED_M_S / 0.9, "cruise")

    def rest(self, seconds: float) -> float:
        """Stay where the needle is."""
        where_m = self.strokes[-1].end_m if self.strokes else -STANDOFF_M - TARE_M
        return self.go(where_m, seconds, "rest")


def troubled_scenario() -> tuple[Scenario, dict[str, tuple[float, float]]]:
    """The insertion, and when each of its `PARTS` begins and ends [s]."""
    way, tare_end_s = _Way(), 0.0
    way.rest(1.0)
    for to_m in (-STANDOFF_M, -STANDOFF_M - TARE_M, -STANDOFF_M):
        tare_end_s = way.go(to_m, TARE_S)
    stopped_s = way.along(FIRST_STOP_M)
    moving_s = way.rest(60.0)
    way.along(TURN_M)
    returned_s = way.along(FIRST_STOP_M)
    insertion_end_s = way.along(DEEPEST_M)
    withdrawing_s = way.rest(1.0)
    withdrawn_s = way.along(-STANDOFF_M)
    again_s = way.rest(1.0)
    inside_s = way.along(AGAIN_M)
    way.rest(1.0)
    end_s = way.along(-STANDOFF_M)
    way.rest(0.5)
    motion = Motion(
        strokes=tuple(way.strokes),
        tare_end_s=tare_end_s,
        insertion_end_s=insertion_end_s,
        withdrawal_start_s=withdrawing_s,
        withdrawal_end_s=end_s,
    )
    spans = zip(
        PARTS,
        (
            (stopped_s, moving_s),
            (moving_s, returned_s),
            (withdrawing_s, withdrawn_s),
            (again_s, inside_s),
        ),
        strict=True,
    )
    title = "70 % gel: stopped, reversed, withdrawn, inserted again"
    return Scenario(id="troubled", title=title, layers=(gel(70),), motion=motion), dict(spans)


def motion_results(arm: str, *, with_velocity: bool = True) -> list[FaultResult]:
    """What comes of each part, against the true force as late as the sensor is."""
    scenario, spans = troubled_scenario()
    run = simulate(scenario, arm, 0)
    tare = tare_index(run)
    session = InsertionSession(run.robot, on_lwr(DEFAULT))
    nothing = np.zeros(len(run.signals.t_s))
    found = feed(session, stream_of(run, 0, tare, nothing), with_velocity=with_velocity)
    session.tare()
    rest = stream_of(run, tare, len(nothing), nothing)
    found += feed(session, rest, with_velocity=with_velocity)
    whole = stream_of(run, 0, len(nothing), late(run.truth.axial_N, with_velocity=with_velocity))
    ruptures = [k for k, e in enumerate(found) if e.identification.rupture is not None]
    results = []
    for name, (begin_s, end_s) in spans.items():
        start, stop = (int(np.searchsorted(run.signals.t_s, t)) for t in (begin_s, end_s))
        part = whole.bent(start, stop)
        inside = sum(start <= k < stop for k in ruptures)
        true = sum(begin_s <= one.onset_s < end_s for one in run.truth.ruptures)
        note = "" if inside == true else f"{inside} ruptures raised, {true} true"
        results.append(judge(name, part, found, note))
    return results
