import numpy as np
import pinocchio as pin
import pytest
from hypothesis import given
from hypothesis import strategies as st

from groundtruth.arm_plant import blend_link_parameters, cad_link_parameters, lwr_bodies
from groundtruth.errors import PlantModelError
from groundtruth.plant_model import PLANT_MODELS, plant_model
from urdf import NeedleTool, load_lwr

# Fact sheet, section 2.6: static force bias at the flange in this posture, per CAD share.
POSTURE = np.array([0.0, 0.5, 0.0, -1.5, 0.0, 1.0, 0.0])
FLANGE_BIAS_N = {0.1: 0.31, 0.2: 0.61, 0.3: 0.92, 1.0: 3.07}

BARE = load_lwr()


def nominal_parameters():
    return np.array([BARE.model.inertias[i].toDynamicParameters() for i in range(1, 8)])


def is_consistent(parameters):
    link = pin.Inertia.FromDynamicParameters(parameters)
    return np.linalg.eigvalsh(pin.PseudoInertia.FromInertia(link).toMatrix()).min() > 0.0


@given(share=st.floats(0.0, 1.0))
def test_every_blend_of_the_tables_is_physically_consistent(share):
    blend = blend_link_parameters(nominal_parameters(), cad_link_parameters(), share)
    assert all(is_consistent(row) for row in blend)


def test_blend_ends_at_the_two_tables():
    nominal, cad = nominal_parameters(), cad_link_parameters()
    np.testing.assert_array_equal(blend_link_parameters(nominal, cad, 0.0), nominal)
    np.testing.assert_array_equal(blend_link_parameters(nominal, cad, 1.0), cad)


@pytest.mark.parametrize(("share", "bias_N"), FLANGE_BIAS_N.items())
def test_blend_biases_the_flange_force_as_published(share, bias_N):
    model = BARE.model.copy()
    for i, row in enumerate(
        blend_link_parameters(nominal_parameters(), cad_link_parameters(), share), start=1
    ):
        model.inertias[i] = pin.Inertia.FromDynamicParameters(row)
    data = model.createData()
    gravity = pin.computeGeneralizedGravity(model, data, POSTURE).copy()
    gravity -= pin.computeGeneralizedGravity(BARE.model, BARE.create_data(), POSTURE)
    jacobian = pin.computeFrameJacobian(
        model, data, POSTURE, BARE.tool_frame_id, pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    )
    wrench = np.linalg.pinv(jacobian.T) @ gravity
    assert abs(wrench[2]) == pytest.approx(bias_N, abs=0.011)


@pytest.mark.parametrize("share", [-0.1, 1.1, float("nan")])
def test_a_share_outside_zero_to_one_is_refused(share):
    with pytest.raises(PlantModelError, match=r"expected a number in \[0, 1\]"):
        blend_link_parameters(nominal_parameters(), cad_link_parameters(), share)


def test_tables_of_different_size_are_refused():
    with pytest.raises(PlantModelError, match="same number of links"):
        blend_link_parameters(nominal_parameters(), cad_link_parameters()[:6], 0.1)


def test_unknown_level_lists_the_known_ones():
    with pytest.raises(PlantModelError, match="ideal, clean, degraded"):
        plant_model("perfect")


@pytest.mark.parametrize("name", PLANT_MODELS)
def test_tool_error_of_a_level_is_exactly_its_mass_error(name):
    level, tool = PLANT_MODELS[name], NeedleTool()
    signs = set()
    for seed in range(8):
        bodies = lwr_bodies(tool, level, np.random.default_rng(seed))
        error = (bodies.sensor.mass + bodies.needle.mass) / tool.payload.mass_kg - 1.0
        assert abs(error) == pytest.approx(level.payload_error, abs=1e-12)
        signs.add(np.sign(round(error, 9)))
    assert signs == ({-1.0, 1.0} if level.payload_error else {0.0})


def test_com_error_has_the_spread_of_the_level():
    tool, level = NeedleTool(), PLANT_MODELS["degraded"]
    rng = np.random.default_rng(0)
    shifts = [lwr_bodies(tool, level, rng).needle.lever for _ in range(60)]
    spread = np.std(np.array(shifts) - tool.beyond_sensor.com_m)
    # 180 draws: 5 % standard error of the standard deviation
    assert spread == pytest.approx(level.payload_com_spread_m, rel=0.2)


def test_textbook_arm_is_the_estimators_robot():
    bodies = lwr_bodies(NeedleTool(), PLANT_MODELS["ideal"], np.random.default_rng(0))
    for true, believed in zip(bodies.model().inertias, bodies.robot.model.inertias, strict=True):
        np.testing.assert_allclose(
            true.toDynamicParameters(), believed.toDynamicParameters(), atol=1e-12
        )


def test_hard_arm_has_at_least_the_faults_of_the_realistic_one():
    realistic, hard = PLANT_MODELS["clean"], PLANT_MODELS["degraded"]
    np.testing.assert_allclose(
        hard.torque_noise_std_Nm, 2.0 * np.array(realistic.torque_noise_std_Nm)
    )
    assert hard.cad_share > realistic.cad_share > 0.0
    assert hard.payload_error > realistic.payload_error > 0.0
    assert hard.velocity_noise_std_rad_s is None
    assert hard.torque_ripple > 0.0
    assert hard.torque_hysteresis > 0.0
