"""Refuses a tare that would hide a contact, and names likely causes of a residual."""

from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.optimize import linear_sum_assignment

from foundation.arrays import Array
from foundation.errors import Suspicion
from residual.bias.fit import FreeMotionFit
from residual.bias.model import LINK_PARAMETERS, BiasModel, TareBlocks
from residual.errors import SensorCode, TareError, named_joints

if TYPE_CHECKING:
    from residual.wrench_estimator import WrenchEstimator

SIGMAS = 5.0
"""A force must exceed this many standard deviations to count as contact."""

INTERVALS = 24
"""Parts of the motion; a contact begins and ends with one of them."""

IMPLAUSIBLE_SIZE = 32.0
"""Drift or walk of so many times the prior's: so does a needle in tissue, no sensor."""

MAX_REMAINING_RATIO = 0.2
"""Fraction of the residual, rms, that an explanation may leave over; offsets are among
it."""

MAX_REMAINING_RATIO_OF_MASS = 0.6
"""The same for a mass at the flange, which is tried last and only where the tare is
refused anyhow."""

MIN_OFFSETS = 3.0
"""Residual, in prior deviations of the offset, beyond which a cause is sought."""

FACTOR_TOLERANCE = 0.15
"""Relative distance within which a factor is one with a known reason."""

STILL_RAD = 1e-9
"""Travel of a position that does not change: the rounding of a mean."""

MOVED_RAD = 0.01
"""Travel of a joint that moves every encoder."""

SWAP_COST_RATIO = 1e-3
"""Cost of exchanging a joint, relative to that of no exchange: of equal orders the one
that moves fewest joints is meant, since joints without gravity are alike."""

OFFSET_BLOCKS = 10.0
"""Weight of the prior of an offset, in blocks: beyond one unit it costs as much as so
many blocks."""

SHORT_MOTION_RATIO = 1e-3
"""Singular values below this fraction of the largest are directions that a short motion
does not show: they stay at zero."""

EVIDENCE_RATIO = 1e-9
"""The same where the information of forces is inverted: only its rounding."""

MIN_SPAN_S = 1e-9
"""Shortest time in which a force grows."""

MAX_COM_M = 0.5
"""No hand or tool has its centre of mass further from the last joint."""


class AxialForce(NamedTuple):
    """A force along the needle, as a contact in a tare would make it.

    Attributes:
        force_N: The force.
        std_N: Its standard deviation.
    """

    force_N: float
    std_N: float


NO_FORCE = AxialForce(0.0, 0.0)
"""No contact is seen."""


class ContactInterval(NamedTuple):
    """The likeliest interval of a contact during a recorded motion of m blocks.

    Attributes:
        is_clear: Which blocks show how large its force is: not those in which it begins
            or ends, shape (m,).
        torque: Torque per newton on the tip in it, zero outside, shape (m, n, 3).
    """

    is_clear: NDArray[np.bool_]
    torque: Array


def check_free_of_contact(
    fit: FreeMotionFit,
    wrench: "WrenchEstimator",
    contact_force_N: float,
    *,
    is_external: bool,
) -> None:
    """Refuse a tare whose motion was not free, or whose torques are of another kind.

    A contact that stands during all of the motion breaks the prior. One that begins or
    ends in it is fitted beside all that the tare fits, as a constant force in its
    likeliest interval and as one that grows until the end: what friction, drift or a
    coarse model explain is no contact.

    Args:
        fit: The tare.
        wrench: The caller's own estimator: its covariance and gain are overwritten.
        contact_force_N: Smallest axial force that is a contact.
        is_external: Whether the robot sends the external torque itself.

    Raises:
        TareError: With the force seen, or the likely reason.
    """
    basis = fit.basis
    blocks = fit.blocks
    forces = [find_standing_contact(basis, blocks, wrench)]
    if forces[0] == NO_FORCE:
        forces = find_passing_contacts(basis, blocks, wrench)
    contacts = [
        force
        for force in forces
        if abs(force.force_N) > max(contact_force_N, SIGMAS * force.std_N)
    ]
    cause = explain_residual(
        basis, blocks, is_external=is_external, is_refused=bool(contacts)
    )
    if not contacts and not cause:
        return
    reading = ""
    if contacts:
        reading = (
            f"the sensor reads {contacts[0].force_N:.2f} N along the needle where 0 +/-"
            f" {contacts[0].std_N:.2f} N is expected in free motion: "
        )
    cause = cause or Suspicion(
        "the needle seems to be in contact, or the payload is wrong",
        SensorCode.CONTACT,
    )
    raise TareError(f"{reading}{cause.text}", cause.code)


