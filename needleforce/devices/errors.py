"""The errors of this package, and the import of vendors' client libraries."""

from importlib import import_module
from typing import Any

from foundation.errors import CodedError, ErrorCode
from foundation.extras import install_command


class DeviceCode(ErrorCode):
    """Kinds of errors of arms, force sensors and haptic devices."""

    SETTING = (
        "NF-DEVICE-SETTING",
        "An address, a rate, a scale or a time of a device cannot work.",
        "Give what the message expects.",
    )
    LINK = (
        "NF-DEVICE-LINK",
        "The device cannot be reached, does not answer or has stayed away too long.",
        "Check that it runs, that its address is right, and that it sends to this "
        "machine.",
    )
    PORT = (
        "NF-DEVICE-PORT",
        "The port cannot be listened on.",
        "End the other program that uses the port, or give an address of this machine.",
    )
    UNITS = (
        "NF-DEVICE-UNITS",
        "The force sensor counts in other units than newtons and newton metres.",
        "Set the sensor to N and Nm, or give its `scale`: `Scale(per_N, per_Nm)`.",
    )
    VERSION = (
        "NF-DEVICE-VERSION",
        "The arm and the client library speak different versions of their interface.",
        "Use the library or the system that the message names.",
    )
    STOPPED = (
        "NF-DEVICE-STOPPED",
        "The arm has stopped by itself while it was commanded, as with a reflex.",
        "Release it at its own panel, see to the cause that the message names, and "
        "open the connection again.",
    )
    CLIENT = (
        "NF-DEVICE-CLIENT",
        "The vendor's client library is not installed.",
        f"Install it: {install_command('devices')}.",
    )


class DeviceError(CodedError):
    """Base of all errors of this package; the others are standard exceptions, too."""

    usual_code = DeviceCode.SETTING


class DeviceSettingError(DeviceError, ValueError):
    """An address, a rate or a scale that cannot work."""


class LinkError(DeviceError, ConnectionError):
    """A device that cannot be reached, does not answer or has stayed away too long."""

    usual_code = DeviceCode.LINK


class MissingClientError(DeviceError, ImportError):
    """The vendor's client library is not installed; the message names it."""

    usual_code = DeviceCode.CLIENT


def import_client(module: str, package: str) -> Any:
    """Import a module of a vendor's library.

    Args:
        module: Its dotted name.
        package: That has it, as it is installed.

    Raises:
        MissingClientError: It is not installed.
    """
    try:
        return import_module(module)
    except ImportError as error:
        raise MissingClientError(f"{package} is not installed") from error
