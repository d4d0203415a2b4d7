"""The textbook tissue is equation (3), to rounding, for any depth and speed."""

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth.errors import TissueError
from groundtruth.materials import gel
from groundtruth.multilayer_tissue import MultilayerTissue

LAYERS = (gel(25), gel(50), gel(70))
TOPS = np.cumsum([0.0, *(layer.thickness_m for layer in LAYERS)])


def equation_3(z, v):
    """f = K_i Δz_i + B_i Δz_i v + B̄_d v on first insertion, written from the paper."""
    if z <= 0.0:
        return 0.0
    cumulative = 0.0
    for i, layer in enumerate(LAYERS):
        dz, b = z - TOPS[i], layer.friction.textbook_Ns_per_m2
        if dz < layer.thickness_m:
            return layer.stiffness_N_per_m * dz + b * dz * v + cumulative * v
        cumulative += b * layer.thickness_m
    return cumulative * v


@given(
    depth_m=st.floats(-0.02, 0.12),
    speed_m_s=st.floats(-0.01, 0.01),
)
def test_first_insertion_is_equation_3(depth_m, speed_m_s):
    force = MultilayerTissue(LAYERS).step(depth_m, speed_m_s, 1e-3)
    assert force.axial_N == pytest.approx(equation_3(depth_m, speed_m_s), abs=1e-12)


def test_cumulative_friction_is_table_i():
    force = MultilayerTissue(LAYERS).step(0.105, 1.0, 1e-3)
    assert force.layer_friction_N == pytest.approx([113.0, 283.0, 534.0])
    assert force.layer == 4
    assert force.tip_N == 0.0


def test_elastic_part_is_gone_on_the_way_back():
    law = MultilayerTissue(LAYERS)
    law.step(0.105, 2e-3, 1e-3)
    back = [law.step(float(z), -2e-3, 1e-3) for z in np.linspace(0.1, 0.001, 50)]
    assert all(force.tip_N == 0.0 and force.axial_N < 0.0 for force in back)
    law.reset()
    assert law.step(0.01, 2e-3, 1e-3).tip_N > 0.0


def test_boundaries_give_way_at_once_where_they_lie():
    boundaries = MultilayerTissue(LAYERS).interfaces
    assert [b.onset_m for b in boundaries] == pytest.approx(TOPS)
    assert all(b.release_m == 0.0 for b in boundaries)
    assert boundaries[0].drop_N == 0.0
    assert boundaries[3].drop_N == pytest.approx(gel(70).exit_force_N)


def test_unusable_sample_is_refused():
    with pytest.raises(TissueError, match="finite"):
        MultilayerTissue(LAYERS).step(float("nan"), 0.0, 1e-3)
