"""The picture of `python -m residual`: it is written, and shows what the table holds."""

import numpy as np
import pytest
from residual_command_log import insertion

from needleforce.cli.force import main
from needleforce.cli.force_replay import ForceRows
from needleforce.cli.force_report import (
    Component,
    _panel,
    broken_at_gaps,
    component_curves,
    limits,
    runs,
)
from needleforce.plots import palette
from recordings import write_table

pytest.importorskip("matplotlib")


def rows_of(status, after_gap=()):
    rows = len(status)
    return ForceRows(
        t_s=np.arange(rows) * 0.01,
        travel_m=np.zeros(rows),
        axial_N=np.arange(rows, dtype=float),
        axial_std_N=np.full(rows, 0.5),
        force_N=np.zeros((rows, 3)),
        torque_Nm=np.zeros((rows, 3)),
        std=np.full((rows, 1), 0.5),
        model_mismatch=np.ones(rows),
        warnings=np.zeros(rows, dtype=int),
        status=np.array(status),
        after_gap=np.isin(np.arange(rows), after_gap),
    )


def curve_of(rows):
    return Component("axial force", palette.OURS, rows.axial_N, rows.axial_std_N)


@pytest.mark.parametrize(
    "options",
    [
        ["--tare", "+0:+2.5"],
        ["--tare", "+0:+2.5", "--mode", "point"],
        ["--tare", "+0:+2.5", "--mode", "full"],
        ["--no-tare"],
    ],
    ids=" ".join,
)
@pytest.mark.parametrize("start_s", [0.0, 1.7e9])
def test_a_png_is_written_for_every_mode(lwr, tmp_path, options, start_s):
    columns = insertion(lwr, seconds=3.0, start_s=start_s)
    columns["tau_Nm"][2600:2650] = np.nan
    keep = np.r_[0:1500, 1700:3000]
    write_table(tmp_path / "log.npz", {name: values[keep] for name, values in columns.items()})
    path = tmp_path / "forces.png"
    assert main([str(tmp_path / "log.npz"), *options, "--png", str(path)]) == 0
    content = path.read_bytes()
    assert content.startswith(b"\x89PNG")
    assert len(content) > 10_000


def test_a_log_without_a_sound_row_still_has_a_picture(lwr, tmp_path, capsys):
    columns = insertion(lwr, seconds=0.1)
    columns["q_rad"][:, 0] = np.nan
    write_table(tmp_path / "log.npz", columns)
    path = tmp_path / "forces.png"
    argv = [str(tmp_path / "log.npz"), "--no-tare", "--png", str(path)]
    assert main([*argv, "-o", str(tmp_path / "forces.csv")]) == 0
    assert path.is_file()
    assert "no sample was sound" in capsys.readouterr().out


def test_a_skipped_row_leaves_no_hole_and_a_gap_does():
    rows = rows_of([0, 0, 3, 0, 0], after_gap=[4])
    drawn = broken_at_gaps(curve_of(rows), rows)
    np.testing.assert_array_equal(drawn.value, [0.0, 1.0, 3.0, np.nan, 4.0])
    np.testing.assert_array_equal(drawn.is_tared, [True, True, True, False, True])


def test_room_is_made_for_the_band_of_tared_rows_and_zero():
    tared = rows_of([1, 1, 0, 0])
    low, high = limits([curve_of(tared)], tared)
    assert low < 0.0
    assert 3.0 + 2 * 0.5 < high < 5.0
    untared = rows_of([1, 1, 1, 2])
    low, high = limits([curve_of(untared)], untared)
    assert 2.0 < high < 3.0


@pytest.mark.parametrize("offset_N", [0.0, 50.0])
def test_what_lies_outside_the_panel_has_no_place_in_the_legend(offset_N):
    rows = rows_of([1, 1, 0, 0])
    rows.axial_N[:2] += offset_N
    labels = [curve.label for curve in _panel("force", [curve_of(rows)], rows, 0.0).curves]
    assert labels == (["axial force"] if offset_N else ["not tared", "axial force"])
    lost = rows_of([3, 3])
    assert len(_panel("force", [curve_of(lost)], lost, 0.0).curves) == 1


def test_runs_are_the_unbroken_stretches():
    assert runs(np.array([True, True, False, True])) == [(0, 1), (3, 3)]
    assert runs(np.zeros(3, dtype=bool)) == []


def test_what_is_not_tared_is_grey_and_without_a_band():
    rows = rows_of([1, 1, 0, 0])
    untared, tared = component_curves(curve_of(rows), rows, start_s=0.0)
    assert untared.label == "not tared"
    assert untared.std is None
    np.testing.assert_array_equal(np.isfinite(untared.y), [True, True, False, False])
    assert tared.style is palette.OURS
    assert tared.label == "axial force"
    np.testing.assert_array_equal(np.isfinite(tared.y), [False, False, True, True])
    never = rows_of([1, 1])
    (only,) = component_curves(curve_of(never), never, start_s=0.0)
    assert only.label == "axial force, not tared"
    assert only.style.color == palette.OURS.color
