"""What a URDF must be before it becomes a model: readable, supported joints, physical inertias."""

import xml.etree.ElementTree as ElementTree
from collections.abc import Container
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from urdf.errors import UnsupportedJointError, UrdfFileError
from urdf.inertia import parameters_about_com, require_physical

_ONE_NUMBER_JOINTS = ("revolute", "prismatic", "fixed")


def read_description(path: Path) -> str:
    """Return the text of a robot description.

    Raises:
        UrdfFileError: Missing, a folder, not readable or not text.
    """
    if not path.is_file():
        raise UrdfFileError(f"{path}: there is no such file; expected the path of a URDF file")
    try:
        return path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise UrdfFileError(f"{path}: cannot be read as text: {error}") from error


def check_description(
    text: str, source: str, *, locked: Container[str], check_inertias: bool
) -> None:
    """Check a URDF's text.

    Args:
        text: The URDF.
        source: Where it came from, for messages.
        locked: Names of joints that will be locked, of whatever kind they are.
        check_inertias: Whether every link's inertia must be physical.

    Raises:
        UrdfFileError: Not XML, not a URDF, or numbers missing.
        UnsupportedJointError: A joint with more than one number, or one that mimics another.
        InertiaError: A link with inertia no rigid body can have.
    """
    root = _parse(text, source)
    for joint in root.findall("joint"):
        if joint.get("name", "") not in locked:
            _check_joint(joint, source)
    if check_inertias:
        for link in root.findall("link"):
            _check_link(link, source)


def _parse(text: str, source: str) -> ElementTree.Element:
    try:
        root = ElementTree.fromstring(text)
    except ElementTree.ParseError as error:
        raise UrdfFileError(f"{source}: is not well-formed XML: {error}") from error
    if root.tag != "robot":
        raise UrdfFileError(f"{source}: root element is <{root.tag}>, expected <robot>")
    if "http://www.ros.org/wiki/xacro" in text and "<xacro:" in text:
        raise UrdfFileError(f"{source}: is a xacro file; expand it to a plain URDF first")
    return root


def _check_joint(joint: ElementTree.Element, source: str) -> None:
    name, kind = joint.get("name"), joint.get("type")
    if kind not in _ONE_NUMBER_JOINTS:
        raise UnsupportedJointError(
            f"{source}: joint {name!r} is of type {kind!r}, expected one of "
            f"{', '.join(_ONE_NUMBER_JOINTS)}; "
            "lock it with locked_joints, or give a continuous joint limits and call it revolute"
        )
    mimic = joint.find("mimic")
    if mimic is not None:
        raise UnsupportedJointError(
            f"{source}: joint {name!r} mimics {mimic.get('joint')!r}, so it does not move on its "
            "own; lock it with locked_joints"
        )


def _check_link(link: ElementTree.Element, source: str) -> None:
    inertial = link.find("inertial")
    if inertial is None:
        return
    owner = f"{source}: link {link.get('name')!r}"
    mass = _numbers(inertial, "mass", ("value",), owner)[0]
    xx, xy, xz, yy, yz, zz = _numbers(
        inertial, "inertia", ("ixx", "ixy", "ixz", "iyy", "iyz", "izz"), owner
    )
    inertia = np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]])
    # Physical or not does not depend on where the centre of mass is, nor on the axes: leave the
    # origin out.
    require_physical(parameters_about_com(mass, np.zeros(3), inertia), owner)


def _numbers(
    inertial: ElementTree.Element, tag: str, keys: tuple[str, ...], owner: str
) -> NDArray[np.float64]:
    element = inertial.find(tag)
    try:
        return np.array([float(element.attrib[key]) for key in keys])  # type: ignore[union-attr]
    except (AttributeError, KeyError, ValueError) as error:
        raise UrdfFileError(
            f"{owner}: <inertial> needs <{tag}> with the numbers {', '.join(keys)}; "
            f"problem: {error}"
        ) from error
