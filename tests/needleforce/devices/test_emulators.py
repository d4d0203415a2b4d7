"""Emulators that run for long or end by themselves, and links that end or fall
silent."""

import json
import multiprocessing
from types import SimpleNamespace

import numpy as np
import pytest

from needleforce.devices import (
    DeviceSettingError,
    FriArm,
    ReplayArm,
    UrArm,
    haply,
)
from needleforce.devices.emulators import (
    Emulator,
    FriSettings,
    emulate_fri,
    process,
)

ROWS = np.zeros((1, 7))


def controller(cycles):
    return Emulator(
        emulate_fri, FriSettings(port=9, q_rad=ROWS, tau_Nm=ROWS, cycles=cycles)
    )


@pytest.mark.slow
def test_an_emulator_may_end_slower_than_it_starts(monkeypatch):
    with controller(1500) as emulator:
        monkeypatch.setattr(process, "START_S", 0.1)
        assert emulator.counts()["cycles"] == 1500


@pytest.mark.slow
def test_stopping_an_ended_emulator_returns_its_counts():
    with controller(10) as emulator:
        for process in multiprocessing.active_children():
            process.join()

        assert emulator.stop()["cycles"] == 10


def test_recorded_samples_end_when_the_arm_is_closed():
    with ReplayArm(np.full(9, 1e-3), np.zeros((9, 7)), None, np.zeros((9, 7))) as arm:
        samples = iter(arm)
        next(samples)

    assert (list(samples), arm.report.used) == ([], 1)


@pytest.mark.parametrize(
    ("arm", "settings", "why"),
    [
        (
            FriArm,
            {"port": 0, "wait_s": np.inf, "give_up_s": np.inf},
            "wait_s=inf, give_up_s=inf",
        ),
        (FriArm, {"port": 0, "wait_s": 1e10, "give_up_s": 1e11}, "at most 3600 s"),
        (UrArm, {"rate_hz": 0.0}, "rate_hz=0.0: expected a positive number"),
        (UrArm, {"rate_hz": np.nan}, "rate_hz=nan"),
    ],
)
def test_times_and_rates_that_cannot_be_are_refused(arm, settings, why):
    with pytest.raises(DeviceSettingError, match=why):
        arm(**settings)


class Gone(Exception):
    """What a websocket raises that has been closed."""


@pytest.mark.parametrize("silence", [TimeoutError, Gone])
def test_haptic_silence_is_one_outage(silence, monkeypatch):
    place = {"x": 0, "y": 0, "z": 1}
    device = {
        "device_id": "a",
        "state": {"cursor_position": place, "cursor_velocity": place},
    }
    now_s = 0.0
    waiting = []
    sent = []

    def recv(timeout):
        if waiting:
            return waiting.pop()

        raise silence

    box = SimpleNamespace(setsockopt=lambda *_: None)
    link = SimpleNamespace(recv=recv, send=sent.append, close=lambda: None, socket=box)
    library = SimpleNamespace(WebSocketException=Gone, connect=lambda *_, **__: link)
    monkeypatch.setattr(haply, "import_client", lambda *_: library)
    monkeypatch.setattr(haply.time, "monotonic", lambda: now_s)
    with haply.HaplyMaster() as master:
        for cycle in range(6001):
            now_s = 1e-3 * cycle
            if cycle % 10 == 0 and not (1000 < cycle < 3000 or 4000 < cycle < 4500):
                waiting.append(json.dumps({"inverse3": [device]}))

            master.read()

    report = master.report

    assert (report.outages, report.longest_gap_s) == (2, pytest.approx(2.0))
    assert len(sent) > report.used + 20  # asked again every 0.1 s
