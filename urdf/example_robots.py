"""Where to find the arms of the optional data package ``example-robot-data``."""

import sys
from importlib import metadata
from pathlib import Path

from urdf.errors import MissingPackageError, UnknownNameError

_ROBOTS = {
    "panda": "panda_description/urdf/panda.urdf",
    "ur3": "ur_description/urdf/ur3_robot.urdf",
    "ur5": "ur_description/urdf/ur5_robot.urdf",
    "ur10": "ur_description/urdf/ur10_robot.urdf",
}
_PACKAGE = "example-robot-data"


def example_robot_path(name: str) -> Path:
    """Return the URDF file of an arm of ``example-robot-data``, for `urdf.load_urdf`.

    Panda needs ``tool_frame`` (such as ``panda_hand_tcp``) and its two finger joints locked; the UR
    arms need ``tool_frame`` (``tool0``).

    Args:
        name: One of panda, ur3, ur5, ur10.

    Raises:
        UnknownNameError: Another name.
        MissingPackageError: The package is not installed.
    """
    if name not in _ROBOTS:
        raise UnknownNameError(f"there is no example robot {name!r}; robots: {', '.join(_ROBOTS)}")
    for prefix in _prefixes():
        path = prefix / "share" / _PACKAGE / "robots" / _ROBOTS[name]
        if path.is_file():
            return path
    raise MissingPackageError(
        f"the description of {name!r} comes with {_PACKAGE}, which is not installed; "
        f"install it with: pip install {_PACKAGE}"
    )


def _prefixes() -> list[Path]:
    """Return where pip (a cmeel wheel) and conda put shared data."""
    prefixes = [Path(sys.prefix)]
    try:
        located = metadata.distribution(_PACKAGE).locate_file("cmeel.prefix")
    except metadata.PackageNotFoundError:
        return prefixes
    return [Path(str(located)), *prefixes]
