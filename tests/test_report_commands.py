"""`--report` of the two commands for recordings: one page with chart, table, warnings, settings."""

import numpy as np
import pytest
from chromium import PHONE, logged, measured, needs_chromium
from residual_command_log import insertion

import needleforce.cli.force as residual_command
import needleforce.cli.identify as identification_command
from groundtruth import insert_needle
from needleforce.cli.identify_report import IdentificationResult, LogClock, identification_chart
from recordings import write_table
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
    assert residual_command.main([str(folder / "log.npz"), *options]) == 0
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
        assert identification_command.main([str(folder / f"{name}.csv"), *options]) == 0
    return folder


def test_forces_have_a_page_with_all_that_was_asked_for(forces):
    page = (forces / "index.html").read_text(encoding="utf-8")
    assert "Forces from log.npz" in page
    for label in ("robot", "samples", "skipped", "gaps", "tare", "lag"):
        assert f"<td>{label}</td>" in page
    assert f"<td>{SENSOR.gain_per_s:g}</td>" in page
    assert "<code>prior.gear_ratio</code>" in page
    drawn = (forces / "forces.svg").read_text(encoding="utf-8")
    for text in ("time since the first sample [s]", "axial force [N]", "tare", "skipped"):
        assert f"<!-- {text} -->" in drawn
    assert "torque" in drawn


def test_layers_have_a_page_with_all_that_was_asked_for(layers):
    page = (layers / "log" / "index.html").read_text(encoding="utf-8")
    assert "Layers in log.csv" in page
    assert "friction N" in page
    assert "<code>false_alarm_interval_s</code>" in page
    drawn = (layers / "log" / "layers.svg").read_text(encoding="utf-8")
    for text in ("rupture, as dated", "friction compensated", "enhanced force", "time [s]"):
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


def result(**changes):
    t_s = np.linspace(0.0, 1.0, 50)
    names = ("force_N", "predicted_force_N", "enhanced_force_N", "tip_force_N")
    names += ("stiffness_N_per_m", "friction_Ns_per_m2", "cumulative_friction_Ns_per_m")
    columns = {name: np.ones(50) for name in names}
    columns |= {name.replace("_N", "_std_N", 1): np.full(50, np.nan) for name in names[4:]}
    columns["absorbed"] = np.ones(50)
    values = {
        "log": "log",
        "method": "published-kv",
        "layers": (),
        "clock": LogClock(),
        "ruptures_s": (0.4,),
        "compensations_s": (),
        "warnings": (),
        "overview": {"t_s": t_s} | columns,
    }
    return IdentificationResult(**(values | changes))


def test_the_kelvin_voigt_friction_has_its_own_unit_and_no_band_is_invented():
    kv, ml = (identification_chart(result(method=name)) for name in ("published-kv", "published"))
    assert kv.panels[2].y_label == "friction B\n[Ns/m]"
    assert ml.panels[2].y_label == "friction B\n[Ns/m²]"
    assert all(curve.std is None for panel in kv.panels for curve in panel.curves)
    assert kv.instants[0].places == (0.4,)


def test_nothing_is_drawn_before_the_first_row_that_was_absorbed():
    rows = dict(result().overview) | {"absorbed": np.repeat([0.0, 1.0, 0.0], [10, 30, 10])}
    forces, *parameters = identification_chart(result(overview=rows)).panels
    for curve in (*forces.curves[1:], *(panel.curves[0] for panel in parameters)):
        assert np.isnan(curve.y[:10]).all()
        assert np.isfinite(curve.y[10:]).all()
    assert np.isfinite(forces.curves[0].y).all()


def test_seconds_since_1970_are_counted_from_the_first_sample():
    rows = dict(result().overview)
    late = identification_chart(
        result(overview=rows | {"t_s": rows["t_s"] + 1.7e9}, ruptures_s=(1.7e9 + 0.4,))
    )
    assert late.x_limits == (0.0, 1.0)
    assert late.x_label == "time since the first sample [s]"
    assert late.instants[0].places == pytest.approx((0.4,))
    assert late.panels[2].curves[0].x[-1] == 1.0
    assert identification_chart(result()).x_label == "time [s]"


def test_transients_do_not_set_the_scale_and_nothing_needs_no_room():
    rows = result().overview
    wild = np.full(50, 100.0)
    wild[0] = 1e9
    chart = identification_chart(result(overview=dict(rows) | {"stiffness_N_per_m": wild}))
    low, high = chart.panels[1].limits
    assert -50.0 < low < 0.0
    assert 100.0 < high < 1000.0
    nothing = dict(rows) | {"stiffness_N_per_m": np.zeros(50)}
    assert identification_chart(result(overview=nothing)).panels[1].limits == (-0.1, 1.0)
