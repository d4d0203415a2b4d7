"""A URDF as a tree of links and joints, and what is checked before it is a model.

The URDF reader that Pinocchio uses (urdfdom) drops a link's whole ``<inertial>`` when
one number in it does not parse, and goes on with mass 0; the only sign is a line on
stderr. So every number of an inertial is parsed here first, as strictly as urdfdom
does.
"""

import re
from collections import Counter
from collections.abc import Iterable
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from urdf.errors import InputError, UnknownNameError, UrdfFileError
from urdf.xml_reader import read_links_and_joints

_MOMENTS = ("ixx", "ixy", "iyy", "ixz", "iyz", "izz")  # in Pinocchio's order
# What urdfdom reads as a number: blanks before it but not after it, no nan, inf,
# hexadecimal or _.
_NUMBER = re.compile(r"\s*[+-]?(\d+\.?\d*|\.\d+)([eE][+-]?\d+)?", re.ASCII)

# What Pinocchio takes for a limit of a joint that has none; replaced by infinity.


def read_description(path: Path, without: Iterable[str] = ()) -> Element:
    """Read the links, with their inertia, and the joints of a URDF file.

    Shapes, materials and extensions are dropped, and so are the links ``without`` with
    all that they carry. The errors of this file are those of `urdf.load_urdf`.
    """
    if isinstance(without, str):
        raise InputError(
            f"without is the string {without!r}, expected a list of link names"
        )
    root = read_links_and_joints(path)
    _remove_links(root, without, str(path))
    return root


def read_bodies(root: Element, source: str) -> dict[str, Array]:
    """Return the ten inertial parameters of every link that may matter, by its name.

    A link fixed to the ground never moves, and mass 0 is no body: their ``<inertial>``
    is removed from the tree. See `urdf.payload` for the order of the parameters, which
    are about the centre of mass, in the axes of the inertial frame.

    Raises:
        UrdfFileError: A number of another link does not parse.
    """
    grounded = _grounded_links(root)
    bodies: dict[str, Array] = {}
    for link in root.findall("link"):
        inertial = link.find("inertial")
        if inertial is None:
            continue
        name = link.get("name", "")
        if name in grounded:
            link.remove(inertial)
            continue
        owner = f"{source}: link {name!r}"
        mass_kg = read_numbers(inertial, "mass", "value", owner)[0]
        if mass_kg == 0.0:
            link.remove(inertial)
            continue
        origin = inertial.find("origin")
        keys = () if origin is None else {"xyz", "rpy"}.intersection(origin.attrib)
        for key in keys:  # only parsed: a body is possible wherever it is, in any axes
            read_numbers(inertial, "origin", key, owner, count=3)
        moments = [read_numbers(inertial, "inertia", key, owner)[0] for key in _MOMENTS]
        bodies[name] = np.array([mass_kg, 0.0, 0.0, 0.0, *moments])
    return bodies


def build_model(root: Element, source: str) -> pin.Model:
    """Return the Pinocchio model of a checked description.

    A continuous joint becomes a revolute one without limits: an angle, not a point on
    the circle. The URDF reader (urdfdom) may still refuse it: `UrdfFileError`.
    """
    _require_tree(root, source)
    unlimited: set[str] = set()
    for joint in root.findall("joint"):
        for mimic in joint.findall("mimic"):
            joint.remove(mimic)
        if joint.get("type") != "fixed" and not _complete_limits(joint):
            unlimited.add(joint.get("name", ""))
    try:
        model = pin.buildModelFromXML(ElementTree.tostring(root, encoding="unicode"))
    except (ValueError, RuntimeError) as error:
        raise UrdfFileError(
            f"{source}: is not a valid URDF: {error} (its reader prints the reason on "
            "stderr)"
        ) from error
    _free_limits(model, unlimited)
    _require_all_mass(root, model, source)
    return model


def link_of(joint: Element, end: str) -> str | None:
    """Return the name of a joint's link at the end ``parent`` or ``child``."""
    element = joint.find(end)
    return None if element is None else element.get("link")


def read_numbers(
    element: Element, tag: str, key: str, owner: str, count: int = 1
) -> list[float]:
    """Return the numbers of an attribute of a child of an element.

    Vectors are split at blanks only, as urdfdom does it, not at tabs.

    Raises:
        UrdfFileError: It is missing, or not so many numbers.
    """
    child = element.find(tag)
    text = None if child is None else child.get(key)
    if text is None:
        raise UrdfFileError(
            f"{owner}: <{element.tag}> needs <{tag}> with the number {key}",
            "Write digits with a decimal point: no commas, formulas, units or blanks.",
        )
    words = [text] if count == 1 else [word for word in text.split(" ") if word]
    numbers = [float(word) for word in words if _NUMBER.fullmatch(word)]
    if len(numbers) != count or len(words) != count or not np.isfinite(numbers).all():
        expected = (
            "one number" if count == 1 else f"{count} numbers with blanks between them"
        )
        raise UrdfFileError(
            f'{owner}: <{element.tag}> <{tag} {key}="{text}"> is not {expected}; the '
            "URDF reader would drop it",
            "Write digits with a decimal point: no commas, formulas, units or blanks.",
        )
    return numbers


