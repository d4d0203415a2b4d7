"""What is doubted of the joint torques since the tare, and the covariance that follows.

Detectors say what they see: torque that no wrench explains
(`residual.checks.monitor`), or a joint's torque that has stepped
(`residual.checks.torque_jump`). Here that becomes doubt: a factor of the tare's
covariance, and a level of the torque that counts as the zero from then on, with a
covariance of its own.
"""

from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from residual.checks.torque_jump import JumpFinding, JumpKind, TorqueSteps


class TorqueDoubt(NamedTuple):
    """Doubt in the zero of n joint torques; its arrays are never written again.

    Attributes:
        widening: Factor of the tare's covariance, by torque that no wrench explains: as
            in least squares, errors seen in directions that no wrench explains are
            likely in the others, too. It lasts as long as that torque.
        step_Nm2: Variance of each torque by a jump that is being measured, shape (n,).
        level_Nm: Torque that counts as the zero since jumps, shape (n,). Like the next
            one it lasts until torques are where they were before the first jump, or
            until the next tare.
        level_Nm2: Its covariance, shape (n, n).
        since_s: Time since the latest jump can have begun, or since the tare.
        jumps: Number of jumps measured.
    """

    widening: float
    step_Nm2: Array
    level_Nm: Array
    level_Nm2: Array
    since_s: float
    jumps: int

    @classmethod
    def after_tare(cls, joints: int) -> "TorqueDoubt":
        """Return no doubt."""
        still = np.zeros(joints)
        return cls(1.0, still, still, np.zeros((joints, joints)), 0.0, 0)

    def is_too_narrow(self, mismatch_squared: float) -> bool:
        """Return whether the covariance is clearly too small for a model mismatch."""
        return _widening(mismatch_squared) > 1.1 * self.widening

    def widened(self, mismatch_squared: float) -> "TorqueDoubt":
        """Return the doubt by a model mismatch squared."""
        return self._replace(widening=_widening(mismatch_squared))

    @property
    def has_jumped(self) -> bool:
        """Whether a torque has jumped and is not back."""
        return bool(self.step_Nm2.any() or self.level_Nm2.any())

    @property
    def jump_Nm2(self) -> Array:
        """Covariance of the torques by jumps, shape (n, n)."""
        return self.level_Nm2 + np.diag(self.step_Nm2)

    def after_finding(
        self, finding: JumpFinding | None, pushed_s: float
    ) -> "TorqueDoubt":
        """Return the doubt after a look at the torques.

        Args:
            finding: What the look has shown; None for nothing.
            pushed_s: Time for which they have changed as by a push on the arm; 0 where
                they have not.
        """
        if finding is None:
            return self
        kind, steps = finding
        still = np.zeros_like(self.step_Nm2)
        if kind is JumpKind.MISTAKEN:
            return self._replace(step_Nm2=still)
        if kind is JumpKind.BACK:
            no_doubt = TorqueDoubt.after_tare(len(still))
            return no_doubt._replace(
                widening=self.widening, since_s=self.since_s, jumps=self.jumps + 1
            )
        if kind is JumpKind.JUMPED:
            since_s = self.since_s
            if not self.step_Nm2.any():
                # A push is seen within the lags of its check, a jump within all blocks.
                since_s = pushed_s + 0.1 if pushed_s else 0.6
            return self._replace(step_Nm2=_bound_steps(steps), since_s=since_s)
        # Each joint may have jumped, as probably as its step explains the change; the
        # covariance of the change is known within a factor of four or so.
        log_odds = (steps.ratios - steps.ratios.max()) / (2.0 * 4.0)
        odds = np.exp(log_odds) / np.exp(log_odds).sum()
        mean_Nm = odds * steps.steps_Nm
        squares_Nm2 = np.square(steps.steps_Nm) + steps.variances_Nm2
        step_Nm2 = np.diag(odds * squares_Nm2) - np.outer(mean_Nm, mean_Nm)
        return self._replace(
            step_Nm2=still,
            level_Nm=self.level_Nm + mean_Nm,
            level_Nm2=self.level_Nm2 + step_Nm2,
            jumps=self.jumps + 1,
        )


def _bound_steps(steps: TorqueSteps) -> Array:
    """Return the variance of each torque while a jump is measured, shape (n,)."""
    sigmas = np.sqrt(steps.ratios)
    # A joint explains the change nearly as well as the likeliest one does: lever arms
    # are known within some percent, and the rest is chance.
    is_plausible = sigmas >= 0.9 * sigmas.max() - 2.5
    # Not all samples are behind the jump yet: it may be larger.
    margin = 1.25
    return np.where(is_plausible, np.square(margin * steps.steps_Nm), 0.0)


def _widening(mismatch_squared: float) -> float:
    # By more than the mismatch shows: four directions that no wrench explains show a
    # variance only within a factor of two.
    return 1.0 + 2.0 * max(0.0, mismatch_squared - 1.0)
