"""Snapshots resume bit for bit; memory stays bounded however long the insertion."""

import pickle

import numpy as np
import pytest

from identification import DEFAULT, PAPER, Identifier


def signal(n, seed=4):
    rng = np.random.default_rng(seed)
    z = -2e-3 + 2.5e-6 * np.arange(n)
    reach = np.maximum(z, 0.0)
    f = np.where(reach < 0.01, 60.0 * reach, 30.0 * reach) + 0.01 * rng.standard_normal(n)
    return z.tolist(), f.tolist()


@pytest.mark.parametrize("config", [DEFAULT, PAPER])
@pytest.mark.parametrize("cut", [700, 5003, 6100])
def test_restored_identifier_goes_on_bit_for_bit(config, cut):
    z, f = signal(8000)
    whole, part = Identifier(config), Identifier(config)
    expected = [whole.update(a, 2.5e-3, b, 1e-3) for a, b in zip(z, f, strict=True)]
    for a, b in zip(z[:cut], f[:cut], strict=True):
        part.update(a, 2.5e-3, b, 1e-3)
    kept = pickle.loads(pickle.dumps(part.snapshot()))
    other = Identifier(config)
    other.restore(kept)
    resumed = [other.update(a, 2.5e-3, b, 1e-3) for a, b in zip(z[cut:], f[cut:], strict=True)]
    assert resumed == expected[cut:]


def test_a_snapshot_is_not_touched_by_what_follows():
    z, f = signal(6000)
    identifier = Identifier()
    for a, b in zip(z[:3000], f[:3000], strict=True):
        identifier.update(a, 2.5e-3, b, 1e-3)
    kept = identifier.snapshot()
    before = pickle.dumps(kept)
    for a, b in zip(z[3000:], f[3000:], strict=True):
        identifier.update(a, 2.5e-3, b, 1e-3)
    assert pickle.dumps(kept) == before


@pytest.mark.parametrize("config", [DEFAULT, PAPER])
def test_memory_is_bounded(config):
    rng = np.random.default_rng(6)
    identifier, sizes = Identifier(config), []
    noise = (0.01 * rng.standard_normal(30_000)).tolist()
    for k in range(30_000):
        identifier.update(1e-5 * k, 5e-3, 0.5 + 1e-5 * k + noise[k], 2e-3)
        if k % 3000 == 2999:
            sizes.append(len(pickle.dumps(identifier.snapshot())))
    limit = 4096 * 7 * 10
    assert max(sizes) < max(2 * sizes[2], limit)


def test_reset_forgets_everything():
    z, f = signal(6000)
    used = Identifier()
    for a, b in zip(z, f, strict=True):
        used.update(a, 2.5e-3, b, 1e-3)
    used.reset()
    fresh = Identifier()
    assert [used.update(a, 2.5e-3, b, 1e-3) for a, b in zip(z[:500], f[:500], strict=True)] == [
        fresh.update(a, 2.5e-3, b, 1e-3) for a, b in zip(z[:500], f[:500], strict=True)
    ]


def test_equal_input_gives_equal_output():
    z, f = signal(3000)
    rows = []
    for _ in range(2):
        identifier = Identifier()
        rows.append([identifier.update(a, 2.5e-3, b, 1e-3) for a, b in zip(z, f, strict=True)])
    assert rows[0] == rows[1]


def test_a_membrane_looked_for_between_blocks_or_in_the_measuring_tick_is_the_same():
    z, f = signal(8000)
    early, late, searched = Identifier(), Identifier(), 0
    for a, b in zip(z, f, strict=True):
        early.update(a, 2.5e-3, b, 1e-3)
        late.update(a, 2.5e-3, b, 1e-3)
        kept = late.snapshot()
        pending = kept.state.pending
        if pending is not None and pending.search is not None:
            searched += 1
            state = kept.state._replace(pending=pending._replace(search=None))
            late.restore(kept._replace(state=state))
    assert searched > 0
    assert early.layers
    assert late.layers == early.layers
