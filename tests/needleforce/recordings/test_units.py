"""In which unit a channel is read, whence that is known, and what contradicts it."""

import numpy as np
import pytest

from needleforce.recordings import (
    CHANNELS,
    ColumnMapping,
    ColumnSpec,
    Table,
    UnitError,
    read_log,
    write_table,
)
from needleforce.recordings.channel_request import ChannelRequest
from needleforce.recordings.channels import KNOWLEDGE
from needleforce.recordings.log import log_of_table
from needleforce.recordings.table import StatedUnit

T_S = np.arange(3.0) / 100.0
ONES = np.ones(3)


@pytest.mark.parametrize(
    ("text", "channel", "unit", "factor"),
    [
        ("kN", "force", "kN", 1e3),
        ("KN", "force", "kN", 1e3),
        ("cN", "force", "cN", 1e-2),
        ("g", "force", "gf", 9.80665e-3),
        ("kgF", "force", "kgf", 9.80665),
        ("lbs", "force", "lbf", 4.4482216152605),
        ("ozF", "force", "ozf", 0.27801385095),
        ("Newton", "force", "N", 1.0),
        ("in", "depth", "inch", 0.0254),
        ('"', "depth", "inch", 0.0254),
        ("μm", "depth", "um", 1e-6),
        ("degrees", "q", "deg", np.pi / 180),
        ("rev/min", "dq", "rpm", 2 * np.pi / 60),
        ("1/min", "dq", "rpm", 2 * np.pi / 60),
        ("deg/sec", "dq", "deg/s", np.pi / 180),
        ("N*m", "tau", "Nm", 1.0),
        ("N-mm", "tau", "Nmm", 1e-3),
        ("in-lbf", "tau", "in-lbf", 0.1129848290),
        ("lbf·in", "tau", "in-lbf", 0.1129848290),
        ("sec", "time", "s", 1.0),
        ("min", "time", "min", 60.0),
        ("mm/min", "speed", "mm/min", 1e-3 / 60),
        ("m/min", "speed", "m/min", 1.0 / 60),
        ("inch/s", "speed", "inch/s", 0.0254),
        ("inch/min", "speed", "inch/min", 0.0254 / 60),
    ],
)
def test_units_of_laboratories_are_known(text, channel, unit, factor):
    assert CHANNELS[channel].units.find(text) == unit
    assert CHANNELS[channel].units[unit] == pytest.approx(factor)


@pytest.mark.parametrize(
    ("text", "channel"),
    [("%", "force"), ("MN", "force"), ("M", "depth"), ("n", "force")],
)
def test_what_is_no_unit_of_a_channel_is_not_guessed(text, channel):
    assert CHANNELS[channel].units.find(text) is None


@pytest.mark.parametrize(
    ("cells", "expected"),
    [
        (["(s)", "(mm)", "(kN)"], True),
        (["s", "N", "mm", "%", ""], True),
        (["[s]", "[Load cell]"], True),
        (["t", "f"], False),
        (["elapsed", "N"], False),
        (["", ""], False),
    ],
)
def test_a_row_of_units_is_recognised(cells, expected):
    assert KNOWLEDGE.is_row_of_units(cells) is expected


def log_of(mapping=None, units=None, required=(), **columns):
    stated = {name: StatedUnit(text, 2) for name, text in (units or {}).items()}
    table = Table(columns={"t_s": T_S, **columns}, units=stated)
    request = ChannelRequest(ColumnMapping(channels=mapping or {}), required)
    return log_of_table(table, request)


@pytest.mark.parametrize(
    "name",
    ["Force (kN)", "Force [kN]", "Load_kN", "Load kN", "Force/kN", "Kraft in kN"],
)
def test_a_unit_in_a_name_is_read(name):
    log = log_of(**{name: ONES})

    assert log["force_N"].tolist() == [1000.0] * 3
    assert [str(unit) for unit in log.units] == [
        "t_s in s (header)",
        f"{name} in kN (header)",
    ]


def test_the_origin_of_every_unit_is_said():
    log = log_of(
        {"force": ColumnSpec(columns="x", unit="mN")},
        units={"Weg": "mm"},
        x=ONES,
        Weg=ONES,
        q=np.ones((3, 2)),
    )
    origins = {unit.channel: str(unit) for unit in log.units}

    assert origins == {
        "time": "t_s in s (header)",
        "q": "q in rad (assumed)",
        "depth": "Weg in mm (row of units, line 2)",
        "force": "x in mN (mapping)",
    }
    assert log.units[2].record() == {
        "channel": "depth",
        "columns": ["Weg"],
        "units": ["mm"],
        "origins": ["row of units"],
        "lines": [2],
        "scale": 1.0,
    }


