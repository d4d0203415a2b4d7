"""What a free motion shows of the torques, and the one correction that explains it.

The ways in which torques are commonly wrong are fitted to the motion one by one
(`residual.bias.torque_fit`). One of them is advised where no other comes near it, and
where the tare passes with the motion corrected so; what was seen is said in any case.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from itertools import combinations
from typing import NamedTuple

import numpy as np
from scipy.optimize import linear_sum_assignment

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.model import BiasModel, TareBlocks
from residual.bias.torque_fit import START_OCTAVES, Correction, TorqueFit
from residual.errors import named_joints
from urdf import Robot
from urdf.payload_rating import rated_payload_kg

SIGMAS = 3.0
"""What is so many of its own deviations from what was expected, deviates."""

CLEAR_LOG = 5.0
"""Logarithm of the odds from which an explanation is clearly better than another: 1 to
150."""

CERTAIN_LOG = 10.0
"""The same from which torques are refused where no contact is seen: 1 to 20 000."""

FAULT_LOG = 3.0
"""The same against any fault: one tare in 20 has one."""

MAX_SCALE_STD = 0.25
"""A factor that is known less well than this, relative to itself, is none."""

MIN_LEVER_M = 5e-3
"""A joint with less hardly feels a force along the needle."""

PAYLOAD_STD = np.array([2.0, 0.3, 0.3, 0.3])
"""Prior deviations of a payload that was left out: mass [kg], first moments [kg m]."""

GEARS = (50, 80, 100, 120, 160)
"""Ratios of harmonic drives in makers' catalogues."""

UNITS = {
    -1.0: "the wrong sign",
    1e-3: "kNm read as Nm",
    1e-2: "per cent, or the motor side of a gear of 1:100",
    1e2: "Ncm read as Nm",
    1e3: "mNm read as Nm",
} | {
    1.0 / gear: f"the motor side of a gear of 1:{gear}" for gear in GEARS if gear != 100
}
"""Measured over true torque of all joints, and what makes it so."""

RATED_UNITS = {
    parts * sign: f"{word} of each joint's effort limit"
    for parts, word in ((1.0, "a fraction"), (1e2, "per cent"), (1e3, "per mille"))
    for sign in (1.0, -1.0)
}
"""The same of torque over the effort limits."""


