"""The decorators of functions that every tick calls.

The compiler is numba, which keeps what it has made on disk (``NUMBA_CACHE_DIR``). With
``NUMBA_DISABLE_JIT=1`` in the environment everything runs as plain Python, fifty times
slower, for debugging.
"""

import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import is_dataclass
from functools import cache
from hashlib import sha256
from importlib import import_module
from inspect import signature
from pathlib import Path
from threading import RLock
from typing import (
    Annotated,
    Any,
    TypeVar,
    cast,
    get_args,
    get_origin,
    get_type_hints,
)

import numpy as np

numba: Any = import_module("numba")  # its annotations do not describe its own use
types: Any = numba.types
imputils: Any = import_module("numba.core.imputils")
registry: Any = import_module("numba.core.registry")

Function = TypeVar("Function", bound=Callable[..., Any])

COMPILER = "" if numba.config.DISABLE_JIT else f"numba {numba.__version__}"
"""What compiles, with its version; empty where everything runs as plain Python."""

SCALARS = {float: types.float64, int: types.int64, bool: types.boolean}
"""Types of numbers in annotations, and the compiler's."""

_lock = RLock()
"""One thread at a time compiles."""

ROOT = Path(__file__).resolve().parents[1]
"""The folder of the packages."""

dispatchers: list[Any] = []
"""Compiled functions that Python may call."""

_inside: list[Any] = []
"""What `compiled_inside` has made. The compiler holds only weak references to it."""


def compiled(function: Function) -> Function:
    """Compile a pure function that Python calls.

    It takes and returns numbers, truth values, arrays, and named or plain tuples of
    them; it raises nothing, and calls compiled functions only, of any module. Loops
    over numbers compile in a tenth of the time that expressions of arrays take.

    Every parameter is annotated as ``float``, ``int``, ``bool``, one of
    `foundation.arrays`, a `NamedTuple` of such, a state (see `foundation.records`), or
    a plain tuple of a fixed number of them. Functions wait until `compile_waiting` is
    called, which whoever calls them in a tick does when constructed: no tick waits for
    a compiler. A call before compiles them, too.

    A named tuple that it returns costs Python 1.2 us to receive; between compiled
    functions named tuples are free.

    Returns:
        The compiled function, or the function itself where compiling is disabled.

    Raises:
        TypeError: For a parameter without a type that the compiler knows.
    """
    if not COMPILER:
        return function
    dispatcher = numba.njit(function)
    with suppress(RuntimeError):  # where no folder can be written
        dispatcher.enable_caching()
        parts = function.__module__.split(".")
        # The packages in `needleforce` share no compiled functions.
        depth = 2 if parts[0] == "needleforce" and len(parts) > 2 else 1
        # Kept code is of these sources: numba would look at one file only.
        stamp = _hash_sources("/".join(parts[:depth]))
        dispatcher._cache._cache_file._source_stamp = stamp
    _compile_on_demand(dispatcher)
    dispatchers.append(dispatcher)
    return dispatcher


@cache
def _hash_sources(folder: str) -> str:
    """Return a hash of the sources below a folder, and of this package."""
    digest = sha256()
    for name in (folder, "foundation"):
        for path in sorted((ROOT / name).rglob("*.py")):
            digest.update(path.read_bytes())
    return digest.hexdigest()


def compiled_inside(function: Function) -> Function:
    """Compile a pure function into the `compiled` functions that call it.

    Python sees the function itself, in plain Python. What is compiled has no entry of
    its own, neither for Python nor in the cache: it takes less time, at a second start
    none.

    Raises:
        TypeError: For a parameter without a type that the compiler knows.
    """
    if not COMPILER:
        return function
    dispatcher = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
    _compile_on_demand(dispatcher)
    _inside.append(dispatcher)
    typing_context = registry.cpu_target.typing_context
    typing_context.insert_global(function, types.Dispatcher(dispatcher))
    return function


def _compile_on_demand(dispatcher: Any) -> None:
    """Let a function be compiled when compiled code or Python calls it first.

    The compiler asks a dispatcher for a template to type a call in compiled code, and
    has it compile for the arguments when Python calls it. Both are replaced, since it
    would compile a version for each combination of types.
    """
    parameters = parameter_types(dispatcher.py_func)
    find_template = dispatcher.get_call_template

    def compile_once() -> None:
        if not dispatcher.overloads:
            dispatcher.compile(tuple(parameters))
            dispatcher.disable_compile()

    def get_call_template(arguments: Any, keywords: Any) -> Any:
        # Its one signature: arguments are converted, rather than compiled for anew.
        compile_once()
        return find_template(arguments, keywords)

    def compile_for_arguments(*arguments: Any, **keywords: Any) -> Any:
        compile_once()
        del dispatcher._compile_for_args
        _, values = dispatcher._compiler.fold_argument_types(arguments, keywords)
        context = dispatcher.targetdescr.typing_context
        for value, wanted in zip(values, parameters, strict=True):
            given = dispatcher.typeof_pyval(value)
            if context.can_convert(given, wanted) is None:
                name = dispatcher.py_func.__qualname__
                raise TypeError(f"{name} takes {wanted}, got {given}")
        return dispatcher.overloads[tuple(parameters)].entry_point

    dispatcher.compile_once = compile_once
    dispatcher.get_call_template = get_call_template
    dispatcher._compile_for_args = compile_for_arguments


