"""Checks of a URDF before it becomes a model.

It must be readable, of a plausible size, supported and physical.

The URDF reader that Pinocchio uses (urdfdom) drops a link's whole ``<inertial>`` when
one number in it does not parse, and goes on with mass 0; the only sign is a line on
stderr. So every number of an inertial is parsed here first, as strictly as urdfdom
does.
"""

import re
import xml.etree.ElementTree as ElementTree
from collections.abc import Collection, Iterable
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from urdf.errors import (
    InputError,
    UnknownNameError,
    UnsupportedJointError,
    UrdfCode,
    UrdfFileError,
)
from urdf.payload import require_physical

MAX_LINKS = 1000
"""Most links of a robot; more are refused. urdfdom and Pinocchio recurse once per link
of a chain and end the process when the stack is used up (between 3000 and 6000 links at
8 MB). Assign a larger number to load a larger robot."""
_BYTES_PER_LINK = 64 * 1024  # a file of more than MAX_LINKS times this is not read
_ONE_NUMBER_JOINTS = ("revolute", "prismatic", "fixed")
_MOMENTS = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")  # in Pinocchio's order
# What urdfdom reads as a number: blanks before it but not after it, no nan, inf,
# hexadecimal or _.
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)


def read_description(path: Path, without: Iterable[str] = ()) -> Element:
    """Read the links, with their inertia, and the joints of a URDF file.

    Shapes, materials and extensions are dropped, and so are the links ``without`` with
    all that they carry. The errors of this file are those of `urdf.load_urdf`.
    """
    if isinstance(without, str):
        raise InputError(
            f"without is the string {without!r}, expected a list of link names"
        )
    text = _read_text(path)
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UrdfFileError(f"{path}: is not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise UrdfFileError(f"{path}: root element is <{root.tag}>, expected <robot>")
    if "http://www.ros.org/wiki/xacro" in text and "<xacro:" in text:
        raise UrdfFileError(
            f"{path}: is a xacro file, expected a plain URDF", UrdfCode.FILE
        )
    links = root.findall("link")
    if len(links) > MAX_LINKS:
        raise UrdfFileError(
            f"{path}: has {len(links)} links, more than {MAX_LINKS}; a chain of that "
            "depth can crash the URDF reader",
            UrdfCode.SIZE,
        )
    bare = Element(root.tag, root.attrib)
    for link in links:
        copy = Element(link.tag, link.attrib)
        copy.extend(
            _without_grandchildren(inertial)
            for inertial in link.findall("inertial")[:1]
        )
        bare.append(copy)
    bare.extend(_without_grandchildren(joint) for joint in root.findall("joint"))
    _remove_links(bare, without, str(path))
    return bare


def check_description(
    root: Element, source: str, *, locked: Collection[str], check_inertias: bool
) -> None:
    """Refuse joints that cannot be modelled, and inertias that do not parse.

    Joints that will be locked are not checked. With ``check_inertias`` an inertia that
    no rigid body can have is refused, too.
    """
    for joint in root.findall("joint"):
        name = joint.get("name", "")
        kind = joint.get("type")
        mimic = joint.find("mimic")
        if name not in locked and kind not in _ONE_NUMBER_JOINTS:
            raise UnsupportedJointError(
                f"{source}: joint {name!r} is of type {kind!r}, expected one of "
                f"{', '.join(_ONE_NUMBER_JOINTS)}"
            )
        if name not in locked and mimic is not None:
            raise UnsupportedJointError(
                f"{source}: joint {name!r} mimics {mimic.get('joint')!r}, so it "
                "does not move on its own"
            )
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is not None:
            owner = f"{source}: link {link.get('name')!r}"
            origin = inertial.find("origin")
            # Only parsed: a body is physical wherever it is, in any axes.
            for key in (
                () if origin is None else {"xyz", "rpy"}.intersection(origin.attrib)
            ):
                _numbers(inertial, "origin", key, owner, count=3)
            mass = _numbers(inertial, "mass", "value", owner)
            inertia = [_numbers(inertial, "inertia", key, owner)[0] for key in _MOMENTS]
            if check_inertias:
                require_physical(np.array([*mass, 0.0, 0.0, 0.0, *inertia]), owner)


def build_model(root: Element, source: str) -> pin.Model:
    """Return the Pinocchio model of a checked description.

    The URDF reader (urdfdom) may still refuse it: `UrdfFileError`.
    """
    try:
        model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise UrdfFileError(
            f"{source}: is not a valid URDF: {error} (its reader prints the reason on "
            "stderr)"
        ) from error
    written_kg = sum(
        float(mass.attrib["value"]) for mass in root.iterfind("link/inertial/mass[1]")
    )
    loaded_kg = sum(inertia.mass for inertia in model.inertias)
    # A second line of defence: another build of urdfdom may take other texts for
    # numbers.
    if abs(loaded_kg - written_kg) > 1e-9 * abs(written_kg):
        raise UrdfFileError(
            f"{source}: the masses in the file add up to {written_kg:g} kg, those of "
            f"the loaded model to {loaded_kg:g} kg; its reader has dropped an "
            "<inertial>, see stderr"
        )
    return model


def _read_text(path: Path) -> str:
    try:
        # Not a pipe, device or folder: reading those may never end.
        if not path.is_file():
            raise UrdfFileError(
                f"{path}: there is no such file; expected the path of a URDF file",
                UrdfCode.FILE,
            )
        if path.stat().st_size > MAX_LINKS * _BYTES_PER_LINK:
            raise UrdfFileError(
                f"{path}: is larger than any robot description "
                f"({MAX_LINKS * _BYTES_PER_LINK} bytes)",
                UrdfCode.SIZE,
            )
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UrdfFileError(
            f"{path!s:.200}: cannot be read as text: {error}", UrdfCode.FILE
        ) from error


def _without_grandchildren(element: Element) -> Element:
    copy = Element(element.tag, element.attrib)
    copy.extend(Element(child.tag, child.attrib) for child in element)
    return copy


def _remove_links(root: Element, without: Iterable[str], source: str) -> None:
    """Remove links, the joints they hang on and everything behind them."""
    links = {link.get("name"): link for link in root.findall("link")}
    joints = root.findall("joint")
    children = {_link_of(joint, "child") for joint in joints}
    gone: set[str | None] = set(without)
    for name in sorted(gone - set(links), key=str):
        known = ", ".join(str(link) for link in links)
        raise UnknownNameError(
            f"{source}: cannot leave out {name!r}, there is no such link; links: "
            f"{known}"
        )
    for name in gone - children:
        raise InputError(
            f"{source}: cannot leave out {name!r}, it is the root of the robot"
        )
    # A URDF may list its joints in any order: repeat until nothing more hangs on what
    # has gone.
    behind: set[str | None] = set()
    while behind != gone:
        behind = set(gone)
        gone |= {
            _link_of(joint, "child")
            for joint in joints
            if _link_of(joint, "parent") in gone
        }
    for joint in joints:
        if _link_of(joint, "child") in gone:
            root.remove(joint)
    for name in gone & set(links):
        root.remove(links[name])


def _link_of(joint: Element, end: str) -> str | None:
    element = joint.find(end)
    return None if element is None else element.get("link")


def _numbers(
    inertial: Element, tag: str, key: str, owner: str, count: int = 1
) -> list[float]:
    """Return the numbers of an attribute, or raise `UrdfFileError`.

    Vectors are split at blanks only, as urdfdom does it, not at tabs.
    """
    element = inertial.find(tag)
    text = None if element is None else element.get(key)
    if text is None:
        raise UrdfFileError(
            f"{owner}: <inertial> needs <{tag}> with the number {key}", UrdfCode.NUMBER
        )
    words = [text] if count == 1 else [word for word in text.split(" ") if word]
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    if len(numbers) != count or len(words) != count or not np.isfinite(numbers).all():
        expected = (
            "one number" if count == 1 else f"{count} numbers with blanks between them"
        )
        raise UrdfFileError(
            f'{owner}: <inertial> <{tag} {key}="{text}"> is not {expected}; the URDF '
            "reader would give the link no inertia at all",
            UrdfCode.NUMBER,
        )
    return numbers
