"""Snapshots resume bit for bit; memory stays bounded however long the insertion."""

import pickle
from dataclasses import fields, is_dataclass, replace
from enum import Enum

import numpy as np
import pytest

from identification import MIXTURE, PUBLISHED, Identifier
from identification.errors import InvalidSnapshotError
from identification.mixture.method import Stage
from needleforce import read_snapshot, write_snapshot


def samples(n=3000, seed=4):
    """Depth, speed, force and interval of a needle that leaves a layer of 10 mm."""
    rng = np.random.default_rng(seed)
    z = -2e-3 + 5e-6 * np.arange(n)
    reach = np.maximum(z, 0.0)
    f = np.where(reach < 0.01, 60.0 * reach, 30.0 * reach) + 0.01 * rng.standard_normal(
        n
    )
    return [(a, 2.5e-3, b, 2e-3) for a, b in zip(z.tolist(), f.tolist(), strict=True)]


def run(identifier, rows):
    return [identifier.update(*row) for row in rows]


@pytest.mark.slow
@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
def test_memory_is_bounded(config):
    rng = np.random.default_rng(6)
    identifier = Identifier(config)
    sizes = []
    noise = (0.01 * rng.standard_normal(18_000)).tolist()
    for k in range(18_000):
        identifier.update(1e-5 * k, 5e-3, 0.5 + 1e-5 * k + noise[k], 2e-3)
        if k % 3000 == 2999:
            sizes.append(len(pickle.dumps(identifier.snapshot())))

    assert max(sizes) < max(2 * sizes[2], 4096 * 7 * 10)


def is_work_left(state):
    """Whether something is left to do for the last block of the mixture."""
    due = state.reporter
    return due.is_due or due.is_layer_due or state.stage is not Stage.DONE


@pytest.mark.slow
@pytest.mark.parametrize(("config", "least"), [(MIXTURE, 10), (PUBLISHED, 1)])
def test_every_state_resumes_bit_for_bit(config, least, tmp_path):
    """One of 29, and from a file one of 25 of those taken while work is left."""
    whole = Identifier(config)
    resumed = Identifier(config)
    files = 0
    estimates = []
    snapshots = []
    for k, row in enumerate(samples()):
        estimates.append(whole.update(*row))
        assert resumed.update(*row) == estimates[-1]
        snapshot = resumed.snapshot()
        # Whether the work of a block or the wait for a force drop has begun and not
        # ended.
        is_at_work = (
            is_work_left(snapshot.state)
            if config is MIXTURE
            else bool(snapshot.state.ruptured)
        )
        files += is_at_work
        if is_at_work and files % 25 == 1:
            write_snapshot(snapshot, tmp_path / "state")
            snapshot = read_snapshot(tmp_path / "state")
        elif k % 29:
            continue
        if k % 290 == 0:
            snapshots.append((snapshot, pickle.dumps(snapshot)))
        resumed = Identifier(config)
        resumed.restore(snapshot)

    assert files >= least
    # Nothing changes a snapshot.
    assert all(pickle.dumps(snapshot) == pickled for snapshot, pickled in snapshots)

    resumed.reset()

    assert run(resumed, samples()) == estimates


def nudged(value):
    """A state with every number and truth value in it changed."""
    if isinstance(value, Enum):
        return next(other for other in type(value) if other is not value)
    if isinstance(value, bool):
        return not value
    if isinstance(value, int | float):
        return value + 1
    if isinstance(value, np.ndarray):
        return value + 1.0
    if is_dataclass(value):
        return replace(
            value, **{f.name: nudged(getattr(value, f.name)) for f in fields(value)}
        )
    if hasattr(value, "_fields"):
        return type(value)(*map(nudged, value))
    return tuple(map(nudged, value)) if isinstance(value, tuple) else value


def test_all_that_a_method_remembers_is_in_the_next_snapshot(in_tissue):
    snapshot = in_tissue[MIXTURE].snapshot()
    identifier = Identifier()
    for name in (field.name for field in fields(snapshot.state)):
        changed = copy_with(snapshot.state, name, nudged(getattr(snapshot.state, name)))
        identifier.resume(snapshot._replace(state=changed))
        kept = getattr(identifier.snapshot().state, name)

        assert pickle.dumps(kept) == pickle.dumps(getattr(changed, name)), name


@pytest.fixture(scope="module")
def in_tissue():
    """An identifier of each method in tissue."""
    identifiers = {config: Identifier(config) for config in (MIXTURE, PUBLISHED)}
    for identifier in identifiers.values():
        run(identifier, samples(2800))
    return identifiers


def copy_with(state, name, value):
    """A named tuple or a data class, one field changed."""
    if is_dataclass(state):
        return replace(state, **{name: value})
    return state._replace(**{name: value})


@pytest.mark.parametrize(
    ("config", "place", "change"),
    [
        (MIXTURE, "mixture.covariances", np.triu),  # not symmetric
        (MIXTURE, "mixture.covariances", lambda matrices: matrices[:, :2, :2]),
        (MIXTURE, "mixture.assumptions", lambda numbers: numbers + 7.0),
        (MIXTURE, "mixture.log_weights", lambda weights: weights.astype(int)),
        (MIXTURE, "learner.levels", lambda _: None),
        (
            MIXTURE,
            "learner.levels.differences.squares_N2",
            lambda squares: squares + np.inf,
        ),
        (MIXTURE, "contact.deepest_m", lambda _: np.nan),
        (MIXTURE, "posterior.offset", lambda _: np.inf),
        (MIXTURE, "learner.tissue.unit", lambda _: 10**6),
        (MIXTURE, "stage", lambda _: 10**9),
        (PUBLISHED, "friction_variance", lambda variance: -variance),
        (PUBLISHED, "machine", lambda _: 5),
        (PUBLISHED, "window", lambda _: None),
        (PUBLISHED, "windows", lambda windows: np.asfortranarray(windows)),
    ],
)
def test_a_damaged_state_is_refused_and_changes_nothing(
    in_tissue, config, place, change
):
    identifier = in_tissue[config]
    snapshot = identifier.snapshot()
    names = place.split(".")
    nodes = [snapshot.state]
    for name in names[:-1]:
        nodes.append(getattr(nodes[-1], name))
    value = change(getattr(nodes[-1], names[-1]))
    for node, name in zip(reversed(nodes), reversed(names), strict=True):
        value = copy_with(node, name, value)
    pickled = pickle.dumps(snapshot)

    with pytest.raises(InvalidSnapshotError, match=names[0]):
        identifier.restore(snapshot._replace(state=value))
    assert pickle.dumps(identifier.snapshot()) == pickled


@pytest.mark.parametrize("name", ["check", "travel"])
def test_damaged_numbers_of_the_samples_are_refused(in_tissue, name):
    identifier = in_tissue[MIXTURE]
    snapshot = identifier.snapshot()
    damaged = replace(getattr(snapshot, name), depth_m=float("nan"))
    for value in (damaged, None):
        with pytest.raises(InvalidSnapshotError, match=name):
            identifier.restore(snapshot._replace(**{name: value}))
