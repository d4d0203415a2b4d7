"""Bad input to `needleforce`: exit code 2 and one line that helps, never a
traceback."""

import builtins
import os
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from needleforce.cli import main
from needleforce.recordings import write_table
from tests.needleforce.cli.residual_command_log import (
    SMALL_ARM,
    insertion,
    refusal,
    write_insertion,
)


@pytest.fixture(scope="module")
def folder(lwr, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    write_insertion(folder / "good.csv", lwr, seconds=1.2, contact_s=9.0)
    whole = (folder / "good.csv").read_bytes()
    (folder / "empty.csv").write_bytes(b"")
    (folder / "cut.csv").write_bytes(whole[: whole.index(b"\n") + 1000])
    write_insertion(folder / "early.npz", lwr, contact_s=1.2)
    columns = insertion(lwr)
    write_table(folder / "milli.npz", {**columns, "tau_Nm": 1e3 * columns["tau_Nm"]})
    turned = {name: values.T for name, values in insertion(lwr).items()}
    np.savez(folder / "transposed.npz", **turned)
    write_insertion(folder / "no_torque.csv", lwr, seconds=0.1, only=("t_s", "q_rad"))
    columns = {"t_s": [0.0, 0.001], "q_rad": [[0.0] * 6] * 2, "tau_Nm": [[0.0] * 6] * 2}
    write_table(folder / "six.csv", columns)
    (folder / "sub").mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


FILES = {
    "arm.urdf": SMALL_ARM,
    "broken.toml": "mass_kg = ",
    "blank.toml": "# nothing\n",
    "negative.toml": "mass_kg = -1.0\ncom_m = [0.0, 0.0, 0.1]\n",
    "key.toml": "gian_per_s = 5.0\n",
    "choice.toml": 'mode = "axail"\n',
    "range.toml": "gain_per_s = -5.0\n",
    "frame.toml": 'frame = "nowhere"\n',
    "given_friction.toml": "[friction]\na = 1\n",
    "part.toml": (
        "[viscous_coulomb]\nviscous_Nms = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n"
    ),
    "rotor_sign.toml": "rotor_inertia_kg_m2 = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n",
    "three.toml": "payload = 3",
    "sub/map.toml": 'payload = "heavy.toml"',
}

LOGS = {
    "missing.csv": "missing.csv",
    "log.xlsx": "log.xlsx is not read as it is.*save the sheet as CSV",
    "log.wav": "no known suffix",
    "empty.csv": "empty.csv",
    "cut.csv": "the log ends before",
    "no_torque.csv": "no column found for tau .*Columns are: t_s, q_rad_1",
    "early.npz": "no tare from .*needle.*--tare START:END.*--force-tare.*--no-tare",
    "milli.npz": (
        r"samples were rejected .* mNm read as Nm.*Give --tau tau_Nm:Nm:0\.001"
    ),
    "transposed.npz": "q_rad has 7 rows of 4000: is it transposed?",
    "six.csv": (
        "6 columns per joint signal, the robot has 7 joints: "
        "lwr_joint_1.*lwr_joint_7.*--q"
    ),
    "n" * 300 + ".csv": "name too long",
}

OPTIONS = {
    "--tau effort": "no column 'effort'.*Columns are",
    "--q q_rad_{1..6}": (
        "number of joints: q has 6 .q_rad_1.*; tau has 7 .tau_Nm_1.*--q q_\\*"
    ),
    "--mapping missing.toml": "cannot read the mapping",
    "--mapping three.toml": "payload is int, expected a table, a file, needle or none",
    "--mapping sub/map.toml": "cannot read the payload file sub/heavy.toml",
    "--rate -5": "rate_hz = -5",
    "--robot pandas": (
        "no example robot 'pandas'; robots: panda.*; --urdf FILE loads any other"
    ),
    "--robot ur5e --urdf arm.urdf": "--robot and --urdf name two robots",
    "--urdf arm.urdf": (
        "7 columns per joint signal, the robot has 3 joints: .*, gripper"
    ),
    "--urdf arm.urdf --tool-frame nowhere": "no frame 'nowhere'.*frames: .*tip",
    "--urdf arm.urdf --tool-frame tip --lock wrist": (
        "cannot lock 'wrist'.*shoulder, elbow"
    ),
    "--urdf arm.urdf --tool-frame tip --lock gripper=open": "'open' is no number",
    "--urdf arm.urdf --tool-frame tip --lock gripper": (
        "robot has 2 joints: shoulder, elbow"
    ),
    "--tool-frame flange": "--urdf FILE",
    "--lock lwr_joint_3": "--urdf FILE",
    "--payload missing.toml": "cannot read the payload file missing.toml: No such file",
    "--payload broken.toml": "payload file broken.toml is not valid TOML",
    "--payload blank.toml": "is empty",
    "--payload negative.toml": "negative.toml: .*mass",
    "--config key.toml": (
        "unknown key 'gian_per_s'; did you mean gain_per_s. known are: gain_per_s"
    ),
    "--config choice.toml": "mode: .* 'axail', expected 'axial' or 'point' or 'full'",
    "--config range.toml": "range.toml: gain_per_s is -5.0",
    "--config frame.toml": "no frame 'nowhere'",
    "--config given_friction.toml": "joint friction stands in the file of --friction",
    "--gain inf": "gain_per_s is inf, expected a finite number",
    "--insertion-axis 0 0 0": (
        "insertion_axis is .0.0, 0.0, 0.0.: they must not all be zero"
    ),
    "--friction part.toml": r"\[viscous_coulomb\]: .*missing required field coulomb_Nm",
    "--friction rotor_sign.toml": "must not be negative",
    "--tare 4": "expected START:END",
    "--tare 0:60": "outside the log, which runs from 0 s to 1.199 s",
    "--tare=-3:-1": "outside the log, which starts at 0 s",
    "--tare 0.1:0.11": "0.1 to 0.11 s: the filters had not settled by then",
    "": (
        "the log ends before the filters have settled and 2 s of free motion.*--no-tare"
    ),
    "-o forces.xlsx": "known are: .csv",
    "--figure .": "cannot write",
    "--figure forces.gif": "forces.gif: its name must end in one of",
}

USAGE = {
    "force": "LOG requires an argument",
    "forc good.csv": 'Unknown command "forc". Did you mean "force"',
    "force good.csv more.csv": "'more.csv': not expected here",
    "force good.csv --mode axail": 'Did you mean "axial"',
    "force good.csv --gian 4": "Unknown option: --gian. Did you mean --gain",
    "force good.csv --tare 0:1 --no-tare": "--tare and --no-tare contradict each other",
    "force good.csv --force-tare --no-tare": (
        "--force-tare and --no-tare contradict each other"
    ),
    "force good.csv --no-tare --figure a.png --from 3 --to 1": (
        "--from 3 --to 1: expected --from"
    ),
    "force good.csv --no-tare --figure a.png --from nan": (
        "--from nan --to inf: expected --from"
    ),
    "identify no.csv --figure a.png --to=-inf": (
        "--from -inf --to -inf: expected --from"
    ),
    "force good.csv --from soon": 'unable to convert "soon" into float',
    "identify good.csv --method ferro": 'Choose from: "mixture", "published"',
    "identify empty.csv": "it is empty",
    "identify good.csv": "no column found for depth",
    "report good.csv": "DIR requires an argument",
    "report - page": "a report needs a file",
}


EMPTY = [["force", ""], ["report", "good.csv", ""], ["force", "good.csv", "--report="]]


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    ("argv", "message"),
    [
        *(
            (["force", name, "-o", "out.csv"], message)
            for name, message in LOGS.items()
        ),
        *(
            (["force", "good.csv", *text.split()], message)
            for text, message in OPTIONS.items()
        ),
        *((text.split(), message) for text, message in USAGE.items()),
        *(
            (argv, f"{argv[-1]!r}: nothing is given there, expected a name")
            for argv in EMPTY
        ),
    ],
    ids=lambda value: " ".join(value)[-60:] if isinstance(value, list) else "",
)
def test_bad_input_is_one_line_and_leaves_nothing(
    folder, monkeypatch, capsys, argv, message
):
    monkeypatch.chdir(folder)
    files = sorted(path.name for path in folder.iterdir())
    line = refusal(argv, capsys)

    assert re.search(message, line), line
    assert sorted(path.name for path in folder.iterdir()) == files


