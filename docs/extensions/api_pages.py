"""One page for each package, with every public name once, in a reader's order.

Names are grouped by the module that they come from; the modules follow the package's
"Reading order". Errors stand last.
"""

import ast
import inspect
import re
from dataclasses import is_dataclass
from enum import Enum
from importlib import import_module
from itertools import groupby
from pathlib import Path
from types import ModuleType
from typing import Any, NamedTuple

from sphinx.application import Sphinx
from sphinx.errors import ExtensionError
from sphinx.pycode import ModuleAnalyzer


class ApiPage(NamedTuple):
    """The page of a package that offers names.

    Attributes:
        title: Title of the page.
        first: Modules that a user meets first; the others follow in reading order.
    """

    title: str
    first: tuple[str, ...] = ()


PACKAGES = {
    "needleforce": ApiPage("One insertion"),
    "residual": ApiPage(
        "The virtual force sensor", ("virtual_force_sensor", "estimate", "config")
    ),
    "identification": ApiPage(
        "Identification of the tissue", ("identifier", "estimate", "config")
    ),
    "urdf": ApiPage("The robot, its tool and payload", ("loading", "payload")),
    "needleforce.recordings": ApiPage("Recordings", ("open_recording", "log")),
    "needleforce.control": ApiPage(
        "Control", ("controller", "tasks", "guidance", "teleoperation")
    ),
    "needleforce.anatomy": ApiPage("The patient and the plan", ("reading", "labels")),
    "needleforce.devices": ApiPage("Arms, force sensors and haptic devices"),
    "needleforce.scene": ApiPage("The scene", ("live", "viewer")),
    "needleforce.plots": ApiPage("Charts and pages"),
    "needleforce.simulation": ApiPage("Simulated insertions beside the truth"),
    "groundtruth": ApiPage("The simulated ground truth", ("simulation", "scenarios")),
}
"""Packages that offer names, in the order of the site."""

INDEX = """API
===

Every public name, by package; each is imported from the package of its page.

.. toctree::

""" + "".join(f"   {name}\n" for name in PACKAGES)
"""The page above them."""

ERRORS = "errors"
READING_ORDER = re.compile(r"\n*Reading order: .*", re.DOTALL)


class PublicName(NamedTuple):
    """A name that a package offers.

    Attributes:
        name: The name.
        package: The package that offers it.
        module: The module that defines it.
    """

    name: str
    package: str
    module: str

    @property
    def path(self) -> str:
        """Where a user imports it from."""
        return f"{self.package}.{self.name}"

    @property
    def value(self) -> Any:
        """The object itself."""
        return getattr(import_module(self.package), self.name)

    @property
    def home(self) -> str:
        """The package in whose page it is described."""
        owners = [
            owner for owner in PACKAGES if f"{self.module}.".startswith(f"{owner}.")
        ]
        return max(owners, key=len, default=self.package)


def resolve(path: str) -> Any:
    """Return the object at a dotted path, or None."""
    parts = path.split(".")
    for length in range(len(parts), 0, -1):
        try:
            value: Any = import_module(".".join(parts[:length]))
        except ImportError:
            continue
        for name in parts[length:]:
            value = getattr(value, name, None)
        return value
    return None


def imported_names(package: ModuleType) -> dict[str, str]:
    """Return the module of each name that a package's file imports, in its order."""
    syntax = ast.parse(inspect.getsource(package))
    names: dict[str, str] = {}
    for node in ast.walk(syntax):
        if isinstance(node, ast.ImportFrom) and node.module:
            for alias in node.names:
                names[alias.asname or alias.name] = node.module
    return names


def public_names(package_name: str) -> list[PublicName]:
    """Return what a package offers: its ``__all__``, or what it imports as itself."""
    package = import_module(package_name)
    modules = imported_names(package)
    offered = getattr(package, "__all__", None)
    if offered is None:
        offered = [name for name in modules if name in vars(package)]
    names = [(name, getattr(package, name)) for name in offered]
    return [
        PublicName(
            name,
            package_name,
            value.__module__ if is_definition(value) else modules[name],
        )
        for name, value in names
        if not isinstance(value, ModuleType)
    ]


def is_definition(value: Any) -> bool:
    """Return whether a value knows in which module it was defined."""
    is_own = inspect.isclass(value) or callable(value)
    return is_own and isinstance(getattr(value, "__module__", None), str)


def reading_order(package_name: str) -> list[str]:
    """Return the names of modules in the order of the package's docstring."""
    docstring = import_module(package_name).__doc__ or ""
    _, _, order = docstring.partition("Reading order: ")
    return re.findall(r"`(\w+)`", order)


def group_of(item: PublicName) -> str:
    """Return the name of the group that a name belongs to."""
    value = item.value
    if isinstance(value, type) and issubclass(value, Exception):
        return ERRORS
    return item.module.removeprefix(f"{item.home}.").split(".")[0]


