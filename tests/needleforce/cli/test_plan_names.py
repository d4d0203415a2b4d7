"""Which structures a path of `plan` stays clear of, and what must be confirmed."""

import numpy as np
import pytest

from needleforce.anatomy import Labels, Structure
from needleforce.anatomy.volume import Grid
from needleforce.cli.patient.plan_run import PathWish, names_to_avoid
from needleforce.cli.terminal import CommandError


def labels_of(*names):
    volume = np.zeros((len(names) + 1, 1, 1), np.uint8)
    volume[1:, 0, 0] = np.arange(1, len(names) + 1)
    grid = Grid(volume.shape, np.zeros(3), 1e-3 * np.eye(3))
    structures = [Structure.named(name, k) for k, name in enumerate(names, 1)]
    return Labels.of([volume], grid, structures)


def wish(avoid=(), passable=()):
    return PathWish("lesion", tuple(avoid), tuple(passable), 0.8, 5.0, 120.0, 35.0, 1)


NAMES = ("liver", "lesion", "aorta", "colon", "RightRib9")


def test_avoid_adds_to_what_is_avoided_anyway():
    labels = labels_of(*NAMES)

    assert set(names_to_avoid(labels, wish())) == {"aorta", "colon", "RightRib9"}
    assert set(names_to_avoid(labels, wish(avoid=["liver"]))) == {
        "liver",
        "aorta",
        "colon",
        "RightRib9",
    }
    assert set(names_to_avoid(labels, wish(avoid=["aorta"]))) == {
        "aorta",
        "colon",
        "RightRib9",
    }


def test_what_is_passable_is_not_avoided_and_no_bone_is_passable():
    labels = labels_of(*NAMES)

    assert "colon" not in names_to_avoid(labels, wish(passable=["colon"]))
    with pytest.raises(CommandError, match="passes no bone"):
        names_to_avoid(labels, wish(passable=["RightRib9"]))


def test_names_that_say_nothing_are_listed_and_must_be_confirmed():
    labels = labels_of(*NAMES, "Blob", "L5")

    with pytest.raises(CommandError, match=r"what they are: Blob, L5; .*--passable"):
        names_to_avoid(labels, wish())
    with pytest.raises(CommandError, match=r"what they are: L5; "):
        names_to_avoid(labels, wish(passable=["Blob"]))
    avoided = names_to_avoid(labels, wish(avoid=["L5"], passable=["Blob"]))
    assert "L5" in avoided
    assert "Blob" not in avoided
