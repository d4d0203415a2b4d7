"""What a recorded free motion says about the torques: scale, signs, order, payload.

A first look fits one factor for all joints and tries each cause with sizes at hand.
Where one of them makes the motion more probable than no cause, all are fitted
(`residual.bias.torque_hypotheses`). Those that cannot be told from the best are tried:
the torque is corrected as the advice says, and the tare is taken again. Only what then
passes is a finding.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.model import BiasModel, TareBlocks
from residual.bias.torque_evidence import TorqueEvidence
from residual.bias.torque_hypotheses import (
    MAX_SCALE_STD,
    SCALE_STD,
    Hypothesis,
    HypothesisTests,
    gravity_columns_of,
)
from residual.bias.torque_texts import (
    Cause,
    describe_hypothesis,
    round_factors,
    tell_apart,
)
from residual.errors import named_joints
from urdf import Robot

SIGMAS = 3.0
"""A factor so many of its own deviations from 1 is named."""

CERTAIN = 10.0
"""Logarithm of the odds from which a cause is certain: 1 to 20 000."""

LIKELY = 5.0
"""Logarithm of the odds from which a cause is named; two causes nearer to each other
than this cannot be told apart."""

LEFT_SIGMAS = 1.0
"""A cause that is not certain may leave a force of so many deviations over: one that
explains the motion hardly better than none, and leaves more, hides another."""

UNLIKELY = 10.0
"""Logarithm of the odds against a cause up to which it is tried where a tare is refused
anyhow."""

LIKELY_PAIR = 15.0
"""The same between causes that are alike: a factor and a payload both act along
gravity, so that small errors of friction and inertia decide between them."""

PAIR = frozenset({"scale", "payload"})
"""Two kinds that are alike: both act along gravity."""

CURRENTS = frozenset({"scale", "joint scales"})
"""Two that are alike, too: one factor for all joints, and one for each."""

TWO_FAULTS = frozenset({"scale and payload", "sign and scale", "payload and sign"})
"""Kinds that are two faults at once."""

MOUNTING = frozenset({"sign", "direction"})
"""Two kinds that are alike: an arm that hangs has the opposite torques at rest."""

SAME_FACTOR_RATIO = 0.1
"""Factors of joints that differ by less are one factor."""

MAX_FINDINGS = 3
"""Causes that a message names."""

MAX_TRIALS = 5
"""Causes that are tried on the motion itself."""

PRIOR_SCALE_STD = 0.1
"""Deviation of a torque sensor's scale where the motion shows nothing of it."""

PLAUSIBLE_RATIO = 2.0
"""A factor beyond this is no poor calibration or description: the tare is refused."""

LEVER_M = 5e-3
"""A joint with a smaller lever hardly feels a force along the needle."""

CHECKED_STD = 0.5
"""Deviation of a joint's factor, relative to 1, up to which its sign has been
checked."""


class ContactReading(NamedTuple):
    """What the sensor reads in a free motion, and whether the tare passes.

    Attributes:
        force_N: Force along the needle.
        std_N: Its standard deviation.
        passes: Whether no contact is seen, and the residual is one of free motion.
    """

    force_N: float
    std_N: float
    passes: bool


class Finding(NamedTuple):
    """A cause that was tried: with it corrected the tare passes.

    Attributes:
        hypothesis: The cause.
        cause: The cause in words.
        reading: What the sensor reads with the cause corrected.
        log_odds: Logarithm of its probability relative to that of no cause.
    """

    hypothesis: Hypothesis
    cause: Cause
    reading: ContactReading
    log_odds: float


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TorqueDiagnosis:
    """What a free motion shows of the torques.

    Attributes:
        scale: Measured torque over that of the model, all joints together.
        scale_std: Its standard deviation; links, offsets and friction are unknown.
        joint_scale: The same of each joint, shape (n,).
        joint_scale_std: Its standard deviation, relative to the size that the first
            finding makes it, shape (n,).
        axial_lever_m: Largest torque per newton along the needle of each joint in the
            motion, shape (n,).
        payload_kg: Mass that the model lacks behind the last joint.
        payload_std_kg: Its standard deviation.
        rating_kg: What the arm may carry.
        findings: Causes that cannot be told apart, the most probable first; none where
            nothing seems to be wrong.
        is_certain: Whether the first one is so probable and so large that the tare is
            refused.
    """

    scale: float
    scale_std: float
    joint_scale: Array
    joint_scale_std: Array
    axial_lever_m: Array
    payload_kg: float
    payload_std_kg: float
    rating_kg: float
    findings: tuple[Finding, ...]
    is_certain: bool

    @property
    def scale_deviates(self) -> bool:
        """Whether the scale is not 1 by more than three deviations."""
        return abs(self.scale - 1.0) > SIGMAS * self.scale_std

    @property
    def is_scale_known(self) -> bool:
        """Whether the motion shows the scale."""
        return self.scale_std < MAX_SCALE_STD

    @property
    def scale_doubt(self) -> float:
        """Standard deviation of the scale of a force, relative to the force."""
        known_std = 1.0 / math.hypot(1.0 / self.scale_std, 1.0 / PRIOR_SCALE_STD)
        if not self.scale_deviates:
            return known_std
        return math.hypot(known_std, self.scale - 1.0)

    @property
    def unchecked_joints(self) -> list[int]:
        """Indices of joints whose torque shows neither sign nor scale."""
        return np.flatnonzero(self.joint_scale_std > CHECKED_STD).tolist()

    def describe_unchecked(self) -> str:
        """Return what the motion cannot show; empty if it shows every joint."""
        unseen = self.unchecked_joints
        with_lever = [joint for joint in unseen if self.axial_lever_m[joint] > LEVER_M]
        without = [joint for joint in unseen if joint not in with_lever]
        texts: list[str] = []
        if with_lever:
            reason = "too little gravity in this motion"
            texts.append(f"{named_joints(with_lever)} not checked ({reason})")
        if without:
            reason = "too little gravity and no axial lever in this motion"
            texts.append(f"{named_joints(without)} not checked ({reason})")
        return ", ".join(texts)

    def describe(self) -> str:
        """Return what is doubtful in one line; empty if nothing is."""
        return describe_findings(self.findings)


