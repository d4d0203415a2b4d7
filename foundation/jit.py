"""The decorator of functions that every tick calls.

The compiler is numba. What it made is kept on disk in folders whose names are hashes of
the sources it depends on: the function's own file and all files of this project that
this file imports, directly or through others. A change in any of them makes a new
folder, so compiled code may call functions and use constants of other files.

With ``NUMBA_DISABLE_JIT=1`` in the environment everything runs as plain Python, fifty
times slower, for debugging.
"""

import hashlib
import os
import re
import sys
from collections.abc import Callable
from dataclasses import is_dataclass
from functools import cache
from importlib import import_module
from inspect import getfile, signature
from pathlib import Path
from shutil import rmtree
from typing import Annotated, Any, TypeVar, cast, get_args, get_origin, get_type_hints

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

MAX_FOLDERS = 4
"""Versions of one module's compiled code that stay on disk: the newest ones."""

_inside: list[Any] = []
"""What `compiled_inside` has made: the compiler only refers to it."""

PROJECT = Path(__file__).resolve().parents[1]
"""The folder in which the project's packages lie."""


def compiled(function: Function) -> Function:
    """Compile a pure function that Python calls.

    It takes and returns numbers, truth values, arrays, and named or plain tuples of
    them; it raises nothing, and calls compiled functions only, of any module. Loops
    over numbers compile in a tenth of the time that expressions of arrays take.

    Where every parameter is annotated as ``float``, ``int``, ``bool``, one of
    `foundation.arrays`, a `NamedTuple` of such, a state (see `foundation.records`),
    or a plain tuple of a fixed number of them, it is compiled when its module is
    imported; what it calls then stands above it or in a module imported there. Where
    one is not (``Any``, ``tuple[float, ...]``), it
    is compiled at the first call with these types: whoever calls it in a tick calls it
    once when constructed. No tick waits for a compiler.

    A named tuple that it returns costs Python 1.2 us to receive; between compiled
    functions named tuples are free.

    Returns:
        The compiled function, or the function itself where compiling is disabled.
    """
    if not COMPILER:
        return function
    parameters = parameter_types(function)
    signatures = () if parameters is None else (parameters,)
    configured_folder = numba.config.CACHE_DIR
    numba.config.CACHE_DIR = str(cache_folder(function.__module__, getfile(function)))
    try:
        return numba.njit(*signatures, cache=True)(function)
    except Exception:  # there is no folder to write into, or a damaged file in it
        return numba.njit(*signatures)(function)
    finally:
        numba.config.CACHE_DIR = configured_folder


def compiled_inside(function: Function) -> Function:
    """Compile a pure function into the `compiled` functions that call it.

    Python sees the function itself, in plain Python. What is compiled has no entry of
    its own, neither for Python nor in the cache, which halves the time that it takes.

    Raises:
        TypeError: For a parameter without a type that the compiler knows.
    """
    if not COMPILER:
        return function
    parameters = parameter_types(function)
    if parameters is None:
        raise TypeError(f"{function.__qualname__} has a parameter of an open type")
    dispatcher = numba.njit(no_cpython_wrapper=True, no_cfunc_wrapper=True)(function)
    find_template = dispatcher.get_call_template

    def get_call_template(arguments: Any, keywords: Any) -> Any:
        # Its one signature: arguments are converted, rather than compiled for anew.
        if not dispatcher.overloads:
            dispatcher.compile(parameters)
            dispatcher.disable_compile()
        return find_template(arguments, keywords)

    dispatcher.get_call_template = get_call_template
    _inside.append(dispatcher)
    typing_context = registry.cpu_target.typing_context
    typing_context.insert_global(function, types.Dispatcher(dispatcher))
    return function


def parameter_types(function: Callable[..., Any]) -> tuple[Any, ...] | None:
    """Return the compiler's types of all parameters, None if one of them is open."""
    hints = get_type_hints(function, include_extras=True)
    parameters = [
        compiler_type(hints.get(name)) for name in signature(function).parameters
    ]
    return None if None in parameters else tuple(parameters)


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


def cache_folder(module: str, file: str) -> Path:
    """Return the folder of a module's compiled code, named by a hash of its sources.

    It lies below ``NUMBA_CACHE_DIR`` where the user has set that, else beside this
    file, else, where that cannot be written, in the user's own cache folder.
    """
    name = f"{module}-{hash_sources(Path(file).resolve())}"
    folder = _cache_root() / name
    if not folder.exists():
        _remove_old_folders(folder.parent, module)
    return folder


@cache
def _cache_root() -> Path:
    if numba.config.CACHE_DIR:
        return Path(numba.config.CACHE_DIR)
    beside = Path(__file__).resolve().parent / "__pycache__"
    if os.access(beside if beside.exists() else beside.parent, os.W_OK):
        return beside
    home = os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache"
    return Path(home) / "needleforce"


def _remove_old_folders(root: Path, module: str) -> None:
    """Remove the oldest folders of a module, so that a new one has its place."""
    try:
        folders = [
            (path.stat().st_mtime, path)
            for path in root.glob(f"{module}-*")
            if re.fullmatch(rf"{re.escape(module)}-[0-9a-f]{{16}}", path.name)
        ]
        for _, path in sorted(folders)[: -(MAX_FOLDERS - 1)]:
            rmtree(path, ignore_errors=True)
    except OSError:  # another process is doing the same
        return


@cache
def hash_sources(file: Path) -> str:
    """Return 16 hexadecimal digits that change with a file or any that it imports."""
    digest = hashlib.sha256(f"{sys.version_info[:2]} {numba.__version__}".encode())
    for path in sorted(_imported_files(file)):
        digest.update(path.read_bytes())
    return digest.hexdigest()[:16]


def _imported_files(file: Path) -> set[Path]:
    """Return a file and all files of the project that it imports, also indirectly."""
    files = {file}
    waiting = [file]
    while waiting:
        new = _direct_imports(waiting.pop()) - files
        files |= new
        waiting += new
    return files


IMPORT = re.compile(
    r"^(?:from ([\w.]+) import (\([^)]*\)|[^\n]*)|import ([\w.]+))", re.MULTILINE
)
"""An import at the left margin: the module and the names, or the module alone."""


@cache
def _direct_imports(file: Path) -> frozenset[Path]:
    """Return the files of the project that the imports of a file name."""
    found = set()
    for module, names, plain in IMPORT.findall(file.read_text(encoding="utf-8")):
        place = PROJECT.joinpath(*(module or plain).split("."))
        candidates = [place.with_suffix(".py"), place / "__init__.py"]
        candidates += [place / f"{name}.py" for name in re.findall(r"\w+", names)]
        found |= {path for path in candidates if path.is_file()}
    return frozenset(found)
