"""Joint states, as messages carry them, to samples in the robot's order."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from fnmatch import fnmatchcase
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.recordings.joint_names import match_joints

NS_PER_S = 10**9

MAX_PENDING = 200
"""States that wait for an external torque of their stamp: 0.2 s at 1 kHz."""


class JointMessage(NamedTuple):
    """What a `sensor_msgs/JointState` carries.

    Attributes:
        stamp_ns: Time stamp of its header [ns].
        names: Names of the joints, shape (k,).
        position: Positions [rad or m], shape (k,).
        velocity: Velocities [rad/s or m/s], shape (k,); empty if there are none.
        effort: Torques [Nm or N], shape (k,); empty if there are none.
    """

    stamp_ns: int
    names: tuple[str, ...]
    position: Sequence[float]
    velocity: Sequence[float]
    effort: Sequence[float]


class JointSample(NamedTuple):
    """Joint signals of one stamp, in the robot's order.

    Attributes:
        stamp_ns: Time stamp of the message [ns].
        dt_s: Time since the sample before [s]; 0 of the first.
        q_rad: Positions, shape (n,).
        dq_rad_s: Velocities, shape (n,); None where the arm sends none.
        effort_Nm: Torques, shape (n,); None where they come on another topic.
    """

    stamp_ns: int
    dt_s: float
    q_rad: Array
    dq_rad_s: Array | None
    effort_Nm: Array | None


@dataclass(slots=True)
class MessageCounts:
    """What became of the joint states that came.

    Attributes:
        used: They are samples.
        other_joints: They lack joints of the arm, as those of a gripper do.
        malformed: They lack velocities that came before, or have fewer values than
            names.
        without_effort: They have no torque.
        stale: Not newer than the one before.
        unmatched: Without an external torque of their stamp.
    """

    used: int = 0
    other_joints: int = 0
    malformed: int = 0
    without_effort: int = 0
    stale: int = 0
    unmatched: int = 0

    def __str__(self) -> str:
        """Return one line for people: what is not zero."""
        counts = (f"{value} {name}" for name, value in asdict(self).items() if value)
        return ", ".join(counts).replace("_", " ") or "nothing received"


class JointReader:
    """Takes the arm's joints out of messages, by name, and counts what it leaves out.

    Names may have a prefix or suffix that the robot's description lacks. A message of
    other joints is passed by. Whether there are velocities is decided by the first
    message of the arm.

    Args:
        joints: Names of the arm's joints, in its order.
        pattern: That the names must fit; empty for any.
        needs_effort: Whether a sample has the torques of its message.

    Attributes:
        counts: What became of the messages.
        problem: Why nothing could be used so far, in a sentence; empty if it could.
        longest_gap_s: Longest time between the stamps of two samples [s].
    """

    def __init__(
        self, joints: tuple[str, ...], pattern: str = "", *, needs_effort: bool = True
    ) -> None:
        self._joints = joints
        self._pattern = pattern
        self._needs_effort = needs_effort
        self._orders: dict[tuple[str, ...], list[int]] = {}
        self._has_velocity: bool | None = None
        self._latest_ns: int | None = None
        self.counts = MessageCounts()
        self.problem = "no joint state has come"
        self.longest_gap_s = 0.0

    def read(self, message: JointMessage) -> JointSample | None:
        """Return the sample of a message, or None, with a count, if it has none."""
        order = self._find_order(message.names)
        if not order:
            self.counts.other_joints += 1
            return None
        if not self._is_complete(message):
            return None
        dt_s = self._step_clock(message.stamp_ns)
        if dt_s is None:
            return None
        self.problem = ""
        self.counts.used += 1
        return JointSample(
            stamp_ns=message.stamp_ns,
            dt_s=dt_s,
            q_rad=np.array(message.position)[order],
            dq_rad_s=np.array(message.velocity)[order] if self._has_velocity else None,
            effort_Nm=np.array(message.effort)[order] if self._needs_effort else None,
        )

    def _find_order(self, names: tuple[str, ...]) -> list[int]:
        """Return where the arm's joints stand among names; nothing if they do not."""
        order = self._orders.get(names)
        if order is not None:
            return order
        matches = [
            match
            for match in match_joints(names, self._joints)
            if all(fnmatchcase(name, self._pattern or "*") for name in match.names)
        ]
        order = []
        if len(matches) == 1:
            order = [names.index(name) for name in matches[0].names]
        elif not self.counts.used:
            self.problem = self._describe_names(names, [m.pattern for m in matches])
        self._orders[names] = order
        return order

    def _describe_names(self, names: tuple[str, ...], patterns: list[str]) -> str:
        """Return why the names of a message are not those of one arm."""
        # A message names so many joints.
        max_listed_names = 12
        listed = ", ".join(names[:max_listed_names])
        if patterns:
            return (
                f"the arm's joints may be {' or '.join(patterns)}; expected one of "
                "them as joint_pattern"
            )
        return (
            f"a joint state names {listed or 'no joint'}; expected all of "
            f"{', '.join(self._joints)}"
        )

    def _is_complete(self, message: JointMessage) -> bool:
        """Return whether a message of the arm has all signals; count it if not."""
        width = len(message.names)
        if self._needs_effort and len(message.effort) != width:
            self.counts.without_effort += 1
            self.problem = (
                f"joint states have {len(message.effort)} efforts of {width} joints; "
                "expected the measured torques, or an external_torque_topic"
            )
            return False
        if self._has_velocity is None:
            self._has_velocity = len(message.velocity) == width
        is_whole = len(message.position) == width
        if self._has_velocity:
            is_whole = is_whole and len(message.velocity) == width
        if not is_whole:
            self.counts.malformed += 1
        return is_whole

    def _step_clock(self, stamp_ns: int) -> float | None:
        """Return the time since the sample before; None if the stamp is not newer.

        Of a clock that was set back it is negative: the session reports it.
        """
        if self._latest_ns is None:
            self._latest_ns = stamp_ns
            return 0.0
        dt_s = (stamp_ns - self._latest_ns) / NS_PER_S
        # A stamp that is older than its predecessor by more than this is of a clock
        # that was set back, as when a simulation starts anew; up to this it is of a
        # late message.
        max_lateness_s = 1.0
        if -max_lateness_s <= dt_s <= 0.0:
            self.counts.stale += 1
            if self.counts.used == 1:
                self.problem = "stamps of joint states do not advance"
            return None
        self._latest_ns = stamp_ns
        self.longest_gap_s = max(self.longest_gap_s, dt_s)
        return dt_s


