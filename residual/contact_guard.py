"""Refuses a tare that would hide a contact."""

import numpy as np
from numpy.typing import NDArray

from residual.errors import TareError
from residual.tare import Tare, TareBlocks
from residual.wrench import WrenchEstimator

_SMOOTHING_BLOCKS = 5
_SIGMAS = 5.0


def check_free_of_contact(
    fitted: Tare,
    previous: Tare,
    blocks: TareBlocks,
    wrench: WrenchEstimator,
    contact_force_N: float,
) -> None:
    """Look for contact in the motion a tare was fitted to.

    Two signs count: an axial force that the new fit leaves unexplained (the needle touched
    something on the way), and one that the previous tare, or the prior where there is none, does
    not allow (the needle is in contact all the time). Both must exceed ``contact_force_N`` and
    five standard deviations.

    Args:
        fitted: The new tare.
        previous: The one before it; the prior when there is none.
        blocks: The motion.
        wrench: Reads the axial force from joint torques.
        contact_force_N: Smallest force that counts [N].

    Raises:
        TareError: If there is contact, with the force seen.
    """
    left = _axial(wrench, blocks, fitted.misfit_Nm)
    noise = float(np.sqrt(np.mean(np.diff(left) ** 2) / 2.0)) if len(left) > 1 else 0.0
    width = min(_SMOOTHING_BLOCKS, len(left))
    smooth = np.convolve(left, np.full(width, 1.0 / width), mode="valid")
    worst = float(np.abs(smooth).max())
    if worst > max(contact_force_N, _SIGMAS * noise / np.sqrt(width)):
        raise TareError(
            f"{worst:.2f} N along the needle came and went while taring (limit "
            f"{contact_force_N:g} N): the needle seems to touch something. Tare in free air, or "
            "force=True if you know better"
        )
    q, direction, age = blocks.q_rad[-1], blocks.direction[-1], float(blocks.age_s[-1])
    shift = blocks.residual_Nm[-1] - previous.bias_Nm(q, direction, age)
    wrench.set_torque_covariance(previous.covariance_Nm2(q, direction, abs(age)))
    seen = wrench.estimate(q, shift)
    if abs(seen.axial) > max(contact_force_N, _SIGMAS * seen.axial_std):
        raise TareError(
            f"the sensor reads {seen.axial:.2f} N along the needle, expected 0 +/- "
            f"{seen.axial_std:.2f} N without contact: the needle seems to be in contact, or the "
            "payload is wrong. Tare in free air, or force=True if you know better"
        )


def _axial(
    wrench: WrenchEstimator, blocks: TareBlocks, torque_Nm: NDArray[np.float64]
) -> NDArray[np.float64]:
    rows = zip(blocks.q_rad, torque_Nm, strict=True)
    return np.array([wrench.estimate(q, torque).axial for q, torque in rows])
