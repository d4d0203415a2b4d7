"""docs/loop.md says what there is."""

import json
import re
from pathlib import Path

import pytest

from needleforce import InsertionSession
from needleforce.snapshot import SNAPSHOT_FORMAT, SNAPSHOT_VERSION
from residual import SensorWarning, Status
from residual.estimate import UNSEEN_STD

ROOT = Path(__file__).parents[1]
PAGE = (ROOT / "docs" / "loop.md").read_text(encoding="utf-8")


def test_its_example_makes_a_session():
    (code,) = re.findall(r"^```python\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    names = {}
    exec(compile(code, "loop.md", "exec"), names)
    assert isinstance(names["session"], InsertionSession)


@pytest.mark.parametrize("member", [*Status, *(one for one in SensorWarning if one)])
def test_every_status_and_caution_has_a_row(member):
    assert f"| `{member.name}` |" in PAGE


def test_every_call_it_lists_exists():
    calls = re.findall(r"^\| `(\w+)\(", PAGE, re.MULTILINE)
    assert {"update", "tare", "begin_insertion"} <= set(calls)
    assert [name for name in calls if not hasattr(InsertionSession, name)] == []


def test_the_format_it_shows_is_the_one_written():
    (block,) = re.findall(r"^```json\n(.*?)^```$", PAGE, re.DOTALL | re.MULTILINE)
    shown = json.loads(block)
    assert shown["format"] == SNAPSHOT_FORMAT
    assert shown["version"] == SNAPSHOT_VERSION
    assert f"{UNSEEN_STD:.0e}".replace("+0", "") in PAGE


def test_its_links_and_examples_exist():
    targets = re.findall(r"\]\(([^)#:]+)\)", PAGE)
    assert targets
    assert [name for name in targets if not (ROOT / "docs" / name).is_file()] == []
    examples = re.findall(r"`(examples/\w+\.py)`", PAGE)
    assert len(examples) >= 3
    assert [name for name in examples if not (ROOT / name).is_file()] == []
