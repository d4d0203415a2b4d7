"""`needleforce identify` and `report`: from a recording to layers, table, figure,
page."""

import re
import signal

import numpy as np
import pytest
from matplotlib.axes import Axes

from groundtruth import insert_needle
from identification import replay
from needleforce.cli import main
from needleforce.recordings import write_table
from needleforce.simulation import signal_table
from residual import DEFAULT as SENSOR
from residual import SensorWarning
from tests.chromium import PHONE, logged, measured, needs_chromium
from tests.insertion_run import short_run
from tests.needleforce.cli.residual_command_log import refusal

pytestmark = pytest.mark.slow


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
        head, *lines = (re.split(r"  +", x.strip()) for x in printed.out.splitlines())
        rows = [line for line in lines if len(line) == len(head) and line[0].isdigit()]
        layers = [dict(zip(head, row, strict=True)) for row in rows]
        return np.genfromtxt(out, delimiter=",", names=True), layers, printed.err

    return run


def test_layers_are_printed_table_and_figures_written(needle, identify, tmp_path):
    png = tmp_path / "o.png"
    table, (layer,), _ = identify("--png", str(png), "--over", "depth")

    (rupture_m,) = table["depth_in_tissue_m"][table["rupture"] > 0]
    end_mm, end_std_mm = map(float, layer["to mm"].split("±"))

    assert "±" in layer["friction N"]
    assert table["used"].tolist() == [1.0] * len(needle["t_s"])
    assert table["identified_layer"][table["is_final"] == 1].tolist() == [1.0]
    assert np.isnan(table["depth_in_tissue_m"][0])
    assert end_mm == pytest.approx(1e3 * rupture_m, abs=0.5)
    assert 0.0 < end_std_mm < 1.0
    assert float(layer["from mm"]) == pytest.approx(0.0, abs=0.1)
    assert png.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("method", "start_s"),
    [("mixture", 1.7e9), ("published", 100.0), ("published-kv", 0.0)],
)
def test_alarm_is_on_the_logs_clock(needle, identify, method, start_s):
    rows, (layer,), _ = identify("--method", method, t_s=needle["t_s"] + start_s)
    alarm_s = rows["t_s"][rows["rupture"] > 0][0]
    log_s = replay(needle["t_s"], needle["depth_m"], needle["force_N"]).layers[0]

    assert float(layer["alarm s"]) == pytest.approx(alarm_s, abs=0.006)
    if method == "mixture":
        assert float(layer["rupture s"]) == pytest.approx(
            start_s + log_s.rupture.time_s, abs=0.03
        )


@pytest.mark.parametrize(
    ("name", "factor", "word"),
    [
        ("force_N", -1.0, "force is negative"),
        ("depth_m", -1.0, "depth falls"),
        ("speed_m_s", -1.0, "speed has the sign"),
        ("depth_m", 1e3, "millimetres"),
    ],
)
def test_wrong_signs_and_units_are_a_warning(needle, identify, name, factor, word):
    *_, said = identify(**{"speed_m_s": ()} | {name: factor * needle[name]})

    assert word in said


def test_an_offset_of_the_sensor_has_no_sign(needle, identify):
    _, (layer,), said = identify(force_N=needle["force_N"] - 49.0)

    assert "negative" not in said
    assert float(layer["drop N"].split("±")[0]) > 0.0


