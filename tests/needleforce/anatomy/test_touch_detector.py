"""When a tip that rests against something is a touch."""

import numpy as np
import pytest

from needleforce.anatomy import TouchDetector

DT_s = 5e-3
ZERO_N = np.zeros(3)


def touches(*stays, contact_N=0.5):
    """Touches of a tip that moves in air and stays at places for two seconds each.

    Each stay is a place along x, the force felt there, and by how far the tip trembles.
    """
    detector = TouchDetector(contact_N)
    found = []
    for place_m, force_N, tremble_m in stays:
        for k in range(200):  # free, 20 mm above
            detector.update(DT_s, np.array([place_m, 0.0, 20e-3 + 1e-4 * k]), ZERO_N)
        for k in range(400):
            aside_m = tremble_m * np.sin(2.0 * np.pi * 2.0 * k * DT_s)
            tip_m = np.array([place_m, aside_m, 0.0])
            found.append(detector.update(DT_s, tip_m, np.array([0.0, 0.0, force_N])))
    return [touch for touch in found if touch is not None]


def test_a_place_is_touched_once_while_the_tip_rests_there():
    [touch] = touches((0.1, 1.0, 0.0))

    assert touch.place_m == pytest.approx([0.1, 0.0, 0.0])
    assert touch.force_N == pytest.approx(1.0, abs=0.03)


@pytest.mark.parametrize(
    ("stays", "count"),
    [
        # It takes the force of a contact, 0.5 N.
        ([(0.1, 0.45, 0.0)], 0),
        ([(0.1, 0.55, 0.0)], 1),
        # The tip rests within 0.7 mm.
        ([(0.1, 1.0, 0.6e-3)], 1),
        ([(0.1, 1.0, 0.85e-3)], 0),
        # Places less than 4 mm apart are one.
        ([(0.1, 1.0, 0.0), (0.1035, 1.0, 0.0)], 1),
        ([(0.1, 1.0, 0.0), (0.1045, 1.0, 0.0)], 2),
    ],
)
def test_a_touch_needs_force_and_rest_at_a_place_of_its_own(stays, count):
    assert len(touches(*stays)) == count
