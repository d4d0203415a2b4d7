"""`needleforce identify`: from a recording to layers, a table and a figure."""

import os
import re
import signal
import threading

import numpy as np
import pytest

from groundtruth import insert_needle
from needleforce import session
from needleforce.cli import main
from needleforce.cli.terminal import INTERRUPTED
from needleforce.recordings import write_table
from needleforce.recordings.channels import FORCE_STATUS, WORTHLESS
from needleforce.simulation import signal_table
from residual import DEFAULT as SENSOR
from residual import SensorWarning, Status
from tests.chromium import PHONE, logged, measured, needs_chromium
from tests.insertion_run import short_run
from tests.needleforce.cli.residual_command_log import refusal


@pytest.fixture(scope="module")
def needle():
    """Columns of an insertion from the end of the free motion until it has left the
    gel."""
    run = insert_needle("gel-50-constant", seed=1, rate_hz=250.0)
    rows = slice(
        *np.searchsorted(run.t_s, (run.tare_end_s, run.truth.rupture_s[0] + 5.0))
    )
    names = ("t_s", "depth_m", "force_N", "speed_m_s")
    return {name: getattr(run, name)[rows] for name in names}


@pytest.fixture
def identify(needle, tmp_path, capsys):
    """Run the command on the needle's columns; return table, printed layers and
    complaints."""

    def run(*options, **changes):
        log = tmp_path / "log.csv"
        out = tmp_path / "out.csv"
        columns = {
            name: values for name, values in (needle | changes).items() if len(values)
        }
        write_table(log, columns)
        assert main(["identify", str(log), "-o", str(out), *options]) == 0
        printed = capsys.readouterr()
        lines, _, channels = printed.out.partition("\n\n")
        head, *texts = lines.splitlines()
        if texts:
            assert re.fullmatch(
                r"Depths are below first contact, -?[\d.]+ mm from the log's own "
                r"zero\.",
                texts.pop(),
            )
        names, *rows = (re.split(r"  +", line.strip()) for line in (head, *texts))
        assert channels.startswith("channel")
        layers = [dict(zip(names, row, strict=True)) for row in rows]
        return np.genfromtxt(out, delimiter=",", names=True), layers, printed.err

    return run


@pytest.mark.slow
def test_layers_are_printed_table_and_figures_written(needle, identify, tmp_path):
    png = tmp_path / "o.png"
    pdf = tmp_path / "depth.pdf"
    table, (layer,), _ = identify("--png", str(png))

    assert "±" in layer["friction N"]
    assert len(table) == len(needle["t_s"])
    assert np.count_nonzero(table["rupture"]) == 1
    assert table["identified_layer"][table["is_final"] == 1].tolist() == [1.0]
    assert np.all(table["used"] == 1)
    is_met = table["in_contact"] > 0
    below_mm = 1e3 * table["depth_in_tissue_m"][is_met]
    assert np.isnan(table["depth_in_tissue_m"][0])
    end_mm, end_std_mm = map(float, layer["to mm"].split("±"))
    assert end_mm == pytest.approx(below_mm[table["rupture"][is_met] > 0][0], abs=0.5)
    assert 0.0 < end_std_mm < 1.0
    assert png.read_bytes()[:4] == b"\x89PNG"

    identify("--figure", str(pdf), "--over", "depth", "--to", "20")

    assert pdf.read_bytes().startswith(b"%PDF")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("method", "start_s"),
    [("mixture", 1.7e9), ("published", 100.0), ("published-kv", 0.0)],
)
def test_alarm_is_on_the_logs_clock(needle, identify, method, start_s):
    rows, (layer,), _ = identify("--method", method, t_s=needle["t_s"] + start_s)
    assert float(layer["alarm s"]) == pytest.approx(
        rows["t_s"][rows["rupture"] > 0][0], abs=0.006
    )


@pytest.mark.slow
def test_wrong_signs_and_units_get_a_hint(needle, identify, tmp_path, capsys):
    force_N = needle["force_N"]
    *_, said = identify(force_N=-force_N)

    assert "Negate it, as in --force fz:N:-1" in said
    assert main(["report", str(tmp_path / "log.csv"), str(tmp_path / "page")]) == 0
    assert "Negate it, as in --force fz:N:-1" in capsys.readouterr().err

    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")

    assert "<p class=notice>Warning: " in page
    assert "the force is negative" in page
    assert "Negate" not in identify("--force", "force_N:N:-1", force_N=-force_N)[2]

    for name, option in {"depth_m": "depth z:m", "speed_m_s": "speed v:m/s"}.items():
        *_, said = identify(**{"speed_m_s": (), name: -needle[name]})
        assert f"Negate it, as in --{option}:-1" in said
        assert "fz" not in said
    in_mN = {"speed_m_s": (), "force_N": (), "force": 1e3 * force_N}
    assert "rejected" not in identify("--force", "force:mN", **in_mN)[2]


