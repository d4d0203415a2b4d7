"""`needleforce identify`: from a recording to layers, a table and a picture."""

import builtins
import re
import sys
from pathlib import Path

import numpy as np
import pytest

from groundtruth import insert_needle
from identification import replay
from identification.errors import InvalidLogError
from identification.log_replay import sign_hints
from needleforce.cli import main
from needleforce.recordings import write_table


@pytest.fixture(scope="module")
def needle():
    run = insert_needle("gel-50-constant", seed=1, rate_hz=250.0)
    start = int(np.searchsorted(run.t_s, run.tare_end_s))
    return run, slice(start, None)


def write(path, needle, force_sign=1.0, speed=True):
    run, part = needle
    columns = [run.t_s[part], run.depth_m[part], force_sign * run.force_N[part]]
    names = "t_s,depth_m,force_N"
    if speed:
        columns.append(run.speed_m_s[part])
        names += ",speed_m_s"
    np.savetxt(path, np.column_stack(columns), delimiter=",", header=names, comments="")
    return str(path)


def test_command_prints_layers_and_writes_table_and_picture(needle, tmp_path, capsys):
    log = write(tmp_path / "log.csv", needle)
    out, png = tmp_path / "out.csv", tmp_path / "out.png"
    assert main(["identify", log, "-o", str(out), "--png", str(png)]) == 0
    printed = capsys.readouterr().out.splitlines()
    assert len(printed) == 2
    assert "friction N" in printed[0]
    table = np.genfromtxt(out, delimiter=",", names=True)
    assert len(table) == len(needle[0].t_s[needle[1]])
    assert np.count_nonzero(table["rupture"]) == 1
    assert np.all(table["used"] == 1)
    assert png.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize("method", ["published", "published-kv"])
def test_command_offers_the_published_method(needle, tmp_path, capsys, method):
    log = write(tmp_path / "log.csv", needle)
    assert main(["identify", log, "--method", method]) == 0
    assert capsys.readouterr().out


def test_the_table_and_the_rows_tell_the_same_instant_of_an_alarm(tmp_path, capsys):
    run = insert_needle("gel-50-constant", seed=1, rate_hz=20.0)
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    columns = {"t_s": run.t_s + 100.0, "depth_m": run.depth_m, "force_N": run.force_N}
    write_table(log, columns | {"speed_m_s": run.speed_m_s})
    assert main(["identify", str(log), "-o", str(out)]) == 0
    rows = np.genfromtxt(out, delimiter=",", names=True)
    alarm_s = rows["t_s"][rows["rupture"] > 0]
    header, *lines = capsys.readouterr().out.splitlines()
    at = [name.strip() for name in re.split(r"  +", header.strip())].index("alarm s")
    told = [float(re.split(r"  +", line.strip())[at]) for line in lines]
    assert len(told) == 1
    assert told == pytest.approx(alarm_s, abs=0.006)


def test_speed_is_derived_when_it_is_not_recorded(needle):
    run, part = needle
    derived = replay(run.t_s[part], run.depth_m[part], run.force_N[part])
    given = replay(run.t_s[part], run.depth_m[part], run.force_N[part], run.speed_m_s[part])
    assert len(derived.layers) == len(given.layers) == 1
    assert derived.layers[0].friction_N == pytest.approx(given.layers[0].friction_N, rel=0.05)


def test_flipped_force_gets_a_hint(needle, tmp_path, capsys):
    log = write(tmp_path / "log.csv", needle, force_sign=-1.0)
    assert main(["identify", log]) == 0
    assert "flip its sign; a factor of -1 after the unit does" in capsys.readouterr().err
    assert main(["identify", log, "--force", "force_N:N:-1"]) == 0
    assert "flip" not in capsys.readouterr().err


def test_hints_name_what_is_odd(needle):
    run, part = needle
    z, v, f = run.depth_m[part], run.speed_m_s[part], run.force_N[part]
    assert sign_hints(z, v, f) == ()
    assert any("speed" in hint for hint in sign_hints(z, -v, f))
    assert any("millimetres" in hint for hint in sign_hints(1e3 * z, v, f))
    assert any("depth" in hint for hint in sign_hints(-z, None, f))
    assert any("nothing to identify" in hint for hint in sign_hints(0.0 * z, None, f))


