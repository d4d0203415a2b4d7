"""Column mappings: in code, in TOML, in the short form of options."""

from dataclasses import FrozenInstanceError

import pytest

from needleforce.recordings import (
    CHANNELS,
    ColumnMapping,
    ColumnSpec,
    FileAccessError,
    MappingError,
    load_mapping,
)
from needleforce.recordings.mapping import parse_column_spec


def from_toml(tmp_path, text):
    path = tmp_path / "mapping.toml"
    path.write_text(text, encoding="utf-8")
    return load_mapping(path)


@pytest.mark.parametrize("columns", ["", (), ("q1", "")])
def test_a_specification_names_columns(columns):
    with pytest.raises(MappingError, match="names no column"):
        ColumnSpec(columns=columns)


@pytest.mark.parametrize("scale", [0.0, float("nan"), float("inf"), (1.0, 0.0), (), 10**400])
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
        ({}, 10**400, "positive"),
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
        ("rate_hz = 'fast'", r"Expected `float | null`, got `str` - at `\$.rate_hz`"),
        ("rate_hz = true", "got `bool`"),
        (f"rate_hz = 1{'0' * 400}", "rate_hz"),
        (f"rate_hz = 1{'0' * 5000}", "not valid TOML"),
        (f"[depth]\ncolumns = 'z'\nscale = 1{'0' * 400}", r"\$.depth"),
        (f"a = {'[' * 5000}", "not valid TOML"),
        ("[depth]\ncolumn = 'z'", r"at `\$.depth`; a channel has columns, unit and scale"),
        ("[depth]\n", "missing required field `columns` - at `\\$.depth`"),
        ("[depth]\ncolumns = 'z'\nunits = 'mm'", "unknown field `units` - at `\\$.depth`"),
        ("[depth]\ncolumns = 'z'\nunit = 1", "got `int` - at `\\$.depth.unit`"),
        ("joints = 'a'", "Expected `array`, got `str`"),
        ("joints = ['a', 'a']", "names a joint twice"),
        ("reference_topic = 1", "got `int` - at `\\$.reference_topic`"),
        ("clock = '/joint_states'", "unknown channel 'clock'"),
        ("[depth]\ncolumns = 'z'\nunit = 'N'", "unit 'N' of channel 'depth'"),
        ("[depth]\ncolumns = 3", "got `int` - at `\\$.depth.columns`"),
        ("[depth]\ncolumns = ['z', 3]", "got `int` - at `\\$.depth.columns"),
        ("[depth]\ncolumns = 'z'\nscale = 'x'", "got `str` - at `\\$.depth.scale`"),
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