@pytest.mark.parametrize("speed", ["12mm/s", "0.72 m/min"])
def test_a_constant_speed_stands_for_a_depth(tmp_path, capsys, speed):
    run = insert_needle("gel-50-constant", seed=1, rate_hz=250.0)
    rows = slice(
        *np.searchsorted(run.t_s, (run.tare_end_s, run.truth.rupture_s[0] + 2))
    )
    log = str(tmp_path / "log.csv")
    write_table(log, {"t_s": run.t_s[rows], "force_N": run.force_N[rows]})
    assert main(["identify", log, "--constant-speed", speed]) == 0

    assert "1 rupture detected" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("options", "word"),
    [
        ("--constant-speed 12", "mm/s"),
        ("--constant-speed 0mm/s", "0mm/s"),
        ("--constant-speed 2kg", "2kg"),
        ("--constant-speed 2mm/s --depth depth_m", "--depth"),
        ("--constant-speed 2mm/s", "--depth"),
        ("--constant-speed 2mm/s --depth none", "--speed"),
        ("--between 4", "START:END"),
        ("--between +900:", "+900:"),
    ],
)
def test_a_speed_or_a_time_that_is_none_is_refused(
    needle, tmp_path, capsys, options, word
):
    log = str(tmp_path / "log.csv")
    write_table(log, needle)

    assert word in refusal(["identify", log, *options.split()], capsys)


def test_of_two_insertions_the_second_is_named_and_chosen(needle, identify):
    depth_m = needle["depth_m"]
    back_m = np.linspace(depth_m[-1], depth_m[0], 500)
    twice = {
        "depth_m": np.concatenate([depth_m, back_m, depth_m]),
        "force_N": np.concatenate([needle["force_N"], 0 * back_m, needle["force_N"]]),
        "speed_m_s": (),
    }
    twice["t_s"] = needle["t_s"][0] + 0.004 * np.arange(len(twice["depth_m"]))
    _, (first,), said = identify(**twice)
    start = re.search(r"--between (\S+):", said)[1]
    _, (second,), said = identify("--between", f"{start}:", **twice)

    assert "--between" not in said
    later_s = float(second["rupture s"]) - float(first["rupture s"])
    assert later_s == pytest.approx(0.004 * (len(depth_m) + 500), abs=0.1)


def test_the_unit_of_a_force_is_named_or_refused(needle, tmp_path, capsys):
    log = tmp_path / "log.csv"
    columns = {name: needle[name] for name in ("t_s", "depth_m")}
    write_table(log, {**columns, "force": 1e3 * needle["force_N"]})

    assert "mN" in refusal(["identify", str(log)], capsys)
    assert main(["identify", str(log), "--force", "force:mN"]) == 0
    assert "force    force in mN (mapping)" in capsys.readouterr().out


def test_a_log_of_which_no_row_is_used_is_refused(needle, tmp_path, capsys):
    log = str(tmp_path / "log.csv")
    is_late = np.arange(len(needle["t_s"])) >= len(needle["t_s"]) // 2
    columns = {
        "t_s": needle["t_s"],
        "depth_m": np.where(is_late, needle["depth_m"], np.nan),
        "force_N": np.where(is_late, np.nan, needle["force_N"]),
    }
    write_table(log, columns)
    for argv in (["identify", log], ["report", log, str(tmp_path / "page")]):
        assert "depth_m" in refusal(argv, capsys)
    assert not (tmp_path / "page").exists()


@pytest.mark.parametrize("factor", [1e3, 1e6])
def test_a_time_in_ms_or_us_is_not_taken_for_seconds(needle, tmp_path, capsys, factor):
    log = tmp_path / "log.csv"
    write_table(log, needle | {"t_s": factor * needle["t_s"]})

    assert f"{factor / 250:.4g} s" in refusal(["identify", str(log)], capsys)


def test_an_interrupted_report_leaves_the_page_that_was_there(
    needle, tmp_path, monkeypatch
):
    log = tmp_path / "log.csv"
    write_table(log, needle)
    folder = tmp_path / "page"
    folder.mkdir()
    (folder / "index.html").write_text("of yesterday")

    def stop(*_, **__):
        signal.raise_signal(signal.SIGINT)  # as Ctrl-C, while the page is made

    monkeypatch.setattr(Axes, "plot", stop)

    assert main(["report", str(log), str(folder)]) == 130
    assert {file.name: file.read_text() for file in folder.iterdir()} == {
        "index.html": "of yesterday"
    }


