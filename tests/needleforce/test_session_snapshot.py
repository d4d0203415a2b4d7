"""Stopping and resuming is bit-equal; what became of a file in between is noticed."""

import copy
import hashlib
from dataclasses import replace

import msgspec
import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from foundation.state import MAX_FILE_BYTES, STATE_VERSION
from identification import MIXTURE, PUBLISHED, RuptureState
from needleforce import (
    InsertionError,
    InsertionSession,
    SnapshotFileError,
    read_snapshot,
    write_snapshot,
)
from residual import DEFAULT, SnapshotError, VirtualForceSensor
from tests.insertion_run import (
    following,
    resumed_after,
    same,
    samples,
    short_run,
    stopped_after,
    tare_index,
)
from urdf import Payload

CONFIGS = {"mixture": MIXTURE, "published": PUBLISHED}
TARE = tare_index(short_run())
IN_TISSUE = TARE + 4000
BEYOND = 1500  # ticks for which the resumed session is compared
NAN_7 = [[7], "C", np.full(7, np.nan).tobytes()]
ODD = [
    None,
    True,
    -1,
    1.0,
    1e300,
    "x",
    [],
    {},
    np.nan,
    np.inf,
    [[1], "C", bytes(8)],
    NAN_7,
]
ODD += [[[0, 2**60], "C", b""], [[3], "C", bytes(8)], [[1], "?", bytes(8)]]


def run_through(session, last, folder, *, with_velocity):
    """Estimates of a run, and the ticks after which a snapshot was written, by tick."""
    estimates = []
    files = {}
    # While the noise is learnt, while free motion is recorded, in air, in the gel, in
    # its rupture.
    cuts = {200, TARE - 50, TARE + 500, TARE + 6000}
    for k, sample in samples(short_run(), with_velocity=with_velocity):
        if k == TARE:
            session.tare()
        estimates.append(session.update(*sample))
        machine = estimates[-1].identification.rupture_state
        if k in cuts or (
            machine is RuptureState.FORCE_DROP_MEASURING and "rupture" not in files
        ):
            name = k if k in cuts else "rupture"
            files[name] = (k, folder / f"{name}.snapshot")
            write_snapshot(session.snapshot(), files[name][1])
        if k == last:
            return estimates, files
    raise AssertionError


@pytest.mark.slow
@pytest.mark.parametrize("with_velocity", [True, False])
@pytest.mark.parametrize("config", CONFIGS)
def test_a_resumed_session_goes_on_bit_for_bit(config, with_velocity, tmp_path):
    run = short_run()
    session = InsertionSession(run.robot, identifier_config=CONFIGS[config])
    end = TARE + 17_500
    estimates, files = run_through(session, end, tmp_path, with_velocity=with_velocity)

    assert ("rupture" in files) or config == "published"

    feed = list(samples(run, with_velocity=with_velocity))
    for cut, path in files.values():
        other = InsertionSession(run.robot, identifier_config=CONFIGS[config])
        other.restore(read_snapshot(path))
        for k in range(cut + 1, min(cut + BEYOND, end)):
            if k == TARE:
                other.tare()
            assert same(other.update(*feed[k][1]), estimates[k]), (cut, k)


@pytest.mark.slow
def test_a_sensor_alone_is_stored_too(tmp_path):
    whole, (row,) = resumed_after(IN_TISSUE, 1)
    stored, other = (VirtualForceSensor(short_run().robot) for _ in range(2))
    stored.restore(whole.snapshot().sensor)
    write_snapshot(stored.snapshot(), tmp_path / "s")
    other.restore(read_snapshot(tmp_path / "s"))

    assert same(other.update(*row), stored.update(*row))


def test_external_torque_resumes_too(tmp_path):
    run = short_run()
    session = InsertionSession(run.robot)
    other = InsertionSession(run.robot)
    torques = np.random.default_rng(0).normal(size=(1500, 7))
    for k, (q, torque) in enumerate(
        zip(run.signals.q_rad[:1500], torques, strict=True)
    ):
        estimate = session.update_external_torque(q, None, torque, 1e-3)
        if k == 900:
            write_snapshot(session.snapshot(), tmp_path / "s")
            other.restore(read_snapshot(tmp_path / "s"))
        if k > 900:
            assert same(other.update_external_torque(q, None, torque, 1e-3), estimate)


