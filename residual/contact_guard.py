"""Refuses a tare that would hide a contact."""

import numpy as np

from residual.errors import TareError
from residual.tare import Tare, TareBlocks
from residual.tare_fit import fit_tare
from residual.wrench import WrenchEstimator

SIGMAS = 5.0
"""A force must exceed this many standard deviations to count as contact."""
SPLITS = (0.1, 0.2, 0.35, 0.55, 0.75, 0.9)
"""Shares of the motion from which the rest is foretold."""
SMOOTHING_BLOCKS = 5
"""A contact lasts: forces are averaged over this many blocks."""


def check_free_of_contact(
    prior: Tare, blocks: TareBlocks, wrench: WrenchEstimator, contact_force_N: float
) -> None:
    """Look for contact in the motion that a tare is to be fitted to.

    Free motion foretells itself: a tare fitted to its beginning must hold for the rest within its
    own standard deviation. A needle that touches something on the way breaks that; one that is in
    contact all the time breaks the prior. The measure is the arm's own misfit, so a coarse model
    does not pass for contact.

    Args:
        prior: What is known before data, see `residual.tare.prior_tare`.
        blocks: The motion.
        wrench: Reads the axial force from joint torques; its covariance is overwritten, so it must
            be the guard's own.
        contact_force_N: Smallest force that counts [N].

    Raises:
        TareError: If there is contact, with the force seen.
    """
    force, doubt = _worst_excess(prior, blocks, wrench, contact_force_N)
    for share in SPLITS:
        if force == 0.0 and (known := round(share * len(blocks.age_s))) >= SMOOTHING_BLOCKS:
            early, late = blocks.split(known)
            force, doubt = _worst_excess(
                fit_tare(prior.basis, early), late, wrench, contact_force_N
            )
    if force != 0.0:
        raise TareError(
            f"the sensor reads {force:.2f} N along the needle where 0 +/- {doubt:.2f} N is "
            "expected in free motion: the needle seems to be in contact, or the payload is wrong. "
            "Tare in free air, or force=True if you know better"
        )


def _worst_excess(
    known: Tare, blocks: TareBlocks, wrench: WrenchEstimator, contact_force_N: float
) -> tuple[float, float]:
    """Largest axial force beyond what a tare allows, with its standard deviation; zeros if none."""
    forces, doubts = [], []
    for q, trend, age, residual in zip(
        blocks.q_rad, blocks.trend, blocks.age_s, blocks.residual_Nm, strict=True
    ):
        wrench.set_torque_covariance(known.covariance_Nm2(q, trend, abs(float(age))))
        seen = wrench.estimate(q, residual - known.bias_Nm(q, trend, float(age)))
        forces.append(seen.axial)
        doubts.append(seen.axial_std)
    width = min(SMOOTHING_BLOCKS, len(forces))
    average = np.full(width, 1.0 / width)
    force = np.convolve(forces, average, mode="valid")
    doubt = np.convolve(doubts, average, mode="valid")
    excess = np.abs(force) - np.maximum(contact_force_N, SIGMAS * doubt)
    worst = int(np.argmax(excess))
    return (float(force[worst]), float(doubt[worst])) if excess[worst] > 0.0 else (0.0, 0.0)