def test_marked_rows_are_counted_and_ignored(needle, identify):
    unusable = (
        SensorWarning.FROZEN,
        SensorWarning.JOINT_LIMIT,
        SensorWarning.NEAR_SINGULAR,
        SensorWarning.MODEL_MISMATCH,
        SensorWarning.TARE_EXPIRED,
        SensorWarning.VELOCITY,
    )
    each = list(SensorWarning)
    status, warnings = np.zeros((2, len(needle["t_s"])))
    status[:4] = [0.0, 1.0, 2.0, 3.0]
    warnings[4 : 4 + len(each)] = each
    rows, _, said = identify(force_status=status, force_warnings=warnings)
    used = rows["used"][: 4 + len(each)]

    assert used[:4].tolist() == [1, 0, 0, 0]
    assert used[4:].tolist() == [warning not in unusable for warning in each]
    assert re.findall(r"were left out: (\d+)", said) == ["3", "6"]


@pytest.mark.parametrize(
    ("options", "column", "code"),
    [
        ([], "status", 1),
        (["--ignore-status"], "force_warnings", 32),
        (["--force", "force_N"], "force_warnings", 32),  # it may be another sensor's
    ],
)
def test_marks_that_do_not_count_hide_no_layer(needle, identify, options, column, code):
    marks = np.full(len(needle["t_s"]), code)

    assert len(identify(*options, **{column: marks})[1]) == 1


@pytest.fixture(scope="module")
def pages(tmp_path_factory):
    """A simulated recording, its forces with a tare, and the layers in them, each
    with a page."""
    folder = tmp_path_factory.mktemp("report")
    run = short_run()
    rows = np.flatnonzero(run.signals.t_s < 34.0)[::2]
    table = {name: values[rows] for name, values in signal_table(run).items()}
    table["tau_Nm"][7500:7525] = np.nan
    table["t_s"] += 1.7e9
    log = str(folder / "<b>log.npz")
    write_table(log, table)
    tare = ["--tare", "+0:+13"]
    forces = str(folder / "forces.csv")
    assert main(["report", log, str(folder / "a" / "log"), *tare]) == 0
    assert main(["force", log, *tare, "-o", forces]) == 0
    assert main(["report", forces, str(folder / "layers")]) == 0
    return folder


def test_a_page_begins_with_what_was_found_and_ends_with_the_settings(pages):
    page, alone = (
        (pages / name / "index.html").read_text(encoding="utf-8")
        for name in ("a/log", "layers")
    )
    lead = page[: page.index("<section")]
    sections = [re.findall('<section id="([^"]+)"', each) for each in (page, alone)]
    layers = [
        re.search(r"Layers traversed.*?</table>", each, re.DOTALL).group()
        for each in (page, alone)
    ]

    # Names from files stay text.
    assert "&lt;b&gt;log.npz" in page
    assert "<b>" not in page
    assert re.search(r"Force along the needle: \S+ to \S+ N", lead)
    assert re.search(r"rupture.* detected, [\d.]+ mm below first contact", lead)
    assert "Warning: rows whose status" in lead
    assert "not a medical device" in lead
    assert sections == [
        ["figures", "summary", "channels", "identification", "sensor"],
        ["figures", "channels", "identification"],
    ]
    assert f"<td>{SENSOR.gain_per_s}</td>" in page
    assert layers[0] == layers[1]


def test_joints_of_two_arms_do_not_matter_for_depth_and_force(tmp_path):
    (tmp_path / "two.csv").write_text(
        "t_s,depth_m,force_N,q1,q2,/b/q1,/b/q2\n0,0,0,1,1,1,1\n0.1,0.001,1,1,1,1,1\n"
    )

    assert main(["report", str(tmp_path / "two.csv"), str(tmp_path / "two")]) == 0


@needs_chromium
def test_pages_open_on_a_phone(pages):
    for page in (pages / name / "index.html" for name in ("a/log", "layers")):
        sizes = measured(page, PHONE)
        figures = page.read_text(encoding="utf-8").count("<figcaption>")
        assert (logged(page), sizes["wide"], len(sizes["images"])) == ([], [], figures)
        assert sizes["content"] <= PHONE[0]
        assert min(sizes["images"]) > 150
