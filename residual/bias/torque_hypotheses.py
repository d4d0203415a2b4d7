"""Ways in which measured torques are commonly wrong, and how probable each is.

Each hypothesis says what makes the measured torque right: another order, a factor or a
sign per joint, gravity added, a payload, or another direction of gravity. With the
torque corrected, the recorded motion has an evidence (`residual.bias.torque_evidence`);
the prior of a hypothesis and the width of its own unknowns are part of it.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import combinations
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
import pinocchio as pin
from scipy.optimize import linear_sum_assignment

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.model import LINK_PARAMETERS, TareBlocks
from urdf import Robot
from urdf.payload_rating import rated_payload_kg

if TYPE_CHECKING:
    from residual.bias.torque_evidence import Evidence, TorqueEvidence

SCALE_STD = 1.0
"""Prior deviation of a factor about the one it is linearised at, relative to it."""

SCALE_STEPS = 4
"""Linearisations of a factor."""

MIN_SCALE = 1e-4
"""Smallest factor."""

MAX_SCALE = 1e4
"""Largest factor."""

LOG_SCALE_WIDTH = math.log(MAX_SCALE / MIN_SCALE)
"""Factors between them are equally probable by their logarithm."""

MAX_STEP_RATIO = 3.0
"""Largest change of a factor in a linearisation."""

PAYLOAD_STD_KG = 2.0
"""Prior deviation of the mass of a payload that was left out."""

MOMENT_STD_KGM = 0.3
"""Prior deviation of its first moments about the last joint."""

GRAVITY_STD_M_S2 = 10.0
"""Prior deviation of each component of a gravity that was not given."""

MIN_TILT_RAD = 0.03
"""Least turn of gravity that is a mounting: an uneven table has less."""

PAYLOAD_MARGIN = 1.3
"""A payload may exceed the rating by so much before it is absurd."""

MASS_TOLERANCE = 1.2
"""The model cannot have more mass too much behind the last joint than it has there;
links beside it are wrong, too."""

MASS_TOLERANCE_KG = 0.1
"""The same, in addition."""

MAX_COM_M = 0.5
"""No hand or tool has its centre of mass further from the last joint."""

MAX_SCALE_STD = 0.25
"""A factor that is known less well than this, relative to itself, is none."""

VISIBLE_SIGMAS = 3.0
"""A joint whose gravity torque stays below so many deviations of its offset shows
neither sign nor scale."""

POSTURES_PER_STEP = 40
"""Postures whose gravity torque is computed in one step."""

LOG_PRIORS: dict[str, float] = {
    "none": 0.0,
    "payload": -2.0,
    "gravity": -2.0,
    "scale": -2.0,
    "sign": -3.0,
    "rated": -4.0,
    "direction": -4.0,
    "joint signs": -4.0,
    "order": -5.0,
    "joint scales": -6.0,
    "scale and payload": -5.0,
    "sign and scale": -6.0,
    "payload and sign": -6.0,
}
"""Logarithms of how probable each kind is before data, but for a constant. Forgotten
payloads and gravity that a driver takes out are the commonest."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Correction:
    """What makes a measured torque right.

    Attributes:
        order: Corrected torque k is made of measured torque ``order[k]``, shape (n,).
        factors: Factor of each corrected torque, shape (n,).
        adds_gravity: Whether gravity is added to the torque.
        payload: Mass and first moments about the last joint that the model lacks [kg,
            kg m], shape (4,).
        gravity_m_s2: Gravity in base axes, shape (3,); None for the model's.
    """

    order: tuple[int, ...]
    factors: Array
    adds_gravity: bool
    payload: Array
    gravity_m_s2: Array | None = None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Hypothesis:
    """A way in which torques may be wrong, fitted to a motion.

    Attributes:
        kind: One of `LOG_PRIORS`.
        correction: What makes the torque right.
        log_evidence: Logarithm of its probability, but for a constant.
        scale: Torque as it was measured over the true one, for all joints.
        scale_std: Standard deviation of it; 0 where it was not fitted.
        is_toggled: Whether it treats gravity otherwise than is done at present.
    """

    kind: str
    correction: Correction
    log_evidence: float
    scale: float = 1.0
    scale_std: float = 0.0
    is_toggled: bool = False


class MissingMass(NamedTuple):
    """Mass that the model lacks behind the last joint.

    Attributes:
        mass_kg: The mass; negative where the model has too much.
        std_kg: Its standard deviation.
    """

    mass_kg: float
    std_kg: float


