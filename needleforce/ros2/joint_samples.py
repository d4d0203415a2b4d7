"""Joint states, as messages carry them, to samples in the robot's order."""

from collections import Counter
from fnmatch import fnmatchcase
from typing import Any

import numpy as np

from needleforce.devices import ArmReading
from needleforce.recordings.joint_names import match_joints

NS_PER_S = 10**9


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
        stamp_ns: Time stamp of the latest sample [ns]; 0 before any.
    """

    def __init__(self, joints: tuple[str, ...], pattern: str = "") -> None:
        self._joints = joints
        self._pattern = pattern or "*"
        self._orders: dict[tuple[str, ...], list[int]] = {}
        self._has_velocity: bool | None = None
        self.counts = Counter[str]()
        self.problem = "no joint state has come"
        self.longest_gap_s = 0.0
        self.stamp_ns = 0

    def read(self, message: Any) -> ArmReading | None:
        """Return the sample of a message, or None, with a count, if it has none.

        Its torques are the efforts; its time step is 0 of the first one.
        """
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
        has_velocity = len(message.velocity) == width
        if self._has_velocity is None:
            self._has_velocity = has_velocity
        if len(message.position) != width or (self._has_velocity and not has_velocity):
            self.counts["malformed"] += 1
            return None
        stamp = message.header.stamp
        stamp_ns = stamp.sec * NS_PER_S + stamp.nanosec
        dt_s = self._step_clock(stamp_ns)
        if dt_s is None:
            return None
        self.problem = ""
        self.counts["used"] += 1
        return ArmReading(
            dt_s=dt_s,
            q_rad=np.array(message.position)[order],
            dq_rad_s=np.array(message.velocity)[order] if self._has_velocity else None,
            tau_Nm=np.array(message.effort)[order],
            external_Nm=None,
            missed=0,  # a topic has no cycles that could be counted
            accepts_commands=False,
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
            expected = f"all of {', '.join(self._joints)}"
            if matches:
                patterns = " or ".join(match.pattern for match in matches)
                expected = f"joint_pattern to be one of {patterns}"
            self.problem = (
                f"a joint state names {', '.join(names[:12]) or 'no joint'}; expected "
                f"{expected}"
            )
        self._orders[names] = order
        return order

    def _step_clock(self, stamp_ns: int) -> float | None:
        """Return the time since the sample before; None if the stamp is not newer.

        Of a clock that was set back it is negative: the session reports it.
        """
        if not self.counts["used"]:
            self.stamp_ns = stamp_ns
            return 0.0
        dt_s = (stamp_ns - self.stamp_ns) / NS_PER_S
        # A stamp that is older than its predecessor by more than this is of a clock
        # that was set back, as when a simulation starts anew; up to this it is of a
        # late message.
        max_lateness_s = 1.0
        if -max_lateness_s <= dt_s <= 0.0:
            self.counts["stale"] += 1
            if self.counts["used"] == 1:
                self.problem = "stamps of joint states do not advance"
            return None
        self.stamp_ns = stamp_ns
        self.longest_gap_s = max(self.longest_gap_s, dt_s)
        return dt_s