def find_standing_contact(
    basis: BiasModel, blocks: TareBlocks, wrench: "WrenchEstimator"
) -> AxialForce:
    """Return the axial force that no error of the prior's size makes, if there is one.

    The gain of the wrench estimator is overwritten.
    """
    prior = basis.prior_tare
    force = NO_FORCE
    excess = SIGMAS
    for interval in split_into_intervals(len(blocks.age_s)):
        k = interval[len(interval) // 2]
        q = blocks.q_rad[k]
        age_s = abs(float(blocks.age_s[k]))
        wrench.set_torque_covariance(
            basis.covariance_Nm2(prior, q, blocks.states[k], age_s)
        )
        estimate = wrench.estimate(q, blocks.residual_Nm[interval].mean(axis=0))
        if abs(estimate.axial) > excess * estimate.axial_std:
            force = AxialForce(estimate.axial, estimate.axial_std)
            excess = abs(estimate.axial) / estimate.axial_std
    return force


def find_passing_contacts(
    basis: BiasModel, blocks: TareBlocks, wrench: "WrenchEstimator"
) -> list[AxialForce]:
    """Return axial forces of the likeliest contacts that begin or end in the motion.

    The first is constant in its interval, the second grows until the end. Fitted beside
    the causes of a tare, a contact does not pass for a sensor that drifts or a rough
    bearing.
    """
    at_prior = FreeMotionFit(basis, blocks, learn=False)
    resistance_axis = -wrench.kinematics.axis_in_tool
    torque = tip_torques(blocks, wrench)
    interval = likeliest_interval(at_prior, torque)
    clear_blocks = blocks.select(interval.is_clear)
    clear_torque = interval.torque[interval.is_clear]
    constant = FreeMotionFit(basis, clear_blocks, clear_torque)
    sizes = [constant.sizes.get(name, 0.0) for name in ("drift", "walk")]
    if max(sizes) >= IMPLAUSIBLE_SIZE:
        constant = FreeMotionFit(basis, clear_blocks, clear_torque, learn=False)
    growing = FreeMotionFit(basis, blocks, likeliest_growing_contact(at_prior, torque))
    return [
        AxialForce(*constant.contact_N(resistance_axis)),
        AxialForce(*growing.contact_N(resistance_axis)),
    ]


def tip_torques(blocks: TareBlocks, wrench: "WrenchEstimator") -> Array:
    """Return the torque per newton on the tip by the tool's axes, shape (m, n, 3)."""
    torque = np.empty((*blocks.q_rad.shape, 3))
    for k, q in enumerate(blocks.q_rad):
        wrench.kinematics.update(q)
        torque[k] = wrench.kinematics.jacobian[:3].T
    return torque


def split_into_intervals(blocks: int) -> list[NDArray[np.intp]]:
    """Return the indices of so many blocks, in `INTERVALS` parts at most."""
    return np.array_split(np.arange(blocks), min(INTERVALS, blocks))


def likeliest_interval(fit: FreeMotionFit, torque: Array) -> ContactInterval:
    """Return the interval in which a constant contact is likeliest.

    The torque per newton on the tip, along three axes, has the shape (m, n, 3).
    """
    q = fit.blocks.q_rad
    intervals = split_into_intervals(len(q))
    causes = np.zeros((*torque.shape[:2], len(intervals), 3))
    for k, interval in enumerate(intervals):
        causes[interval, :, k] = torque[interval]
    information, evidence = fit.information_on(causes.reshape(*q.shape, -1))
    first, end = _best_range(information, evidence)
    touched_blocks = np.concatenate(intervals[first:end])
    is_touched = np.isin(np.arange(len(q)), touched_blocks)
    is_clear = np.ones(len(q), dtype=bool)
    for edge in {first, end} - {0, len(intervals)}:
        is_clear[intervals[edge - 1]] = False
        is_clear[intervals[edge]] = False
    if not (is_clear & is_touched).any():  # as short as its edges
        is_clear[is_touched] = True
    return ContactInterval(is_clear, is_touched[:, None, None] * torque)


def likeliest_growing_contact(fit: FreeMotionFit, torque: Array) -> Array:
    """Return the torque of a force that grows evenly to a newton at the end.

    It grows from its likeliest start. Torques have the shape (m, n, 3), as of
    `likeliest_interval`.
    """
    age_s = fit.blocks.age_s[:, None]
    starts = np.linspace(0, len(age_s), INTERVALS, endpoint=False, dtype=int)
    starts_s = age_s[starts, 0]
    span_s = np.maximum(age_s[-1] - starts_s, MIN_SPAN_S)
    growth = np.maximum(age_s - starts_s, 0.0) / span_s
    torques = growth[:, None, :, None] * torque[:, :, None]
    causes = torques.reshape(*torques.shape[:2], -1)
    information, evidence = fit.information_on(causes)
    gains = []
    for k in range(0, len(evidence), 3):
        own = slice(k, k + 3)
        gains.append(_evidence_gain(information[own, own], evidence[own]))
    return torques[:, :, int(np.argmax(gains))]


def _evidence_gain(information: Array, evidence: Array) -> float:
    """Return how much likelier a force makes the motion; twice its log likelihood."""
    force = np.linalg.lstsq(information, evidence, rcond=EVIDENCE_RATIO)[0]
    return float(evidence @ force)


def _best_range(information: Array, evidence: Array) -> tuple[int, int]:
    """Return the first of the likeliest intervals, and the one after the last of them.

    Information and evidence are of three force components in every interval.
    """
    count = len(evidence) // 3
    information = information.reshape(count, 3, count, 3)
    evidence = evidence.reshape(count, 3)
    best_range = (0, count)
    best_gain = 0.0
    for first in range(count):
        for end in range(first + 1, count + 1):
            own = slice(first, end)
            gain = _evidence_gain(
                information[own, :, own].sum(axis=(0, 2)), evidence[own].sum(axis=0)
            )
            if gain > best_gain:
                best_range = (first, end)
                best_gain = gain
    return best_range


def explain_residual(
    basis: BiasModel, blocks: TareBlocks, *, is_external: bool, is_refused: bool
) -> Suspicion | None:
    """Return the likely cause of a residual that is not that of free motion, or None.

    At rest the residual of measured torques is ``g(q) - tau``: g(q) itself if gravity
    was taken out of tau before, 2 g(q) if tau has the other sign, minus g(q) if gravity
    was added twice.

    Args:
        basis: Model of the residual of free motion.
        blocks: The motion.
        is_external: As of `check_free_of_contact`.
        is_refused: Whether the tare is refused anyhow. Only then a mass at the flange
            and missing positions (a simulated joint may stand still) are considered;
            otherwise, the others only in a residual far beyond all offsets.
    """
    scale = basis.prior.offset_fraction * basis.effort_Nm
    size = _rms(blocks.residual_Nm / scale)
    if size == 0.0 or not (is_refused or size > MIN_OFFSETS):
        return None
    if is_refused and (missing := _missing_positions(blocks)):
        return missing
    gravity_Nm = np.array([basis.gravity_Nm(q) for q in blocks.q_rad])
    treatment = _gravity_treatment(
        blocks.residual_Nm / scale, gravity_Nm / scale, is_external=is_external
    )
    if treatment:
        return treatment
    if not is_external:
        exchange = _exchanged_joints(gravity_Nm - blocks.residual_Nm, gravity_Nm)
        if exchange:
            return exchange
    return _mass_at_flange(basis, blocks, scale) if is_refused else None


_GRAVITY_FACTORS = {
    False: {
        1.0: Suspicion("tau seems to leave gravity out", SensorCode.GRAVITY_MISSING),
        2.0: Suspicion("tau seems to have the wrong sign", SensorCode.TORQUE_SIGN),
        -1.0: Suspicion("gravity seems to be added twice", SensorCode.GRAVITY_TWICE),
    },
    True: {
        1.0: Suspicion("it seems to be the measured torque", SensorCode.TORQUE_KIND),
        -1.0: Suspicion(
            "it seems to be the negated measured torque", SensorCode.TORQUE_KIND_SIGN
        ),
    },
}


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(np.square(values))))