class Explanation(NamedTuple):
    """A way in which torques may be wrong, fitted to a motion.

    Attributes:
        kind: What is wrong: unit, scale (of all), scales (of each joint), signs,
            gravity, direction, order or payload; none where nothing is.
        correction: What makes the motion right.
        log: Logarithm of its probability, but for a constant.
        scale: Measured over true torque of all joints.
        text: What is known of it, in words.
    """

    kind: str
    correction: Correction
    log: float
    scale: float = 1.0
    text: str = ""


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
        motion: The motion.
        log_evidence: Logarithm of its probability as it was given, but for a constant.
        advice: The one explanation that fits, with which the tare passes, and what to
            do in its text; None where nothing seems to be wrong, or several fit.
        is_certain: Whether the torques are certainly of another kind, so that the tare
            is refused.
    """

    scale: float
    scale_std: float
    joint_scale: Array
    joint_scale_std: Array
    axial_lever_m: Array
    payload_kg: float
    payload_std_kg: float
    motion: TareBlocks
    log_evidence: float
    advice: Explanation | None
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
    def deviating_joints(self) -> list[int]:
        """Indices of joints whose scale is not 1 by more than three deviations."""
        error = np.abs(self.joint_scale - 1.0)
        return np.flatnonzero(error > SIGMAS * self.joint_scale_std).tolist()

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
        """Return what was seen: expected and measured torque of each joint."""
        residual_Nm = self.motion.residual_Nm
        torque_Nm = self.motion.torque_Nm
        expected_Nm = (residual_Nm + torque_Nm).mean(axis=0)
        pairs = zip(expected_Nm, torque_Nm.mean(axis=0), strict=True)
        joints = ", ".join(
            f"{number}: {expected:.2f} / {measured:.2f}"
            for number, (expected, measured) in enumerate(pairs, 1)
        )
        rms_Nm = float(np.sqrt(np.square(residual_Nm).mean()))
        text = (
            f"mean torque by joint, expected / measured: {joints} Nm; residual "
            f"{rms_Nm:.3g} Nm rms"
        )
        if self.is_scale_known:
            text += (
                f"; all together tau is {self.scale:.3g} +/- {self.scale_std:.2g} "
                "times what the model expects"
            )
        return "; ".join(filter(None, (text, self.describe_one_joint())))

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


def diagnose_torques(
    robot: Robot,
    basis: BiasModel,
    blocks: TareBlocks,
    *,
    adds_gravity: bool,
    is_suspicious: bool,
    axial_lever_m: Array,
    passes: Callable[[TareBlocks], Steps[bool]],
) -> Steps[TorqueDiagnosis]:
    """Return what a free motion shows of the torques.

    Args:
        robot: The arm with its payload.
        basis: Model of its bias.
        blocks: The motion.
        adds_gravity: Whether gravity is added to the measured torque.
        is_suspicious: Whether a contact is seen: then all explanations are fitted.
        axial_lever_m: See `TorqueDiagnosis`.
        passes: Returns whether a corrected motion is free of contact.
    """
    fit = yield from TorqueFit.in_steps(robot, basis, blocks, adds_gravity=adds_gravity)
    as_given = fit.as_given
    nothing = yield from fit.evaluate(as_given)
    common = yield from fit.evaluate(as_given, fit.model_Nm[:, :, None], np.ones(1))
    each = yield from fit.evaluate(
        as_given, fit.model_Nm[:, :, None] * np.eye(robot.nv), np.ones(robot.nv)
    )
    load = yield from fit.evaluate(
        as_given, fit.payload_columns, PAYLOAD_STD, sizes=START_OCTAVES
    )
    deviates = any(
        bool((np.abs(one.extra) > SIGMAS * one.extra_std).any())
        for one in (common, each, load)
    )
    advice = None
    is_certain = False
    if is_suspicious or deviates:
        found = [Explanation("none", as_given, nothing.log)]
        found += yield from _fit_explanations(fit, basis)
        best = max(found, key=lambda one: one.log)
        # Factors of all joints have every unit and sign among them: no rival to one.
        rivals = [one for one in found if one is not best and one.kind != "scales"]
        is_alone = all(one.log < best.log - CLEAR_LOG for one in rivals)
        near = [best, *(one for one in rivals if one.log > best.log - CERTAIN_LOG)]
        is_harmful = not any(_is_harmless(one, as_given) for one in near)
        is_candidate = best.kind != "none" and (is_alone or is_harmful)
        if is_candidate and (yield from passes(fit.corrected_motion(best.correction))):
            is_certain = is_harmful
            if is_alone and best.kind not in ("scale", "scales"):
                advice = best._replace(text=_describe(best, fit))
    return TorqueDiagnosis(
        scale=1.0 - float(common.extra[0]),
        scale_std=float(common.extra_std[0]),
        joint_scale=1.0 - each.extra,
        joint_scale_std=each.extra_std,
        axial_lever_m=axial_lever_m,
        payload_kg=-float(load.extra[0]),
        payload_std_kg=float(load.extra_std[0]),
        motion=blocks,
        log_evidence=nothing.log,
        advice=advice,
        is_certain=is_certain,
    )


def _is_harmless(explanation: Explanation, as_given: Correction) -> bool:
    """Return whether forces can be measured all the same, only less certainly."""
    if explanation.kind in ("none", "payload"):
        return True
    is_toggled = explanation.correction.adds_gravity is not as_given.adds_gravity
    # A factor up to 2 is a poor calibration, or masses that are off.
    return (
        explanation.kind == "scale" and 0.5 < explanation.scale < 2.0 and not is_toggled
    )


def _fit_explanations(fit: TorqueFit, basis: BiasModel) -> Steps[list[Explanation]]:
    """Return what may be wrong with the torques, each fitted to the motion."""
    as_given = fit.as_given
    toggled = replace(as_given, adds_gravity=not as_given.adds_gravity)
    found = yield from _evaluate(fit, [Explanation("gravity", toggled, 0.0)])
    # Where gravity is added to torque that has it, something else may be wrong, too.
    starts = [as_given, toggled] if as_given.adds_gravity else [as_given]
    for start in starts:
        own = yield from _fit_factors(fit, start, np.ones(fit.robot.nv), UNITS)
        if np.ptp(fit.effort_Nm) > 0.0:
            rated = yield from _fit_factors(fit, start, fit.effort_Nm, RATED_UNITS)
            own += [one for one in rated if one.kind == "unit"]
        own += yield from _fit_joint_scales(fit, start)
        own += yield from _fit_orders(fit, start)
        own += yield from _fit_orders_of_all(fit, basis, start)
        if not start.adds_gravity:
            own += yield from _fit_direction(fit, start)
        if not as_given.adds_gravity:
            own += yield from _fit_payload(fit)
        # Beside gravity that is added twice these are a second fault.
        log = 0.0 if start is as_given else FAULT_LOG
        found += [one._replace(log=one.log - log) for one in own]
    return [one._replace(log=one.log - FAULT_LOG) for one in found]


def _evaluate(
    fit: TorqueFit, candidates: list[Explanation]
) -> Steps[list[Explanation]]:
    """Return explanations that had the logarithm of their prior, with the motion's."""
    found: list[Explanation] = []
    for one in candidates:
        now = yield from fit.evaluate(one.correction)
        found.append(one._replace(log=one.log + now.log))
    return found


