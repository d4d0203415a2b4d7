"""Refuses a tare that would hide a contact, and says what a residual looks like."""

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from foundation.advice import Message
from residual.advice import TareAdvice
from residual.bias.fit import FreeMotionFit
from residual.bias.model import BiasModel, TareBlocks
from residual.errors import Array, TareError, named_joints

if TYPE_CHECKING:
    from residual.wrench_estimator import WrenchEstimator

SIGMAS = 5.0  # A force must exceed this many standard deviations to count as contact
INTERVALS = 24  # parts of the motion; a contact begins and ends with one of them
IMPLAUSIBLE = (
    32.0  # Times the prior's drift or walk: so does a needle in tissue, no sensor
)

MOST_LEFT = 0.2
MOST_LEFT_BY_A_MASS = 0.6
"""Fraction of the residual, rms, that an explanation may leave over; offsets are
among it."""
LEAST_OFFSETS = (
    3.0  # Residual, in the offset's prior deviations, beyond which a cause is sought
)
NEAR = 0.15  # so near to a factor with a reason a factor is that one
# Rounding of a mean; a way that moves every encoder
STILL_RAD = 1e-9
MOVED_RAD = 0.01
OFFSET_BLOCKS = 10.0
FURTHEST_M = 0.5  # no hand or tool has its centre of mass further from the last joint


def check_free_of_contact(
    fit: FreeMotionFit,
    wrench: "WrenchEstimator",
    contact_force_N: float,
    *,
    is_external: bool,
) -> None:
    """Refuse a tare whose motion was not free, or whose torques are not what they are
    taken for.

    A contact that stands during all of the motion breaks the prior. One that begins or
    ends in it is fitted beside all that the tare fits, as a constant force in its
    likeliest interval and as one that grows until the end: what friction, drift or a
    coarse model explain is no contact.

    The estimator's covariance is overwritten: it must be the caller's own. An external
    residual is one that the robot sends itself. `TareError` with the force seen, or the
    likely reason.
    """
    basis = fit.basis
    blocks = fit.blocks
    seen = [_beyond_prior(basis, blocks, wrench)]
    if seen[0][0] == 0.0:
        at_prior = FreeMotionFit(basis, blocks, learn=False)
        axis = -wrench.kinematics.axis_in_tool
        torque = np.empty(
            (*blocks.q_rad.shape, 3)
        )  # per newton on the tip, along the tool's axes
        for k, position in enumerate(blocks.q_rad):
            wrench.kinematics.update(position)
            torque[k] = wrench.kinematics.jacobian[:3].T
        # Fitted beside it, a contact does not pass for a sensor that drifts or a rough
        # bearing.
        kept, contact = _likeliest_contact(at_prior, torque)
        beside = FreeMotionFit(basis, blocks.part(kept), contact[kept])
        if (
            max(beside.sizes.get(name, 0.0) for name in ("drift", "walk"))
            >= IMPLAUSIBLE
        ):
            beside = FreeMotionFit(basis, blocks.part(kept), contact[kept], learn=False)
        entry = FreeMotionFit(basis, blocks, _growing_contact(at_prior, torque))
        seen = [beside.contact_N(axis), entry.contact_N(axis)]
    touch = [(N, std) for N, std in seen if abs(N) > max(contact_force_N, SIGMAS * std)]
    cause = explain_residual(
        basis, blocks, is_external=is_external, is_refused=bool(touch)
    )
    if touch or cause:
        text = "the sensor reads {:.2f} N along the needle where 0 +/- {:.2f} N is expected in "
        raise TareError(
            Message(
                text.format(*touch[0]) + "free motion: " if touch else "",
                cause or "the needle seems to be in contact, or the payload is wrong",
                ". Tare in free air",
                TareAdvice.IGNORE_CONTACT,
            )
        )


