"""Stopping and resuming is bit-equal; what became of a file in between is noticed."""

import copy
from dataclasses import replace

import numpy as np
import pytest

from foundation.state import MAX_FILE_BYTES
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
        (bytes(MAX_FILE_BYTES + 1), "no state"),
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

    def full(_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr("os.fsync", full)

    with pytest.raises(OSError, match="No space"):
        write_snapshot(stopped_after(IN_TISSUE), path)
    assert [p.name for p in tmp_path.iterdir()] == [path.name]
    assert path.read_bytes() == older
