"""What is identified through an arm does not depend on how its signals are written.

One simulated gel, at 500 Hz, sample by sample for a session.
"""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from groundtruth import simulate
from needleforce import InsertionSession

pytestmark = pytest.mark.slow

RATE_HZ = 500.0


class ArmLog(NamedTuple):
    """Joint signals, shape (n,) and (n, 7), the time when the tare stroke has ended."""

    t_s: np.ndarray
    q_rad: np.ndarray
    dq_rad_s: np.ndarray
    tau_Nm: np.ndarray
    tare_end_s: float

    def rows(self, rows):
        """The same, some of its rows only."""
        signals = (self.t_s, self.q_rad, self.dq_rad_s, self.tau_Nm)
        return ArmLog(*(signal[rows] for signal in signals), self.tare_end_s)


@cache
def record():
    """The log, its robot, and the rows between which the needle approaches in air."""
    run = simulate("gel-25-constant", "clean", seed=3)
    signals = run.signals
    end = int(np.searchsorted(signals.t_s, run.truth.ruptures[0].end_s + 3.0))
    log = ArmLog(
        signals.t_s, signals.q_rad, signals.dq_rad_s, signals.tau_Nm, run.tare_end_s
    ).rows(slice(0, end, 2))
    approach = slice(
        int(np.searchsorted(log.t_s, run.tare_end_s + 0.5)),
        int(np.searchsorted(log.t_s, run.truth.contact_s - 1.0)),
    )
    return log, run.robot, approach


def turn_about_vertical(log):
    q_rad = log.q_rad.copy()
    q_rad[:, 0] += 0.5
    return log._replace(q_rad=q_rad)


def miss_approach(log):
    """The needle is 2 mm in front of the tissue when samples come again."""
    approach = record()[2]
    return log.rows(np.r_[: approach.start, approach.stop : len(log.t_s)])


def approach_twice(log):
    """The needle comes to the tissue, goes back the way it came, and comes again.

    Nothing rubs in the joints of this arm, so its torques do not tell both ways apart.
    """
    approach = record()[2]
    way = np.arange(approach.start, approach.stop)
    rows = np.r_[: approach.stop, way[::-1], way, approach.stop : len(log.t_s)]
    twice = log.rows(rows)
    dq_rad_s = twice.dq_rad_s.copy()
    dq_rad_s[approach.stop : approach.stop + way.size] *= -1.0
    return twice._replace(
        t_s=log.t_s[0] + np.arange(rows.size) / RATE_HZ, dq_rad_s=dq_rad_s
    )


CHANGES = {
    "the arm turned about the vertical": turn_about_vertical,
    "no samples of the approach": miss_approach,
    "the approach twice": approach_twice,
    "half the rate": lambda log: log.rows(slice(None, None, 2)),
}


def layers_of_session(log):
    """What a session finds that gets the samples one by one."""
    session = InsertionSession(record()[1])
    steps_s = np.diff(log.t_s, prepend=log.t_s[0] - 1.0 / RATE_HZ)
    tare = int(np.searchsorted(log.t_s, log.tare_end_s))
    for k in range(len(log.t_s)):
        if k == tare:
            session.tare()
        session.update(log.q_rad[k], log.dq_rad_s[k], log.tau_Nm[k], float(steps_s[k]))
    return session.layers


@cache
def original_layers():
    return layers_of_session(record()[0])


@pytest.mark.parametrize("change", CHANGES)
def test_the_same_samples_have_the_same_layers_in_a_session(change):
    (before,) = original_layers()
    (after,) = layers_of_session(CHANGES[change](record()[0]))
    std_N = np.hypot(before.friction_std_N, after.friction_std_N)

    assert abs(after.friction_N - before.friction_N) < std_N
    assert after.thickness_m == pytest.approx(before.thickness_m, abs=3e-4)
