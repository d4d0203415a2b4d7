"""The lines of a text, plain or compressed with gzip, as its bytes come."""

import codecs
import io
import re
import zlib
from collections.abc import Iterable, Iterator

from needleforce.recordings.errors import FormatError, RecordingCode
from needleforce.recordings.follow import BINARY, MAX_BLOCK_BYTES, head_of

MAX_LINE_CHARACTERS = 1 << 24
"""A longer line is none of a text."""

_GZIP_MAGIC = b"\x1f\x8b"

_GZIP_WINDOW = 31
"""For zlib: the largest window, with the head and the checksum of gzip."""

MAX_NUL_BYTES = 1 << 24
"""After so many in a row nothing more is expected of a file."""

SNIFFED_BYTES = 1024
"""The first bytes of a text, which show its encoding."""

MIN_NUL_FRACTION = 0.7
"""Of every second byte of UTF-16 without a mark, at least so many are NUL: those of
letters, digits and separators."""

_CUT_SHORT = "the compressed file is cut short"
_DAMAGED = "the compressed file is damaged"
_NUL_BYTES = "the file goes on with NUL bytes, as power loss may leave them"

_UTF_8 = "utf-8-sig"
_UTF_16_LITTLE = "utf-16-le"
_UTF_16_BIG = "utf-16-be"
_SHIFT_JIS = "cp932"
_SHIFT_JIS_WORDS = tuple(
    word.encode(_SHIFT_JIS)
    for word in ("時間", "試験力", "荷重", "変位", "ストローク", "名前")
)
"""Words in the exports of Japanese machines; as other text they make no sense."""

_NUL = "\0"
_NUL_RUN = re.compile("\0+")

_WINDOWS_CHARACTERS = {
    0xDC00 + byte: bytes([byte]).decode("cp1252", "replace") for byte in range(128, 256)
}
"""What bytes that are no UTF-8, as Python escapes them, mean in Windows text."""


class TextLines:
    """Iterates over the whole lines of a text, in lists of those that came together.

    Text compressed with gzip is unpacked, whatever its suffix, and line ends may be of
    any kind. UTF-16 is known by its mark or by its NUL bytes; what else is not UTF-8 is
    read as Windows text. NUL bytes in a row, as a power loss may leave them, become one
    such character, so that they cost the line in which they stand.

    Attributes:
        tail: What stands behind the last line end, once all is read.
        size: Bytes of text so far.
        warnings: What was lost or guessed.
    """

    def __init__(self, blocks: Iterable[bytes]) -> None:
        self._blocks = blocks
        self._line_count = 0
        self._fault = ""
        self._is_blank = True
        self._is_nul = False
        self.tail = ""
        self.size = 0
        self.warnings: list[str] = []

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the lines, without their ends; `FormatError` if there is no text."""
        head, blocks = head_of(self._plain_blocks(), SNIFFED_BYTES)
        encoding = _encoding(head)
        errors = "surrogateescape" if encoding == _UTF_8 else "replace"
        decoder = io.IncrementalNewlineDecoder(
            codecs.getincrementaldecoder(encoding)(errors), translate=True
        )
        nul_bytes = 0
        for block in blocks:
            self.size += len(block)
            yield from self._split(decoder.decode(block))
            nul_bytes = 0 if block.strip(b"\0") else nul_bytes + len(block)
            if nul_bytes > MAX_NUL_BYTES:
                break

        yield from self._split(decoder.decode(b"", final=True))
        if _NUL in self.tail:
            self._fault = self._fault or _NUL_BYTES
        if self._fault:
            self._report_loss()
        if self._is_blank:
            state = "is not text" if self._is_nul else "is empty"
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

        if _NUL in text:
            self._is_nul = True
            text = _NUL_RUN.sub(_NUL, text)

        self._is_blank = self._is_blank and not text.replace(_NUL, "").strip()
        *lines, self.tail = (self.tail + text).split("\n")
        if len(self.tail) > MAX_LINE_CHARACTERS:
            raise FormatError(
                f"it is not text; line {self._line_count + 1} does not end"
            )

        if lines:
            self._line_count += len(lines)
            yield lines


def _encoding(head: bytes) -> str:
    """Return the encoding of a text from its first bytes."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"

    if any(word in head for word in _SHIFT_JIS_WORDS):
        return _SHIFT_JIS

    first = head[0 : len(head) // 2 * 2 : 2]
    second = head[1 : len(head) // 2 * 2 : 2]
    if not first:
        return _UTF_8

    limit = MIN_NUL_FRACTION * len(first)
    if second.count(0) >= limit and not first.count(0):
        return _UTF_16_LITTLE
    if first.count(0) >= limit and not second.count(0):
        return _UTF_16_BIG

    return _UTF_8
