"""Benchmarks on recordings of real arms and of real tissue.

Reading order: `panda` and `ur10e` (real arms), `liver` and `bovine` (real tissue;
`liver` also reads files for the others).
"""

import numpy as np
import pinocchio as pin

from foundation.arrays import Array


def add_link(
    model: pin.Model, name: str, placement: pin.SE3, axis: Array, link: pin.Inertia
) -> None:
    """Add a revolute joint without limits, and its link, behind the last of a model.

    Args:
        model: The model.
        name: Name of joint and link.
        placement: Frame of the joint at zero in that of the joint before.
        axis: Axis of rotation in the joint's frame, shape (3,), of length 1.
        link: Inertia of the link in the joint's frame.
    """
    unlimited = np.array([np.inf])
    number = model.addJoint(
        model.njoints - 1,
        pin.JointModelRevoluteUnaligned(axis),
        placement,
        name,
        unlimited,
        unlimited,
        -unlimited,
        unlimited,
    )
    model.addJointFrame(number, -1)
    model.inertias[number] = link
