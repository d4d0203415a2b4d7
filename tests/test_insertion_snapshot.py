"""Stopping and resuming gives bit-equal results, through a plain file."""

import json
from dataclasses import replace

import numpy as np
import pytest
from insertion_run import same, samples, sealed, short_run, tare_index

from identification import MULTILAYER as IDENTIFIER_DEFAULT
from identification import PUBLISHED as IDENTIFIER_PAPER
from identification import Identifier, RuptureState
from needleforce import (
    SNAPSHOT_VERSION,
    InsertionError,
    InsertionSession,
    SnapshotFileError,
    read_snapshot,
    write_snapshot,
)
from needleforce.snapshot import from_plain, to_plain
from residual import DEFAULT, SnapshotError, VirtualForceSensor
from urdf import NeedleTool, Payload, load_lwr

CONFIGS = {"default": IDENTIFIER_DEFAULT, "published": IDENTIFIER_PAPER}
BEYOND = 1500
"""Ticks for which the resumed session is compared."""


def resumed(session, robot, path, config=IDENTIFIER_DEFAULT, sensor_config=DEFAULT):
    """A new session that goes on from a file."""
    write_snapshot(session.snapshot(), path)
    other = InsertionSession(robot, sensor_config, config)
    other.restore(read_snapshot(path))
    return other


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
            files[name] = (k, folder / f"{name}.json")
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


def test_sensor_and_identifier_alone_are_stored_too(tmp_path):
    run = short_run()
    sensor, identifier = VirtualForceSensor(run.robot), Identifier()
    for k, sample in samples(run):
        estimate = sensor.update(*sample)
        identifier.update(1e-6 * k, 1e-3, estimate.axial, 1e-3)
        if k == 1000:
            break
    write_snapshot(sensor.snapshot(), tmp_path / "sensor.json")
    write_snapshot(identifier.snapshot(), tmp_path / "identifier.json")
    other, another = VirtualForceSensor(run.robot), Identifier()
    other.restore(read_snapshot(tmp_path / "sensor.json"))
    another.restore(read_snapshot(tmp_path / "identifier.json"))
    assert same(other.update(*sample), sensor.update(*sample))
    assert another.update(2e-3, 1e-3, 0.1, 1e-3) == identifier.update(2e-3, 1e-3, 0.1, 1e-3)


def test_external_torque_resumes_too(tmp_path):
    run = short_run()
    session = InsertionSession(run.robot)
    rng = np.random.default_rng(0)
    for k in range(1500):
        torque = rng.normal(size=7)
        estimate = session.update_external_torque(run.signals.q_rad[k], None, torque, 1e-3)
        if k == 900:
            other = resumed(session, run.robot, tmp_path / "s.json")
        if k > 900:
            twin = other.update_external_torque(run.signals.q_rad[k], None, torque, 1e-3)
            assert same(twin, estimate)


def started(robot, **settings):
    """A session that has seen a few samples."""
    session = InsertionSession(robot, **settings)
    for k, sample in samples(short_run()):
        session.update(*sample)
        if k == 100:
            return session
    raise AssertionError


def test_another_robot_or_other_settings_are_refused_and_change_nothing(lwr):
    session = started(lwr)
    kept = session.snapshot()
    heavier = load_lwr(payload=NeedleTool()).with_payload(
        NeedleTool().payload
        + Payload(mass_kg=0.1, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
    )
    for foreign, error, match in [
        (InsertionSession(heavier), SnapshotError, "another robot"),
        (InsertionSession(lwr, replace(DEFAULT, gain_per_s=50.0)), SnapshotError, "other settings"),
        (InsertionSession(lwr, identifier_config=IDENTIFIER_PAPER), ValueError, "Snapshot taken"),
        (InsertionSession(lwr, speed_lag_s=0.02), InsertionError, "speed_lag_s"),
    ]:
        before = to_plain(foreign.snapshot())
        with pytest.raises(error, match=match):
            foreign.restore(kept)
        assert to_plain(foreign.snapshot()) == before
    with pytest.raises(InsertionError, match="SensorState"):
        session.restore(kept.sensor)
    with pytest.raises(SnapshotError, match="expected a SensorState"):
        VirtualForceSensor(lwr).restore(kept)


def test_files_that_are_no_snapshots_say_so(lwr, tmp_path):
    path = tmp_path / "s.json"
    write_snapshot(started(lwr).snapshot(), path)
    good = json.loads(path.read_text())
    assert good["version"] == SNAPSHOT_VERSION
    for content, match in [
        (good | {"version": 99}, "version 99"),
        (good | {"format": "other"}, "no format"),
        ([], "no format"),
        (good | {"version": True}, "version True"),
        (good | {"snapshot": None}, "sha256"),
        (sealed(None), "NoneType"),
        (sealed({"type": "Popen", "fields": {}}), "Popen"),
        (sealed({"type": "Travel", "fields": {"depth_m": 0.0}}), "speed_m_s"),
        (sealed({"array": [1.0, 2.0], "shape": [3], "order": "C"}), "array"),
    ]:
        path.write_text(json.dumps(content))
        with pytest.raises(SnapshotFileError, match=match):
            read_snapshot(path)
    for text in (json.dumps(good)[:1000], "[" * 100_000, "[" * 100_000 + "]" * 100_000):
        path.write_text(text)
        with pytest.raises(SnapshotFileError, match="cut short"):
            read_snapshot(path)
    path.write_text(json.dumps(good)[:1000])
    with pytest.raises(SnapshotFileError, match="cut short"):
        read_snapshot(path)
    with pytest.raises(SnapshotFileError, match="got a dict"):
        write_snapshot({}, path)
    with pytest.raises(OSError, match="missing"):
        read_snapshot(tmp_path / "missing.json")


@pytest.mark.parametrize(
    "value",
    [
        None,
        (1, 2.5, "x", True),
        float("inf"),
        np.float64(0.1),
        np.array([[1.0, np.nan], [2.0, -np.inf]]),
        np.asfortranarray(np.arange(6.0).reshape(2, 3)),
        np.zeros((0, 5, 7)),
        RuptureState.DETECTED,
    ],
)
def test_plain_values_come_back_as_they_were(value):
    back = from_plain(json.loads(json.dumps(to_plain(value), allow_nan=False)))
    if isinstance(value, np.ndarray):
        np.testing.assert_array_equal(back, value)
        assert back.flags.f_contiguous == value.flags.f_contiguous
        assert not back.flags.writeable
    else:
        assert back == value


@pytest.mark.parametrize("value", [object(), {1: 2}, np.zeros(2, dtype=np.int64)])
def test_what_a_snapshot_cannot_hold_is_refused(value):
    with pytest.raises(SnapshotFileError, match="cannot hold"):
        to_plain(value)
