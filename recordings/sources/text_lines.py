"""The lines of a text as its bytes come."""

import codecs
import io
from collections.abc import Iterable, Iterator

from recordings.errors import FormatError
from recordings.sources.unpacked import Unpacked

_LONGEST_LINE = 1 << 24  # characters


class TextLines:
    """Iterates over the whole lines of a text, in lists of those that came together.

    Compressed text is unpacked, line ends may be of any kind, and what is not UTF-8 is read as
    Windows text.

    Args:
        blocks: bytes as read.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._bytes = Unpacked(blocks)
        self._decode = codecs.getincrementaldecoder("utf-8-sig")()
        self._ends = io.IncrementalNewlineDecoder(None, translate=True)
        self.count = 0
        """Lines so far."""
        self.tail = ""
        """Once all is read: what stands behind the last line end."""
        self._note = ""
        self._checked = self._sound = 0
        self.warnings: list[str] = []
        """What was lost or guessed."""

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the lines, without their ends.

        Raises:
            FormatError: the source is empty, or holds no text.
        """
        is_blank = True
        for block in self._bytes:
            self._note_check()
            if b"\x00" in block:
                raise FormatError("it is not text; expected CSV")
            is_blank = is_blank and not block.strip()
            yield from self._split(self._text(block, is_last=False), is_last=False)
        yield from self._split(self._text(b"", is_last=True), is_last=True)
        self._note_check()
        if self._bytes.fault:
            # What follows the last line end is a piece of a line.
            self.tail = ""
            self._note = (
                f"the compressed file {self._bytes.fault}; what follows line {self.count} is lost"
            )
            if self._bytes.is_damaged:
                self._note += (
                    f", and lines {self._sound + 1} to {self.count} may be wrong: gzip tells that "
                    "there is damage, not where"
                )
            self.warnings.append(self._note)
        if is_blank:
            raise FormatError("it is empty; expected a header row and rows of numbers")

    def forgive_end(self) -> None:
        """Leave out a piece of a line at the end, and do not blame the source for it."""
        self.tail = ""
        if self._bytes.fault and not self._bytes.is_damaged:
            self.warnings.remove(self._note)

    def _note_check(self) -> None:
        """Whole lines before the end of a member that passed its check are sound."""
        if self._bytes.checked > self._checked:
            self._checked, self._sound = self._bytes.checked, self.count

    def _split(self, text: str, is_last: bool) -> Iterator[list[str]]:
        *lines, self.tail = (self.tail + self._ends.decode(text, final=is_last)).split("\n")
        if len(self.tail) > _LONGEST_LINE:
            raise FormatError(f"it is not text; line {self.count + 1} does not end")
        if lines:
            self.count += len(lines)
            yield lines

    def _text(self, block: bytes, is_last: bool) -> str:
        waiting = self._decode.getstate()[0]
        try:
            return self._decode.decode(block, final=is_last)
        except UnicodeDecodeError:
            self.warnings.append("the file is not UTF-8; it was read as Windows text (cp1252)")
            self._decode = codecs.getincrementaldecoder("cp1252")(errors="replace")
            return self._decode.decode(waiting + block, final=is_last)
