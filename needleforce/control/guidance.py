"""Manual guidance: the arm yields to a hand anywhere on it, felt through the joint residual.

    T dv/dt + v = dz(r) / (c D),     dz(r) = r - clip(r, -h, h),     h = f r_max + s sigma

with r the residual, D a damping per joint, h a dead zone: a fraction f of the torque limit and s
standard deviations. Without a hand r stays within h and v is exactly zero, so nothing creeps.
Viscous, without stiffness: the arm stays where it is let go.

A stiff hand makes a loop with the arm that swings unless D is high, and a hand that leads wants it
low. So the damping is light where the motion is steady, and full where it swings:

    c = 1 - (1 - c_0) (m^T D m / p)^16,      m = mean of v,  p = mean of v^T D v,  over 0.12 s
"""

import math

import numpy as np
from numpy.typing import ArrayLike

from needleforce.control.errors import SettingError
from needleforce.control.ports import Array
from needleforce.control.tasks import JointVelocity
from urdf import Robot

LAG_s, LEAST, SIGMAS = 0.02, 2e-3, 4.0
"""T, f and s."""
LWR_DAMPING_Nms = (9.0, 9.0, 4.5, 4.5, 1.8, 1.35, 0.45)
"""D per rad, for the seven joints of an LWR: with half of it the arm runs away from a hand of
2000 N/m."""
LIGHT, STEADY_s, SHARP = 0.4, 0.12, 16.0
"""c_0, the time of the means and their power: the lower or the smaller, the lighter a leading hand,
and the more a stiff one swings as it leads: with 0.1 and 6 a hub at 100 mm/s takes 3 N instead of
5, but pulls at a hand of 2000 N/m with 50 N."""
HOLD_s = 0.02
"""The last residual stands in for rejected ones for so long, and fades after that: a hand that lets
go looks like a spike, and an arm that stopped at once for it would make the next one."""
REST_rad_s = 1e-6


class Guidance:
    """Joint velocities that yield to a hand, as a task that belongs last in a stack.

    With a needle in tissue stack it below `Fixture` and `AxialSpeed(0)`: a push from the side shows
    up along the needle too, and would withdraw it.

    Args:
        robot: The arm; its torque limits set the dead zone.
        damping_Nms_per_rad: D of every joint, shape (n,); those of an LWR where None.

    Raises:
        SettingError: A damping is not positive, or the robot is no LWR and has none.
    """

    def __init__(self, robot: Robot, damping_Nms_per_rad: ArrayLike | None = None) -> None:
        given = LWR_DAMPING_Nms if damping_Nms_per_rad is None else damping_Nms_per_rad
        self._damping = np.array(given, dtype=np.float64)
        is_positive = np.isfinite(self._damping).all() and (self._damping > 0.0).all()
        if self._damping.shape != (robot.nv,) or not is_positive:
            raise SettingError(
                f"damping is {given!r}, expected a positive number for each of {robot.nv} joints"
            )
        self._least_Nm = LEAST * robot.effort_limit_Nm
        self.reset()

    def reset(self) -> None:
        """Rest: call it when guidance begins."""
        self._velocity = self._beyond_Nm = self._mean = np.zeros_like(self._damping)
        self._power_W = 0.0
        self._sigma_Nm, self._rejected_s = np.full(self._damping.shape, np.inf), 0.0

    def update(
        self, residual_Nm: Array, sigma_Nm: Array, dt_s: float, *, is_valid: bool = True
    ) -> JointVelocity:
        """The task of the coming cycle. A number that is not finite counts as a rejected sample.

        Args:
            residual_Nm: Torque of the environment on the joints, `WrenchEstimate.residual`.
            sigma_Nm: Its standard deviation, `VirtualForceSensor.residual_std_Nm`.
            dt_s: Time since the last call.
            is_valid: Whether the residual is of this cycle, `Status.OK`.
        """
        # A hand is no contact at the tip: the sensor takes it for an error of its own and widens
        # sigma as the residual grows. What counts is sigma without a hand.
        self._sigma_Nm = np.fmin(self._sigma_Nm, sigma_Nm)
        zone = self._least_Nm + SIGMAS * self._sigma_Nm
        beyond = residual_Nm - np.clip(residual_Nm, -zone, zone)
        if not 0.0 < dt_s < math.inf:
            return JointVelocity(self._velocity)
        kept = math.exp(-dt_s / LAG_s)
        if is_valid and np.isfinite(beyond).all():
            self._beyond_Nm, self._rejected_s = beyond, 0.0
        else:
            self._rejected_s += dt_s
            self._beyond_Nm = self._beyond_Nm * (kept if self._rejected_s > HOLD_s else 1.0)
        wish = self._beyond_Nm / (self._damping * self._heaviness(dt_s))
        self._velocity = wish + kept * (self._velocity - wish)
        if not self._beyond_Nm.any() and np.abs(self._velocity).max() < REST_rad_s:
            self._velocity = np.zeros_like(self._velocity)
        return JointVelocity(self._velocity)

    def _heaviness(self, dt_s: float) -> float:
        """C of the coming cycle."""
        old = math.exp(-dt_s / STEADY_s)
        self._mean = old * self._mean + (1.0 - old) * self._velocity
        power_W = float(self._velocity**2 @ self._damping)
        self._power_W = old * self._power_W + (1.0 - old) * power_W
        steady_W = float(self._mean**2 @ self._damping)
        return 1.0 - (1.0 - LIGHT) * (steady_W / max(self._power_W, 1e-9)) ** SHARP