def test_refused_rows_are_counted_with_the_reason(needle, tmp_path, capsys):
    run, part = needle
    columns = {"t_s": run.t_s[part], "depth_m": run.depth_m[part], "force": 1e3 * run.force_N[part]}
    write_table(tmp_path / "mN.csv", columns)
    assert main(["identify", str(tmp_path / "mN.csv")]) == 0
    told = capsys.readouterr().err
    refused = int((np.abs(columns["force"]) > 200.0).sum())
    assert f"rows that were refused: {refused} (force beyond any needle's: check the unit)" in told
    assert "in SI; if the file is in mN, say unit = 'mN'" in told
    assert main(["identify", str(tmp_path / "mN.csv"), "--force", "force:mN"]) == 0
    assert "refused" not in capsys.readouterr().err


def test_missing_file_and_empty_log_are_one_clear_line(tmp_path, capsys):
    assert main(["identify", str(tmp_path / "none.csv")]) == 2
    assert "error:" in capsys.readouterr().err
    (tmp_path / "empty.csv").write_text("")
    assert main(["identify", str(tmp_path / "empty.csv")]) == 2
    assert capsys.readouterr().err.count("\n") == 1


def test_outputs_are_refused_before_the_work(needle, tmp_path, capsys):
    log = write(tmp_path / "log.csv", needle)
    assert main(["identify", log, "--png", str(tmp_path / "no" / "x.png")]) == 2
    assert main(["identify", log, "-o", str(tmp_path / "no" / "x.csv")]) == 2
    assert "no folder" in capsys.readouterr().err


def test_a_picture_without_matplotlib_says_what_to_install(monkeypatch, tmp_path, capsys):
    real = builtins.__import__

    def refuse(name, *args, **kwargs):
        if name.startswith("matplotlib"):
            raise ImportError(name)
        return real(name, *args, **kwargs)

    for name in [name for name in sys.modules if name.startswith("matplotlib")]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setattr(builtins, "__import__", refuse)
    assert main(["identify", str(tmp_path / "log.csv"), "--png", str(tmp_path / "x.png")]) == 2
    assert "pip install 'needleforce[plots]'" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("columns", "message"),
    [(([], [], []), "non-empty"), (([0.0, 1.0], [0.0], [0.0, 0.0]), "rows")],
)
def test_unusable_columns_are_refused(columns, message):
    with pytest.raises(InvalidLogError, match=message):
        replay(*columns)


def test_the_example_of_the_documentation_runs():
    text = (Path(__file__).parents[1] / "docs" / "identification.md").read_text(encoding="utf-8")
    names = {}
    exec(text.split("```python\n")[1].split("```")[0], names)
    assert names["estimate"].status.is_absorbed
    assert names["identifier"].layers == ()


def test_gaps_in_a_recording_are_reported_not_dropped():
    t = 0.01 * np.arange(200)
    force = np.where(np.arange(200) == 50, np.nan, 0.0)
    result = replay(t, 1e-5 * np.arange(200), force)
    assert len(result.estimates) == 200
    assert [k for k, e in enumerate(result.estimates) if not e.status.is_absorbed] == [50]


def test_a_clock_that_was_set_back_hides_no_layer(needle, tmp_path, capsys):
    run, part = needle
    t_s = run.t_s[part].copy()
    half = int(np.searchsorted(run.depth_m[part], 0.004))
    t_s[half:] -= t_s[half]
    log, out = tmp_path / "log.csv", tmp_path / "out.csv"
    write_table(log, {"t_s": t_s, "depth_m": run.depth_m[part], "force_N": run.force_N[part]})
    assert main(["identify", str(log), "-o", str(out)]) == 0
    told = capsys.readouterr()
    assert "clock set back" in told.err
    header, line = told.out.splitlines()
    cells = zip(*(re.split(r"  +", text.strip()) for text in (header, line)), strict=True)
    rupture_s = float(dict(cells)["rupture s"])
    given = replay(run.t_s[part], run.depth_m[part], run.force_N[part]).layers[0].rupture
    expected_s = given.time_s - 1.0 / 250.0 - (run.t_s[part][half] - run.t_s[part][0])
    assert rupture_s == pytest.approx(expected_s, abs=0.03)
    rows = np.genfromtxt(out, delimiter=",", names=True)
    np.testing.assert_array_equal(rows["t_s"], t_s)
    assert 3 <= np.count_nonzero(rows["used"] == 0) <= 30
