"""docs/notation.md names what exists."""

import inspect
import re
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

TEXT = (Path(__file__).parents[1] / "docs" / "notation.md").read_text(encoding="utf-8")
PACKAGES = ("urdf", "residual", "identification", "groundtruth")
NAMES = sorted(set(re.findall(rf"`((?:{'|'.join(PACKAGES)})\.[\w.]+(?:\(\w+\))?)`", TEXT)))
COLUMNS = ["symbol", "name in the code", "unit", "shape", "equation"]


def tables():
    """Header and rows of every table with a column of code names."""
    for block in re.findall(r"(?:^\|.*\n)+", TEXT, re.MULTILINE):
        header, _, *rows = [
            [cell.strip() for cell in line.split("|")[1:-1]] for line in block.splitlines()
        ]
        if "name in the code" in header:
            yield header, rows


def resolve(path):
    """The object at a dotted path: modules first, then attributes."""
    parts = path.split(".")
    found = import_module(parts[0])
    for depth, part in enumerate(parts[1:], 2):
        if not hasattr(found, part) and isinstance(found, ModuleType):
            import_module(".".join(parts[:depth]))
        found = getattr(found, part)
    return found


@pytest.mark.parametrize("name", NAMES)
def test_every_name_exists(name):
    path, _, argument = name.partition("(")
    found = resolve(path)
    assert found is not None
    if argument:
        assert argument.rstrip(")") in inspect.signature(found).parameters


def test_every_row_fills_its_columns_and_every_equation_of_the_paper_has_one():
    found = list(tables())
    assert len(found) == 7
    for header, rows in found:
        assert header == COLUMNS
        for row in rows:
            assert len(row) == len(COLUMNS), row
            assert set(re.findall(r"`([^`]*)`", row[1])) <= set(NAMES), row
            assert row[0]
            assert row[1].startswith("`")
    equations = " ".join(row[-1] for _, rows in found for row in rows)
    assert [number for number in range(2, 14) if f"({number})" not in equations] == []