def compile_waiting() -> None:
    """Compile all functions of the modules imported so far, or load them from disk."""
    with _lock:
        waiting = [one for one in dispatchers if not one.overloads]
        for number, dispatcher in enumerate(waiting, 1):
            dispatcher.compile_once()
            is_slow = not dispatcher.stats.cache_hits
            if sys.stderr is not None and is_slow and number % 20 == 0:
                sys.stderr.write(
                    f"needleforce: compiling once, {number} of {len(waiting)}\n"
                )


def parameter_types(function: Callable[..., Any]) -> list[Any]:
    """Return the compiler's types of all parameters of a function.

    Raises:
        TypeError: Where one is open.
    """
    hints = get_type_hints(function, include_extras=True)
    names = signature(function).parameters
    parameters = [compiler_type(hints.get(name)) for name in names]
    if None in parameters:
        open_name = list(names)[parameters.index(None)]
        raise TypeError(
            f"the type of {open_name} of {function.__qualname__} is not known to the "
            "compiler; see foundation.jit.compiled"
        )
    return parameters


def compiler_type(hint: Any) -> Any:
    """Return the compiler's type of an annotation, None where that is open."""
    if hint in SCALARS:
        return SCALARS[hint]
    if get_origin(hint) is Annotated:
        dimensions, *marks = hint.__metadata__
        # A parameter that is only read takes read-only arrays and others.
        is_read_only = "written" not in marks
        return types.Array(types.float64, dimensions, "C", readonly=is_read_only)
    if isinstance(hint, type) and is_dataclass(hint):
        return numba.from_dtype(record_dtype(hint))
    if get_origin(hint) is list and is_dataclass(get_args(hint)[0]):
        return types.Array(compiler_type(get_args(hint)[0]), 1, "C")
    names = getattr(hint, "_fields", None)
    if names is not None:
        fields = get_type_hints(hint, include_extras=True)
        parts = [compiler_type(fields[name]) for name in names]
        return None if None in parts else types.BaseTuple.from_types(parts, hint)
    if get_origin(hint) is tuple and Ellipsis not in get_args(hint):
        parts = [compiler_type(part) for part in get_args(hint)]
        return None if None in parts else types.Tuple(parts)
    return None


def _can_convert(self: Any, typing_context: Any, other: Any) -> Any:
    """Return how safely a named tuple converts to another, None if it does not.

    The compiler converts plain tuples element by element (an integer to a float, an
    array to one that is only read) but refuses to do so for tuples with names.
    """
    if getattr(other, "instance_class", None) is not self.instance_class:
        return None
    conversions = [
        typing_context.can_convert(own, wanted)
        for own, wanted in zip(self, other, strict=True)
    ]
    return None if None in conversions else max(conversions, default=None)


def _cast(context: Any, builder: Any, source: Any, target: Any, value: Any) -> Any:
    """Emit the conversion of a named tuple, element by element."""
    elements = [
        context.cast(builder, builder.extract_value(value, number), own, wanted)
        for number, (own, wanted) in enumerate(zip(source, target, strict=True))
    ]
    return context.make_tuple(builder, target, elements)


if COMPILER:
    types.NamedTuple.can_convert_to = _can_convert
    types.NamedUniTuple.can_convert_to = _can_convert
    imputils.lower_cast(types.BaseNamedTuple, types.BaseNamedTuple)(_cast)


@cache
def state_fields(kind: type) -> dict[str, Any]:
    """Return the types of the fields of a state, by name."""
    return get_type_hints(kind)


@cache
def record_dtype(kind: type) -> np.dtype[Any]:
    """Return numpy's type of a state: a structure with its fields, in their order."""
    parts: list[Any] = []
    for name, hint in state_fields(kind).items():
        if hint in SCALARS:
            parts.append((name, np.dtype(hint)))
        elif is_dataclass(hint):
            parts.append((name, record_dtype(cast(type, hint))))
        else:  # a tuple of states of one type
            inner = get_args(hint)
            parts.append((name, record_dtype(inner[0]), (len(inner),)))
    return np.dtype(parts, align=True)