def describe_findings(findings: tuple[Finding, ...]) -> str:
    """Return causes with what the tare reads once each is corrected."""
    texts = [
        f"{one.cause.text} (corrected, the sensor reads {one.reading.force_N:.2f} +/- "
        f"{one.reading.std_N:.2f} N in the tare)"
        for one in findings
    ]
    text = "; or ".join(texts)
    if len(findings) > 1:
        text += f". {tell_apart({one.cause.code for one in findings})}"
    return text


def diagnose_torques(
    robot: Robot,
    basis: BiasModel,
    blocks: TareBlocks,
    *,
    adds_gravity: bool,
    is_suspicious: bool,
    axial_lever_m: Array,
    retare: Callable[[TareBlocks], Steps[ContactReading]],
) -> Steps[TorqueDiagnosis]:
    """Return what a free motion shows of the torques.

    Args:
        robot: The arm with its payload.
        basis: Model of its bias.
        blocks: The motion.
        adds_gravity: Whether gravity is added to the measured torque.
        is_suspicious: Whether a contact is seen: then all causes are fitted.
        axial_lever_m: See `TorqueDiagnosis`.
        retare: Takes the tare of a corrected motion.
    """
    evidence = yield from TorqueEvidence.in_steps(basis, blocks)
    yield
    columns = yield from gravity_columns_of(robot, blocks.lagged_q_rad)
    tests = HypothesisTests(robot, evidence, columns, adds_gravity=adds_gravity)
    yield
    as_given = yield from tests.evaluate("none", tests.as_given)
    sizes = evidence.sizes
    joints = robot.nv
    model_Nm = tests.model_Nm
    difference_Nm = tests.difference_Nm(tests.as_given)
    ones = np.ones(joints)
    common = yield from evidence.evaluate(
        difference_Nm, ones, model_Nm[:, :, None], np.array([SCALE_STD])
    )
    load = yield from tests.missing_payload()
    findings: tuple[Finding, ...] = ()
    is_certain = False
    scale = 1.0 - float(common.extra[0])
    scale_std = float(common.extra_std[0])
    deviates = abs(scale - 1.0) > SIGMAS * scale_std
    has_cause = is_suspicious or deviates
    if not has_cause:
        has_cause = yield from tests.has_better(as_given, sizes)
    if has_cause:
        hypotheses = yield from tests.all()
        chosen = _choose(hypotheses, is_suspicious=is_suspicious)
        findings = yield from _try(chosen, tests, retare)
        is_certain = _is_certain(findings)
    correction = findings[0].hypothesis.correction if findings else tests.as_given
    each = yield from evidence.evaluate(
        tests.difference_Nm(correction),
        correction.factors,
        model_Nm[:, :, None] * np.eye(joints),
        np.full(joints, SCALE_STD),
        order=correction.order,
    )
    return TorqueDiagnosis(
        scale=scale,
        scale_std=scale_std,
        joint_scale=(1.0 - each.extra) / correction.factors,
        joint_scale_std=each.extra_std,
        axial_lever_m=axial_lever_m,
        payload_kg=load.mass_kg,
        payload_std_kg=load.std_kg,
        rating_kg=tests.rating_kg,
        findings=findings,
        is_certain=is_certain,
    )


_SIMPLER = {
    "joint scales": ("sign", "joint signs", "rated"),
    "joint signs": ("sign",),
}
"""Kinds that are a simpler kind and more: not named where the simpler one will do."""


class _Choice(NamedTuple):
    """A hypothesis that is tried.

    Attributes:
        hypothesis: The hypothesis.
        log_odds: Logarithm of its odds against no cause.
    """

    hypothesis: Hypothesis
    log_odds: float


