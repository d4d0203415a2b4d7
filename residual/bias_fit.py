"""Fits a tare to blocks of free motion, and refuses one that would hide a contact.

Bayesian least squares; pure functions.
"""

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from residual.bias_model import BiasModel, Tare, TareBlocks
from residual.errors import TareError
from residual.wrench_estimator import WrenchEstimator

Array = NDArray[np.float64]
LINK_SCALES = (0.25, 0.5, 1.0, 2.0)
"""How good the link table may be, against the prior's figure; the motion itself chooses."""

FEW_BLOCKS = 8
"""From seven differences between neighbours a variance is known to two thirds of itself; from fewer
it may be nearly nothing by chance, and a few blocks would count for too much."""

SIGMAS = 5.0
"""A force must exceed this many standard deviations to count as contact."""
SPLITS = (0.1, 0.2, 0.35, 0.55, 0.75, 0.9)
"""Fractions of the motion from which the rest is predicted."""
SMOOTHING_BLOCKS = 5
"""A contact lasts: forces are averaged over this many blocks."""

MOST_LEFT, MOST_LEFT_BY_A_MASS = 0.2, 0.6
"""Fraction of the residual, root mean square, that an explanation may leave over; offsets of the
torque sensors are among it."""
LEAST_OFFSETS = 3.0
"""Residual in standard deviations of the offset's prior from which one is looked for unasked."""
NEAR = 0.15
"""So near to a factor with a reason a factor is that one."""
OFFSET_BLOCKS = 10.0
FURTHEST_M = 0.5
"""No hand or tool has its centre of mass further from the last joint."""


def fit_tare(basis: BiasModel, blocks: TareBlocks) -> Tare:
    """Fit the offset over blocks of free motion.

    Two passes: the first takes the noise seen between neighbouring blocks for independent; what it
    leaves beyond that is the sensors' waviness (torque ripple, hysteresis), a wave along each
    joint's position that comes back when the joint does. The second pass knows of it, so that
    waves do not pass for many independent samples of a slope.

    Args:
        basis: The linear model with its prior.
        blocks: What was seen.

    Returns:
        The fitted tare.
    """
    design = np.stack(
        [
            basis.columns(q, loops, age)
            for q, loops, age in zip(blocks.q_rad, blocks.hysteresis, blocks.age_s, strict=True)
        ]
    )
    residual = blocks.residual_Nm
    few = len(residual) < FEW_BLOCKS
    # Neighbours of which there are few mean nothing: then a block is as noisy as its samples.
    white = blocks.scatter_Nm2 if few else _neighbour_variance(residual)
    white = white + basis.resolution_variance()
    whiteners = [np.eye(len(residual)) / v for v in white]
    mean, _ = _posterior(_normal(design, residual, whiteners), basis.std)
    wave = _wave_variance(residual - design @ mean, white, np.ptp(blocks.q_rad, axis=0), basis)
    if wave.any():
        alike = [_alike(q, basis.prior.wave_rad) for q in blocks.q_rad.T]
        whiteners = [
            np.linalg.inv(v * np.eye(len(residual)) + w * k)
            for v, w, k in zip(white, wave, alike, strict=True)
        ]
    normal = _normal(design, residual, whiteners)
    mean, covariance = _posterior(normal, _likeliest_prior(normal, basis))
    return Tare(
        basis=basis,
        mean=mean,
        covariance=covariance,
        noise_Nm2=np.diag(blocks.scatter_Nm2 + white + wave),
    )


def _neighbour_variance(residual: Array) -> Array:
    """Variance of a block's noise per joint, from the differences of neighbours, shape (n,)."""
    return np.square(np.diff(residual, axis=0)).mean(axis=0) / 2.0


def _wave_variance(
    left: Array,
    white: Array,
    travel_rad: Array,
    basis: BiasModel,
) -> Array:
    """Variance of the sensors' waviness per joint [Nm^2], shape (n,).

    What the first pass left beyond the white noise. A joint that moved less than a few wavelengths
    has had its wave fitted away as a slope: it is given what the others have, in proportion to
    range, since an arm's torque sensors are of one kind.
    """
    own = np.maximum((left**2).mean(axis=0) - white, 0.0)
    moved = travel_rad > 4.0 * basis.prior.wave_rad
    if not moved.any():
        return own
    of_range = np.mean(own[moved] / basis.effort_Nm[moved] ** 2)
    return np.maximum(own, of_range * basis.effort_Nm**2)


def _alike(position: Array, length: float) -> Array:
    """How much a wave at two positions is the same, 0 to 1, shape (m, m)."""
    distance = (position[:, None] - position) / length
    return np.exp(-0.5 * distance**2)


