"""The codes of errors: every raise has one, and every advice names what exists."""

import ast
import re
from importlib import import_module

import pytest

from benchmarks import BenchmarkCode
from benchmarks.cli import app as benchmark_app
from foundation.errors import CodedError, ErrorCode
from identification.estimate import SampleStatus
from needleforce import shadowed
from needleforce.cli import app
from needleforce.cli.advice import COMMAND_ADVICE, WATCH_ADVICE
from needleforce.cli.terminal import CommandCode
from needleforce.codes import ERROR_CODES, NO_REPORTS, code_entries, main
from residual.estimate import SensorWarning, Status
from tests.source_files import PACKAGE_SOURCES, ROOT, name_of, syntax

KINDS = (*ERROR_CODES, BenchmarkCode)
CODES = [code for kind in KINDS for code in kind]
LABELS = {code.label: code for code in CODES}

BUILTIN = {
    "AttributeError",  # of a module, as Python asks for it
    "EOFError",
    "KeyboardInterrupt",
    "ImportError",
    "StopIteration",
    "SystemExit",
    "TypeError",
    "ValueError",
}
"""What is raised without a code: Python's protocols, and what the raiser's caller
catches and turns into an error with a code."""

CAUGHT = {
    "foundation/first_use.py",
    "foundation/jit.py",
    "foundation/records.py",
    "identification/published/offline.py",
    "needleforce/__init__.py",
    "needleforce/anatomy/file_checks.py",
    "needleforce/anatomy/slicer_segments.py",
    "needleforce/cli/logs/log_session.py",
    "needleforce/cli/plan_file.py",
    "needleforce/cli/terminal.py",
    "needleforce/cli/toml_tables.py",
    "needleforce/devices/haply.py",
    "needleforce/recordings/bags/message_types.py",
    "needleforce/recordings/bags/ros1_file.py",
    "needleforce/shadowed.py",
    "needleforce/recordings/bags/sqlite_file.py",
    "needleforce/recordings/columnar.py",
    "groundtruth/rig_arm.py",
    "residual/checks/input.py",
    "urdf/errors.py",
}
"""Files that raise them."""


def raised_classes(path):
    """Names of the classes that a file raises by calling them."""
    for node in ast.walk(syntax(path)):
        if isinstance(node, ast.Raise) and node.exc is not None:
            raised = node.exc.func if isinstance(node.exc, ast.Call) else node.exc
            if isinstance(raised, ast.Name) and raised.id[0].isupper():
                yield raised.id


def module_of(path):
    parts = path.relative_to(ROOT).with_suffix("").parts
    return import_module(".".join(parts[:-1] if parts[-1] == "__init__" else parts))


def test_every_error_that_is_raised_has_a_code_that_is_listed():
    unlisted = {}
    checked = 0
    for path in PACKAGE_SOURCES:
        for name in set(raised_classes(path)):
            if name in BUILTIN and name_of(path) in CAUGHT:
                continue
            kind = getattr(module_of(path), name)
            checked += 1
            if not issubclass(kind, CodedError) or kind.usual_code not in CODES:
                unlisted[f"{name_of(path)}: {name}"] = kind
    assert unlisted == {}
    assert checked > 80


def test_every_code_that_a_file_names_exists_and_every_listed_one_is_named():
    kinds = {kind.__name__: kind for kind in (*KINDS,)}
    named = set()
    for path in PACKAGE_SOURCES:
        for node in ast.walk(syntax(path)):
            if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name):
                kind = kinds.get(node.value.id)
                if kind is not None:
                    named.add(kind[node.attr])

    assert CommandCode.HIDDEN.label == shadowed.CODE
    assert set(CODES) - named == {CommandCode.HIDDEN}


def test_codes_are_unique_and_of_one_form():
    assert len(LABELS) == len(CODES)
    assert [
        label for label in LABELS if not re.fullmatch(r"NF(-[A-Z]+){2,5}", label)
    ] == []
    for code in CODES:
        assert re.fullmatch(r"[A-Z].*\.", code.meaning), code
        assert code.cure[0].isupper() or code.cure.startswith("--"), code


