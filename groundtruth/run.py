"""The outcome of a simulated insertion: what the robot gave, and apart from it, what was true."""

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray

from groundtruth.rupture import Rupture
from groundtruth.scenario import Scenario
from urdf import NeedleTool, Robot

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Signals:
    """What a robot and its F/T sensor give, n samples; all that an estimator may see.

    Attributes:
        t_s: Time stamps, shape (n,), increasing; jittered and with gaps on a hard arm.
        q_rad: Joint positions, shape (n, 7).
        dq_rad_s: Joint velocities, shape (n, 7), or None where the interface reports none.
        tau_Nm: Link-side joint torques, shape (n, 7). Row k is held from its sample to the next
            tick (torque alignment ``hold``); at rest it equals the gravity torque.
        ft_wrench: F/T reading in ``ft_sensor`` axes (z along the insertion), shape (n, 6), force N,
            then torque Nm: wrench of the environment on the needle plus the needle's weight (so
            tissue that pushes back lowers z), minus its inertia.
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
        tau_Nm: Joint torques, held from each sample to the next tick, shape (n, 7).
        external_torque_Nm: Torque of the tissue on the joints, shape (n, 7), mean over the tick
            that begins at the sample: what a momentum observer can learn from that sample and
            the next.
        axial_N: Force of the tissue on the needle, shape (n,), positive when it pushes back.
        tip_N: Its part at the tip, shape (n,).
        friction_N: Its part along the shaft, shape (n,), negative on the way out.
        layer_friction_N: Share of each layer in it, shape (n, number of layers).
        layer: 0 above the tissue, i in layer i, see `TissueForce`, shape (n,).
        depth_m: Travel of the tip since first contact, negative above, shape (n,); zero where
            there is no tissue.
        speed_m_s: Speed of the tip along the needle, shape (n,).
        ruptures: In the order they happened.
    """

    t_s: Array
    q_rad: Array
    dq_rad_s: Array
    tau_Nm: Array
    external_torque_Nm: Array
    axial_N: Array
    tip_N: Array
    friction_N: Array
    layer_friction_N: Array
    layer: NDArray[np.int64]
    depth_m: Array
    speed_m_s: Array
    ruptures: tuple[Rupture, ...]

    def __post_init__(self) -> None:
        """Make the arrays read-only."""
        _freeze(self)

    @property
    def rupture_s(self) -> Array:
        """Onset of each rupture, shape (number of ruptures,)."""
        return np.array([rupture.onset_s for rupture in self.ruptures], dtype=np.float64)


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
        tare_end_s: The needle has not met anything before this; a user knows that.
        contact_s: True first contact, nan without tissue.
        withdrawn_s: The tip has left the surface on its way out, nan without tissue.
    """

    scenario: Scenario
    arm: str
    seed: int
    robot: Robot
    tool: NeedleTool
    signals: Signals
    truth: Truth
    tare_end_s: float
    contact_s: float
    withdrawn_s: float


def _freeze(result: Signals | Truth) -> None:
    for item in fields(result):
        value = getattr(result, item.name)
        if isinstance(value, np.ndarray):
            value.setflags(write=False)
