"""Simulate an insertion: the arm drives the needle through the tissue, its sensors report it."""

from collections.abc import Callable

import numpy as np

from groundtruth.arm_level import ArmLevel, arm_level
from groundtruth.arm_plant import ArmPlant, TICK_s, TissueContact
from groundtruth.arm_trace import ArmTrace, drive
from groundtruth.ft_sensor import measured_wrench
from groundtruth.insertion_path import InsertionPath, LWR_POSTURE_rad, insertion_path, needle_down
from groundtruth.joint_excitation import joint_excitation
from groundtruth.joint_reference import JointMotion, joint_reference, motion_along
from groundtruth.joint_sensors import measured_position, measured_velocity
from groundtruth.plant_bodies import PlantBodies, lwr_bodies
from groundtruth.run import Array, Run, Signals, Truth
from groundtruth.sample_clock import received, stamps
from groundtruth.scenario import Scenario
from groundtruth.scenarios import scenario as catalogued
from groundtruth.torque_sensor import measured_torque
from urdf import NeedleTool

FREE_MOTION_s = 20.0
"""Length of the joint motion that follows the tare stroke where there is no tissue."""


def simulate(
    scenario: Scenario | str,
    arm: str = "textbook",
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Push the needle of a simulated LWR 4+ through a scenario's tissue and back out.

    Scenarios without layers replace the insertion by a motion of all joints.

    Args:
        scenario: A scenario or its permanent name.
        arm: Name of the arm level: ``textbook``, ``realistic`` or ``hard``.
        seed: Seed of everything drawn; equal arguments give equal runs.
        progress: Called now and then with the share done, 0 to 1.

    Returns:
        Signals and truth, apart.

    Raises:
        ScenarioError: No scenario of that name.
        ArmLevelError: No arm level of that name.
        PathError: The needle's line is out of the arm's reach.
        PlantError: The tissue has pushed the arm off its motion.
    """
    chosen = catalogued(scenario) if isinstance(scenario, str) else scenario
    level = arm_level(arm)
    masses, sensors = np.random.SeedSequence(seed).spawn(2)
    tool = NeedleTool()
    bodies = lwr_bodies(tool, level, np.random.default_rng(masses))
    path = _path(bodies, chosen)
    plant = ArmPlant(bodies, _contact(path, chosen))
    reference = joint_reference(bodies.model(), _motion(path, chosen), TICK_s)
    trace = drive(plant, reference, progress)
    time = np.arange(len(trace.q_rad)) * TICK_s
    kept, signals = _sense(trace, time, bodies, level, sensors)
    contact_s, withdrawn_s = _contact_interval(trace, time)
    return Run(
        scenario=chosen,
        arm=level.name,
        seed=seed,
        robot=bodies.robot,
        tool=tool,
        signals=signals,
        truth=_truth(trace, time, kept, chosen),
        tare_end_s=chosen.motion.tare_end_s,
        contact_s=contact_s,
        withdrawn_s=withdrawn_s,
    )


def _path(bodies: PlantBodies, scenario: Scenario) -> InsertionPath:
    start = needle_down(bodies.robot, np.array(LWR_POSTURE_rad))
    motion = scenario.motion
    return insertion_path(bodies.robot, start, (0.0, motion.deepest_m - motion.start_m))


def _contact(path: InsertionPath, scenario: Scenario) -> TissueContact | None:
    """Lay the tissue so that the motion's zero is its surface."""
    if not scenario.layers:
        return None
    start = path.transform_start_to_base.translation
    return TissueContact(
        law=scenario.new_tissue(),
        surface_in_base_m=start - scenario.motion.start_m * path.axis_in_base,
        axis_in_base=path.axis_in_base,
    )


def _motion(path: InsertionPath, scenario: Scenario) -> JointMotion:
    motion = scenario.motion
    end_s = motion.duration_s if scenario.layers else motion.tare_end_s
    time = np.arange(round(end_s / TICK_s) + 1) * TICK_s
    travel = motion.position_m(time) - motion.start_m
    along = motion_along(path, travel, motion.speed_m_s(time))
    if scenario.layers:
        return along
    return along.then(joint_excitation(along.q_rad[-1], FREE_MOTION_s, TICK_s))


def _sense(
    trace: ArmTrace,
    time: Array,
    bodies: PlantBodies,
    level: ArmLevel,
    seed: np.random.SeedSequence,
) -> tuple[np.ndarray, Signals]:
    """Pass the true signals through the sensors and the wire; each has its own stream of noise."""
    clock, loss, position, velocity, torque, wrench = map(np.random.default_rng, seed.spawn(6))
    limit = bodies.robot.effort_limit_Nm
    kept = received(len(time), level, loss)
    dq = measured_velocity(trace.dq_rad_s, level, velocity)
    tau = measured_torque(trace.tau_Nm, trace.q_rad, TICK_s, limit, level, torque)
    signals = Signals(
        t_s=stamps(time, TICK_s, level, clock)[kept],
        q_rad=measured_position(trace.q_rad, level, position)[kept],
        dq_rad_s=None if dq is None else dq[kept],
        tau_Nm=tau[kept],
        ft_wrench=measured_wrench(trace.ft_wrench, TICK_s, level, wrench)[kept],
    )
    return kept, signals


def _truth(trace: ArmTrace, time: Array, kept: np.ndarray, scenario: Scenario) -> Truth:
    return Truth(
        t_s=time[kept],
        q_rad=trace.q_rad[kept],
        dq_rad_s=trace.dq_rad_s[kept],
        tau_Nm=trace.tau_Nm[kept],
        external_torque_Nm=trace.external_torque_Nm[kept],
        axial_N=trace.axial_N[kept],
        tip_N=trace.tip_N[kept],
        friction_N=trace.friction_N[kept],
        layer=trace.layer[kept],
        depth_m=trace.depth_m[kept],
        speed_m_s=trace.speed_m_s[kept],
        rupture_s=_ruptures(trace.layer, time, scenario),
    )


def _ruptures(layer: np.ndarray, time: Array, scenario: Scenario) -> Array:
    """First instants beyond each boundary that holds: all but a surface without membrane."""
    count = len(scenario.layers)
    first = 0 if count and scenario.layers[0].membrane is not None else 1
    return np.array([time[layer > i][0] for i in range(first, count + 1) if (layer > i).any()])


def _contact_interval(trace: ArmTrace, time: Array) -> tuple[float | None, float | None]:
    inside = np.flatnonzero(trace.depth_m > 0.0)
    if not len(inside):
        return None, None
    return float(time[inside[0]]), float(time[min(inside[-1] + 1, len(time) - 1)])
