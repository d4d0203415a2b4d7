"""The decorator of functions that every tick calls."""

from collections.abc import Callable
from inspect import signature
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

import numpy as np
from numpy.typing import NDArray

numba: Any
try:
    import numba
except ImportError:
    numba = None

Vector = Annotated[NDArray[np.float64], 1]  # Array of shape (n,), contiguous
Matrix = Annotated[NDArray[np.float64], 2]  # Array of shape (m, n), contiguous in rows
Blocks = Annotated[NDArray[np.float64], 3]  # Array of shape (k, m, n), contiguous
WrittenVector = Annotated[NDArray[np.float64], 1, "written"]
WrittenMatrix = Annotated[NDArray[np.float64], 2, "written"]
WrittenBlocks = Annotated[NDArray[np.float64], 3, "written"]
"""The same, and of shape (k, m, n), for results: the function writes into them."""
Function = TypeVar("Function", bound=Callable[..., Any])

COMPILER = (
    "" if numba is None or numba.config.DISABLE_JIT else f"numba {numba.__version__}"
)
"""What compiles, with its version; empty where functions run as plain Python."""


def compiled(function: Function) -> Function:
    """Compile a pure function, if numba is there.

    It takes and returns numbers, truth values, arrays and tuples of them, raises
    nothing, and uses functions and constants of its own file and `dot` only. It is
    compiled once ever, in about a second, and kept on disk beside the file; what is
    kept would not notice a change in another one.

    That happens when its module is imported, where every parameter is annotated as
    `float`, `int`, `bool`, one of the arrays above or a tuple of a fixed number of
    them; what it calls then stands above it. Where one is not (``Any``, ``tuple[float,
    ...]``), whoever calls it in a tick calls it once when constructed, with the same
    types. No tick waits for a compiler.

    Where nothing compiles the function itself is returned: give it numeric expressions
    that numpy runs nearly as fast, and loops only if its caller has another way where
    `COMPILER` is empty.
    """
    if not COMPILER:
        return function
    hints = get_type_hints(function, include_extras=True)
    types = [_numba_type(hints.get(name)) for name in signature(function).parameters]
    early = () if None in types else (tuple(types),)
    try:
        return numba.njit(*early, cache=True)(function)
    except (
        Exception
    ):  # no folder in which the result could be kept, or a damaged file in it
        return numba.njit(*early)(function)


def compiled_or(plain: Callable[..., Any]) -> Callable[[Function], Function]:
    """As `compiled`, with another way where nothing compiles.

    Compiled, loops over single numbers run four times as fast as numpy's calls on small
    arrays; as plain Python fifty times slower: `plain` then does the same with numpy.
    """
    return lambda loops: compiled(loops) if COMPILER else cast(Function, plain)


def working_copy(array: NDArray[np.float64]) -> Any:
    """A copy whose single numbers compiled functions read and write.

    Where nothing compiles, a list, of a matrix one of lists: Python takes a number out
    of it in a third of the time, and calculates with it in a third.
    """
    return array.copy() if COMPILER else array.tolist()


def _numba_type(hint: Any) -> Any:
    """Type of a parameter, or None if its annotation leaves it open."""
    scalars = {float: "float64", int: "int64", bool: "boolean"}
    if hint in scalars:
        return getattr(numba.types, scalars[hint])
    if get_origin(hint) is Annotated:
        dimensions, *marks = hint.__metadata__
        # A parameter that is only read takes read-only arrays and others.
        read_only = "written" not in marks
        return numba.types.Array(
            numba.types.float64, dimensions, "C", readonly=read_only
        )
    if get_origin(hint) is tuple and Ellipsis not in get_args(hint):
        parts = [_numba_type(part) for part in get_args(hint)]
        return None if None in parts else numba.types.Tuple(parts)
    return None


@compiled_or(np.dot)
def dot(a: Vector, b: Vector) -> float:
    """Scalar product: of a few numbers a loop takes a tenth of the time that BLAS
    takes.
    """
    total = 0.0
    for k in range(len(a)):
        total += a[k] * b[k]
    return total
