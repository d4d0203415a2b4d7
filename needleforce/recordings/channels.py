"""The channels of a log: their names, their units, and their usual column names."""

from collections.abc import Mapping
from dataclasses import dataclass
from math import pi
from typing import NamedTuple

Units = Mapping[str, float]
"""Units that may stand in a file, with their factors to SI; the first is SI."""

_TIME = {"s": 1.0, "ms": 1e-3, "us": 1e-6, "ns": 1e-9}
_ANGLE = {"rad": 1.0, "deg": pi / 180.0}
_ANGULAR_SPEED = {"rad/s": 1.0, "deg/s": pi / 180.0}
_TORQUE = {"Nm": 1.0, "mNm": 1e-3, "Ncm": 1e-2, "kNm": 1e3}
_LENGTH = {"m": 1.0, "cm": 1e-2, "mm": 1e-3, "um": 1e-6, "inch": 0.0254}
_SPEED = {"m/s": 1.0, "cm/s": 1e-2, "mm/s": 1e-3, "um/s": 1e-6}
_FORCE = {"N": 1.0, "mN": 1e-3, "kN": 1e3, "lbf": 4.4482216152605}
_CODE = {"1": 1.0}

FORCE_STATUS = ("ok", "not tared", "initializing", "rejected")
"""What 0, 1, 2, ... of the column `force_status` mean; only the first is a usable
force."""

WORTHLESS = {
    "frozen": 2,
    "joint limit": 8,
    "near singular": 16,
    "model mismatch": 32,
    "tare expired": 64,
    "velocity": 128,
}
"""Bits of the column `force_warnings` that make a force worthless to an identifier."""

UNSMOOTHED = "axial_unsmoothed"
"""The column of the force that `needleforce force` has not smoothed or delayed."""


class UnitSpelling(NamedTuple):
    """How people write a part of a unit.

    Attributes:
        written: In a file.
        meant: In `Units`.
    """

    written: str
    meant: str


_UNIT_SPELLINGS = (
    UnitSpelling("µ", "u"),  # micro sign
    UnitSpelling("μ", "u"),  # Greek letter
    UnitSpelling("°", "deg"),
    UnitSpelling("N·m", "Nm"),
    UnitSpelling("N.m", "Nm"),
    UnitSpelling("N*m", "Nm"),
    UnitSpelling("_per_", "/"),
    UnitSpelling("_", "/"),
)
"""Applied in this order."""


@dataclass(frozen=True, slots=True)
class Channel:
    """One quantity of a log.

    Attributes:
        name: How mappings and options call it, such as `q`.
        key: In a `Log`, with the SI unit, such as `q_rad`.
        units: That may stand in a file, with factors to SI.
        per_joint: One column per joint (2-D) rather than one value (1-D).
        spellings: Usual column names, without unit and number and in lower case.
        meaning: One phrase for help texts.
    """

    name: str
    key: str
    units: Units
    per_joint: bool
    spellings: tuple[str, ...]
    meaning: str

    @property
    def places(self) -> dict[str, str]:
        """What an advice about this channel names: the channel, and its option.

        What only this package writes has no option of its own, only an entry in the
        mapping.
        """
        has_option = not self.name.startswith("force_")
        option = self.name.replace("_", "-") if has_option else "mapping"
        return {"channel": self.name, "option": f"--{option}"}

    @property
    def si_unit(self) -> str:
        """The SI unit of this channel."""
        return next(iter(self.units))


def _joint_channel(
    name: str, key: str, units: Units, spellings: str, meaning: str
) -> Channel:
    """Return a channel of one column per joint; its spellings are words."""
    return Channel(name, key, units, True, tuple(spellings.split()), meaning)


def _single_channel(
    name: str, key: str, units: Units, spellings: str, meaning: str
) -> Channel:
    """Return a channel of one column; its spellings are words."""
    return Channel(name, key, units, False, tuple(spellings.split()), meaning)


_ALL_CHANNELS = (
    _single_channel(
        "time", "t_s", _TIME, "t time timestamp time_stamp stamp", "time stamp"
    ),
    _joint_channel(
        "q",
        "q_rad",
        _ANGLE,
        "q position pos joint_position joint_positions actual_q",
        "joint positions",
    ),
    _joint_channel(
        "dq",
        "dq_rad_s",
        _ANGULAR_SPEED,
        "dq qd qdot q_dot velocity vel joint_velocity joint_velocities actual_qd",
        "joint velocities",
    ),
    _joint_channel(
        "tau",
        "tau_Nm",
        _TORQUE,
        "tau tau_j effort torque joint_torque joint_torques",
        "measured joint torques",
    ),
    _joint_channel(
        "tau_ext",
        "tau_ext_Nm",
        _TORQUE,
        "tau_ext tau_external tau_ext_hat tau_ext_hat_filtered external_torque "
        "external_torques external_joint_torque external_joint_torques",
        "external joint torques as the robot estimates them",
    ),
    _single_channel(
        "depth",
        "depth_m",
        _LENGTH,
        "depth z insertion_depth travel",
        "depth of the needle tip",
    ),
    _single_channel(
        "speed", "speed_m_s", _SPEED, "speed v insertion_speed", "rate of depth"
    ),
    _single_channel(
        "force",
        "force_N",
        _FORCE,
        f"force f fz f_z force_z axial {UNSMOOTHED} axial_force insertion_force",
        "axial force, positive when tissue pushes back",
    ),
    _single_channel(
        "force_std",
        "force_std_N",
        _FORCE,
        "force_std axial_std",
        "standard deviation of the force",
    ),
    _single_channel(
        "force_status",
        "force_status",
        _CODE,
        "force_status",
        "whether the force can be used, as `needleforce force` writes it",
    ),
    _single_channel(
        "force_warnings",
        "force_warnings",
        _CODE,
        "force_warnings",
        "what may be wrong with the force, as `needleforce force` writes it",
    ),
)

CHANNELS = {channel.name: channel for channel in _ALL_CHANNELS}
"""Every channel by the name that mappings use."""


def find_unit(text: str, units: Units) -> str | None:
    """Return the key of `units` that a text such as `mm/s`, `mm_s` or `µs` spells."""
    unit = text.strip()
    for spelling in _UNIT_SPELLINGS:
        unit = unit.replace(spelling.written, spelling.meant)

    return unit if unit in units else None
