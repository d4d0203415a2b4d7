"""The errors of this package, and the import of vendors' client libraries."""

from importlib import import_module
from typing import Any

from foundation.errors import NeedleforceError


class DeviceError(NeedleforceError):
    """Base of all errors of this package; the others are standard exceptions, too."""


class DeviceSettingError(DeviceError, ValueError):
    """An address, a rate or a scale that cannot work."""


class LinkError(DeviceError, ConnectionError):
    """A device that cannot be reached, does not answer or has stayed away too long."""

    usual_advice = (
        "Check that it runs, that its address is right, and that it sends to "
        "this machine."
    )


class MissingClientError(DeviceError, ImportError):
    """The vendor's client library is not installed; the message names it."""

    usual_advice = "Install it: pip install 'needleforce[devices]'."


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
