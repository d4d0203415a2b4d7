"""Manual guidance: the arm yields to a hand anywhere on it, felt by its joint residual.

    T_u du/dt + u = D^-1 dz(r),    T dw/dt + w = u,    v = w / c

    dz(r) = r - clip(r, -z h, z h)

with r the residual, D a damping per joint, h = f r_max + s sigma a dead zone: a
fraction f of the torque limit and s standard deviations. Without a hand r stays within
h and v is exactly zero, so nothing creeps. Once a hand is felt, by any joint, most of
the dead zone only makes the arm heavy: z falls from 1, and returns when all joints are
within h again.

A stiff hand makes a loop with the arm that swings unless the damping is high, the more
so the later the torques come; and a hand that leads wants it low. So the damping grows
while what is felt swings (compare Landi et al., IROS 2017), and decays:

    d ln c / dt = a max(1 - q / q_0, 0) - b ln c,   q = m^T D m / p,   1 <= c <= c_max
    m = mean of w,   p = mean of w^T D w,   over 0.12 s at most, since the hand was felt

D comes from the mass matrix M, averaged over the range of the joints, and from the
limits of torque and speed, so that arms of any size yield alike:

    D_i = s (M_ii / tau + e r_max,i / v_max,i)

Let the sensor's `SensorConfig.smooth_momentum` be off: smoothing is for an arm that
hardly accelerates; in guidance it turns acceleration into residual, and the arm
chatters at 26 Hz.
"""

import math

import numpy as np
import pinocchio as pin
from numpy.typing import ArrayLike

from foundation.arrays import Array
from needleforce.control.errors import SettingError, as_vector, require_positive
from needleforce.control.tasks import JointVelocity
from residual.checks.input import MAX_PLAUSIBLE, as_float, known_limits
from residual.checks.outliers import UNKNOWN_EFFORT_NM
from urdf import Robot

LWR_DAMPING_Nms = (3.2, 3.2, 1.1, 1.1, 0.4, 0.24, 0.1)
"""D of an LWR per rad, 10 to 25 Ns/m at the hub."""


def find_damping_of_arm(robot: Robot) -> Array:
    """Return D of every joint at a scale of 1, shape (n,) [Nms/rad]; see the module.

    Raises:
        SettingError: The model has no speed limits.
    """
    speed_rad_s = robot.velocity_limit_rad_s
    if not (np.isfinite(speed_rad_s).all() and (speed_rad_s > 0.0).all()):
        raise SettingError(
            "the robot's model has no speed limits to find a damping from, expected "
            f"damping_Nms_per_rad: a positive number for each of {robot.nv} joints"
        )
    torque_limit_Nm = known_limits(robot.effort_limit_Nm, UNKNOWN_EFFORT_NM)
    # Of so many, within the range of the joints, a turn at most, the mean is taken.
    postures_rad = np.random.default_rng(0).uniform(
        np.maximum(robot.position_lower_rad, -np.pi),
        np.minimum(robot.position_upper_rad, np.pi),
        (500, robot.nv),
    )
    data = robot.create_data()
    inertias = [np.diag(pin.crba(robot.model, data, q)).copy() for q in postures_rad]
    # tau and e of the module, which give an LWR what was found for it by trial, to a
    # factor of 2; e damps wrists, whose mass is next to nothing.
    return np.mean(inertias, axis=0) / 0.8 + 0.012 * torque_limit_Nm / speed_rad_s