def test_another_robot_or_other_settings_are_refused(lwr):
    snapshot = stopped_after(IN_TISSUE)
    more = Payload(mass_kg=0.1, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    heavier = lwr.with_payload(lwr.payload + more)
    robot = short_run().robot
    for foreign, error, match in [
        (InsertionSession(heavier), SnapshotError, "another robot"),
        (
            InsertionSession(robot, replace(DEFAULT, gain_per_s=50.0)),
            SnapshotError,
            "settings",
        ),
        (
            InsertionSession(robot, identifier_config=PUBLISHED),
            ValueError,
            "Snapshot taken",
        ),
        (InsertionSession(robot, speed_lag_s=0.02), InsertionError, "speed_lag_s"),
    ]:
        state = foreign.snapshot()
        with pytest.raises(error, match=match):
            foreign.restore(snapshot)
        assert same(foreign.snapshot(), state)

    with pytest.raises(InsertionError, match="SensorState"):
        InsertionSession(robot).restore(snapshot.sensor)
    with pytest.raises(SnapshotError, match="expected a SensorState"):
        VirtualForceSensor(lwr).restore(snapshot)


@pytest.mark.parametrize(
    "fields",
    [{"travel": (0.0, 0.0)}, {"checkpoints": ()}, {"plan": None}, {"time_s": -1e300}],
    ids=str,
)
def test_a_snapshot_edited_in_memory_is_refused(fields):
    session = InsertionSession(short_run().robot)
    state = session.snapshot()

    with pytest.raises(InsertionError, match="the snapshot is damaged"):
        session.restore(stopped_after(IN_TISSUE)._replace(**fields))
    assert same(session.snapshot(), state)


def test_a_shallow_copy_shares_nothing():
    session, rows = resumed_after(IN_TISSUE, 300)
    twin = copy.copy(session)
    state = session.snapshot()
    estimates = [twin.update(*row) for row in rows]

    assert same(session.snapshot(), state)
    assert all(
        same(session.update(*row), estimate)
        for row, estimate in zip(rows, estimates, strict=True)
    )


def written(folder):
    """A file, its envelope and the plain tree of its snapshot."""
    path = folder / "s"
    write_snapshot(stopped_after(IN_TISSUE), path)
    envelope = msgspec.msgpack.decode(path.read_bytes())
    return path, envelope, msgspec.msgpack.decode(envelope["data"])


def sealed(envelope, plain):
    """A file with another snapshot and the digest that belongs to it."""
    data = msgspec.msgpack.encode(plain)
    changed = envelope | {"data": data, "sha256": hashlib.sha256(data).hexdigest()}
    return msgspec.msgpack.encode(changed)


def test_files_that_are_no_snapshots_say_so(tmp_path):
    path, envelope, plain = written(tmp_path)

    assert envelope["version"] == STATE_VERSION

    encode = msgspec.msgpack.encode
    for content, match in [
        (encode(envelope | {"version": 99}), "version 99"),
        (encode(envelope | {"format": "other"}), "'other'"),
        (encode([]), "holds no state"),
        (encode(envelope | {"data": b""}), "sha256"),
        (encode(envelope | {"kind": "Popen"}), "'Popen'"),
        (encode(envelope | {"kind": "session, x"}), "'session, x'"),
        (encode(envelope | {"kind": "sensor"}), "damaged"),
        (encode(envelope | {"method": "os.system"}), "`method`"),
        (sealed(envelope, None), "damaged"),
        (sealed(envelope, plain[:-1]), "damaged"),
        (path.read_bytes()[:1000], "cut short"),
        (b"", "cut short"),
        (bytes(MAX_FILE_BYTES + 1), "64 MB"),
    ]:
        path.write_bytes(content)
        with pytest.raises(SnapshotFileError, match=match):
            read_snapshot(path)

    with pytest.raises(SnapshotFileError, match="got a dict"):
        write_snapshot({}, path)
    with pytest.raises(OSError, match="missing"):
        read_snapshot(tmp_path / "missing")


@pytest.mark.slow
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

    assert same(read_snapshot(path), stopped_after(IN_TISSUE))


def test_a_full_disk_leaves_the_older_snapshot(tmp_path, monkeypatch):
    path, _, _ = written(tmp_path)
    older = path.read_bytes()

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)

    with pytest.raises(OSError, match="No space"):
        write_snapshot(stopped_after(IN_TISSUE), path)
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


@pytest.mark.slow
@given(st.data())
@settings(max_examples=60, suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_a_changed_field_is_refused_or_harmless(tmp_path, data):
    path, envelope, plain = written(tmp_path)
    place = data.draw(st.sampled_from(sorted(places(plain), key=str)))
    path.write_bytes(
        sealed(envelope, with_change(plain, place, data.draw(st.sampled_from(ODD))))
    )
    session = InsertionSession(short_run().robot)
    state = session.snapshot()
    try:
        session.restore(read_snapshot(path))
    except ValueError:
        assert same(session.snapshot(), state)
        return
    for row in following(IN_TISSUE, 200):
        estimate = session.update(*row)
        wrench = estimate.wrench
        numbers = (
            wrench.axial,
            wrench.axial_std,
            wrench.model_mismatch,
            *estimate[1:3],
        )
        assert np.isfinite(numbers).all()


@pytest.mark.parametrize("value", [object(), 1 + 2j, np.zeros(2, dtype=np.int64)])
def test_what_a_snapshot_cannot_hold_is_refused(value, tmp_path):
    with pytest.raises(SnapshotFileError, match="cannot hold"):
        write_snapshot(
            stopped_after(IN_TISSUE)._replace(unused_s=value), tmp_path / "s"
        )
