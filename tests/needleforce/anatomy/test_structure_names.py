"""What names imply, and what is dense in the CT without a name."""

import numpy as np
import pytest

from needleforce.anatomy import Labels, Structure
from needleforce.anatomy.structures import is_known, words_of
from needleforce.anatomy.volume import Grid, Volume


@pytest.mark.parametrize(
    "name",
    [
        "RightRib9",
        "Rib7R",
        "CostalCartilage",
        "rib_left_7",
        "RIB",
        "CTRib",
        "L3Vertebra",
    ],
)
def test_names_of_bone_are_obstacles_however_they_are_written(name):
    assert Structure.named(name, 1).is_obstacle
    assert is_known(name)


def test_words_are_divided_at_capitals_and_digits():
    assert words_of("RightRib9") == {"right", "rib", "9"}
    assert words_of("Rib7R") == {"rib", "7", "r"}
    assert words_of("portal_vein") == {"portal", "vein"}


@pytest.mark.parametrize(("name", "known"), [("L5", False), ("Blob", False)])
def test_names_that_say_nothing_are_not_known(name, known):
    assert is_known(name) is known


def test_a_renal_pelvis_is_no_bone_and_a_pelvis_is():
    assert not Structure.named("RenalPelvis", 1).is_obstacle
    assert Structure.named("pelvis", 1).is_obstacle


def test_what_is_dense_as_bone_and_not_labelled_is_an_obstacle():
    values = np.zeros((40, 40, 40))
    values[10:14, 10:14, :] = 400.0  # labelled as a rib
    values[20:24, 20:24, :] = 300.0  # nobody labelled it
    values[30, 30, 30] = 900.0  # 1 mm³: a calcification
    grid = Grid(values.shape, np.zeros(3), 1e-3 * np.eye(3))
    volume = np.zeros(values.shape, np.uint8)
    volume[10:14, 10:14, :] = 1
    labels = Labels.of([volume], grid, [Structure.named("rib_left_7", 1)])
    found = labels.with_dense(Volume(values, grid))
    dense = found["dense_as_bone"]

    assert dense.is_obstacle
    assert dense.voxels == 4 * 4 * 40
    clearances = found.clearances([0.0, 0.0215, 0.02], [0.039, 0.0215, 0.02])
    assert [one.name for one in clearances if one.distance_m == 0.0] == [
        "dense_as_bone"
    ]
