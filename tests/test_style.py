"""How the code is written: what a reader must not have to unpack.

Each rule is checked on the syntax of every file. What cannot be checked (whether a name
is the quantity's, whether a sentence is plain) stands in CONTRIBUTING.md.
"""

import ast
import re
from collections import defaultdict

import pytest

from tests.source_files import PACKAGE_SOURCES, SOURCES, functions, name_of, syntax

OWN_LIMITS = ("MOST_", "LEAST_", "LONGEST_", "SHORTEST_", "FEWEST_")
"""Words for limits that `MAX_` and `MIN_` have replaced."""


def is_packed(node):
    """Whether an assignment binds several unlike things: `a, b = x, y`, not a swap."""
    if not (isinstance(node, ast.Assign) and len(node.targets) == 1):
        return False
    target = node.targets[0]
    value = node.value
    if not (isinstance(target, ast.Tuple) and isinstance(value, ast.Tuple)):
        return False
    targets = {ast.unparse(element) for element in target.elts}
    values = {ast.unparse(element) for element in value.elts}
    return len(target.elts) == len(value.elts) and not targets & values


def is_bare_tuple(node):
    """Whether an annotation passes three or more values without names."""
    if not (isinstance(node, ast.Subscript) and ast.unparse(node.value) == "tuple"):
        return False
    parts = node.slice.elts if isinstance(node.slice, ast.Tuple) else [node.slice]
    if any(isinstance(part, ast.Constant) and part.value is ... for part in parts):
        return ast.unparse(parts[0]) == "Any"
    return len(parts) >= 3


def annotations(function):
    """What a signature says of its arguments and of what it returns."""
    arguments = (*function.args.args, *function.args.kwonlyargs)
    given = (function.returns, *(argument.annotation for argument in arguments))
    return [annotation for annotation in given if annotation is not None]


def offenders(paths, search):
    """What a search finds in the syntax of each file, where it finds anything."""
    results = {name_of(path): list(search(syntax(path))) for path in paths}
    assert len(results) > 50
    return {name: found for name, found in results.items() if found}


def packed_assignments(tree):
    return [node.lineno for node in ast.walk(tree) if is_packed(node)]


def test_one_statement_binds_one_thing():
    assert offenders(SOURCES, packed_assignments) == {}


def bare_tuples(tree):
    return [
        f"{function.name}: {ast.unparse(annotation)}"
        for function in functions(tree)
        for annotation in annotations(function)
        if any(is_bare_tuple(node) for node in ast.walk(annotation))
    ]


def test_values_that_travel_together_have_names():
    assert offenders(SOURCES, bare_tuples) == {}


def constants_of_one_line(tree):
    """Lines that bind several constants; the variables of a script are none."""
    return [
        node.lineno
        for node in tree.body
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Tuple)
        if any(name[0].isupper() for name in map(ast.unparse, node.targets[0].elts))
    ]


def test_one_constant_stands_on_one_line():
    assert offenders(SOURCES, constants_of_one_line) == {}
    assert constants_of_one_line(ast.parse("a, b = f()\nA, B = f()")) == [2]


def limits_of_other_names(tree):
    return {
        node.id
        for node in ast.walk(tree)
        if isinstance(node, ast.Name) and node.id.lstrip("_").startswith(OWN_LIMITS)
    }


def test_limits_are_called_max_and_min():
    assert offenders(PACKAGE_SOURCES, limits_of_other_names) == {}


def described_fields(docstring):
    """Names in the `Attributes:` section of a docstring."""
    _, _, section = docstring.partition("Attributes:\n")
    entries = re.findall(r"^    (\w[\w, ]*):", section, re.MULTILINE)
    return {name.strip() for entry in entries for name in entry.split(",")}


def public_fields(node):
    """Names of the annotated fields of a class, without class variables."""
    return [
        part.target.id
        for part in node.body
        if isinstance(part, ast.AnnAssign)
        and isinstance(part.target, ast.Name)
        and not part.target.id.startswith("_")
        and "ClassVar" not in ast.unparse(part.annotation)
    ]


def undescribed_fields(tree):
    return [
        f"{node.name}.{name}"
        for node in ast.walk(tree)
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_")
        for name in public_fields(node)
        if name not in described_fields(ast.get_docstring(node) or "")
    ]


def test_fields_are_described_where_help_shows_them():
    assert offenders(PACKAGE_SOURCES, undescribed_fields) == {}


def defined_types(tree):
    """Names of the public classes and type aliases of a module."""
    for node in tree.body:
        if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
            yield node.name
        if isinstance(node, ast.Assign) and isinstance(node.targets[0], ast.Name):
            name = node.targets[0].id
            if re.match(r"[A-Z][a-z]\w*$", name):
                yield name


def test_no_type_has_the_name_of_another_in_its_package():
    places = defaultdict(list)
    for path in PACKAGE_SOURCES:
        package = name_of(path).split("/")[0]
        for name in defined_types(syntax(path)):
            places[f"{package}: {name}"].append(name_of(path))
    twice = {name: where for name, where in places.items() if len(where) > 1}

    assert twice == {}


OPERATIONS = (
    ast.BinOp,
    ast.BoolOp,
    ast.Compare,
    ast.Call,
    ast.Subscript,
    ast.UnaryOp,
    ast.IfExp,
)


def test_density_of_the_code_is_printed(capsys):
    statements = defaultdict(int)
    operations = defaultdict(int)
    lines = defaultdict(int)
    for path in SOURCES:
        area = name_of(path).split("/")[0]
        nodes = list(ast.walk(syntax(path)))
        statements[area] += sum(isinstance(node, ast.stmt) for node in nodes)
        operations[area] += sum(isinstance(node, OPERATIONS) for node in nodes)
        lines[area] += path.read_text(encoding="utf-8").count("\n")
    with capsys.disabled():
        for area, count in lines.items():
            per_hundred = 100 * statements[area] / count
            per_line = operations[area] / count
            print(  # noqa: T201
                f"\n{area}: {count} lines, {per_hundred:.0f} statements per hundred, "
                f"{per_line:.2f} operations a line",
                end="",
            )

    assert all(lines.values())


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("a, b = 1, 2", True),
        ("a, b = b, a", False),
        ("a, b = f()", False),
        ("a = b = 1", False),
    ],
)
def test_a_packed_assignment_would_be_noticed(text, expected):
    assert is_packed(ast.parse(text).body[0]) is expected


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("tuple[int, int, int]", True),
        ("tuple[Any, ...] | None", True),
        ("tuple[float, ...]", False),
        ("tuple[int, str]", False),
    ],
)
def test_a_bare_tuple_would_be_noticed(text, expected):
    annotation = ast.parse(text, mode="eval").body
    assert any(is_bare_tuple(node) for node in ast.walk(annotation)) is expected
