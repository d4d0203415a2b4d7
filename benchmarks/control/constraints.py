"""What the kinematic constraints hold, in closed loop against true positions.

Remote centre (RCM): the tip follows a circle of 40 mm across, 80 mm below a trocar that
holds the needle with 1000 N/m, with 1 N on the tip across; error is the distance of the
true axis from the point where it was when the centre was set. Fixture: 100 mm through
tissue while the user wants to leave the line, sideways at up to 20 mm/s; error is the
distance of the true tip from the line. Decoupled motion: the needle turns by 0.5 rad
about the tip, which should rest.

S is the stiff inner loop, I joint impedance. With *kinematic error*, the arm's joints
are not quite where the controller's model has them: micrometres on shared kinematics
mean nothing without it.
"""

import math
from collections.abc import Callable, Iterator, Sequence
from functools import partial

import numpy as np

from benchmarks.control.loop import SERVOS
from benchmarks.control.published import solve_published
from benchmarks.jobs import Figure, Job, Method
from foundation.arrays import Array
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.rig_arm import SimulatedArm, with_kinematic_error
from groundtruth.rig_contacts import Contact, HandOnArm, Trocar, distance_to_axis_m
from needleforce.control.controller import Controller
from needleforce.control.joint_limits import Limits
from needleforce.control.priority_solver import Solver, hierarchical
from needleforce.control.tasks import (
    DecoupledMotion,
    Fixture,
    Posture,
    RemoteCentre,
    Task,
    TipVelocity,
)

MILLI = 1e3
GAIN_per_s = 30.0
"""K of the constraints. Noise of the measured positions passes the loop and grows with
the root of K; what a push displaces falls with K."""
SETTLE_s = 0.6
"""Rest before a constraint is set at the mean of what is measured in its second half.
After 0.3 s joint impedance still moves by 0.01 mm under the 1 N on the tip."""
BEHIND_TIP_m = 0.08
RADIUS_m = 0.02
PERIOD_s = 8.0
FADE_s = 1.0
INSERTION_m = 0.1
VARIANTS = {
    "rcm": ("", "_kinematic", "_elbow", "_published"),
    "fixture": ("", "_pushed", "_kinematic", "_published"),
    "decoupled": ("", "_kinematic"),
}
"""What is different in the cases of a constraint: the arm has a kinematic error, a hand
pushes, the published recursion solves."""
CASES = tuple(
    f"{kind}{variant} {servo}"
    for kind, variants in VARIANTS.items()
    for variant in variants
    for servo in SERVOS
)