def _beyond_prior(
    basis: BiasModel, blocks: TareBlocks, wrench: "WrenchEstimator"
) -> tuple[float, float]:
    """Axial force that no error of the prior's size makes, and its std; zeros if
    there is none.
    """
    prior = basis.prior_tare
    worst = (0.0, 0.0)
    excess = SIGMAS
    for part in np.array_split(
        np.arange(len(blocks.age_s)), min(INTERVALS, len(blocks.age_s))
    ):
        k = part[len(part) // 2]
        q = blocks.q_rad[k]
        age_s = abs(float(blocks.age_s[k]))
        wrench.set_torque_covariance(
            basis.covariance_Nm2(prior, q, blocks.states[k], age_s)
        )
        seen = wrench.estimate(q, blocks.residual_Nm[part].mean(axis=0))
        if abs(seen.axial) > excess * seen.axial_std:
            worst = (seen.axial, seen.axial_std)
            excess = abs(seen.axial) / seen.axial_std
    return worst


def _likeliest_contact(
    fit: FreeMotionFit, torque: Array
) -> tuple[NDArray[np.bool_], Array]:
    """Torque per newton on the tip, in the likeliest interval of contact, shape
    (blocks, n, 3).

    First come the blocks that say how large its force is: not those in which it begins
    or ends.
    """
    q = fit.blocks.q_rad
    parts = np.array_split(np.arange(len(q)), min(INTERVALS, len(q)))
    within = np.zeros((*torque.shape[:2], len(parts), 3))
    for k, part in enumerate(parts):
        within[part, :, k] = torque[part]
    first, last = _best_interval(*fit.information_on(within.reshape(*q.shape, -1)))
    is_touched = np.isin(np.arange(len(q)), np.concatenate(parts[first:last]))
    kept = np.ones(len(q), dtype=bool)
    for edge in {first, last} - {0, len(parts)}:
        kept[parts[edge - 1]] = kept[parts[edge]] = False
    if not (kept & is_touched).any():  # as short as its edges
        kept[is_touched] = True
    return kept, is_touched[:, None, None] * torque


def _growing_contact(fit: FreeMotionFit, torque: Array) -> Array:
    """The same of a force that grows evenly, from its likeliest start, to a newton
    at the end.
    """
    age_s = fit.blocks.age_s[:, None]
    starts_s = age_s[
        np.linspace(0, len(age_s), INTERVALS, endpoint=False, dtype=int), 0
    ]
    grown = np.maximum(age_s - starts_s, 0.0) / np.maximum(age_s[-1] - starts_s, 1e-9)

    torques = grown[:, None, :, None] * torque[:, :, None]
    known, seen = fit.information_on(torques.reshape(*torque.shape[:2], -1))
    own = [slice(k, k + 3) for k in range(0, len(seen), 3)]
    gains = [
        seen[k] @ np.linalg.lstsq(known[k, k], seen[k], rcond=1e-9)[0] for k in own
    ]
    return torques[:, :, int(np.argmax(gains))]


def _best_interval(information: Array, evidence: Array) -> tuple[int, int]:
    """First part of the likeliest interval and the one after its last, of three
    forces per part.
    """
    count = len(evidence) // 3
    information = information.reshape(count, 3, count, 3)
    evidence = evidence.reshape(count, 3)
    best = (0, count)
    most = 0.0
    for first in range(count):
        for last in range(first + 1, count + 1):
            own = slice(first, last)
            known = information[own, :, own].sum(axis=(0, 2))
            seen = evidence[own].sum(axis=0)
            gain = float(seen @ np.linalg.lstsq(known, seen, rcond=1e-9)[0])
            if gain > most:
                best = (first, last)
                most = gain
    return best


def explain_residual(
    basis: BiasModel, blocks: TareBlocks, *, is_external: bool, is_refused: bool
) -> str:
    """The likely cause of a residual that is not that of free motion; empty if unknown.

    At rest the residual of measured torques is ``g(q) - tau``: g(q) itself if gravity
    was taken out of tau before, 2 g(q) if tau has the other sign, minus g(q) if gravity
    was added twice.

    Only where the tare is refused anyhow, a mass at the flange and missing positions (a
    simulated joint may stand still) are considered; otherwise, the others only in a
    residual far beyond all offsets. ``is_external`` as in `check_free_of_contact`.
    """
    scale = basis.prior.offset_fraction * basis.effort_Nm
    residual = blocks.residual_Nm / scale
    size = _rms(residual)
    if size == 0.0 or not (is_refused or size > LEAST_OFFSETS):
        return ""
    travel_rad = np.ptp(blocks.q_rad, axis=0)
    still = np.flatnonzero(travel_rad < STILL_RAD)
    if is_refused and still.size and travel_rad.max() > MOVED_RAD:
        missing = f"q at {named_joints(still)} never changed, others did: it seems to be missing"
        return f"{missing}, unless the needle is in contact"
    gravity_Nm = np.array([basis.gravity_Nm(q) for q in blocks.q_rad])
    gravity = gravity_Nm / scale
    if gravity.any():
        factor = float(np.vdot(residual, gravity) / np.vdot(gravity, gravity))
        if _rms(residual - factor * gravity) < MOST_LEFT * size:
            for known, reason in _GRAVITY_FACTORS[is_external].items():
                if abs(factor / known - 1.0) < NEAR:
                    seen = f"the residual is {factor:.2f} times gravity's torque g(q): "
                    return Message(seen, reason)
    order = (
        ()
        if is_external
        else _order_of_joints(gravity_Nm - blocks.residual_Nm, gravity_Nm)
    )
    if order:
        pairs = [(i + 1, j + 1) for i, j in enumerate(order) if i != j]
        moved = [f"tau of joint {i} reads as joint {j}'s" for i, j in pairs]
        return f"joints seem to be exchanged: {', '.join(moved)}"
    return _mass_at_flange(basis, blocks, scale) if is_refused else ""


_GRAVITY_FACTORS = {
    False: {
        1.0: Message("tau seems to leave gravity out; ", TareAdvice.COMPENSATE_GRAVITY),
        2.0: Message("tau seems to have the wrong sign; ", TareAdvice.NEGATE_TORQUE),
        -1.0: Message("gravity seems to be added twice; ", TareAdvice.KEEP_GRAVITY),
    },
    True: {
        1.0: Message(
            "it seems to be the measured torque; ", TareAdvice.SEND_MEASURED_TORQUE
        ),
        -1.0: Message(
            "it seems to be the negated measured torque; ",
            TareAdvice.SEND_NEGATED_TORQUE,
        ),
    },
}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _order_of_joints(torque: Array, gravity: Array) -> tuple[int, ...]:
    """Whose gravity each measured torque is, both (m, n); empty if their own, or
    nobody's.
    """
    cost = np.square(torque[:, :, None] - gravity[:, None, :]).mean(axis=0)
    own = float(np.trace(cost))
    # Joints without gravity are alike: of equal orders the one that moves fewest is
    # meant.
    joints, order = linear_sum_assignment(cost + 1e-3 * own * (1.0 - np.eye(len(cost))))
    explains = (order != joints).any() and cost[
        joints, order
    ].sum() < MOST_LEFT**2 * own
    return tuple(order.tolist()) if explains else ()


def _mass_at_flange(basis: BiasModel, blocks: TareBlocks, scale: Array) -> str:
    """A mass behind the last joint that the model has too much of, or lacks; empty if
    it is none.

    Least squares of the residual over its mass and first moments, and an offset per
    joint.
    """
    n = len(scale)
    masses = np.concatenate(
        [basis.regressor(q)[:, -4:] / scale[:, None] for q in blocks.q_rad]
    )
    offsets = np.tile(np.eye(n), (len(blocks.q_rad), 1))
    # An offset is expected within one unit: beyond, it costs as much as so many blocks.
    prior = np.hstack((np.zeros((n, 4)), np.sqrt(OFFSET_BLOCKS) * np.eye(n)))
    residual = (blocks.residual_Nm / scale).ravel()
    columns = np.vstack((np.hstack((masses, offsets)), prior))
    # Directions that a short motion does not show stay at zero.
    found = np.linalg.lstsq(columns, np.append(residual, np.zeros(n)), rcond=1e-3)[0]
    mass = float(found[0])
    is_body = np.linalg.norm(found[1:4]) < FURTHEST_M * abs(found[0])
    if not is_body or _rms(residual - masses @ found[:4]) > MOST_LEFT_BY_A_MASS * _rms(
        residual
    ):
        return ""
    fault = "has about {:.2g} kg too much" if mass > 0.0 else "lacks about {:.2g} kg"
    return (
        f"the robot's model {fault.format(abs(mass))} at the flange: correct hand, tool and "
        "payload in it, unless the needle is in contact"
    )
