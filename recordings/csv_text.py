"""The text of a CSV file, compressed or not, as far as it can be read."""

import zlib
from pathlib import Path

from recordings.errors import FileAccessError, FormatError

_GZIP_MAGIC = b"\x1f\x8b"
_NEWLINE = b"\n"
_CHUNK = 1 << 16  # bytes
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
    told = "".join(f" ({warning})" for warning in warnings)
    if not data.strip():
        raise FormatError(f"{path} is empty; expected a header row and rows of numbers{told}")
    if b"\x00" in data:
        raise FormatError(f"{path} is not text; expected CSV{told}")
    text, notes = _decode(data)
    return text.replace("\r\n", "\n").replace("\r", "\n"), warnings + notes


def _decompress(data: bytes) -> tuple[bytes, tuple[str, ...]]:
    """Return all whole lines that a compressed file yields, and what is wrong with it."""
    parts: list[bytes] = []
    reason = ""
    while data.startswith(_GZIP_MAGIC) and not reason:
        data, reason = _decompress_member(data, parts)
    text = b"".join(parts)
    if not reason:
        return text, ()
    whole = text[: text.rfind(_NEWLINE) + 1]
    return whole, (
        f"the compressed file {reason}; what follows line {whole.count(_NEWLINE)} is lost",
    )


def _decompress_member(data: bytes, parts: list[bytes]) -> tuple[bytes, str]:
    """Append a gzip member's content to `parts`; return the data after it, and its fault."""
    member = zlib.decompressobj(_GZIP_WINDOW)
    for start in range(0, len(data), _CHUNK):
        # In chunks, so that what precedes a damaged place is kept.
        try:
            parts.append(member.decompress(data[start : start + _CHUNK]))
        except zlib.error:
            return b"", "is damaged"
        if member.eof:
            return member.unused_data + data[start + _CHUNK :], ""
    return b"", "is cut short"


def _decode(data: bytes) -> tuple[str, tuple[str, ...]]:
    try:
        return data.decode("utf-8-sig"), ()
    except UnicodeDecodeError:
        note = "the file is not UTF-8; it was read as Windows text (cp1252)"
        return data.decode("cp1252", errors="replace"), (note,)
