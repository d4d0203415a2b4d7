"""The decorator of functions that every tick calls."""

from collections.abc import Callable
from typing import Any, TypeVar

numba: Any
try:
    import numba
except ImportError:
    numba = None

F = TypeVar("F", bound=Callable[..., Any])

COMPILER = "" if numba is None or numba.config.DISABLE_JIT else f"numba {numba.__version__}"
"""What compiles, with its version; empty where functions run as plain Python."""


def compiled(function: F) -> F:
    """Compile a pure function at its first call, if numba is there; the result is kept on disk.

    Such a function takes and returns floats, arrays of float64 and tuples of them, raises nothing,
    and uses functions and constants of its own file only: what is kept on disk does not notice
    a change in another. Who owns it calls it once when constructed (a second at the first time
    ever, a few milliseconds later), so that no tick waits for a compiler.

    Args:
        function: Numeric expressions that numpy runs nearly as fast without a compiler.

    Returns:
        The compiled function, or the same one where nothing compiles.
    """
    if not COMPILER:
        return function
    try:
        return numba.njit(cache=True)(function)
    except RuntimeError:  # no folder in which the result could be kept
        return numba.njit(function)
