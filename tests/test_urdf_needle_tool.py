"""NeedleTool: the paper's masses and lengths, and inertias of the right size."""

from dataclasses import FrozenInstanceError

import numpy as np
import pytest

from urdf import InputError, NeedleTool


def test_defaults_are_the_paper_s_tool():
    tool = NeedleTool()
    assert tool.sensor.mass_kg == 0.236
    assert tool.beyond_sensor.mass_kg == pytest.approx(0.068)
    assert tool.payload.mass_kg == pytest.approx(0.304)
    assert tool.tip_in_flange_m == pytest.approx([0, 0, 0.040 + 0.153])


def test_whole_tool_is_sensor_plus_needle_moved_to_the_flange():
    tool = NeedleTool()
    first_moment = tool.payload.parameters[3]
    beyond = tool.beyond_sensor
    by_hand = 0.236 * 0.020 + 0.068 * (0.040 + beyond.com_m[2])
    assert first_moment == pytest.approx(by_hand)
    assert tool.payload.com_m[:2] == pytest.approx([0, 0])


def test_shaft_is_a_small_part_of_the_needle_mass():
    """A solid 18-gauge steel shaft of 118 mm weighs 7850 pi/4 d^2 L."""
    assert NeedleTool().shaft_mass_kg == pytest.approx(
        7850 * np.pi / 4 * 0.00127**2 * 0.118, rel=1e-12
    )


def test_inertia_of_a_bare_rod_is_the_textbook_s():
    rod = NeedleTool(
        needle_mass_kg=0.1,
        needle_length_m=0.2 + 1e-9,
        hub_length_m=1e-9,
        needle_diameter_m=0.002,
        shaft_density_kg_m3=0.1 / (np.pi / 4 * 0.002**2 * 0.2),
    ).beyond_sensor
    transverse = 0.1 * (3 * 0.001**2 + 0.2**2) / 12
    assert np.diag(rod.inertia_kg_m2) == pytest.approx(
        [transverse, transverse, 0.5 * 0.1 * 0.001**2], rel=1e-6
    )
    assert rod.com_m[2] == pytest.approx(0.1)


def test_no_sensor_mass_leaves_the_needle():
    tool = NeedleTool(sensor_mass_kg=0.0)
    assert tool.payload.mass_kg == pytest.approx(0.068)


def test_tool_is_frozen_and_its_arrays_read_only():
    tool = NeedleTool()
    with pytest.raises(FrozenInstanceError):
        tool.needle_length_m = 0.2
    with pytest.raises(ValueError, match="read-only"):
        tool.tip_in_flange_m[2] = 0.0


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"needle_length_m": 0.0}, "needle_length_m is 0, expected a positive"),
        ({"sensor_mass_kg": -0.1}, "sensor_mass_kg is -0.1"),
        ({"hub_diameter_m": np.nan}, "hub_diameter_m has NaN"),
        ({"sensor_height_m": "tall"}, "sensor_height_m is not an array of numbers"),
        ({"needle_length_m": 0.03}, "hub_length_m 0.035 must be shorter"),
        ({"needle_diameter_m": 0.02}, "more than needle_mass_kg 0.068; give a thinner shaft"),
    ],
)
def test_tools_that_cannot_be_built(change, message):
    with pytest.raises(InputError, match=message):
        NeedleTool(**change)
