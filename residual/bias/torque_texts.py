"""Causes of a wrong torque in words, with what stands in the places of an advice."""

from collections.abc import Set as AbstractSet
from dataclasses import replace
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from foundation.arrays import Array
from residual.errors import SensorCode, named_joints

if TYPE_CHECKING:
    from residual.bias.torque_hypotheses import Hypothesis, HypothesisTests

ROUND_RATIO = 0.5
"""A factor is rounded by at most so many of its deviations."""

MAX_DIGITS = 4
"""Digits of a factor in an advice."""

JOINT_DIGITS = 3
"""Digits of the factors of single joints."""

UNIT_TOLERANCE = 0.08
"""Relative distance within which a factor is that of a unit."""

CALIBRATION_RATIO = 2.0
"""Factors nearer to 1 than this may be a poor calibration or description."""

UNIT_FACTORS = (
    (1e-3, "kNm read as Nm"),
    (1e-2, "the motor side of a gear of 1:100, per cent"),
    (1e2, "Ncm read as Nm"),
    (1e3, "mNm read as Nm"),
)
"""What a factor is that is nearly one of these."""

RATED_PARTS = {1.0: "a fraction", 100.0: "per cent", 1000.0: "per mille"}
"""Words for parts of an effort limit."""


UPRIGHT_COSINE = 0.9998
"""Cosine of the tilt, about 1 degree, up to which a base stands upright."""

CONTAINS_GRAVITY = "contains_gravity"
"""Place of an advice that is there where gravity must no longer be added."""


class Cause(NamedTuple):
    """A cause in words.

    Attributes:
        text: What was seen, and what seems to be the cause.
        code: Kind of the cause.
        places: What stands in the places of its advice.
    """

    text: str
    code: SensorCode
    places: dict[str, str]


def round_factors(hypothesis: "Hypothesis") -> "Hypothesis":
    """Return a hypothesis with factors of as few digits as their deviations allow."""
    factors = hypothesis.correction.factors
    if hypothesis.kind == "joint scales":
        rounded = np.array([float(f"{one:.{JOINT_DIGITS}g}") for one in factors])
    elif hypothesis.scale_std > 0.0:
        allowed = ROUND_RATIO * hypothesis.scale_std / hypothesis.scale
        size = float(np.abs(factors).max())
        value = size
        for digits in range(1, MAX_DIGITS + 1):
            value = float(f"{size:.{digits}g}")
            if abs(value / size - 1.0) < allowed:
                break
        rounded = factors * (value / size)
    else:
        return hypothesis
    return replace(
        hypothesis, correction=replace(hypothesis.correction, factors=rounded)
    )


def describe_hypothesis(hypothesis: "Hypothesis", tests: "HypothesisTests") -> Cause:
    """Return a hypothesis in words."""
    cause = _DESCRIPTIONS[hypothesis.kind](hypothesis, tests)
    is_doubled = tests.adds_gravity and not hypothesis.correction.adds_gravity
    if not is_doubled or hypothesis.kind == "gravity":
        return cause
    return cause._replace(
        text=f"{cause.text}; it contains gravity, which must not be added",
        places=cause.places | {CONTAINS_GRAVITY: "yes"},
    )


def tell_apart(codes: AbstractSet[SensorCode]) -> str:
    """Return what would tell causes apart that explain a motion equally well."""
    if codes == {SensorCode.TORQUE_SCALE, SensorCode.PAYLOAD}:
        return (
            "A known mass hung on the flange tells them apart: it must read as its "
            "weight"
        )
    if codes == {SensorCode.TORQUE_SIGN, SensorCode.GRAVITY_DIRECTION}:
        return "How the arm is mounted tells them apart"
    if codes == {SensorCode.TORQUE_SCALE}:
        return (
            "The maker's torque constants tell them apart, or a free motion that turns "
            "every joint by some tenths of a radian"
        )
    return (
        "A free motion that turns every joint by some tenths of a radian tells them "
        "apart"
    )


def _factor_text(factors: Array) -> str:
    """Return one factor for all joints, or one for each."""
    if np.ptp(factors) == 0.0:
        return f"{factors[0]:.{MAX_DIGITS}g}"
    return ",".join(f"{one:.{MAX_DIGITS}g}" for one in factors)


def _places_of(hypothesis: "Hypothesis") -> dict[str, str]:
    return {"factors": _factor_text(hypothesis.correction.factors)}


def _describe_scale(hypothesis: "Hypothesis", _: "HypothesisTests") -> Cause:
    scale = hypothesis.scale
    std = hypothesis.scale_std
    sign = -1.0 if hypothesis.correction.factors[0] < 0.0 else 1.0
    guess = f"motor currents, the motor side of a gear (1:{1 / scale:.3g}) or "
    guess += "another unit"
    if scale > 1.0:
        guess = "another unit"
    if 1.0 / CALIBRATION_RATIO < scale < CALIBRATION_RATIO:
        guess = (
            "the torque sensors' scale, currents with other torque constants, or the "
            "masses of the description are off"
        )
    for factor, unit in UNIT_FACTORS:
        if abs(scale / factor - 1.0) < UNIT_TOLERANCE:
            guess = f"{unit}, currents, or another unit"
    text = (
        f"tau is {sign * scale:.3g} +/- {std:.2g} times the torque that gravity asks "
        f"for: {guess}"
    )
    return Cause(text, SensorCode.TORQUE_SCALE, _places_of(hypothesis))


