"""Detects changes of the joint torques that no force at the tip makes.

Torques of the present are compared with those of half a second ago. Beside the change
that a force at the tip makes, a step of one joint is tried for every joint. Where one
step explains the change, that joint's sensor has jumped, or something pushes the arm
and stays; where none does, a hand pushes the arm. A jump that stays becomes a level
that counts as the zero, with a covariance of its own, since which joint it was can
often not be told.
"""

import math
from dataclasses import dataclass
from typing import Any, NamedTuple, Self

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled, compiled_inside
from foundation.linear_algebra import (
    dot,
    multiply,
    multiply_transposed,
    multiply_vector,
)
from residual.checks.input import ROUNDING_S

invert: Any = np.linalg.inv
"""The inverse, whose annotations do not say that it keeps the type of numbers."""

ANY_FORCE_N = 1e4
"""Deviation of a force at the tip of which nothing is known."""

BLOCKS_BEFORE = 5
"""Number of blocks that the torque before a change is the mean of."""

BLOCKS_AFTER = 4
"""Number of blocks after them, of which the torque after a change is the mean."""


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


@compiled_inside
def invert_beside_force(rows: Matrix, covariance: Matrix, force_N: float) -> Array:
    """Return the inverse covariance of torque that a force at the tip adds to.

    Args:
        rows: Torque per unit of each unknown of the force, shape (k, n).
        covariance: Without the force [Nm^2], shape (n, n).
        force_N: Deviation of the force.
    """
    # Both are symmetric; turned, what LAPACK returns is contiguous in rows.
    precision = invert(covariance).T
    weighted = multiply(rows, precision)
    information = multiply_transposed(weighted, rows)
    for i in range(len(rows)):
        information[i, i] += 1.0 / force_N**2
    share = multiply(invert(information).T, weighted)
    joints = len(covariance)
    for i in range(joints):
        for j in range(joints):
            for k in range(len(rows)):
                precision[i, j] -= weighted[k, i] * share[k, j]
    return precision


@compiled
def fit_steps(
    rows: Matrix, change: Vector, usual: Matrix, force_N: float
) -> TorqueSteps:
    """Fit a step of each joint beside a change of the force at the tip.

    Args:
        rows: Torque per unit of each unknown of the force, shape (k, n), k < n.
        change: Change of the joint torque [Nm], shape (n,).
        usual: Mean product of usual changes, the tip force left out [Nm^2], shape (n,
            n).
        force_N: Deviation of the change of the force.
    """
    least_Nm = 3e-3  # Deviation that a change of torque has at least.
    # The mean product is learnt from few samples: it is shrunk towards its diagonal.
    diagonal_weight = 0.2
    # Lever arms are known within 2 % of the largest torque that a force explains.
    lever_error = 0.02
    joints = len(change)
    covariance = (1.0 - diagonal_weight) * usual
    for i in range(joints):
        covariance[i, i] = usual[i, i] + least_Nm**2
    precision = invert_beside_force(rows, covariance, ANY_FORCE_N)
    remaining = multiply_vector(covariance, multiply_vector(precision, change))
    largest_Nm = np.abs(change - remaining).max()
    for i in range(joints):
        covariance[i, i] += (lever_error * largest_Nm) ** 2
    precision = invert_beside_force(rows, covariance, force_N)
    weighted = multiply_vector(precision, change)
    variances_Nm2 = 1.0 / np.diag(precision)
    steps_Nm = weighted * variances_Nm2
    remaining_Nm = multiply_vector(covariance, weighted)
    return TorqueSteps(
        weighted * steps_Nm,
        steps_Nm,
        variances_Nm2,
        remaining_Nm,
        dot(change, weighted),
    )


