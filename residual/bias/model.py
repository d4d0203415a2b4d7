"""Model of the bias: what a robot's residual reads without contact.

Section IV of the paper subtracts a constant r_0, which holds only near where it was
taken. Here the bias is a linear model of physical causes with a prior on each
(`BiasModel`), fitted by Bayesian least squares over the free motion before contact. It
extrapolates along the insertion and its covariance says how far. The offset is
subtracted from the observer's output, never inside its integral, so that it does not
fade.
"""

import math
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple, get_args

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from residual.checks.input import check_choice, known_limits
from residual.errors import ConfigurationError
from urdf import Robot

TareKind = Literal["constant", "model"]
"""``constant``: the paper's r_0, one number per joint. ``model``: r_0 and the torque of
a small error of every link's mass and first moments, of the sensors' hysteresis and of
their drift."""

CONSTANT_PRIOR_RATIO = 100.0
"""Prior deviation of the kind ``constant``, relative to that of the offset: practically
any, since its offset stands for all causes."""

PRIOR_NOISE_FRACTION = 1e-3
"""Noise of a single residual before a tare, as a fraction of the effort limit."""

MIN_LINK_MASS_KG = 1e-3
"""Smallest mass of a link that its prior counts with: it keeps deviations positive."""

LINK_PARAMETERS = 4
"""Static parameters of a link: its mass and three first moments."""

INERTIAL_PARAMETERS = 10
"""Parameters of a link in Pinocchio's regressors; the static ones come first."""

SECONDS_PER_MINUTE = 60.0


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasPrior:
    """Standard deviations of what the tare fits, before it has seen data.

    They are properties of a class of arms, not of one recording; fractions are of each
    joint's effort limit, the range of its torque sensor. The sizes of link errors,
    friction, drift and walk are where the tare starts from: the motion corrects them,
    see `residual.bias.fit`.

    Attributes:
        offset_fraction: Constant offset. 1 %: joint-torque sensors of the LWR kind
            start with 0.1 to 1 Nm on joints of 100 to 176 Nm.
        mass_fraction: Error of a link's mass, as a fraction of it. 5 %: two published
            CAD-grade tables of one arm differ by that much.
        com_m: Error of a link's centre of mass [m]. 5 mm, after the same two tables.
        hysteresis_fraction: Hysteresis of the torque sensor, per loop of
            `hysteresis_widths`. 0.01 %: well within the 0.5 % linearity such sensors
            are sold with.
        hysteresis_widths: Half widths of the loops, as fractions of range; several, a
            Prandtl-Ishlinskii model, since the width of a loop is not known beforehand.
        ripple_fraction: Amplitude of the ripple of a joint with a known `gear_ratio`.
        gear_ratio: Of the harmonic drive of each joint, if known: ripple of its torque
            sensor at twice the motor angle is then fitted. Empty if unknown.
        wave_rad: Correlation length of a torque sensor's waviness [rad]. A harmonic
            drive of 160:1 has a ripple of period pi/160 = 0.02 rad: a quarter of that.
        friction_fraction: Coulomb friction of a bearing between torque sensor and link;
            the excess at low speed has the same prior. 0.03 %: a bearing of 50 mm
            radius under 100 N with a friction coefficient of rolling, 0.005, has 0.025
            Nm.
        viscous_fraction_s: Viscous friction there, per rad/s. 0.4 %: an identification
            of a real LWR 4+ found 0.19 to 0.84 Nm s/rad on joints of 38 to 176 Nm.
        stribeck_rad_s: Speed over which friction falls from that at rest to Coulomb
            friction; ball bearings and seals do so within hundredths of a radian per
            second.
        presliding_rad: Half the rotation over which friction reverses, per Maxwell-slip
            element; until then a bearing is a spring. Rolling bearings slide after 5 to
            50 um: at a radius of 50 mm 0.1 to 1 mrad.
        drift_fraction_per_min: Steady drift, and the same for a drift that fades. 0.01
            % a minute, as strain gauges warm up (an ATI Mini45 was seen to drift 0.04 %
            of its range in 4 minutes).
        fading_s: Time constant of the drift that fades; that Mini45 drifted half as
            fast later on.
        walk_fraction_per_sqrt_min: Random walk in addition to the drift.
        resolution_fraction: Least noise assumed, finer than any torque sensor resolves;
            keeps the weights of joints sensible on signals without noise. 0.001 %.
        fallback_effort_Nm: Used where a description gives no effort limit [Nm].

    Raises:
        ConfigurationError: If a number is not finite and positive.
    """

    offset_fraction: float = 0.01
    mass_fraction: float = 0.05
    com_m: float = 0.005
    hysteresis_fraction: float = 1e-4
    hysteresis_widths: tuple[float, ...] = (5e-5, 2e-4, 8e-4)
    ripple_fraction: float = 2e-4
    gear_ratio: tuple[float, ...] = ()
    wave_rad: float = 5e-3
    friction_fraction: float = 3e-4
    viscous_fraction_s: float = 4e-3
    stribeck_rad_s: float = 0.03
    presliding_rad: tuple[float, ...] = (5e-5, 2e-4, 8e-4)
    drift_fraction_per_min: float = 1e-4
    fading_s: float = 120.0
    walk_fraction_per_sqrt_min: float = 3e-5
    resolution_fraction: float = 1e-5
    fallback_effort_Nm: float = 100.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            numbers = np.asarray(getattr(self, name))
            is_real = numbers.dtype.kind in "fiu"
            dimensions = int(
                name in ("hysteresis_widths", "presliding_rad", "gear_ratio")
            )
            if not (
                is_real
                and numbers.ndim == dimensions
                and np.isfinite(numbers).all()
                and (numbers > 0).all()
            ):
                raise ConfigurationError(
                    f"{name} is {getattr(self, name)!r}, expected finite numbers > 0, "
                    "of one number or of a tuple as by default"
                )


