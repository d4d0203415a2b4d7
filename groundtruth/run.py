"""The outcome of a simulated insertion: what the robot gave, and apart from it, what was true."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from groundtruth.scenario import Scenario
from urdf import NeedleTool, Robot

Array = NDArray[np.float64]


def _freeze(result: object) -> None:
    for item in fields(result):  # type: ignore[arg-type]
        value = getattr(result, item.name)
        if isinstance(value, np.ndarray):
            value.flags.writeable = False


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals:
    """What a robot and its F/T sensor give, n samples; all that an estimator may see.

    Attributes:
        t_s: Time stamps, shape (n,), increasing; jittered and with gaps on a hard arm.
        q_rad: Joint positions, shape (n, 7).
        dq_rad_s: Joint velocities, shape (n, 7), or None where the interface reports none.
        tau_Nm: Link-side joint torques, shape (n, 7). Row k is the torque held from sample k to the next tick
            (torque alignment ``hold``); at rest it equals the gravity torque.
        ft_wrench: F/T reading in ``ft_sensor`` axes (z along the insertion), shape (n, 6), force N then torque
            Nm: wrench of the environment on the needle plus weight of the needle (so tissue pushing back
            lowers z), minus its inertia.
    """

    t_s: Array
    q_rad: Array
    dq_rad_s: Array | None
    tau_Nm: Array
    ft_wrench: Array

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        _freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Truth:
    """What was true at the same n samples.

    Attributes:
        t_s: True instants of the samples, shape (n,).
        q_rad: Joint positions, shape (n, 7).
        dq_rad_s: Joint velocities, shape (n, 7).
        tau_Nm: Joint torques, held from sample k to the next tick, shape (n, 7).
        external_torque_Nm: Torque of the tissue on the joints, shape (n, 7), mean over the tick that begins at
            sample k: what a momentum observer fed with samples k and k + 1 can at best see.
        axial_N: Force of the tissue against insertion, shape (n,), positive when it pushes back.
        tip_N: Its part at the tip, shape (n,).
        friction_N: Its part along the shaft, shape (n,).
        layer: 0 above the tissue, i in layer i, shape (n,).
        depth_m: Travel of the tip below the surface, negative above, shape (n,); zero if there is no tissue.
        speed_m_s: Its rate, shape (n,).
        rupture_s: Instants at which a boundary gave way, ascending.
    """

    t_s: Array
    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    external_torque_Nm: Array
    axial_N: Array
    tip_N: Array
    friction_N: Array
    layer: NDArray[np.int64]
    depth_m: Array
    speed_m_s: Array
    rupture_s: Array

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        _freeze(self)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Run:
    """One simulated insertion.

    Attributes:
        scenario: What was simulated.
        arm: Name of the arm level.
        seed: Seed of everything drawn.
        robot: The robot as the estimator knows it: nominal links, nominal tool.
        tool: The tool as the estimator knows it.
        signals: What the robot gave.
        truth: What was true.
        tare_end_s: The needle has certainly not met anything before this (a user knows that).
        contact_s: True first contact, None without tissue.
        withdrawn_s: The tip is back above the surface for good, None without tissue.
    """

    scenario: Scenario
    arm: str
    seed: int
    robot: Robot
    tool: NeedleTool
    signals: Signals
    truth: Truth
    tare_end_s: float
    contact_s: float | None
    withdrawn_s: float | None
