"""Snapshots resume bit for bit; memory stays bounded however long the insertion."""

import pickle

import numpy as np
import pytest

from identification import MIXTURE, PUBLISHED, Identifier
from needleforce import read_snapshot, write_snapshot
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
    force_N = noisy(0.5 + 1e-5 * np.arange(18_000), 0.01, 6)
    rows = rows_of(1e-5 * np.arange(18_000), 5e-3, force_N, 2e-3)
    sizes = []
    for first in range(0, 18_000, 3000):
        run(rows[first : first + 3000], identifier)
        sizes.append(len(pickle.dumps(identifier.snapshot())))

    assert max(sizes) < max(2 * sizes[2], 4096 * 7 * 10)


@pytest.mark.slow
@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
def test_every_state_resumes_bit_for_bit(config, tmp_path):
    """One of 29 from memory, and one of 203 from a file."""
    rows = samples()
    _, estimates = run(rows, Identifier(config))
    resumed = Identifier(config)
    kept = []
    for k, row in enumerate(rows):
        assert resumed.update(*row) == estimates[k]
        if k % 29:
            continue
        snapshot = resumed.snapshot()
        if k % 203 == 0:
            write_snapshot(snapshot, tmp_path / "state")
            snapshot = read_snapshot(tmp_path / "state")
            kept.append((snapshot, pickle.dumps(snapshot)))
        resumed = Identifier(config)
        resumed.restore(snapshot)
    resumed.reset()

    # Nothing changes a snapshot.
    assert all(pickle.dumps(snapshot) == pickled for snapshot, pickled in kept)
    assert run(rows, resumed)[1] == estimates
