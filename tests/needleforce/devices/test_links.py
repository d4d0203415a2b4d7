"""Arms, force sensors and haptic devices against emulators in processes of their
own."""

import io
import json
import socket
import threading
import time
from contextlib import suppress
from functools import partial
from http.client import IncompleteRead
from typing import NamedTuple

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.devices import (
    DeviceSettingError,
    FriArm,
    LinkError,
    LinkReport,
    NetFT,
    ReplayArm,
    Scale,
    controller_link,
    datagram_link,
    fri,
    pace,
    rdt,
)
from needleforce.devices.datagram_link import LOOPBACK
from needleforce.devices.emulators import (
    Emulator,
    FriSettings,
    RdtSettings,
    WireFaults,
    emulate_fri,
    emulate_rdt,
)

ROWS = np.linspace(0.0, 1.0, 700).reshape(100, 7).astype(np.float32).astype(float)
WRENCH = np.random.default_rng(0).normal(size=(5000, 6))
PATIENCE_S = 20.0
"""On a busy machine things take longer; nothing here is a measurement of speed."""


class FriRun(NamedTuple):
    """Readings of an arm, its report, and what the emulated controller has counted."""

    readings: list
    report: LinkReport
    counts: dict


def fri_run(cycles, faults=None, *, send=None, give_up_s=1.0, **settings):
    """Run an arm against an emulated, patient controller of so many cycles."""
    arm = FriArm(port=0, wait_s=0.05, give_up_s=give_up_s)
    controller = FriSettings(
        port=arm.address[1],
        q_rad=ROWS,
        tau_Nm=2.0 * ROWS,
        cycles=cycles,
        extra_wait_s=PATIENCE_S,
        faults=faults or WireFaults(),
        **settings,
    )
    readings = []
    with arm, Emulator(emulate_fri, controller) as emulator:
        for reading in arm:
            readings.append(reading)
            if send is not None:
                arm.send(send)

        return FriRun(readings, arm.report, emulator.counts())


def measurement(**values):
    packet = np.zeros((), fri.MEASUREMENT)
    fields = {
        "size": 916,
        "kind": fri.MEASUREMENT_KIND,
        "period_s": 1e-3,
        "state": 1,
    } | values
    for name, value in fields.items():
        packet[name] = value

    return packet.tobytes()


@pytest.mark.slow
def test_every_lwr_cycle_is_answered_and_passed_on():
    run = fri_run(1000)

    assert len(run.readings) == 1000 == run.report.used
    assert run.counts["same_cycle"] == 1000
    assert [reading.dt_s for reading in run.readings[:3]] == [1e-3] * 3

    reading = run.readings[42]

    assert np.array_equal(reading.q_rad, ROWS[42])
    assert np.array_equal(reading.tau_Nm, 2.0 * ROWS[42])
    assert reading.dq_rad_s is None


@pytest.mark.slow
def test_invalid_packets_are_dropped_missed_ones_counted():
    faults = WireFaults(
        lost=0.02, late=0.02, repeated=0.02, truncated=0.02, garbage=0.05
    )
    run = fri_run(2000, faults)

    assert all(
        np.array_equal(reading.tau_Nm, 2.0 * reading.q_rad) for reading in run.readings
    )

    report = run.report

    assert report.malformed > 50
    assert report.stale > 20
    assert report.missed > 30

    elapsed_s = sum(reading.dt_s for reading in run.readings)

    assert report.used + report.missed == round(elapsed_s / 1e-3)
    assert sum(reading.missed for reading in run.readings) == report.missed


@pytest.mark.slow
def test_readings_after_an_outage_include_its_duration():
    run = fri_run(2500, WireFaults(silent=((0.3, 2.3),)), give_up_s=4.0)
    gap = max(run.readings, key=lambda reading: reading.dt_s)

    assert 1.99 < gap.dt_s < 3.9  # longer only on a busy machine
    assert gap.missed == round(gap.dt_s / 1e-3) - 1
    assert run.report.outages == 2  # the second is the end
    assert len(run.readings) == pytest.approx(500, abs=10)