class Tare(NamedTuple):
    """A fitted offset: parameters of a `BiasModel`, which robot and settings give.

    Attributes:
        mean: Parameters, offsets first, shape (m,).
        covariance: Of the parameters, shape (m, m).
        noise_Nm2: Covariance of a single residual about the model, shape (n, n).
        scatter_Nm2: Part of its diagonal that the mean of a recorded block removes,
            shape (n,).
        walk_Nm2_per_s: Variance that the sensors' random walk adds in a second, shape
            (n,).
        scale_std: Standard deviation of the torques' scale, relative to it: what the
            motion leaves unknown of it.
    """

    mean: Array
    covariance: Array
    noise_Nm2: Array
    scatter_Nm2: Array
    walk_Nm2_per_s: Array
    scale_std: float = 0.0

    @property
    def kind(self) -> TareKind:
        """``model`` if there are parameters beyond one offset per joint."""
        return "constant" if len(self.mean) == len(self.noise_Nm2) else "model"


@compiled
def all_columns(
    links: Matrix,
    q: Vector,
    states: Matrix,
    age_s: float,
    fading_s: float,
    ripple_per_rad: Vector,
) -> Array:
    """Return H of a `BiasModel`, shape (n, m).

    Args:
        links: Its columns of the links, shape (n, 4 links).
        q: Position [rad], shape (n,).
        states: Of hysteresis and friction, shape (states, n).
        age_s: Age of the tare.
        fading_s: See `BiasPrior`.
        ripple_per_rad: Ripple of every joint's sensor per rotation, shape (n,); of
            length 0 where it is not known.
    """
    joints, link_columns = links.shape
    count = len(states)
    # Behind the columns of the links each parameter has one column per joint.
    own = np.empty((count + (4 if len(ripple_per_rad) else 2), joints))
    own[:count] = states
    own[count] = age_s
    own[count + 1] = -fading_s * math.expm1(-age_s / fading_s)
    if len(ripple_per_rad):
        own[count + 2] = np.sin(ripple_per_rad * q)
        own[count + 3] = np.cos(ripple_per_rad * q)
    own_start = joints + link_columns
    columns = np.zeros((joints, own_start + own.size))
    columns[:, joints:own_start] = links
    for j in range(joints):
        columns[j, j] = 1.0
        for k in range(len(own)):
            columns[j, own_start + k * joints + j] = own[k, j]
    return columns


