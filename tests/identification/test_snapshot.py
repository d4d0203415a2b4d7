"""Snapshots resume bit for bit; memory stays bounded however long the insertion."""

import pickle

import numpy as np
import pytest

from identification import MULTILAYER, PUBLISHED, Identifier
from identification.errors import InvalidSnapshotError
from needleforce import read_snapshot, write_snapshot


def samples(n=8000, seed=4):
    """Depth, speed, force and interval of a needle that leaves a layer of 10 mm."""
    rng = np.random.default_rng(seed)
    z = -2e-3 + 2.5e-6 * np.arange(n)
    reach = np.maximum(z, 0.0)
    f = np.where(reach < 0.01, 60.0 * reach, 30.0 * reach) + 0.01 * rng.standard_normal(
        n
    )
    return [(a, 2.5e-3, b, 1e-3) for a, b in zip(z.tolist(), f.tolist(), strict=True)]


def run(identifier, rows):
    return [identifier.update(*row) for row in rows]


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
def test_memory_is_bounded(config):
    rng = np.random.default_rng(6)
    identifier = Identifier(config)
    sizes = []
    noise = (0.01 * rng.standard_normal(30_000)).tolist()
    for k in range(30_000):
        identifier.update(1e-5 * k, 5e-3, 0.5 + 1e-5 * k + noise[k], 2e-3)
        if k % 3000 == 2999:
            sizes.append(len(pickle.dumps(identifier.snapshot())))
    assert max(sizes) < max(2 * sizes[2], 4096 * 7 * 10)


@pytest.mark.parametrize(("config", "least"), [(MULTILAYER, 10), (PUBLISHED, 1)])
def test_every_state_of_an_insertion_is_accepted_and_resumes_bit_for_bit(
    config, least, tmp_path
):
    """Each seventh one, and from a file each fifth one that is taken while work is
    left."""
    whole = Identifier(config)
    part = Identifier(config)
    files = 0
    found = []
    taken = []
    for k, row in enumerate(samples()):
        found.append(whole.update(*row))
        assert part.update(*row) == found[-1]
        kept = part.snapshot()
        # Whether the work of a block or the wait for a force drop has begun and not
        # ended.
        is_at_work = (
            kept.state.stage != 0 if config is MULTILAYER else bool(kept.state.ruptured)
        )
        files += is_at_work
        if is_at_work and files % 5 == 1:
            write_snapshot(kept, tmp_path / "kept.json")
            kept = read_snapshot(tmp_path / "kept.json")
        elif k % 7:
            continue
        taken += [(kept, pickle.dumps(kept))] if k % 70 == 0 else []
        part = Identifier(config)
        part.restore(kept)
    assert files >= least
    assert all(
        pickle.dumps(kept) == before for kept, before in taken
    )  # nothing changes one
    part.reset()
    assert run(part, samples()) == found


@pytest.fixture(scope="module")
def in_tissue():
    """An identifier of each method in tissue."""
    found = {config: Identifier(config) for config in (MULTILAYER, PUBLISHED)}
    for identifier in found.values():
        run(identifier, samples(5600))
    return found


@pytest.mark.parametrize(
    ("config", "place", "change"),
    [
        (MULTILAYER, "bank.spreads", np.triu),  # not symmetric
        (MULTILAYER, "bank.spreads", lambda spreads: spreads[:, :2, :2]),
        (MULTILAYER, "bank.facts", lambda facts: facts + 7.0),
        (MULTILAYER, "bank.log_weights", lambda weights: weights.astype(int)),
        (MULTILAYER, "levels", lambda _: None),
        (MULTILAYER, "levels.squares", lambda squares: squares + np.inf),
        (MULTILAYER, "tissue.unit", lambda _: 10**6),
        (MULTILAYER, "stage", lambda _: 10**9),
        (PUBLISHED, "memory", lambda memory: np.append(memory[:4], -memory[4:])),
        (PUBLISHED, "windows", lambda windows: np.asfortranarray(windows)),
    ],
)
def test_a_damaged_state_is_refused_and_changes_nothing(
    in_tissue, config, place, change
):
    identifier = in_tissue[config]
    whole, *names = identifier.snapshot(), *place.split(".")
    parts = [whole.state]
    for name in names[:-1]:
        parts.append(getattr(parts[-1], name))
    value = change(getattr(parts[-1], names[-1]))
    for part, name in zip(reversed(parts), reversed(names), strict=True):
        value = part._replace(**{name: value})
    before = pickle.dumps(identifier.snapshot())
    with pytest.raises(InvalidSnapshotError, match=names[0]):
        identifier.restore(whole._replace(state=value))
    assert pickle.dumps(identifier.snapshot()) == before