def _fit_factors(
    fit: TorqueFit, start: Correction, base: Array, units: dict[float, str]
) -> Steps[list[Explanation]]:
    """Return one factor for all joints, and the units that are near to it.

    Measured torque is the factor times the true one over ``base``, shape (n,).
    """
    weights = 1.0 / np.square(fit.effort_Nm)
    model_Nm = fit.torque_without(start)
    size = max(float((weights * np.square(model_Nm)).sum()), 1e-300)
    scale = float((weights * fit.measured_Nm * base * model_Nm).sum()) / size
    std = math.inf
    log = -math.inf
    for _ in range(4):
        scale = math.copysign(min(max(abs(scale), 1e-4), 1e4), scale)
        correction = replace(start, factors=base / scale)
        now = yield from fit.evaluate(correction, model_Nm[:, :, None], np.ones(1))
        std = float(now.extra_std[0])
        # Factors from 1e-4 to 1e4 are equally probable by their logarithm.
        log = now.log - math.log(math.log(1e8))
        scale *= min(max(1.0 - float(now.extra[0]), 1.0 / 3.0), 3.0)
    if std > MAX_SCALE_STD:
        return []
    near = [
        Explanation("unit", replace(start, factors=base / unit), 0.0, unit, text)
        for unit, text in units.items()
        # Torque sensors of an arm have a scale within some per cent.
        if abs(scale / unit - 1.0) < SIGMAS * std + 0.05
    ]
    if near or abs(scale - 1.0) < SIGMAS * std:
        return (yield from _evaluate(fit, near))
    return [Explanation("scale", replace(start, factors=base / scale), log, scale)]


def _fit_joint_scales(fit: TorqueFit, start: Correction) -> Steps[list[Explanation]]:
    """Return a factor for each joint, and the signs that some joints' torques have."""
    joints = fit.robot.nv
    columns = fit.torque_without(start)[:, :, None] * np.eye(joints)
    each = yield from fit.evaluate(start, columns, np.ones(joints))
    scale = 1.0 - each.extra
    # Factors of either sign from 1e-4 to 1e4 are equally probable at every joint.
    width = 2.0 * math.log(1e8) / math.sqrt(2.0 * math.pi)
    log = each.log - joints * math.log(width)
    found = [Explanation("scales", replace(start, factors=1.0 / scale), log)]
    is_known = np.abs(scale) > 2.0 * each.extra_std
    is_turned = is_known & (scale < 0.0)
    if 0 < np.count_nonzero(is_turned) < np.count_nonzero(is_known):
        correction = replace(start, factors=np.where(is_turned, -1.0, 1.0))
        signs = Explanation("signs", correction, -joints * math.log(2.0))
        found += yield from _evaluate(fit, [signs])
    return found


