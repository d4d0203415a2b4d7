"""What comes out of the virtual sensor, and how far it may be trusted."""

from enum import StrEnum
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


class Status(StrEnum):
    """What the caller should know about one estimate."""

    OK = "ok"
    """A tared estimate of a sound sample."""
    NOT_TARED = "not tared"
    """The offset has not been removed yet: the numbers carry the model's errors."""
    SETTLING = "settling"
    """The filters have just started, or started anew after a gap in time."""
    SKIPPED = "skipped"
    """The sample was bad and was not absorbed: the numbers are those of the last sound one."""


class WrenchEstimate(NamedTuple):
    """Force and torque that the environment exerts on the tool, at a named frame.

    Attributes:
        axial: Axial force [N]: resistance to insertion, positive when tissue pushes back.
        axial_std: Its standard deviation [N].
        force: Force on the tool [N], shape (3,), in the estimator's axes, read-only.
        torque: Torque on the tool about the frame's origin [Nm], shape (3,), read-only; zero in
            the modes that assume none.
        covariance: Of the estimated components, shape (k, k): k = 1 axial force [N^2], 3 force,
            6 force and torque; in the estimator's axes.
        conditioning: Ratio of the largest to the smallest standard deviation over directions in
            the estimated space; infinite where a direction cannot be seen.
        damping_share: Share of each true component that damping removes, 0 to 1, shape (k,).
        residual: External joint torque after offset removal [Nm], shape (n,), read-only.
        status: What the caller should know.
        message: The reason, when the status is not OK.
    """

    axial: float
    axial_std: float
    force: NDArray[np.float64]
    torque: NDArray[np.float64]
    covariance: NDArray[np.float64]
    conditioning: float
    damping_share: NDArray[np.float64]
    residual: NDArray[np.float64]
    status: Status = Status.OK
    message: str = ""
