"""``--print-config`` writes a mapping for a given recording, which reads as without one."""

import tomllib

import numpy as np
import pytest
from bag_samples import data_file, insertion_rows, write_bag
from residual_command_log import insertion

from needleforce.cli import main
from needleforce.recordings import load_mapping, read_log, write_table
from needleforce.recordings.open_recording import suggest_mapping
from needleforce.recordings.table import Labels

JOINTS = ("q", "dq", "tau")


@pytest.fixture(scope="module")
def columns(lwr):
    """Joint signals of a short insertion."""
    wanted = ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    return {name: insertion(lwr)[name] for name in wanted}


def written(tmp_path, text):
    path = tmp_path / "map.toml"
    path.write_text(text, encoding="utf-8")
    return path


def test_what_was_lost_is_a_comment(tmp_path):
    path = data_file(write_bag(tmp_path / "bag", insertion_rows(2000)))
    path.write_bytes(path.read_bytes()[:100_000])
    text = suggest_mapping(path, JOINTS)
    assert any(line.startswith("# bag.mcap is cut short") for line in text.splitlines())
    assert tomllib.loads(text)["reference_topic"] == "/joint_states"


def test_what_options_say_already_stands_in_the_mapping(tmp_path, capsys):
    path = tmp_path / "log.csv"
    path.write_text("Zeit;Weg;fz [mN]\n0;1;2\n1;2;3\n", encoding="utf-8")
    argv = [str(path), "--time", "Zeit:ms", "--depth", "Weg:mm:-1", "--force", "fz [mN]"]
    assert main(["identify", *argv, "--print-config"]) == 0
    mapping = load_mapping(written(tmp_path, capsys.readouterr().out))
    log = read_log(path, mapping, required=["depth", "force"])
    np.testing.assert_allclose(log.t_s, [0.0, 1e-3])
    np.testing.assert_allclose(log["depth_m"], [-1e-3, -2e-3])
    np.testing.assert_allclose(log["force_N"], [2e-3, 3e-3])
    assert main(["identify", str(path), "--rate", "50", "--print-config"]) == 0
    rate = load_mapping(written(tmp_path, capsys.readouterr().out))
    assert rate.rate_hz == 50.0
    assert main(["identify", str(path), "--force", "nothing", "--print-config"]) == 2
    assert "no column 'nothing'" in capsys.readouterr().err


def test_joint_columns_with_a_factor_each_are_kept(tmp_path, capsys):
    path = tmp_path / "log.csv"
    head = ["t", *(f"{name}{i}" for name in ("Achse", "Strom") for i in range(1, 8))]
    path.write_text(f"{','.join(head)}\n{','.join('1' * 15)}\n2{',1' * 14}\n", encoding="utf-8")
    given = tmp_path / "given.toml"
    given.write_text(
        '[tau]\ncolumns = "Strom*"\nscale = [1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -7.0]\n',
        encoding="utf-8",
    )
    argv = [str(path), "--q", "Achse:deg", "--mapping", str(given), "--print-config"]
    assert main(["force", *argv]) == 0
    mapping = load_mapping(written(tmp_path, capsys.readouterr().out))
    log = read_log(path, mapping, required=["q", "tau"])
    np.testing.assert_allclose(log["q_rad"], np.full((2, 7), np.pi / 180.0))
    np.testing.assert_allclose(log["tau_Nm"], [[1.0, 2.0, 3.0, 4.0, 5.0, 6.0, -7.0]] * 2)


def test_the_commands_print_edit_and_read_it(tmp_path, columns, lwr, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    order = [6, 5, 4, 3, 2, 1, 0]
    turned = columns | {n: columns[n][:, order] for n in ("q_rad", "dq_rad_s", "tau_Nm")}
    names = tuple(lwr.joint_names[i] for i in order)
    write_table("log.mcap", turned, labels=Labels(joint_names=names))
    write_table("log.csv", columns)
    assert main(["force", "log.mcap", "--print-config"]) == 0
    text = capsys.readouterr().out
    assert tomllib.loads(text)["joints"] == list(lwr.joint_names)
    assert tomllib.loads(text)["payload"]["needle"]["needle_mass_kg"] == 0.068
    edited = written(tmp_path, text.replace("scale = 1.0  # -1.0", "scale = -1.0  # -1.0"))
    tare = ["--tare", "0:2.5"]
    results = []
    for options in (
        ["log.csv", "-o", "a.npz", *tare],
        ["log.mcap", "-o", "b.npz", *tare],
        ["log.mcap", "-o", "c.npz", "--no-tare", "--mapping", str(edited)],
    ):
        assert main(["force", *options]) == 0
        results.append(np.load(options[2])["axial_N"])
    np.testing.assert_allclose(results[1], results[0], atol=1e-9)
    assert not np.allclose(results[2], results[0], equal_nan=True)
    capsys.readouterr()
    assert main(["identify", "b.npz", "--print-config"]) == 0
    content = tomllib.loads(capsys.readouterr().out)
    assert content["force"]["columns"] == "axial_N"
    assert content["depth"]["columns"] == "travel_m"


@pytest.mark.parametrize(
    ("lines", "options", "summary"),
    [
        ("joints = []", [], "payload 0.304 kg"),
        ('payload = "none"', [], "payload 0 kg"),
        ('payload = "none"', ["--payload", "needle"], "payload 0.304 kg"),
        ("[payload]\nmass_kg = 1.5\ncom_m = [0.0, 0.0, 0.1]", [], "payload 1.5 kg"),
        ("[payload.needle]\nsensor_mass_kg = 0.0", [], "payload 0.068 kg"),
    ],
)
def test_the_payload_may_stand_in_the_mapping(
    tmp_path, columns, capsys, monkeypatch, lines, options, summary
):
    monkeypatch.chdir(tmp_path)
    write_table("log.npz", columns)
    mapping = written(tmp_path, lines)
    assert main(["force", "log.npz", "--no-tare", "--mapping", str(mapping), *options]) == 0
    assert summary in capsys.readouterr().out.splitlines()[0]


def test_a_payload_is_printed_as_it_is_read(tmp_path, columns, capsys, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_table("log.npz", columns)
    lines = "[payload]\nmass_kg = 1.5\ncom_m = [0.0, 0.0, 0.1]"
    mapping = written(tmp_path, lines)
    assert main(["force", "log.npz", "--mapping", str(mapping), "--print-config"]) == 0
    payload = tomllib.loads(capsys.readouterr().out)["payload"]
    assert payload["mass_kg"] == 1.5
    assert payload["com_m"] == [0.0, 0.0, 0.1]
    assert main(["force", "log.npz", "--payload", "none", "--print-config"]) == 0
    assert tomllib.loads(capsys.readouterr().out)["payload"] == "none"


def test_a_report_is_about_what_the_log_holds(tmp_path, columns, lwr, capsys):
    pytest.importorskip("matplotlib")
    write_table(tmp_path / "joints.npz", columns)
    forces = {"t_s": columns["t_s"], "z": 1e-5 * columns["t_s"], "f": np.sin(columns["t_s"])}
    write_table(tmp_path / "forces.npz", forces)
    for log, options, title in (
        ("joints", ["--tare", "0:2.5"], "Forces from joints.npz"),
        ("forces", ["--depth", "z", "--force", "f"], "Layers in forces.npz"),
    ):
        folder = tmp_path / log
        assert main(["report", str(tmp_path / f"{log}.npz"), str(folder), *options]) == 0
        assert title in (folder / "index.html").read_text(encoding="utf-8")
    assert "no rupture detected" in capsys.readouterr().out
