"""Refuses a tare that would hide a contact, and names likely causes of a residual."""

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.fit import FreeMotionFit, JointRows
from residual.bias.model import BiasModel, TareBlocks
from residual.bias.torque_scale import TorqueDiagnosis, diagnose_torques
from residual.errors import TareError
from residual.wrench_estimator import WrenchEstimator

SIGMAS = 5.0
"""A force must exceed this many standard deviations to count as contact."""

INTERVALS = 24
"""Parts of the motion; a contact begins and ends with one of them."""


AxialForce = tuple[float, float]
"""A force along the needle, as a contact in a tare would make it, and its standard
deviation [N]."""


def check_free_of_contact(
    fit: FreeMotionFit,
    wrench: WrenchEstimator,
    contact_force_N: float,
    *,
    is_external: bool,
    adds_gravity: bool,
) -> Steps[TorqueDiagnosis | None]:
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
        adds_gravity: Whether gravity is added to the measured torque.

    Returns:
        What the motion shows of the torques; None of external ones.

    Raises:
        TareError: With the force seen.
    """
    torque = yield from tip_torques(fit.blocks, wrench)
    contacts = yield from find_contacts(fit, torque, wrench, contact_force_N)
    seen = ""
    if contacts:
        seen = (
            f"the sensor reads {contacts[0][0]:.2f} N along the needle where 0 +/- "
            f"{contacts[0][1]:.2f} N is expected in free motion: "
        )
    if is_external:
        if contacts:
            raise TareError(
                f"{seen}the needle is in contact, or these are not the external torques"
            )
        return None
    levers_m = torque @ wrench.kinematics.axis_in_tool
    diagnosis = yield from diagnose_torques(
        fit.basis, fit.blocks, levers_m, adds_gravity=adds_gravity
    )
    if not contacts and not diagnosis.wrong_joints:
        return diagnosis
    text = "units, signs, order, payload or friction are not those of the model"
    if contacts:
        text = f"the needle is in contact, or {text}: tare where the needle is free"
    shown = "; ".join(filter(None, (diagnosis.describe(), text)))
    raise TareError(f"{seen}{shown}", diagnosis=diagnosis)


def find_contacts(
    fit: FreeMotionFit,
    torque: Array,
    wrench: WrenchEstimator,
    contact_force_N: float,
) -> Steps[list[AxialForce]]:
    """Return the forces in a motion that count as contacts, standing ones first.

    Arguments are those of `check_free_of_contact`; the torque is of `tip_torques`.
    """
    standing = yield from largest_standing_force(fit.basis, fit.blocks, wrench)
    forces = [standing]
    if abs(standing[0]) <= SIGMAS * standing[1]:
        forces = yield from find_passing_contacts(fit, torque, wrench)
    return [
        (force_N, std_N)
        for force_N, std_N in forces
        if abs(force_N) > max(contact_force_N, SIGMAS * std_N)
    ]


def largest_standing_force(
    basis: BiasModel, blocks: TareBlocks, wrench: WrenchEstimator
) -> Steps[AxialForce]:
    """Return the axial force that is largest relative to its deviation at the prior.

    The gain of the wrench estimator is overwritten.
    """
    prior = basis.prior_tare
    force: AxialForce = 0.0, 0.0
    excess = 0.0
    for number, interval in enumerate(split_into_intervals(len(blocks.age_s))):
        if number % 2 == 0:
            yield
        k = interval[len(interval) // 2]
        q = blocks.q_rad[k]
        age_s = abs(float(blocks.age_s[k]))
        wrench.set_torque_covariance(
            basis.covariance_Nm2(prior, q, blocks.states[k], age_s)
        )
        estimate = wrench.estimate(q, blocks.residual_Nm[interval].mean(axis=0))
        if abs(estimate.axial) > excess * estimate.axial_std:
            force = estimate.axial, estimate.axial_std
            excess = abs(estimate.axial) / estimate.axial_std
    return force


def find_passing_contacts(
    fit: FreeMotionFit, torque: Array, wrench: WrenchEstimator
) -> Steps[list[AxialForce]]:
    """Return axial forces of the likeliest contacts that begin or end in the motion.

    The first is constant in its interval, the second grows until the end. Fitted beside
    the causes of a tare, a contact does not pass for a sensor that drifts or a rough
    bearing.
    """
    basis = fit.basis
    blocks = fit.blocks
    joint_rows = fit.joint_rows
    at_prior = yield from FreeMotionFit.in_steps(
        basis, blocks, learn=False, joint_rows=joint_rows
    )
    yield
    resistance_axis = -wrench.kinematics.axis_in_tool
    interval = yield from likeliest_interval(at_prior, torque)
    constant = yield from _fit_contact(fit, interval, learn=True)
    sizes = [constant.sizes.get(name, 0.0) for name in ("drift", "walk")]
    # So does a needle in tissue drift or walk, no sensor.
    if max(sizes) >= 32.0:
        constant = yield from _fit_contact(fit, interval, learn=False)
    growing_torque = yield from likeliest_growing_contact(at_prior, torque)
    growing = yield from FreeMotionFit.in_steps(
        basis, blocks, growing_torque, joint_rows=joint_rows
    )
    return [
        constant.contact_N(resistance_axis),
        growing.contact_N(resistance_axis),
    ]


def _fit_contact(
    fit: FreeMotionFit, interval: tuple[NDArray[np.bool_], Array], *, learn: bool
) -> Steps[FreeMotionFit]:
    """Return a fit with a contact of constant force in an interval."""
    is_clear, torque = interval
    joint_rows = [JointRows(own, rows[is_clear]) for own, rows in fit.joint_rows]
    yield
    return (
        yield from FreeMotionFit.in_steps(
            fit.basis,
            fit.blocks.select(is_clear),
            torque[is_clear],
            learn=learn,
            joint_rows=joint_rows,
        )
    )


def tip_torques(blocks: TareBlocks, wrench: WrenchEstimator) -> Steps[Array]:
    """Return the torque per newton on the tip by the tool's axes, shape (m, n, 3)."""
    torque = np.empty((*blocks.q_rad.shape, 3))
    for k, q in enumerate(blocks.q_rad):
        wrench.kinematics.update(q)
        torque[k] = wrench.kinematics.jacobian[:3].T
        if k % 16 == 0:
            yield
    return torque


