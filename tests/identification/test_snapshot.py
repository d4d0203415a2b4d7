"""Snapshots resume bit for bit; memory stays bounded however long the insertion."""

import pickle

import numpy as np
import pytest

from identification import MIXTURE, PUBLISHED, Identifier
from tests.identification.worlds import noisy, rows_of, run


def samples(n=3000):
    """Depth, speed, force and interval of a needle that leaves a layer of 10 mm."""
    depth_m = -2e-3 + 5e-6 * np.arange(n)
    reach_m = np.maximum(depth_m, 0.0)
    force_N = np.where(reach_m < 0.01, 60.0 * reach_m, 30.0 * reach_m)
    return rows_of(depth_m, 2.5e-3, noisy(force_N, 0.01, 4), 2e-3)


@pytest.mark.slow
@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
def test_memory_is_bounded(config):
    identifier = Identifier(config)
    force_N = noisy(0.5 + 1e-5 * np.arange(12_000), 0.01, 6)
    rows = rows_of(1e-5 * np.arange(12_000), 5e-3, force_N, 2e-3)
    run(rows[:6_000], identifier)
    size = len(pickle.dumps(identifier.snapshot()))
    run(rows[6_000:], identifier)

    assert len(pickle.dumps(identifier.snapshot())) < max(1.5 * size, 4096 * 7 * 10)


@pytest.mark.slow
@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
def test_a_state_resumes_bit_for_bit_and_nothing_changes_a_snapshot(config):
    rows = samples()
    _, estimates = run(rows, Identifier(config))
    identifier = Identifier(config)
    for first in range(0, len(rows), 29):
        snapshot = identifier.snapshot()
        before = pickle.dumps(snapshot)
        identifier = Identifier(config)
        identifier.restore(snapshot)
        _, resumed = run(rows[first : first + 29], identifier)
        assert resumed == estimates[first : first + 29]
        assert pickle.dumps(snapshot) == before
    identifier.reset()

    assert run(rows[:500], identifier)[1] == estimates[:500]
