"""A short simulated insertion on the clean arm, for the tests of sessions."""

from dataclasses import fields, is_dataclass, replace
from functools import cache, partial
from itertools import islice

import numpy as np

from groundtruth import simulate
from needleforce import InsertionSession


def cut(result, rows):
    """Signals or truth of a run, at some of its samples only."""
    arrays = {item.name: getattr(result, item.name) for item in fields(result)}
    return replace(
        result, **{k: v[rows] for k, v in arrays.items() if isinstance(v, np.ndarray)}
    )


@cache
def simulated(*case, **options):
    """`simulate`, but the run ends 6 s behind the last layer, before the withdrawal."""
    run = simulate(*case, **options)
    rows = slice(
        int(np.searchsorted(run.signals.t_s, run.truth.ruptures[-1].end_s + 6.0))
    )
    return replace(run, signals=cut(run.signals, rows), truth=cut(run.truth, rows))


short_run = partial(
    simulated, "gel-25-constant", "clean"
)  # the quickest catalogued insertion


def time_steps(run):
    """Time since the sample before [s]; the first is never read."""
    return np.round(
        np.diff(run.signals.t_s, prepend=run.signals.t_s[0] - 1.0), 9
    ).tolist()


def samples(run, *, with_velocity=True):
    """Index and arguments of `InsertionSession.update`, tick by tick."""
    sent = run.signals
    for k, dt_s in enumerate(time_steps(run)):
        dq = sent.dq_rad_s[k] if with_velocity else None
        yield k, (sent.q_rad[k], dq, sent.tau_Nm[k], dt_s)


def tare_index(run):
    """First sample after the stroke in free air."""
    return int(np.searchsorted(run.signals.t_s, run.tare_end_s))


def insert(session, last=None, *, with_velocity=True):
    """Every estimate of the short run up to a sample, tared where a user would."""
    tare = tare_index(short_run())
    estimates = []
    for k, sample in samples(short_run(), with_velocity=with_velocity):
        if k == tare:
            session.tare()
        estimates.append(session.update(*sample))
        if k == last:
            break
    return estimates


@cache
def stopped_after(last):
    """Snapshot of a session after a sample of the short run."""
    session = InsertionSession(short_run().robot)
    insert(session, last)
    return session.snapshot()


@cache
def following(last, count):
    """So many samples that follow a sample of the short run."""
    rows = islice(samples(short_run()), last + 1, last + 1 + count)
    return [sample for _, sample in rows]


def resumed_after(last, count):
    """A session that goes on after a sample of the short run, and so many samples
    that follow."""
    session = InsertionSession(short_run().robot)
    session.restore(stopped_after(last))
    return session, following(last, count)


def same(one, other):
    """Whether two nested results are equal, bit for bit; a NaN equals another."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if is_dataclass(one):
        return all(
            same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one)
        )
    return one == other or (one != one and other != other)
