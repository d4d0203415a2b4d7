"""Column mappings: in code, in TOML, on the command line."""

from argparse import ArgumentParser
from dataclasses import FrozenInstanceError

import pytest

from recordings import (
    CHANNELS,
    ColumnMapping,
    ColumnSpec,
    FileAccessError,
    MappingError,
    load_mapping,
    mapping_arguments,
    mapping_from_arguments,
)
from recordings.columns.spec import parse_column_spec


def from_toml(tmp_path, text):
    path = tmp_path / "mapping.toml"
    path.write_text(text, encoding="utf-8")
    return load_mapping(path)


def from_options(*options, channels=("depth", "force", "q")):
    parser = ArgumentParser()
    parser.add_argument("log")
    mapping_arguments(parser, channels)
    return mapping_from_arguments(parser.parse_args(["x.csv", *options]))


@pytest.mark.parametrize("columns", ["", (), ("q1", "")])
def test_a_specification_names_columns(columns):
    with pytest.raises(MappingError, match="names no column"):
        ColumnSpec(columns=columns)


@pytest.mark.parametrize("scale", [0.0, float("nan"), float("inf"), (1.0, 0.0), ()])
def test_a_scale_is_finite_and_not_zero(scale):
    with pytest.raises(MappingError, match="finite and not zero"):
        ColumnSpec(columns="z", scale=scale)


def test_a_mapping_is_frozen_and_spells_units_one_way():
    source = {"speed": ColumnSpec(columns="v", unit="mm_s")}
    mapping = ColumnMapping(channels=source)
    source.clear()
    assert mapping.channels["speed"].unit == "mm/s"
    with pytest.raises(FrozenInstanceError):
        mapping.rate_hz = 1.0  # pyright: ignore
    with pytest.raises(TypeError):
        mapping.channels["speed"] = ColumnSpec(columns="v")  # pyright: ignore


@pytest.mark.parametrize(
    ("channels", "rate_hz", "message"),
    [
        ({"torque": "tau"}, None, "unknown channel 'torque'; channels are: time, q, dq, tau"),
        ({}, 0.0, "positive"),
        ({}, float("nan"), "positive"),
        ({}, float("inf"), "positive"),
        ({"time": "t"}, 100.0, "keep one"),
    ],
)
def test_a_mapping_that_contradicts_itself_is_refused(channels, rate_hz, message):
    channels = {name: ColumnSpec(columns=columns) for name, columns in channels.items()}
    with pytest.raises(MappingError, match=message):
        ColumnMapping(channels=channels, rate_hz=rate_hz)


def test_a_mapping_refuses_a_unit_of_another_quantity():
    with pytest.raises(MappingError, match="unit 'deg' of channel 'depth' is not known"):
        ColumnMapping(channels={"depth": ColumnSpec(columns="z", unit="deg")})


def test_toml_gives_columns_units_scales_and_rate(tmp_path):
    mapping = from_toml(
        tmp_path,
        """
        rate_hz = 500
        depth = "z"
        [q]
        columns = "q{1..7}"
        unit = "deg"
        [tau]
        columns = ["i1", "i2"]
        scale = [10.5, -9]
        [force]
        columns = "fz"
        scale = -1
        """,
    )
    assert mapping.rate_hz == 500
    assert mapping.channels["depth"] == ColumnSpec(columns="z")
    assert mapping.channels["q"] == ColumnSpec(columns="q{1..7}", unit="deg")
    assert mapping.channels["tau"] == ColumnSpec(columns=("i1", "i2"), scale=(10.5, -9.0))
    assert mapping.channels["force"] == ColumnSpec(columns="fz", scale=-1.0)


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("depth = ", "not valid TOML"),
        ("depht = 'z'", "unknown channel 'depht'"),
        ("rate_hz = 'fast'", "must be a number"),
        ("rate_hz = true", "must be a number"),
        ("[depth]\ncolumn = 'z'", r"\[depth\] has the keys column; it needs columns"),
        ("[depth]\n", "has the keys none"),
        ("[depth]\ncolumns = 'z'\nunits = 'mm'", "it needs columns, and may have unit"),
        ("[depth]\ncolumns = 'z'\nunit = 1", "must be text"),
        ("[depth]\ncolumns = 'z'\nunit = 'N'", "unit 'N' of channel 'depth'"),
        ("[depth]\ncolumns = 3", "must be a name or a list of names"),
        ("[depth]\ncolumns = ['z', 3]", "must be a name or a list of names"),
        ("[depth]\ncolumns = 'z'\nscale = 'x'", "must be a number or a list of numbers"),
        ("[depth]\ncolumns = 'z'\nscale = 0", "not zero"),
    ],
)
def test_a_wrong_toml_is_refused_with_the_file_named(tmp_path, text, message):
    with pytest.raises(MappingError, match=message) as caught:
        from_toml(tmp_path, text)
    assert "mapping.toml" in str(caught.value)


