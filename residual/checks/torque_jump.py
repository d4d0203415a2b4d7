"""Detects a torque sensor that jumps: one joint's torque steps beside any tip force.

Torques are compared as means over about half a second, before and after. Beside the
change that a force at the tip makes, a step of one joint is tried for every joint.
Which joint it was can often not be told; what follows from that is decided in
`residual.checks.torque_doubt`. A push on the arm that stays may look the same.
"""

from enum import StrEnum
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from foundation.linear_algebra import dot, multiply_vector
from residual.checks.torque_change import (
    ANY_FORCE_N,
    USUAL_S,
    change_covariance,
    invert_beside_force,
)

BLOCKS_BEFORE = 5
"""Number of blocks that the torque before a jump is the mean of."""

BLOCKS_AFTER = 4
"""The same after it: with the block of the jump between them a jump is seen within half
a second."""

BLOCKS = BLOCKS_BEFORE + 1 + BLOCKS_AFTER
"""Number of blocks that are remembered."""


ROUNDING_S = 1e-6
"""Two times that are nearer to each other are the same."""


class JumpKind(StrEnum):
    """What a look at the torques has shown of a jump."""

    JUMPED = "jumped"
    """A torque has jumped; by how much is being measured."""
    MEASURED = "measured"
    """By how much is known."""
    MISTAKEN = "mistaken"
    """It was no jump: it is back soon, or several joints feel it."""
    BACK = "back"
    """Torques are where they were before the first jump."""


class TorqueSteps(NamedTuple):
    """Step of each of n joints that would explain a change of torque best.

    Attributes:
        ratios: Square of the step over its variance, shape (n,).
        steps_Nm: The steps, shape (n,).
        variances_Nm2: Their variances, shape (n,).
        remaining_Nm: The change less what a tip force explains, shape (n,).
        total: Square of that in units of its covariance: what the ratios are parts of.
    """

    ratios: Array
    steps_Nm: Array
    variances_Nm2: Array
    remaining_Nm: Array
    total: float

    @property
    def is_one(self) -> bool:
        """Whether one step explains the change, and not only a part of it.

        A push on the arm is felt by several joints.
        """
        most = float(self.ratios.max())
        # Beside a tenth of what it explains a step may leave 25 by chance.
        return self.total - most < 25.0 + 0.1 * most

    @property
    def is_jump(self) -> bool:
        """Whether the step is too large to be chance, and for a twist of the needle."""
        # A twisted needle makes less [Nm].
        min_jump_Nm = 0.05
        # Insertions without a jump reach 13 in a minute; noise alone reaches 25 once in
        # ten hours.
        min_ratio = 25.0
        likeliest = int(self.ratios.argmax())
        is_large = abs(self.steps_Nm[likeliest]) > min_jump_Nm
        return self.is_one and is_large and self.ratios[likeliest] > min_ratio


class JumpFinding(NamedTuple):
    """What a look at the torques has shown of a jump, and the steps that explain it.

    Attributes:
        kind: What it has shown.
        steps: Step that each joint may have made.
    """

    kind: JumpKind
    steps: TorqueSteps


@compiled
def fit_steps(
    rows: Matrix, change: Vector, usual: Matrix, force_N: float
) -> TorqueSteps:
    """Fit a step of each joint beside a change of the force at the tip.

    Args:
        rows: Torque per unit of each unknown of the force, shape (k, n), k < n.
        change: Change of the joint torque [Nm], shape (n,).
        usual: Mean product of changes without a jump, the tip force left out [Nm^2],
            shape (n, n).
        force_N: Deviation of the change of the force.
    """
    least_Nm = 3e-3  # Deviation that a change of torque has at least.
    covariance = change_covariance(rows, change, usual, least_Nm)
    precision = invert_beside_force(rows, covariance, force_N)
    weighted = multiply_vector(precision, change)
    joints = len(change)
    ratios = np.zeros(joints)
    steps_Nm = np.zeros(joints)
    variances_Nm2 = np.zeros(joints)
    for j in range(joints):
        variances_Nm2[j] = 1.0 / precision[j, j]
        steps_Nm[j] = weighted[j] * variances_Nm2[j]
        ratios[j] = weighted[j] * steps_Nm[j]
    remaining_Nm = multiply_vector(covariance, weighted)
    return TorqueSteps(
        ratios, steps_Nm, variances_Nm2, remaining_Nm, dot(change, weighted)
    )


