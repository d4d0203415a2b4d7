"""Joint states, as messages carry them, to samples in the robot's order."""

from collections import Counter
from fnmatch import fnmatchcase
from typing import Any, NamedTuple

import numpy as np

from foundation.arrays import Array
from needleforce.recordings.joint_names import match_joints

NS_PER_S = 10**9


class JointSample(NamedTuple):
    """Joint signals of one stamp, in the robot's order.

    Attributes:
        stamp_ns: Time stamp of the message [ns].
        dt_s: Time since the sample before [s]; 0 of the first.
        q_rad: Positions, shape (n,).
        dq_rad_s: Velocities, shape (n,); None where the arm sends none.
        effort_Nm: Torques, shape (n,).
    """

    stamp_ns: int
    dt_s: float
    q_rad: Array
    dq_rad_s: Array | None
    effort_Nm: Array


class JointReader:
    """Takes the arm's joints out of `sensor_msgs/JointState` messages, by name.

    Names may have a prefix or suffix that the robot's description lacks. A message of
    other joints is passed by. Whether there are velocities is decided by the first
    message of the arm.

    Args:
        joints: Names of the arm's joints, in its order.
        pattern: That the names must fit; empty for any.

    Attributes:
        counts: What became of the messages: `used`, `other_joints`, `malformed` (fewer
            values than names, or lost velocities), `without_effort`, `stale`.
        problem: Why nothing could be used so far, in a sentence; empty if it could.
        longest_gap_s: Longest time between the stamps of two samples [s].
    """

    def __init__(self, joints: tuple[str, ...], pattern: str = "") -> None:
        self._joints = joints
        self._pattern = pattern or "*"
        self._orders: dict[tuple[str, ...], list[int]] = {}
        self._has_velocity: bool | None = None
        self._latest_ns: int | None = None
        self.counts = Counter[str]()
        self.problem = "no joint state has come"
        self.longest_gap_s = 0.0

    def read(self, message: Any) -> JointSample | None:
        """Return the sample of a message, or None, with a count, if it has none."""
        order = self._find_order(tuple(message.name))
        if not order:
            self.counts["other_joints"] += 1
            return None
        width = len(message.name)
        if len(message.effort) != width:
            self.counts["without_effort"] += 1
            self.problem = (
                f"joint states have {len(message.effort)} efforts of {width} joints; "
                "expected the measured torques, or an external_torque_topic"
            )
            return None
        if self._has_velocity is None:
            self._has_velocity = len(message.velocity) == width
        has_lost_velocity = self._has_velocity and len(message.velocity) != width
        if len(message.position) != width or has_lost_velocity:
            self.counts["malformed"] += 1
            return None
        stamp = message.header.stamp
        stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec
        dt_s = self._step_clock(stamp_ns)
        if dt_s is None:
            return None
        self.problem = ""
        self.counts["used"] += 1
        return JointSample(
            stamp_ns=stamp_ns,
            dt_s=dt_s,
            q_rad=np.array(message.position)[order],
            dq_rad_s=np.array(message.velocity)[order] if self._has_velocity else None,
            effort_Nm=np.array(message.effort)[order],
        )

    def _find_order(self, names: tuple[str, ...]) -> list[int]:
        """Return where the arm's joints stand among names; nothing if they do not."""
        if names in self._orders:
            return self._orders[names]
        matches = [
            match
            for match in match_joints(names, self._joints)
            if all(fnmatchcase(name, self._pattern) for name in match.names)
        ]
        order: list[int] = []
        if len(matches) == 1:
            order = [names.index(name) for name in matches[0].names]
        elif not self.counts["used"]:
            listed = ", ".join(names[:12]) or "no joint"
            expected = f"all of {', '.join(self._joints)}"
            if matches:
                patterns = " or ".join(match.pattern for match in matches)
                expected = f"joint_pattern to be one of {patterns}"
            self.problem = f"a joint state names {listed}; expected {expected}"
        self._orders[names] = order
        return order

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
            self.counts["stale"] += 1
            if self.counts["used"] == 1:
                self.problem = "stamps of joint states do not advance"
            return None
        self._latest_ns = stamp_ns
        self.longest_gap_s = max(self.longest_gap_s, dt_s)
        return dt_s