def _fit_payload(fit: TorqueFit) -> Steps[list[Explanation]]:
    """Return the explanation of a mass behind the last joint; none if it is absurd."""
    robot = fit.robot
    now = yield from fit.evaluate(fit.as_given, fit.payload_columns, PAYLOAD_STD)
    missing = -now.extra
    mass_kg = float(missing[0])
    given_kg = 0.0 if robot.payload is None else robot.payload.mass_kg
    given_kgm = np.zeros(3)
    if robot.payload is not None:
        given_kgm = given_kg * np.array(robot.payload.com_m)
    # The model cannot have much more mass too much there than it has.
    least_kg = -1.2 * float(robot.model.inertias[robot.nv].mass) - 0.1
    most_kg = 1.3 * rated_payload_kg(robot) - given_kg
    moment = float(np.linalg.norm(missing[1:]) - np.linalg.norm(now.extra_std[1:]))
    # No hand or tool has its centre of mass more than 0.5 m from the last joint.
    is_far = moment > 0.5 * (abs(mass_kg) + float(now.extra_std[0]))
    if is_far or not least_kg <= mass_kg <= most_kg:
        return []
    text = "none at all; --without LINK leaves a hand out"
    # The payload on the flange, rounded, as the lines of a file.
    rounded_kg = round(mass_kg + given_kg, 2)
    if rounded_kg > 0.0:
        frame = robot.bare_model.frames[robot.frame_id(robot.flange_frame)]
        turn = frame.placement.rotation
        place_m = frame.placement.translation
        moment_kgm = turn.T @ (missing[1:] - mass_kg * place_m) + given_kgm
        com_m = np.round(moment_kgm / rounded_kg, 3) + 0.0
        mass_kg = rounded_kg - given_kg
        more_kgm = turn @ (rounded_kg * com_m - given_kgm)
        missing = np.append(mass_kg, more_kgm + mass_kg * place_m)
        numbers = ", ".join(f"{one:.3f}" for one in com_m)
        text = f"mass_kg = {rounded_kg:.2f} and com_m = [{numbers}], a line each"
    correction = replace(fit.as_given, payload=missing)
    return [Explanation("payload", correction, now.log, text=text)]


def _fit_direction(fit: TorqueFit, start: Correction) -> Steps[list[Explanation]]:
    """Return the explanation that gravity points elsewhere, if it does."""
    given = np.array(fit.robot.gravity_m_s2)
    size = float(np.linalg.norm(given))
    if size == 0.0:
        return []
    now = yield from fit.evaluate(start, fit.gravity_columns, np.full(3, 10.0))
    gravity = given - now.extra
    length = float(np.linalg.norm(gravity))
    if length < 0.5 * size:
        return []
    # An uneven table turns gravity by less than 0.03 rad: components below are zero.
    gravity = gravity * (size / length)
    is_small = np.abs(gravity) < 2.0 * now.extra_std + 0.03 * size
    if not is_small.all():
        gravity = np.where(is_small, 0.0, gravity)
        gravity = np.round(gravity * (size / np.linalg.norm(gravity)), 2) + 0.0
    if float(np.linalg.norm(gravity - given)) < 0.03 * size:
        return []
    # On a wall or a ceiling are six directions; slopes are as probable all round the
    # sphere, and the fit says how widely.
    spread = min(max(float(np.median(now.extra_std)) / size, 1e-3), 1.0)
    is_slope = np.count_nonzero(gravity) > 1
    log = -2.0 * math.log(2.0 / spread) if is_slope else -math.log(6.0)
    turned = replace(start, gravity_m_s2=gravity)
    return (yield from _evaluate(fit, [Explanation("direction", turned, log)]))


