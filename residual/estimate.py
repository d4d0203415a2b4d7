"""Estimates of the virtual sensor, and how far they may be trusted."""

from enum import IntFlag, StrEnum
from typing import NamedTuple, Self

import numpy as np
from numpy.typing import NDArray

UNSEEN_STD = 1e6
"""Standard deviation [N, Nm] of what is not known at all: no force of an arm comes near
it, and unlike infinity it can be drawn, stored and calculated with."""


class Status(StrEnum):
    """Whether an estimate may be used."""

    OK = "ok"
    """A tared estimate of a valid sample."""
    NOT_TARED = "not tared"
    """The offset has not been removed yet: the numbers carry the model's errors."""
    INITIALIZING = "initializing"
    """The filters have just started, or started anew after a gap in time."""
    REJECTED = "rejected"
    """The sample was bad and was not used: the numbers are those of the last valid
    one."""


class SensorWarning(IntFlag):
    """What may be wrong beyond the standard deviation, or has widened it.

    The first three make a sample `REJECTED`. As text it is the names of what it holds.
    """

    def __str__(self) -> str:
        names = [str(warning.name).lower().replace("_", " ") for warning in self]
        return ", ".join(names) or "none"

    NONE = 0
    SPIKE = 1
    """A signal jumped further than an arm can, and has not stayed there."""
    FROZEN = 2
    """Torques, or positions and velocities, repeat bit for bit although they are noisy
    ones. A sample is rejected if they do so in all joints, for 5 s at most; then, or if
    one torque does so by itself, the warning is all."""
    SATURATED = 4
    """A torque is at the joint's effort limit: the true one may be anything beyond."""
    JOINT_LIMIT = 8
    """A joint is at its position limit: the end stop may carry torque."""
    NEAR_SINGULAR = 16
    """The joints hardly feel a force in some direction that is asked for."""
    MODEL_MISMATCH = 32
    """The joint torques do not fit the assumed contact: a force from the side, a second
    contact, a payload or an arm that is not the model's."""
    TARE_EXPIRED = 64
    """A single time step was so long that the drift it would stand for spoils the tare:
    a long pause, or a clock that was set. It stays until the next tare. While free
    motion is recorded for one: what was recorded before is forgotten."""
    VELOCITY = 128
    """Measured velocities are not the rate of the measured positions: other units,
    another sign, another order of the joints, or far too late. The message names the
    joints."""
    ARM_PUSHED = 256
    """The joint torques have just changed as no force at the tip changes them: a hand
    on the arm? At most 2.5 s; then they count as what the arm feels by itself."""
    TORQUE_JUMP = 512
    """One joint's torque has stepped beside any force at the tip: its sensor has
    jumped, or something pushes the arm and stays. Once it has stayed for 2 s its new
    level counts as the zero; ``axial_std`` holds what is not certain of it. The warning
    stays until the torques are back, or until the next tare."""
    UNEXPLAINED = 1024
    """In free air, since the tare, a force acts on the needle where nothing can: a tool
    gripped anew, a cable, a sensor that has moved. ``axial_std`` holds what was seen.
    It stays until free air shows none, or until the next tare."""
    TOO_FAST = 2048
    """In tissue the needle has advanced further than 0.3 mm within the force's lag: the
    fall at a rupture is lost in what follows it, so ruptures may be missed, and tip
    force and friction divided wrongly, by more than their deviations. It stays for the
    insertion. Advance slower, measure the velocities, or raise
    `SensorConfig.gain_per_s`."""
    TURN = 4096
    """In this sample the angle of a joint has stepped by a whole turn, as drivers
    report it that keep to a circle. That counts as no motion."""


class WrenchEstimate(NamedTuple):
    """Force and torque that the environment exerts on the tool, at a named frame.

    Every number is finite.

    Attributes:
        axial: Axial force [N]: resistance to insertion, positive when tissue pushes
            back. Smoothed like all of the wrench, see
            `wrench_estimator.smoothing_step`.
        axial_std: Its standard deviation [N]; `UNSEEN_STD` where nothing is known.
        lateral: Size of the force across the needle [N], never negative: of noise alone
            it reads about `lateral_std`. Its direction is in ``force``. Zero in mode
            ``axial``, which assumes that there is none.
        lateral_std: Standard deviation of that force in the direction that is known
            least [N]; `UNSEEN_STD` in mode ``axial``.
        force: Force on the tool [N], shape (3,), in the estimator's axes, read-only.
        torque: Torque on the tool about the frame's origin [Nm], shape (3,), read-only;
            zero in the modes that assume none.
        covariance: Of the estimated components, shape (k, k): k = 1 axial force [N^2],
            3 force, 6 force and torque; in the estimator's axes.
        damping_fraction: Fraction of each true component that damping removes, 0 to 1,
            shape (k,).
        axial_unsmoothed: The axial force before it is smoothed [N], for whoever filters
            further.
        residual: External joint torque after offset removal [Nm], shape (n,),
            read-only.
        status: Whether it may be used.
        message: The reason, when the status is not OK or there is a warning, or a
            question: may a signal be missing? Joints count from 1.
        model_mismatch: Normalised residual: joint torque that no wrench of the assumed
            kind explains, rms over what its covariance allows: about 1 when all is
            well; 0 where the mode has as many unknowns as there are joints.
        warnings: What may be wrong beyond the standard deviation, or has widened it.
    """

    axial: float
    axial_std: float
    lateral: float
    lateral_std: float
    force: NDArray[np.float64]
    torque: NDArray[np.float64]
    covariance: NDArray[np.float64]
    damping_fraction: NDArray[np.float64]
    axial_unsmoothed: float
    residual: NDArray[np.float64]
    status: Status = Status.OK
    message: str = ""
    model_mismatch: float = 0.0
    warnings: SensorWarning = SensorWarning.NONE

    @classmethod
    def unknown(cls, joints: int, components: int) -> Self:
        """Return an estimate that knows nothing, for a first sample that is bad."""
        nothing = np.zeros(3)
        covariance = np.diag(np.full(components, UNSEEN_STD**2))
        damping_fraction = np.zeros(components)
        residual = np.zeros(joints)
        for array in (nothing, covariance, damping_fraction, residual):
            array.setflags(write=False)
        return cls(
            axial=0.0,
            axial_std=UNSEEN_STD,
            lateral=0.0,
            lateral_std=UNSEEN_STD,
            force=nothing,
            torque=nothing,
            covariance=covariance,
            damping_fraction=damping_fraction,
            axial_unsmoothed=0.0,
            residual=residual,
        )


class Assessment(NamedTuple):
    """What an estimate says of itself; fields as of `WrenchEstimate`.

    Attributes:
        status: Whether it may be used.
        message: The reason if not, and of warnings.
        model_mismatch: Normalised residual.
        warnings: What may be wrong.
    """

    status: Status = Status.OK
    message: str = ""
    model_mismatch: float = 0.0
    warnings: SensorWarning = SensorWarning.NONE


GOOD = Assessment()
"""Assessment of an estimate of which nothing is wrong."""
