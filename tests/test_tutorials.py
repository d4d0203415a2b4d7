"""The tutorials: every command and program on them runs and prints what they show."""

import io
import re
import shlex
import socket
import subprocess
import sys
from contextlib import redirect_stdout
from pathlib import Path

import pytest

from groundtruth import simulate
from needleforce import read_plan
from needleforce.cli import main
from needleforce.recordings import write_table

TUTORIALS = Path(__file__).parents[1] / "docs" / "tutorials"
ANSWERS = r"^```sh\n(needleforce .*?)\n```$(?:\n\n^```text\n(.*?)^```$)?"
NUMBER = r"-?\d+(?:\.\d+)?"
SHORT_ROWS = 20_000
"""Of a recording that a command reads whose answer is not shown."""
TOLERANCE = 0.15
"""Relative difference of a printed number that another machine's rounding may make."""


def page(name):
    return (TUTORIALS / f"{name}.md").read_text(encoding="utf-8")


def programs(name):
    return re.findall(r"^```python\n(.*?)^```$", page(name), re.DOTALL | re.MULTILINE)


def commands(name):
    """Every command of a page, and what the page shows of what it printed."""
    blocks = re.findall(ANSWERS, page(name), re.DOTALL | re.MULTILINE)
    return [
        (shlex.split(line)[1:], answer if line is block.splitlines()[-1] else "")
        for block, answer in blocks
        for line in block.splitlines()
    ]


def shortened(arguments):
    """Arguments of a command, with the beginning of each recording in its place."""
    inputs = [name for name in arguments[1:2] if Path(name).is_file()]
    for name in inputs:
        rows = Path(name).read_text(encoding="utf-8").splitlines(keepends=True)
        Path(f"short-{name}").write_text("".join(rows[:SHORT_ROWS]), encoding="utf-8")
    return [f"short-{name}" if name in inputs else name for name in arguments]


def is_like(shown, printed):
    """Whether two lines have the same words, and nearly the same numbers."""
    words = [re.sub(NUMBER, "", line).split() for line in (shown, printed)]
    numbers = [
        [float(text) for text in re.findall(NUMBER, line)] for line in (shown, printed)
    ]
    return words[0] == words[1] and numbers[1] == pytest.approx(
        numbers[0], rel=TOLERANCE, abs=TOLERANCE
    )


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a command; each line of an answer must be like one that is printed."""
    monkeypatch.chdir(tmp_path)

    def run(arguments, answer, said=""):
        code = main(arguments)
        printed = said + "".join(capsys.readouterr())

        assert code == (2 if answer.startswith("error: ") else 0)

        for shown in answer.splitlines():
            start = shown.removesuffix("...").rstrip()
            lines = [
                line[: len(start)] if "..." in shown else line
                for line in printed.splitlines()
            ]

            assert any(is_like(start, line) for line in lines), shown
        return printed

    return run


@pytest.mark.slow
@pytest.mark.parametrize("name", ["csv", "arm-log"])
def test_the_commands_of_a_recording_print_what_is_shown(name, run):
    pytest.importorskip("matplotlib")
    shown = commands(name)
    for arguments, answer in shown:
        run(arguments if answer else shortened(arguments), answer)

    assert any(answer for _, answer in shown)

    for program in programs(name):
        said = io.StringIO()
        with redirect_stdout(said):
            exec(compile(program, name, "exec"), {})

        assert f"```text\n{said.getvalue()}```" in page(name)


@pytest.mark.slow
def test_a_recording_of_the_live_arm_prints_what_is_shown(run):
    """The recording is what the emulated controller sends, without the network."""
    pytest.importorskip("matplotlib")
    signals = simulate("gel-25-constant", plant="clean").signals
    sent = {"t_s": signals.t_s, "q_rad": signals.q_rad, "tau_Nm": signals.tau_Nm}
    write_table("live.csv", {name: values[:40_000] for name, values in sent.items()})
    said = ""
    for arguments, answer in commands("live-arm"):
        if arguments[0] in ("force", "identify"):
            said = run(arguments, answer, said)

    assert said


@pytest.mark.slow
def test_the_plan_of_the_page_is_the_one_shown(run):
    pytest.importorskip("SimpleITK")
    names = [arguments[0] for arguments, _ in commands("ct-to-needle")]
    said = ""
    for arguments, answer in commands("ct-to-needle")[: names.index("plan") + 1]:
        if arguments[0] in ("simulate", "plan") and "sim" not in arguments[1]:
            said = run(arguments, answer)

    assert said


def free_port():
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as link:
        link.bind(("127.0.0.1", 0))
        return link.getsockname()[1]


@pytest.mark.slow
def test_the_emulated_arm_is_watched_by_the_program(tmp_path, monkeypatch):
    controller, watch = programs("live-arm")
    port = str(free_port())
    controller = controller.replace("49938", port).replace("40_000", "2_000")
    (tmp_path / "lwr_controller.py").write_text(controller, encoding="utf-8")
    root = str(TUTORIALS.parents[1])
    process = subprocess.Popen(
        [sys.executable, "lwr_controller.py"],
        cwd=tmp_path,
        env={"PYTHONPATH": root, "PATH": ""},
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    try:
        assert process.stdout.read(len("Start")) == "Start"

        def press_enter():
            process.stdin.write("\n")
            process.stdin.flush()

        watch = watch.replace("FriArm()", f"FriArm(port={port}, give_up_s=10.0)")
        watch = watch.replace(
            "        for sample", "        press_enter()\n        for sample"
        )
        said = io.StringIO()
        with redirect_stdout(said):
            exec(compile(watch, "watch.py", "exec"), {"press_enter": press_enter})

        assert re.search(r"\b\d+ used", said.getvalue())
        assert "2000 cycles" in process.communicate(timeout=60.0)[0]
    finally:
        process.kill()
        process.wait()


def test_the_plans_of_the_page_are_read(tmp_path):
    text = (TUTORIALS.parent / "how-to" / "scene.md").read_text(encoding="utf-8")
    plans = re.findall(r"^```json\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)
    last = []
    for number, plan in enumerate(plans):
        path = tmp_path / f"plan{number}.json"
        path.write_text(plan, encoding="utf-8")
        last.append([layer.name for layer in read_plan(path).match.layers][-1])

    assert last == ["liver", "behind"]