def _fit_orders(fit: TorqueFit, start: Correction) -> Steps[list[Explanation]]:
    """Return the two most probable orders of the torques alone.

    Tried are exchanges of two joints, turns of all, and the order nearest the model.
    """
    identity = fit.as_given.order
    tried = [
        tuple({first: second, second: first}.get(one, one) for one in identity)
        for first, second in combinations(identity, 2)
    ]
    apart = fit.model_Nm[:, :, None] - fit.measured_Nm[:, None, :]
    cost = np.square(apart / fit.effort_Nm[:, None]).mean(axis=0)
    # Of equal orders the one that moves fewest joints is meant.
    cost = cost + 1e-6 * cost.max() * (1.0 - np.eye(len(cost)))
    nearest = tuple(int(one) for one in linear_sum_assignment(cost)[1])
    tried += [identity[::-1], (*identity[1:], identity[0])]
    tried += [(identity[-1], *identity[:-1]), nearest]
    orders = [order for order in dict.fromkeys(tried) if order != identity]
    quick: list[tuple[float, Explanation]] = []
    for order in orders:
        correction = replace(start, order=order)
        now = yield from fit.evaluate(correction, sizes=(1.0, 0.0, 2.0, 2.0))
        moved = np.count_nonzero(np.array(order) != identity)
        # Two joints are one exchange of so many; each further joint is one more.
        log = -float(moved - 1) * math.log(len(orders))
        quick.append((now.log, Explanation("order", correction, log)))
    quick.sort(key=lambda one: -one[0])
    return (yield from _evaluate(fit, [one for _, one in quick[:2]]))


def _fit_orders_of_all(
    fit: TorqueFit, basis: BiasModel, start: Correction
) -> Steps[list[Explanation]]:
    """Return orders in which positions, velocities and torques may stand.

    Drivers of ROS sort joints by name; others count them from the hand.
    """
    names = list(fit.robot.joint_names)
    alphabet = sorted(names)
    by_name = tuple(alphabet.index(name) for name in names)
    found: list[Explanation] = []
    for order in {by_name, start.order[::-1]} - {start.order}:
        correction = replace(start, order=order, is_order_of_all=True)
        motion = fit.corrected_motion(correction)
        yield
        ordered = yield from TorqueFit.in_steps(
            fit.robot, basis, motion, adds_gravity=start.adds_gravity
        )
        now = yield from ordered.evaluate(ordered.as_given)
        text = "the alphabet's" if order == by_name else "reversed"
        found.append(Explanation("order", correction, now.log - 1.0, text=text))
    return found


def _describe(explanation: Explanation, fit: TorqueFit) -> str:
    """Return what seems to be wrong, and what makes it right."""
    correction = explanation.correction
    factors = correction.factors
    numbers = _list_numbers(np.array(correction.order) + 1)
    turned = np.flatnonzero(factors < 0.0)
    joints = "" if len(turned) == len(factors) else f" of {named_joints(turned)}"
    mass_kg = float(correction.payload[0])
    fault = "lacks about {:.2g} kg" if mass_kg > 0.0 else "has about {:.2g} kg too much"
    product = f"multiply it by {_list_numbers(np.unique(factors))}"
    if np.ptp(factors) > 0.0:
        product = f"multiply it by {_list_numbers(factors)}"
    given = [fit.robot.joint_names[k] for k in np.argsort(correction.order)]
    texts = {
        "gravity": "",
        "unit": f"tau is {explanation.text}: {product}",
        "signs": f"tau{joints} has the wrong sign: {product}",
        "order": f"tau has the joints in another order: take its numbers {numbers}",
        "all": f"q, dq and tau have the joints in {explanation.text} order, "
        f"{', '.join(given)}: take their numbers {numbers}",
        "payload": f"the model {fault.format(abs(mass_kg))} at the flange, unless the "
        f"needle is in contact: the payload is {explanation.text}",
    }
    if correction.gravity_m_s2 is not None:
        gravity = _list_numbers(correction.gravity_m_s2)
        texts["direction"] = f"gravity in base axes is ({gravity}) m/s^2"
    kind = "all" if correction.is_order_of_all else explanation.kind
    if explanation.scale == -1.0 and kind == "unit":
        kind = "signs"
    toggled = ""
    if correction.adds_gravity and not fit.as_given.adds_gravity:
        toggled = "tau leaves gravity out: set torque_is_gravity_compensated=True"
    if fit.as_given.adds_gravity and not correction.adds_gravity:
        toggled = "tau has gravity in it: set torque_is_gravity_compensated=False"
    return "; ".join(filter(None, (texts[kind], toggled)))


def _list_numbers(values: Array) -> str:
    """Return numbers with commas between them."""
    return ", ".join(f"{one:.6g}" for one in values)
