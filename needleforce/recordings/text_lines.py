"""The lines of a text, plain or compressed with gzip, as its bytes come."""

import codecs
import io
import zlib
from collections.abc import Iterable, Iterator

from needleforce.recordings.errors import FormatError, RecordingCode
from needleforce.recordings.follow import BINARY, MAX_BLOCK_BYTES, head_of

MAX_LINE_CHARACTERS = 1 << 24
"""A longer line is none of a text."""

_GZIP_MAGIC = b"\x1f\x8b"

_GZIP_WINDOW = 31
"""For zlib: the largest window, with the head and the checksum of gzip."""

_CUT_SHORT = "the compressed file is cut short"
_DAMAGED = "the compressed file is damaged"
_NUL_BYTES = "the file goes on with NUL bytes, as power loss may leave them"

_WINDOWS_CHARACTERS = {
    0xDC00 + byte: bytes([byte]).decode("cp1252", "replace") for byte in range(128, 256)
}
"""What bytes that are no UTF-8, as Python escapes them, mean in Windows text."""


class TextLines:
    """Iterates over the whole lines of a text, in lists of those that came together.

    Text compressed with gzip is unpacked, whatever its suffix, line ends may be of any
    kind, and what is not UTF-8 is read as Windows text.

    Attributes:
        tail: What stands behind the last line end, once all is read.
        size: Bytes of text so far.
        warnings: What was lost or guessed.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = blocks
        decoder = codecs.getincrementaldecoder("utf-8-sig")("surrogateescape")
        self._decoder = io.IncrementalNewlineDecoder(decoder, translate=True)
        self._line_count = 0
        self._fault = ""
        self._is_blank = True
        self.tail = ""
        self.size = 0
        self.warnings: list[str] = []

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the lines, without their ends; `FormatError` if there is no text."""
        for block in self._plain_blocks():
            self.size += len(block)
            text, nul, _ = block.partition(b"\x00")
            yield from self._split(self._decoder.decode(text))
            if nul:
                self._fault = _NUL_BYTES
                break

        yield from self._split(self._decoder.decode(b"", final=True))
        is_nul = self._fault == _NUL_BYTES
        if self._fault:
            self._report_loss()
        if self._is_blank:
            state = "is not text" if is_nul else "is empty"
            raise FormatError(f"it {state}; expected a header row and rows of numbers")

    def _report_loss(self) -> None:
        """Warn of what follows the last whole line, and leave it out."""
        is_damaged = self._fault == _DAMAGED
        self._fault += f"; what follows line {self._line_count} is lost"
        if is_damaged:
            self._fault += (
                ", and lines before it may be wrong: gzip shows that there is damage, "
                "not where"
            )

        self.warnings.append(self._fault)
        # What follows the last line end is a piece of a line.
        self.tail = ""

    def forgive_end(self) -> None:
        """Leave out a piece of a line at the end, without a warning."""
        self.tail = ""
        if self._fault.startswith(_CUT_SHORT):
            self.warnings.remove(self._fault)

    def _plain_blocks(self) -> Iterator[bytes]:
        """Yield the text in blocks of bytes, unpacked; `FormatError` if it is none."""
        head, blocks = head_of(self._blocks)
        if head in BINARY:
            kind = BINARY[head][1:]
            raise FormatError(f"it is {kind}, not text", RecordingCode.SUFFIX)

        if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
            raise FormatError("it is UTF-16 text, expected UTF-8 (in Excel: CSV UTF-8)")

        yield from self._gunzip(blocks) if head.startswith(_GZIP_MAGIC) else blocks

    def _gunzip(self, blocks: Iterable[bytes]) -> Iterator[bytes]:
        """Yield unpacked blocks of at most `MAX_BLOCK_BYTES`.

        A megabyte of gzip can hold a gigabyte.
        """
        member = zlib.decompressobj(_GZIP_WINDOW)
        is_open = False
        try:
            for packed in blocks:
                # Members may follow each other, and zeros the last.
                while packed and (is_open or (packed := packed.lstrip(b"\x00"))):
                    yield member.decompress(packed, MAX_BLOCK_BYTES)
                    packed = member.unconsumed_tail
                    is_open = not member.eof
                    if member.eof:
                        packed = member.unused_data
                        member = zlib.decompressobj(_GZIP_WINDOW)
        except zlib.error:
            self._fault = _DAMAGED
        else:
            self._fault = _CUT_SHORT if is_open else ""

    def _split(self, escaped: str) -> Iterator[list[str]]:
        """Yield the lines that end in further text, if any do."""
        text = escaped
        if not escaped.isascii():
            text = escaped.translate(_WINDOWS_CHARACTERS)

        note = "the file is not UTF-8; it was read as Windows text (cp1252)"
        if text != escaped and note not in self.warnings:
            self.warnings.append(note)

        self._is_blank = self._is_blank and not text.strip()

        *lines, self.tail = (self.tail + text).split("\n")
        if len(self.tail) > MAX_LINE_CHARACTERS:
            raise FormatError(
                f"it is not text; line {self._line_count + 1} does not end"
            )

        if lines:
            self._line_count += len(lines)
            yield lines