def _choose(ranked: list[Hypothesis], *, is_suspicious: bool) -> list[_Choice]:
    """Return the causes that may explain a motion, the most probable first.

    Args:
        ranked: All hypotheses, the most probable first.
        is_suspicious: Whether a contact is seen, so that something is wrong.
    """
    nothing = next(one for one in ranked if one.kind == "none").log_evidence
    causes = [one for one in ranked if one.kind != "none"]
    # What is refused anyhow may have an improbable cause: the trial decides.
    needed = nothing + (-UNLIKELY if is_suspicious else LIKELY)
    limits = {
        one.kind: one.log_evidence - LIKELY_PAIR
        for one in causes
        if one.kind in PAIR and one.log_evidence > needed
    }
    beside = min(limits.values(), default=math.inf)
    chosen = [
        one
        for one in causes
        if one.log_evidence > needed or (one.kind in PAIR and one.log_evidence > beside)
    ]
    scaled = next((one for one in causes if one.kind == "scale"), None)
    if scaled is not None and not chosen and _deviates(scaled):
        chosen = [
            one
            for one in causes
            if one.kind in ("scale", "payload")
            and one.log_evidence > scaled.log_evidence - LIKELY
        ]
    return [_Choice(one, one.log_evidence - nothing) for one in chosen]


def _deviates(hypothesis: Hypothesis) -> bool:
    """Return whether a factor is not 1 by more than three deviations."""
    std = hypothesis.scale_std
    return abs(hypothesis.scale - 1.0) > SIGMAS * std and std < (
        MAX_SCALE_STD * hypothesis.scale
    )


def _try(
    chosen: list[_Choice],
    tests: HypothesisTests,
    retare: Callable[[TareBlocks], Steps[ContactReading]],
) -> Steps[tuple[Finding, ...]]:
    """Return the causes with which the tare passes once they are corrected."""
    findings: list[Finding] = []
    trials = 0
    # Two faults at once are the last to be thought of.
    simple = [one for one in chosen if one.hypothesis.kind not in TWO_FAULTS]
    double = [one for one in chosen if one.hypothesis.kind in TWO_FAULTS]
    best: _Choice | None = None
    for choice in (*simple, *double):
        if trials == MAX_TRIALS or len(findings) == MAX_FINDINGS:
            break
        if not _is_worth_a_trial(choice, best, findings, tests):
            continue
        hypothesis, log_odds = choice
        best = best or choice
        advised = round_factors(hypothesis)
        trials += 1
        reading = yield from retare(tests.corrected_motion(advised.correction))
        leaves_little = abs(reading.force_N) <= LEFT_SIGMAS * reading.std_N
        if reading.passes and (leaves_little or log_odds >= CERTAIN):
            cause = describe_hypothesis(advised, tests)
            findings.append(Finding(advised, cause, reading, log_odds))
    ranked = sorted(findings, key=lambda one: -one.log_odds)
    return tuple(
        one for one in ranked if one.log_odds > ranked[0].log_odds - LIKELY_PAIR
    )


def _is_worth_a_trial(
    choice: _Choice,
    best: _Choice | None,
    findings: list[Finding],
    tests: HypothesisTests,
) -> bool:
    """Return whether a cause may be the one, beside those that were tried.

    Args:
        choice: The cause.
        best: The most probable one that was tried, whether it passed or not: where it
            did not, one that is far less probable is no better for passing.
        findings: Causes that passed.
        tests: Of the motion.
    """
    hypothesis, log_odds = choice
    kind = hypothesis.kind
    if kind in ("scale", "scale and payload") and not _deviates(hypothesis):
        return False
    if kind == "joint scales" and _has_one_factor(hypothesis, tests):
        return False
    kinds = {one.hypothesis.kind for one in findings}
    if kinds & {kind, *_SIMPLER.get(kind, ())}:
        return False
    if best is None:
        return True
    if kind in TWO_FAULTS:
        return log_odds > best.log_odds + (LIKELY if findings else -LIKELY)
    is_alike = {kind, best.hypothesis.kind} in (PAIR, CURRENTS, MOUNTING)
    return log_odds > best.log_odds - (LIKELY_PAIR if is_alike else LIKELY)


def _has_one_factor(hypothesis: Hypothesis, tests: HypothesisTests) -> bool:
    """Return whether the joints that show their factor have the same."""
    factors = hypothesis.correction.factors[tests.visible]
    middle = float(np.median(factors))
    return bool((np.abs(factors / middle - 1.0) < SAME_FACTOR_RATIO).all())


def _is_certain(findings: tuple[Finding, ...]) -> bool:
    """Return whether the first cause is so probable and large that a tare is wrong."""
    if not findings or findings[0].log_odds < CERTAIN:
        return False
    for finding in findings:
        kind = finding.hypothesis.kind
        scale = finding.hypothesis.scale
        if kind == "payload" or finding.log_odds < CERTAIN:
            return False
        is_small = 1.0 / PLAUSIBLE_RATIO < scale < PLAUSIBLE_RATIO
        is_scaled = kind in ("scale", "scale and payload")
        if is_scaled and is_small and not finding.hypothesis.is_toggled:
            return False
    return True
