"""README and docs say what there is: examples run, commands exist, links lead
somewhere."""

import io
import re
import runpy
from contextlib import redirect_stdout
from dataclasses import replace
from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np
import pytest

from residual import Status
from tests.insertion_run import cut, short_run, simulated
from tests.source_files import project_files
from urdf import MissingPackageError, example_robot_path

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
SAYS = {
    "any_arm": r"after the tare at most 0\.[01]\d N",
    "autonomous_insertion": (
        r"rests 3[1-4]\.\d mm deep, in state dwell\nwent 0\.[012]\d mm past the rupture"
    ),
    "controller_loop": (
        r"layer 1 ruptured at 3\d.\d mm\nat most \d\.\d\d N.*; 0 samples rejected"
    ),
    "csv_to_layers": r"(layer \d: [234]\d\.\d mm, \d+ N/m, friction .* N\n){3}$",
    "estimated_velocity": r"late by 10 ms;.*\n0\.00\d\d rad/s, .* 0\.01\d\d rad/s",
    "hand_guidance": r"pushed for a second, the tip moved [1-9]\d+ mm",
    "known_push": r"after 0\.2 s within 0\.0000\d Nm",
    "landmarks": r"at the target: expected 1\.\d mm, is [01]\.\d mm",
    "noise_spectrum": r"noise 0\.02\d N unsmoothed, 0\.01\d N smoothed",
    "observer_gain": r"(K = +\d+/s: lag +\d+\.\d ms, noise 0\.0\d\d N\n){5}$",
    "own_torque_estimate": r"at most 0\.\d\d N; the gel is 2[789]\.\d mm thick",
    "own_urdf": r"7 joints: lwr_joint_1, .*\nflange flange, tool frame needle_tip",
    "payload_from_log": r"30\d ± 1 g",
    "published_method": (
        r"published: rms error 0\.[1-9]\d N, .*\nours: rms error 0\.0\d N, 3 alarms"
    ),
    "remote_centre": (
        r"entry held within 0\.0\d\d mm; tip back within 0\.\d\d mm\n"
        r"without the remote centre the needle leaves it by 1\d mm"
    ),
    "rupture_alarms": r"(layer \d: alarm [1-4]\d ms after the rupture began\n){3}$",
    "stop_and_resume": r"both read -?\d\.\d{6} N three seconds later",
    "tare": r"in free air at most 0\.[3-9]\d N before .*, 0\.[01]\d N after",
    "teleoperation": r"2\d\.\d mm deep, 0\.\d\d N shown\nleast energy .*: 0\.000 mJ",
    "virtual_fixture": (
        r"joystick alone: 2\d\.\d\d mm aside.*\nbelow a fixture: 0\.0\d mm aside"
    ),
    "virtual_sensor": r"rms error 0\.0[12]\d N",
    "watched_plan": (
        r"the scene is at http://127.0.0.1:\d+\n"
        r"deeper than planned by \+[12]\.\d ± \d\.\d mm"
    ),
}
"""What the files in examples/ print."""
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *(
        path
        for path in project_files()
        if path.suffix == ".md" and DOCS in path.parents
    ),
]
GENERATED = re.compile(r"(^|/)(api|gallery)/|(^|/)(command-line|benchmarks|codes)\.md$")
"""Pages that exist once the site is built, which checks links to them and anchors."""
README = (ROOT / "README.md").read_text(encoding="utf-8")


def run_example(code):
    """Names and printed text of an example."""
    names = {}
    said = io.StringIO()
    with redirect_stdout(said):
        exec(compile(code, "example", "exec"), names)
    return names, said.getvalue()


def examples(text):
    return re.findall(r"^```python\n(.*?)^```$", text, re.DOTALL | re.MULTILINE)


@pytest.mark.slow
def test_the_readmes_example_finds_the_layers(monkeypatch):
    monkeypatch.setattr("groundtruth.simulate", simulated)
    (code,) = examples(README)
    names, said = run_example(code)
    truth = names["run"].scenario.layers
    for layer, true_layer in zip(names["session"].layers, truth, strict=True):
        assert layer.thickness_m == pytest.approx(true_layer.thickness_m, abs=1e-3)

    shown = re.search(r"prints one line per layer: `(.*?)` and two more", README)

    assert said.splitlines()[0] == shown[1] == "28 mm, 0.57 N of friction"
    assert len(said.splitlines()) == 3


@pytest.mark.slow
def test_the_readmes_loop_runs_with_an_arm_that_sends_no_velocities(monkeypatch):
    begin = cut(short_run().signals, slice(1000))
    run = replace(short_run(), signals=replace(begin, dq_rad_s=None))
    monkeypatch.setattr("groundtruth.simulate", lambda *_, **__: run)
    (code,) = examples(README)
    names, _ = run_example(code)

    assert names["estimate"].status is Status.NOT_TARED


def test_the_example_of_the_identification_prints_what_its_page_says():
    text = (DOCS / "explanation" / "identification.md").read_text(encoding="utf-8")
    (code,) = examples(text)
    _, said = run_example(code)

    assert f"`{said.strip()}`" in text


@pytest.mark.slow
@pytest.mark.parametrize("name", SAYS)
def test_an_example_runs_prints_its_result_and_draws_it(name, capsys, monkeypatch):
    assert sorted(path.stem for path in ROOT.glob("examples/*.py")) == sorted(SAYS)

    example = ROOT / "examples" / f"{name}.py"

    monkeypatch.setattr("groundtruth.simulate", simulated)
    shown = []
    monkeypatch.setattr(plt, "show", lambda: shown.extend(plt.get_fignums()))
    try:
        runpy.run_path(str(example), run_name="__main__")
    finally:
        plt.close("all")

    assert re.match(SAYS[name], capsys.readouterr().out)
    assert len(shown) == 1


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_leads_to_a_file(page):
    text = page.read_text(encoding="utf-8")
    targets = re.findall(r"\]\(([^)#:\s]+)(?:#[^)]*)?\)", text)

    missing = [name for name in targets if not (page.parent / name).exists()]

    assert [name for name in missing if not GENERATED.search(name)] == []

    files = re.findall(
        r"`((?:urdf|residual|identification|groundtruth|needleforce|benchmarks"
        r"|examples|docs|tests)/[\w/]+\.\w+)`",
        text,
    )

    assert [name for name in files if not (ROOT / name).is_file()] == []


@pytest.mark.parametrize(
    "page", ["loop", "noise-and-rate", "stop-and-resume", "tool-and-payload"]
)
def test_the_examples_of_a_task_run(page, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    text = (DOCS / "how-to" / f"{page}.md").read_text(encoding="utf-8")
    codes = examples(text)
    for code in codes:
        run_example(code)

    assert codes


# docs/how-to/your-robot.md runs as it stands, and what it measures is what it hung
# there.


PANDA = (ROOT / "docs" / "how-to" / "your-robot.md").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def names():
    """What the page's blocks leave behind, run one after another."""
    try:
        example_robot_path("panda")
    except MissingPackageError as error:
        pytest.skip(str(error))
    code = "\n".join(examples(PANDA))
    return run_example(code)[0]


@pytest.mark.parametrize("force", ["force", "force_compensated"])
def test_a_hung_weight_reads_as_its_weight(names, force):
    assert names[force] == pytest.approx(np.array([0.0, 0.0, -1.961]), abs=0.1)
