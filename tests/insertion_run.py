"""A short simulated insertion on the clean arm, for the tests of sessions."""

from dataclasses import fields, is_dataclass
from functools import cache

import numpy as np

from groundtruth import simulate


@cache
def short_run():
    """The quickest catalogued insertion: one gel at constant speed."""
    return simulate("gel-25-constant", "clean", seed=0)


def time_steps(run):
    """Time since the sample before [s]; the first is never read."""
    return np.round(np.diff(run.signals.t_s, prepend=run.signals.t_s[0] - 1.0), 9).tolist()


def samples(run, *, with_velocity=True):
    """Index and arguments of `InsertionSession.update`, tick by tick."""
    sent = run.signals
    for k, dt_s in enumerate(time_steps(run)):
        dq = sent.dq_rad_s[k] if with_velocity else None
        yield k, (sent.q_rad[k], dq, sent.tau_Nm[k], dt_s)


def tare_index(run):
    """First sample after the stroke in free air."""
    return int(np.searchsorted(run.signals.t_s, run.tare_end_s))


def same(one, other):
    """Whether two nested results are equal, bit for bit; a NaN equals another."""
    if isinstance(one, np.ndarray):
        return np.array_equal(one, other)
    if isinstance(one, tuple):
        return len(one) == len(other) and all(map(same, one, other))
    if is_dataclass(one):
        return all(same(getattr(one, f.name), getattr(other, f.name)) for f in fields(one))
    return one == other or (one != one and other != other)
