"""Simulate an insertion: the arm drives the needle through tissue, and its sensors report it."""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from groundtruth.arm_level import ArmLevel, arm_level
from groundtruth.arm_plant import ArmPlant, TICK_s, TissueContact
from groundtruth.arm_trace import ArmTrace, drive
from groundtruth.ft_sensor import measured_wrench
from groundtruth.insertion_path import InsertionPath
from groundtruth.joint_reference import joint_reference
from groundtruth.joint_sensors import measured_position, measured_velocity
from groundtruth.plant_bodies import lwr_bodies
from groundtruth.run import Array, Run, Signals, Truth
from groundtruth.sample_clock import received, stamps
from groundtruth.scenario import Scenario
from groundtruth.scenarios import scenario as scenario_named
from groundtruth.tissue_truth import TissueTruth, collect_truth
from groundtruth.tool_motion import scenario_motion, scenario_path
from groundtruth.torque_sensor import measured_torque
from urdf import NeedleTool


def simulate(
    scenario: Scenario | str,
    arm: str = "textbook",
    seed: int = 0,
    progress: Callable[[float], None] | None = None,
) -> Run:
    """Push the needle of a simulated LWR 4+ through a scenario's tissue and back out.

    A scenario without layers moves all joints in free air instead.

    Args:
        scenario: A scenario or the name of a catalogued one.
        arm: Name of the arm level: ``textbook``, ``realistic`` or ``hard``.
        seed: Seed of everything drawn; equal arguments give equal runs.
        progress: Called now and then with the share done, 0 to 1.

    Returns:
        Signals and truth, apart.

    Raises:
        ScenarioError: There is no scenario of that name.
        ArmLevelError: There is no arm level of that name.
        PathError: The needle's line is out of the arm's reach.
        PlantError: The tissue has pushed the arm off its motion.
    """
    chosen = scenario_named(scenario) if isinstance(scenario, str) else scenario
    level = arm_level(arm)
    tool = NeedleTool()
    mass_seed, sensor_seed = np.random.SeedSequence(seed).spawn(2)
    bodies = lwr_bodies(tool, level, np.random.default_rng(mass_seed))
    path = scenario_path(bodies.robot, chosen)
    contact = _contact(path, chosen)
    reference = joint_reference(bodies.model(), scenario_motion(path, chosen), TICK_s)
    trace = drive(ArmPlant(bodies, contact), reference, progress)
    time = np.arange(len(trace.q_rad), dtype=np.float64) * TICK_s
    kept, signals = _sense(trace, time, bodies.robot.effort_limit_Nm, level, sensor_seed)
    tissue = collect_truth(contact.law, time, trace.depth_m, trace.forces)
    return Run(
        scenario=chosen,
        arm=level.name,
        seed=seed,
        robot=bodies.robot,
        tool=tool,
        signals=signals,
        truth=_truth(trace, tissue, time, kept),
        tare_end_s=chosen.motion.tare_end_s,
        contact_s=tissue.contact_s if chosen.layers else float("nan"),
        withdrawn_s=tissue.withdrawn_s if chosen.layers else float("nan"),
    )


def _contact(path: InsertionPath, scenario: Scenario) -> TissueContact:
    """Lay the tissue so that the zero of the scenario's motion is its surface."""
    start = path.transform_start_to_base.translation
    return TissueContact(
        law=scenario.new_tissue(),
        surface_in_base_m=start - scenario.motion.start_m * path.axis_in_base,
        axis_in_base=path.axis_in_base,
    )


def _sense(
    trace: ArmTrace,
    time: Array,
    limit_Nm: Array,
    level: ArmLevel,
    seed: np.random.SeedSequence,
) -> tuple[NDArray[np.intp], Signals]:
    """Pass the true signals through sensors and wire; each of them has its own stream of noise."""
    clock, loss, position, velocity, torque, wrench = map(np.random.default_rng, seed.spawn(6))
    kept = received(len(time), level, loss)
    dq = measured_velocity(trace.dq_rad_s, level, velocity)
    tau = measured_torque(trace.tau_Nm, trace.q_rad, TICK_s, limit_Nm, level, torque)
    return kept, Signals(
        t_s=stamps(time, TICK_s, level, clock)[kept],
        q_rad=measured_position(trace.q_rad, level, position)[kept],
        dq_rad_s=None if dq is None else dq[kept],
        tau_Nm=tau[kept],
        ft_wrench=measured_wrench(trace.ft_wrench, TICK_s, level, wrench)[kept],
    )


def _truth(trace: ArmTrace, tissue: TissueTruth, time: Array, kept: NDArray[np.intp]) -> Truth:
    return Truth(
        t_s=time[kept],
        q_rad=trace.q_rad[kept],
        dq_rad_s=trace.dq_rad_s[kept],
        tau_Nm=trace.tau_Nm[kept],
        external_torque_Nm=trace.external_torque_Nm[kept],
        axial_N=tissue.axial_N[kept],
        tip_N=tissue.tip_N[kept],
        friction_N=tissue.friction_N[kept],
        layer_friction_N=tissue.layer_friction_N[kept],
        layer=tissue.layer[kept],
        depth_m=trace.depth_m[kept],
        speed_m_s=trace.speed_m_s[kept],
        ruptures=tissue.ruptures,
    )