def directive_of(item: PublicName) -> str:
    """Return the directive that describes a name."""
    value = item.value
    if isinstance(value, type):
        return f".. autoclass:: {item.path}\n   :members:\n   :undoc-members:\n"
    if inspect.isfunction(value):
        return f".. autofunction:: {item.path}\n"
    comments = ModuleAnalyzer.for_module(item.module).find_attr_docs()
    words = "\n".join(comments.get(("", item.name), [])).strip()
    kind = type(value).__name__
    text = f"{words}\n" if words else ""
    lines = "".join(f"   {line}\n" for line in text.splitlines())
    return f".. py:data:: {item.path}\n   :type: {kind}\n\n{lines}"


def is_record(value: type) -> bool:
    """Return whether a class is a bare record or an enumeration."""
    return is_dataclass(value) or issubclass(value, tuple | Enum)


def place_of(item: PublicName) -> tuple[int, int]:
    """Return what comes first in a group: what does something, then its records.

    Each of them in the order of the source; constants come last.
    """
    value = item.value
    if not (isinstance(value, type) or inspect.isfunction(value)):
        return 2, 0
    is_of_records = isinstance(value, type) and is_record(value)
    return int(is_of_records), inspect.getsourcelines(value)[1]


def first_line(module_name: str) -> str:
    """Return the summary line of a module."""
    return (import_module(module_name).__doc__ or "").splitlines()[0]


def heading(text: str, mark: str) -> str:
    """Return a heading of a page."""
    return f"{text}\n{mark * len(text)}\n\n"


def introduction(package_name: str) -> str:
    """Return the docstring of a package as text of a page; its code stays code."""
    docstring = inspect.cleandoc(import_module(package_name).__doc__ or "")
    text = READING_ORDER.sub("", docstring)
    text = re.sub(r"`(\w+)`", r"``\1``", text.replace("``", "`"))
    return re.sub(r"\n\n(?=    )", "\n\n.. code-block:: python\n\n", text, count=1)


def groups_of(package_name: str) -> list[tuple[str, list[PublicName]]]:
    """Return the names described in the page of a package, by group, in order."""
    own = [item for item in public_names(package_name) if item.home == package_name]
    order = [*PACKAGES[package_name].first, *reading_order(package_name)]
    order += [group for group in map(group_of, own) if group not in order]

    def rank(item: PublicName) -> tuple[bool, int]:
        group = group_of(item)
        return group == ERRORS, order.index(group)

    own.sort(key=place_of)
    own.sort(key=rank)
    return [(group, list(items)) for group, items in groupby(own, key=group_of)]


def page_of(package_name: str) -> str:
    """Return the page of a package."""
    title = PACKAGES[package_name].title
    page = heading(f"{title}: ``{package_name}``", "=")
    page += f"{introduction(package_name)}\n\n.. py:currentmodule:: {package_name}\n\n"
    for group, items in groups_of(package_name):
        page += heading(group.replace("_", " ").capitalize(), "-")
        if group != ERRORS:
            page += f"{first_line(items[0].module)}\n\n"
        page += "\n".join(map(directive_of, items)) + "\n"
    others = [item for item in public_names(package_name) if item.home != package_name]
    if others:
        page += heading("Offered here too", "-")
        page += "".join(f"* :py:obj:`{item.home}.{item.name}`\n" for item in others)
    return page


def check_homes() -> None:
    """Refuse a public name that no page describes.

    Raises:
        ExtensionError: A package offers a name whose home does not.
    """
    described = {
        (item.home, item.name)
        for package_name in PACKAGES
        for item in public_names(package_name)
        if item.home == package_name
    }
    for package_name in PACKAGES:
        for item in public_names(package_name):
            if (item.home, item.name) not in described:
                raise ExtensionError(
                    f"{item.path} is described nowhere: {item.home} does not offer it"
                )


def write_if_changed(path: Path, text: str) -> None:
    """Write a page unless it is there already: Sphinx reads again what is new."""
    if not path.exists() or path.read_text(encoding="utf-8") != text:
        path.write_text(text, encoding="utf-8")


def write_pages(app: Sphinx) -> None:
    """Write the pages beside the others."""
    check_homes()
    folder = Path(app.srcdir) / "reference" / "api"
    folder.mkdir(parents=True, exist_ok=True)
    pages = {"index": INDEX} | {name: page_of(name) for name in PACKAGES}
    for name, page in pages.items():
        write_if_changed(folder / f"{name}.rst", page)


def setup(app: Sphinx) -> dict[str, bool]:
    """Write the pages before Sphinx looks for them."""
    app.connect("builder-inited", write_pages)
    return {"parallel_read_safe": True, "parallel_write_safe": True}
