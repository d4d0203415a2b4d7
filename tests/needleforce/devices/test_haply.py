"""A haptic device through its local service, which the tests play."""

import json
import threading
import time
from contextlib import contextmanager, suppress

import numpy as np
import pytest

from needleforce.devices import DeviceSettingError, HaplyMaster, LinkError

server = pytest.importorskip("websockets.sync.server")
ConnectionClosed = pytest.importorskip("websockets.exceptions").ConnectionClosed

PATIENCE_S = 20.0
PLACE = {"x": 0, "y": 0, "z": 1}
STATE = {"cursor_position": PLACE, "cursor_velocity": {"x": 2, "y": 0, "z": 0}}
GOOD = {"inverse3": [{"device_id": "a", "state": STATE}]}


@contextmanager
def service(talk):
    """A service that talks to whoever connects; its address."""
    with server.serve(talk, "127.0.0.1", 0) as serving:
        threading.Thread(target=serving.serve_forever, daemon=True).start()
        yield f"ws://127.0.0.1:{serving.socket.getsockname()[1]}"
        serving.shutdown()


def read_one(master):
    end_s = time.monotonic() + PATIENCE_S
    while (reading := master.read()) is None and time.monotonic() < end_s:
        time.sleep(1e-3)
    return reading


@pytest.mark.parametrize(
    ("force_N", "felt_N"),
    [
        ([0.0, 0.0, -100.0], [0.0, 0.0, -2.0]),  # shortened
        ([0.5, 0.0, 1.0], [0.5, 0.0, 1.0]),
        ([np.nan, 0.0, 0.0], [0.0] * 3),
        ([1.0, 1.0], [0.0] * 3),
    ],
)
def test_a_haptic_device_moves_and_is_felt(force_N, felt_N):
    felt = []

    def talk(link):
        link.send(json.dumps(GOOD))
        for text in link:
            felt.append(json.loads(text))
            with suppress(ConnectionClosed):
                link.send(json.dumps(GOOD))

    def force_of(message):
        (device,) = message["inverse3"]
        assert device["device_id"] == "a"
        values = device["commands"]["set_cursor_force"]["values"]
        return [values[axis] for axis in "xyz"]

    with service(talk) as address:
        with HaplyMaster(address, max_force_N=2.0) as master:
            reading = read_one(master)
            assert reading.position_m.tolist() == [0.0, 0.0, 1.0]
            assert reading.velocity_m_s.tolist() == [2.0, 0.0, 0.0]
            assert reading.clutch
            master.render(force_N)
            while len(felt) < 2:
                read_one(master)
        end_s = time.monotonic() + 5.0
        while any(force_of(felt[-1])) and time.monotonic() < end_s:
            time.sleep(0.01)

    assert force_of(felt[1]) == felt_N
    assert not any(force_of(felt[-1]))  # at the end


def test_malformed_states_are_counted():
    grip = {"wireless_verse_grip": [{"state": {"buttons": {"a": False}}}]}
    bad = [
        "{",
        "[]",
        "{}",
        '{"inverse3": []}',
        "[" * 100_000,
        json.dumps(GOOD).replace('"z": 1', f'"z": 1{"0" * 400}'),
        json.dumps(GOOD).replace('"z": 1', '"z": NaN'),
        json.dumps({"inverse3": [{"state": {}}]}),
    ]

    def talk(link):
        for text in (*bad, json.dumps(GOOD | grip)):
            link.send(text)
        time.sleep(0.2)

    with service(talk) as address, HaplyMaster(address) as master:
        reading = read_one(master)

    assert not reading.clutch
    assert master.report.malformed == len(bad)


def test_silence_is_one_outage_and_asks_again():
    asked = []

    def talk(link):
        link.send(json.dumps(GOOD))
        asked.extend(text for text, _ in zip(link, range(5), strict=False))
        link.send(json.dumps(GOOD))
        time.sleep(0.2)

    with service(talk) as address, HaplyMaster(address) as master:
        read_one(master)
        assert master.silent_s == 0.0
        read_one(master)

    assert len(asked) == 5  # every 0.1 s
    assert master.report.outages == 1
    assert 0.3 < master.report.longest_gap_s < PATIENCE_S


def test_an_absent_service_and_no_force_are_refused():
    with pytest.raises(LinkError, match="9"):
        HaplyMaster("ws://127.0.0.1:9")
    with pytest.raises(DeviceSettingError, match="max_force_N"):
        HaplyMaster(max_force_N=0.0)
