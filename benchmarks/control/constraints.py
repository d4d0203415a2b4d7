"""What the remote centre holds, in closed loop against true positions.

Remote centre (RCM): the tip follows a circle of 40 mm across, 80 mm below a trocar that
holds the needle with 1000 N/m, with 1 N on the tip across; error is the distance of the
true axis from the point where it was when the centre was set.

S is the stiff inner loop, I joint impedance. With *kinematic error*, the arm's joints
are not quite where the controller's model has them: micrometres on shared kinematics
mean nothing without it.
"""

import math
from collections.abc import Iterator, Sequence

import numpy as np

from benchmarks.control.loop import SERVOS
from benchmarks.jobs import Figure, Job
from foundation.arrays import Array
from groundtruth.plant_model import PLANT_MODELS
from groundtruth.rig_arm import SimulatedArm, with_kinematic_error
from groundtruth.rig_contacts import Contact, HandOnArm, Trocar
from needleforce.control.controller import Controller
from needleforce.control.joint_limits import Limits
from needleforce.control.tasks import Posture, RemoteCentre, TipVelocity

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
CASES = tuple(
    f"{kind} {servo}"
    for kind in ("rcm", "rcm_kinematic", "rcm_elbow")
    for servo in SERVOS
)
"""As it is, with a kinematic error of the arm, and with a hand that pushes."""


def across(seed: int) -> Array:
    """Draw a horizontal direction; the needle points down."""
    angle = np.random.default_rng([seed, 4]).uniform(0.0, 2.0 * math.pi)
    return np.array([math.cos(angle), math.sin(angle), 0.0])


def _circle(
    servo: str, job: Job, contacts: Sequence[Contact], has_kinematic_error: bool
) -> tuple[Array, Array]:
    """Let an arm come to rest, then run the circle.

    Args:
        servo: One of `SERVOS`.
        job: Plant model and seed.
        contacts: Hands and trocar.
        has_kinematic_error: Whether the joints are not where the model has them.

    Returns:
        Errors of the centre and of the tip [m], from the circle's full size on.
    """
    plant = PLANT_MODELS[job.plant]
    rig = SimulatedArm(
        None,
        with_kinematic_error(plant) if has_kinematic_error else plant,
        job.seed,
        servo=SERVOS[servo],
        contacts=contacts,
        standoff_m=5e-3,
    )
    control = Controller(rig.robot, Limits(rig.robot))
    still = [next(rig).q_rad for _ in range(round(1e3 * SETTLE_s))]
    tool = control.tool
    tool.update(np.mean(still[len(still) // 2 :], axis=0))
    true = rig.truth
    centre_m = true.tip_m - BEHIND_TIP_m * true.rotation[:, 2]
    home_m = tool.tip_m
    constraint = RemoteCentre(home_m - BEHIND_TIP_m * tool.axis, GAIN_per_s)
    tip = TipVelocity((0.0, 0.0, 0.0), home_m, 10.0)
    posture = Posture(rig.home_rad)
    start_s = rig.time_s
    error_m: list[float] = []
    off_m: list[float] = []
    for sample in rig:
        t_s = rig.time_s - start_s
        error_m.append(rig.distance_to_axis_m(centre_m))
        if t_s >= FADE_s + PERIOD_s:
            break
        grown = min(t_s / FADE_s, 1.0)
        radius = RADIUS_m * grown**2 * (3.0 - 2.0 * grown)
        growth = RADIUS_m * 6.0 * grown * (1.0 - grown) / FADE_s
        rate = 2.0 * math.pi / PERIOD_s
        out = np.array([math.cos(rate * t_s), math.sin(rate * t_s), 0.0])
        on = np.array([-out[1], out[0], 0.0])
        tip.goal_m = home_m + radius * out
        tip.rate = growth * out + radius * rate * on
        off_m.append(float(np.linalg.norm(rig.truth.tip_m - true.tip_m - radius * out)))
        rig.send(control.update(sample, (constraint, tip, posture)).dq_rad_s)
    whole = slice(round(1e3 * FADE_s), None)
    return np.array(error_m)[whole], np.array(off_m)[whole]


def run(job: Job) -> Iterator[Figure]:
    """Yield the numbers of one case; on the elbow a hand pushes with 30 N.

    The pushes come within 50 ms, for 1 s, every 2 s.
    """
    kind, servo = job.case.split()
    side = across(job.seed)
    force = HandOnArm(
        at="tip", force_N=lambda t_s: min(t_s / (0.5 * SETTLE_s), 1.0) * side
    )
    contacts: list[Contact] = [Trocar(behind_tip_m=BEHIND_TIP_m), force]
    if kind == "rcm_elbow":
        elbow_side = across(job.seed + 1)

        def push(t_s: float) -> Array:
            phase = (t_s - SETTLE_s - FADE_s) % 2.0 if t_s > SETTLE_s + FADE_s else 0.0
            size = min(phase / 0.05, max((1.0 - phase) / 0.05, 0.0), 1.0)
            return 30.0 * size * elbow_side

        contacts.append(HandOnArm(at="elbow", force_N=push))
    error_m, off_m = _circle(servo, job, contacts, kind == "rcm_kinematic")
    yield Figure("rcm_error_max_mm", 1e3 * error_m.max())
    if kind == "rcm":
        yield Figure("rcm_error_rms_mm", 1e3 * np.sqrt(np.mean(error_m**2)))
        yield Figure("rcm_tip_error_max_mm", 1e3 * off_m.max())
