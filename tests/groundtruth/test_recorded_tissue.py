"""A recorded force in the place of simulated tissue."""

import numpy as np
import pytest

from groundtruth.errors import TissueError
from groundtruth.recorded_tissue import RecordedTissue


def recorded() -> RecordedTissue:
    """Return 100 N/m over 20 mm at 5 mm/s, then a fall from 2 to 1 N in 2 s of rest."""
    t_s = np.arange(0.0, 6.0, 0.01)
    depth_m = np.minimum(5e-3 * t_s, 20e-3)
    force_N = np.where(t_s < 4.0, 100.0 * depth_m, 2.0 - 0.5 * (t_s - 4.0))
    return RecordedTissue(t_s, depth_m, force_N)


def test_an_advancing_needle_feels_the_force_of_its_depth_whatever_its_speed():
    tissue = recorded()
    depths_m = np.arange(-2e-3, 19e-3, 1e-5)
    forces_N = [tissue.step(depth, 1e-2, 1e-3).axial_N for depth in depths_m.tolist()]

    assert forces_N == pytest.approx(100.0 * np.maximum(depths_m, 0.0), abs=2e-3)


def test_a_needle_that_holds_feels_the_recorded_relaxation():
    tissue = recorded()
    for depth_m in np.arange(0.0, 20e-3, 1e-5).tolist():
        tissue.step(depth_m, 1e-2, 1e-3)
    held_N = [tissue.step(20e-3, 0.0, 1e-3).axial_N for _ in range(1000)]

    assert held_N[0] == pytest.approx(2.0, abs=0.02)
    assert held_N[-1] == pytest.approx(1.5, abs=0.02)


def test_a_withdrawn_needle_feels_nothing_that_was_not_recorded():
    tissue = recorded()
    for depth_m in np.arange(0.0, 15e-3, 1e-5).tolist():
        tissue.step(depth_m, 1e-2, 1e-3)

    assert tissue.step(10e-3, -1e-2, 1e-3).axial_N == 0.0


def test_a_force_that_is_not_finite_is_refused():
    with pytest.raises(TissueError, match="finite forces"):
        RecordedTissue(np.arange(3.0), np.arange(3.0), np.array([0.0, np.nan, 1.0]))
