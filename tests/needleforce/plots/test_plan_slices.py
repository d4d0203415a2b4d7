"""Slices of a plan name the patient's sides."""

from types import SimpleNamespace

import numpy as np
import pytest
from matplotlib.figure import Figure

from needleforce.anatomy import Grid, Labels, Structure, Volume
from needleforce.plots import draw_along, draw_probe_view


@pytest.fixture
def figures(monkeypatch):
    """The figures that are saved."""
    saved = []
    monkeypatch.setattr(Figure, "savefig", lambda self, *_, **__: saved.append(self))
    return saved


def letters_of(axes):
    """The letters at the edges of a picture, by their place in it."""
    places = {"left": (0.04, 0.5), "right": (0.96, 0.5), "up": (0.5, 0.97)}
    texts = {text.get_position(): text.get_text() for text in axes.texts}
    return {name: texts.get(place) for name, place in places.items()}


def test_slices_along_and_across_a_path_name_left_and_right(figures, tmp_path):
    grid = Grid((40, 40, 40), np.full(3, -0.04), 2e-3 * np.eye(3))
    voxels = np.ones(grid.shape, np.uint8)
    labels = Labels.of([voxels], grid, [Structure.named("liver", 1)])
    scan = Volume(np.zeros(grid.shape, np.int16), grid)
    path = SimpleNamespace(
        entry_m=np.array([0.0, -0.03, 0.0]),
        target_m=np.array([0.0, 0.03, 0.0]),
        length_m=0.06,
        layers=(),
    )
    draw_along(scan, labels, path, tmp_path / "along.png")
    draw_probe_view(scan, labels, path, 0.005, tmp_path / "across.png")
    along, across = figures

    side, head = (letters_of(axes) for axes in along.axes)
    assert side == {"left": "R", "right": "L", "up": None}
    assert head == {"left": "F", "right": "H", "up": None}
    for axes in across.axes:
        assert letters_of(axes) == {"left": "R", "right": "L", "up": "H"}
