"""What every command does with errors, signals, outputs, long tables, help and
options."""

import io
import os
import signal
import subprocess
import sys
import tomllib
from pathlib import Path

import numpy as np
import pytest

from needleforce.cli import app, main
from needleforce.cli.logs.outputs import check_outputs
from needleforce.cli.logs.row_overview import RowOverview
from needleforce.cli.shared_options import Output
from needleforce.cli.terminal import (
    FAILED,
    INTERRUPTED,
    READER_GONE,
    CommandError,
    progress_bar,
    run_command,
    say,
    stop_request,
    write_out,
)
from needleforce.plots import FiguresError
from needleforce.recordings import FileAccessError, load_mapping, read_log, write_table
from needleforce.recordings.table import TableLabels
from tests.needleforce.cli.residual_command_log import insertion


def failing(error):
    def work():
        raise error

    return work


@pytest.fixture(autouse=True)
def _open_output(monkeypatch):
    """What is done to standard output must not outlive the test."""
    monkeypatch.setattr("needleforce.cli.terminal._close_output", lambda: None)


@pytest.mark.parametrize(
    ("error", "code", "said"),
    [
        (
            CommandError("no such\noption"),
            FAILED,
            "error: no such option. --help says what each option means\n",
        ),
        (
            FileAccessError("no such\nfile"),
            FAILED,
            "error: no such file. Check the name, the permissions "
            "and the space that is left\n",
        ),
        (KeyboardInterrupt(), INTERRUPTED, "interrupted\n"),
        (BrokenPipeError(), READER_GONE, ""),
        (
            OSError(28, "disk full"),
            FAILED,
            "error: cannot write standard output: disk full. Make "
            "room on the disk, or give another place\n",
        ),
    ],
)
def test_foreseen_failure_is_one_line_and_code(capsys, error, code, said):
    assert run_command(failing(error)) == code
    assert capsys.readouterr().err == said


def test_unforeseen_error_is_raised_and_code_returned(capsys):
    for error in (ZeroDivisionError(), PermissionError(13, "forbidden", "some.file")):
        with pytest.raises(type(error)):
            run_command(failing(error))

    assert run_command(lambda: 7) == 7

    say("two\nlines")
    write_out("table\n", to_stderr=True)
    write_out("result\n")
    printed = capsys.readouterr()

    assert printed.err == "two lines\ntable\n"
    assert printed.out == "result\n"


def test_first_ctrl_c_asks_second_interrupts():
    # A job in the background of a shell starts with it ignored.
    handler = signal.signal(signal.SIGINT, signal.default_int_handler)
    with stop_request() as stop:
        assert not stop()
        os.kill(os.getpid(), signal.SIGINT)
        assert stop()
        with pytest.raises(KeyboardInterrupt):
            os.kill(os.getpid(), signal.SIGINT)

    with pytest.raises(KeyboardInterrupt):
        os.kill(os.getpid(), signal.SIGINT)

    signal.signal(signal.SIGINT, handler)


def test_unwritable_characters_become_escapes(monkeypatch):
    stream = io.TextIOWrapper(io.BytesIO(), encoding="ascii")
    monkeypatch.setattr(sys, "stdout", stream)
    write_out("0.3±0.1 \udcff\n")

    assert stream.buffer.getvalue() == b"0.3\\xb10.1 \\udcff\n"


@pytest.mark.slow
def test_help_and_version_answer_without_the_estimators(capsys):
    assert main(["--help"]) == 0

    for name in ("simulate", "force", "identify", "report"):
        assert name in capsys.readouterr().out or main([name, "--help"]) == 0
    code = "import sys; from needleforce.cli import main; main(['force', '--help']); "
    code += "print({'pinocchio', 'numba', 'numpy'} & set(sys.modules))"
    process = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=True
    )

    assert process.stdout.splitlines()[-1] == "set()"
    assert "--external-torque" in process.stdout
    assert "START:END" in process.stdout


@pytest.mark.slow
def test_packages_forward_to_the_command_shells_complete_it():
    for package in ("residual", "identification", "groundtruth"):
        argv = [sys.executable, "-m", package, "--help"]
        process = subprocess.run(argv, capture_output=True, text=True, check=True)
        assert process.stdout.startswith("Usage: needleforce ")
    for shell in ("bash", "zsh", "fish"):
        script = app.generate_completion(shell=shell)
        for word in ("force", "identify", "external-torque", "published-kv"):
            assert word in script