def test_a_log_of_which_no_row_is_used_is_refused(needle, tmp_path, capsys):
    log = tmp_path / "log.csv"
    depth_m = needle["depth_m"].copy()
    force_N = needle["force_N"].copy()
    depth_m[::2] = np.nan
    force_N[1::2] = np.nan
    write_table(log, {"t_s": needle["t_s"], "depth_m": depth_m, "force_N": force_N})
    for argv in (["identify", str(log)], ["report", str(log), str(tmp_path / "page")]):
        said = refusal(argv, capsys)
        assert f"none of {len(depth_m)} rows" in said
        assert f"{len(depth_m)} x not finite" in said
    assert not (tmp_path / "page").exists()


@pytest.mark.parametrize("factor", [1e3, 1e6])
def test_a_time_in_ms_or_us_is_not_taken_for_seconds(needle, tmp_path, capsys, factor):
    log = tmp_path / "log.csv"
    names = ("depth_m", "force_N")
    columns = {"t_s": factor * needle["t_s"]} | {name: needle[name] for name in names}
    write_table(log, columns)

    assert f"{factor / 250:.4g} s lie between" in refusal(
        ["identify", str(log)], capsys
    )


@pytest.mark.slow
def test_an_interrupted_report_leaves_the_page_that_was_there(needle, tmp_path, capsys):
    log = tmp_path / "log.csv"
    write_table(log, needle)
    page = tmp_path / "page" / "index.html"
    page.parent.mkdir()
    page.write_text("of yesterday")
    timer = threading.Timer(0.2, os.kill, (os.getpid(), signal.SIGINT))
    timer.start()

    assert main(["report", str(log), str(page.parent)]) == INTERRUPTED
    assert page.read_text() == "of yesterday"
    assert os.listdir(page.parent) == ["index.html"]


@pytest.mark.slow
def test_forces_beyond_the_assumed_unit_are_refused(needle, tmp_path, capsys):
    log = tmp_path / "log.csv"
    columns = {name: needle[name] for name in ("t_s", "depth_m")}
    write_table(log, {**columns, "force": 1e3 * needle["force_N"]})

    assert main(["identify", str(log)]) == 2
    assert "as in --force force:mN" in capsys.readouterr().err
    assert main(["identify", str(log), "--force", "force:mN"]) == 0
    assert "force    force in mN (mapping)" in capsys.readouterr().out


@pytest.mark.slow
def test_a_testing_machines_export_gives_its_units(needle, tmp_path, capsys):
    log = tmp_path / "Specimen_RawData_1.csv"
    rows = zip(
        needle["t_s"], 1e3 * needle["depth_m"], 1e-3 * needle["force_N"], strict=True
    )
    text = "".join(f'"{t:.4f}","{z:.4f}","{f:.7f}"\n' for t, z, f in rows)
    log.write_text(f"Results Table 1\n\nTime,Extension,Load\n(s),(mm),(kN)\n{text}")

    assert main(["report", str(log), str(tmp_path / "page")]) == 0

    out = capsys.readouterr().out

    assert out.splitlines()[-5:-2] == [
        "time     Time in s (row of units, line 4)",
        "depth    Extension in mm (row of units, line 4)",
        "force    Load in kN (row of units, line 4)",
    ]
    assert out.splitlines()[1].split()[0] == "1"

    page = (tmp_path / "page" / "index.html").read_text(encoding="utf-8")

    assert "Load in kN (row of units, line 4)" in page
    assert main(["identify", str(log), "--depth", "Extension:m"]) == 2

    error = capsys.readouterr().err

    assert "the mapping says m for column 'Extension', and the row of units" in error
    assert "as in --depth Extension:mm\n" in error


def test_a_layout_of_the_user_is_known_to_the_command(tmp_path, capsys):
    log = tmp_path / "log.csv"
    log.write_text("t [s],droga [mm],load [daN]\n0,1,2\n1,2,3\n")
    layout = tmp_path / "my.toml"
    layout.write_text(
        "[units.force]\ndaN = [10]\n[channels.depth]\nwords = ['droga']\n"
    )
    options = ["--layout", str(layout), "--print-config"]

    assert main(["identify", str(log), *options]) == 0

    printed = capsys.readouterr().out

    assert 'columns = "droga [mm]"' in printed
    assert 'unit = "daN"' in printed


def test_codes_match_sensor_and_session():
    assert tuple(status.value for status in Status) == FORCE_STATUS

    for word, bit in WORTHLESS.items():
        assert SensorWarning[word.upper().replace(" ", "_")] == bit

    assert sum(WORTHLESS.values()) == session.UNUSABLE


