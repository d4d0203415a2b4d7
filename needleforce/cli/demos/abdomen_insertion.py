"""`needleforce demo abdomen`: from a CT to a needle whose ruptures correct the plan.

A segmented torso, registered to the robot by landmarks and touches; a plan to a target
in the liver; a simulated insertion through those tissues, which lie a few millimetres
deeper than the plan says; ruptures found from joint torques, matched with the plan.
Simulation only.
"""

from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from scipy.spatial.transform import Rotation

from groundtruth import Run, Scenario, simulate
from groundtruth.layers import Layer as TissueLayer
from groundtruth.materials import ABDOMEN
from groundtruth.motion import constant_motion
from needleforce import anatomy
from needleforce.anatomy import (
    Labels,
    Layer,
    PlanMatch,
    PlanState,
    Registration,
    Structure,
)
from needleforce.cli.demos.abdomen_plan import (
    FRONT,
    Array,
    inside_body,
    plan_path,
    read_torso,
    thick_layers,
)
from needleforce.cli.terminal import Progress
from needleforce.scene.state_ring import FIELDS, view_row
from needleforce.session import InsertionSession, SessionEstimate
from urdf import Robot

SHIFT_STD_m = 3e-3  # How far organs lie from where the CT saw them, along the needle


TOUCHES = 100


TOUCH_STD_m = 0.5e-3


LANDMARKS = 5


SPEED_m_s = 4e-3


STANDOFF_m = 15e-3


BEYOND_m = 12e-3


class Insertion(NamedTuple):
    """What the demonstration has done.

    Attributes:
        entry_m: Of the plan, in the model.
        rough: By landmarks.
        fine: By touches.
        truth: True rotation and shift from the model to the robot.
        shift_m: By which everything lies deeper along the needle than planned.
        depth_m: Of the tip below the planned entry, per row.
        states: After each rupture: its depth, what is known.
        stop_m: Depth at which the plan, corrected, has the target.
        rows: As the scene takes them.
        entry_in_base_m: Where the needle meets the planned entry.
        axis: Of the needle there.
    """

    labels: Labels
    entry_m: Array
    target_m: Array
    plan: list[Layer]
    rough: Registration
    fine: Registration
    truth: tuple[Array, Array]
    shift_m: float
    depth_m: Array
    force_N: Array
    tip_N: Array
    states: list[tuple[float, PlanState]]
    stop_m: float
    robot: Robot
    rows: Array
    entry_in_base_m: Array
    axis: Array

    @property
    def length_m(self) -> float:
        """From entry to target, as planned."""
        return float(np.linalg.norm(self.target_m - self.entry_m))

    @property
    def errors_m(self) -> tuple[float, float]:
        """How far from the target the tip stops: by the plan alone, corrected.

        The shift lies along the needle; what registration errs by across it stays in
        both.
        """
        truth = self.truth[0] @ self.target_m + self.truth[1]
        axis = self.truth[0] @ (self.target_m - self.entry_m) / self.length_m
        wrong = self.fine.to_robot(self.target_m) - truth
        across = float(np.linalg.norm(wrong - (wrong @ axis) * axis))
        true = self.length_m + self.shift_m
        by_plan, corrected = np.hypot(
            [self.length_m - true, self.stop_m - true], across
        ).tolist()
        return by_plan, corrected


def register(
    labels: Labels, entry_m: Array, truth: tuple[Array, Array], rng: np.random.Generator
) -> tuple[Registration, Registration]:
    """Register by landmarks, and by touches of the skin around the entry, with a
    pointer.

    Where the touches cannot register (a torso that could spin), it is the landmarks
    twice.
    """
    body = [inside_body(labels).astype(np.uint8)]
    skin = Labels.of(body, labels.grid, [Structure.named("skin", 1)]).surfaces()["skin"]
    front = skin.vertices_m[
        skin.vertices_m @ FRONT > np.quantile(skin.vertices_m @ FRONT, 0.4)
    ]
    marks = front[_spread(front, LANDMARKS, rng)]
    robot = marks @ truth[0].T + truth[1] + 1e-3 * rng.normal(size=marks.shape)
    rough = anatomy.fit_landmarks(marks, robot, std_m=1.5e-3, is_std_known=True)
    near = front[np.linalg.norm(front - entry_m, axis=1) < 0.25]
    touched = near[rng.choice(len(near), TOUCHES)] + TOUCH_STD_m * rng.normal(
        size=(TOUCHES, 3)
    )
    slipped = rng.random(TOUCHES) < 0.1
    touched[slipped] += rng.uniform(5e-3, 20e-3, (int(slipped.sum()), 1)) * FRONT
    try:
        return rough, anatomy.fit_surface(skin, touched @ truth[0].T + truth[1], rough)
    except anatomy.RegistrationError:
        return rough, rough


def _spread(points: Array, count: int, rng: np.random.Generator) -> list[int]:
    """Indices of points far from each other."""
    chosen = [int(rng.integers(len(points)))]
    far = np.full(len(points), np.inf)
    for _ in range(count - 1):
        far = np.minimum(far, np.linalg.norm(points - points[chosen[-1]], axis=1))
        chosen.append(int(np.argmax(far)))
    return chosen