COLUMNS = {"t_s": np.arange(3) / 1000.0, "force_N": np.ones(3)}


@pytest.fixture
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    write_table("log.csv", COLUMNS)
    (tmp_path / "bag").mkdir()
    write_table("bag/bag.mcap", COLUMNS)
    (tmp_path / "bag/metadata.yaml").touch()
    (tmp_path / "link").symlink_to(tmp_path / "bag")
    (tmp_path / "log.png").symlink_to(tmp_path / "log.csv")
    (tmp_path / "hard.csv").hardlink_to(tmp_path / "log.csv")
    (tmp_path / "f.csv").touch()
    (tmp_path / "t.csv").mkdir()
    (tmp_path / "f.png").symlink_to(tmp_path / "f.csv")
    return tmp_path


def check(source, **outputs):
    paths = {
        name: path if name == "output" else Path(path) for name, path in outputs.items()
    }
    return check_outputs(source, Output(**paths))


@pytest.mark.usefixtures("folder")
@pytest.mark.parametrize(
    ("source", "outputs", "message"),
    [
        ("bag/bag.mcap", {"output": "bag/x.csv"}, "the log"),
        ("link", {"output": "bag/x.csv"}, "the log"),
        ("bag", {"report": "bag/r"}, "the log"),
        ("log.csv", {"figure": "log.png"}, "the log"),
        ("log.csv", {"output": "hard.csv"}, "the log"),
        ("log.csv", {"output": "f.csv", "figure": "f.png"}, "--figure"),
        ("other.csv", {"figure": "picture.gif"}, "cannot write picture.gif"),
        ("other.csv", {"figure": "no/where.svg"}, "there is no folder no"),
        ("log.csv", {"output": "t.csv"}, "it is a folder"),
        ("log.csv", {"report": "r" * 300}, "File name too long"),
        ("log.csv", {"output": "bag.db3"}, "bag.db3"),
    ],
    ids=str,
)
def test_harmful_output_is_refused(source, outputs, message):
    pytest.importorskip("matplotlib")
    with pytest.raises((FileAccessError, CommandError, FiguresError), match=message):
        check(source, **outputs)


@pytest.mark.usefixtures("folder")
def test_outputs_side_by_side_are_fine():
    assert check("log.csv", output="f.csv", figure="g.pdf", report=".") is None
    assert check("bag", output="f.mcap", figure="g.png", report="report") is None


@pytest.mark.parametrize("pieces", [1, 90])
def test_overview_keeps_few_rows_and_all_extremes(pieces):
    x = np.random.default_rng(0).normal(size=5_000)
    x[::7] = np.nan
    overview = RowOverview(("x",), max_rows=200)
    for numbers in np.array_split(np.arange(len(x)), pieces):
        overview.add({"n": numbers, "x": x[numbers]})
    rows = overview.columns()

    assert 50 < len(rows["n"]) <= 200
    assert 0 < np.diff(rows["n"]).min() <= np.diff(rows["n"]).max() < 500
    np.testing.assert_array_equal(rows["x"], x[rows["n"]])
    assert (np.nanmin(rows["x"]), np.nanmax(rows["x"])) == (np.nanmin(x), np.nanmax(x))


@pytest.fixture
def run(tmp_path, monkeypatch, capsys):
    """Run a command in an empty folder; return what it prints."""
    monkeypatch.chdir(tmp_path)

    def run(*argv):
        assert main([*argv]) == 0
        return capsys.readouterr().out

    return run


def written(text):
    Path("map.toml").write_text(text, encoding="utf-8")
    return "map.toml"


def test_printed_mapping_holds_the_options(run, capsys):
    Path("log.csv").write_text("Zeit;Weg;fz [mN]\n0;1;2\n1;2;3\n", encoding="utf-8")
    columns = ["--time", "Zeit:ms", "--depth", "Weg:mm:-1", "--force", "fz [mN]"]
    mapping = load_mapping(
        written(run("identify", "log.csv", *columns, "--print-config"))
    )
    log = read_log("log.csv", mapping, required=["depth", "force"])

    np.testing.assert_allclose(log.t_s, [0.0, 1e-3])
    np.testing.assert_allclose(log["depth_m"], [-1e-3, -2e-3])
    np.testing.assert_allclose(log["force_N"], [2e-3, 3e-3])

    rate = load_mapping(
        written(run("identify", "log.csv", "--rate", "50", "--print-config"))
    )

    assert rate.rate_hz == 50.0
    assert main(["identify", "log.csv", "--force", "nothing", "--print-config"]) == 2
    assert "no column 'nothing'" in capsys.readouterr().err


