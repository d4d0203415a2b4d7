"""Re-weighting of the friction variance after a rupture, equation (12)."""


def reweighted_friction_variance(
    var_friction: float, elastic_ratio: float, friction_ratio: float, mean_speed_m_s: float
) -> float:
    """sigma'^2_B,0 = (1 / v^2) (r_B / r_K) sigma^2_B,0, equation (12).

    With collinear columns least squares moves the estimate along Psi phi, so that
    (B v dz) / (K dz) settles at sigma'^2_B v^2 / sigma^2_K = r_B / r_K.

    Args:
        var_friction: sigma^2_B,0.
        elastic_ratio: r_K of equation (11), positive.
        friction_ratio: r_B of equation (11).
        mean_speed_m_s: Average speed while traversing the layer, not zero.
    """
    return var_friction * friction_ratio / (elastic_ratio * mean_speed_m_s * mean_speed_m_s)