@pytest.mark.parametrize(
    ("mapping", "units", "column", "message"),
    [
        ("m", "mm", "z", "mapping says m .* row of units .line 2. says mm; if the"),
        ("N", None, "Force (kN)", "mapping says N .* and its name says kN"),
        (None, "N", "Force (kN)", "its name says kN and the row of units .* says N"),
        (None, "%", "Load", "'Load' is in '%', which is no known unit of force; exp"),
        (None, None, "Load (%)", "'Load .%.' is in '%', which is no known unit"),
        (None, "daN", "Load", "'daN', which is no known unit of force"),
        (
            "N",
            "%",
            "Load",
            "the row of units .line 2. says that column 'Load' is in '%'",
        ),
    ],
)
def test_what_a_file_says_otherwise_is_refused(mapping, units, column, message):
    channel = "depth" if column == "z" else "force"
    spec = ColumnSpec(columns=column, unit=mapping)
    with pytest.raises(UnitError, match=message):
        log_of(
            {channel: spec} if mapping else None,
            units={column: units} if units else None,
            required=(channel,),
            **{column: ONES},
        )


def test_the_advice_on_a_contradiction_gives_what_was_asked_for():
    with pytest.raises(UnitError, match="give its unit and the factor 1000") as caught:
        log_of({"depth": ColumnSpec(columns="z", unit="m")}, units={"z": "mm"}, z=ONES)

    assert "as z:mm does" in caught.value.advice

    log = log_of(
        {"depth": ColumnSpec(columns="z", unit="mm", scale=1000.0)},
        units={"z": "mm"},
        z=ONES,
    )

    assert log["depth_m"].tolist() == [1.0] * 3


def test_the_mapping_decides_between_two_units_of_the_file():
    spec = ColumnSpec(columns="Force (kN)", unit="N")
    log = log_of({"force": spec}, units={"Force (kN)": "N"}, **{"Force (kN)": ONES})

    assert log["force_N"].tolist() == [1.0] * 3


def test_a_factor_may_stand_for_a_unit_that_is_not_known():
    spec = ColumnSpec(columns="Load (%)", scale=2.0)

    assert (
        log_of({"force": spec}, **{"Load (%)": ONES})["force_N"].tolist() == [2.0] * 3
    )


def test_a_column_in_a_unit_of_the_channel_comes_before_others():
    log = log_of(**{"Load (%)": ONES, "Load (N)": 2.0 * ONES})

    assert log["force_N"].tolist() == [2.0] * 3


@pytest.mark.parametrize(
    ("names", "channel"),
    [
        (("Displacement (mm)", "Extension", "Crosshead [mm]", "Standardweg"), "depth"),
        (
            ("Weg mm", "Stroke/mm", "Compressive extension", "Axial Displacement"),
            "depth",
        ),
        (
            ("Traversenweg", "Déplacement", "Corsa", "ストローク", "Position (mm)"),
            "depth",
        ),
        (("Load", "Axial Force", "Standardkraft", "Prüfkraft", "PRUEFKRAFT"), "force"),
        (("Test Force", "Forza", "Charge", "試験力", "Reading [lbF]"), "force"),
    ],
)
def test_the_words_of_testing_machines_are_known(names, channel):
    for name in names:
        log = log_of(required=(channel,), **{name: ONES})

        assert log.units[-1].columns == (name,)


def test_a_usual_name_comes_before_the_words_of_machines():
    log = log_of(force=ONES, Load=2.0 * ONES)

    assert log["force_N"].tolist() == [1.0] * 3


def test_a_position_without_a_unit_of_length_is_no_depth():
    log = log_of(position=ONES)

    assert list(log.channels) == ["q_rad"]


@pytest.mark.parametrize("suffix", ["csv", "npz", "parquet"])
def test_every_format_reads_units_in_names_alike(tmp_path, suffix):
    path = tmp_path / f"log.{suffix}"
    columns = {"Time (ms)": 1e3 * T_S, "Extension/mm": ONES, "Load kN": ONES}
    write_table(path, columns)
    log = read_log(path, required=("depth", "force"))

    assert log.t_s.tolist() == pytest.approx([0.0, 0.01, 0.02])
    assert log["depth_m"].tolist() == [0.001] * 3
    assert log["force_N"].tolist() == [1000.0] * 3