@pytest.mark.slow
def test_mapping_is_printed_edited_and_read_back(run, lwr):
    columns = insertion(lwr)
    table = {name: columns[name] for name in ("t_s", "q_rad", "dq_rad_s", "tau_Nm")}
    turned = {k: v[..., ::-1] if v.ndim == 2 else v for k, v in table.items()}
    write_table(
        "log.mcap", turned, labels=TableLabels(joint_names=lwr.joint_names[::-1])
    )
    write_table("log.csv", table)
    text = run("force", "log.mcap", "--print-config")

    assert tomllib.loads(text)["joints"] == list(lwr.joint_names)
    assert tomllib.loads(text)["payload"]["needle"]["needle_mass_kg"] == 0.068

    edited = written(text.replace("scale = 1.0  # -1.0", "scale = -1.0  # -1.0"))
    results = []
    for options in (
        ["log.csv", "-o", "a.npz", "--tare", "0:2.5"],
        ["log.mcap", "-o", "b.npz", "--tare", "0:2.5"],
        ["log.mcap", "-o", "c.npz", "--no-tare", "--mapping", edited],
    ):
        run("force", *options)
        results.append(np.load(options[2])["axial_N"])

    np.testing.assert_allclose(results[1], results[0], atol=1e-9)
    assert not np.allclose(results[2], results[0], equal_nan=True)

    content = tomllib.loads(run("identify", "b.npz", "--print-config"))

    assert content["force"]["columns"] == "axial_unsmoothed_N"
    assert content["depth"]["columns"] == "travel_m"


@pytest.mark.slow
def test_the_payload_may_stand_in_the_mapping(run, lwr):
    write_table(
        "log.npz", {name: insertion(lwr)[name] for name in ("t_s", "q_rad", "tau_Nm")}
    )
    for lines, options, summary, printed in (
        ("joints = []", [], "payload 0.304 kg", "needle_mass_kg = 0.068"),
        ('payload = "none"', [], "payload 0 kg", 'payload = "none"'),
        (
            "[payload]\nmass_kg = 1.5\ncom_m = [0, 0, 0.1]",
            [],
            "payload 1.5 kg",
            "mass_kg = 1.5",
        ),
        (
            "[payload.needle]\nsensor_mass_kg = 0.0",
            [],
            "payload 0.068 kg",
            "sensor_mass_kg = 0.0",
        ),
    ):
        argv = ["force", "log.npz", "--mapping", written(lines), *options]
        assert summary in run(*argv, "--no-tare").splitlines()[0]
        assert printed in run(*argv, "--print-config")


# A long command shows on a terminal how far it is, on stderr, and nowhere else.


ROWS = np.arange(20_000)
LONG_COLUMNS = {"t_s": ROWS / 1000, "depth_m": 1e-6 * ROWS, "force_N": 1e-3 * ROWS**0.5}


class Terminal(io.StringIO):
    def isatty(self):
        return True


@pytest.mark.parametrize("is_terminal", [False, True])
def test_progress_bar_needs_a_terminal(monkeypatch, is_terminal):
    stream = Terminal() if is_terminal else io.StringIO()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")
    with progress_bar("log.csv") as progress:
        progress(0.5)
    with progress_bar("other.csv", is_wanted=False) as progress:
        progress(0.5)

    assert ("log.csv" in stream.getvalue(), "50%" in stream.getvalue()) == (
        is_terminal,
    ) * 2
    assert "other.csv" not in stream.getvalue()


@pytest.mark.slow
def test_progress_bar_leaves_the_result_unchanged(tmp_path, monkeypatch, capsys):
    path = tmp_path / "log.csv"
    write_table(path, LONG_COLUMNS)

    assert main(["identify", str(path)]) == 0

    plain = capsys.readouterr().out
    stream = Terminal()
    monkeypatch.setattr("sys.stderr", stream)
    monkeypatch.setenv("TERM", "xterm")

    assert main(["identify", str(path)]) == 0
    assert capsys.readouterr().out == plain
    assert "log.csv" in stream.getvalue()
