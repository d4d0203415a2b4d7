"""Bad input to `python -m residual`: exit code 2 and one line that helps, never a traceback."""

import pytest
from residual_command_log import SMALL_ARM, write_insertion

from needleforce.cli.force import main
from recordings import write_table


@pytest.fixture(scope="module")
def folder(lwr, tmp_path_factory):
    folder = tmp_path_factory.mktemp("logs")
    write_insertion(folder / "good.csv", lwr, seconds=1.2, contact_s=9.0)
    whole = (folder / "good.csv").read_bytes()
    write_insertion(folder / "good.npz", lwr, seconds=0.1)
    npz = (folder / "good.npz").read_bytes()
    (folder / "cut.npz").write_bytes(npz[: len(npz) // 2])
    (folder / "empty.csv").write_bytes(b"")
    (folder / "header.csv").write_bytes(whole[: whole.index(b"\n") + 1])
    (folder / "cut.csv").write_bytes(whole[: whole.index(b"\n") + 1000])
    write_insertion(folder / "no_torque.csv", lwr, seconds=0.1, only=("t_s", "q_rad"))
    columns = {"t_s": [0.0, 0.001], "q_rad": [[0.0] * 6] * 2, "tau_Nm": [[0.0] * 6] * 2}
    write_table(folder / "six.csv", columns)
    for name, text in FILES.items():
        (folder / name).write_text(text)
    (folder / "binary.toml").write_bytes(b"\xff\xfe\x00")
    return folder


FILES = {
    "arm.urdf": SMALL_ARM,
    "cut.urdf": SMALL_ARM[:400],
    "hollow.urdf": SMALL_ARM.replace('izz="0.01"', 'izz="9.0"'),
    "broken.toml": "mass_kg = ",
    "blank.toml": "# nothing\n",
    "half.toml": "mass_kg = 1.0\n",
    "text_mass.toml": 'mass_kg = "heavy"\ncom_m = [0.0, 0.0, 0.1]\n',
    "negative.toml": "mass_kg = -1.0\ncom_m = [0.0, 0.0, 0.1]\n",
    "flat.toml": "mass_kg = 1.0\ncom_m = [0.0, 0.0]\n",
    "triangle.toml": "mass_kg = 1.0\ncom_m = [0.0, 0.0, 0.1]\n"
    "inertia_kg_m2 = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 9.0]]\n",
    "ragged.toml": "mass_kg = 1.0\ncom_m = [0.0, 0.0, 0.1]\ninertia_kg_m2 = [[1.0], [0.0, 1.0]]\n",
    "both.toml": "mass_kg = 1.0\n[needle]\nneedle_mass_kg = 0.1\n",
    "thick.toml": "[needle]\nneedle_diameter_m = 0.1\n",
    "needle_key.toml": "[needle]\nlength = 0.1\n",
    "key.toml": "gian_per_s = 5.0\n",
    "type.toml": 'gain_per_s = "fast"\n',
    "switch.toml": "smooth_momentum = 1\n",
    "choice.toml": 'mode = "axail"\n',
    "range.toml": "gain_per_s = -5.0\n",
    "axis.toml": "insertion_axis = [0.0, 1.0]\n",
    "frame.toml": 'frame = "nowhere"\n',
    "no_prior.toml": "prior = 5\n",
    "prior.toml": "[prior]\noffset_share = -1.0\n",
    "no_model.toml": "[stribeck]\na = 1.0\n",
    "no_table.toml": "sigmoid = 3\n",
    "short.toml": "[viscous_coulomb]\nviscous_Nms = [1.0, 2.0]\n",
    "part.toml": "[viscous_coulomb]\nviscous_Nms = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n",
    "rotor.toml": 'rotor_inertia_kg_m2 = "heavy"\n',
    "rotor_sign.toml": "rotor_inertia_kg_m2 = [-1.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n",
}

LOGS = {
    "missing.csv": "missing.csv",
    "log.xlsx": "no known suffix",
    "empty.csv": "empty.csv",
    "header.csv": "header.csv",
    "cut.npz": "cut short",
    "cut.csv": "the log ends before",
    "no_torque.csv": "no column found for tau .*Columns are: t_s, q_rad_1",
    "six.csv": "6 columns per joint signal, the robot has 7 joints: lwr_joint_1.*lwr_joint_7.*--q",
}

OPTIONS = {
    "--tau effort": "no column 'effort'.*Columns are",
    "--tau tau_Nm:N": "no column",
    "--q q_rad_{1..6}": "differ in the number of joints",
    "--mapping missing.toml": "cannot read the mapping",
    "--rate -5": "rate_hz = -5",
    "--urdf missing.urdf": "no such file",
    "--urdf cut.urdf": "not well-formed XML",
    "--urdf hollow.urdf --tool-frame tip": "link 'upper': .*triangle inequality",
    "--urdf arm.urdf": "7 columns per joint signal, the robot has 3 joints: .*, gripper",
    "--urdf arm.urdf --tool-frame nowhere": "no frame 'nowhere'.*frames: .*tip",
    "--urdf arm.urdf --tool-frame tip --lock wrist": "cannot lock 'wrist'.*shoulder, elbow",
    "--urdf arm.urdf --tool-frame tip --lock gripper=open": "'open' is no number",
    "--urdf arm.urdf --tool-frame tip --lock gripper": "robot has 2 joints: shoulder, elbow",
    "--tool-frame flange": "--urdf FILE",
    "--lock lwr_joint_3": "--urdf FILE",
    "--payload missing.toml": "cannot read the payload file missing.toml: No such file",
    "--payload broken.toml": "payload file broken.toml is not valid TOML",
    "--payload binary.toml": "not valid TOML",
    "--payload blank.toml": "is empty",
    "--payload half.toml": "com_m is missing",
    "--payload text_mass.toml": "mass_kg = 'heavy', expected a number",
    "--payload negative.toml": "negative.toml: .*mass",
    "--payload flat.toml": r"com_m has shape \(2,\), expected \(3,\)",
    "--payload triangle.toml": "triangle.toml: payload",
    "--payload ragged.toml": "expected a list of numbers",
    "--payload both.toml": r"\[needle\] alone",
    "--payload thick.toml": "thinner shaft",
    "--payload needle_key.toml": "unknown key 'length'; known are: sensor_mass_kg",
    "--config key.toml": "unknown key 'gian_per_s'; known are: gain_per_s",
    "--config type.toml": "gain_per_s = 'fast', expected a number",
    "--config switch.toml": "smooth_momentum = 1, expected true or false",
    "--config choice.toml": "mode = 'axail', expected 'axial' or 'point' or 'full'",
    "--config range.toml": "range.toml: gain_per_s is -5.0",
    "--config axis.toml": "expected a list of 3 numbers",
    "--config frame.toml": "no frame 'nowhere'",
    "--config no_prior.toml": "expected a table",
    "--config prior.toml": "offset_share is -1.0",
    "--gain inf": "gain_per_s = inf, expected a number",
    "--gain 0": "gain_per_s is 0.0, expected a finite number > 0",
    "--friction no_model.toml": r"has stribeck; expected one table of \[viscous_coulomb\]",
    "--friction no_table.toml": "must be a table",
    "--friction short.toml": "viscous_Nms = .1.0, 2.0., expected 7 numbers, one per joint",
    "--friction part.toml": r"\[viscous_coulomb\]: coulomb_Nm, offset_Nm missing",
    "--friction rotor.toml": "expected 7 numbers",
    "--friction rotor_sign.toml": "must not be negative",
    "--tare 4": "expected START:END",
    "--tare a:b": "'a' is no time",
    "--tare 0:inf": "'inf' is no time",
    "--tare 1:0.5": "START must come before END",
    "--tare 0:60": "outside the log, which runs from 0 to 1.199 s",
    "--tare 0.1:0.11": "0.1 to 0.11 s: the filters had not settled by then",
    "": "the log ends before the filters have settled and 2 s of free motion.*--no-tare",
    "-o forces.xlsx": "known are: .csv",
    "-o none/forces.csv": "no folder none",
    "--png none/forces.png": "no folder none",
}


def complaint(argv, capsys):
    """Run the command; return its one line of complaint."""
    assert main(argv) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [line for line in printed.err.splitlines() if not line.startswith("warning: ")]
    assert len(lines) == 1, printed.err
    assert lines[0].startswith("error: ")
    return lines[0]


@pytest.mark.parametrize(("name", "message"), LOGS.items())
def test_a_log_that_cannot_be_used(folder, monkeypatch, capsys, name, message):
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.iterdir())
    assert_matches(complaint([name, "-o", "out.csv"], capsys), message)
    assert sorted(path.name for path in folder.iterdir()) == before


@pytest.mark.parametrize(("options", "message"), OPTIONS.items())
def test_an_option_that_cannot_be_used(folder, monkeypatch, capsys, options, message):
    monkeypatch.chdir(folder)
    before = sorted(path.name for path in folder.iterdir())
    assert_matches(complaint(["good.csv", *options.split()], capsys), message)
    assert sorted(path.name for path in folder.iterdir()) == before


def assert_matches(line, message):
    with pytest.raises(ValueError, match=message):
        raise ValueError(line)


@pytest.mark.parametrize(
    "argv",
    [
        [],
        ["good.csv", "--mode", "sideways"],
        ["good.csv", "--gain", "fast"],
        ["good.csv", "--tare", "0:1", "--no-tare"],
        ["good.csv", "--lwr", "--urdf", "arm.urdf"],
        ["good.csv", "--surprise"],
    ],
    ids=" ".join,
)
def test_usage_errors_leave_with_2(argv, capsys):
    with pytest.raises(SystemExit) as left:
        main(argv)
    assert left.value.code == 2
    assert "error: " in capsys.readouterr().err


def test_contact_in_the_default_window_is_not_tared_away(lwr, tmp_path, capsys):
    log = write_insertion(tmp_path / "early.npz", lwr, contact_s=1.2)
    line = complaint([str(log)], capsys)
    assert_matches(line, "no tare from .*needle.*--force-tare.*--tare START:END.*--no-tare")


def test_a_picture_without_matplotlib_is_refused_before_the_work(folder, monkeypatch, capsys):
    monkeypatch.setitem(__import__("sys").modules, "matplotlib", None)
    monkeypatch.setitem(__import__("sys").modules, "matplotlib.figure", None)
    line = complaint([str(folder / "good.csv"), "--no-tare", "--png", "f.png"], capsys)
    assert_matches(line, r"pip install 'needleforce\[plots\]'")


def test_a_file_that_cannot_be_written_is_told(folder, tmp_path, capsys):
    pytest.importorskip("matplotlib")
    argv = [str(folder / "good.csv"), "--no-tare", "--png", str(tmp_path)]
    assert_matches(complaint(argv, capsys), "cannot write")


def test_warnings_of_the_log_are_passed_on(folder, tmp_path, capsys):
    text = (folder / "good.csv").read_text().splitlines()
    text[40] = text[40].rsplit(",", 1)[0] + ",oops"
    (tmp_path / "log.csv").write_text("\n".join(text) + "\n")
    assert main([str(tmp_path / "log.csv"), "--external-torque", "--no-tare"]) == 0
    assert "warning: " in capsys.readouterr().err
