"""Names of labels in the header of a NIfTI file, as TotalSegmentator writes them.

The header is followed by extensions: size and kind, four bytes each, then the content
of size - 8 bytes. That of TotalSegmentator is the XML text of a Caret label table:
``<Label Key="5" ...><![CDATA[liver]]></Label>``.
"""

import gzip
import struct
import zlib
from pathlib import Path
from xml.etree import ElementTree

from needleforce.anatomy.errors import EXPORT_LABELS, VolumeError


def read_header_names(path: Path) -> dict[int, str]:
    """Return names by label from the extensions of a NIfTI file, if it has any.

    Raises:
        VolumeError: There is a table of labels, and it cannot be read.
    """
    names: dict[int, str] = {}
    for content in _read_extensions(path):
        if b"<Label" not in content:
            continue
        try:
            # Decoded before it is looked at, and parsed as text: whatever encoding the
            # XML declares, the parser sees what was checked here.
            text = content.rstrip(b"\0").decode("utf-8-sig").strip()
            if "<!DOCTYPE" in text or "<!ENTITY" in text:
                continue
            root = ElementTree.fromstring(text)
            for label in root.iter("Label"):
                names[int(label.attrib["Key"])] = (label.text or "").strip()
        except (ElementTree.ParseError, KeyError, ValueError) as error:
            raise VolumeError(
                f"the table of labels in the header of {path} cannot be read: {error}",
                EXPORT_LABELS,
            ) from error
    return {value: name for value, name in names.items() if name}


def _read_extensions(path: Path) -> list[bytes]:
    """Return the contents of the extensions behind the header."""
    extension_head_bytes = 8
    max_extension_bytes = 1 << 22  # more than the names of a thousand labels take
    offset_at = 108  # where the header says at which byte the voxels begin
    # Of NIfTI-1, before the four bytes that say whether extensions follow.
    header_bytes = 348
    try:
        with gzip.open(path) if path.name.endswith(".gz") else path.open("rb") as file:
            header = file.read(header_bytes + 4)
            if len(header) < header_bytes + 4 or not header[header_bytes]:
                return []
            order = "<" if struct.unpack_from("<i", header)[0] == header_bytes else ">"
            end = int(struct.unpack_from(f"{order}f", header, offset_at)[0])
            length = min(max(end - header_bytes - 4, 0), max_extension_bytes)
            block = file.read(length)
    except (OSError, EOFError, zlib.error):
        return []  # what is wrong with the file is said where its voxels are read
    contents: list[bytes] = []
    place = 0
    while place + extension_head_bytes <= len(block):
        size = struct.unpack_from(f"{order}i", block, place)[0]
        if size < extension_head_bytes:
            break
        contents.append(block[place + extension_head_bytes : place + size])
        place += size
    return contents