def _missing_positions(blocks: TareBlocks) -> Suspicion | None:
    """Return which positions never changed while others did; None if there are none."""
    travel_rad = np.ptp(blocks.q_rad, axis=0)
    still_joints = np.flatnonzero(travel_rad < STILL_RAD)
    if not still_joints.size or travel_rad.max() <= MOVED_RAD:
        return None
    return Suspicion(
        f"q at {named_joints(still_joints)} never changed, others did: it seems to be "
        "missing, unless the needle is in contact",
        SensorCode.POSITIONS,
    )


def _gravity_treatment(
    residual: Array, gravity: Array, *, is_external: bool
) -> Suspicion | None:
    """Return how gravity was treated if the residual is a multiple of it, else None.

    Both have the shape (m, n), relative to what an offset may be.
    """
    if not gravity.any():
        return None
    factor = float(np.vdot(residual, gravity) / np.vdot(gravity, gravity))
    if _rms(residual - factor * gravity) >= MAX_REMAINING_RATIO * _rms(residual):
        return None
    for known_factor, reason in _GRAVITY_FACTORS[is_external].items():
        if abs(factor / known_factor - 1.0) < FACTOR_TOLERANCE:
            size = f"the residual is {factor:.2f} times gravity's torque g(q)"
            return reason._replace(text=f"{size}: {reason.text}")
    return None


