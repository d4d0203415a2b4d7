"""Refuse to start where a file of the user hides a package of this project.

Python imports the first match on its path, and there the folder of a script, or the
current one, comes first: a script or a folder of data named ``residual`` or ``urdf``
would be imported in place of ours.
"""

import os
import sys
from importlib.util import find_spec

PACKAGES = ("foundation", "urdf", "residual", "identification", "groundtruth")
"""The packages that this one imports, and that lie beside it."""

_BESIDE = os.path.dirname(os.path.dirname(os.path.abspath(__file__)))
"""Folder in which they lie."""

USAGE = 2
"""Exit code of a command after one line that says what is wrong."""


def refuse_hidden_packages() -> None:
    """Raise `ImportError` where a package of ours would not be the one imported.

    The command `needleforce` ends with one line instead.

    Raises:
        ImportError: The message names what hides it, and the cure.
    """
    for name in PACKAGES:
        place = _hiding_place(name)
        if place is None:
            continue
        message = (
            f"{place} hides the package {name!r} of needleforce. Rename it, or "
            "work in another folder"
        )
        if _is_command():
            sys.stderr.write(f"error: {message}\n")
            raise SystemExit(USAGE)
        raise ImportError(message, name=name, path=place)


def _hiding_place(name: str) -> str | None:
    """Return the file or folder that is imported in place of our package, if any."""
    ours = os.path.join(_BESIDE, name, "__init__.py")
    if not os.path.isfile(ours):  # imported from an archive
        return None
    try:
        spec = find_spec(name)
    except ValueError:  # something without a spec was put into `sys.modules`
        return getattr(sys.modules[name], "__file__", None)
    if spec is None:
        return None
    if spec.origin is None:  # a folder without `__init__.py`
        return next(iter(spec.submodule_search_locations or ()), None)
    if os.path.realpath(spec.origin) == os.path.realpath(ours):
        return None
    is_package = spec.submodule_search_locations is not None
    return os.path.dirname(spec.origin) if is_package else spec.origin


def _is_command() -> bool:
    """Whether this process is `needleforce` or ``python -m needleforce``."""
    started = sys.argv[0] if sys.argv else ""
    # So it is named while Python looks for the module to run.
    if started == "-m":
        return "needleforce" in sys.orig_argv
    return os.path.splitext(os.path.basename(started))[0] == "needleforce"