def split_into_intervals(blocks: int) -> list[NDArray[np.intp]]:
    """Return the indices of so many blocks, in `INTERVALS` parts at most."""
    return np.array_split(np.arange(blocks), min(INTERVALS, blocks))


def likeliest_interval(
    fit: FreeMotionFit, torque: Array
) -> Steps[tuple[NDArray[np.bool_], Array]]:
    """Return the interval in which a constant contact is likeliest.

    Args:
        fit: The fit without a contact.
        torque: Torque per newton on the tip, along three axes, shape (m, n, 3).

    Returns:
        Which blocks show how large its force is, not those in which it begins or ends,
        shape (m,); and the torque, zero outside the interval.
    """
    q = fit.blocks.q_rad
    intervals = split_into_intervals(len(q))
    causes = np.zeros((*torque.shape[:2], len(intervals), 3))
    for k, interval in enumerate(intervals):
        causes[interval, :, k] = torque[interval]
    yield
    information, evidence = yield from fit.information_on(causes.reshape(*q.shape, -1))
    first, end = yield from _best_range(information, evidence)
    touched_blocks = np.concatenate(intervals[first:end])
    is_touched = np.isin(np.arange(len(q)), touched_blocks)
    is_clear = np.ones(len(q), dtype=bool)
    for edge in {first, end} - {0, len(intervals)}:
        is_clear[intervals[edge - 1]] = False
        is_clear[intervals[edge]] = False
    if not (is_clear & is_touched).any():  # as short as its edges
        is_clear[is_touched] = True
    yield
    return is_clear, is_touched[:, None, None] * torque


def likeliest_growing_contact(fit: FreeMotionFit, torque: Array) -> Steps[Array]:
    """Return the torque of a force that grows evenly to a newton at the end.

    It grows from its likeliest start. Torques have the shape (m, n, 3), as of
    `likeliest_interval`.
    """
    age_s = fit.blocks.age_s[:, None]
    starts = np.linspace(0, len(age_s), INTERVALS, endpoint=False, dtype=int)
    starts_s = age_s[starts, 0]
    span_s = np.maximum(age_s[-1] - starts_s, 1e-9)
    growth = np.maximum(age_s - starts_s, 0.0) / span_s
    torques = np.empty((*torque.shape[:2], len(starts), 3))
    for joint in range(torque.shape[1]):
        torques[:, joint] = growth[:, :, None] * torque[:, joint, None]
        yield
    causes = torques.reshape(*torques.shape[:2], -1)
    information, evidence = yield from fit.information_on(causes)
    gains: list[float] = []
    for number in range(len(starts)):
        own = slice(3 * number, 3 * number + 3)
        gains.append(_evidence_gain(information[own, own], evidence[own]))
        if number % 5 == 0:
            yield
    return torques[:, :, int(np.argmax(gains))]


def _evidence_gain(information: Array, evidence: Array) -> float:
    """Return how much likelier a force makes the motion; twice its log likelihood."""
    # Singular values below 1e-9 of the largest are rounding.
    force = np.linalg.lstsq(information, evidence, rcond=1e-9)[0]
    return float(evidence @ force)


def _best_range(information: Array, evidence: Array) -> Steps[tuple[int, int]]:
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
            if end % 5 == 0:
                yield
    return best_range
