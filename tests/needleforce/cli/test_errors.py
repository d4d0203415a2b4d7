"""Bad input to `needleforce`: exit code 2 and one line that names it, never a
traceback."""

import builtins
import os
import sys

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

pytestmark = pytest.mark.slow

FILES = {
    "arm.urdf": SMALL_ARM,
    "broken.toml": "mass_kg = ",
    "blank.toml": "# nothing\n",
    "negative.toml": "mass_kg = -1.0\ncom_m = [0.0, 0.0, 0.1]\n",
    "lacking.toml": "mass_kg = 1.0\n",
    "key.toml": "gian_per_s = 5.0\n",
    "nested.toml": "prior = {gear_ration = 3.0}\n",
    "choice.toml": 'mode = "axail"\n',
    "range.toml": "gain_per_s = -5.0\n",
    "frame.toml": 'frame = "nowhere"\n',
    "given_friction.toml": "[friction]\na = 1\n",
    "part.toml": "[viscous_coulomb]\nviscous_Nms = [0.0]\n",
    "short.toml": (
        "[viscous_coulomb]\nviscous_Nms = [0.0, 0.0]\ncoulomb_Nm = [0.0, 0.0]\n"
        "offset_Nm = [0.0, 0.0]\n"
    ),
    "rotor_sign.toml": "rotor_inertia_kg_m2 = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n",
    "three.toml": "payload = 3",
    "sub/map.toml": 'payload = "heavy.toml"',
    "depth.csv": "t_s,depth_m,force_N\n0,0,0\n1,0.001,1\n",
    "no_plan.json": "{",
    "log.wav": "RIFF",
}

LOGS = {
    "missing.csv": "missing.csv",
    "log.wav": "suffix",
    "empty.csv": "empty.csv",
    "cut.csv": "cannot be tared",
    "no_torque.csv": "tau",
    "early.npz": "--tare START:END",
    "milli.npz": "tared",
    "six.csv": "6 columns",
    "nan.npz": "joint 1",
}

OPTIONS = {
    "--tau effort": "'effort'",
    "--q q_rad_{1..6}": "joints",
    "--mapping missing.toml": "missing.toml",
    "--mapping three.toml": "payload",
    "--mapping sub/map.toml": "sub/heavy.toml",
    "--rate -5": "-5",
    "--robot pandas": "'pandas'",
    "--robot ur5e --urdf arm.urdf": "two robots",
    "--urdf arm.urdf": "3 joints",
    "--urdf arm.urdf --tool-frame nowhere": "'nowhere'",
    "--urdf arm.urdf --tool-frame tip --lock wrist": "'wrist'",
    "--urdf arm.urdf --tool-frame tip --lock gripper=open": "gripper=open",
    "--urdf arm.urdf --tool-frame tip --lock gripper": "2 joints",
    "--lock lwr_joint_3": "--lock",
    "--lock-others": "--lock-others",
    "--accept-inertia": "--accept-inertia",
    "--gravity 0 0 1": "9.81",
    "--payload missing.toml": "missing.toml",
    "--payload broken.toml": "broken.toml",
    "--payload blank.toml": "blank.toml",
    "--payload negative.toml": "mass",
    "--payload lacking.toml": "com_m",
    "--config key.toml": "'gian_per_s'",
    "--config nested.toml": "'gear_ration'",
    "--config choice.toml": "axail",
    "--config range.toml": "gain_per_s",
    "--config frame.toml": "'nowhere'",
    "--config given_friction.toml": "friction",
    "--gain inf": "gain_per_s",
    "--insertion-axis 0 0 0": "zero",
    "--friction part.toml": "coulomb_Nm",
    "--friction short.toml": "viscous_Nms",
    "--friction rotor_sign.toml": "negative",
    "--tare 4": "START:END",
    "--tare 0:soon": "0:soon",
    "--tare 0:": "START:END",
    "--tare 0:inf": "inf",
    "--tare 0:60": "1.199 s",
    "--tare=-3:-1": "-3 to -1 s",
    "--tare 1:0.5": "start before its end",
    "--tare 0.1:0.11": "0.1 to 0.11 s",
    "--tare 0:1 --no-tare": "contradict",
    "--force-tare --no-tare": "contradict",
    "": "cannot be tared",
    "-o forces.xlsx": ".xlsx",
    "-o sub": "suffix",
    "-o good.csv": "the log",
    "-o no/where.csv": "no folder",
    "-o f.csv --figure f.csv": ".csv",
    "--figure .": "cannot write",
    "--figure forces.gif": "forces.gif",
    "--figure no/where.svg": "no folder",
    "--gain soon": "float",
    "--mode axail": "axial",
    "--gian 4": "--gian",
    "more.csv": "more.csv",
}

