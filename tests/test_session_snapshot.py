"""Stopping and resuming is bit-equal; what became of a file in between is noticed."""

import copy
import hashlib
import pickle
from dataclasses import replace
from functools import cache

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from insertion_run import same, samples, short_run, tare_index

from identification import MULTILAYER, PUBLISHED, Identifier, RuptureState
from needleforce import (
    InsertionError,
    InsertionSession,
    SnapshotFileError,
    read_snapshot,
    write_snapshot,
)
from needleforce.snapshot import MOST_BYTES, SNAPSHOT_VERSION
from residual import DEFAULT, SnapshotError, VirtualForceSensor
from urdf import NeedleTool, Payload, load_lwr

CONFIGS = {"multilayer": MULTILAYER, "published": PUBLISHED}
BEYOND = 1500
"""Ticks for which the resumed session is compared."""
NAN_7 = [[7], "C", np.full(7, np.nan).tobytes()]
ODD = [None, True, -1, 1.0, 1e300, "x", [], {}, np.nan, np.inf, [[1], "C", bytes(8)], NAN_7]
ODD += [[[0, 2**60], "C", b""], [[3], "C", bytes(8)], [[1], "?", bytes(8)]]


def run_through(session, last, folder, *, with_velocity):
    """Estimates of a run, and the ticks after which a snapshot was written, by tick."""
    tare = tare_index(short_run())
    found, files = [], {}
    # While the noise is learnt, while free motion is recorded, in air, in the gel, in its rupture.
    cuts = {200, tare - 50, tare + 500, tare + 6000}
    for k, sample in samples(short_run(), with_velocity=with_velocity):
        if k == tare:
            session.tare()
        found.append(session.update(*sample))
        machine = found[-1].identification.rupture_state
        if k in cuts or (machine is RuptureState.FORCE_DROP_MEASURING and "rupture" not in files):
            name = k if k in cuts else "rupture"
            files[name] = (k, folder / f"{name}.snapshot")
            write_snapshot(session.snapshot(), files[name][1])
        if k == last:
            return found, files
    raise AssertionError


@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("config", CONFIGS)
def test_a_resumed_session_goes_on_bit_for_bit(config, with_velocity, tmp_path):
    run = short_run()
    tare = tare_index(run)
    session = InsertionSession(run.robot, identifier_config=CONFIGS[config])
    last = tare + 17_500
    found, files = run_through(session, last, tmp_path, with_velocity=with_velocity)
    assert ("rupture" in files) or config == "published"
    feed = list(samples(run, with_velocity=with_velocity))
    for cut, path in files.values():
        other = InsertionSession(run.robot, identifier_config=CONFIGS[config])
        other.restore(read_snapshot(path))
        for k in range(cut + 1, min(cut + BEYOND, last)):
            if k == tare:
                other.tare()
            assert same(other.update(*feed[k][1]), found[k]), (cut, k)


@cache
def stopped():
    """A session stopped in the tissue, its snapshot, and the samples that come next."""
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
    return session, session.snapshot(), rows


@pytest.mark.parametrize(
    "copied", [copy.deepcopy, lambda session: pickle.loads(pickle.dumps(session))]
)
def test_a_copy_goes_on_bit_for_bit_and_apart_from_the_original(copied):
    _, snapshot, rows = stopped()
    session = InsertionSession(short_run().robot)
    session.restore(snapshot)
    other = copied(session)
    expected = [session.update(*row) for row in rows]
    assert same(tuple(other.update(*row) for row in rows), tuple(expected))


def test_sensor_and_identifier_alone_are_stored_too(tmp_path):
    run = short_run()
    sensor, identifier = VirtualForceSensor(run.robot), Identifier()
    for k, sample in samples(run):
        estimate = sensor.update(*sample)
        identifier.update(1e-6 * k, 1e-3, estimate.axial, 1e-3)
        if k == 1000:
            break
    write_snapshot(sensor.snapshot(), tmp_path / "sensor")
    write_snapshot(identifier.snapshot(), tmp_path / "identifier")
    other, another = VirtualForceSensor(run.robot), Identifier()
    other.restore(read_snapshot(tmp_path / "sensor"))
    another.restore(read_snapshot(tmp_path / "identifier"))
    assert same(other.update(*sample), sensor.update(*sample))
    assert another.update(2e-3, 1e-3, 0.1, 1e-3) == identifier.update(2e-3, 1e-3, 0.1, 1e-3)


def test_external_torque_resumes_too(tmp_path):
    run = short_run()
    session, other = InsertionSession(run.robot), InsertionSession(run.robot)
    rng = np.random.default_rng(0)
    for k in range(1500):
        torque = rng.normal(size=7)
        estimate = session.update_external_torque(run.signals.q_rad[k], None, torque, 1e-3)
        if k == 900:
            write_snapshot(session.snapshot(), tmp_path / "s")
            other.restore(read_snapshot(tmp_path / "s"))
        if k > 900:
            twin = other.update_external_torque(run.signals.q_rad[k], None, torque, 1e-3)
            assert same(twin, estimate)


