"""The examples run, and say what they promise."""

import gc
import re
import runpy
from pathlib import Path

import pytest

FOLDER = Path(__file__).parents[1] / "examples"
SAYS = {
    "controller_loop": (
        r"(?s).*layer 1 ruptured at 3\d.\d mm.*at most \d\.\d\d N.*; 0 samples rejected"
    ),
    "own_torque_estimate": r"at most 0\.\d\d N; the gel is 2[789]\.\d mm thick",
    "stop_and_resume": r"both read -?\d\.\d{6} N in the end",
}


@pytest.mark.parametrize("name", SAYS)
def test_an_example_is_short_runs_and_says_what_it_found(name, capsys):
    assert sorted(path.stem for path in FOLDER.glob("*.py")) == sorted(SAYS)
    example = FOLDER / f"{name}.py"
    assert len(example.read_text(encoding="utf-8").splitlines()) <= 40
    try:
        runpy.run_path(str(example), run_name="__main__")
    finally:
        gc.unfreeze()
    assert re.match(SAYS[name], capsys.readouterr().out)