USAGE = {
    "force": "LOG",
    "forc good.csv": "forc",
    "identify good.csv --method ferro": "mixture",
    "identify empty.csv": "empty",
    "identify good.csv": "depth",
    "report good.csv": "DIR",
    "report - page": "pipe",
    "report depth.csv page --plan no_plan.json": "joint positions",
    "report good.csv page --plan no_plan.json": "no_plan.json",
    "report missing.csv new/page": "missing.csv",
    "report good.csv arm.urdf/page": "cannot write",
    "report good.csv page --tare 0:60": "1.199 s",
    "report good.csv page --tare 0:1 --constant-speed 2mm/s": "--constant-speed",
    "live nao": "nao",
    "lag nao --yes": "nao",
    "demo --data ct": "abdomen",
    "demo --seed -1": "--seed",
    "simulate torso -o x --plant fri": "--plant",
    "simulate torso -o x --truth y": "--truth",
    "simulate p.json -o x.csv --seed 1": "--seed",
    "simulate p.json -o x.csv --plant fri": "--plant",
    "simulate gel-25-constant": "nothing to write",
    "simulate -o x.csv": "--list",
    "simulate gel-26 -o x.csv": "gel-26",
    "simulate gel-25-constant -o x.xyz": "x.xyz",
    "simulate gel-25-constant -o x.csv --seed -1": "--seed",
    "simulate gel-25-constant -o x.csv --truth x.csv": "--truth",
    "simulate gel-25-constant -o good.csv": "exists",
    "view good.csv --export x.htm": ".html",
    "view good.csv --export no/x.html": "no folder",
}

EMPTY = [["force", ""], ["report", "good.csv", ""], ["force", "good.csv", "--figure="]]


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
    write_insertion(folder / "no_torque.csv", lwr, seconds=0.1, only=("t_s", "q_rad"))
    columns = {"t_s": [0.0, 0.001], "q_rad": [[0.0] * 6] * 2, "tau_Nm": [[0.0] * 6] * 2}
    write_table(folder / "six.csv", columns)
    columns = insertion(lwr, seconds=0.1)
    columns["q_rad"][:, 0] = np.nan
    write_table(folder / "nan.npz", columns)
    (folder / "sub").mkdir()
    for name, text in FILES.items():
        (folder / name).write_text(text)
    return folder


@pytest.mark.filterwarnings("ignore::RuntimeWarning")
@pytest.mark.parametrize(
    ("argv", "word"),
    [
        *((["force", name, "-o", "out.csv"], word) for name, word in LOGS.items()),
        *(
            (["force", "good.csv", *text.split()], word)
            for text, word in OPTIONS.items()
        ),
        *((text.split(), word) for text, word in USAGE.items()),
        *((argv, "nothing is given") for argv in EMPTY),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_line_and_leaves_nothing(
    folder, monkeypatch, capsys, argv, word
):
    monkeypatch.chdir(folder)
    files = sorted(path.name for path in folder.iterdir())
    line = refusal(argv, capsys)

    assert word in line
    assert sorted(path.name for path in folder.iterdir()) == files


@pytest.mark.parametrize(
    "argv", [["force", "no.csv", "--figure", "f.png"], ["report", "no.csv", "page"]]
)
def test_missing_matplotlib_is_refused_before_the_work(monkeypatch, capsys, argv):
    def missing(name, *more, before=builtins.__import__, **named):
        if name.startswith("matplotlib"):
            raise ImportError(name, name="matplotlib")
        return before(name, *more, **named)

    monkeypatch.setattr(builtins, "__import__", missing)
    monkeypatch.setattr("needleforce.cli.logs.columns.has_channels", lambda *_: False)

    assert "matplotlib" in refusal(argv, capsys)


@pytest.mark.parametrize(
    ("source", "output", "word"),
    [
        ("bag/bag.mcap", ["-o", "bag/x.csv"], "the log"),
        ("link", ["-o", "bag/x.csv"], "the log"),
        ("log.csv", ["--figure", "log.png"], "the log"),
        ("log.csv", ["-o", "hard.csv"], "the log"),
        ("log.csv", ["-o", "f.csv", "--figure", "f.png"], "--figure"),
        ("log.csv", ["-o", "t.csv"], "it is a folder"),
        ("log.csv", ["-o", "bag.db3"], ".mcap"),
    ],
)
def test_harmful_output_is_refused(tmp_path, monkeypatch, capsys, source, output, word):
    pytest.importorskip("matplotlib")
    monkeypatch.chdir(tmp_path)
    columns = {"t_s": np.arange(3) / 1000.0, "force_N": np.ones(3)}
    write_table("log.csv", columns)
    (tmp_path / "bag").mkdir()
    write_table("bag/bag.mcap", columns)
    (tmp_path / "bag/metadata.yaml").touch()
    (tmp_path / "link").symlink_to(tmp_path / "bag")
    (tmp_path / "log.png").symlink_to(tmp_path / "log.csv")
    (tmp_path / "hard.csv").hardlink_to(tmp_path / "log.csv")
    (tmp_path / "f.csv").touch()
    (tmp_path / "t.csv").mkdir()
    (tmp_path / "f.png").symlink_to(tmp_path / "f.csv")

    assert word in refusal(["identify", source, *output], capsys)


@pytest.mark.skipif(sys.platform != "linux", reason="file names are bytes on Linux")
def test_undecodable_file_name_is_drawn_and_printed(folder, tmp_path, capsys):
    name = tmp_path / os.fsdecode(b"log-\xff-$\\frac{$.csv")
    name.write_bytes((folder / "good.csv").read_bytes())
    page = tmp_path / "page"
    assert main(["report", str(name), str(page), "--no-tare"]) == 0
    assert "log-\\udcff-$\\frac{$.csv" in (page / "index.html").read_text(
        encoding="utf-8"
    )
    capsys.readouterr()
    assert main(["force", str(name), "--print-config"]) == 0
    assert "\\udcff" in capsys.readouterr().out