class ClosedLoop:
    """An arm that has come to rest, and its controller, which knows where that is.

    Args:
        servo: One of `SERVOS`.
        job: Plant model and seed.
        scenario: Tissue in front of the needle; None for none.
        contacts: Hands, trocars and walls.
        has_kinematic_error: Whether the joints are not where the model has them.
        solver: What serves the stack of tasks.
    """

    def __init__(
        self,
        servo: str,
        job: Job,
        *,
        scenario: str | None = None,
        contacts: Sequence[Contact] = (),
        has_kinematic_error: bool = False,
        solver: Solver = hierarchical,
    ) -> None:
        plant = PLANT_MODELS[job.plant]
        self.seed = job.seed
        self.rig = SimulatedArm(
            scenario,
            with_kinematic_error(plant) if has_kinematic_error else plant,
            job.seed,
            servo=SERVOS[servo],
            contacts=contacts,
            standoff_m=5e-3,
        )
        self.control = Controller(self.rig.robot, Limits(self.rig.robot), solver)
        still = [next(self.rig).q_rad for _ in range(round(SETTLE_s * MILLI))]
        self.control.tool.update(np.mean(still[len(still) // 2 :], axis=0))

    def run(
        self,
        seconds: float,
        stack: Callable[[float], Sequence[Task]],
        error: Callable[[], float],
    ) -> Array:
        """Return the errors at all samples of some time, under a stack of tasks."""
        start_s = self.rig.time_s
        errors = []
        for sample in self.rig:
            t_s = self.rig.time_s - start_s
            errors.append(error())
            if t_s >= seconds:
                break
            self.rig.send(self.control.update(sample, stack(t_s)).dq_rad_s)
        return np.array(errors)


def across(seed: int) -> Array:
    """Draw a horizontal direction; the needle points down."""
    angle = np.random.default_rng([seed, 4]).uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _circle(test: ClosedLoop) -> tuple[Array, Array]:
    """Run the circle; return errors of the centre and of the tip [m].

    Both count from the circle's full size on.
    """
    rig = test.rig
    tool = test.control.tool
    true = rig.truth
    centre_m = true.tip_m - BEHIND_TIP_m * true.rotation[:, 2]
    home_m = tool.tip_m
    constraint = RemoteCentre(home_m - BEHIND_TIP_m * tool.axis, GAIN_per_s)
    tip = TipVelocity((0.0, 0.0, 0.0), home_m, 10.0)
    posture = Posture(rig.home_rad)
    off_m: list[float] = []

    def stack(t_s: float) -> Sequence[Task]:
        grown = min(t_s / FADE_s, 1.0)
        radius = RADIUS_m * grown**2 * (3.0 - 2.0 * grown)
        growth = RADIUS_m * 6.0 * grown * (1.0 - grown) / FADE_s
        rate = 2.0 * math.pi / PERIOD_s
        out = np.array([math.cos(rate * t_s), math.sin(rate * t_s), 0.0])
        on = np.array([-out[1], out[0], 0.0])
        tip.goal_m = home_m + radius * out
        tip.rate = growth * out + radius * rate * on
        off_m.append(float(np.linalg.norm(rig.truth.tip_m - true.tip_m - radius * out)))
        return constraint, tip, posture

    error = partial(rig.distance_to_axis_m, centre_m)
    error_m = test.run(FADE_s + PERIOD_s, stack, error)
    return error_m[round(FADE_s * MILLI) :], np.array(off_m[round(FADE_s * MILLI) :])


def _trocar_and_force(seed: int) -> list[Contact]:
    """Return the trocar, and 1 N on the tip that comes up while the arm settles."""
    side = across(seed)
    force = HandOnArm(
        at="tip", force_N=lambda t_s: min(t_s / (0.5 * SETTLE_s), 1.0) * side
    )
    return [Trocar(behind_tip_m=BEHIND_TIP_m), force]


def measure_rcm(new: "NewLoop", job: Job, variant: str) -> Iterator[Figure]:
    """Measure the circle; on the elbow a hand pushes with 30 N.

    They come within 50 ms, for 1 s, every 2 s.
    """
    contacts = _trocar_and_force(job.seed)
    if variant == "_elbow":
        side = across(job.seed + 1)

        def push(t_s: float) -> Array:
            phase = (t_s - SETTLE_s - FADE_s) % 2.0 if t_s > SETTLE_s + FADE_s else 0.0
            return 30.0 * min(phase / 0.05, max((1.0 - phase) / 0.05, 0.0), 1.0) * side

        contacts.append(HandOnArm(at="elbow", force_N=push))
    error, off = _circle(new(contacts=contacts))
    yield Figure("rcm_error_max_mm", MILLI * error.max(), method=method_of(variant))
    if not variant:
        yield Figure("rcm_error_rms_mm", MILLI * _rms(error))
        yield Figure("rcm_tip_error_max_mm", MILLI * off.max())


def _insertion(test: ClosedLoop, with_fixture: bool = True) -> tuple[Array, float]:
    """Return distances of the true tip from the line, and the depth reached [m]."""
    rig = test.rig
    tool = test.control.tool
    true = rig.truth
    line_m = true.tip_m
    axis = true.rotation[:, 2]
    # A needle in a fixture is held by a hand, so it gets more gain.
    fixture = Fixture(tool.tip_m, tool.rotation, 60.0)
    inwards = tool.axis
    aside = across(test.seed + 2)
    user = TipVelocity((0.0, 0.0, 0.0))
    posture = Posture(rig.home_rad)
    speed_m_s = 0.01
    seconds = INSERTION_m / speed_m_s

    def stack(t_s: float) -> Sequence[Task]:
        speed = speed_m_s * min(t_s / 0.1, (seconds - t_s) / 0.1, 1.0)
        wish = 0.02 * math.sin(2.0 * math.pi * 0.5 * t_s)  # sideways, at 0.5 Hz
        user.rate = speed * inwards + wish * aside
        return (fixture, user, posture) if with_fixture else (user, posture)

    error = test.run(
        seconds, stack, lambda: distance_to_axis_m(rig.truth.tip_m, line_m, axis)
    )
    return error, float((rig.truth.tip_m - line_m) @ axis)


def measure_fixture(new: "NewLoop", job: Job, variant: str) -> Iterator[Figure]:
    """Measure 100 mm of stack-glove along the fixture, and without it.

    A hand on the hub pushes with 5 N across, on and off every second.
    """
    side = across(job.seed + 3)

    def push(t_s: float) -> Array:
        return (
            5.0 if t_s > SETTLE_s and math.floor(t_s - SETTLE_s) % 2 else 0.0
        ) * side

    contacts = [HandOnArm(at="hub", force_N=push)] if variant == "_pushed" else []
    new = partial(new, scenario="stack-glove-constant", contacts=contacts)
    error, travel = _insertion(new())
    method = method_of(variant)
    yield Figure("fixture_error_max_mm", MILLI * error.max(), method=method)
    if variant in ("", "_pushed"):
        yield Figure("fixture_error_rms_mm", MILLI * _rms(error))
    if variant in ("", "_published"):  # what remains of the travel, too
        yield Figure("fixture_travel_mm", MILLI * travel, method=method)
    if not variant:
        error, _ = _insertion(new(), with_fixture=False)
        yield Figure("no_fixture_error_max_mm", MILLI * error.max())


def _turn(test: ClosedLoop) -> float:
    """Return the largest distance of the tip from its rest, per angle [m/rad]."""
    tool = test.control.tool
    start_m = test.rig.truth.tip_m
    motion = DecoupledMotion(tool, GAIN_per_s)
    posture = Posture(test.rig.home_rad)
    axis = np.random.default_rng([test.seed, 5]).standard_normal(3)
    axis /= np.linalg.norm(axis)
    no_speed = np.zeros(3)
    turn_rad = 0.5
    turn_s = 3.0

    def stack(t_s: float) -> Sequence[Task]:
        fraction = min(t_s / turn_s, 1.0)
        rate = turn_rad / turn_s * 30.0 * (fraction * (1.0 - fraction)) ** 2
        motion.move(tool, no_speed, rate * axis, 1.0 / MILLI)
        return motion, posture

    error = test.run(
        turn_s + 0.5,
        stack,
        lambda: float(np.linalg.norm(test.rig.truth.tip_m - start_m)),
    )
    return error.max() / turn_rad


def _rms(error: Array) -> float:
    """Return the root mean square."""
    return float(np.sqrt(np.mean(np.square(error))))


def method_of(variant: str) -> Method:
    """Return whose solver serves the stack of tasks."""
    return "published" if variant == "_published" else "ours"


NewLoop = Callable[..., ClosedLoop]
"""Makes a loop of a case; it takes scenario and contacts."""


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of one case."""
    name, servo = job.case.split()
    kind, mark, variant = name.partition("_")
    variant = mark + variant
    new = partial(
        ClosedLoop,
        servo,
        job,
        has_kinematic_error=variant == "_kinematic",
        solver=solve_published if variant == "_published" else hierarchical,
    )
    if kind == "rcm":
        yield from measure_rcm(new, job, variant)
    elif kind == "fixture":
        yield from measure_fixture(new, job, variant)
    else:
        yield Figure("turn_tip_error_mm_per_rad", MILLI * _turn(new()))