def tissue(plan: list[Layer]) -> tuple[TissueLayer, ...]:
    """Layers of the simulation as thick as those of the plan, and one behind the
    target.
    """
    fat, muscle, liver = ABDOMEN
    kinds = {"liver": liver, "fat": fat, "cavity": fat}
    thick_m = np.array([layer.exit_m - layer.entry_m for layer in plan])
    thick_m[-1] += 2.0 * BEYOND_m
    return tuple(
        replace(kinds.get(layer.name, muscle), name=layer.name, thickness_m=each_m)
        for layer, each_m in zip(plan, thick_m.tolist(), strict=True)
    )


def insert(
    folder: Path | None, seed: int, progress: Progress = lambda fraction: None
) -> Insertion:
    """Plan, register, insert, and let ruptures correct the plan."""
    rng = np.random.default_rng(seed)
    labels = read_torso(folder, rng)
    entry, target = plan_path(labels, "liver", rng)
    plan = thick_layers(labels.layers_along(entry, target))
    turn = Rotation.from_euler("x", 90.0 + 5.0 * rng.normal(), degrees=True).as_matrix()
    truth = turn, np.array([0.6, 0.0, 0.3]) + 0.02 * rng.normal(size=3)
    rough, fine = register(labels, entry, truth, rng)
    axis = truth[0] @ ((target - entry) / np.linalg.norm(target - entry))
    wrong = float((truth[0] @ target + truth[1] - fine.to_robot(target)) @ axis)
    shift = wrong + SHIFT_STD_m * float(rng.normal())
    progress(0.2)
    layers = tissue(plan)
    length = float(np.linalg.norm(target - entry))
    motion = constant_motion(
        speed_m_s=SPEED_m_s, depth_m=length + BEYOND_m, standoff_m=STANDOFF_m
    )
    scenario = Scenario(
        id="abdomen", title="the plan's tissues", layers=layers, motion=motion
    )
    run = simulate(scenario, "clean", seed, lambda part: progress(0.2 + 0.6 * part))
    std = float(np.hypot(fine.std_along_m(axis, target), SHIFT_STD_m))
    followed = _followed(run, PlanMatch(plan, std), shift, length)
    return Insertion(labels, entry, target, plan, rough, fine, truth, shift, **followed)


def _followed(
    run: Run, match: PlanMatch, shift_m: float, length_m: float
) -> dict[str, Any]:
    """The session over the run's signals, its ruptures matched with the plan: the
    other fields.
    """
    signals = run.signals
    true = run.truth
    session = InsertionSession(run.robot)
    velocity = (
        signals.dq_rad_s if signals.dq_rad_s is not None else [None] * len(signals.t_s)
    )
    rows = []
    states = []
    last_s = signals.t_s[0]
    stop = None
    entry_m = 0.0
    start_m = np.zeros(3)
    axis = np.zeros(3)
    for k, (t_s, q, dq, tau) in enumerate(
        zip(signals.t_s, signals.q_rad, velocity, signals.tau_Nm, strict=True)
    ):
        now = session.update(q, dq, tau, t_s - last_s)
        last_s = t_s
        if not session.tared and t_s > run.tare_end_s:
            session.tare()
            # The robot knows where its tip is, and where the planned entry; the tissue
            # lies deeper by what nobody knows.
            entry_m = -float(true.depth_m[k]) - shift_m
            start_m, axis = session.snapshot().zero
            session.follow(match, start_m + entry_m * axis)
            continue
        if now.plan is None or t_s > run.scenario.motion.insertion_end_s:
            continue
        is_event = _took_event(now, entry_m, states)
        if k % 20 == 0 or is_event:
            rows.append(view_row(now, q))
        if stop is None and now.depth_m - entry_m >= length_m + now.plan.offset_m:
            stop = now.depth_m - entry_m
    table = np.array(rows)
    depth = table[:, FIELDS.index("depth_m")] - entry_m
    return {
        "depth_m": depth,
        "force_N": table[:, FIELDS.index("force_N")],
        "tip_N": table[:, FIELDS.index("tip_N")],
        "states": states,
        "stop_m": depth[-1] if stop is None else stop,
        "robot": run.robot,
        "rows": table,
        "entry_in_base_m": start_m + entry_m * axis,
        "axis": axis,
    }


def _took_event(
    now: SessionEstimate, entry_m: float, states: list[tuple[float, PlanState]]
) -> bool:
    """Note a rupture, or strike out one that proved false; whether there was either."""
    found = now.identification
    if found.rupture is not None and now.plan is not None:
        states.append((found.rupture.depth_m - entry_m, now.plan))
    if found.retracted is not None:
        wrong_m = found.retracted.depth_m - entry_m
        states[:] = [one for one in states if one[0] != wrong_m]
    return found.rupture is not None or found.retracted is not None