class BiasModel:
    """Linear model of a residual without contact: ``H(q, states, age) theta``.

    Columns in order: offset per joint; mass and first moments per link (static columns
    of the joint-torque regressor, [18]); then per joint hysteresis, friction, drift
    and, where gear ratios are known, ripple. The constant kind has the first group
    only.

    The states, shape (states, n), are those of `residual.bias.joint_states`: loops of
    hysteresis, friction elements, their excess at low speed, and speed.

    Args:
        robot: The arm with its payload.
        kind: See `TareKind`.
        prior: Sizes of the causes.

    Attributes:
        joints: Number of joints.
        kind: As given.
        prior: As given.
        effort_Nm: Effort limit per joint, shape (n,).
        ripple_per_rad: Ripple of every joint's sensor per rotation, shape (n,); of
            length 0 where no gear ratios are known.
        loops: Number of hysteresis loops.
        elements: Number of friction elements.
        states: Number of states of every joint.
        std: Prior standard deviation of every parameter, shape (m,).
        groups: Parameters of every cause, by its name.
    """

    def __init__(self, robot: Robot, kind: TareKind, prior: BiasPrior) -> None:
        check_choice("tare", kind, get_args(TareKind))
        n = robot.nv
        self.joints = n
        self.kind: TareKind = kind
        self.prior = prior
        self._data = robot.create_data()
        self._model = robot.model
        self._still = np.zeros(n)
        self.effort_Nm = known_limits(robot.effort_limit_Nm, prior.fallback_effort_Nm)
        ratio = prior.gear_ratio if kind == "model" else ()
        if ratio and len(ratio) != n:
            raise ConfigurationError(
                f"gear_ratio has {len(ratio)} numbers, expected {n}: one per joint, or "
                "none"
            )
        self.ripple_per_rad = 2.0 * np.array(ratio, dtype=np.float64)
        self.loops = len(prior.hysteresis_widths)
        self.elements = len(prior.presliding_rad)
        self.states = self.loops + self.elements + 2
        std = self._prior_std()
        self.std = np.concatenate(list(std.values()))
        ends = np.cumsum([len(values) for values in std.values()]).tolist()
        self.groups = dict(zip(std, map(slice, [0, *ends], ends), strict=True))

    def _prior_std(self) -> dict[str, Array]:
        """Return the prior standard deviations of every group of columns, in order."""
        prior = self.prior
        effort = self.effort_Nm
        if self.kind == "constant":
            return {"offset": CONSTANT_PRIOR_RATIO * prior.offset_fraction * effort}
        coulomb = np.tile(prior.friction_fraction * effort, self.elements + 1)
        viscous = prior.viscous_fraction_s * effort
        drift_per_s = prior.drift_fraction_per_min / SECONDS_PER_MINUTE
        std = {
            "offset": prior.offset_fraction * effort,
            "links": self.link_std,
            "hysteresis": np.tile(prior.hysteresis_fraction * effort, self.loops),
            "friction": np.concatenate((coulomb, viscous)),
            "drift": np.tile(drift_per_s * effort, 2),
        }
        if len(self.ripple_per_rad):
            std["sine"] = prior.ripple_fraction * effort
            std["cosine"] = std["sine"]
        return std

    @property
    def link_std(self) -> Array:
        """Prior deviations of mass and first moments, shape (4 links,)."""
        prior = self.prior
        stds: list[float] = []
        for inertia in list(self._model.inertias)[1:]:
            mass = max(inertia.mass, MIN_LINK_MASS_KG)
            moments = mass * np.hypot(
                prior.com_m, prior.mass_fraction * np.abs(inertia.lever)
            )
            stds += [prior.mass_fraction * mass, *moments]
        return np.array(stds)

    def gravity_Nm(self, q: Array) -> Array:
        """Return the torque that holds the arm against gravity, shape (n,)."""
        return pin.computeGeneralizedGravity(self._model, self._data, q)

    def regressor(self, q: Array) -> Array:
        """Return the static torque per mass and first moment, shape (n, 4 links)."""
        return self.moving_regressor(q, self._still, self._still)

    def moving_regressor(self, q: Array, dq: Array, ddq: Array) -> Array:
        """Return the same of a moving arm [rad, rad/s, rad/s^2]."""
        full = pin.computeJointTorqueRegressor(self._model, self._data, q, dq, ddq)
        # For a single joint it comes as a vector.
        by_link = full.reshape(self.joints, -1, INERTIAL_PARAMETERS)
        return by_link[:, :, :LINK_PARAMETERS].reshape(self.joints, -1)

    def columns(self, q: Array, states: Array, age_s: float) -> Array:
        """Return H at a position [rad], states and age of the tare, shape (n, m)."""
        if self.kind == "constant":
            return np.eye(self.joints)
        return all_columns(
            self.regressor(q),
            q,
            states,
            age_s,
            self.prior.fading_s,
            self.ripple_per_rad,
        )

    def bias_Nm(self, tare: Tare, q: Array, states: Array, age_s: float) -> Array:
        """Return the residual without contact, H theta, shape (n,).

        Arguments beside the tare are those of `columns`.
        """
        return self.columns(q, states, age_s).dot(tare.mean)

    def covariance_Nm2(
        self, tare: Tare, q: Array, states: Array, age_s: float
    ) -> Array:
        """Return the covariance of the residual's error after the tare, shape (n, n).

        It has noise, model and drift. Arguments beside the tare are those of `columns`.
        """
        columns = self.columns(q, states, age_s)
        model = columns.dot(tare.covariance).dot(columns.T)
        return model + tare.noise_Nm2 + np.diag(max(age_s, 0.0) * tare.walk_Nm2_per_s)

    @property
    def prior_tare(self) -> Tare:
        """Tare before free motion was recorded: no offset, the prior's covariance."""
        return Tare(
            mean=np.zeros(len(self.std)),
            covariance=np.diag(self.std**2),
            noise_Nm2=np.diag((PRIOR_NOISE_FRACTION * self.effort_Nm) ** 2),
            scatter_Nm2=np.zeros(self.joints),
            walk_Nm2_per_s=self.walk_Nm2_per_s(),
        )

    def walk_Nm2_per_s(self) -> Array:
        """Return the variance that a random walk adds in a second, shape (n,).

        Its size is the prior's.
        """
        walk_per_sqrt_min = self.prior.walk_fraction_per_sqrt_min * self.effort_Nm
        return np.square(walk_per_sqrt_min) / SECONDS_PER_MINUTE


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TareBlocks:
    """Means over short blocks of free motion, one row each.

    Attributes:
        q_rad: Positions, shape (m, n).
        states: Of hysteresis and friction, shape (m, states, n).
        residual_Nm: Residuals before offset removal, shape (m, n).
        torque_Nm: Torques as they were measured, without gravity that was added, as
            late as the residuals, shape (m, n).
        age_s: Time relative to the end of the tare, <= 0, shape (m,).
        scatter_Nm2: Variance of single residuals about their block's mean, shape (n,).
        lag_s: Lag of residuals and torques behind the positions.
    """

    q_rad: Array
    states: Array
    residual_Nm: Array
    torque_Nm: Array
    age_s: Array
    scatter_Nm2: Array
    lag_s: float = 0.0

    @property
    def lagged_q_rad(self) -> Array:
        """Positions as late as the residuals, shape (m, n)."""
        return self.q_rad - self.lag_s * self.states[:, -1]

    def select(self, is_selected: NDArray[np.bool_]) -> "TareBlocks":
        """Return some of the blocks; the selection has the shape (m,)."""
        return replace(
            self,
            q_rad=self.q_rad[is_selected],
            states=self.states[is_selected],
            residual_Nm=self.residual_Nm[is_selected],
            torque_Nm=self.torque_Nm[is_selected],
            age_s=self.age_s[is_selected],
        )