def _normal(design: Array, residual: Array, whiteners: list[Array]) -> tuple[Array, Array]:
    """Information and evidence of ``residual = design theta + noise``.

    The noise of joint i has the inverse covariance ``whiteners[i]``.
    """
    size = design.shape[2]
    information, evidence = np.zeros((size, size)), np.zeros(size)
    for joint, whitener in enumerate(whiteners):
        rows = design[:, joint]
        weighted = whitener @ rows
        information += rows.T @ weighted
        evidence += weighted.T @ residual[:, joint]
    return information, evidence


def _posterior(normal: tuple[Array, Array], prior_std: Array) -> tuple[Array, Array]:
    """Mean and covariance of theta, solved in units of the prior: well conditioned."""
    information, evidence = normal
    units = np.outer(prior_std, prior_std)
    covariance = np.linalg.inv(np.eye(len(prior_std)) + information * units)
    mean = prior_std * (covariance @ (prior_std * evidence))
    return mean, covariance * units


def _likeliest_prior(normal: tuple[Array, Array], basis: BiasModel) -> Array:
    """The prior with the scale of link errors that makes the data likeliest (empirical Bayes)."""
    if "links" not in basis.groups:
        return basis.std
    information, evidence = normal
    candidates = []
    for scale in LINK_SCALES:
        std = basis.std.copy()
        std[basis.groups["links"]] *= scale
        precision = np.eye(len(std)) + information * np.outer(std, std)
        pull = std * evidence
        _, log_volume = np.linalg.slogdet(precision)
        candidates.append((pull @ np.linalg.solve(precision, pull) - log_volume, std))
    return max(candidates, key=lambda candidate: candidate[0])[1]


def check_free_of_contact(
    prior: Tare,
    blocks: TareBlocks,
    wrench: WrenchEstimator,
    contact_force_N: float,
    *,
    is_external: bool = False,
) -> None:
    """Refuse a tare whose motion was not free, or whose torques are not what they are taken for.

    Free motion predicts itself: a tare fitted to its beginning must hold for the rest within its
    own standard deviation. A needle that touches something on the way breaks that; one that is in
    contact all the time breaks the prior. The measure is the arm's own model mismatch, so a coarse
    model does not pass for contact.

    Args:
        prior: What is known before data, see `residual.bias_model.prior_tare`.
        blocks: The motion.
        wrench: Reads the axial force from joint torques; its covariance is overwritten, so it must
            be the caller's own for this.
        contact_force_N: Smallest force that counts [N].
        is_external: Whether the residual is an estimate that the robot sends itself.

    Raises:
        TareError: If there is contact, with the force seen, or wrong torques, with what they look
            like.
    """
    force, std = _worst_excess(prior, blocks, wrench, contact_force_N)
    for fraction in SPLITS:
        if force == 0.0 and (known := round(fraction * len(blocks.age_s))) >= SMOOTHING_BLOCKS:
            early, late = blocks.split(known)
            force, std = _worst_excess(fit_tare(prior.basis, early), late, wrench, contact_force_N)
    cause = explain_residual(prior.basis, blocks, is_external=is_external, is_refused=force != 0.0)
    if force != 0.0 or cause:
        seen = f"the sensor reads {force:.2f} N along the needle where 0 +/- {std:.2f} N is "
        raise TareError(
            (seen + "expected in free motion: " if force != 0.0 else "")
            + (cause or "the needle seems to be in contact, or the payload is wrong")
            + ". Tare in free air, or ignore_contact=True if you know better"
        )


def _worst_excess(
    known: Tare, blocks: TareBlocks, wrench: WrenchEstimator, contact_force_N: float
) -> tuple[float, float]:
    """Largest axial force beyond what a tare allows, with its standard deviation; zeros if none."""
    forces, stds = [], []
    for q, loops, age, residual in zip(
        blocks.q_rad, blocks.hysteresis, blocks.age_s, blocks.residual_Nm, strict=True
    ):
        wrench.set_torque_covariance(known.covariance_Nm2(q, loops, abs(float(age))))
        seen = wrench.estimate(q, residual - known.bias_Nm(q, loops, float(age)))
        forces.append(seen.axial)
        stds.append(seen.axial_std)
    width = min(SMOOTHING_BLOCKS, len(forces))
    average = np.full(width, 1.0 / width)
    force = np.convolve(forces, average, mode="valid")
    std = np.convolve(stds, average, mode="valid")
    excess = np.abs(force) - np.maximum(contact_force_N, SIGMAS * std)
    worst = int(np.argmax(excess))
    return (float(force[worst]), float(std[worst])) if excess[worst] > 0.0 else (0.0, 0.0)


