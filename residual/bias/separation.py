"""How well a tare told the hysteresis of the torque sensors from friction.

In air both reverse where a stroke turns round, and both read as a torque against the
motion. In tissue they part: friction follows the position and stays as it is while the
needle advances, hysteresis follows the torque, which the force on the needle changes.
So a torque that a stroke leaves undecided becomes an error of the force in tissue.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from residual.bias.model import BiasModel, Tare

SEPARATED_FRACTION = 0.5
"""Deviation of a joint's hysteresis, relative to that before the tare, up to which it
counts as told from friction."""


class JointSeparation(NamedTuple):
    """Hysteresis and Coulomb friction of one joint after a tare [Nm].

    Attributes:
        joint: Its name.
        hysteresis_Nm: Half the width of all loops of the torque sensor together, with
            the sign that it has in the residual; the same holds for friction.
        hysteresis_std_Nm: Standard deviation of that: an error of up to twice as much
            shows where the torque reverses.
        prior_std_Nm: The same before the tare.
        friction_Nm: Coulomb friction of the bearing.
        friction_std_Nm: Standard deviation of the friction.
        correlation: Of the errors of both; near -1 only the sum is known.
    """

    joint: str
    hysteresis_Nm: float
    hysteresis_std_Nm: float
    prior_std_Nm: float
    friction_Nm: float
    friction_std_Nm: float
    correlation: float

    @property
    def is_separated(self) -> bool:
        """Whether the motion told hysteresis from friction."""
        return self.hysteresis_std_Nm <= SEPARATED_FRACTION * self.prior_std_Nm


def separate_causes(
    basis: BiasModel, tare: Tare, joint_names: Sequence[str]
) -> tuple[JointSeparation, ...]:
    """Return how well a tare separates hysteresis and friction, joint by joint.

    The sum of a joint's loops is h = sᵀθ, the sum of its friction elements f = tᵀθ,
    with s and t of zeros and ones; their covariance is that of the parameters θ.

    Args:
        basis: The model that the tare is of.
        tare: The fitted offset.
        joint_names: Of the n joints.

    Returns:
        One for each joint; none for a tare of the kind ``constant``, which has neither.
    """
    if "hysteresis" not in basis.groups:
        return ()
    return tuple(
        _separate_joint(basis, tare, joint, name)
        for joint, name in enumerate(joint_names)
    )


def _separate_joint(
    basis: BiasModel, tare: Tare, joint: int, name: str
) -> JointSeparation:
    loops = _select_sum(basis, "hysteresis", joint, basis.loops)
    elements = _select_sum(basis, "friction", joint, basis.elements)
    sums = np.stack((loops, elements))
    covariance = sums @ tare.covariance @ sums.T
    hysteresis_std_Nm = math.sqrt(covariance[0, 0])
    friction_std_Nm = math.sqrt(covariance[1, 1])
    return JointSeparation(
        joint=name,
        hysteresis_Nm=float(loops @ tare.mean),
        hysteresis_std_Nm=hysteresis_std_Nm,
        prior_std_Nm=math.sqrt(loops @ np.square(basis.std)),
        friction_Nm=float(elements @ tare.mean),
        friction_std_Nm=friction_std_Nm,
        correlation=float(covariance[0, 1] / (hysteresis_std_Nm * friction_std_Nm)),
    )


def _select_sum(basis: BiasModel, group: str, joint: int, count: int) -> Array:
    """Return the ones that sum the first parameters of a joint in a group, shape (m,).

    A group has one parameter per joint, again and again.
    """
    selection = np.zeros(len(basis.std))
    start = basis.groups[group].start + joint
    selection[start : start + count * basis.joints : basis.joints] = 1.0
    return selection


def advise_motion(separations: Sequence[JointSeparation]) -> str:
    """Return what motion would tell more in the next tare; empty if none is needed."""
    undecided = [item.joint for item in separations if not item.is_separated]
    if not undecided:
        return ""
    return (
        f"hysteresis and friction of {', '.join(undecided)} look alike in this motion; "
        "swing the elbow several times, slowly, by about 8 degrees during the stroke, "
        "so that these joints' torques reverse where their positions do not"
    )
