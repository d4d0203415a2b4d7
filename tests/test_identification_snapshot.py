"""Snapshots resume bit for bit; memory stays bounded however long the insertion."""

import pickle

import numpy as np
import pytest

from identification import MULTILAYER, PUBLISHED, Identifier
from identification import rupture_measurement as rupture_step
from identification.errors import InvalidSnapshotError
from identification.published_identifier import PublishedState
from identification.rupture_measurement import finish_measurement
from needleforce import read_snapshot, write_snapshot


def signal(n, seed=4):
    rng = np.random.default_rng(seed)
    z = -2e-3 + 2.5e-6 * np.arange(n)
    reach = np.maximum(z, 0.0)
    f = np.where(reach < 0.01, 60.0 * reach, 30.0 * reach) + 0.01 * rng.standard_normal(n)
    return z.tolist(), f.tolist()


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
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


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
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


def is_at_work(state):
    """Whether a re-run has begun and not ended."""
    if isinstance(state, PublishedState):
        return state.found is not None
    pending = state.candidate
    return pending is not None and (pending.work or pending.search_work) is not None


def test_what_is_worked_off_tick_by_tick_or_at_once_is_the_same():
    z, f = signal(8000)
    slow, fast, early, late = Identifier(), Identifier(), [], []
    for k, (a, b) in enumerate(zip(z, f, strict=True)):
        early += [
            (k, found) for found in [slow.update(a, 2.5e-3, b, 1e-3).identified_layer] if found
        ]
        fast.update(a, 2.5e-3, b, 1e-3)
        kept = fast.snapshot()
        state = finish_measurement(kept.state._replace(identified_layer=None), MULTILAYER)
        late += [(k, found) for found in [state.identified_layer] if found]
        fast.restore(kept._replace(state=state))
    assert len(early) == len(late) == 2
    assert [found for _, found in early] == [found for _, found in late]
    assert [there - here for (there, _), (here, _) in zip(early, late, strict=True)] == [5, 5]


def test_no_tick_at_a_kilohertz_works_off_more_than_one_stage(monkeypatch):
    worked = []

    def counted(stage):
        return lambda *given: (worked.append(stage), stage(*given))[1]

    for name in ("_work", "_search"):
        monkeypatch.setattr(rupture_step, name, counted(getattr(rupture_step, name)))
    z, f = signal(8000)
    identifier, most = Identifier(), 0
    for a, b in zip(z, f, strict=True):
        before = len(worked)
        identifier.update(a, 2.5e-3, b, 1e-3)
        most = max(most, len(worked) - before)
    assert most == 1
    assert len(worked) > 10


@pytest.mark.parametrize(("config", "least"), [(MULTILAYER, 10), (PUBLISHED, 1)])
def test_a_snapshot_taken_while_work_is_left_resumes_bit_for_bit(config, least, tmp_path):
    z, f = signal(8000)
    whole, part, files = Identifier(config), Identifier(config), 0
    for a, b in zip(z, f, strict=True):
        expected, found = (one.update(a, 2.5e-3, b, 1e-3) for one in (whole, part))
        assert found == expected
        if is_at_work(part.snapshot().state):
            files += 1
            write_snapshot(part.snapshot(), tmp_path / "kept.json")
            part = Identifier(config)
            part.restore(read_snapshot(tmp_path / "kept.json"))
    assert files >= least


def test_a_second_event_finds_the_work_before_it_done():
    """Rest begins while the look is under way: it ends with the next block, nothing is lost."""
    z, f = signal(8000)
    ahead, stopped, looks = Identifier(), Identifier(), 0
    for a, b in zip(z, f, strict=True):
        ahead.update(a, 2.5e-3, b, 1e-3)
        kept = ahead.snapshot()
        pending = kept.state.candidate
        if pending is None or pending.work is None:
            continue
        looks += 1
        expected = finish_measurement(kept.state, MULTILAYER).identified_layer
        stopped.restore(kept)
        # A block of one sample leaves no tick in between.
        assert expected is not None
        assert stopped.update(a, 0.0, b, 10e-3).identified_layer == expected
    assert looks > 2


def damaged(config, place, change):
    """A snapshot in tissue, one array or number of its state changed."""
    identifier = Identifier(config)
    z, f = signal(5600)
    for a, b in zip(z, f, strict=True):
        identifier.update(a, 2.5e-3, b, 1e-3)
    whole, *names = identifier.snapshot(), *place.split(".")
    parts = [whole.state]
    for name in names[:-1]:
        parts.append(getattr(parts[-1], name))
    value = change(getattr(parts[-1], names[-1]))
    for part, name in zip(reversed(parts), reversed(names), strict=True):
        value = part._replace(**{name: value})
    return identifier, whole._replace(state=value)


def with_corner(number):
    def change(matrix):
        matrix = matrix.copy()
        matrix[0, 1] = number
        return matrix

    return change


@pytest.mark.parametrize(
    ("config", "place", "change"),
    [
        (MULTILAYER, "fit.covariance", with_corner(0.3)),
        (MULTILAYER, "fit.covariance", lambda matrix: -matrix),
        (MULTILAYER, "fit.covariance", lambda matrix: matrix[:2, :2]),
        (MULTILAYER, "layer.prior.matrix", with_corner(-7.0)),
        (MULTILAYER, "layer.data.matrix", lambda matrix: matrix - 1e3 * np.eye(6)),
        (MULTILAYER, "layer.data.matrix", with_corner(np.nan)),
        (MULTILAYER, "detector.variance", lambda _: np.zeros(3)),
        (MULTILAYER, "track.points", lambda points: points[:, :4]),
        (MULTILAYER, "track.points", lambda points: points.astype(int)),
        (MULTILAYER, "lag", lambda _: None),
        (PUBLISHED, "memory.rls.covariance", lambda _: 1e12),
        (PUBLISHED, "memory.rls.var_friction", lambda _: -1.0),
        (PUBLISHED, "windows", lambda windows: np.asfortranarray(windows)),
    ],
)
def test_a_damaged_state_is_refused_and_changes_nothing(config, place, change):
    identifier, snapshot = damaged(config, place, change)
    before = pickle.dumps(identifier.snapshot())
    with pytest.raises(InvalidSnapshotError, match=place.split(".")[0]):
        identifier.restore(snapshot)
    assert pickle.dumps(identifier.snapshot()) == before


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
def test_every_state_of_an_insertion_is_accepted(config):
    identifier, twin = Identifier(config), Identifier(config)
    z, f = signal(8000)
    for k, (a, b) in enumerate(zip(z, f, strict=True)):
        identifier.update(a, 2.5e-3, b, 1e-3)
        if k % 7 == 0:
            twin.restore(identifier.snapshot())