@dataclass(slots=True, kw_only=True, eq=False)
class TorqueWatch:
    """Torques without their offset over the last second, and what is doubted of them.

    Attributes:
        blocks_Nm: Means over blocks of a tenth of a second, the latest last, shape (9,
            n).
        present_Nm: Torque of the present, smoothed, shape (n,).
        usual_Nm2: Mean product of changes that are usual, the force at the tip left
            out, shape (n, n).
        with_force_Nm2: The same with it.
        before_Nm: Torque before the latest unusual change, shape (n,).
        origin_Nm: Torque before the first jump, shape (n,).
        step_Nm2: Variance of each torque by a jump that is being measured, shape (n,).
        level_Nm: Torque that counts as the zero since jumps, shape (n,). Like the next
            one it lasts until torques are where they were before the first jump.
        level_Nm2: Its covariance, shape (n, n).
        open_Nm: Sum of the torques in the block that is not full, shape (n,).
        has_blocks: Whether a block has been full; the first one stands for all before.
        open_count: Number of these torques.
        open_s: Length of that block so far.
        learned_s: Time over which the usual changes were learned.
        changed_s: Time since an unusual change was seen; 0 for none.
        is_pushed: Whether it is as large as that of a push on the arm.
        since_s: Time since the latest jump can have begun, or since the tare.
        jumps: Number of jumps measured.
    """

    blocks_Nm: Array
    present_Nm: Array
    usual_Nm2: Array
    with_force_Nm2: Array
    before_Nm: Array
    origin_Nm: Array
    step_Nm2: Array
    level_Nm: Array
    level_Nm2: Array
    open_Nm: Array
    has_blocks: bool = False
    open_count: int = 0
    open_s: float = 0.0
    learned_s: float = 0.0
    changed_s: float = 0.0
    is_pushed: bool = False
    since_s: float = 0.0
    jumps: int = 0

    @classmethod
    def after_tare(cls, torque_Nm: Array, error_Nm2: Array) -> Self:
        """Return the watch at the first torque, shape (n,).

        Args:
            torque_Nm: That torque.
            error_Nm2: Variance of the torque in free air that lasts for a block and
                longer, as the tare has shown it, shape (n,).
        """
        joints = len(torque_Nm)
        return cls(
            blocks_Nm=np.tile(torque_Nm, (BLOCKS_BEFORE + BLOCKS_AFTER, 1)),
            present_Nm=torque_Nm.copy(),
            usual_Nm2=np.diag(2.0 * error_Nm2),
            with_force_Nm2=np.diag(2.0 * error_Nm2),
            before_Nm=torque_Nm.copy(),
            origin_Nm=torque_Nm.copy(),
            step_Nm2=np.zeros(joints),
            level_Nm=np.zeros(joints),
            level_Nm2=np.zeros((joints, joints)),
            open_Nm=np.zeros(joints),
        )

    @property
    def has_jumped(self) -> bool:
        """Whether a torque has jumped and is not back."""
        return bool(self.step_Nm2.any() or self.level_Nm2.any())

    @property
    def is_measuring(self) -> bool:
        """Whether a torque has jumped, and by how much is not known yet."""
        return bool(self.step_Nm2.any())

    @property
    def jump_Nm2(self) -> Array:
        """Covariance of the torques by jumps, shape (n, n)."""
        return self.level_Nm2 + np.diag(self.step_Nm2)

    def update(self, rows: Array, torque_Nm: Array, dt_s: float) -> None:
        """Look at the torques of a check.

        Args:
            rows: As of `fit_steps`, where the tool is.
            torque_Nm: External joint torque after offset removal, shape (n,).
            dt_s: Time since the last check.
        """
        present_lag_s = 0.06
        block_s = 0.1  # longer than the observer's lag and the noise's memory
        usual_s = 8.0  # of which usual changes are remembered
        # Mean squares of a change in units of the usual one: from where the arm counts
        # as pushed, and below which a change is usual.
        min_push = 15.0
        max_usual = 6.0
        min_learned_s = 1.0  # before several joints together are judged
        self.since_s += dt_s
        gain = -math.expm1(-dt_s / present_lag_s)
        self.present_Nm = self.present_Nm + gain * (torque_Nm - self.present_Nm)
        self.open_Nm = self.open_Nm + torque_Nm
        self.open_count += 1
        self.open_s += dt_s
        if self.open_s >= block_s - ROUNDING_S:
            mean_Nm = self.open_Nm / self.open_count
            if not self.has_blocks:
                self.has_blocks = True
                self.learned_s = self.open_s
                self._settle(mean_Nm)
            self._begin_block(np.vstack((self.blocks_Nm[1:], mean_Nm)))
        free = len(torque_Nm) - len(rows)
        if free <= 0 or not self.has_blocks:
            return
        if self.changed_s > 0.0:
            self._follow(rows, dt_s)
            return
        self.before_Nm = self.blocks_Nm[:BLOCKS_BEFORE].mean(axis=0)
        change_Nm = self.present_Nm - self.before_Nm
        steps = self.fit(rows, change_Nm)
        is_known = self.learned_s >= min_learned_s
        self.is_pushed = is_known and steps.total > min_push * free
        if self.is_pushed or steps.is_jump:
            self.changed_s = dt_s
            self.since_s = 0.1 if self.is_pushed else 0.6
            if steps.is_jump:
                self._bound(steps)
        elif steps.total < max_usual * free:
            self.learned_s += dt_s
            weight = min(dt_s / min(self.learned_s + min_learned_s, usual_s), 1.0)
            self.usual_Nm2 = _follow_product(self.usual_Nm2, steps.remaining_Nm, weight)
            self.with_force_Nm2 = _follow_product(
                self.with_force_Nm2, change_Nm, weight
            )

    def has_begun(self, axial_row: Array) -> bool:
        """Return whether torques change as no force along the needle changes them.

        Args:
            axial_row: Torque per newton along the needle, shape (1, n).
        """
        limit = 4.0  # from here on a rupture is not reported
        if self.learned_s < 1.0 or len(self.present_Nm) < 2:
            return False
        change_Nm = self.present_Nm - self.before_Nm
        steps = fit_steps(axial_row, change_Nm, self.with_force_Nm2, ANY_FORCE_N)
        return steps.total > limit * (len(self.present_Nm) - 1)

    def fit(self, rows: Array, change_Nm: Array, force_N: float = ANY_FORCE_N) -> Any:
        """Return the `TorqueSteps` of a change; arguments as of `fit_steps`."""
        return fit_steps(rows, change_Nm, self.usual_Nm2, force_N)

    def _follow(self, rows: Array, dt_s: float) -> None:
        """Look at an unusual change: it ends, is one joint's step, or stays."""
        # Until then all blocks are behind it. A push of a hand lasts half a second to
        # two; within it, the change may also be that of another joint or of the push,
        # and each explanation leaves another force at the tip.
        min_changed_s = 2.0
        max_changed_s = 2.5
        max_release = 12.0  # mean square below which the arm counts as released
        self.changed_s += dt_s
        steps = self.fit(rows, self.present_Nm - self.before_Nm)
        self.is_pushed = steps.total > max_release * (len(self.present_Nm) - len(rows))
        if self._is_same(rows, self.present_Nm - self.before_Nm) and not self.is_pushed:
            self._settle(self.present_Nm)
            return
        if self.level_Nm2.any() and self._is_same(
            rows, self.present_Nm - self.origin_Nm
        ):
            self.level_Nm = np.zeros_like(self.level_Nm)
            self.level_Nm2 = np.zeros_like(self.level_Nm2)
            self.jumps += 1
            self._settle(self.present_Nm)
            return
        if steps.is_jump or self.is_measuring:
            self._bound(steps)
        newest_Nm = self.blocks_Nm[-2:].mean(axis=0)
        older_Nm = self.blocks_Nm[-BLOCKS_AFTER:-2].mean(axis=0)
        stays = self._is_same(rows, newest_Nm - older_Nm)
        if self.changed_s < (min_changed_s if stays else max_changed_s) - ROUNDING_S:
            return
        after_Nm = self.blocks_Nm[-BLOCKS_AFTER:].mean(axis=0)
        if self.is_measuring:
            # A needle's force changes by about a newton within the second of the
            # blocks.
            self._take_level(self.fit(rows, after_Nm - self.before_Nm, 1.0))
        self._settle(after_Nm)

    def _is_same(self, rows: Array, change_Nm: Array) -> bool:
        """Return whether a change of torque is no step of a joint."""
        max_ratio = 9.0
        return self.fit(rows, change_Nm).ratios.max() < max_ratio

    def _bound(self, steps: TorqueSteps) -> None:
        """Bound each torque's step while a jump is measured."""
        sigmas = np.sqrt(steps.ratios)
        # A joint explains the change nearly as well as the likeliest one does: lever
        # arms are known within some percent, and the rest is chance.
        is_plausible = steps.is_one & (sigmas >= 0.9 * sigmas.max() - 2.5)
        # Not all samples are behind the jump yet: it may be larger.
        margin = 1.25
        self.step_Nm2 = np.where(is_plausible, np.square(margin * steps.steps_Nm), 0.0)

    def _take_level(self, steps: TorqueSteps) -> None:
        """Let a measured jump count as the zero."""
        if not self.level_Nm2.any():
            self.origin_Nm = self.before_Nm
        # Each joint may have jumped, as probably as its step explains the change; the
        # covariance of the change is known within a factor of four or so.
        log_odds = (steps.ratios - steps.ratios.max()) / (2.0 * 4.0)
        odds = np.exp(log_odds) / np.exp(log_odds).sum()
        mean_Nm = odds * steps.steps_Nm
        squares_Nm2 = np.square(steps.steps_Nm) + steps.variances_Nm2
        self.level_Nm = self.level_Nm + mean_Nm
        self.level_Nm2 = (
            self.level_Nm2 + np.diag(odds * squares_Nm2) - np.outer(mean_Nm, mean_Nm)
        )
        self.jumps += 1

    def _settle(self, torque_Nm: Array) -> None:
        """Go on from a torque that all before it is forgotten for."""
        self.changed_s = 0.0
        self.is_pushed = False
        self.step_Nm2 = np.zeros_like(torque_Nm)
        self.present_Nm = torque_Nm.copy()
        self.before_Nm = torque_Nm.copy()
        self._begin_block(np.tile(torque_Nm, (len(self.blocks_Nm), 1)))

    def _begin_block(self, blocks_Nm: Array) -> None:
        """Begin an empty block behind those that are full."""
        self.blocks_Nm = blocks_Nm
        self.open_Nm = np.zeros_like(self.open_Nm)
        self.open_count = 0
        self.open_s = 0.0


def _follow_product(mean_Nm2: Array, torque_Nm: Array, weight: float) -> Array:
    """Return a mean product of torques after another torque with a weight."""
    return mean_Nm2 + weight * (np.outer(torque_Nm, torque_Nm) - mean_Nm2)
