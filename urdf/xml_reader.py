"""Reads links and joints of a URDF file as lenient as the usual readers, bounded.

urdfdom and Pinocchio know no namespaces, take comments with ``--`` in them, and do not
look at what they do not use. So a prefix that nothing declares, as in Fetch's old
``<sensor:camera>``, stops no file here either.
"""

from pathlib import Path
from string import hexdigits
from xml.etree.ElementTree import Element
from xml.parsers import expat

from urdf.errors import KEEP_JOINTS, PLAIN_URDF, UrdfFileError

MAX_JOINTS = 499
"""Most joints of a robot, fixed ones included; more are refused while the file is read.
urdfdom and Pinocchio recurse once per link of a chain and end the process when the
stack is used up (between 3000 and 6000 links at 8 MB). Assign a larger number to load a
larger robot."""

MAX_BYTES = 1 << 26
"""Larger files are not read: the largest known description, with meshes' names and
sensors of a humanoid, has 0.5 MB."""

_XACRO_INSTRUCTIONS = frozenset(
    f"xacro:{name}"
    for name in ("include", "macro", "property", "arg", "if", "unless", "insert_block")
)
"""Elements of a file that xacro has still to expand; others it has left behind."""

_KEPT = {
    ("link",): frozenset({"inertial"}),
    ("link", "inertial"): frozenset({"origin", "mass", "inertia"}),
    ("joint",): frozenset({"parent", "child", "origin", "axis", "limit", "mimic"}),
}
"""What is kept below an element of a robot; all the rest is not used."""

_CONTROLS = {
    code: " " for code in range(ord(" ")) if chr(code) not in ("\t", "\n", "\r")
}
"""Characters that XML forbids, each with what is read in its place."""


def read_links_and_joints(path: Path) -> Element:
    """Read the links, with their inertia, and the joints of a URDF file.

    Raises:
        UrdfFileError: Missing, unreadable, malformed or too large a file.
    """
    text = _read_text(path)
    collector = _Collector(str(path))
    parser = expat.ParserCreate()
    parser.StartElementHandler = collector.start
    parser.EndElementHandler = collector.end
    try:
        parser.Parse(_tolerated(text), True)
    except expat.ExpatError as error:
        raise UrdfFileError(f"{path}: is not well-formed XML: {error}") from error
    root = collector.finish()
    root.attrib.setdefault("name", path.stem)  # urdfdom wants one, nobody else does
    return root


class _Collector:
    """Builds the tree of what is kept, and refuses what is no single robot.

    Args:
        source: Name of the file, for messages.

    Attributes:
        root: The robot, as far as it was read.
    """

    def __init__(self, source: str) -> None:
        self.root = Element("")
        self._source = source
        self._open: list[Element | None] = []  # None for what is not kept
        self._counts = {"link": 0, "joint": 0}
        self._has_xacro = False

    def start(self, tag: str, attributes: dict[str, str]) -> None:
        """Take the start of an element."""
        self._has_xacro = self._has_xacro or tag.startswith("xacro:")
        if tag in _XACRO_INSTRUCTIONS:
            raise _xacro_error(self._source)
        element = None
        if not self._open:
            self._refuse_other_root(tag)
            element = self.root = Element(tag, attributes)
        elif self._is_kept(tag):
            parent = self._open[-1]
            element = Element(tag, attributes)
            if parent is not None:
                parent.append(element)
        self._open.append(element)

    def end(self, _tag: str) -> None:
        """Take the end of an element."""
        self._open.pop()

    def finish(self) -> Element:
        """Return the robot; refuse one whose links xacro has still to make."""
        if self._has_xacro and not self._counts["link"]:
            raise _xacro_error(self._source)
        return self.root

    def _is_kept(self, tag: str) -> bool:
        """Return whether an element below the open ones is kept; count joints."""
        if self._open[-1] is None:
            return False
        if len(self._open) == 1:
            if tag not in self._counts:
                return False
            self._counts[tag] += 1
            self._refuse_large()
            return True
        above = tuple(element.tag for element in self._open[1:] if element is not None)
        # As urdfdom does it, the first of its kind counts.
        is_first = self._open[-1].find(tag) is None
        return is_first and tag in _KEPT.get(above, ())

    def _refuse_other_root(self, tag: str) -> None:
        if tag != "robot":
            raise UrdfFileError(
                f"{self._source}: root element is <{tag}>, expected <robot>"
            )

    def _refuse_large(self) -> None:
        """Refuse at the first joint too many, so that the rest is not read."""
        links = self._counts["link"]
        joints = self._counts["joint"]
        if joints <= MAX_JOINTS and links <= MAX_JOINTS + 1:
            return
        raise UrdfFileError(
            f"{self._source}: has more than {MAX_JOINTS} joints or {MAX_JOINTS + 1} "
            "links, expected the description of one robot",
            KEEP_JOINTS,
        )


def _xacro_error(source: str) -> UrdfFileError:
    return UrdfFileError(
        f"{source}: is a xacro file, expected a plain URDF", PLAIN_URDF
    )


def _read_text(path: Path) -> str:
    try:
        # Not a pipe, device or folder: reading those may never end.
        if not path.is_file():
            raise UrdfFileError(
                f"{path}: there is no such file; expected the path of a URDF file",
                PLAIN_URDF,
            )
        if path.stat().st_size > MAX_BYTES:
            raise UrdfFileError(
                f"{path}: is larger than any robot description ({MAX_BYTES} bytes)",
                KEEP_JOINTS,
            )
        return _decode(path.read_bytes())
    except (OSError, UnicodeDecodeError) as error:
        raise UrdfFileError(
            f"{path!s:.200}: cannot be read as text: {error}", PLAIN_URDF
        ) from error


def _decode(data: bytes) -> str:
    """Return the text of a file; single bytes where it is not UTF-8.

    Names in a URDF are ASCII; what is not UTF-8 are comments of an exporter, in the
    code page of its author's machine. Binary data are refused.
    """
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError:
        if b"\0" in data:
            raise
        return data.decode("latin-1")


def _tolerated(text: str) -> str:
    """Return a text without what urdfdom and Pinocchio pass over and expat does not.

    It is gone through once: a file may be anybody's.
    """
    text = _cut_out(text, "<!--", "-->")
    text = _cut_out(text, "<?xml", "?>")
    before, *after = text.split("&")
    text = before + "".join(_ampersand_before(rest) + rest for rest in after)
    return text.translate(_CONTROLS)


def _cut_out(text: str, start: str, end: str) -> str:
    """Return a text without what stands between two marks, but for its line ends.

    With them an error names the right line. What is not closed stays, for the parser to
    refuse.
    """
    kept: list[str] = []
    place = 0
    while (begin := text.find(start, place)) >= 0:
        stop = text.find(end, begin + len(start))
        if stop < 0:
            break
        kept += [text[place:begin], "\n" * text.count("\n", begin, stop)]
        place = stop + len(end)
    return "".join([*kept, text[place:]])


def _ampersand_before(rest: str) -> str:
    """Return how an ampersand is read before a text: alone unless a name follows."""
    name, end, _ = rest.partition(";")
    if name.startswith("#x"):
        is_name = name[2:] != "" and all(digit in hexdigits for digit in name[2:])
    elif name.startswith("#"):
        is_name = name[1:].isdecimal()
    else:
        is_name = name.replace("_", "a").isalnum()
    return "&" if end and is_name else "&amp;"
