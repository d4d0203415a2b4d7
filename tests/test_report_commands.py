"""`--report` of the two commands for recordings: one page with chart, table, warnings, settings."""

import numpy as np
import pytest
from chromium import PHONE, logged, measured, needs_chromium
from residual_command_log import insertion

from groundtruth import insert_needle
from needleforce.cli import main
from needleforce.recordings import write_table
from residual import DEFAULT as SENSOR

pytest.importorskip("matplotlib")


@pytest.fixture(scope="module")
def forces(lwr, tmp_path_factory):
    """The report of a log with a gap, a skipped stretch and a tare."""
    folder = tmp_path_factory.mktemp("forces")
    columns = insertion(lwr, seconds=3.0, start_s=1.7e9)
    columns["tau_Nm"][2600:2650] = np.nan
    keep = np.r_[0:1500, 1700:3000]
    write_table(folder / "log.npz", {name: values[keep] for name, values in columns.items()})
    options = ["--tare", "+0:+2.5", "--mode", "full", "--report", str(folder / "a" / "report")]
    assert main(["force", str(folder / "log.npz"), *options]) == 0
    return folder / "a" / "report"


@pytest.fixture(scope="module")
def layers(tmp_path_factory):
    """The report of an insertion whose force has the wrong sign to begin with."""
    folder = tmp_path_factory.mktemp("layers")
    run = insert_needle("gel-50-constant", seed=1, rate_hz=250.0)
    part = slice(int(np.searchsorted(run.t_s, run.tare_end_s)), None)
    names = {"t_s": run.t_s, "depth_m": run.depth_m, "force_N": run.force_N}
    write_table(folder / "log.csv", {name: values[part] for name, values in names.items()})
    write_table(
        folder / "wrong.csv", {"t_s": run.t_s, "depth_m": run.depth_m, "force_N": -run.force_N}
    )
    for name in ("log", "wrong"):
        options = ["--report", str(folder / name)]
        assert main(["identify", str(folder / f"{name}.csv"), *options]) == 0
    return folder


def test_forces_have_a_page_with_all_that_was_asked_for(forces):
    page = (forces / "index.html").read_text(encoding="utf-8")
    assert "Forces from log.npz" in page
    for label in ("robot", "samples", "rejected", "gaps", "tare", "lag"):
        assert f"<td>{label}</td>" in page
    assert f"<td>{SENSOR.gain_per_s:g}</td>" in page
    assert "<code>prior.gear_ratio</code>" in page
    drawn = (forces / "forces.svg").read_text(encoding="utf-8")
    for text in ("time since the first sample [s]", "axial force [N]", "tare", "rejected"):
        assert f"<!-- {text} -->" in drawn
    assert "torque" in drawn


def test_layers_have_a_page_with_all_that_was_asked_for(layers):
    page = (layers / "log" / "index.html").read_text(encoding="utf-8")
    assert "Layers in log.csv" in page
    assert "friction N" in page
    assert "<code>false_alarm_interval_s</code>" in page
    drawn = (layers / "log" / "layers.svg").read_text(encoding="utf-8")
    for text in (
        "estimated rupture time",
        "friction identified",
        "enhanced force",
        "time of the log [s]",
    ):
        assert f"<!-- {text} -->" in drawn


def test_warnings_stand_in_the_page(layers):
    page = (layers / "wrong" / "index.html").read_text(encoding="utf-8")
    assert "<p class=notice>Warning: " in page
    assert "sign" in page


@needs_chromium
def test_both_open_on_a_phone(forces, layers):
    for folder in (forces, layers / "log", layers / "wrong"):
        page = folder / "index.html"
        assert logged(page) == []
        found = measured(page, PHONE)
        assert found["content"] <= PHONE[0]
        assert found["wide"] == []
        assert len(found["images"]) == page.read_text(encoding="utf-8").count("<figcaption>")
        assert all(image["height"] > 150 for image in found["images"])