def test_another_robot_or_other_settings_are_refused_and_change_nothing(lwr):
    kept = stopped()[1]
    heavier = load_lwr(payload=NeedleTool()).with_payload(
        NeedleTool().payload
        + Payload(mass_kg=0.1, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    )
    robot = short_run().robot
    for foreign, error, match in [
        (InsertionSession(heavier), SnapshotError, "another robot"),
        (InsertionSession(robot, replace(DEFAULT, gain_per_s=50.0)), SnapshotError, "settings"),
        (InsertionSession(robot, identifier_config=PUBLISHED), ValueError, "Snapshot taken"),
        (InsertionSession(robot, speed_lag_s=0.02), InsertionError, "speed_lag_s"),
    ]:
        before = foreign.snapshot()
        with pytest.raises(error, match=match):
            foreign.restore(kept)
        assert same(foreign.snapshot(), before)
    with pytest.raises(InsertionError, match="SensorState"):
        InsertionSession(robot).restore(kept.sensor)
    with pytest.raises(SnapshotError, match="expected a SensorState"):
        VirtualForceSensor(lwr).restore(kept)


def written(folder):
    """A file, its envelope and the plain tree of its snapshot."""
    path = folder / "s"
    write_snapshot(stopped()[1], path)
    envelope = msgspec.msgpack.decode(path.read_bytes())
    return path, envelope, msgspec.msgpack.decode(envelope["data"])


def sealed(envelope, plain):
    """A file with another snapshot and the digest that belongs to it."""
    data = msgspec.msgpack.encode(plain)
    changed = envelope | {"data": data, "sha256": hashlib.sha256(data).hexdigest()}
    return msgspec.msgpack.encode(changed)


def test_files_that_are_no_snapshots_say_so(tmp_path):
    path, envelope, plain = written(tmp_path)
    assert envelope["version"] == SNAPSHOT_VERSION
    encode = msgspec.msgpack.encode
    for content, match in [
        (encode(envelope | {"version": 99}), "version 99"),
        (encode(envelope | {"version": True}), "no snapshot"),
        (encode(envelope | {"format": "other"}), "'other'"),
        (encode([]), "no snapshot"),
        (encode(envelope | {"data": b""}), "sha256"),
        (encode(envelope | {"kind": "Popen"}), "'Popen'"),
        (encode(envelope | {"method": "os.system"}), r"'os\.system'"),
        (sealed(envelope, None), "damaged"),
        (sealed(envelope, plain[:-1]), "damaged"),
        (path.read_bytes()[:1000], "cut short"),
        (b"\x91" * 100_000, "no snapshot"),
        (b"", "cut short"),
        (bytes(MOST_BYTES + 1), "64 MB"),
    ]:
        path.write_bytes(content)
        with pytest.raises(SnapshotFileError, match=match):
            read_snapshot(path)
    with pytest.raises(SnapshotFileError, match="got a dict"):
        write_snapshot({}, path)
    with pytest.raises(OSError, match="missing"):
        read_snapshot(tmp_path / "missing")


def test_one_changed_byte_is_noticed(tmp_path):
    path, _, _ = written(tmp_path)
    content = bytearray(path.read_bytes())
    for at in np.random.default_rng(0).integers(len(content), size=200):
        content[at] ^= 4
        path.write_bytes(content)
        with pytest.raises(SnapshotFileError):
            read_snapshot(path)
        content[at] ^= 4
    path.write_bytes(content)
    assert same(read_snapshot(path), stopped()[1])


def test_a_full_disk_leaves_the_older_snapshot_and_no_part(tmp_path, monkeypatch):
    path, _, _ = written(tmp_path)
    older = path.read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)
    with pytest.raises(OSError, match="No space"):
        write_snapshot(stopped()[1], path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == older


def places(plain, path=()):
    """Where something stands in a plain tree; of long lists only the first."""
    if path:
        yield path
    if isinstance(plain, dict | list):
        long = isinstance(plain, list) and len(plain) > 40
        inner = plain.items() if isinstance(plain, dict) else list(enumerate(plain))
        for key, value in inner[:2] if long else inner:
            yield from places(value, (*path, key))


def with_change(plain, path, value):
    changed = copy.deepcopy(plain)
    where = changed
    for key in path[:-1]:
        where = where[key]
    where[path[-1]] = value
    return changed


@given(st.data())
@settings(
    max_examples=200,
    deadline=None,
    derandomize=True,
    suppress_health_check=[HealthCheck.function_scoped_fixture],
)
def test_a_field_changed_on_purpose_is_refused_or_does_no_harm(tmp_path, data):
    path, envelope, plain = written(tmp_path)
    place = data.draw(st.sampled_from(sorted(places(plain), key=str)))
    path.write_bytes(sealed(envelope, with_change(plain, place, data.draw(st.sampled_from(ODD)))))
    session = InsertionSession(short_run().robot)
    before = session.snapshot()
    try:
        session.restore(read_snapshot(path))
    except ValueError:
        assert same(session.snapshot(), before)
        return
    for row in stopped()[2]:
        estimate = session.update(*row)
        wrench = estimate.wrench
        numbers = (wrench.axial, wrench.axial_std, wrench.model_mismatch, *estimate[1:3])
        assert np.isfinite(numbers).all()


@pytest.mark.parametrize("value", [object(), 1 + 2j, np.zeros(2, dtype=np.int64)])
def test_what_a_snapshot_cannot_hold_is_refused(value, tmp_path):
    with pytest.raises(SnapshotFileError, match="cannot hold"):
        write_snapshot(stopped()[1]._replace(unused_s=value), tmp_path / "s")
