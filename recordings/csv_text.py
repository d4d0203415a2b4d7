"""The text of a CSV file, compressed or not, as far as it can be read."""

import zlib
from pathlib import Path

from recordings.errors import FileAccessError, FormatError

_GZIP_MAGIC = b"\x1f\x8b"
_GZIP_WINDOW = 31  # zlib's code for "expect a gzip header"


def read_text(path: Path) -> tuple[str, tuple[str, ...]]:
    """Return a file's text, with line ends unified to newlines.

    Args:
        path: a text file, which may be compressed with gzip whatever its suffix.

    Returns:
        The text, and warnings on what was lost or guessed.

    Raises:
        FileAccessError: the file cannot be read.
        FormatError: it is empty, or not text.
    """
    try:
        data = path.read_bytes()
    except OSError as error:
        raise FileAccessError(f"cannot read {path}: {error.strerror or error}") from error
    warnings: tuple[str, ...] = ()
    if data.startswith(_GZIP_MAGIC):
        data, warnings = _decompress(data)
    if not data.strip():
        raise FormatError(f"{path} is empty; expected a header row and rows of numbers")
    if b"\x00" in data:
        raise FormatError(f"{path} is not text; expected CSV")
    text, notes = _decode(data, is_complete=not warnings)
    return text.replace("\r\n", "\n").replace("\r", "\n"), warnings + notes


def _decompress(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    parts = []
    while data.startswith(_GZIP_MAGIC):
        member = zlib.decompressobj(_GZIP_WINDOW)
        try:
            parts.append(member.decompress(data))
        except zlib.error:
            return b"".join(parts), ("the compressed file is damaged; the rest of it is lost",)
        if not member.eof:
            return b"".join(parts), ("the compressed file is cut short; its end is lost",)
        data = member.unused_data
    return b"".join(parts), ()


def _decode(data: bytes, is_complete: bool) -> tuple[str, tuple[str, ...]]:
    try:
        return data.decode("utf-8-sig", errors="strict" if is_complete else "ignore"), ()
    except UnicodeDecodeError:
        note = "the file is not UTF-8; its header was read as Windows text (cp1252)"
        return data.decode("cp1252", errors="replace"), (note,)
