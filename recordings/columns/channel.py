"""The channels a log may have: names, units, and how their columns are commonly called."""

from collections.abc import Mapping
from dataclasses import dataclass
from types import MappingProxyType

from recordings.columns import units as u


@dataclass(frozen=True, slots=True, kw_only=True)
class Channel:
    """One quantity of a log.

    Attributes:
        name: how mappings and options call it, such as `q`.
        key: its name in a `Log`, with the SI unit, such as `q_rad`.
        units: units accepted in a file, with their factors to SI; the first is SI.
        per_joint: whether it has one column per joint (2-D) rather than one value (1-D).
        spellings: column names, without unit and joint number and in lower case, that are
            recognised when no mapping is given.
        meaning: one phrase for help texts.
    """

    name: str
    key: str
    units: u.Units
    per_joint: bool
    spellings: tuple[str, ...]
    meaning: str

    @property
    def si_unit(self) -> str:
        """The SI unit of this channel."""
        return next(iter(self.units))


def _channel(
    name: str, key: str, units: u.Units, spellings: str, meaning: str, per_joint: bool = False
) -> Channel:
    return Channel(
        name=name,
        key=key,
        units=units,
        per_joint=per_joint,
        spellings=tuple(spellings.split()),
        meaning=meaning,
    )


_ROWS = (
    _channel("time", "t_s", u.TIME, "t time timestamp time_stamp stamp", "time stamp"),
    _channel(
        "q",
        "q_rad",
        u.ANGLE,
        "q position pos joint_position joint_positions actual_q",
        "joint positions",
        per_joint=True,
    ),
    _channel(
        "dq",
        "dq_rad_s",
        u.ANGULAR_SPEED,
        "dq qd qdot q_dot velocity vel joint_velocity joint_velocities actual_qd",
        "joint velocities",
        per_joint=True,
    ),
    _channel(
        "tau",
        "tau_Nm",
        u.TORQUE,
        "tau tau_j effort torque joint_torque joint_torques",
        "measured joint torques",
        per_joint=True,
    ),
    _channel(
        "tau_ext",
        "tau_ext_Nm",
        u.TORQUE,
        "tau_ext tau_external tau_ext_hat tau_ext_hat_filtered external_torque external_torques "
        "external_joint_torque external_joint_torques",
        "external joint torques as the robot estimates them",
        per_joint=True,
    ),
    _channel(
        "depth", "depth_m", u.LENGTH, "depth z insertion_depth travel", "depth of the needle tip"
    ),
    _channel("speed", "speed_m_s", u.SPEED, "speed v insertion_speed", "rate of depth"),
    _channel(
        "force",
        "force_N",
        u.FORCE,
        "force f fz f_z force_z axial axial_force insertion_force",
        "axial force, positive when tissue pushes back",
    ),
    _channel(
        "force_status",
        "force_status",
        u.CODE,
        "force_status",
        "whether the force can be used, as `python -m residual` writes it",
    ),
    _channel(
        "force_cautions",
        "force_cautions",
        u.CODE,
        "force_cautions",
        "what may be wrong with the force, as `python -m residual` writes it",
    ),
)

CHANNELS: Mapping[str, Channel] = MappingProxyType({row.name: row for row in _ROWS})
"""Every channel by the name that mappings use."""
