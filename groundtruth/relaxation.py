"""Relaxation: a resting needle is slowly let go, an advancing tip meets fresh tissue."""

import math

RELAXATION_S = 10.0
"""Time constant. Real liver (de Jong 2017, 19 holds of 60 s) loses 63 % of what it will lose in
8.5 s (median), the quick loss of viscous friction at the stop included."""
RECOVERY_M = 0.3e-3
"""Travel over which an advancing tip meets fresh tissue: a fraction of its diameter."""


def relaxation_step(relaxed: float, speed_m_s: float, dt_s: float) -> float:
    """Advance the relaxation of the tip force: it grows with time and fades with travel.

    Exact step of dr/dt = (1 - r) / RELAXATION_S - r |v| / RECOVERY_M for a held speed, so any
    step is stable. In motion it stays near zero (1.3 % at 2.3 mm/s).

    Args:
        relaxed: Relaxation before, 0 (fresh) to 1 (a long rest).
        speed_m_s: Speed of the tip.
        dt_s: Length of the step.

    Returns:
        The relaxation after the step, 0 to 1.
    """
    rate = 1.0 / RELAXATION_S + abs(speed_m_s) / RECOVERY_M
    settled = 1.0 / (RELAXATION_S * rate)
    return relaxed - (settled - relaxed) * math.expm1(-rate * dt_s)


def bristle_step(
    bristle: float, travel_m: float, dt_s: float, presliding_m: float, relaxed_share: float
) -> float:
    """Advance the deflection of the shaft's bristles: Dahl's presliding, with relaxation.

    Travel pulls the deflection to the direction of motion, dw/dx = (sign(dx) - w) / presliding
    (Dahl 1968, exponent 1); time lets a deflection beyond 1 - relaxed_share sink to that. Both
    act at once and the step is their exact solution: it cannot leave [-1, 1], whatever its size.

    Args:
        bristle: Deflection before, -1 to 1; the Coulomb force is `coulomb * bristle`.
        travel_m: Signed travel of the shaft during the step.
        dt_s: Length of the step.
        presliding_m: Travel constant of the tissue.
        relaxed_share: Share of the Coulomb force lost after a long rest.

    Returns:
        The deflection after the step.
    """
    pull = abs(travel_m) / presliding_m
    target = math.copysign(pull, travel_m)
    held = 1.0 - relaxed_share
    if abs(bristle) > held:
        fade = dt_s / RELAXATION_S
        pull += fade
        target += fade * math.copysign(held, bristle)
    if pull == 0.0:
        return bristle
    return bristle - (target / pull - bristle) * math.expm1(-pull)