class Guidance:
    """Joint velocities that yield to a hand, as a task that belongs last in a stack.

    With a needle in tissue stack it below `Fixture` and `AxialSpeed(0)`: a push from
    the side shows up along the needle too, and would withdraw it.

    Args:
        robot: The arm; its torque limits set the dead zone.
        damping_Nms_per_rad: D of every joint at a scale of 1, shape (n,); None for
            those of the module, and for an LWR (`lwr...`) those found by trial.
        scale: s: 2 makes the arm twice as heavy to lead, and steadier.

    Raises:
        SettingError: A damping or the scale is not positive, or the robot's model has
            no speed limits to find a damping from.
    """

    def __init__(
        self,
        robot: Robot,
        damping_Nms_per_rad: ArrayLike | None = None,
        *,
        scale: float = 1.0,
    ) -> None:
        require_positive({"scale": scale})
        damping = damping_Nms_per_rad
        if damping is None and robot.joint_names[0].startswith("lwr"):
            damping = LWR_DAMPING_Nms
        elif damping is None:
            damping = find_damping_of_arm(robot)
        self._damping_Nms = scale * as_vector(damping, robot.nv, "damping_Nms_per_rad")
        require_positive({"damping_Nms_per_rad": self._damping_Nms.min()})
        torque_limit_Nm = known_limits(robot.effort_limit_Nm, UNKNOWN_EFFORT_NM)
        # Without a hand r keeps within 0.2 h in 40 s where torques are clean, 0.4 h on
        # FRI.
        self._min_zone_Nm = 1.6e-3 * torque_limit_Nm
        self.reset()

    def reset(self) -> None:
        """Rest: call it when guidance begins."""
        self._velocity_rad_s = np.zeros_like(self._damping_Nms)  # w
        self._driven_rad_s = np.zeros_like(self._damping_Nms)  # u
        self._beyond_Nm = np.zeros_like(self._damping_Nms)  # dz(r)
        self._factor = 0.0  # c
        self._forget_swings()
        self._zone = 1.0  # z
        self._sigma_Nm = np.full(self._damping_Nms.shape, np.inf)
        self._rejected_s = 0.0

    def update(
        self, residual_Nm: Array, sigma_Nm: Array, dt_s: float, *, is_valid: bool = True
    ) -> JointVelocity:
        """Return the task of the coming cycle.

        A residual that is not finite counts as rejected.

        Args:
            residual_Nm: Torque of the environment on the joints,
                `WrenchEstimate.residual`.
            sigma_Nm: Its standard deviation, `VirtualForceSensor.residual_std_Nm`.
            dt_s: Time since the last call.
            is_valid: Whether the residual is of this cycle, `Status.OK`.
        """
        if not 0.0 < as_float(dt_s) < math.inf:
            return JointVelocity(self._velocity_rad_s / self._factor)
        dt_s = min(dt_s, 0.1)  # a longer step is a pause
        if is_valid:
            # A hand is no contact at the tip: the sensor takes it for an error of its
            # own and widens sigma as the residual grows. So it may grow slowly only, as
            # torques drift: over 20 s.
            grown_Nm = math.exp(dt_s / 20.0) * self._sigma_Nm
            self._sigma_Nm = np.fmin(grown_Nm, sigma_Nm)
        zone_Nm = self._update_dead_zone(residual_Nm, dt_s)
        # T: shorter lets the noise of the torques through, longer makes the arm feel
        # soft. T_u: the residual holds a part of the arm's own acceleration, a cycle
        # late; without this lag the acceleration follows it so fast that both swing at
        # 250 Hz.
        decay = math.exp(-dt_s / 0.015)
        smoothing = math.exp(-dt_s / 5e-3)
        beyond_Nm = residual_Nm - np.clip(residual_Nm, -zone_Nm, zone_Nm)
        self._rejected_s += dt_s
        if is_valid and np.abs(beyond_Nm).max() < MAX_PLAUSIBLE:
            self._beyond_Nm = beyond_Nm
            self._rejected_s = 0.0
        # A hand that lets go looks like a spike, and an arm that stopped at once for it
        # would make the next one.
        elif self._rejected_s > 0.02:
            self._beyond_Nm = self._beyond_Nm * decay
        wanted_rad_s = self._beyond_Nm / self._damping_Nms
        driven_rad_s = wanted_rad_s + smoothing * (self._driven_rad_s - wanted_rad_s)
        velocity_rad_s = driven_rad_s + decay * (self._velocity_rad_s - driven_rad_s)
        if not self._beyond_Nm.any() and np.abs(velocity_rad_s).max() < 1e-6:
            velocity_rad_s = np.zeros_like(velocity_rad_s)  # that is rest
            driven_rad_s = velocity_rad_s
        self._driven_rad_s = driven_rad_s
        self._velocity_rad_s = velocity_rad_s
        self._damp_swings(velocity_rad_s, dt_s)
        return JointVelocity(velocity_rad_s / self._factor)

    def _update_dead_zone(self, residual_Nm: Array, dt_s: float) -> Array:
        """Open the dead zone where a hand is felt, else close it; return z h, (n,).

        Noise alone passes four sigma once in 16,000 samples of a joint. While a hand is
        felt z is 0.15: the whole dead zone would take 3 N at the hub of a moving arm.
        It opens in 0.05 s, which holds no hand up, and closes in 0.5 s, so that a hand
        that turns round does not meet it again.
        """
        zone_Nm = self._min_zone_Nm + 4.0 * self._sigma_Nm
        # A number that is not finite is no hand: it compares as not larger.
        is_felt = bool((np.abs(residual_Nm) > zone_Nm).any())
        goal = 0.15 if is_felt else 1.0
        time_s = 0.05 if is_felt else 0.5
        self._zone = goal + math.exp(-dt_s / time_s) * (self._zone - goal)
        return zone_Nm * self._zone

    def _damp_swings(self, velocity_rad_s: Array, dt_s: float) -> None:
        """Adapt the factor c to a velocity w of the joints, shape (n,).

        A hand that leads keeps its direction longer than the means' 0.12 s; one that
        begins to lead stays above q_0 = 0.9, if not by much. The damping grows by e in
        33 ms where the motion only swings, before it is large, and decays in 0.25 s.
        With c_max = 20, not 50, the arm runs away from a hand of 5000 N/m where torques
        come late.
        """
        damping_Nms = self._damping_Nms
        if not velocity_rad_s.any():  # the next motion is another one
            self._forget_swings()
            return
        decay = math.exp(-dt_s / 0.12)
        power_W = float(velocity_rad_s**2 @ damping_Nms)
        self._weight = decay * self._weight + 1.0 - decay
        self._mean_rad_s = decay * self._mean_rad_s + (1.0 - decay) * velocity_rad_s
        self._mean_power_W = decay * self._mean_power_W + (1.0 - decay) * power_W
        steady_ratio = float(self._mean_rad_s**2 @ damping_Nms) / max(
            self._mean_power_W * self._weight,
            1e-12,  # finite where nothing moves
        )
        rise_per_s = 30.0 * max(1.0 - steady_ratio / 0.9, 0.0)
        rate_per_s = rise_per_s - 4.0 * math.log(self._factor)
        self._factor = min(max(self._factor * math.exp(dt_s * rate_per_s), 1.0), 50.0)

    def _forget_swings(self) -> None:
        """Begin the means anew, with the damping of a hand that is first felt.

        With c = 1, not 3, a hand of 5000 N/m swings an arm by 30 mm where torques come
        late.
        """
        self._factor = max(self._factor, 3.0)
        self._mean_rad_s = np.zeros_like(self._damping_Nms)  # m
        self._mean_power_W = 0.0  # p
        self._weight = 0.0  # of the samples in the means: 1 once they are full
