"""Which client library speaks with which Franka arm, and what the arm itself says.

libfranka and an arm's system image speak with each other in one version of the
interface only; where they differ, the library names no version, or only in part.
"""

from typing import NamedTuple

from needleforce.devices.franka_wire import read_server_version

FER_LIBRARY_VERSION = 5
"""Of the interface, in panda-python 1.1 (libfranka 0.9)."""

FR3_LIBRARY_VERSION = 10
"""Of the interface, in pylibfranka 0.20 and 0.21."""

SYSTEM_OF_VERSION = {
    3: "FER, system 3",
    4: "FER, system 4.0",
    5: "FER, system 4.2",
    6: "FR3, system 5.2",
    7: "FR3, system 5.5",
    8: "FR3, system 5.7.0",
    9: "FR3, system 5.7.2",
    10: "FR3, system 5.9",
}
"""Arms that speak a version, with the first system image that does."""

OLDEST_FR3_VERSION = 6
"""Arms of a lower version are FER."""


class Library(NamedTuple):
    """A client library for Franka arms.

    Attributes:
        package: Its name on the package index, with its version.
        version: Of the interface that it speaks.
        kind: How an arm of that version is named.
    """

    package: str
    version: int
    kind: str


FER_LIBRARY = Library("panda-python 1.1", FER_LIBRARY_VERSION, "franka")
FR3_LIBRARY = Library("pylibfranka 0.21", FR3_LIBRARY_VERSION, "fr3")


def describe_mismatch(host: str, library: Library) -> str:
    """Return in words why an arm and a library do not fit; empty where they do.

    Args:
        host: Address of the arm, which is asked.
        library: With which it could not be connected to.
    """
    version = read_server_version(host)
    if version is None or version == library.version:
        return ""

    system = SYSTEM_OF_VERSION.get(version, "a system unknown here")
    text = (
        f"the arm speaks version {version} of Franka's interface ({system}), "
        f"{library.package} version {library.version}"
    )
    other = FER_LIBRARY if library is FR3_LIBRARY else FR3_LIBRARY
    if version == other.version:
        return f"{text}; {other.kind}:{host} uses {other.package}, which fits"
    if version >= OLDEST_FR3_VERSION:
        return (
            f"{text}; update the arm's system to one of version {FR3_LIBRARY.version}, "
            f"or install the pylibfranka built for version {version}"
        )

    return f"{text}; update the arm's system to 4.2, which {FER_LIBRARY.package} fits"