def _require_tree(root: Element, source: str) -> None:
    """Refuse what is no tree of links; the URDF reader says so on stderr only."""
    links = [link.get("name") for link in root.findall("link")]
    joints = root.findall("joint")
    children = [link_of(joint, "child") for joint in joints]
    faults = [f"link {name!r} stands twice" for name in _repeated(links)]
    names = [joint.get("name") for joint in joints]
    faults += [f"joint {name!r} stands twice" for name in _repeated(names)]
    faults += [f"link {name!r} hangs on two joints" for name in _repeated(children)]
    for joint in joints:
        faults += [
            f"joint {joint.get('name')!r} has the {end} link {link_of(joint, end)!r}, "
            "which is not there"
            for end in ("parent", "child")
            if link_of(joint, end) not in links
        ]
    roots = [str(link) for link in links if link not in children]
    if not faults and len(roots) != 1:
        faults.append(
            f"{len(roots)} links hang on nothing, expected one: {', '.join(roots)}"
        )
    if faults:
        raise UrdfFileError(f"{source}: is not a valid URDF: {'; '.join(faults)}")


def _repeated(names: Iterable[str | None]) -> list[str | None]:
    """Return the names that stand twice, each once."""
    return [name for name, count in Counter(names).items() if count > 1]


def _complete_limits(joint: Element) -> bool:
    """Write limits of a joint that its reader takes; a negative or absent one is 0.

    That stands for a torque or velocity that is not known.

    Returns:
        Whether its position has limits: not that of a continuous joint, nor where they
        are absent or leave no room, as where an exporter has written zeros.
    """
    unlimited = "1e9"
    limit = joint.find("limit")
    if limit is None:
        limit = Element("limit")
        joint.append(limit)
    for key in ("effort", "velocity"):
        if limit.get(key, "-").strip().startswith("-"):
            limit.set(key, "0")
    bounds = [limit.get(key, "0") for key in ("lower", "upper")]
    is_read = all(map(_NUMBER.fullmatch, bounds))
    is_limited = not is_read or float(bounds[0]) < float(bounds[1])
    if joint.get("type") == "continuous":
        joint.set("type", "revolute")
        is_limited = False
    if not is_limited:
        limit.set("lower", f"-{unlimited}")
        limit.set("upper", unlimited)
    return is_limited


def _free_limits(model: pin.Model, names: set[str]) -> None:
    """Set the limits of the positions of these joints to infinity."""
    lower_rad = model.lowerPositionLimit.copy()
    upper_rad = model.upperPositionLimit.copy()
    for name, joint in zip(list(model.names), list(model.joints), strict=True):
        if name in names:
            lower_rad[joint.idx_q] = -np.inf
            upper_rad[joint.idx_q] = np.inf
    model.lowerPositionLimit = lower_rad
    model.upperPositionLimit = upper_rad


def _require_all_mass(root: Element, model: pin.Model, source: str) -> None:
    """Refuse a model that has another mass than its description.

    A second line of defence: another build of urdfdom may take other texts for numbers.
    """
    written_kg = sum(
        float(mass.attrib["value"]) for mass in root.iterfind("link/inertial/mass[1]")
    )
    loaded_kg = sum(inertia.mass for inertia in model.inertias)
    if abs(loaded_kg - written_kg) > 1e-9 * abs(written_kg):
        raise UrdfFileError(
            f"{source}: the masses in the file add up to {written_kg:g} kg, those of "
            f"the loaded model to {loaded_kg:g} kg; its reader has dropped an "
            "<inertial>, see stderr"
        )


def _grounded_links(root: Element) -> set[str | None]:
    """Return the links that no moving joint carries."""
    children = {link_of(joint, "child") for joint in root.findall("joint")}
    grounded = {link.get("name") for link in root.findall("link")} - children
    fixed = {
        link_of(joint, "child"): link_of(joint, "parent")
        for joint in root.findall("joint")
        if joint.get("type") == "fixed"
    }
    return _reached_from(grounded, fixed)


def _reached_from(
    start: set[str | None], parents: dict[str | None, str | None]
) -> set[str | None]:
    """Return some links and all that hang on them, by each link's parent."""
    carried: dict[str | None, list[str | None]] = {}
    for child, parent in parents.items():
        carried.setdefault(parent, []).append(child)
    reached = set(start)
    waiting = list(start)
    while waiting:
        children = carried.get(waiting.pop(), ())
        new = [child for child in children if child not in reached]
        reached.update(new)
        waiting += new
    return reached


def _remove_links(root: Element, without: Iterable[str], source: str) -> None:
    """Remove links, the joints they hang on and everything behind them."""
    links = {link.get("name"): link for link in root.findall("link")}
    joints = root.findall("joint")
    parents = {link_of(joint, "child"): link_of(joint, "parent") for joint in joints}
    left_out: set[str | None] = set(without)
    for name in sorted(left_out - set(links), key=str):
        known = ", ".join(str(link) for link in links)
        raise UnknownNameError(
            f"{source}: cannot leave out {name!r}, there is no such link; links: "
            f"{known}"
        )
    for name in left_out - set(parents):
        raise InputError(
            f"{source}: cannot leave out {name!r}, it is the root of the robot"
        )
    gone = _reached_from(left_out, parents)
    for joint in joints:
        if link_of(joint, "child") in gone:
            root.remove(joint)
    for name in gone & set(links):
        root.remove(links[name])