@pytest.mark.slow
def test_marked_rows_are_counted_and_ignored(needle, identify):
    count = len(needle["t_s"])
    status, warnings = np.zeros((2, count))
    status[:4] = [0.0, 1.0, 2.0, 3.0]
    warnings[4:6] = [5.0, 32.0 + 1.0]
    rows, _, said = identify(force_status=status, force_warnings=warnings)

    assert rows["used"][:7].tolist() == [1, 0, 0, 0, 1, 0, 1]
    assert re.findall(r"were left out: (\d+)", said) == ["3", "1"]
    assert len(identify(status=np.ones(count))[1]) == 1

    marked = {"force_warnings": np.full(count, 32)}
    _, layers, said = identify(**marked)

    assert f"velocity) were left out: {count}" in said
    assert layers == []
    assert len(identify("--ignore-status", **marked)[1]) == 1
    assert (
        len(identify("--force", "force_N", **marked)[1]) == 1
    )  # it may be another sensor's


@pytest.fixture(scope="module")
def insertion(tmp_path_factory):
    """A simulated recording, its forces with a tare, and the layers in them, each
    with a page."""
    pytest.importorskip("matplotlib")
    folder = tmp_path_factory.mktemp("report")
    run = short_run()
    rows = np.flatnonzero(run.signals.t_s < 34.0)[::2]
    table = {name: values[rows] for name, values in signal_table(run).items()}
    table["tau_Nm"][7500:7525] = np.nan
    table["t_s"] += 1.7e9
    write_table(folder / "log.npz", table)
    tare = ["--tare", "+0:+13"]
    assert (
        main(["report", str(folder / "log.npz"), str(folder / "a" / "log"), *tare]) == 0
    )
    forces = str(folder / "forces.csv")
    assert main(["force", str(folder / "log.npz"), *tare, "-o", forces]) == 0
    assert main(["report", forces, str(folder / "layers")]) == 0
    return folder


@pytest.mark.slow
def test_report_shows_forces_and_their_layers(insertion):
    page, alone = (
        (insertion / name / "index.html").read_text(encoding="utf-8")
        for name in ("a/log", "layers")
    )

    assert "Forces and layers from log.npz" in page
    assert "Layers from forces.csv" in alone

    # The answer stands first, before any section; settings stand last.
    lead = page[: page.index("<section")]

    assert re.search(r"Force along the needle: \S+ to \S+ N", lead)
    assert re.search(r"ruptures? detected, [\d.]+ mm below first contact", lead)
    assert "Layers traversed" in lead
    assert "Warning: rows whose status" in lead
    assert "not a medical device" in lead
    assert re.findall('<section id="([^"]+)"', page) == [
        "layers",
        "forces",
        "summary",
        "channels",
        "sensor",
        "identification",
    ]
    assert re.findall('<section id="([^"]+)"', alone) == [
        "layers",
        "channels",
        "identification",
    ]

    for label in ("robot", "samples", "rejected", "gaps", "tare", "lag"):
        assert f"<td>{label}</td>" in page

    assert f"<td>{SENSOR.gain_per_s:g}</td>" in page
    assert "<code>prior.gear_ratio</code>" in page

    for text in ("friction N", "<code>alarm_probability</code>"):
        assert text in page
        assert text in alone
    tables = [re.search(r"Layers traversed.*?</table>", p, re.S) for p in (page, alone)]

    assert tables[0].group() == tables[1].group()

    rows = "t_s,depth_m,force_N,q1,q2,/b/q1,/b/q2\n0,0,0,1,1,1,1\n1,0.001,1,1,1,1,1\n"
    (insertion / "two.csv").write_text(rows)  # whose joints are meant does not matter

    assert main(["report", str(insertion / "two.csv"), str(insertion / "two")]) == 0

    for text in (
        "time since the first sample [s]",
        "axial force [N]",
        "tare",
        "rejected",
    ):
        assert (
            f"<!-- {text} -->"
            in (insertion / "a" / "log" / "forces-over-time.svg").read_text()
        )
    for text in ("estimated rupture time", "friction identified", "enhanced force"):
        assert f"<!-- {text} -->" in (insertion / "layers" / "layers.svg").read_text()


@pytest.mark.slow
@needs_chromium
def test_pages_open_on_a_phone(insertion):
    for page in (insertion / name / "index.html" for name in ("a/log", "layers")):
        assert logged(page) == []
        sizes = measured(page, PHONE)
        assert sizes["content"] <= PHONE[0]
        assert sizes["wide"] == []
        assert len(sizes["images"]) == page.read_text(encoding="utf-8").count(
            "<figcaption>"
        )
        assert min(sizes["images"]) > 150