class HypothesisTests:
    """Fits hypotheses to one recorded motion.

    Args:
        robot: The arm with its payload.
        evidence: Of the motion; its measured torque is as the log has it.
        gravity_columns: Torque per unit of gravity along x, y and z at every block,
            shape (m, n, 3), of `gravity_columns_of`.
        adds_gravity: Whether gravity is added to the measured torque at present.

    Attributes:
        robot: As given.
        adds_gravity: As given.
        model_Nm: Torque of the model over the parts of the motion, shape (k, n).
        gravity_Nm: Of it the torque against gravity, shape (k, n).
        visible: Which joints have a gravity torque beyond offsets, shape (n,).
        rating_kg: What the arm may carry.
    """

    def __init__(
        self,
        robot: Robot,
        evidence: "TorqueEvidence",
        gravity_columns: Array,
        *,
        adds_gravity: bool,
    ) -> None:
        self.robot = robot
        self._evidence = evidence
        self.adds_gravity = adds_gravity
        self._joints = robot.nv
        segments = evidence.segments
        basis = evidence.basis
        blocks = segments.blocks
        self._gravity_columns_of_blocks = gravity_columns
        self.gravity_of_blocks = gravity_columns @ np.array(robot.gravity_m_s2)
        self.model_of_blocks = blocks.residual_Nm + blocks.torque_Nm
        if adds_gravity:
            self.model_of_blocks = self.model_of_blocks + self.gravity_of_blocks
        self.measured_of_blocks = blocks.torque_Nm
        self._measured = segments.mean_of(self.measured_of_blocks)
        self.model_Nm = segments.mean_of(self.model_of_blocks)
        self.gravity_Nm = segments.mean_of(self.gravity_of_blocks)
        links = slice((1 + LINK_PARAMETERS) * robot.nv)
        self._payload_columns = segments.columns[:, :, links][:, :, -LINK_PARAMETERS:]
        offset_Nm = basis.prior.offset_fraction * basis.effort_Nm
        rms_Nm = np.sqrt(np.square(self.gravity_Nm).mean(axis=0))
        self.visible = rms_Nm > VISIBLE_SIGMAS * offset_Nm
        self.rating_kg = rated_payload_kg(robot)
        self._mass_kg = float(robot.model.inertias[robot.nv].mass)
        self._given_kg = 0.0 if robot.payload is None else robot.payload.mass_kg

    @property
    def effort_Nm(self) -> Array:
        """Effort limit per joint, shape (n,)."""
        return self._evidence.basis.effort_Nm

    def describe_payload(self, missing: Array) -> str:
        """Return the payload on the flange, as the lines of a file for ``--payload``.

        Args:
            missing: Mass and first moments that the model lacks, about the last joint,
                shape (4,).
        """
        robot = self.robot
        flange = robot.bare_model.frames[robot.frame_id(robot.flange_frame)]
        placement = flange.placement
        mass_kg = float(missing[0]) + self._given_kg
        if mass_kg <= 0.0:
            return "none at all; --without LINK leaves a hand out"
        moment = placement.rotation.T @ (
            missing[1:] - missing[0] * placement.translation
        )
        if robot.payload is not None:
            moment = moment + robot.payload.mass_kg * np.array(robot.payload.com_m)
        com = ", ".join(f"{round(one, 3) + 0.0:.3f}" for one in moment / mass_kg)
        return f"mass_kg = {mass_kg:.2f} and com_m = [{com}], a line each"

    @property
    def as_given(self) -> Correction:
        """The correction that is in force."""
        return Correction(
            order=tuple(range(self._joints)),
            factors=np.ones(self._joints),
            adds_gravity=self.adds_gravity,
            payload=np.zeros(LINK_PARAMETERS),
        )

    @property
    def untouched(self) -> Correction:
        """No correction: the torque as measured is that of the joints."""
        return replace(self.as_given, adds_gravity=False)

    def difference_Nm(self, correction: Correction) -> Array:
        """Return torque of the model minus corrected torque, shape (k, n)."""
        model_Nm = self.model_Nm + self._payload_columns @ correction.payload
        if correction.gravity_m_s2 is not None:
            turned_Nm = self.gravity_columns @ correction.gravity_m_s2
            model_Nm = model_Nm - self.gravity_Nm + turned_Nm
        torque_Nm = self._measured[:, correction.order] * correction.factors
        if correction.adds_gravity:
            torque_Nm = torque_Nm + self.gravity_Nm
        return model_Nm - torque_Nm

    def corrected_motion(self, correction: Correction) -> TareBlocks:
        """Return the motion as it would have been recorded with a correction."""
        blocks = self._evidence.segments.blocks
        order = list(correction.order)
        torque_Nm = self.measured_of_blocks[:, order] * correction.factors
        if correction.adds_gravity:
            torque_Nm = torque_Nm + self.gravity_of_blocks
        model_Nm = self.model_of_blocks
        if correction.payload.any():
            columns = self._evidence.regressor_of_blocks[:, :, -LINK_PARAMETERS:]
            model_Nm = model_Nm + columns @ correction.payload
        if correction.gravity_m_s2 is not None:
            turned_Nm = self._gravity_columns_of_blocks @ correction.gravity_m_s2
            model_Nm = model_Nm - self.gravity_of_blocks + turned_Nm
        states = blocks.states.copy()
        loops = self._evidence.basis.loops
        # Hysteresis follows the torque, and its sign.
        states[:, :loops] = states[:, :loops, order] * np.sign(correction.factors)
        return replace(
            blocks,
            states=states,
            residual_Nm=model_Nm - torque_Nm,
            torque_Nm=torque_Nm,
            scatter_Nm2=blocks.scatter_Nm2[order] * np.square(correction.factors),
        )

    def evaluate(
        self,
        kind: str,
        correction: Correction,
        *,
        penalty: float = 0.0,
        sizes: tuple[float, ...] | None = None,
    ) -> Steps[Hypothesis]:
        """Return a hypothesis of which nothing is left to be fitted."""
        found = yield from self._evidence.evaluate(
            self.difference_Nm(correction),
            correction.factors,
            order=correction.order,
            sizes=sizes,
        )
        log = found.log + LOG_PRIORS[kind] - penalty
        return Hypothesis(kind=kind, correction=correction, log_evidence=log)

    def with_scale(
        self, kind: str, start: Correction, *, penalty: float = 0.0
    ) -> Steps[Hypothesis]:
        """Return a hypothesis with one factor for all joints fitted in addition."""
        corrected = self._measured[:, start.order] * start.factors
        model_Nm = self.model_Nm
        weights = np.square(1.0 / self._evidence.basis.effort_Nm)
        scale = abs(
            float((weights * corrected * model_Nm).sum())
            / max(float((weights * np.square(model_Nm)).sum()), 1e-300)
        )
        scale = min(max(scale, MIN_SCALE), MAX_SCALE)
        std = scale
        for _ in range(SCALE_STEPS):
            correction = replace(start, factors=start.factors / scale)
            found = yield from self._evidence.evaluate(
                self.difference_Nm(correction),
                correction.factors,
                model_Nm[:, :, None],
                np.array([SCALE_STD]),
                order=start.order,
            )
            change = 1.0 - float(found.extra[0])
            std = scale * float(found.extra_std[0])
            scale *= min(max(change, 1.0 / MAX_STEP_RATIO), MAX_STEP_RATIO)
            scale = min(max(scale, MIN_SCALE), MAX_SCALE)
        correction = replace(start, factors=start.factors / scale)
        penalty += _width_penalty(std / scale)
        found = yield from self.evaluate(kind, correction, penalty=penalty)
        return replace(found, scale=scale, scale_std=std)

    def joint_scales(self) -> Steps[Hypothesis | None]:
        """Return the hypothesis of one factor per joint: motor currents, as a rule.

        None if the motion does not show them.
        """
        model_Nm = self.model_Nm
        squares = np.square(model_Nm).sum(axis=0)
        scales = (self._measured * model_Nm).sum(axis=0) / np.maximum(squares, 1e-300)
        visible = self.visible
        usual = float(np.median(np.abs(scales[visible]))) if visible.any() else 1.0
        scales = np.where(visible & (scales != 0.0), scales, usual or 1.0)
        extra = model_Nm[:, :, None] * np.eye(self._joints)
        std = np.ones(self._joints)
        for _ in range(SCALE_STEPS):
            factors = 1.0 / scales
            correction = replace(self.untouched, factors=factors)
            found = yield from self._evidence.evaluate(
                self.difference_Nm(correction),
                factors,
                extra,
                np.full(self._joints, SCALE_STD),
            )
            change = np.clip(1.0 - found.extra, 1.0 / MAX_STEP_RATIO, MAX_STEP_RATIO)
            scales = np.where(visible, scales * change, scales)
            std = found.extra_std
        if not visible.any() or std[visible].max() > MAX_SCALE_STD:
            return None
        correction = replace(self.untouched, factors=1.0 / scales)
        penalty = sum(_width_penalty(float(one)) for one in std[visible])
        penalty += math.log(2.0) * np.count_nonzero(visible)
        return (yield from self.evaluate("joint scales", correction, penalty=penalty))

    def payload(self, kind: str, start: Correction) -> Steps[Hypothesis | None]:
        """Return the hypothesis of a mass behind the last joint; None if absurd."""
        stds = np.array([PAYLOAD_STD_KG, *[MOMENT_STD_KGM] * 3])
        found = yield from self._evidence.evaluate(
            self.difference_Nm(start),
            start.factors,
            self._payload_columns,
            stds,
            order=start.order,
        )
        missing = -found.extra
        if not self._can_be_payload(missing, found.extra_std):
            return None
        log = found.log + LOG_PRIORS[kind]
        return Hypothesis(
            kind=kind,
            correction=replace(start, payload=missing),
            log_evidence=log,
        )

    def missing_payload(self) -> Steps[MissingMass]:
        """Return the mass that the model lacks, if nothing else is wrong."""
        stds = np.array([PAYLOAD_STD_KG, *[MOMENT_STD_KGM] * 3])
        found = yield from self._evidence.evaluate(
            self.difference_Nm(self.as_given),
            np.ones(self._joints),
            self._payload_columns,
            stds,
            sizes=self._evidence.START_OCTAVES,
        )
        return MissingMass(-float(found.extra[0]), float(found.extra_std[0]))

    def has_better(self, nothing: Hypothesis, sizes: tuple[float, ...]) -> Steps[bool]:
        """Return whether some cause is more probable than none, with sizes as given."""
        toggled = replace(self.as_given, adds_gravity=not self.adds_gravity)
        hanging = replace(
            self.untouched, gravity_m_s2=-np.array(self.robot.gravity_m_s2)
        )
        negated = replace(self.untouched, factors=-np.ones(self._joints))
        tried = [("gravity", toggled), ("direction", hanging), ("sign", negated)]
        for joint in range(self._joints):
            factors = np.ones(self._joints)
            factors[joint] = -1.0
            tried.append(("joint signs", replace(self.untouched, factors=factors)))
        tried += [
            ("order", replace(self.untouched, order=order))
            for order, _ in self.orders()
        ]
        limit = nothing.log_evidence
        yield
        for kind, correction in tried:
            found = yield from self.evaluate(kind, correction, sizes=sizes)
            if found.log_evidence > limit:
                return True
        payload = yield from self.payload("payload", self.as_given)
        return payload is not None and payload.log_evidence > limit

    def _can_be_payload(self, missing: Array, std: Array) -> bool:
        """Return whether a mass and first moments can hang on this arm."""
        mass_kg = float(missing[0])
        too_much_kg = MASS_TOLERANCE * self._mass_kg + MASS_TOLERANCE_KG
        limit_kg = PAYLOAD_MARGIN * self.rating_kg - self._given_kg
        if not -too_much_kg <= mass_kg <= limit_kg:
            return False
        moment = float(np.linalg.norm(missing[1:]))
        moment_std = float(np.linalg.norm(std[1:]))
        return moment - moment_std < MAX_COM_M * (abs(mass_kg) + float(std[0]))

    def payload_with_scale(self) -> Steps[Hypothesis | None]:
        """Return the hypothesis of a mass and a factor for all joints."""
        scaled = yield from self.with_scale("scale", self.untouched)
        scale = scaled.scale
        model_Nm = self.model_Nm
        extra = np.concatenate((model_Nm[:, :, None], self._payload_columns), axis=2)
        stds = np.array([SCALE_STD, PAYLOAD_STD_KG, *[MOMENT_STD_KGM] * 3])

        def fit(scale: float) -> Steps["Evidence"]:
            start = replace(self.untouched, factors=self.untouched.factors / scale)
            difference_Nm = self.difference_Nm(start)
            return (
                yield from self._evidence.evaluate(
                    difference_Nm, start.factors, extra, stds
                )
            )

        for _ in range(SCALE_STEPS):
            found = yield from fit(scale)
            scale *= 1.0 - float(found.extra[0])
            scale = min(max(scale, MIN_SCALE), MAX_SCALE)
        found = yield from fit(scale)
        missing = -found.extra[1:]
        if not self._can_be_payload(missing, found.extra_std[1:]):
            return None
        correction = replace(
            self.untouched, factors=self.untouched.factors / scale, payload=missing
        )
        log = found.log + LOG_PRIORS["scale and payload"]
        return Hypothesis(
            kind="scale and payload",
            correction=correction,
            log_evidence=log - math.log(LOG_SCALE_WIDTH),
            scale=scale,
            scale_std=scale * float(found.extra_std[0]),
        )

    def direction(self) -> Steps[Hypothesis | None]:
        """Return the hypothesis that gravity points elsewhere; None if it does not."""
        columns = self.gravity_columns
        given = np.array(self.robot.gravity_m_s2)
        size = float(np.linalg.norm(given))
        if size == 0.0:
            return None
        found = yield from self._evidence.evaluate(
            self.difference_Nm(self.untouched),
            np.ones(self._joints),
            columns,
            np.full(3, GRAVITY_STD_M_S2),
        )
        gravity = given - found.extra
        length = float(np.linalg.norm(gravity))
        if length < 0.5 * size:
            return None
        gravity = gravity * (size / length)
        gravity = _without_small_parts(gravity, found.extra_std)
        cosine = float(gravity @ given) / size**2
        if math.acos(min(max(cosine, -1.0), 1.0)) < MIN_TILT_RAD:
            return None
        correction = replace(self.untouched, gravity_m_s2=gravity)
        # Directions are as probable all round the sphere; the fit says how widely.
        spread = float(np.median(found.extra_std)) / size
        penalty = 2.0 * math.log(2.0 / max(min(spread, 1.0), 1e-3))
        return (yield from self.evaluate("direction", correction, penalty=penalty))

    def rated(self) -> Steps[list[Hypothesis]]:
        """Return hypotheses of torque as a fraction, or in per cent, of the limits."""
        effort_Nm = self._evidence.basis.effort_Nm
        found: list[Hypothesis] = []
        if np.ptp(effort_Nm) == 0.0:
            return found
        for parts in (1.0, 100.0, 1000.0):
            correction = replace(self.untouched, factors=effort_Nm / parts)
            scaled = yield from self.with_scale("rated", correction)
            is_whole = abs(scaled.scale - 1.0) < VISIBLE_SIGMAS * scaled.scale_std
            if is_whole and scaled.scale_std < MAX_SCALE_STD:
                found.append((yield from self.evaluate("rated", correction)))
        return found

    def orders(self) -> Iterator[tuple[tuple[int, ...], float]]:
        """Yield other orders of the joints, with what makes each less probable."""
        joints = self._joints
        identity = tuple(range(joints))
        pairs = list(combinations(range(joints), 2))
        for first, second in pairs:
            order = list(identity)
            order[first] = second
            order[second] = first
            yield tuple(order), math.log(len(pairs))
        others = [
            tuple(reversed(identity)),
            (*identity[1:], identity[0]),
            (identity[-1], *identity[:-1]),
        ]
        assigned = self._assigned_order()
        if sum(a != b for a, b in zip(assigned, identity, strict=True)) > 2:
            others.append(assigned)
        for order in dict.fromkeys(others):
            if sum(a != b for a, b in zip(order, identity, strict=True)) > 2:
                yield order, math.log(len(pairs)) + 2.0

    def _assigned_order(self) -> tuple[int, ...]:
        """Return the order in which torques are nearest to the model's."""
        effort = self._evidence.basis.effort_Nm
        apart = self.model_Nm[:, :, None] - self._measured[:, None, :]
        cost = np.square(apart / effort[:, None]).mean(axis=0)
        # Of equal orders the one that moves fewest joints is meant.
        cost = cost + 1e-6 * cost.max() * (1.0 - np.eye(len(cost)))
        return tuple(int(one) for one in linear_sum_assignment(cost)[1])

    @cached_property
    def gravity_columns(self) -> Array:
        """Torque per unit of gravity over the parts of the motion, shape (k, n, 3)."""
        return self._evidence.segments.mean_of(self._gravity_columns_of_blocks)

    def joint_signs(self, start: Hypothesis) -> Steps[Hypothesis | None]:
        """Return the hypothesis of some joints' signs; None if none is turned.

        Signs are turned one at a time, as long as that makes the motion more probable.
        """
        best: Hypothesis | None = None
        factors = np.ones(self._joints)
        log = start.log_evidence
        for turned in range(1, self._joints):
            tried: list[Hypothesis] = []
            for joint in range(self._joints):
                if factors[joint] < 0.0:
                    continue
                own = factors.copy()
                own[joint] = -1.0
                correction = replace(self.untouched, factors=own)
                penalty = turned * math.log(self._joints)
                hypothesis = yield from self.evaluate(
                    "joint signs", correction, penalty=penalty
                )
                tried.append(hypothesis)
            candidate = max(tried, key=lambda one: one.log_evidence)
            if candidate.log_evidence <= log + 1.0:
                break
            best = candidate
            log = candidate.log_evidence
            factors = candidate.correction.factors
        return best

    def all(self) -> Steps[list[Hypothesis]]:
        """Return all hypotheses, the most probable first."""
        toggled = replace(self.as_given, adds_gravity=not self.adds_gravity)
        negated = replace(self.untouched, factors=-np.ones(self._joints))
        hanging = replace(
            self.untouched, gravity_m_s2=-np.array(self.robot.gravity_m_s2)
        )
        found: list[Hypothesis | None] = []
        for kind, correction in (
            ("none", self.as_given),
            ("gravity", toggled),
            ("sign", negated),
        ):
            found.append((yield from self.evaluate(kind, correction)))
        found.append((yield from self.with_scale("scale", self.untouched)))
        found.append((yield from self.with_scale("sign and scale", negated)))
        found.append((yield from self.payload("payload", self.as_given)))
        found.append((yield from self.payload("payload and sign", negated)))
        found.append((yield from self.payload_with_scale()))
        found.append((yield from self.joint_scales()))
        found += yield from self.rated()
        found.append((yield from self.direction()))
        found.append((yield from self.evaluate("direction", hanging)))
        untouched = yield from self.evaluate("none", self.untouched)
        found.append((yield from self.joint_signs(untouched)))
        found += yield from self._best_orders()
        known = [
            one
            for one in found
            if one is not None and one.scale_std < MAX_SCALE_STD * one.scale
        ]
        ranked = [
            replace(
                one, is_toggled=one.correction.adds_gravity is not self.adds_gravity
            )
            for one in known
        ]
        return sorted(ranked, key=lambda one: -one.log_evidence)

    def _best_orders(self) -> Steps[list[Hypothesis]]:
        """Return the three most probable orders."""
        sizes = (1.0, 0.0, 2.0, 2.0)
        tried = []
        for order, penalty in self.orders():
            correction = replace(self.untouched, order=order)
            found = yield from self.evaluate(
                "order", correction, penalty=penalty, sizes=sizes
            )
            tried.append((found.log_evidence, correction, penalty))
        tried.sort(key=lambda one: -one[0])
        best: list[Hypothesis] = []
        for _, correction, penalty in tried[:3]:
            found = yield from self.evaluate("order", correction, penalty=penalty)
            best.append(found)
        return best


