"""When a session is tared: on request, by itself, and how it is said to have ended."""

from types import SimpleNamespace

import pytest

from needleforce import AutoTare, InsertionSession, TareRun
from residual import Status, TareError
from tests.insertion_run import samples, short_run, tare_index


class Stand:
    """Stands in for a session at 100 Hz whose tare takes a thousand steps."""

    def __init__(self, refusals=0):
        self.tared = False
        self.tare_refusal = None
        self.time_s = 0.0
        self.begun_s = []
        self._refusals = refusals
        self._left = 0
        self._steps = 0

    @property
    def taring(self):
        return self._left > 0

    def start_tare_recording(self):
        self.tared = False
        self._left = 0

    def start_tare(self, *, steps_per_tick):
        self.begun_s.append(round(self.time_s, 2))
        self.tare_refusal = None
        self._left = 1000
        self._steps = steps_per_tick

    def update(self):
        self.time_s += 0.01
        if self.taring:
            self._left -= self._steps
            if self._left <= 0 and self._refusals:
                self._refusals -= 1
                self.tare_refusal = TareError("contact")
            elif self._left <= 0:
                self.tared = True
        status = Status.OK if self.tared else Status.NOT_TARED
        return SimpleNamespace(time_s=self.time_s, status=status)


def started(session):
    run = TareRun()
    run.start(session)
    return run


def test_a_tare_takes_a_second_of_a_slow_loop_too():
    session = Stand()
    run = TareRun()
    for _ in range(100):
        run.after(session, session.update())
    run.start(session)
    run.start(session)
    ends_s = [
        round(session.time_s, 2)
        for _ in range(300)
        if run.after(session, session.update())
    ]

    assert (session.begun_s, ends_s, run.refusal) == ([1.0], [2.0], None)


def test_an_automatic_tare_waits_and_tries_again_after_a_refusal():
    session = Stand(refusals=1)
    refused_s = []
    tare = AutoTare(4.0, on_refusal=lambda time_s, _: refused_s.append(time_s))
    tared_s = [
        round(session.time_s, 2)
        for _ in range(2000)
        if tare.after(session, session.update())
    ]

    assert (session.begun_s, tared_s) == ([4.01, 9.02], [10.02])
    assert refused_s == [pytest.approx(5.01)]


def test_a_tare_whose_recording_is_begun_anew_is_given_up_with_a_reason():
    session = Stand()
    run = started(session)
    session.start_tare_recording()

    assert run.after(session, session.update())
    assert "another recording" in str(run.refusal)


def test_a_tare_without_motion_is_refused_at_once_with_advice():
    run = started(InsertionSession(short_run().robot))

    assert not run.is_running
    assert run.refusal.advice


@pytest.mark.slow
def test_a_tare_runs_beside_the_updates_and_a_second_one_records_first():
    session = InsertionSession(short_run().robot)
    run = TareRun()
    tare = tare_index(short_run())
    ends = []
    for k, sample in samples(short_run()):
        if k in (tare, tare + 1500):
            run.start(session, recording_s=1.0 if session.tared else 0.0)
            assert run.is_running
        if run.after(session, session.update(*sample)):
            ends.append((k - tare, run.refusal))
        if k == tare + 1600:
            assert not session.tared
            break

    ((ticks, refusal),) = ends
    assert refusal is None
    assert 100 < ticks < 1500
