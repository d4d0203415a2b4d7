"""Where compiled code is kept on disk.

Each function has a file whose name holds a hash of all that its code depends on: its
own instructions, and every function, constant and type of arguments that it refers to,
directly or through others. So compiled code may call functions and use constants of
other files, and a comment, a docstring, a moved line or another function's change makes
nothing compile again.

The files lie in ``NUMBA_CACHE_DIR`` where the user has set that, else beside this file,
else in the user's own cache folder. What is there is used also where nothing can be
written.
"""

import hashlib
import os
import pickle
import re
import sys
from collections.abc import Iterator
from contextlib import suppress
from enum import Enum
from functools import cache
from importlib import import_module
from pathlib import Path
from types import CodeType, FunctionType, ModuleType
from typing import Any, get_args
from uuid import uuid4

import numpy as np

numba: Any = import_module("numba")  # its annotations do not describe its own use
compiler: Any = import_module("numba.core.compiler")
serialize: Any = import_module("numba.core.serialize")

MAX_VERSIONS = 4
"""Versions of one function's compiled code that stay on disk: the newest ones."""


def cache_roots() -> Iterator[Path]:
    """Yield the folders in which compiled code may be kept, the best first."""
    if numba.config.CACHE_DIR:
        yield Path(numba.config.CACHE_DIR)
        return
    yield Path(__file__).resolve().parent / "__pycache__"
    home = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    yield Path(home) / "needleforce"


def writable_root() -> Path | None:
    """Return the first folder, which need not exist yet, that can be written."""
    for root in cache_roots():
        existing = next((path for path in (root, *root.parents) if path.exists()), None)
        if existing is not None and os.access(existing, os.W_OK):
            return root
    return None


class FunctionCache:
    """Compiled code of one function, on disk; the compiler loads and saves it.

    What cannot be written or read is compiled again, whatever the reason: a full disk,
    a folder of another user, a file that was cut off.

    Args:
        function: The function, in plain Python.
    """

    def __init__(self, function: FunctionType) -> None:
        self._function = function
        self._name = f"{function.__module__}.{function.__qualname__}"

    @property
    def file_name(self) -> str:
        """Name of the file of the function as it now stands."""
        return f"{self._name}-{hash_function(self._function)}.compiled"

    @property
    def cache_path(self) -> str:
        """Folder of the file, for the compiler's statistics."""
        path = self._find()
        return "" if path is None else str(path.parent)

    @property
    def is_warm(self) -> bool:
        """Whether there is something to load."""
        return self._find() is not None

    def _find(self) -> Path | None:
        paths = [root / self.file_name for root in cache_roots()]
        return next((path for path in paths if path.is_file()), None)

    def load_overload(self, _signature: Any, target_context: Any) -> Any:
        """Return what was kept of the function; None without it."""
        path = self._find()
        if path is None:
            return None
        target_context.refresh()
        try:
            parts = pickle.loads(path.read_bytes())
            return compiler.CompileResult._rebuild(target_context, *parts)
        except Exception:  # reading a damaged file may raise anything
            return None

    def save_overload(self, _signature: Any, result: Any) -> None:
        """Keep what was compiled, if that is possible."""
        root = writable_root()
        if root is None:
            return
        unfinished = root / f"{uuid4().hex}.unfinished"
        with suppress(OSError):
            root.mkdir(parents=True, exist_ok=True)
            try:
                unfinished.write_bytes(serialize.dumps(result._reduce()))
                unfinished.replace(root / self.file_name)
            finally:
                unfinished.unlink(missing_ok=True)
            self._remove_old_versions(root)

    def _remove_old_versions(self, root: Path) -> None:
        versions = [
            (path.stat().st_mtime, path)
            for path in root.glob(f"{self._name}-{'[0-9a-f]' * 16}.compiled")
        ]
        for _, path in sorted(versions)[:-MAX_VERSIONS]:
            path.unlink(missing_ok=True)


@cache
def hash_function(function: FunctionType) -> str:
    """Return 16 hexadecimal digits that change with all that compiled code is made of.

    Beside the function that is the compiler, how it is called, and the processor.
    """
    target = import_module("numba.core.registry").cpu_target.target_context
    processor = target.codegen().magic_tuple()
    digest = hashlib.sha256(
        f"{sys.version_info[:2]} {numba.__version__} {processor}".encode()
    )
    digest.update(Path(__file__).with_name("jit.py").read_bytes())
    found = {function}
    waiting = [function]
    while waiting:
        new = set(_describe(waiting.pop())[1]) - found
        found |= new
        waiting += new
    for text in sorted(_describe(part)[0] for part in found):
        digest.update(text.encode())
    return digest.hexdigest()[:16]


@cache
def _describe(function: FunctionType) -> tuple[str, tuple[FunctionType, ...]]:
    """Return all that a function does but for the functions it refers to; and these."""
    texts: list[str] = [f"{function.__module__}.{function.__qualname__}"]
    functions: list[FunctionType] = []
    waiting: list[Any] = [
        function.__code__,
        function.__defaults__,
        *(cell.cell_contents for cell in function.__closure__ or ()),
        *function.__annotations__.values(),
    ]
    while waiting:
        value = waiting.pop()
        value = getattr(value, "py_func", value)  # of what is compiled already
        if isinstance(value, FunctionType) and not _is_foreign(value.__module__):
            functions.append(value)
        elif isinstance(value, CodeType):
            texts.append(_describe_code(value))
            waiting += [*value.co_consts, *_find_globals(value, function.__globals__)]
        elif isinstance(value, tuple | frozenset):
            waiting += (
                sorted(value, key=repr) if isinstance(value, frozenset) else value
            )
        else:
            texts.append(_describe_value(value))
            waiting += _find_types(value)
    return "\n".join(texts), tuple(functions)


def _describe_code(code: CodeType) -> str:
    names = (code.co_name, code.co_names, code.co_varnames, code.co_argcount)
    return f"{code.co_code.hex()} {names}"


def _find_globals(code: CodeType, names: dict[str, Any]) -> Iterator[Any]:
    """Yield what the names in code stand for: in its module, or in one it names."""
    for name in code.co_names:
        if name not in names:  # of an attribute
            continue
        value = names[name]
        yield value
        if isinstance(value, ModuleType) and not _is_foreign(value.__name__):
            yield from _find_globals(code, vars(value))


def _find_types(value: Any) -> list[Any]:
    """Return the types that the fields of a named tuple or a state have."""
    if isinstance(value, type) and not _is_foreign(value.__module__):
        return list(getattr(value, "__annotations__", {}).values())
    return list(get_args(value))


def _describe_value(value: Any) -> str:
    """Return a constant, a type, or what others have made, in words."""
    if isinstance(value, np.ndarray):
        return f"{value.dtype} {value.shape} {value.tobytes().hex()}"
    if isinstance(value, type) and issubclass(value, Enum):
        return repr(list(value))
    if isinstance(value, type):
        return f"{value} {getattr(value, '__annotations__', {}).keys()}"
    if hasattr(value, "__qualname__"):  # of functions: their text holds an address
        return f"{value.__module__}.{value.__qualname__}"
    # Texts with blanks are docstrings and messages: compiled code has none.
    is_prose = isinstance(value, str) and re.search(r"\s", value)
    return "" if is_prose else repr(value)


def _is_foreign(module: str | None) -> bool:
    """Return whether a module is the compiler's, numpy's or Python's own."""
    return (module or "").partition(".")[0] in {"numba", "numpy", "math", "builtins"}
