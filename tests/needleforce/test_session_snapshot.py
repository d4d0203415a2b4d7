"""Stopping and resuming is bit-equal; what became of a file in between is noticed."""

import copy
from dataclasses import replace
from functools import partial
from unittest.mock import Mock

import numpy as np
import pytest

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


def copied(snapshot, folder):
    """What comes back from a file."""
    write_snapshot(snapshot, folder / "copy")
    return read_snapshot(folder / "copy")


@pytest.mark.slow
def test_a_sensor_alone_is_stored_too(tmp_path):
    whole, (row,) = resumed_after(IN_TISSUE, 1)
    stored, other = (VirtualForceSensor(short_run().robot) for _ in range(2))
    stored.restore(whole.snapshot().sensor)
    other.restore(copied(stored.snapshot(), tmp_path))

    assert same(other.update(*row), stored.update(*row))


def test_external_torque_resumes_too(tmp_path):
    run = short_run()
    session, other = (InsertionSession(run.robot) for _ in range(2))
    torques = np.random.default_rng(0).normal(size=(1500, 7))
    q_rad = run.signals.q_rad[:1500]
    rows = [(q, None, tau, 1e-3) for q, tau in zip(q_rad, torques, strict=True)]
    for row in rows[:901]:
        session.update_external_torque(*row)
    other.restore(copied(session.snapshot(), tmp_path))
    for row in rows[901:]:
        estimate = session.update_external_torque(*row)
        assert same(other.update_external_torque(*row), estimate)


ROBOT = short_run().robot
HEAVIER = ROBOT.with_payload(
    ROBOT.payload
    + Payload(mass_kg=0.1, com_m=np.zeros(3), inertia_kg_m2=np.zeros((3, 3)))
)


@pytest.mark.parametrize(
    ("foreign", "error", "match"),
    [
        (partial(InsertionSession, HEAVIER), SnapshotError, "another robot"),
        (
            partial(InsertionSession, ROBOT, replace(DEFAULT, gain_per_s=50.0)),
            *(SnapshotError, "settings"),
        ),
        (
            partial(InsertionSession, ROBOT, identifier_config=PUBLISHED),
            *(ValueError, "Snapshot taken"),
        ),
        (
            partial(InsertionSession, ROBOT, speed_lag_s=0.02),
            *(InsertionError, "speed_lag_s"),
        ),
        (partial(VirtualForceSensor, ROBOT), SnapshotError, "SensorState"),
    ],
)
def test_another_robot_or_other_settings_are_refused(foreign, error, match):
    other = foreign()
    state = other.snapshot()
    with pytest.raises(error, match=match):
        other.restore(stopped_after(IN_TISSUE))
    assert same(other.snapshot(), state)


def test_the_state_of_a_sensor_is_none_of_a_session():
    with pytest.raises(InsertionError, match="SensorState"):
        InsertionSession(ROBOT).restore(stopped_after(IN_TISSUE).sensor)


def test_a_shallow_copy_shares_nothing():
    session, rows = resumed_after(IN_TISSUE, 300)
    twin = copy.copy(session)
    state = session.snapshot()
    estimates = tuple(twin.update(*row) for row in rows)

    assert same(session.snapshot(), state)
    assert same(tuple(session.update(*row) for row in rows), estimates)


def test_files_that_are_no_snapshots_are_refused(tmp_path):
    path = tmp_path / "s"
    write_snapshot(stopped_after(IN_TISSUE), path)
    content = path.read_bytes()
    flipped = bytearray(content)
    flipped[len(content) // 2] ^= 4

    assert same(read_snapshot(path), stopped_after(IN_TISSUE))

    for changed, match in [
        (content.replace(b" session ", b" sensor ", 1), "SessionSnapshot"),
        (content.replace(b" session ", b" Popen ", 1), "Popen"),
        (bytes(flipped), "damaged"),
        (content[:1000], "cut short"),
        (b"", "no state"),
    ]:
        path.write_bytes(changed)
        with pytest.raises(SnapshotFileError, match=match):
            read_snapshot(path)

    with pytest.raises(SnapshotFileError, match="dict"):
        write_snapshot({}, path)


def test_a_full_disk_leaves_the_older_snapshot(tmp_path, monkeypatch):
    path = tmp_path / "s"
    write_snapshot(stopped_after(IN_TISSUE), path)
    older = path.read_bytes()
    full = OSError(28, "No space left on device")
    monkeypatch.setattr("os.fsync", Mock(side_effect=full))

    with pytest.raises(OSError, match="No space"):
        write_snapshot(stopped_after(IN_TISSUE), path)
    assert [(p.name, p.read_bytes()) for p in tmp_path.iterdir()] == [("s", older)]
