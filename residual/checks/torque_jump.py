"""Detects a torque sensor that jumps: one joint's torque steps beside any tip force.

Torques are compared as means over about half a second, before and after. The change
that a force at the tip explains is left out; of the rest, a step of one joint is tried
for every joint. Which joint it was can often not be told: every joint that explains it
about as well is taken to be uncertain by the step that it would need. Nothing is
corrected. A push on the arm that stays may look the same.
"""

from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from foundation.linear_algebra import dot, invert_definite, multiply_vector
from residual.checks.pushed_arm import split_change

BLOCK_S = 0.1
"""Torques are averaged over blocks of this length: five checks, longer than the
observer's lag and the noise's memory."""

ROUNDING_S = 1e-6
"""Two times that are nearer to each other are the same."""

BLOCKS_BEFORE = 5
"""Number of blocks that the torque before a jump is the mean of."""

BLOCKS_AFTER = 4
"""The same after it: with the block of the jump between them a jump is seen within half
a second."""

BLOCKS_BACK = 2
"""Number of newest blocks that show that a torque is back."""

BLOCKS = BLOCKS_BEFORE + 1 + BLOCKS_AFTER
"""Number of blocks that are remembered."""

MIN_JUMP_RATIO = 25.0
"""Square of a step over its variance from which it counts as a jump. Insertions without
a jump reach 13 in a minute; noise alone reaches 25 once in ten hours."""

MAX_USUAL_RATIO = 16.0
"""The same up to which a change is learnt as usual."""

MAX_CHANCE = 25.0
"""Square of a change that the step may leave by chance, in units of its covariance."""

MAX_UNEXPLAINED_FRACTION = 0.1
"""And the part of what it explains: a push on the arm is felt by several joints."""

MIN_JUMP_NM = 0.05
"""Smallest step that counts as a jump: a twist of the needle makes less."""

SAME_RATIO = 9.0
"""The same below which a torque counts as back where it was before the jump."""

PLAUSIBLE_FRACTION = 0.9
"""A joint may have jumped if its step, in standard deviations, is at least this part of
the likeliest joint's: lever arms are known within some percent."""

PLAUSIBLE_SIGMAS = 2.5
"""And if it is smaller by no more than so many standard deviations beyond that."""

STEP_MARGIN = 1.25
"""A torque that may have jumped is uncertain by so much more than the step that it
would need: the step is measured with errors, and lever arms change with the pose."""

SETTLING_S = 0.6
"""Time from the warning until all blocks after the jump are behind it."""

USUAL_S = 8.0
"""Time constant of the usual change; it begins with what the tare has shown."""

MIN_CHANGE_NM = 3e-3
"""Standard deviation that a change of torque has at least."""

CHANGE_ERROR_RATIO = 0.02
"""A change up to this fraction of the largest that the tip force explains may be an
error of the lever arms."""

DIAGONAL_WEIGHT = 0.2
"""Weight of the diagonal in the covariance of usual changes, which is learnt from few
blocks."""

UNSEEN_STEP = 1e-9
"""Information about a step [1/Nm^2] below which a joint cannot be seen to jump: a tip
force explains its torque."""


class TorqueSteps(NamedTuple):
    """Step of each of n joints that would explain a change of torque best.

    Attributes:
        ratios: Square of the step over its variance, shape (n,).
        steps_Nm: The steps, shape (n,).
        remaining_Nm: The change less what a tip force explains, shape (n,).
        total: Square of that in units of its covariance: what the ratios are parts of.
    """

    ratios: Array
    steps_Nm: Array
    remaining_Nm: Array
    total: float

    @property
    def is_one(self) -> bool:
        """Whether one step explains the change, and not only a part of it."""
        most = float(self.ratios.max())
        return self.total - most < MAX_CHANCE + MAX_UNEXPLAINED_FRACTION * most

    @property
    def is_jump(self) -> bool:
        """Whether the step is too large to be chance, and for a twist of the needle."""
        likeliest = int(self.ratios.argmax())
        is_large = abs(self.steps_Nm[likeliest]) > MIN_JUMP_NM
        return self.is_one and is_large and self.ratios[likeliest] > MIN_JUMP_RATIO


