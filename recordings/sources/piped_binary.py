"""A binary recording that comes through a pipe: it waits in a temporary file, memory stays bounded.

Such formats cannot be read as they come: what a column means, or where it stands, is known at the
end. So the pipe is read to its end first.
"""

import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from itertools import chain
from pathlib import Path

from recordings.errors import FileAccessError

_MAGIC = {
    b"\x89MCAP0\r\n": ".mcap",
    b"SQLite format 3\x00": ".db3",
    b"PK\x03\x04": ".npz",
    b"PAR1": ".parquet",
}
"""How files begin, and their suffix."""


def peek(blocks: Iterable[bytes]) -> tuple[str, Iterator[bytes]]:
    """Look at how a recording begins; no more is waited for than decides it.

    Args:
        blocks: bytes as they come.

    Returns:
        The suffix of its format, empty if it is text; and all its bytes.
    """
    rest, head = iter(blocks), b""
    for block in rest:
        head += block
        if not any(magic.startswith(head) for magic in _MAGIC):
            break
    suffix = next((end for magic, end in _MAGIC.items() if head.startswith(magic)), "")
    return suffix, chain([head] if head else [], rest)


@contextmanager
def spooled(blocks: Iterable[bytes], suffix: str) -> Iterator[Path]:
    """Keep all bytes in a temporary file as long as the context is entered.

    Args:
        blocks: bytes as they come.
        suffix: of the file.

    Raises:
        FileAccessError: the file cannot be written.
    """
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        path = Path(folder) / f"standard-input{suffix}"
        try:
            with path.open("wb") as file:
                for block in blocks:
                    file.write(block)
        except OSError as error:
            raise FileAccessError(
                f"cannot keep the piped recording in {folder}: {error.strerror or error}; "
                "give it as a file, or set TMPDIR to a folder with more room"
            ) from error
        yield path
