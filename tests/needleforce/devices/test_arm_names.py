"""Arms by a name of one line, and who is listened to."""

import socket
import threading
import time

import pytest

from needleforce.cli import main
from needleforce.devices import DeviceSettingError, FriArm, connect_arm, parse_arm_name
from needleforce.devices.arm_names import parse_listening_address
from tests.needleforce.devices.test_links import measurement

TWO_HOSTS = ("127.0.0.2", "127.0.0.3")


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", ("127.0.0.1", None, None)),
        ("30200", ("127.0.0.1", 30200, None)),
        ("pc.example", ("pc.example", None, None)),
        ("pc.example:30200", ("pc.example", 30200, None)),
        ("pc.example:30200@kuka.example", ("pc.example", 30200, "kuka.example")),
        ("pc.example@kuka.example", ("pc.example", None, "kuka.example")),
        ("@127.0.0.2", ("127.0.0.1", None, "127.0.0.2")),
        ("0@127.0.0.3", ("127.0.0.1", 0, "127.0.0.3")),
    ],
)
def test_a_listening_address_has_host_port_and_controller(text, expected):
    assert parse_listening_address(text) == expected


@pytest.mark.parametrize(
    ("name", "why"),
    [
        ("fri:pc.example:", "expected a port from 0 to 65535"),
        ("fri:pc.example:70000", "expected a port from 0 to 65535"),
        ("fri:pc.example:port", "got 'port'"),
        ("fri:pc.example@", "expected the controller's address after @"),
        (
            "fri@kuka.example",
            "cannot send to 127.0.0.1; name the address of this machine",
        ),
        ("fri:30200@kuka.example", r"LOCAL_ADDRESS@kuka.example"),
        ("ur", "expected an arm as fri"),
        ("franka:", "expected an arm as fri"),
        ("nao:pc.example", "expected an arm as fri"),
    ],
)
def test_a_name_that_cannot_be_is_refused(name, why):
    with pytest.raises(DeviceSettingError, match=why):
        connect_arm(name)


def test_a_name_is_kind_and_address():
    assert parse_arm_name("fri@127.0.0.2") == ("fri", "@127.0.0.2")
    assert parse_arm_name("ur:arm.example") == ("ur", "arm.example")


def send_from(host, counts, arm):
    with socket.socket(type=socket.SOCK_DGRAM) as box:
        box.bind((host, 0))
        for count in counts:
            box.sendto(measurement(count=count), arm.address)


@pytest.mark.slow
def test_the_first_controller_is_kept_after_an_outage():
    first, second = TWO_HOSTS
    arm = FriArm("0.0.0.0", 0, wait_s=0.05, give_up_s=0.5)
    address = ("127.0.0.1", arm.address[1])
    arm.address = address
    with arm:
        send_from(first, [1, 2], arm)
        readings = iter(arm)
        next(readings)
        next(readings)

        assert arm.peer[0] == first
        assert not arm.is_peer_named

        send_from(second, [3], arm)
        assert next(readings, None) is None  # another host counts as silence
        assert arm.report.outages == 1
        assert arm.report.foreign == 0  # the kernel drops it

        send_from(first, [4], arm)  # the same host, on another port

        assert next(iter(arm)).missed > 0


@pytest.mark.slow
def test_an_address_of_this_machine_is_listened_on(capsys, tmp_path):
    path = tmp_path / "x.csv"
    host, peer = TWO_HOSTS
    with FriArm(host, 0) as arm:
        port = arm.address[1]

    with socket.socket(type=socket.SOCK_DGRAM) as box:
        box.bind((peer, 0))
        is_over = threading.Event()

        def talk():
            count = 0
            while not is_over.is_set():
                count += 1
                box.sendto(measurement(count=count % 65536), (host, port))
                time.sleep(1e-3)

        talking = threading.Thread(target=talk)
        talking.start()
        try:
            code = main(
                ["record", f"fri:{host}:{port}", "-o", str(path), "--seconds", "0.2"]
            )
        finally:
            is_over.set()
            talking.join()

    said = capsys.readouterr().err

    assert code == 0
    assert f"{peer}, port " in said
    assert f"was the first to send; only {peer} is listened to" in said
    assert path.exists()


@pytest.mark.slow
def test_silence_on_loopback_says_who_can_reach_it(monkeypatch, capsys, tmp_path):
    def impatient(**settings):
        return FriArm(**settings, give_up_s=0.2)

    monkeypatch.setattr("needleforce.devices.arm_names.FriArm", impatient)

    assert main(["record", "fri:0", "-o", str(tmp_path / "x.csv")]) == 2

    said = capsys.readouterr().err

    assert "it listened on 127.0.0.1, port " in said
    assert "which only programs of this machine reach" in said
    assert "fri:LOCAL_ADDRESS:" in said
