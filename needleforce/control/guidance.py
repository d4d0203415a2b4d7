"""Manual guidance: the arm yields to a hand anywhere on it, felt through the joint
residual.

    T dw/dt + w = D^-1 dz(r),    v = w / c,    dz(r) = r - clip(r, -z h, z h)

with r the residual, D a damping per joint, h = f r_max + s sigma a dead zone: a
fraction f of the torque limit and s standard deviations. Without a hand r stays within
h and v is exactly zero, so nothing creeps. Once a hand is felt, by any joint, most of
the dead zone only makes the arm heavy: z falls from 1, and returns when all joints are
within h again.

A stiff hand makes a loop with the arm that swings unless the damping is high, the more
so the later the torques come; and a hand that leads wants it low. So the damping grows
while what is felt swings (compare Landi et al., IROS 2017), and fades:

    d ln c / dt = a max(1 - q / q_0, 0) - b ln c,     q = m^T D m / p,     1 <= c <= c_max
    m = mean of w,   p = mean of w^T D w,   over 0.12 s at most, since the hand was felt

Let the sensor's `SensorConfig.smooth_momentum` be off: smoothing is for an arm that
hardly accelerates; in guidance it turns acceleration into residual, and the arm
chatters at 26 Hz.
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from needleforce.control.errors import SettingError
from needleforce.control.ports import Array
from needleforce.control.tasks import JointVelocity
from residual.checks.input import MOST_PLAUSIBLE, as_float, known_limits
from residual.checks.outliers import UNKNOWN_EFFORT_NM
from urdf import Robot

LAG_s = 0.02
LEAST = 1.6e-3
SIGMAS = 4.0
"""T, f and s. Without a hand r keeps within 0.2 h in 40 s where torques are clean,
0.4 h on FRI."""
# z while a hand is felt, times in which it falls, returns
LEFT = 0.15
OPEN_s = 0.05
CLOSE_s = 0.5
LWR_DAMPING_Nms = (
    3.2,
    3.2,
    1.1,
    1.1,
    0.4,
    0.24,
    0.1,
)  # D per rad: 10 to 25 Ns/m at the hub
STEADY_s = 0.12
STEADY = 0.9
"""Time of the means, and q_0: a hand that begins to lead stays above it, if not by
much."""
RISE_per_s = 30.0
FADE_per_s = 4.0
FIRST = 3.0
MOST = 50.0
"""a, b, c when a hand is first felt, and c_max. With c = 1 at first a hand of 5000 N/m
swings an arm by 30 mm where torques come late; with c_max = 20 the arm runs away from
it."""
HOLD_s = 0.02
"""The last residual stands in for rejected ones for so long, and fades after that: a
hand that lets go looks like a spike, and an arm that stopped at once for it would make
the next one."""
GROWTH_s = 20.0
"""Time over which sigma may grow by e: torques drift slowly since the tare, hands
come at once."""
REST_rad_s = 1e-6
LONGEST_s = 0.1
"""What counts as rest, and the most time that a step stands for: a longer one is a
pause."""


class Guidance:
    """Joint velocities that yield to a hand, as a task that belongs last in a stack.

    With a needle in tissue stack it below `Fixture` and `AxialSpeed(0)`: a push from
    the side shows up along the needle too, and would withdraw it.

    Args:
        robot: The arm; its torque limits set the dead zone.
        damping_Nms_per_rad: D of every joint, shape (n,); None for those of an LWR
            (`lwr...`).

    Raises:
        SettingError: A damping is not positive, or the robot is no LWR and has none.
    """

    def __init__(
        self, robot: Robot, damping_Nms_per_rad: ArrayLike | None = None
    ) -> None:
        given = damping_Nms_per_rad
        if given is None and robot.joint_names[0].startswith("lwr"):
            given = LWR_DAMPING_Nms
        self._damping = np.array(given, dtype=np.float64)
        is_positive = np.isfinite(self._damping).all() and (self._damping > 0.0).all()
        if self._damping.shape != (robot.nv,) or not is_positive:
            what = f"a positive number for each of {robot.nv} joints"
            raise SettingError(f"damping is {given!r}, expected {what}")
        self._least_Nm = LEAST * known_limits(robot.effort_limit_Nm, UNKNOWN_EFFORT_NM)
        self.reset()

    def reset(self) -> None:
        """Rest: call it when guidance begins."""
        self._wish = self._beyond_Nm = self._mean = np.zeros_like(self._damping)
        self._power_W = 0.0
        self._seen = 0.0
        self._heavy = FIRST
        self._zone = 1.0
        self._sigma_Nm = np.full(self._damping.shape, np.inf)
        self._rejected_s = 0.0

    def update(
        self, residual_Nm: Array, sigma_Nm: Array, dt_s: float, *, is_valid: bool = True
    ) -> JointVelocity:
        """The task of the coming cycle. A number that is not finite counts as a
        rejected sample.

        Args:
            residual_Nm: Torque of the environment on the joints,
                `WrenchEstimate.residual`.
            sigma_Nm: Its standard deviation, `VirtualForceSensor.residual_std_Nm`.
            dt_s: Time since the last call.
            is_valid: Whether the residual is of this cycle, `Status.OK`.
        """
        if not 0.0 < as_float(dt_s) < math.inf:
            return JointVelocity(self._wish / self._heavy)
        dt_s = min(dt_s, LONGEST_s)
        # A hand is no contact at the tip: the sensor takes it for an error of its own
        # and widens sigma as the residual grows. What counts is sigma without a hand.
        if is_valid:
            self._sigma_Nm = np.fmin(
                math.exp(dt_s / GROWTH_s) * self._sigma_Nm, sigma_Nm
            )
        zone = self._least_Nm + SIGMAS * self._sigma_Nm
        is_felt = bool(
            (np.abs(residual_Nm) > zone).any()
        )  # not by a number that is not finite
        goal, time_s = (LEFT, OPEN_s) if is_felt else (1.0, CLOSE_s)
        self._zone = goal + math.exp(-dt_s / time_s) * (self._zone - goal)
        zone *= self._zone
        beyond = residual_Nm - np.clip(residual_Nm, -zone, zone)
        kept = math.exp(-dt_s / LAG_s)
        if is_valid and np.abs(beyond).max() < MOST_PLAUSIBLE:
            self._beyond_Nm = beyond
            self._rejected_s = 0.0
        else:
            self._rejected_s += dt_s
            self._beyond_Nm = self._beyond_Nm * (
                kept if self._rejected_s > HOLD_s else 1.0
            )
        wish = self._beyond_Nm / self._damping
        self._wish = wish + kept * (self._wish - wish)
        if not self._beyond_Nm.any() and np.abs(self._wish).max() < REST_rad_s:
            self._wish = np.zeros_like(self._wish)
        if self._wish.any():
            old = math.exp(-dt_s / STEADY_s)
            self._seen = old * self._seen + 1.0 - old
            self._mean = old * self._mean + (1.0 - old) * self._wish
            self._power_W = old * self._power_W + (1.0 - old) * float(
                self._wish**2 @ self._damping
            )
            steady = float(self._mean**2 @ self._damping) / max(
                self._power_W * self._seen, 1e-12
            )
            rate = RISE_per_s * max(1.0 - steady / STEADY, 0.0) - FADE_per_s * math.log(
                self._heavy
            )
            self._heavy = min(max(self._heavy * math.exp(dt_s * rate), 1.0), MOST)
        else:  # nothing is felt, so the next motion is another one
            self._mean = np.zeros_like(self._wish)
            self._power_W = 0.0
            self._seen = 0.0
            self._heavy = max(self._heavy, FIRST)
        return JointVelocity(self._wish / self._heavy)