def _describe_sign(hypothesis: "Hypothesis", _: "HypothesisTests") -> Cause:
    factors = hypothesis.correction.factors
    turned = np.flatnonzero(factors < 0.0)
    joints = "" if len(turned) == len(factors) else f" at {named_joints(turned)}"
    text = f"tau{joints} seems to have the wrong sign"
    return Cause(text, SensorCode.TORQUE_SIGN, _places_of(hypothesis))


def _describe_joint_scales(hypothesis: "Hypothesis", tests: "HypothesisTests") -> Cause:
    factors = hypothesis.correction.factors
    visible = np.flatnonzero(tests.visible)
    seen = ", ".join(f"{factors[joint]:.3g} at joint {joint + 1}" for joint in visible)
    text = f"tau seems to be motor currents: torque constants of {seen}"
    hidden = np.flatnonzero(~tests.visible)
    if hidden.size:
        text += (
            f"; those of {named_joints(hidden)} do not show, their factors are the "
            "others' middle: take the maker's"
        )
    return Cause(text, SensorCode.TORQUE_SCALE, _places_of(hypothesis))


def _describe_rated(hypothesis: "Hypothesis", tests: "HypothesisTests") -> Cause:
    parts = tests.effort_Nm / hypothesis.correction.factors
    word = RATED_PARTS[float(f"{np.median(parts):.3g}")]
    text = f"tau seems to be {word} of each joint's effort limit"
    return Cause(text, SensorCode.TORQUE_SCALE, _places_of(hypothesis))


def _describe_gravity(hypothesis: "Hypothesis", _: "HypothesisTests") -> Cause:
    if hypothesis.correction.adds_gravity:
        return Cause("tau seems to leave gravity out", SensorCode.GRAVITY_MISSING, {})
    return Cause("gravity seems to be added twice", SensorCode.GRAVITY_TWICE, {})


def _describe_direction(hypothesis: "Hypothesis", tests: "HypothesisTests") -> Cause:
    gravity = hypothesis.correction.gravity_m_s2
    given = np.array(tests.robot.gravity_m_s2)
    if gravity is None:
        gravity = given
    cosine = float(gravity @ given) / float(np.linalg.norm(gravity) ** 2)
    degrees = float(np.degrees(np.arccos(np.clip(cosine, -1.0, 1.0))))
    is_upright = -gravity[2] > UPRIGHT_COSINE * float(np.linalg.norm(gravity))
    mounting = "the arm hangs, or stands on a wall or a slope"
    if is_upright:
        mounting = "the arm's base stands upright"
    text = (
        f"gravity seems to be turned by {degrees:.0f} degrees from the one that was "
        f"given: {mounting}"
    )
    places = {"gravity": " ".join(f"{one + 0.0:.3g}" for one in gravity)}
    return Cause(text, SensorCode.GRAVITY_DIRECTION, places)


def _describe_order(hypothesis: "Hypothesis", _: "HypothesisTests") -> Cause:
    order = hypothesis.correction.order
    # A measured torque j stands where the corrected joint k says order[k] = j.
    exchanges = ", ".join(
        f"tau of joint {measured + 1} reads as joint {joint + 1}'s"
        for measured, joint in sorted(
            (measured, joint)
            for joint, measured in enumerate(order)
            if joint != measured
        )
    )
    text = f"joints seem to be exchanged: {exchanges}"
    places = {"order": ",".join(str(one + 1) for one in order)}
    return Cause(text, SensorCode.JOINT_ORDER, places)


def _describe_payload(hypothesis: "Hypothesis", tests: "HypothesisTests") -> Cause:
    mass_kg = float(hypothesis.correction.payload[0])
    fault = "lacks about {:.2g} kg" if mass_kg > 0.0 else "has about {:.2g} kg too much"
    text = (
        f"the robot's model {fault.format(abs(mass_kg))} at the flange, unless the "
        "needle is in contact"
    )
    places = {"payload": tests.describe_payload(hypothesis.correction.payload)}
    return Cause(text, SensorCode.PAYLOAD, places)


def _describe_both(hypothesis: "Hypothesis", tests: "HypothesisTests") -> Cause:
    """Return a factor or a sign, and a payload."""
    is_sign = hypothesis.kind == "payload and sign"
    first = _describe_sign if is_sign else _describe_scale
    cause = first(hypothesis, tests)
    payload = _describe_payload(hypothesis, tests)
    return cause._replace(
        text=(
            f"{cause.text}; and {payload.text}, where the payload is "
            f"{payload.places['payload']}"
        ),
        places=cause.places | payload.places,
    )


_DESCRIPTIONS = {
    "scale": _describe_scale,
    "sign and scale": _describe_scale,
    "sign": _describe_sign,
    "joint signs": _describe_sign,
    "joint scales": _describe_joint_scales,
    "rated": _describe_rated,
    "gravity": _describe_gravity,
    "direction": _describe_direction,
    "order": _describe_order,
    "payload": _describe_payload,
    "scale and payload": _describe_both,
    "payload and sign": _describe_both,
}
"""What describes each kind of hypothesis."""
