"""A URDF as a tree of links and joints, and what is checked before it is a model.

The URDF reader that Pinocchio uses (urdfdom) drops a link's whole ``<inertial>`` when
one number in it does not parse, and goes on with mass 0; the only sign is a line on
stderr. So every number of an inertial is parsed here first, and the masses are added
up. It knows no namespaces, and neither does the parser here: a prefix that nothing
declares, as in Fetch's old ``<sensor:camera>``, stops no file.
"""

import re
from collections.abc import Iterable
from pathlib import Path
from xml.etree.ElementTree import Element, SubElement, TreeBuilder, tostring
from xml.parsers import expat

import numpy as np
import pinocchio as pin

from urdf.errors import (
    KEEP_JOINTS,
    PLAIN_URDF,
    InputError,
    UnknownNameError,
    UrdfFileError,
)

MAX_JOINTS = 499
"""Most joints of a robot, fixed ones included. urdfdom and Pinocchio recurse once per
link of a chain and end the process when the stack is used up (between 3000 and 6000
links at 8 MB). Assign a larger number to load a larger robot."""

_KEPT = {
    "link": {"inertial"},
    "joint": {"parent", "child", "origin", "axis", "limit", "mimic"},
}
"""What is kept of links and joints; all the rest is not used."""


def read_description(path: Path, without: Iterable[str] = ()) -> Element:
    """Read the links, with their inertia, and the joints of a URDF file.

    Shapes, materials and extensions are dropped, and so are the links ``without`` with
    all that they carry. The errors of this file are those of `urdf.load_urdf`.
    """
    file = _parse(_read_text(path), path)
    if file.tag != "robot" or any(part.tag.startswith("xacro:") for part in file):
        raise UrdfFileError(
            f"{path}: is <{file.tag}> or has xacro tags, expected <robot> with none",
            PLAIN_URDF,
        )
    root = Element("robot", name=file.get("name", path.stem))
    for element in file:
        if element.tag in _KEPT:
            kept = SubElement(root, element.tag, element.attrib)
            kept.extend(part for part in element if part.tag in _KEPT[element.tag])
    if max(len(root.findall("joint")), len(root.findall("link")) - 1) > MAX_JOINTS:
        raise UrdfFileError(
            f"{path}: has more than {MAX_JOINTS} joints or {MAX_JOINTS + 1} links, "
            "expected the description of one robot",
            KEEP_JOINTS,
        )
    _remove_links(root, set(without), str(path))
    return root


def _read_text(path: Path) -> str:
    """Return the text of a file.

    Names in a URDF are ASCII; what is not UTF-8 are comments of an exporter, in the
    code page of its author's machine: they are not read.
    """
    # The largest known description, with meshes' names and sensors of a humanoid, has
    # 0.5 MB.
    max_bytes = 1 << 23
    try:
        # Not a pipe, device or folder: reading those may never end.
        if not path.is_file() or path.stat().st_size > max_bytes:
            raise UrdfFileError(
                f"{path}: is no file, or larger than {max_bytes} bytes", PLAIN_URDF
            )
        return path.read_bytes().decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise UrdfFileError(f"{path!s:.200}: cannot be read: {error}") from error


def _parse(text: str, path: Path) -> Element:
    """Return the tree of an XML text without entities of its own."""

    def refuse(*_: object) -> None:
        raise UrdfFileError(f"{path}: has a DOCTYPE, expected plain XML")

    builder = TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.StartDoctypeDeclHandler = refuse
    try:
        parser.Parse(text, True)
    except expat.ExpatError as error:
        raise UrdfFileError(f"{path}: is not well-formed XML: {error}") from error
    return builder.close()


def _remove_links(root: Element, without: set[str], source: str) -> None:
    """Remove links, the joints they hang on and everything behind them."""
    links = {link.get("name", ""): link for link in root.findall("link")}
    if unknown := sorted(without - links.keys()):
        raise UnknownNameError(
            f"{source}: cannot leave out {unknown}, there is no such link; links: "
            f"{', '.join(links)}"
        )
    waiting = list(without)
    while waiting:
        parent = waiting.pop()
        for joint in root.findall("joint"):
            child = link_of(joint, "child")
            if child == parent:
                root.remove(joint)
            elif link_of(joint, "parent") == parent:
                waiting.append(child)
        if links[parent] in list(root):
            root.remove(links[parent])
    if without and root.find("link") is None:
        raise InputError(f"{source}: cannot leave out {without}, the root of the robot")