def explain_residual(
    basis: BiasModel, blocks: TareBlocks, *, is_external: bool, is_refused: bool
) -> str:
    """What a residual that is no free motion's looks like; empty if like nothing known.

    At rest the residual of measured torques is ``g(q) - tau``: g(q) itself if gravity was taken out
    of tau before, 2 g(q) if tau has the other sign, minus g(q) if gravity was added twice.

    Args:
        basis: Model of the arm, with how large offsets are expected to be.
        blocks: The motion.
        is_external: Whether the residual is an estimate that the robot sends itself.
        is_refused: Whether the tare is refused anyhow; a mass at the flange is looked for only
            then, and the others only in a residual far beyond all offsets.
    """
    scale = basis.prior.offset_share * basis.effort_Nm
    residual = blocks.residual_Nm / scale
    size = _rms(residual)
    if size == 0.0 or not (is_refused or size > LEAST_OFFSETS):
        return ""
    gravity_Nm = np.array([basis.gravity_Nm(q) for q in blocks.q_rad])
    gravity = gravity_Nm / scale
    if gravity.any():
        factor = float(np.vdot(residual, gravity) / np.vdot(gravity, gravity))
        if _rms(residual - factor * gravity) < MOST_LEFT * size:
            for known, reason in _GRAVITY_FACTORS[is_external].items():
                if abs(factor / known - 1.0) < NEAR:
                    return f"the residual is {factor:.2f} times gravity's torque g(q): {reason}"
    order = () if is_external else _order_of_joints(gravity_Nm - blocks.residual_Nm, gravity_Nm)
    if order:
        moved = [f"{i} reads as {j}'s" for i, j in enumerate(order) if i != j]
        return f"joints seem to be exchanged: tau at joint index {', '.join(moved)}"
    return _mass_at_flange(basis, blocks, scale) if is_refused else ""


_GRAVITY_FACTORS = {
    False: {
        1.0: "tau seems to leave gravity out; set torque_is_gravity_compensated=True",
        2.0: "tau seems to have the wrong sign; negate it",
        -1.0: "gravity seems to be added twice; set torque_is_gravity_compensated=False",
    },
    True: {
        1.0: "it seems to be the measured torque; call update() instead",
        -1.0: "it seems to be the negated measured torque; negate it and call update() instead",
    },
}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _order_of_joints(torque: Array, gravity: Array) -> tuple[int, ...]:
    """Whose gravity each measured torque is, both (m, n); empty if their own, or nobody's."""
    cost = np.square(torque[:, :, None] - gravity[:, None, :]).mean(axis=0)
    own = float(np.trace(cost))
    # Joints without gravity are alike: of equal orders the one that moves fewest is meant.
    joints, order = linear_sum_assignment(cost + 1e-3 * own * (1.0 - np.eye(len(cost))))
    explains = (order != joints).any() and cost[joints, order].sum() < MOST_LEFT**2 * own
    return tuple(order.tolist()) if explains else ()


def _mass_at_flange(basis: BiasModel, blocks: TareBlocks, scale: Array) -> str:
    """A mass behind the last joint that the model has too much of, or lacks; empty if it is none.

    Least squares of the residual over its mass and first moments, and an offset per joint.
    """
    n = len(scale)
    masses = np.concatenate([basis.regressor(q)[:, -4:] / scale[:, None] for q in blocks.q_rad])
    offsets = np.tile(np.eye(n), (len(blocks.q_rad), 1))
    # An offset is expected within one unit: beyond, it costs as much as so many blocks.
    prior = np.hstack((np.zeros((n, 4)), np.sqrt(OFFSET_BLOCKS) * np.eye(n)))
    residual = (blocks.residual_Nm / scale).ravel()
    columns = np.vstack((np.hstack((masses, offsets)), prior))
    # Directions that a short motion does not show stay at zero.
    found = np.linalg.lstsq(columns, np.append(residual, np.zeros(n)), rcond=1e-3)[0]
    mass, is_body = float(found[0]), np.linalg.norm(found[1:4]) < FURTHEST_M * abs(found[0])
    if not is_body or _rms(residual - masses @ found[:4]) > MOST_LEFT_BY_A_MASS * _rms(residual):
        return ""
    fault = "has about {:.2g} kg too much" if mass > 0.0 else "lacks about {:.2g} kg"
    return (
        f"the robot's model {fault.format(abs(mass))} at the flange: correct hand, tool and "
        "payload in it, unless the needle is in contact"
    )
