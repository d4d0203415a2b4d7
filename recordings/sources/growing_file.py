"""A file that still grows, read piece by piece like any other."""

from collections.abc import Iterable


class GrowingFile:
    """Gives out the bytes of a file as they come.

    Args:
        blocks: from `byte_blocks`, pauses told.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = iter(blocks)
        self._held = bytearray()
        self._is_over = False

    def read(self, size: int) -> bytes | None:
        """Return so many bytes; fewer once no more will come; None where they have not come yet."""
        while len(self._held) < size and not self._is_over:
            block = next(self._blocks, None)
            if block is None:
                self._is_over = True
            elif block:
                self._held += block
            else:
                return None
        part = bytes(self._held[:size])
        del self._held[:size]
        return part