def test_a_toml_in_another_encoding_is_refused(tmp_path):
    (tmp_path / "mapping.toml").write_bytes(b"depth = 'z\xb5'")
    with pytest.raises(MappingError, match="not valid TOML"):
        load_mapping(tmp_path / "mapping.toml")


def test_a_mapping_that_is_not_there_is_told(tmp_path):
    with pytest.raises(FileAccessError, match="cannot read the mapping"):
        load_mapping(tmp_path / "none.toml")


@pytest.mark.parametrize(
    ("text", "spec"),
    [
        ("z", ColumnSpec(columns="z")),
        ("z:mm", ColumnSpec(columns="z", unit="mm")),
        ("z:mm:-1", ColumnSpec(columns="z", unit="mm", scale=-1.0)),
        ("z:2.5", ColumnSpec(columns="z", scale=2.5)),
        ("a, b", ColumnSpec(columns=("a", "b"))),
        ("ns::z:um", ColumnSpec(columns="ns::z", unit="um")),
        ("z:inch", ColumnSpec(columns="z:inch")),
    ],
)
def test_the_short_form_means_the_same_specification(text, spec):
    assert parse_column_spec(text, CHANNELS["depth"]) == spec


def test_a_short_form_without_a_name_is_refused():
    with pytest.raises(MappingError, match="names no column"):
        parse_column_spec(":mm", CHANNELS["depth"])


def test_options_give_a_mapping():
    mapping = from_options("--depth", "z:mm", "--q", "q{1..7}:deg", "--time", "stamp:ns")
    assert dict(mapping.channels) == {
        "time": ColumnSpec(columns="stamp", unit="ns"),
        "q": ColumnSpec(columns="q{1..7}", unit="deg"),
        "depth": ColumnSpec(columns="z", unit="mm"),
    }
    assert from_options().channels == {}


def test_a_command_only_offers_the_channels_it_reads(capsys):
    with pytest.raises(SystemExit):
        from_options("--tau", "tau")
    with pytest.raises(SystemExit):
        from_options("--help")
    assert "--force COLUMNS" in capsys.readouterr().out


def test_options_win_over_the_file(tmp_path):
    path = tmp_path / "mapping.toml"
    path.write_text("time = 't'\n[depth]\ncolumns = 'z'\nunit = 'mm'\n[force]\ncolumns = 'f'\n")
    mapping = from_options("--mapping", str(path), "--depth", "d", "--rate", "100")
    assert mapping.rate_hz == 100.0
    assert dict(mapping.channels) == {
        "depth": ColumnSpec(columns="d"),
        "force": ColumnSpec(columns="f"),
    }
    path.write_text("rate_hz = 50")
    assert from_options("--mapping", str(path)).rate_hz == 50
    assert from_options("--mapping", str(path), "--time", "t").rate_hz is None


def test_a_rate_beside_a_time_column_is_refused():
    with pytest.raises(MappingError, match="keep one"):
        from_options("--time", "t", "--rate", "100")
