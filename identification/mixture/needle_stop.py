"""What the force at a stop says of friction, and what earlier stops have shown.

While the needle advances, friction f on the shaft and tip force t share the axial force
F = f + t. Once it rests, a fraction p of that friction and a fraction q of that tip
force remain,

    F' = p f + q t,

and F' is measured. Before the first stop p is hardly known: it is Coulomb's part of the
friction, and how friction divides into Coulomb and viscous friction does not show at
one speed. q is known better, since a tip that does not advance cannot press harder; it
relaxes. `meet_stop` corrects f, p and q with F', to first order. What it finds of p and
q is where the next stop begins. Between the speed before a stop and rest, p and q lie
between 1 and their values at rest, in proportion to the speed lost.

Lengths are in mm, speeds in mm/s, forces in N.
"""

from dataclasses import dataclass
from typing import NamedTuple

from foundation.jit import compiled_inside
from identification.mixture.needle_contact import REST_SPEED_MM_S

SLIDING_DEFLECTION = 0.9
"""Presliding deflection from which on the whole shaft slides inwards."""

RELAXED_FRICTION = 0.6
"""Fraction of p that a long rest takes, as of the whole force in real liver (19 holds
of 60 s)."""

MIN_FRICTION_N = 0.01
"""Friction from which on a stop says something of its split."""


@dataclass(slots=True)
class Friction:
    """Coulomb and viscous friction of a length of shaft, with their joint covariance.

    Attributes:
        coulomb: Coulomb friction [N].
        viscous: Viscous friction [N/(mm/s)].
        coulomb_variance: Variance of the Coulomb friction.
        covariance: Covariance of the two.
        viscous_variance: Variance of the viscous friction.
        offset_coulomb: Covariance of the offset and the Coulomb friction.
        offset_viscous: Covariance of the offset and the viscous friction.
    """

    coulomb: float = 0.0
    viscous: float = 0.0
    coulomb_variance: float = 0.0
    covariance: float = 0.0
    viscous_variance: float = 0.0
    offset_coulomb: float = 0.0
    offset_viscous: float = 0.0


@dataclass(slots=True)
class NeedleStop:
    """The motion before a stop, and what stops have shown.

    Attributes:
        speed_mm_s: Speed of the needle that still advanced, 0 before any.
        depth_mm: Where that was.
        force: Axial force there, less the offset [N].
        friction: Friction of the shaft there [N].
        friction_variance: Variance of that friction [N²].
        kept_friction: p, as expected at the next stop.
        kept_friction_variance: Variance of p.
        kept_tip: q, as expected at the next stop.
        kept_tip_variance: Variance of q.
        covariance: Covariance of p and q.
        rest_s: Time at rest so far.
        shown_friction: p that earlier stops have shown; 0 before the first.
        shown_friction_variance: Variance of that.
        shown_tip: q that earlier stops have shown.
        shown_tip_variance: Variance of that.
        shown_covariance: Covariance of the two.
    """

    speed_mm_s: float = 0.0
    depth_mm: float = 0.0
    force: float = 0.0
    friction: float = 0.0
    friction_variance: float = 0.0
    kept_friction: float = 0.0
    kept_friction_variance: float = 0.0
    kept_tip: float = 0.0
    kept_tip_variance: float = 0.0
    covariance: float = 0.0
    rest_s: float = 0.0
    shown_friction: float = 0.0
    shown_friction_variance: float = 0.0
    shown_tip: float = 0.0
    shown_tip_variance: float = 0.0
    shown_covariance: float = 0.0


class Retention(NamedTuple):
    """Fractions of friction and tip force that remain, p and q.

    Attributes:
        friction: Mean of p.
        tip: Mean of q.
        friction_variance: Variance of p.
        tip_variance: Variance of q.
        covariance: Covariance of the two.
    """

    friction: float
    tip: float
    friction_variance: float
    tip_variance: float
    covariance: float


@compiled_inside
def lost_speed(stop: NeedleStop, speed_mm_s: float) -> float:
    """Return the fraction of the remembered speed that the needle has lost, 0 to 1."""
    if stop.speed_mm_s <= 0.0:
        return 0.0
    return min(max(1.0 - speed_mm_s / stop.speed_mm_s, 0.0), 1.0)


@compiled_inside
def retain(stop: NeedleStop, lost: float, relaxation: float) -> Retention:
    """Return what remains where so much of the speed is lost, before F' is known.

    Args:
        stop: With p and q at rest, not relaxed.
        lost: Fraction of the speed that is lost.
        relaxation: How far tissue has relaxed at rest, 0 to 1.
    """
    # A long rest takes half as much of q as of p, since it is not known whether tip or
    # friction relaxes, with a deviation of 0.3 of both.
    relaxed_friction = stop.kept_friction * (1.0 - RELAXED_FRICTION * relaxation)
    relaxed_tip = stop.kept_tip * (1.0 - 0.3 * relaxation)
    relaxed_variance = (0.3 * relaxation) ** 2
    return Retention(
        1.0 - lost * (1.0 - relaxed_friction),
        1.0 - lost * (1.0 - relaxed_tip),
        lost * lost * (stop.kept_friction_variance + relaxed_variance),
        lost * lost * (stop.kept_tip_variance + relaxed_variance),
        lost * lost * stop.covariance,
    )


