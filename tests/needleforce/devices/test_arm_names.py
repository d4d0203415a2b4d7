"""Arms by a name of one line."""

import pytest

from needleforce.devices import (
    DeviceSettingError,
    FriArm,
    IiwaArm,
    LinkError,
    connect_arm,
)


@pytest.mark.parametrize(
    ("name", "arm_type", "host", "port"),
    [
        ("fri", FriArm, "127.0.0.1", 49938),
        ("iiwa", IiwaArm, "127.0.0.1", 30200),
        ("fri:30201", FriArm, "127.0.0.1", 30201),
        ("fri:127.0.0.2", FriArm, "127.0.0.2", 49938),
        ("fri:127.0.0.2:30202", FriArm, "127.0.0.2", 30202),
        ("iiwa:127.0.0.1:30203@127.0.0.3", IiwaArm, "127.0.0.1", 30203),
        ("fri@127.0.0.2", FriArm, "127.0.0.1", 49938),
        ("fri:30204@127.0.0.3", FriArm, "127.0.0.1", 30204),
    ],
)
def test_a_listening_arm_has_address_port_and_controller(name, arm_type, host, port):
    with connect_arm(name) as arm:
        assert type(arm) is arm_type
        assert arm.address == (host, port)
        assert arm.is_peer_named is ("@" in name)


@pytest.mark.parametrize(
    ("name", "error", "word"),
    [
        ("fri:pc.example:", DeviceSettingError, "pc.example:"),
        ("fri:pc.example:70000", DeviceSettingError, "70000"),
        ("fri:pc.example:port", DeviceSettingError, "example:port"),
        ("fri:pc.example@", DeviceSettingError, "@"),
        ("fri@kuka.example", DeviceSettingError, "127.0.0.1"),
        ("fri:30200@kuka.example", DeviceSettingError, "kuka.example"),
        ("ur", DeviceSettingError, "ur"),
        ("franka:", DeviceSettingError, "franka:"),
        ("nao:pc.example", DeviceSettingError, "nao:pc.example"),
        ("", DeviceSettingError, "fri"),
        ("fri:no-such-host.invalid", LinkError, "no-such-host.invalid"),
        ("fri:127.0.0.2:30205@no-such-host.invalid", LinkError, "no-such-host"),
    ],
)
def test_a_name_that_cannot_be_is_refused(name, error, word):
    with pytest.raises(error, match=word):
        connect_arm(name)
