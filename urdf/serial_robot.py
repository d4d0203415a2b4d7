"""A serial arm from numbers instead of a file: real arms are often published as tables."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from urdf.errors import Array, InputError, finite_array, read_only
from urdf.payload import NeedleTool, Payload, require_mass, require_physical
from urdf.robot import STANDARD_GRAVITY_M_S2, TOOL_FRAME, Robot, assemble_robot, rigid_motion


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SerialJoint:
    """One revolute joint and the link behind it.

    A row (alpha, a, d) of a modified Denavit-Hartenberg table is the placement Rx(alpha) Tx(a)
    Tz(d) with axis z; a URDF row (xyz, rpy, axis) is that placement and axis. A placement is that
    of the joint's frame at zero in the previous one (the base for the first); ``pin.SE3`` or a
    homogeneous matrix of shape (4, 4), m.

    Raises:
        InputError: Wrong shape, not finite, no rigid motion, or an axis of length zero.
        InertiaError: No mass, but moments.
    """

    name: str  # of the joint, and of the frame of the link behind it
    placement: pin.SE3 | Array
    axis: Array  # of rotation in the joint's frame, shape (3,); any length but zero
    inertia: Array  # the link's ten parameters, see `urdf.payload`, in the joint's frame

    def __post_init__(self) -> None:
        owner = f"joint {self.name!r}"
        axis = finite_array(self.axis, (3,), f"{owner} axis")
        length = float(np.linalg.norm(axis))
        if length == 0.0:
            raise InputError(f"{owner} axis is zero, expected a direction")
        inertia = finite_array(self.inertia, (10,), f"{owner} inertia")
        require_mass(inertia, owner)
        object.__setattr__(self, "placement", rigid_motion(self.placement, f"{owner} placement"))
        object.__setattr__(self, "axis", read_only(axis / length))
        object.__setattr__(self, "inertia", inertia)


def build_serial_robot(
    joints: Sequence[SerialJoint],
    *,
    name: str = "serial",
    tool_placement: pin.SE3 | ArrayLike | None = None,
    gravity_m_s2: ArrayLike = STANDARD_GRAVITY_M_S2,
    payload: Payload | NeedleTool | None = None,
    check_inertias: bool = True,
) -> Robot:
    """Build a serial arm of revolute joints in memory, without limits.

    Args:
        joints: From base to tip, each name once and none of them ``tool``.
        name: Name of the robot, for messages.
        tool_placement: Frame ``tool`` (tool frame and flange) in the last joint's frame; default:
            the same.
        gravity_m_s2: See `urdf.load_urdf`, as for ``check_inertias`` and the errors.
        payload: What hangs on the frame ``tool``.
        check_inertias: False accepts links no rigid body could be, as identified models have.
    """
    names = [joint.name for joint in joints]
    if not names or len({*names, TOOL_FRAME}) != len(names) + 1:
        raise InputError(
            f"joints must have names, each once and none {TOOL_FRAME!r} or empty list: {names}"
        )
    model = pin.Model()
    model.name = name
    for joint in joints:
        if check_inertias:
            require_physical(joint.inertia, f"link behind joint {joint.name!r}")
        # The joints along a coordinate axis are cheaper in every algorithm.
        aligned = (pin.JointModelRX, pin.JointModelRY, pin.JointModelRZ)
        along = np.flatnonzero(joint.axis == 1.0)
        unaligned = pin.JointModelRevoluteUnaligned(joint.axis.copy())
        kind = aligned[along[0]]() if along.size else unaligned
        inf = np.array([np.inf])
        limits = (inf, inf, -inf, inf)  # effort, velocity, lowest and highest position
        index = model.addJoint(model.njoints - 1, kind, joint.placement, joint.name, *limits)
        model.addJointFrame(index, -1)
        if joint.inertia[0] != 0.0:
            model.inertias[index] = pin.Inertia.FromDynamicParameters(joint.inertia.copy())
    return assemble_robot(
        model,
        flange_frame=names[-1],
        tool_placement=pin.SE3.Identity() if tool_placement is None else tool_placement,
        payload=payload,
        gravity_m_s2=gravity_m_s2,
        check_inertias=check_inertias,
    )
