"""A URDF as a tree of links and joints, and what is checked before it is a model.

The URDF reader that Pinocchio uses (urdfdom) drops a link's whole ``<inertial>`` when
one number in it does not parse, and goes on with mass 0, or without inertia; the only
sign is a line on stderr. So the masses are added up here, and inertia is looked at.

It knows no namespaces, and neither does the parser here: a prefix that nothing
declares, as in Fetch's old ``<sensor:camera>``, stops no file.
"""

import re
from collections.abc import Iterable
from itertools import product
from math import isfinite
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

DIGITS_ONLY = "Write digits with a decimal point: no commas, formulas or units."
"""Advice for a number that the URDF reader does not read."""

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
    file = _parse(path)
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


def _parse(path: Path) -> Element:
    """Return the tree of an XML file without entities of its own.

    Names in a URDF are ASCII; what is not UTF-8 are comments of an exporter, in the
    code page of its author's machine: they are not read.
    """
    # The largest known description, with meshes' names and sensors of a humanoid, has
    # 0.5 MB.
    max_bytes = 1 << 23

    def refuse(*_: object) -> None:
        raise UrdfFileError(f"{path}: has a DOCTYPE, expected plain XML")

    builder = TreeBuilder()
    parser = expat.ParserCreate()
    parser.StartElementHandler = builder.start
    parser.EndElementHandler = builder.end
    parser.StartDoctypeDeclHandler = refuse
    try:
        # Not a pipe, device or folder: reading those may never end.
        if not path.is_file() or path.stat().st_size > max_bytes:
            raise UrdfFileError(
                f"{path}: is no file, or larger than {max_bytes} bytes", PLAIN_URDF
            )
        parser.Parse(path.read_bytes().decode("utf-8-sig", errors="replace"), True)
    except OSError as error:
        raise UrdfFileError(f"{path!s:.200}: cannot be read: {error}") from error
    except expat.ExpatError as error:
        raise UrdfFileError(f"{path}: is not well-formed XML: {error}") from error
    return builder.close()


def _remove_links(root: Element, without: set[str], source: str) -> None:
    """Remove links, the joints they hang on and everything behind them."""
    links = [link.get("name", "") for link in root.findall("link")]
    if unknown := sorted(without.difference(links)):
        raise UnknownNameError(
            f"{source}: cannot leave out {unknown}, there is no such link; links: "
            f"{', '.join(links)}"
        )
    removed = set(without)
    for _ in links if without else ():  # no chain is longer
        removed |= {
            child_of(joint)
            for joint in root.findall("joint")
            if parent_of(joint) in removed
        }
    for joint in root.findall("joint"):
        if child_of(joint) in removed:
            root.remove(joint)
    for link in root.findall("link"):
        if link.get("name") in removed:
            root.remove(link)
    if without and root.find("link") is None:
        raise InputError(f"{source}: cannot leave out {without}, the root of the robot")


def build_model(root: Element, source: str) -> pin.Model:
    """Return the Pinocchio model of a description, all of whose joints move.

    A continuous joint becomes a revolute one without limits: an angle, not a point on
    the circle. A link of mass 0 is no body, whatever its inertia. The URDF reader
    (urdfdom) may still refuse the description: `UrdfFileError`.
    """
    children = [child_of(joint) for joint in root.findall("joint")]
    if twice := sorted({name for name in children if children.count(name) > 1}):
        raise UrdfFileError(  # of all that is no tree, its reader takes this alone
            f"{source}: is not a valid URDF: {', '.join(twice)} hang on two joints"
        )
    _check_inertials(root, source)
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
    rounding = 1e-12  # relative, of sums of some hundred masses
    if not np.isclose(loaded_kg, written_kg, rtol=rounding, atol=0.0):
        raise UrdfFileError(
            f"{source}: the masses in the file add up to {written_kg:g} kg, those of "
            f"the loaded model to {loaded_kg:g} kg: its reader drops an <inertial> of "
            "which it cannot read a number, and names link and number on stderr",
            DIGITS_ONLY,
        )
    return model


def _check_inertials(root: Element, source: str) -> None:
    """Check what urdfdom would drop without a word; a link of mass 0 is no body.

    An origin that it cannot read shows in the sum of the masses: the mass goes, too.

    Raises:
        UrdfFileError: A mass or moment is no finite number.
    """
    # What urdfdom reads as a number: no nan, inf, hexadecimal, comma or _.
    number = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)
    moments = ("ixx", "ixy", "ixz", "iyy", "iyz", "izz")
    attributes = [("mass", "value"), *(("inertia", key) for key in moments)]
    for link in root.findall("link[inertial]"):
        for inertial, (tag, key) in product(link.findall("inertial"), attributes):
            text = read_attribute(inertial, tag, key)
            if not number.fullmatch(text) or not isfinite(float(text)):
                raise UrdfFileError(
                    f"{source}: link {link.get('name')!r}: <inertial> <{tag} "
                    f'{key}="{text}"> has to be a number; the URDF reader would drop '
                    "it",
                    DIGITS_ONLY,
                )
        if float(read_attribute(link, "inertial/mass", "value")) == 0.0:
            del link[:]


def read_attribute(element: Element, path: str, key: str) -> str:
    """Return an attribute of the first element at a path; empty without one."""
    found = element.find(path)
    return "" if found is None else found.get(key, "")


def parent_of(joint: Element) -> str:
    """Return the name of the link that carries a joint."""
    return read_attribute(joint, "parent", "link")


def child_of(joint: Element) -> str:
    """Return the name of the link that a joint moves."""
    return read_attribute(joint, "child", "link")


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