@pytest.mark.parametrize("command", ["force", "identify"])
def test_a_page_is_refused_with_the_command_that_writes_it(command, capsys):
    line = refusal([command, "a.csv", "--report", "page"], capsys)

    assert "pages are written by `needleforce report a.csv page`" in line


@pytest.mark.parametrize("command", ["force", "identify"])
def test_missing_matplotlib_is_refused_before_the_work(
    folder, monkeypatch, capsys, command
):
    def missing(name, *more, before=builtins.__import__, **named):
        if name.startswith("matplotlib"):
            raise ImportError(name, name="matplotlib")
        return before(name, *more, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    monkeypatch.chdir(folder)
    line = refusal([command, "missing.csv", "--figure", "f.png"], capsys)

    assert re.search("needs matplotlib, which is not installed.*pip install", line)


def test_failed_command_leaves_no_report_folder(folder, tmp_path, capsys):
    (tmp_path / "file").touch()
    assert "no.csv" in refusal(["report", "no.csv", f"{tmp_path}/new/p"], capsys)
    good = str(folder / "good.csv")
    line = refusal(["report", good, str(tmp_path / "file" / "page")], capsys)
    assert "cannot write to" in line

    assert os.listdir(tmp_path) == ["file"]


def test_stamps_in_another_unit_are_named(lwr, tmp_path, capsys):
    columns = insertion(lwr)
    columns["t_s"] = 1_700_000_000_000_000_000 + np.rint(1e9 * columns["t_s"]).astype(
        np.int64
    )
    write_table(tmp_path / "log.npz", {"time": columns.pop("t_s"), **columns})

    assert main(["force", str(tmp_path / "log.npz"), "--tare", "+0:+1"]) == 2

    printed = capsys.readouterr().err

    assert re.search("^error: .* --time time:UNIT$", printed, re.MULTILINE)


@pytest.mark.slow
@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes on Linux")
def test_undecodable_file_name_is_drawn_and_printed(folder, tmp_path, capsys):
    name = tmp_path / os.fsdecode(b"log-\xff-$\\frac{$.csv")
    name.write_bytes((folder / "good.csv").read_bytes())
    page = tmp_path / "page"
    picture = tmp_path / "f.png"
    assert main(["report", str(name), str(page), "--no-tare"]) == 0
    assert main(["force", str(name), "--no-tare", "--figure", str(picture)]) == 0
    assert "log-\\udcff-$\\frac{$.csv" in (page / "index.html").read_text(
        encoding="utf-8"
    )
    assert main(["force", str(name), "--print-config"]) == 0
    assert "\\udcff" in capsys.readouterr().out
    assert Path(picture).stat().st_size > 5_000


def test_no_option_is_suggested_for_its_dashes_alone(capsys):
    assert main(["live", "lwr", "--idle"]) == 2
    said = capsys.readouterr().err
    assert "Unknown option: --idle" in said
    assert "--view" not in said
