"""The channels of a log: their names, their units, and their usual column names.

Names of columns are compared in lower case, with `_` for spaces and hyphens, and
without accents.
"""

import re
import unicodedata
from dataclasses import dataclass

from needleforce.recordings.units import (
    ANGLE,
    ANGULAR_SPEED,
    CODE,
    FORCE,
    LENGTH,
    SPEED,
    TIME,
    TORQUE,
    Units,
)

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

UNSMOOTHED_STD = "axial_unsmoothed_std"
"""The column of its standard deviation, without the error of the torques' scale."""


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
        machine_words: What testing machines and other languages call it; these count
            where no column has a usual name.
        words_with_unit: Names that say it only beside one of its units, as
            `Position (mm)` does; these count last.
    """

    name: str
    key: str
    units: Units
    per_joint: bool
    spellings: tuple[str, ...]
    meaning: str
    machine_words: tuple[str, ...] = ()
    words_with_unit: tuple[str, ...] = ()

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

    @property
    def usual_unit(self) -> str:
        """The unit that an example in an advice has."""
        return _USUAL_UNITS.get(self.name, self.si_unit)


_USUAL_UNITS = {"depth": "mm", "speed": "mm/s"}
"""Units in which laboratories write what they do not write in SI units."""


def normalised_name(name: str) -> str:
    """Return a name in lower case without accents, with `_` between its words.

    Words end at spaces, hyphens and capitals: `Axial-Force` and `axialForce` are alike.
    """
    words = re.sub(r"(?<=[a-z])(?=[A-Z])", "_", name)
    decomposed = unicodedata.normalize("NFKD", words)
    letters = "".join(c for c in decomposed if not unicodedata.combining(c))
    return re.sub(r"[\s\-_]+", "_", letters.lower()).strip("_:.%")


def _words(text: str) -> tuple[str, ...]:
    """Return the names in a text, as `normalised_name` writes them."""
    return tuple(map(normalised_name, text.split()))


def _joint_channel(
    name: str, key: str, units: Units, spellings: str, meaning: str, **more: str
) -> Channel:
    """Return a channel of one column per joint; its spellings are words."""
    names = {field: _words(text) for field, text in more.items()}
    return Channel(name, key, units, True, tuple(spellings.split()), meaning, **names)


def _single_channel(
    name: str, key: str, units: Units, spellings: str, meaning: str, **more: str
) -> Channel:
    """Return a channel of one column; its spellings are words."""
    names = {field: _words(text) for field, text in more.items()}
    return Channel(name, key, units, False, tuple(spellings.split()), meaning, **names)


_ALL_CHANNELS = (
    _single_channel(
        "time",
        "t_s",
        TIME,
        "t time timestamp time_stamp stamp",
        "time stamp",
        machine_words="elapsed_time running_time test_time time_elapsed total_time "
        "x_value zeit prüfzeit pruefzeit testzeit messzeit temps tempo tiempo zaman "
        "時間 経過時間 试验时间",
    ),
    _joint_channel(
        "q",
        "q_rad",
        ANGLE,
        "q position pos joint_position joint_positions actual_q",
        "joint positions",
        machine_words="joint_angle joint_angles actual_joint_position "
        "actual_joint_positions measured_joint_position measured_joint_positions "
        "joint_pos",
    ),
    _joint_channel(
        "dq",
        "dq_rad_s",
        ANGULAR_SPEED,
        "dq qd qdot q_dot velocity vel joint_velocity joint_velocities actual_qd",
        "joint velocities",
        machine_words="joint_speed joint_speeds actual_joint_velocity "
        "actual_joint_velocities measured_joint_velocity measured_joint_velocities "
        "joint_vel",
    ),
    _joint_channel(
        "tau",
        "tau_Nm",
        TORQUE,
        "tau tau_j effort torque joint_torque joint_torques",
        "measured joint torques",
        machine_words="joint_effort joint_efforts actual_joint_torque "
        "actual_joint_torques measured_torque measured_torques measured_joint_torque "
        "measured_joint_torques",
    ),
    _joint_channel(
        "tau_ext",
        "tau_ext_Nm",
        TORQUE,
        "tau_ext tau_external tau_ext_hat tau_ext_hat_filtered external_torque "
        "external_torques external_joint_torque external_joint_torques",
        "external joint torques as the robot estimates them",
    ),
    _single_channel(
        "depth",
        "depth_m",
        LENGTH,
        "depth z insertion_depth travel",
        "depth of the needle tip",
        machine_words="displacement disp axial_displacement compressive_displacement "
        "crosshead crosshead_displacement crosshead_position crosshead_travel "
        "crosshead_extension extension compressive_extension tensile_extension "
        "primary_extension stroke distance penetration penetration_depth indentation "
        "needle_displacement needle_depth tip_depth insertion_distance "
        "grip_separation standard_travel standardweg traverse traversenweg verfahrweg "
        "weg hub eindringtiefe einstichtiefe déplacement course allongement corsa "
        "spostamento desplazamiento carrera uzama ストローク 変位 位移",
        words_with_unit="position pos needle_position axial_position height s x",
    ),
    _single_channel(
        "speed",
        "speed_m_s",
        SPEED,
        "speed v insertion_speed",
        "rate of depth",
        words_with_unit="velocity vel crosshead_speed geschwindigkeit vitesse velocità "
        "velocidad",
    ),
    _single_channel(
        "force",
        "force_N",
        FORCE,
        f"force f fz f_z force_z axial {UNSMOOTHED} axial_force insertion_force",
        "axial force, positive when tissue pushes back",
        machine_words="load axial_load compressive_load compression_load tensile_load "
        "load_cell loadcell needle_force normal_force measured_force standard_force "
        "test_force compressive_force standardkraft kraft axialkraft prüfkraft "
        "pruefkraft druckkraft zugkraft last charge forza carico fuerza carga kuvvet "
        "yük 試験力 荷重 载荷",
        words_with_unit="reading",
    ),
    _single_channel(
        "force_std",
        "force_std_N",
        FORCE,
        f"force_std axial_std {UNSMOOTHED_STD}",
        "standard deviation of the force",
    ),
    _single_channel(
        "force_status",
        "force_status",
        CODE,
        "force_status",
        "whether the force can be used, as `needleforce force` writes it",
    ),
    _single_channel(
        "force_warnings",
        "force_warnings",
        CODE,
        "force_warnings",
        "what may be wrong with the force, as `needleforce force` writes it",
    ),
)

CHANNELS = {channel.name: channel for channel in _ALL_CHANNELS}
"""Every channel by the name that mappings use."""