@pytest.mark.slow
def test_commands_need_command_mode_and_good_connection():
    faults = WireFaults(bad_quality=((0.6, 0.8),))
    run = fri_run(1000, faults, send=np.full(7, 0.05), command_from_s=0.2)
    accepted = np.array([reading.accepts_commands for reading in run.readings])
    in_monitor_mode = slice(0, 190)
    while_commanded = slice(220, 580)
    while_badly_connected = slice(620, 790)

    assert not accepted[in_monitor_mode].any()
    assert accepted[while_commanded].all()
    assert not accepted[while_badly_connected].any()

    moved_rad = run.counts["commanded_rad"] - ROWS[0]

    assert np.allclose(moved_rad, 0.05 * np.count_nonzero(accepted) * 1e-3, rtol=0.1)


@pytest.mark.slow
@pytest.mark.parametrize("command", ["record", "live"])
def test_a_silent_arm_is_reported(command, tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(
        "needleforce.devices.arm_names.FriArm", partial(FriArm, give_up_s=0.2)
    )
    to = ["-o", str(tmp_path / "x.csv")] if command == "record" else []

    assert main([command, "fri:0", *to]) == 2

    said = capsys.readouterr().err.splitlines()

    assert said[-1].startswith(
        "error: no sample came from fri:0 (1 outages), expected one per"
    )
    assert list(tmp_path.iterdir()) == []


def test_invalid_datagrams_count_as_silence():
    arm = FriArm(port=0, wait_s=0.05, give_up_s=0.3)
    with arm, socket.socket(type=socket.SOCK_DGRAM) as box:
        box.sendto(measurement(count=5), arm.address)
        samples = iter(arm)
        begin_s = time.monotonic()
        assert next(samples).missed == 0
        is_over = threading.Event()

        def flood():
            while not is_over.wait(0.01):
                box.sendto(bytes(900), arm.address)
                box.sendto(measurement(count=5), arm.address)

        flooding = threading.Thread(target=flood, daemon=True)
        flooding.start()
        assert list(samples) == []
        is_over.set()
        flooding.join()
        assert 0.3 <= time.monotonic() - begin_s < 0.3 + PATIENCE_S

    assert min(arm.report.malformed, arm.report.stale) > 3


@pytest.mark.parametrize(
    ("count", "passed_s", "waiting", "then", "steps_s"),
    [
        (49999, 0.3, [0, 1], 2, [0.3, 1e-3, 1e-3]),  # begun anew
        (5, 0.5, [505, 506], 507, [0.5, 1e-3, 1e-3]),  # lost on the way
        (
            5,
            0.9,
            range(6, 66),
            905,
            [*[1e-3] * 60, 0.84],
        ),  # not read, and no room for all
        (5, 1.5, range(6, 66), 1505, [*[1e-3] * 60, 1.44]),
        (
            5,
            40.0,
            range(6, 66),
            40005,
            [40.0, *[1e-3] * 60],
        ),  # too long for the counter
    ],
)
def test_no_more_time_is_reported_than_passed(
    count, passed_s, waiting, then, steps_s, monkeypatch
):
    real = time.monotonic
    ahead_s = 0.0
    # A slow clock, which advances where the test says so.
    for module in (controller_link, datagram_link):
        monkeypatch.setattr(module, "monotonic", lambda: 1e-3 * real() + ahead_s)

    arm = FriArm(port=0, wait_s=1e-3, give_up_s=1e-3 * PATIENCE_S)
    with arm, socket.socket(type=socket.SOCK_DGRAM) as box:
        box.sendto(measurement(count=count), arm.address)
        arriving = iter(arm)
        readings = []
        next(arriving)
        ahead_s = passed_s
        for counts in (waiting, [then]):
            for number in counts:
                box.sendto(measurement(count=number), arm.address)

            readings += [next(arriving) for _ in counts]

    assert [sample.dt_s for sample in readings] == pytest.approx(steps_s)
    assert arm.report.missed == round((sum(steps_s) - 1e-3 * len(readings)) / 1e-3)


def test_commands_that_cannot_be_are_refused():
    with FriArm(port=0) as arm:
        for bad in (np.zeros(6), np.full(7, np.nan), np.zeros(7)):
            assert not arm.send(bad)  # the last because nothing has come yet


@pytest.mark.parametrize(
    "data",
    [
        b"",
        bytes(916),
        measurement(size=915),
        measurement(kind=0x1005),
        measurement(period_s=0.0),
        measurement(period_s=1e-7),  # in whole microseconds it is none
        measurement(state=3),
        measurement(position_rad=np.nan),
        measurement(torque_Nm=np.inf),
        measurement()[:-1],
        measurement() + b"x",
    ],
)
def test_what_is_no_measurement_is_refused(data):
    assert fri.read_measurement(data) is None


@pytest.mark.slow
def test_random_datagrams_do_no_harm():
    rng = np.random.default_rng(1)

    assert fri.read_measurement(measurement()) is not None

    for _ in range(100_000):
        size = 916 if rng.random() < 0.5 else int(rng.integers(1501))
        record = fri.read_measurement(rng.bytes(size))
        assert record is None or np.isfinite(record["position_rad"]).all()


def test_another_sender_is_not_listened_to():
    arm = FriArm(port=0, wait_s=0.05, give_up_s=0.1)
    with (
        arm,
        socket.socket(type=socket.SOCK_DGRAM) as box,
        socket.socket(type=socket.SOCK_DGRAM) as stranger,
    ):
        for count in range(3):
            box.sendto(measurement(count=count), arm.address)
            stranger.sendto(measurement(count=100 + count), arm.address)

        readings = list(arm)

    assert len(readings) == 3
    assert arm.report.foreign <= 3  # the kernel drops those after the first reading

    for peer, used in (("127.0.0.2", 0), ("127.1", 1)):
        named = FriArm(port=0, peer=peer, wait_s=0.05, give_up_s=0.1)
        with named, socket.socket(type=socket.SOCK_DGRAM) as box:
            box.sendto(measurement(), named.address)
            assert len(list(named)) == used == 1 - named.report.foreign


def test_an_address_that_cannot_be_is_said_so():
    with FriArm(port=0) as arm, pytest.raises(LinkError, match="other program"):
        FriArm(port=arm.address[1])

    with pytest.raises(DeviceSettingError, match="expected 0 to 65535"):
        FriArm(port=70000)

    with pytest.raises(DeviceSettingError, match="wait_s"):
        FriArm(port=0, wait_s=2.0, give_up_s=1.0)

    with pytest.raises(LinkError, match="no counts per newton"):
        NetFT(scale="http://127.0.0.1:9/none.xml")

    for name in ("no-such-host.invalid", "a" * 70):
        with pytest.raises(LinkError, match="no name that is known here"):
            NetFT(name)

        with pytest.raises(LinkError, match="no name that is known here"):
            FriArm(port=0, peer=name)

    for scale in (Scale(0.0, 1.0), (1,), (1, 2, 3)):
        with pytest.raises(DeviceSettingError, match="positive counts"):
            NetFT(scale=scale)

    for port in (-5, 0, 70000):
        with pytest.raises(DeviceSettingError, match="expected 1 to 65535"):
            NetFT(port=port, scale=Scale(1.0, 1.0))


def test_a_closed_force_sensor_reads_nothing():
    ft = NetFT(scale=Scale(1.0, 1.0))
    ft.close()

    assert ft.read() is None
    assert list(ft.stream()) == []

    ft.close()


@pytest.mark.slow
@pytest.mark.parametrize("buffered", [False, True])
def test_every_force_record_comes_in_newtons(buffered):
    settings = RdtSettings(wrench=WRENCH, scale=(500_000.0, 2e6))
    with Emulator(emulate_rdt, settings) as box:
        ft = NetFT(port=box.ready["port"], scale=box.ready["page"], buffered=buffered)
        with ft:
            assert ft.scale == (500_000.0, 2e6)
            wrenches = []
            end_s = time.monotonic() + PATIENCE_S
            stream = ft.stream()
            for wrench in stream:
                wrenches.append(wrench)
                if len(wrenches) == 3000:
                    time.sleep(0.06)  # more records than fit by default
                if len(wrenches) > 6000 or time.monotonic() > end_s:
                    break

            ft.bias()
            zero = wrenches[-1]
            assert np.allclose(
                next(stream), WRENCH[len(wrenches) % 5000] - zero, atol=3e-6
            )
            ft.unbias()

    assert ft.report.missed == 0
    assert len(wrenches) > 6000
    assert np.allclose(wrenches, WRENCH[np.arange(len(wrenches)) % 5000], atol=2e-6)


@pytest.mark.slow
def test_lost_force_records_are_counted():
    faults = WireFaults(lost=0.01, truncated=0.01, repeated=0.01, garbage=0.1)
    max_N = np.abs(WRENCH).max() + 1e-6
    wrenches = []
    with (
        Emulator(emulate_rdt, RdtSettings(wrench=WRENCH, faults=faults)) as box,
        NetFT(port=box.ready["port"], scale=Scale(1e6, 1e6)) as ft,
    ):
        end_s = time.monotonic() + PATIENCE_S
        while ft.report.used <= 5000 and time.monotonic() < end_s:
            time.sleep(1e-3)
            wrenches.append(ft.read())

    report = ft.report

    assert all(
        np.abs(wrench).max() <= max_N for wrench in wrenches if wrench is not None
    )
    assert report.used > 5000
    assert report.missed == pytest.approx(0.02 * (report.used + report.missed), rel=0.5)
    assert report.malformed > 20
    assert report.stale > 20


def test_a_page_that_breaks_off_names_no_counts(monkeypatch):
    def broken(url, timeout):
        raise IncompleteRead(b"<netft>")

    monkeypatch.setattr(rdt, "urlopen", broken)

    with pytest.raises(LinkError, match="no counts per newton"):
        rdt.read_scale("http://127.0.0.1/")


def drip(connections):
    """Answer with the beginning of a page, then with a byte every 50 ms."""
    connection, _ = connections.accept()
    with suppress(OSError):
        connection.sendall(b"HTTP/1.0 200 OK\r\nX: ")
        for _ in range(200):
            connection.sendall(b"x")
            time.sleep(0.05)


def test_a_page_that_comes_byte_by_byte_is_not_waited_for():
    with socket.create_server((LOOPBACK, 0)) as connections:
        port = connections.getsockname()[1]
        threading.Thread(target=drip, args=(connections,), daemon=True).start()
        begin_s = time.monotonic()
        with pytest.raises(LinkError, match=r"no whole answer within 0\.3 s"):
            rdt.read_scale(f"http://{LOOPBACK}:{port}/", timeout_s=0.3)

        assert time.monotonic() - begin_s < 3.0  # 10 s of bytes


def test_a_name_that_nobody_looks_up_is_not_waited_for(monkeypatch):
    def wait(host):
        time.sleep(5.0)

    monkeypatch.setattr(socket, "gethostbyname", wait)
    monkeypatch.setattr(datagram_link, "MAX_LOOK_UP_S", 0.1)
    with pytest.raises(LinkError, match=r"no whole answer within 0\.1 s"):
        NetFT("sensor.example", scale=Scale(1.0, 1.0))


@pytest.mark.parametrize(
    ("force", "torque", "why"),
    [
        ("N", "N-m", None),
        ("", "Nm", "counts per '' under <scalfu>, expected N"),
        (
            "lbf",
            "lbf-in",
            "(?s)counts per 'lbf' under <scalfu>, expected N.*Set the sensor to N",
        ),
        ("N", "N-mm", "counts per 'N-mm' under <scaltu>, expected Nm"),
    ],
)
def test_counts_per_other_units_are_refused(force, torque, why, monkeypatch):
    page = f"<netft><scalfu>{force}</scalfu><scaltu>{torque}</scaltu>"
    page += "<calcpf>1000</calcpf><calcpt>2000</calcpt></netft>"
    monkeypatch.setattr(rdt, "urlopen", lambda *_, **__: io.BytesIO(page.encode()))
    if why is None:
        assert rdt.read_scale("http://127.0.0.1/") == (1000.0, 2000.0)
        return

    with pytest.raises(LinkError, match=why):
        rdt.read_scale("http://127.0.0.1/")


def test_a_faulty_force_sensor_gives_no_force():
    record = np.zeros(1, rdt.RECORD)
    with socket.socket(type=socket.SOCK_DGRAM) as box:
        box.bind((LOOPBACK, 0))
        with NetFT("127.1", box.getsockname()[1], scale=Scale(1e6, 1e6)) as ft:
            _, asked_from = box.recvfrom(64)
            for count, status in enumerate((0, 1 << 31, 0)):
                record["count"] = count
                record["status"] = status
                box.sendto(record.tobytes(), asked_from)

            time.sleep(0.05)
            assert ft.read() is not None
            assert (ft.report.used, ft.report.malformed) == (2, 1)


def received(*datagrams):
    """What a sensor's link has counted of datagrams with records of these counts."""
    with socket.socket(type=socket.SOCK_DGRAM) as box:
        box.bind((LOOPBACK, 0))
        with NetFT(port=box.getsockname()[1], scale=Scale(1.0, 1.0)) as ft:
            _, asked_from = box.recvfrom(64)
            for counts in datagrams:
                for first in range(0, len(counts), 40):
                    some = counts[first : first + 40]
                    records = np.zeros(len(some), rdt.RECORD)
                    records["count"] = some
                    box.sendto(records.tobytes(), asked_from)

            time.sleep(0.05)
            # A reading takes what waits for a limited time.
            wrenches = [ft.read() for _ in range(20)]
            assert any(wrench is not None for wrench in wrenches)
            return ft.report


@pytest.mark.parametrize(("first", "anew"), [(5, 10_000_000), (5_000_000, 0)])
def test_a_restarted_count_needs_many_records_in_sequence(first, anew):
    odd = [anew]
    again = range(anew, anew + 800)
    report = received(
        range(first, first + 50), odd, range(first + 50, first + 52), again
    )
    stale = 1 + rdt.MIN_RENUMBERED_RECORDS + 1

    assert (report.used, report.stale, report.missed) == (853 - stale, stale, 0)


def test_repeated_and_late_buffered_datagrams_are_unused():
    first, second, third, fourth = (range(k, k + 40) for k in (0, 40, 80, 120))

    assert received(first, second, second, third).used == 120

    late = received(first, third, second, fourth)

    assert (late.used, late.stale, late.missed) == (120, 40, 40)


@pytest.mark.slow
def test_a_haptic_device_moves_and_is_felt():
    pytest.importorskip("websockets")
    from needleforce.devices import HaplyMaster
    from needleforce.devices.emulators import emulate_haply

    wish = np.zeros((1000, 3))
    wish[:, 2] = 0.02
    wish[0] = 0.0
    with Emulator(emulate_haply, wish) as service:
        with HaplyMaster(service.ready["address"], max_force_N=2.0) as master:
            places = []
            end_s = time.monotonic() + PATIENCE_S
            while len(places) <= 1000 and time.monotonic() < end_s:
                if (sample := master.read()) is not None:
                    places.append(sample.position_m[2])
                    master.render([0.0, 0.0, -100.0])  # shortened to 2 N
                else:
                    time.sleep(2e-4)

        counts = service.stop()

    assert len(places) > 1000
    # A hand of 300 N/m at 20 mm against 2 N; it swings at 2 Hz.
    assert np.mean(places[-480:]) == pytest.approx(0.02 - 2.0 / 300.0, abs=2e-3)
    assert counts["port_energy_J"] > 0.0


def test_malformed_haptic_states_are_counted():
    server = pytest.importorskip("websockets.sync.server")
    from needleforce.devices import HaplyMaster

    place = {"x": 0, "y": 0, "z": 1}
    state = {"cursor_position": place, "cursor_velocity": place}
    good = {"inverse3": [{"device_id": "a", "state": state}]}
    grip = {"wireless_verse_grip": [{"state": {"buttons": {"a": False}}}]}
    bad = [
        "{",
        "[]",
        "{}",
        '{"inverse3": []}',
        "[" * 100_000,
        json.dumps(good).replace('"z": 1', f'"z": 1{"0" * 400}'),
        json.dumps({"inverse3": [{"state": {}}]}),
    ]

    def talk(link):
        for text in (*bad, json.dumps(good | grip)):
            link.send(text)

        time.sleep(0.2)

    with server.serve(talk, LOOPBACK, 0) as service:
        threading.Thread(target=service.serve_forever, daemon=True).start()
        with HaplyMaster(
            f"ws://{LOOPBACK}:{service.socket.getsockname()[1]}"
        ) as master:
            sample = None
            end_s = time.monotonic() + PATIENCE_S
            while sample is None and time.monotonic() < end_s:
                time.sleep(0.01)
                sample = master.read()

        service.shutdown()

    assert sample is not None
    assert not sample.clutch
    assert sample.position_m.tolist() == [0.0, 0.0, 1.0]
    assert master.report.malformed == len(bad)
    with pytest.raises(LinkError, match="no haptic service"):
        HaplyMaster("ws://127.0.0.1:9")


@pytest.mark.parametrize("reads", [True, False])
def test_a_haptic_service_that_takes_no_leave_is_left(reads):
    """It answers no close, and perhaps reads nothing at all."""
    server = pytest.importorskip("websockets.server")
    from needleforce.devices import HaplyMaster

    place = {"x": 0, "y": 0, "z": 1}
    state = {"cursor_position": place, "cursor_velocity": place}
    text = json.dumps({"inverse3": [{"device_id": "a", "state": state}]})
    is_over = threading.Event()

    def serve(connections):
        connection, _ = connections.accept()
        protocol = server.ServerProtocol()
        protocol.receive_data(connection.recv(4096))
        (request,) = protocol.events_received()
        protocol.send_response(protocol.accept(request))
        protocol.send_text(text.encode())
        for data in protocol.data_to_send():
            connection.sendall(data)

        connection.settimeout(0.05)
        while not is_over.is_set():
            with suppress(TimeoutError):
                if not reads or not connection.recv(1 << 16):
                    is_over.wait(0.05)

        connection.close()

    with socket.create_server((LOOPBACK, 0)) as connections:
        thread = threading.Thread(target=serve, args=(connections,), daemon=True)
        thread.start()
        address = f"ws://{LOOPBACK}:{connections.getsockname()[1]}"
        with HaplyMaster(address) as master:
            end_s = time.monotonic() + PATIENCE_S
            while master.read() is None and time.monotonic() < end_s:
                time.sleep(0.01)

            if not reads:
                master._device_id = "a" * 10_000_000  # more than the kernel keeps

            begin_s = time.monotonic()

        assert time.monotonic() - begin_s < 1.0
        is_over.set()
        thread.join()


def test_recorded_signals_come_in_real_time():
    arm = ReplayArm(np.full(100, 1e-3), ROWS, None, ROWS)
    begin_s = time.monotonic()

    assert len(list(pace(arm))) == 100
    assert time.monotonic() - begin_s > 0.09
    assert not arm.send(np.zeros(7))