def _exchanged_joints(torque: Array, gravity: Array) -> Suspicion | None:
    """Return which joints seem to be exchanged; None if none."""
    order = _order_of_joints(torque, gravity)
    exchanges = [
        f"tau of joint {joint + 1} reads as joint {other + 1}'s"
        for joint, other in enumerate(order)
        if joint != other
    ]
    if not exchanges:
        return None
    text = f"joints seem to be exchanged: {', '.join(exchanges)}"
    return Suspicion(text, SensorCode.JOINT_ORDER)


def _order_of_joints(torque: Array, gravity: Array) -> tuple[int, ...]:
    """Return whose gravity each measured torque is, both of shape (m, n).

    It is empty if each is its own joint's, or nobody's.
    """
    cost = np.square(torque[:, :, None] - gravity[:, None, :]).mean(axis=0)
    own_cost = float(np.trace(cost))
    swap_cost = SWAP_COST_RATIO * own_cost * (1.0 - np.eye(len(cost)))
    joints, order = linear_sum_assignment(cost + swap_cost)
    is_exchanged = (order != joints).any()
    is_explained = cost[joints, order].sum() < MAX_REMAINING_RATIO**2 * own_cost
    return tuple(order.tolist()) if is_exchanged and is_explained else ()


def _mass_at_flange(
    basis: BiasModel, blocks: TareBlocks, scale: Array
) -> Suspicion | None:
    """Return a mass behind the last joint that the model has too much of, or lacks.

    None if there is none. Least squares of the residual over its mass and first
    moments, and an offset per joint.
    """
    joints = len(scale)
    mass_columns = np.concatenate(
        [
            basis.regressor(q)[:, -LINK_PARAMETERS:] / scale[:, None]
            for q in blocks.q_rad
        ]
    )
    offset_columns = np.tile(np.eye(joints), (len(blocks.q_rad), 1))
    # An offset is expected within one unit.
    prior_rows = np.hstack(
        (np.zeros((joints, LINK_PARAMETERS)), np.sqrt(OFFSET_BLOCKS) * np.eye(joints))
    )
    residual = (blocks.residual_Nm / scale).ravel()
    columns = np.vstack((np.hstack((mass_columns, offset_columns)), prior_rows))
    parameters = np.linalg.lstsq(
        columns, np.append(residual, np.zeros(joints)), rcond=SHORT_MOTION_RATIO
    )[0]
    mass_kg = float(parameters[0])
    moment = np.linalg.norm(parameters[1:LINK_PARAMETERS])
    remaining = residual - mass_columns @ parameters[:LINK_PARAMETERS]
    is_body = moment < MAX_COM_M * abs(mass_kg)
    is_explained = _rms(remaining) <= MAX_REMAINING_RATIO_OF_MASS * _rms(residual)
    if not (is_body and is_explained):
        return None
    fault = "has about {:.2g} kg too much" if mass_kg > 0.0 else "lacks about {:.2g} kg"
    return Suspicion(
        f"the robot's model {fault.format(abs(mass_kg))} at the flange, unless the "
        "needle is in contact",
        SensorCode.PAYLOAD,
    )