def gravity_columns_of(robot: Robot, q_rad: Array) -> Steps[Array]:
    """Return the torque per unit of gravity along x, y and z, shape (m, n, 3).

    Args:
        robot: The arm with its payload.
        q_rad: Postures, shape (m, n).
    """
    model = pin.Model(robot.model)
    data = model.createData()
    columns = np.empty((*q_rad.shape, 3))
    for axis in range(3):
        model.gravity = pin.Motion(np.eye(3)[axis].copy(), np.zeros(3))
        for k, q in enumerate(q_rad):
            columns[k, :, axis] = pin.computeGeneralizedGravity(model, data, q)
            if k % POSTURES_PER_STEP == 0:
                yield
    return columns


def _width_penalty(relative_std: float) -> float:
    """Return by how much a fitted factor is less probable than a given one."""
    width = math.sqrt(2.0 * math.pi) * max(min(relative_std, 3.0), 1e-6)
    return math.log(LOG_SCALE_WIDTH / width)


def _without_small_parts(gravity: Array, std: Array) -> Array:
    """Return a gravity whose components within their deviation are zero."""
    size = float(np.linalg.norm(gravity))
    kept = np.where(np.abs(gravity) < 2.0 * std + MIN_TILT_RAD * size, 0.0, gravity)
    length = float(np.linalg.norm(kept))
    return gravity if length == 0.0 else kept * (size / length)
