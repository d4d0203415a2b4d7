"""What became of a file between writing and reading is noticed, and then nothing has changed."""

import copy
import json
from functools import cache

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from insertion_run import same, samples, sealed, short_run, tare_index

from needleforce import InsertionSession, SnapshotFileError, read_snapshot, write_snapshot

ODD = [None, True, -1, 1.0, 1e300, "x", [], {}, {"float": "nan"}, {"float": "inf"}]
ODD += [{"array": [1.0], "shape": [1], "order": "C"}]
ODD += [{"array": [{"float": "nan"}] * 7, "shape": [7], "order": "C"}]
ODD += [{"array": [], "shape": [0, 10**20], "order": "C"}]


@cache
def stopped():
    """A run stopped in the tissue: snapshot, and the samples that come next."""
    run = short_run()
    tare = tare_index(run)
    session = InsertionSession(run.robot)
    for k, sample in samples(run):
        if k == tare:
            session.tare()
        session.update(*sample)
        if k == tare + 4000:
            break
    rows = [sample for k, sample in samples(run) if tare + 4000 < k <= tare + 4200]
    return session.snapshot(), rows


def written(folder):
    path = folder / "s.json"
    write_snapshot(stopped()[0], path)
    return path, json.loads(path.read_text())


def places(plain, path=()):
    """Where something stands in a snapshot; of long lists only the first."""
    if path:
        yield path
    if isinstance(plain, dict | list):
        inner = plain.items() if isinstance(plain, dict) else list(enumerate(plain))[:2]
        for key, value in inner:
            yield from places(value, (*path, key))


def with_change(plain, path, value):
    changed = copy.deepcopy(plain)
    where = changed
    for key in path[:-1]:
        where = where[key]
    where[path[-1]] = value
    return changed


def numbers(estimate):
    wrench = estimate.wrench
    return (
        wrench.axial,
        wrench.axial_std,
        wrench.model_mismatch,
        estimate.depth_m,
        estimate.speed_m_s,
    )


def test_one_changed_digit_is_noticed(tmp_path):
    path, content = written(tmp_path)
    text = path.read_text()
    at = text.index("smooth_torque")
    digit = next(k for k in range(at, len(text)) if text[k] in "12345678")
    path.write_text(text[:digit] + str(int(text[digit]) + 1) + text[digit + 1 :])
    with pytest.raises(SnapshotFileError, match="sha256"):
        read_snapshot(path)
    path.write_text(json.dumps(content, indent=2))
    assert same(read_snapshot(path), stopped()[0])


@given(st.data())
@settings(
    max_examples=120,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_a_field_changed_on_purpose_is_refused_or_does_no_harm(tmp_path, data):
    path, content = written(tmp_path)
    plain = content["snapshot"]
    place = data.draw(st.sampled_from(sorted(places(plain), key=str)))
    path.write_text(json.dumps(sealed(with_change(plain, place, data.draw(st.sampled_from(ODD))))))
    session = InsertionSession(short_run().robot)
    before = session.snapshot()
    try:
        session.restore(read_snapshot(path))
    except ValueError:
        assert same(session.snapshot(), before)
        return
    for row in stopped()[1]:
        assert np.isfinite(numbers(session.update(*row))).all()


@pytest.mark.parametrize(
    ("path", "value"),
    [
        (("sensor", "offset", "recorder"), None),
        (("sensor", "offset", "smooth_torque"), ODD[-2]),
        (("sensor", "offset", "bias"), ODD[-3]),
        (("sensor", "missed_s"), {"float": "nan"}),
        (("zero", "axis_in_base"), ODD[-3]),
        (("identifier", "state"), 1),
        (("identifier", "state", "track"), None),
        (("travel", "depth_m"), {"float": "inf"}),
    ],
)
def test_a_refused_snapshot_leaves_the_running_session_as_it_was(tmp_path, path, value):
    file, content = written(tmp_path)
    plain = content["snapshot"]
    place = tuple(part for name in path for part in ("fields", name))
    file.write_text(json.dumps(sealed(with_change(plain, place, value))))
    ours, twin = InsertionSession(short_run().robot), InsertionSession(short_run().robot)
    ours.restore(stopped()[0])
    twin.restore(stopped()[0])
    with pytest.raises(ValueError, match=r"damaged|cannot read"):
        ours.restore(read_snapshot(file))
    assert ours.tared
    for row in stopped()[1][:50]:
        assert same(ours.update(*row), twin.update(*row))
