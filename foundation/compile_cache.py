"""Where compiled code is kept on disk.

It is kept in folders whose names are hashes of the code it depends on: a module's own
file and all files of this project that this file imports, directly or through others. A
change in any of them makes a new folder, so compiled code may call functions and use
constants of other files. A comment, a docstring or a moved line changes nothing.

The folders lie below ``NUMBA_CACHE_DIR`` where the user has set that, else beside this
file, else in the user's own cache folder. One that is warm is used also where it cannot
be written.
"""

import hashlib
import os
import re
import sys
from collections.abc import Callable, Iterator
from functools import cache
from importlib import import_module
from importlib.machinery import SourceFileLoader
from pathlib import Path
from shutil import rmtree
from types import CodeType
from typing import Any, NamedTuple

numba: Any = import_module("numba")  # its annotations do not describe its own use
caching: Any = import_module("numba.core.caching")

MAX_FOLDERS = 4
"""Versions of one module's compiled code that stay on disk: the newest ones."""

PROJECT = Path(__file__).resolve().parents[1]
"""The folder in which the project's packages lie."""


class CacheStatus(NamedTuple):
    """Where compiled code is kept.

    Attributes:
        folder: The first folder that can be written, or that is warm; None without one.
        is_writable: Whether it can be written.
        is_warm: Whether it holds compiled code of this project's present sources.
    """

    folder: Path | None
    is_writable: bool
    is_warm: bool


def find_cache() -> CacheStatus:
    """Find where the compiled code of the estimators is kept."""
    name = folder_name("residual.momentum_observer")
    for root in cache_roots():
        is_warm = (root / name).is_dir()
        if is_warm or can_write(root):
            return CacheStatus(root, can_write(root), is_warm)
    return CacheStatus(None, False, False)


def folder_name(module: str) -> str:
    """Return the name of the folder of a module's compiled code, at present."""
    file = PROJECT.joinpath(*module.split(".")).with_suffix(".py")
    return f"{module}-{hash_sources(file)}"


def cache_roots() -> Iterator[Path]:
    """Yield the folders below which compiled code may be kept, the best first."""
    if numba.config.CACHE_DIR:
        yield Path(numba.config.CACHE_DIR)
        return
    yield Path(__file__).resolve().parent / "__pycache__"
    home = os.environ.get("XDG_CACHE_HOME") or Path("~/.cache").expanduser()
    yield Path(home) / "needleforce"


def can_write(folder: Path) -> bool:
    """Return whether a folder, which need not exist yet, can be written."""
    existing = next((path for path in (folder, *folder.parents) if path.exists()), None)
    return existing is not None and os.access(existing, os.W_OK)


def cache_folder(module: str, file: str) -> Path | None:
    """Return the folder of a module's compiled code, named by a hash of its sources.

    It is None where there is none yet and none can be made.
    """
    name = f"{module}-{hash_sources(Path(file).resolve())}"
    roots = list(cache_roots())
    for root in roots:
        if (root / name).is_dir():
            return root / name
    for root in roots:
        if can_write(root):
            _remove_old_folders(root, module)
            return root / name
    return None


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
        digest.update(_hash_code(path))
    return digest.hexdigest()[:16]


@cache
def _hash_code(path: Path) -> bytes:
    """Return a hash of what Python makes of a file, without lines and docstrings.

    Python keeps that beside the file, so reading it costs as little as an import.
    """
    code = SourceFileLoader(path.stem, str(path)).get_code(path.stem)
    digest = hashlib.sha256()
    waiting: list[Any] = [code]
    while waiting:
        value = waiting.pop()
        if isinstance(value, CodeType):
            digest.update(value.co_code)
            names = (value.co_name, value.co_names, value.co_varnames)
            digest.update(repr((*names, value.co_argcount)).encode())
            waiting += value.co_consts
        elif isinstance(value, frozenset):  # its order differs between processes
            digest.update(repr(sorted(map(repr, value))).encode())
        elif not (isinstance(value, str) and re.search(r"\s", value)):
            # Strings with blanks are docstrings and messages: compiled code has none.
            digest.update(repr(value).encode())
    return digest.digest()


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


class _FolderLocator(caching._CacheLocator):
    """Tells the compiler the folder of a function's module."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder

    @classmethod
    def from_function(cls, function: Callable[..., Any], file: str) -> Any:
        folder = cache_folder(function.__module__, file)
        return None if folder is None else cls(folder)

    def ensure_cache_path(self) -> None:
        self._folder.mkdir(parents=True, exist_ok=True)

    def get_cache_path(self) -> str:
        return str(self._folder)

    def get_source_stamp(self) -> str:
        return self._folder.name

    def get_disambiguator(self) -> str:
        return ""  # the file's name has the function's qualified name


class _FolderCacheImpl(caching.CompileResultCacheImpl):
    """The compiler's own way to write and read, in our folder."""

    _locator_classes = (_FolderLocator,)


class FunctionCache(caching.FunctionCache):
    """Compiled code of one function, on disk.

    What cannot be written or read is compiled again, whatever the reason: a full disk,
    a folder of another user, a file that was cut off.
    """

    _impl_class = _FolderCacheImpl

    @property
    def is_warm(self) -> bool:
        """Whether there is something to load."""
        return Path(self._cache_file._index_path).exists()

    def load_overload(self, sig: Any, target_context: Any) -> Any:
        """Return what was kept for a signature, None without it."""
        try:
            return super().load_overload(sig, target_context)
        except Exception:  # reading a damaged file may raise anything
            self._forget()
            return None

    def save_overload(self, sig: Any, data: Any) -> None:
        """Keep what was compiled for a signature, if that is possible."""
        try:
            super().save_overload(sig, data)
        except OSError:
            self.disable()

    def _forget(self) -> None:
        """Empty the index, so that what is compiled again can be kept."""
        try:
            self.flush()
        except OSError:
            self.disable()


def cache_of(function: Callable[..., Any]) -> FunctionCache | None:
    """Return the cache of a function, None where nothing can be kept."""
    try:
        return FunctionCache(function)
    except RuntimeError:  # there is no folder
        return None
