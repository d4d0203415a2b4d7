"""What a free motion shows of the torques: their scale, and a missing mass."""

import math
from dataclasses import dataclass

import numpy as np

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.torque_fit import START_OCTAVES, TorqueFit
from residual.errors import named_joints

SIGMAS = 3.0
"""What is so many of its own deviations from what was expected, deviates."""

MAX_SCALE_STD = 0.25
"""A factor that is known less well than this, relative to itself, is none."""

MAX_SCALE_ERROR = 0.4
"""A joint's torque that differs by more than this part of the model's is of another
kind: no sensor is so far off."""

MIN_LEVER_M = 5e-3
"""A joint with less hardly feels a force along the needle."""

PAYLOAD_STD = np.array([2.0, 0.3, 0.3, 0.3])
"""Prior deviations of a payload that was left out: mass [kg], first moments [kg m]."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueDiagnosis:
    """What a free motion shows of the torques.

    Attributes:
        scale: Measured torque over that of the model, all joints together.
        scale_std: Its standard deviation; links, offsets and friction are unknown.
        joint_scale: The same of each joint, shape (n,).
        joint_scale_std: Its standard deviation, shape (n,).
        axial_lever_m: Largest torque per newton along the needle of each joint in the
            motion, shape (n,).
        payload_kg: Mass that the model lacks behind the last joint.
        payload_std_kg: Its standard deviation.
    """

    scale: float
    scale_std: float
    joint_scale: Array
    joint_scale_std: Array
    axial_lever_m: Array
    payload_kg: float
    payload_std_kg: float

    @property
    def scale_deviates(self) -> bool:
        """Whether the scale is not 1 by more than three deviations."""
        return abs(self.scale - 1.0) > SIGMAS * self.scale_std

    @property
    def is_scale_known(self) -> bool:
        """Whether the motion shows the scale."""
        return self.scale_std < MAX_SCALE_STD

    @property
    def deviating_joints(self) -> list[int]:
        """Indices of joints whose scale is not 1 by more than three deviations."""
        error = np.abs(self.joint_scale - 1.0)
        return np.flatnonzero(error > SIGMAS * self.joint_scale_std).tolist()

    @property
    def wrong_joints(self) -> list[int]:
        """Indices of joints whose torque is surely of another kind than the model's."""
        error = np.abs(self.joint_scale - 1.0)
        limit = np.maximum(SIGMAS * self.joint_scale_std, MAX_SCALE_ERROR)
        return np.flatnonzero(error > limit).tolist()

    @property
    def scale_doubt(self) -> float:
        """Standard deviation of the scale of a force, relative to the force."""
        # Where the motion shows nothing of it: a torque sensor's scale is within 10 %.
        doubt = 1.0 / math.hypot(1.0 / self.scale_std, 1.0 / 0.1)
        if self.scale_deviates:
            doubt = math.hypot(doubt, self.scale - 1.0)
        # The joint of a wrong scale may be the one that feels the force.
        wrong = [
            k for k in self.deviating_joints if self.axial_lever_m[k] > MIN_LEVER_M
        ]
        return max([doubt, *np.abs(self.joint_scale[wrong] - 1.0).tolist()])

    @property
    def unchecked_joints(self) -> list[int]:
        """Indices of joints whose torque shows neither sign nor scale."""
        return np.flatnonzero(self.joint_scale_std > 0.5).tolist()

    def describe_unchecked(self) -> str:
        """Return what the motion cannot show; empty if it shows every joint."""
        has_lever = self.axial_lever_m > MIN_LEVER_M
        texts: list[str] = []
        for sees_axial, reason in ((True, ""), (False, " and no axial lever")):
            joints = [k for k in self.unchecked_joints if has_lever[k] == sees_axial]
            if joints:
                reason = f"too little gravity{reason} in this motion"
                texts.append(f"{named_joints(joints)} not checked ({reason})")
        return ", ".join(texts)

    def describe_torques(self) -> str:
        """Return in one line what the torques are beside those of the model."""
        text = ""
        if self.is_scale_known:
            text = (
                f"all together tau is {self.scale:.3g} +/- {self.scale_std:.2g} times "
                "what the model expects"
            )
        one_joint = self.describe_one_joint()
        if (joints := self.wrong_joints) and not one_joint:
            scales = ", ".join(f"{one:.2g}" for one in self.joint_scale[joints])
            one_joint = f"{named_joints(joints)}: {scales} times"
        return "; ".join(filter(None, (text, one_joint)))

    def describe_one_joint(self) -> str:
        """Return the scale of the one joint that deviates, in words.

        It is empty where none does, or several do: they may have a common cause.
        """
        if len(self.deviating_joints) != 1:
            return ""
        (joint,) = self.deviating_joints
        return (
            f"tau of {named_joints([joint])} is {self.joint_scale[joint]:.3g} +/- "
            f"{self.joint_scale_std[joint]:.2g} times what the model expects"
        )


def diagnose_torques(fit: TorqueFit, axial_lever_m: Array) -> Steps[TorqueDiagnosis]:
    """Return what a motion shows of the torques.

    Args:
        fit: Of the motion.
        axial_lever_m: As of `TorqueDiagnosis`.
    """
    model_Nm = fit.model_Nm[:, :, None]
    joints = len(axial_lever_m)
    common = yield from fit.evaluate(model_Nm, np.ones(1))
    each = yield from fit.evaluate(model_Nm * np.eye(joints), np.ones(joints))
    load = yield from fit.evaluate(fit.payload_columns, PAYLOAD_STD, START_OCTAVES)
    return TorqueDiagnosis(
        scale=1.0 - float(common.extra[0]),
        scale_std=float(common.extra_std[0]),
        joint_scale=1.0 - each.extra,
        joint_scale_std=each.extra_std,
        axial_lever_m=axial_lever_m,
        payload_kg=-float(load.extra[0]),
        payload_std_kg=float(load.extra_std[0]),
    )