def build_model(root: Element, source: str) -> pin.Model:
    """Return the Pinocchio model of a description, all of whose joints move.

    A continuous joint becomes a revolute one without limits: an angle, not a point on
    the circle. The URDF reader (urdfdom) may still refuse it: `UrdfFileError`.
    """
    children = [link_of(joint, "child") for joint in root.findall("joint")]
    if twice := sorted({name for name in children if children.count(name) > 1}):
        raise UrdfFileError(  # of all that is no tree, its reader takes this alone
            f"{source}: is not a valid URDF: {', '.join(twice)} hang on two joints"
        )
    for link in root.findall("link"):
        _check_inertial(link, source)
    for joint in root.findall("joint"):
        if joint.get("type") != "fixed":
            _complete_limits(joint)
    try:
        model = pin.buildModelFromXML(tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise UrdfFileError(
            f"{source}: is not a valid URDF: {error} (its reader prints the reason on "
            "stderr)"
        ) from error
    # Absent limits, and those that leave no room: an exporter has written zeros.
    has_no_room = model.lowerPositionLimit >= model.upperPositionLimit
    model.lowerPositionLimit[has_no_room] = -np.inf
    model.upperPositionLimit[has_no_room] = np.inf
    masses = root.iterfind("link/inertial/mass[1]")
    written_kg = sum(float(mass.attrib["value"]) for mass in masses)
    loaded_kg = sum(inertia.mass for inertia in model.inertias)
    if not abs(loaded_kg - written_kg) <= 1e-9 * abs(written_kg):
        raise UrdfFileError(
            f"{source}: the masses in the file add up to {written_kg:g} kg, those of "
            f"the loaded model to {loaded_kg:g} kg; its reader has dropped an "
            "<inertial>, see stderr"
        )
    return model


def link_of(joint: Element, end: str) -> str:
    """Return the name of a joint's link at the end ``parent`` or ``child``."""
    element = joint.find(end)
    return "" if element is None else element.get("link", "")


def read_numbers(
    element: Element, tag: str, key: str, owner: str, count: int = 1
) -> list[float]:
    """Return the finite numbers of an attribute of a child of an element.

    Raises:
        UrdfFileError: It is missing, or not so many numbers.
    """
    child = element.find(tag)
    text = "" if child is None else child.get(key, "")
    # What urdfdom reads as a number: no nan, inf, hexadecimal, comma or _.
    number = re.compile(r"[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
    words = text.split() if count > 1 else [text.lstrip()]
    numbers = [float(word) for word in words if number.fullmatch(word)]
    if len(numbers) != count or len(words) != count or not np.isfinite(numbers).all():
        raise UrdfFileError(
            f'{owner}: <{element.tag}> <{tag} {key}="{text}"> has to be {count} '
            "numbers with blanks between them; the URDF reader would drop it",
            "Write digits with a decimal point: no commas, formulas or units.",
        )
    return numbers


def _check_inertial(link: Element, source: str) -> None:
    """Parse all numbers of a link's inertial; remove it where the mass is 0: no body.

    Raises:
        UrdfFileError: One that urdfdom would not read.
    """
    inertial = link.find("inertial")
    if inertial is None:
        return
    owner = f"{source}: link {link.get('name')!r}"
    mass_kg = read_numbers(inertial, "mass", "value", owner)
    for key in ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"):
        read_numbers(inertial, "inertia", key, owner)
    origin = inertial.find("origin")
    written = () if origin is None else {"xyz", "rpy"}.intersection(origin.attrib)
    for key in written:
        read_numbers(inertial, "origin", key, owner, count=3)
    if mass_kg == [0.0]:
        link.remove(inertial)


def _complete_limits(joint: Element) -> None:
    """Write limits of a joint that its reader takes; a negative or absent one is 0.

    That stands for a torque or velocity that is not known, and for a position without
    limits, as that of a continuous joint is.
    """
    limit = joint.find("limit")
    if limit is None:
        limit = SubElement(joint, "limit")
    for key in ("effort", "velocity"):
        if limit.get(key, "-").strip().startswith("-"):
            limit.set(key, "0")
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
        limit.set("lower", "0")
        limit.set("upper", "0")
