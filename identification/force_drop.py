"""What a rupture tells about elastic and friction force, equations (10) and (11)."""

_SMALLEST_RATIO = 1e-3


def drop_interval_s(travel_m: float, speed_m_s: float) -> float:
    """Waiting time T_drop = k_v / v (Section VI-A); the published k_v = 1 is in millimetres."""
    return travel_m / speed_m_s


def force_drop_N(force_at_rupture_N: float, force_after_N: float) -> float:
    """Force drop f(t_r) - f(t_r + T_drop), equation (10)."""
    return force_at_rupture_N - force_after_N


def force_ratios(
    drop_N: float,
    force_at_rupture_N: float,
    cumulative_friction_Ns_per_m: float,
    speed_m_s: float,
) -> tuple[float, float]:
    """Elastic and friction ratio (r_K, r_B) of the layer just left, equation (11).

    A drop below zero or above the whole force has no physical ratio; r_K is kept inside
    (0, 1) by a thousandth so that (12) stays positive and finite.

    Args:
        drop_N: Force drop of equation (10).
        force_at_rupture_N: f(t_r).
        cumulative_friction_Ns_per_m: Sum of B_j d_j over the layers before; zero for the first.
        speed_m_s: v(t_r).
    """
    own_N = force_at_rupture_N - cumulative_friction_Ns_per_m * speed_m_s
    raw = drop_N / own_N if own_N > 0.0 else 1.0
    elastic = min(max(raw, _SMALLEST_RATIO), 1.0 - _SMALLEST_RATIO)
    return elastic, 1.0 - elastic