@compiled_inside
def meet_stop(
    stop: NeedleStop, before: Retention, force: float, force_variance: float
) -> tuple[tuple[float, float], Retention]:
    """Correct f, p and q with the force measured, and return p f.

    Args:
        stop: With the force and the friction while the needle advanced.
        before: p and q as expected.
        force: F', less the offset [N].
        force_variance: Of the measured forces and of all that the two fractions do not
            describe [N²].

    Returns:
        Mean [N] and variance of p f; p and q.
    """
    friction = stop.friction
    tip = max(stop.force - friction, 0.0)
    p = before.friction
    q = before.tip
    # The measurement's slopes over f, p and q, the tip force being F - f.
    by_friction = p - q
    cross_friction = stop.friction_variance * by_friction
    cross_p = before.friction_variance * friction + before.covariance * tip
    cross_q = before.tip_variance * tip + before.covariance * friction
    variance = (
        by_friction * cross_friction
        + friction * cross_p
        + tip * cross_q
        + force_variance
    )
    innovation = force - p * friction - q * tip
    after = Retention(
        p + cross_p / variance * innovation,
        q + cross_q / variance * innovation,
        max(before.friction_variance - cross_p * cross_p / variance, 0.0),
        max(before.tip_variance - cross_q * cross_q / variance, 0.0),
        before.covariance - cross_p * cross_q / variance,
    )
    friction_before = friction + cross_friction / variance * innovation
    variance_before = stop.friction_variance - cross_friction**2 / variance
    covariance_with_p = -cross_friction * cross_p / variance
    kept_fraction = min(max(after.friction, 0.0), 1.0)
    variance_at_rest = (
        kept_fraction**2 * variance_before
        + friction_before**2 * after.friction_variance
        + 2.0 * kept_fraction * friction_before * covariance_with_p
    )
    friction_at_rest = kept_fraction * friction_before
    return (friction_at_rest, max(variance_at_rest, 0.0)), after


@compiled_inside
def expect_stop(stop: NeedleStop, expected_p: float, expected_variance: float) -> None:
    """Set p and q to what the force law and earlier stops let expect.

    Args:
        stop: Which is changed.
        expected_p: Coulomb's part of the friction, by the force law.
        expected_variance: Its variance.
    """
    if stop.shown_friction_variance == 0.0:
        stop.kept_friction = expected_p
        stop.kept_friction_variance = expected_variance
        stop.kept_tip = 0.95  # no measurement is known that tells it from p
        stop.kept_tip_variance = 0.15**2
        stop.covariance = 0.0
        return
    change_variance = 0.1**2  # from one stop to the next
    shown_variance = stop.shown_friction_variance + change_variance
    weight = expected_variance / (expected_variance + shown_variance)
    stop.kept_friction = weight * stop.shown_friction + (1.0 - weight) * expected_p
    stop.kept_friction_variance = weight * shown_variance
    stop.kept_tip = stop.shown_tip
    stop.kept_tip_variance = stop.shown_tip_variance + change_variance
    stop.covariance = weight * stop.shown_covariance


@compiled_inside
def remember_motion(
    stop: NeedleStop, shaft: Friction, speed: float, depth_mm: float, net_force: float
) -> None:
    """Remember a needle that advances, unless it is coming to a stop.

    Args:
        stop: Which is changed.
        shaft: Friction of the whole shaft.
        speed: Of the needle [mm/s].
        depth_mm: Of its tip.
        net_force: Axial force, less the offset [N].
    """
    # A needle that slows down is coming to a stop: within half a millimetre, further on
    # it advances at another speed.
    is_steady = speed >= 0.9 * stop.speed_mm_s or depth_mm > stop.depth_mm + 0.5
    if speed <= REST_SPEED_MM_S or not is_steady:
        return
    cross_covariance = shaft.coulomb_variance + speed * shaft.covariance
    variance = (
        cross_covariance + speed * shaft.covariance + speed**2 * shaft.viscous_variance
    )
    friction = shaft.coulomb + speed * shaft.viscous
    stop.speed_mm_s = speed
    stop.depth_mm = depth_mm
    stop.force = net_force
    stop.friction = max(friction, 0.0)
    stop.friction_variance = max(variance, 0.0)
    stop.rest_s = 0.0
    # Variance of Coulomb's part, the friction being given
    shared = cross_covariance**2 / max(variance, 1e-12)
    coulomb_variance = max(shaft.coulomb_variance - shared, 0.0)
    # Beyond what the force law claims to know of p: at one speed it knows nothing, and
    # what it learns from changes of speed rests on its form.
    split_variance = 0.25**2
    friction = max(friction, MIN_FRICTION_N)
    expected_p = min(max(shaft.coulomb / friction, 0.0), 1.0)
    expect_stop(stop, expected_p, coulomb_variance / friction**2 + split_variance)


@compiled_inside
def learn_from_rest(
    stop: NeedleStop, duration_s: float, force: float, force_variance: float
) -> None:
    """Keep what a stop has shown, once the needle has rested for a while.

    Args:
        stop: Which is changed.
        duration_s: Length of the block at rest.
        force: Its force, less the offset [N].
        force_variance: See `meet_stop`.
    """
    learning_s = 0.3  # after which the force has shown what a stop takes from it
    is_shown = stop.rest_s < learning_s <= stop.rest_s + duration_s
    stop.rest_s += duration_s
    if not is_shown or stop.friction < MIN_FRICTION_N:
        return
    _, shown = meet_stop(stop, retain(stop, 1.0, 0.0), force, force_variance)
    stop.shown_friction = min(max(shown.friction, 0.0), 1.0)
    stop.shown_tip = min(max(shown.tip, 0.0), 1.0)
    stop.shown_friction_variance = shown.friction_variance
    stop.shown_tip_variance = shown.tip_variance
    stop.shown_covariance = shown.covariance
