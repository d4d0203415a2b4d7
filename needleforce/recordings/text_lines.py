"""The lines of a text, plain or compressed with gzip, as its bytes come."""

import codecs
import io
import re
import zlib
from collections.abc import Iterable, Iterator
from itertools import chain

from needleforce.recordings.channels import Knowledge
from needleforce.recordings.column_names import known_names
from needleforce.recordings.errors import KNOWN_SUFFIX, FormatError
from needleforce.recordings.follow import BINARY, MAX_BLOCK_BYTES, head_of

_CUT_SHORT = "the compressed file is cut short"
_DAMAGED = "the compressed file is damaged"

_UTF_8 = "utf-8-sig"
_NUL = "\0"
_WINDOWS_CHARACTERS = {
    0xDC00 + byte: bytes([byte]).decode("cp1252", "replace") for byte in range(128, 256)
}
"""What bytes that are no UTF-8, as Python escapes them, mean in Windows text."""


class TextLines:
    """Iterates over the whole lines of a text, in lists of those that came together.

    Text compressed with gzip is unpacked, whatever its suffix, and line ends may be of
    any kind. UTF-16 is known by its mark or by its NUL bytes; what else is not UTF-8,
    by the names and units that it holds, or it is Windows text. NUL bytes in a row, as
    a power loss may leave them, become one such character, so that they cost the line
    in which they stand.

    Attributes:
        tail: What stands behind the last line end, once all is read.
        size: Bytes of text so far.
        warnings: What was lost or guessed.
    """

    def __init__(self, blocks: Iterable[bytes], knowledge: Knowledge) -> None:
        self._blocks = blocks
        self._knowledge = knowledge
        self._line_count = 0
        self._fault = ""
        self._is_blank = True
        self._is_nul = False
        self.tail = ""
        self.size = 0
        self.warnings: list[str] = []

    def __iter__(self) -> Iterator[list[str]]:
        """Yield the lines, without their ends; `FormatError` if there is no text."""
        # A kilobyte is waited for to see the encoding, and as much looked at as came.
        _, blocks = head_of(self._plain_blocks(), 1024)
        head = next(blocks, b"")
        encoding = _encoding(head[: 1 << 16], self._knowledge)
        if not encoding.startswith("utf"):
            self.warnings.append(f"the file is not UTF-8; it was read as {encoding}")

        errors = "surrogateescape" if encoding == _UTF_8 else "replace"
        decoder = io.IncrementalNewlineDecoder(
            codecs.getincrementaldecoder(encoding)(errors), translate=True
        )
        nul_bytes = 0
        for block in chain([head], blocks):
            self.size += len(block)
            yield from self._split(decoder.decode(block))
            # After so many in a row nothing more is expected of a file.
            max_nul_bytes = 1 << 24
            nul_bytes = 0 if block.strip(b"\0") else nul_bytes + len(block)
            if nul_bytes > max_nul_bytes:
                break

        yield from self._split(decoder.decode(b"", final=True))
        if _NUL in self.tail:
            self._fault = self._fault or (
                "the file goes on with NUL bytes, as power loss may leave them"
            )
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
            raise FormatError(f"it is {kind}, not text", KNOWN_SUFFIX)

        yield from self._gunzip(blocks) if head.startswith(b"\x1f\x8b") else blocks

    def _gunzip(self, blocks: Iterable[bytes]) -> Iterator[bytes]:
        """Yield unpacked blocks of at most `MAX_BLOCK_BYTES`.

        A megabyte of gzip can hold a gigabyte.
        """
        window = 31  # for zlib: the largest, with the head and checksum of gzip
        member = zlib.decompressobj(window)
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
                        member = zlib.decompressobj(window)
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
            text = re.sub("\0+", _NUL, text)

        self._is_blank = self._is_blank and not text.replace(_NUL, "").strip()
        *lines, self.tail = (self.tail + text).split("\n")
        max_characters = 1 << 24
        if len(self.tail) > max_characters:
            raise FormatError(
                f"it is not text; line {self._line_count + 1} does not end"
            )

        if lines:
            self._line_count += len(lines)
            yield lines


def _encoding(head: bytes, knowledge: Knowledge) -> str:
    """Return the encoding of a text from its first bytes."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"

    # Without a mark every second byte of letters, digits and separators is NUL.
    first = head[0 : len(head) // 2 * 2 : 2]
    second = head[1 : len(head) // 2 * 2 : 2]
    min_count = max(0.7 * len(first), 1)
    if second.count(0) >= min_count and not first.count(0):
        return "utf-16-le"
    if first.count(0) >= min_count and not second.count(0):
        return "utf-16-be"

    try:
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        best = max(
            knowledge.encodings, key=lambda name: _known_words(head, name, knowledge)
        )
        return _UTF_8 if best == "cp1252" else best

    return _UTF_8


def _known_words(head: bytes, encoding: str, knowledge: Knowledge) -> int:
    """Return how many names and units stand in the lines that are no ASCII."""
    lines = [line for line in head.splitlines()[:-1] if not line.isascii()][:20]
    try:
        text = "\t".join(line.decode(encoding) for line in lines)
    except UnicodeDecodeError:
        return -1

    cells = [cell for cell in re.split(r'[,;\t"]', text) if cell.strip()]
    return known_names(cells, knowledge) + sum(map(knowledge.is_unit, cells))