def options_of(application):
    """Names of all options of an application and its commands."""
    commands = [application[name] for name in application if not name.startswith("-")]
    collections = [command.assemble_argument_collection() for command in commands]
    found = {name for items in collections for item in items for name in item.names}
    return found | {"--help", "--version"}


OPTIONS = options_of(app)
BENCHMARK_OPTIONS = options_of(benchmark_app)
FOREIGN = {"--nthreads"}
"""Options of other programs that an advice names."""


def named_options(advice):
    return set(re.findall(r"(?<!\S)--?[a-z][\w-]*", advice)) - FOREIGN


def test_the_parsers_options_are_found():
    assert {"--tare", "--urdf", "-o", "--print-config"} <= OPTIONS
    assert {"--data", "--cluster", "--json"} <= BENCHMARK_OPTIONS


@pytest.mark.parametrize("table", [COMMAND_ADVICE, WATCH_ADVICE])
def test_advice_of_the_command_names_its_options(table):
    assert set(table) <= set(LABELS)

    for label, advice in table.items():
        foreign = {"-m", "-s", "-d"}
        assert named_options(advice) - OPTIONS - foreign == set(), label
        assert "`" not in advice


def test_advice_that_serves_both_names_nothing_of_the_library():
    alone = [code for code in CODES if code.label not in COMMAND_ADVICE]

    assert [code.label for code in alone if "`" in code.cure] == []

    for code in alone:
        own = BENCHMARK_OPTIONS if code in BenchmarkCode else OPTIONS
        assert named_options(code.cure) - own - {"-m", "-s", "-d"} == set(), code


def test_advice_of_the_library_names_no_option():
    commands = {code for kind in KINDS[:1] for code in kind} | set(BenchmarkCode)
    given = [code for code in CODES if code not in commands]

    assert {
        c.label: o for c in given if (o := named_options(c.cure) - {"-s", "-d"})
    } == {}


def defined_names():
    """All names that the packages define: modules, classes, functions, fields."""
    names = set()
    for path in PACKAGE_SOURCES:
        names |= set(path.relative_to(ROOT).with_suffix("").parts)
        for node in ast.walk(syntax(path)):
            if isinstance(node, ast.ClassDef | ast.FunctionDef):
                names.add(node.name)
            elif isinstance(node, ast.arg):
                names.add(node.arg)
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                names.add(node.id)
    return names


def test_advice_of_the_library_names_what_exists():
    known = defined_names() | {"True", "False", "None", "check_urdf", "channel"}
    for code in CODES:
        for quoted in re.findall(r"`([^`]+)`", code.cure):
            names = set(re.findall(r"[A-Za-z_]\w*", quoted))
            assert names - known == set(), code


def test_every_status_and_warning_is_listed_with_a_cure():
    entries = code_entries(KINDS)
    labels = [entry.label for entry in entries]

    assert len(set(labels)) == len(labels)

    for member in (*Status, *SensorWarning, *SampleStatus):
        label = f"{type(member).__name__}.{member.name}"
        assert (label in labels) is (member not in NO_REPORTS)
    assert all(entry.meaning and entry.library_cure.endswith(".") for entry in entries)


def test_the_module_prints_one_code_or_all(capsys):
    assert main(["NF-SENSOR-CONTACT"]) == 0

    printed = capsys.readouterr().out

    assert printed.startswith("NF-SENSOR-CONTACT\n")
    assert "library: Move in free air" in printed
    assert "command: Choose where the needle is free with --tare" in printed
    assert main([]) == 0
    assert "SensorWarning.SPIKE\n" in capsys.readouterr().out
    assert main(["NF-NOTHING"]) == 2


def test_codes_of_other_enumerations_can_be_listed():
    class PumpCode(ErrorCode):
        DRY = ("NF-PUMP-DRY", "The pump is dry.", "Fill it.")

    assert code_entries([PumpCode])[0].command_cure == "Fill it."