class TorquePairing:
    """Joins samples with the external torques of the same stamp, in whatever order.

    Args:
        joints: Names of the arm's joints, in its order.
        counts: Where samples without a torque are counted.
    """

    def __init__(self, joints: tuple[str, ...], counts: MessageCounts) -> None:
        self._reader = JointReader(joints)
        self._counts = counts
        self._samples: dict[int, JointSample] = {}
        self._torques: dict[int, Array] = {}
        self._latest_ns: int | None = None

    def add_sample(self, sample: JointSample) -> JointSample | None:
        """Return the sample with its torque, or None if that has not come."""
        torque_Nm = self._torques.pop(sample.stamp_ns, None)
        if torque_Nm is None:
            self._samples[sample.stamp_ns] = sample
            if len(self._samples) > MAX_PENDING:
                self._samples.pop(next(iter(self._samples)))
                self._counts.unmatched += 1
            return None
        return self._join(sample, torque_Nm)

    def add_torque(self, message: JointMessage) -> JointSample | None:
        """Return the sample of a torque, or None if that has not come."""
        # Positions do not matter here, and may be missing.
        filled = message._replace(position=message.effort, velocity=())
        torque = self._reader.read(filled)
        if torque is None or torque.effort_Nm is None:
            return None
        sample = self._samples.pop(message.stamp_ns, None)
        if sample is None:
            self._torques[message.stamp_ns] = torque.effort_Nm
            if len(self._torques) > MAX_PENDING:
                self._torques.pop(next(iter(self._torques)))
            return None
        return self._join(sample, torque.effort_Nm)

    def _join(self, sample: JointSample, torque_Nm: Array) -> JointSample:
        """Return a sample with its torque, and the time since the one joined before.

        Samples before it are without a torque and will stay so.
        """
        older = [stamp for stamp in self._samples if stamp < sample.stamp_ns]
        for stamp_ns in older:
            del self._samples[stamp_ns]
        self._counts.unmatched += len(older)
        latest_ns = self._latest_ns
        self._latest_ns = sample.stamp_ns
        dt_s = 0.0
        if latest_ns is not None:
            dt_s = (sample.stamp_ns - latest_ns) / NS_PER_S
        return sample._replace(effort_Nm=torque_Nm, dt_s=dt_s)
