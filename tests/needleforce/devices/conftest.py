"""A controller's socket."""

import socket

import pytest


@pytest.fixture
def box():
    """A controller's socket."""
    with socket.socket(type=socket.SOCK_DGRAM) as box:
        box.settimeout(10.0)
        yield box