@compiled
def fit_steps(rows: Matrix, change: Vector, usual: Matrix) -> TorqueSteps:
    """Fit a step of each joint beside a free force at the tip.

    Args:
        rows: Torque per unit of each unknown of the force, shape (k, n), k < n.
        change: Change of the joint torque [Nm], shape (n,).
        usual: Mean product of changes without a jump, the tip force left out [Nm^2],
            shape (n, n).
    """
    count, joints = rows.shape
    covariance = np.zeros((joints, joints))
    for i in range(joints):
        for j in range(joints):
            covariance[i, j] = (1.0 - DIAGONAL_WEIGHT) * usual[i, j]
        covariance[i, i] += DIAGONAL_WEIGHT * usual[i, i] + MIN_CHANGE_NM**2
    explained = split_change(rows, covariance, change).explained
    largest_Nm = 0.0
    for i in range(joints):
        largest_Nm = max(largest_Nm, abs(explained[i]))
    for i in range(joints):
        covariance[i, i] += (CHANGE_ERROR_RATIO * largest_Nm) ** 2
    explained = split_change(rows, covariance, change).explained
    remaining = np.zeros(joints)
    for i in range(joints):
        remaining[i] = change[i] - explained[i]
    weighted = multiply_vector(invert_definite(covariance), remaining)
    ratios = np.zeros(joints)
    steps_Nm = np.zeros(joints)
    one = np.zeros(joints)
    for i in range(joints):
        one[i] = 1.0
        information = (joints - count) * split_change(rows, covariance, one).unexplained
        one[i] = 0.0
        if information > UNSEEN_STEP:
            steps_Nm[i] = weighted[i] / information
            ratios[i] = weighted[i] * steps_Nm[i]
    return TorqueSteps(ratios, steps_Nm, remaining, dot(change, weighted))


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
        settling_s: Time for which the latest jump is still measured.
        earlier_Nm2: Variance of each torque by the jumps before, shape (n,); None
            without one.
        jump_Nm2: The same with the latest jump, as known so far.
        jumps: Number of jumps measured.
    """

    blocks_Nm: Array
    has_blocks: bool
    open_Nm: Array
    open_count: int
    open_s: float
    usual_Nm2: Array
    before_Nm: Array
    origin_Nm: Array
    settling_s: float
    earlier_Nm2: Array | None
    jump_Nm2: Array | None
    jumps: int

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
            settling_s=0.0,
            earlier_Nm2=None,
            jump_Nm2=None,
            jumps=0,
        )

    def find_damage(self) -> str:
        """Return which array has a wrong shape, "" if none has."""
        joints = self.open_Nm.shape[0]
        shapes = {
            "blocks_Nm": (BLOCKS, joints),
            "usual_Nm2": (joints, joints),
            "before_Nm": (joints,),
            "origin_Nm": (joints,),
            "earlier_Nm2": (joints,),
            "jump_Nm2": (joints,),
        }
        for name, shape in shapes.items():
            array = getattr(self, name)
            if array is not None and array.shape != shape:
                return f"{name} has shape {array.shape}"
        return ""

    @property
    def is_settling(self) -> bool:
        """Whether a jump was seen just now and is still being measured."""
        return self.settling_s > 0.0

    @property
    def has_jumped(self) -> bool:
        """Whether a torque has jumped and is not back."""
        return self.jump_Nm2 is not None

    def advanced(self, rows: Array, torque_Nm: Array, dt_s: float) -> "TorqueCourse":
        """Return the course after a check.

        Args:
            rows: As of `fit_steps`, where the tool is.
            torque_Nm: External joint torque after offset removal, shape (n,).
            dt_s: Time since the last check.
        """
        course = self._replace(
            open_Nm=self.open_Nm + torque_Nm,
            open_count=self.open_count + 1,
            open_s=self.open_s + dt_s,
        )
        if course.open_s < BLOCK_S - ROUNDING_S or len(rows) >= len(torque_Nm):
            return course
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

    def _judged(self, rows: Array, dt_s: float) -> "TorqueCourse":
        """Return the course after a look at a new block, a time after the last."""
        after_Nm = self.blocks_Nm[-BLOCKS_AFTER:].mean(axis=0)
        if self.is_settling:
            return self._measured(rows, after_Nm, dt_s)
        before_Nm = self.blocks_Nm[:BLOCKS_BEFORE].mean(axis=0)
        steps = fit_steps(rows, after_Nm - before_Nm, self.usual_Nm2)
        if steps.is_jump:
            return self._replace(
                before_Nm=before_Nm,
                origin_Nm=self.origin_Nm if self.has_jumped else before_Nm,
                settling_s=SETTLING_S,
                jump_Nm2=self._variance_with(steps),
            )
        if steps.ratios.max() > MAX_USUAL_RATIO:
            return self
        return self._with_usual(steps.remaining_Nm, dt_s)

    def _with_usual(self, remaining_Nm: Array, dt_s: float) -> "TorqueCourse":
        """Return the course with a change learnt as usual."""
        weight = min(dt_s / USUAL_S, 1.0)
        product_Nm2 = np.outer(remaining_Nm, remaining_Nm)
        usual_Nm2 = self.usual_Nm2 + weight * (product_Nm2 - self.usual_Nm2)
        return self._replace(usual_Nm2=usual_Nm2)

    def _measured(self, rows: Array, after_Nm: Array, dt_s: float) -> "TorqueCourse":
        """Return the course after a look at a jump that is still being measured.

        What is back soon, or proves to be a push that several joints feel, was no jump.
        """
        newest_Nm = self.blocks_Nm[-BLOCKS_BACK:].mean(axis=0)
        steps = fit_steps(rows, after_Nm - self.before_Nm, self.usual_Nm2)
        if not steps.is_one or self._is_same(rows, newest_Nm - self.before_Nm):
            return self._replace(
                blocks_Nm=np.tile(newest_Nm, (BLOCKS, 1)),
                settling_s=0.0,
                jump_Nm2=self.earlier_Nm2,
            )
        has_earlier = self.earlier_Nm2 is not None
        if has_earlier and self._is_same(rows, newest_Nm - self.origin_Nm):
            return self._settled(newest_Nm, None)
        jump_Nm2 = self._variance_with(steps)
        if self.settling_s > dt_s:
            return self._replace(settling_s=self.settling_s - dt_s, jump_Nm2=jump_Nm2)
        return self._settled(after_Nm, jump_Nm2)

    def _variance_with(self, steps: TorqueSteps) -> Array:
        """Return the variance of each torque with that of another jump, shape (n,)."""
        latest_Nm2 = plausible_variances(steps)
        return latest_Nm2 if self.earlier_Nm2 is None else self.earlier_Nm2 + latest_Nm2

    def _is_same(self, rows: Array, change_Nm: Array) -> bool:
        """Return whether a change of torque is no jump."""
        return fit_steps(rows, change_Nm, self.usual_Nm2).ratios.max() < SAME_RATIO

    def _settled(self, torque_Nm: Array, jump_Nm2: Array | None) -> "TorqueCourse":
        """Return the course once a jump is measured: the torque and its variance."""
        return self._replace(
            settling_s=0.0,
            earlier_Nm2=jump_Nm2,
            jump_Nm2=jump_Nm2,
            jumps=self.jumps + 1,
            # What was before the jump is compared with nothing any more.
            blocks_Nm=np.tile(torque_Nm, (BLOCKS, 1)),
        )


def plausible_variances(steps: TorqueSteps) -> Array:
    """Return the variance of each torque if any joint may have jumped [Nm^2].

    It is the square of the step that a joint would need, with a margin, and zero for a
    joint that explains the change much worse than the likeliest one, shape (n,).
    """
    sigmas = np.sqrt(steps.ratios)
    least = PLAUSIBLE_FRACTION * sigmas.max() - PLAUSIBLE_SIGMAS
    return np.where(sigmas >= least, np.square(STEP_MARGIN * steps.steps_Nm), 0.0)
