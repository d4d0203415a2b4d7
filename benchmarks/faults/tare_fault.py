"""A tare that is asked for in the wrong place, or with the wrong payload."""

import numpy as np

from benchmarks.faults.fault import FaultResult, feed, is_finite, judge, late
from benchmarks.faults.fault_stream import stream_of, tare_index
from benchmarks.methods.sensor_settings import on_lwr
from groundtruth import Run
from insertion import InsertionSession
from residual import DEFAULT, TareError
from urdf import Payload, Robot

UNKNOWN_KG = 0.1
"""A third of what the tool weighs."""


def tare_in_contact(run: Run, at: int) -> FaultResult:
    """Tare in the tissue for the first time; then withdraw, tare in free air, insert again.

    Args:
        run: An insertion.
        at: Sample before which the first tare is asked for, in the tissue.
    """
    count, nothing = len(run.signals.t_s), np.zeros(len(run.signals.t_s))
    session = InsertionSession(run.robot, on_lwr(DEFAULT))
    before = feed(session, stream_of(run, 0, at, nothing))[-1]
    told = ""
    try:
        session.tare()
    except TareError:
        told = "TareError"
    after = feed(session, stream_of(run, at, count, nothing))
    session.start_recording()
    # The robot is driven back to the start while nobody listens.
    again = stream_of(run, 0, tare_index(run), nothing)
    again.dt_s[0] = 1.0
    feed(session, again)
    session.tare()
    result = _insert(session, run, "tare asked for in the tissue")
    return FaultResult(
        name=result.name,
        worst_N=abs(after[0].wrench.axial - before.wrench.axial),
        worst_sigma=abs(after[0].wrench.axial - before.wrench.axial) / after[0].wrench.axial_std,
        recovery_s=result.recovery_s,
        told=(told, after[0].status.value) if told else (after[0].status.value,),
        is_finite=result.is_finite and all(map(is_finite, after[:1000])),
        note="recovery: after a tare in free air",
    )


def wrong_payload(run: Run) -> FaultResult:
    """The tool is heavier than the estimator knows, from the start."""
    session = InsertionSession(_lighter(run.robot), on_lwr(DEFAULT))
    tare = tare_index(run)
    feed(session, stream_of(run, 0, tare, np.zeros(len(run.signals.t_s))))
    session.tare()
    return _insert(session, run, f"payload {1e3 * UNKNOWN_KG:g} g wrong from the start")


def _insert(session: InsertionSession, run: Run, name: str) -> FaultResult:
    """The insertion after the tare; it is all fault, and its recovery that of its whole length."""
    tare, count = tare_index(run), len(run.signals.t_s)
    forces = late(run.truth.axial_N)
    insertion = stream_of(run, tare, count, forces)
    found = feed(session, insertion)
    worst = judge(name, insertion.bent(0, count - tare), found)
    lasting = judge(name, insertion.bent(0, 0), found)
    return FaultResult(
        name=name,
        worst_N=worst.worst_N,
        worst_sigma=worst.worst_sigma,
        recovery_s=lasting.recovery_s,
        told=worst.told,
        is_finite=worst.is_finite,
    )


def _lighter(robot: Robot) -> Robot:
    """The robot with less of a tool than it really carries."""
    known = robot.payload
    assert known is not None
    share = 1.0 - UNKNOWN_KG / known.mass_kg
    return robot.with_payload(
        Payload(
            mass_kg=share * known.mass_kg,
            com_m=known.com_m,
            inertia_kg_m2=share * known.inertia_kg_m2,
        )
    )