class TorqueCourse(NamedTuple):
    """Torque without its offset over the last second; arrays are not written again.

    Attributes:
        blocks_Nm: Its means over blocks, the latest last, shape (10, n).
        has_blocks: Whether they are filled; the first fills all.
        open_Nm: Sum of the torques in the block that is not full, shape (n,).
        open_count: Number of these torques.
        open_s: Length of that block so far.
        usual_Nm2: Mean product of changes without a jump, shape (n, n).
        before_Nm: Torque before the latest jump, shape (n,).
        origin_Nm: Torque before the first jump, shape (n,).
        measured_s: Time for which the latest jump has been measured; 0 for none.
        has_jumped: Whether a torque has jumped and is not back.
    """

    blocks_Nm: Array
    has_blocks: bool
    open_Nm: Array
    open_count: int
    open_s: float
    usual_Nm2: Array
    before_Nm: Array
    origin_Nm: Array
    measured_s: float
    has_jumped: bool

    @classmethod
    def after_tare(cls, error_Nm2: Array) -> "TorqueCourse":
        """Return the course before the first torque.

        Args:
            error_Nm2: Variance of the torque in free air that lasts for a block and
                longer, as the tare has shown it, shape (n,).
        """
        joints = len(error_Nm2)
        still = np.zeros(joints)
        return cls(
            blocks_Nm=np.zeros((BLOCKS, joints)),
            has_blocks=False,
            open_Nm=still,
            open_count=0,
            open_s=0.0,
            usual_Nm2=np.diag(2.0 * error_Nm2),
            before_Nm=still,
            origin_Nm=still,
            measured_s=0.0,
            has_jumped=False,
        )

    def advanced(
        self, rows: Array, torque_Nm: Array, dt_s: float
    ) -> tuple["TorqueCourse", JumpFinding | None]:
        """Return the course after a check, and what that has shown; None for nothing.

        Args:
            rows: As of `fit_steps`, where the tool is.
            torque_Nm: External joint torque after offset removal, shape (n,).
            dt_s: Time since the last check.
        """
        # Five checks, longer than the observer's lag and the noise's memory.
        block_s = 0.1
        course = self._replace(
            open_Nm=self.open_Nm + torque_Nm,
            open_count=self.open_count + 1,
            open_s=self.open_s + dt_s,
        )
        if course.open_s < block_s - ROUNDING_S or len(rows) >= len(torque_Nm):
            return course, None
        return course._with_block()._judged(rows, course.open_s)

    def _with_block(self) -> "TorqueCourse":
        """Return the course with the open block as its latest one."""
        latest_Nm = self.open_Nm / self.open_count
        blocks_Nm = np.vstack((self.blocks_Nm[1:], latest_Nm))
        if not self.has_blocks:
            blocks_Nm = np.tile(latest_Nm, (BLOCKS, 1))
        return self._replace(
            blocks_Nm=blocks_Nm,
            has_blocks=True,
            open_Nm=np.zeros_like(latest_Nm),
            open_count=0,
            open_s=0.0,
        )

    def _judged(
        self, rows: Array, dt_s: float
    ) -> tuple["TorqueCourse", JumpFinding | None]:
        """Return the course after a look at a new block, a time after the last."""
        after_Nm = self.blocks_Nm[-BLOCKS_AFTER:].mean(axis=0)
        if self.measured_s > 0.0:
            return self._measured(rows, after_Nm, dt_s)
        before_Nm = self.blocks_Nm[:BLOCKS_BEFORE].mean(axis=0)
        steps = self._fit_steps(rows, after_Nm - before_Nm)
        if steps.is_jump:
            jumped = self._replace(
                before_Nm=before_Nm,
                origin_Nm=self.origin_Nm if self.has_jumped else before_Nm,
                measured_s=dt_s,
            )
            return jumped, JumpFinding(JumpKind.JUMPED, steps)
        max_usual_ratio = 16.0
        if steps.ratios.max() > max_usual_ratio:
            return self, None
        weight = min(dt_s / USUAL_S, 1.0)
        product_Nm2 = np.outer(steps.remaining_Nm, steps.remaining_Nm)
        usual_Nm2 = self.usual_Nm2 + weight * (product_Nm2 - self.usual_Nm2)
        return self._replace(usual_Nm2=usual_Nm2), None

    def _measured(
        self, rows: Array, after_Nm: Array, dt_s: float
    ) -> tuple["TorqueCourse", JumpFinding | None]:
        """Return the course after a look at a jump that is still being measured."""
        # Until then all blocks after the jump are behind it. A push of a hand lasts
        # half a second to two; within it, the change may also be that of another joint
        # or of the push, and each explanation leaves another force at the tip.
        min_measured_s = 2.0
        max_measured_s = 2.5
        newest_Nm = self.blocks_Nm[-2:].mean(axis=0)
        older_Nm = self.blocks_Nm[-BLOCKS_AFTER:-2].mean(axis=0)
        change_Nm = after_Nm - self.before_Nm
        steps = self._fit_steps(rows, change_Nm)
        if not steps.is_one or self._is_same(rows, newest_Nm - self.before_Nm):
            settled = self._settled(newest_Nm, has_jumped=self.has_jumped)
            return settled, JumpFinding(JumpKind.MISTAKEN, steps)
        if self.has_jumped and self._is_same(rows, newest_Nm - self.origin_Nm):
            settled = self._settled(newest_Nm, has_jumped=False)
            return settled, JumpFinding(JumpKind.BACK, steps)
        stays = self._is_same(rows, newest_Nm - older_Nm)
        enough_s = min_measured_s if stays else max_measured_s
        if self.measured_s < enough_s - ROUNDING_S:
            going_on = self._replace(measured_s=self.measured_s + dt_s)
            return going_on, JumpFinding(JumpKind.JUMPED, steps)
        # A needle's force changes by about so much within the second of the blocks.
        force_N = 1.0
        steps = fit_steps(rows, change_Nm, self.usual_Nm2, force_N)
        settled = self._settled(after_Nm, has_jumped=True)
        return settled, JumpFinding(JumpKind.MEASURED, steps)

    def _is_same(self, rows: Array, change_Nm: Array) -> bool:
        """Return whether a change of torque is no jump."""
        max_ratio = 9.0
        return self._fit_steps(rows, change_Nm).ratios.max() < max_ratio

    def _fit_steps(self, rows: Array, change_Nm: Array) -> TorqueSteps:
        """Return the steps that explain a change beside any force at the tip."""
        return fit_steps(rows, change_Nm, self.usual_Nm2, ANY_FORCE_N)

    def _settled(self, torque_Nm: Array, *, has_jumped: bool) -> "TorqueCourse":
        """Return the course with a torque that all before it is forgotten for."""
        return self._replace(
            measured_s=0.0,
            has_jumped=has_jumped,
            blocks_Nm=np.tile(torque_Nm, (BLOCKS, 1)),
        )
