"""Offset removal that lasts: a model of what a robot's residual reads without contact.

Section IV of the paper subtracts a constant r_0, which holds near where it was taken only. Here
the error is a linear model of physical causes with a prior on each (`BiasModel`), fitted by
Bayesian least squares over the free motion before contact. It extrapolates along the insertion
and its covariance says how far. The offset is subtracted from the observer's output, never inside
its integral, so that it does not fade.
"""

from dataclasses import dataclass
from typing import Literal

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from residual.errors import ConfigurationError
from residual.input_validation import known_limits
from urdf import Robot

Array = NDArray[np.float64]
TareKind = Literal["constant", "model"]
"""``constant``: the paper's r_0, one number per joint. ``model``: r_0 and the torque of a small
error of every link's mass and first moments, of the sensors' hysteresis and of their drift."""


@dataclass(frozen=True, slots=True, kw_only=True)
class BiasPrior:
    """Standard deviations of what the tare fits, before it has seen data.

    They are properties of a class of arms, not of one recording; a share is a fraction of each
    joint's effort limit, the range of its torque sensor.

    Attributes:
        offset_share: Constant offset. 1 %: joint-torque sensors of the LWR kind start with
            0.1 to 1 Nm on joints of 100 to 176 Nm.
        mass_share: Error of a link's mass, as a fraction of it. 5 %: two published CAD-grade tables
            of one arm differ by that much.
        com_m: Error of a link's centre of mass [m]. 5 mm, after the same two tables.
        hysteresis_share: Hysteresis of the torque sensor, per loop of `hysteresis_widths`. 0.01 %:
            well within the 0.5 % linearity such sensors are sold with.
        hysteresis_widths: Half widths of the loops, as fractions of range: a Prandtl-Ishlinskii
            model, since the width of a loop is not known beforehand.
        ripple_share: Amplitude of the ripple of a joint with a known `gear_ratio`.
        gear_ratio: Of the harmonic drive of each joint, if known: its torque sensor's ripple then
            goes with twice the motor angle, and is fitted. Empty if unknown.
        wave_rad: Length over which a torque sensor's own waviness changes [rad]. A harmonic drive
            of 160:1 has a ripple of period pi/160 = 0.02 rad: a quarter of that.
        drift_share_per_min: Linear drift. 0.01 % a minute, as strain gauges warm up (an ATI Mini45
            was seen to drift 0.04 % of its range in 4 minutes).
        walk_share_per_sqrt_min: Random walk beside it.
        resolution_share: What no torque sensor resolves; keeps the weights of joints sensible on
            signals without noise. 0.001 %.
        fallback_effort_Nm: Stands in where a description gives no effort limit [Nm].

    Raises:
        ConfigurationError: If a number is not finite and positive.
    """

    offset_share: float = 0.01
    mass_share: float = 0.05
    com_m: float = 0.005
    hysteresis_share: float = 1e-4
    hysteresis_widths: tuple[float, ...] = (5e-5, 1e-4, 2e-4)
    ripple_share: float = 2e-4
    gear_ratio: tuple[float, ...] = ()
    wave_rad: float = 5e-3
    drift_share_per_min: float = 1e-4
    walk_share_per_sqrt_min: float = 3e-5
    resolution_share: float = 1e-5
    fallback_effort_Nm: float = 100.0

    def __post_init__(self) -> None:
        for name in self.__slots__:
            value = getattr(self, name)
            numeric = np.asarray(value)
            if numeric.dtype.kind not in "fiu" or not (
                np.isfinite(numeric).all() and (numeric > 0).all()
            ):
                raise ConfigurationError(f"{name} is {value!r}, expected finite numbers > 0")
        if np.ndim(self.hysteresis_widths) != 1 or np.ndim(self.gear_ratio) != 1:
            raise ConfigurationError(
                "hysteresis_widths and gear_ratio must be tuples of numbers, got "
                f"{self.hysteresis_widths!r} and {self.gear_ratio!r}"
            )


class BiasModel:
    """The linear model of a residual without contact: ``bias = H(q, hysteresis, age) theta``.

    Columns in order: offset per joint; mass and first moments per link (static columns of the
    joint-torque regressor, [18]); hysteresis per joint; drift per joint; where gear ratios are
    known, ripple per joint. The constant kind has the first group only.

    Args:
        robot: The arm with its payload.
        kind: See `TareKind`.
        prior: How large each group may be.

    Raises:
        ConfigurationError: For an unknown kind.
    """

    def __init__(self, robot: Robot, kind: TareKind, prior: BiasPrior) -> None:
        if kind not in ("constant", "model"):
            raise ConfigurationError(f"tare is {kind!r}, expected 'constant' or 'model'")
        self.joints = robot.nv
        self.kind: TareKind = kind
        self.prior = prior
        self._model, self._data = robot.model, robot.create_data()
        self._still = np.zeros(robot.nv)
        self.effort_Nm = known_limits(robot.effort_limit_Nm, prior.fallback_effort_Nm)
        bodies = self._model.njoints - 1
        self._static = np.concatenate([10 * k + np.arange(4) for k in range(bodies)])
        ratio = prior.gear_ratio if kind == "model" else ()
        if ratio and len(ratio) != robot.nv:
            raise ConfigurationError(
                f"gear_ratio has {len(ratio)} numbers, expected {robot.nv}: one per joint, or none"
            )
        self.ripple_per_rad = 2.0 * np.array(ratio) if ratio else None
        self.loops = len(prior.hysteresis_widths)
        self.half_width_Nm = np.outer(prior.hysteresis_widths, self.effort_Nm)
        self.std = self._prior_std()
        n = robot.nv
        self.groups = {"offset": slice(0, n)}
        if kind == "model":
            sizes = {"links": 4 * bodies, "hysteresis": self.loops * n, "drift": n}
            if self.ripple_per_rad is not None:
                sizes |= {"sine": n, "cosine": n}
            start = n
            for name, size in sizes.items():
                self.groups[name] = slice(start, start + size)
                start += size

    def _prior_std(self) -> Array:
        prior, effort = self.prior, self.effort_Nm
        if self.kind == "constant":
            return 100.0 * prior.offset_share * effort
        links = []
        for inertia in list(self._model.inertias)[1:]:
            mass = max(inertia.mass, 1e-3)
            moment = mass * np.hypot(prior.com_m, prior.mass_share * np.abs(inertia.lever))
            links += [prior.mass_share * mass, *moment]
        return np.concatenate(
            [
                prior.offset_share * effort,
                links,
                *(self.loops * [prior.hysteresis_share * effort]),
                prior.drift_share_per_min / 60.0 * effort,
                *([] if self.ripple_per_rad is None else 2 * [prior.ripple_share * effort]),
            ]
        )

    def gravity_Nm(self, q: Array) -> Array:
        """Torque that holds the arm against gravity [Nm], shape (n,)."""
        return pin.computeGeneralizedGravity(self._model, self._data, q)

    def regressor(self, q: Array) -> Array:
        """Static torque per mass and first moment of every link, shape (n, 4 links)."""
        still = self._still
        full = pin.computeJointTorqueRegressor(self._model, self._data, q, still, still)
        # Of a single joint it comes as a vector.
        return full.reshape(self.joints, -1)[:, self._static]

    def columns(self, q: Array, hysteresis: Array, age_s: float) -> Array:
        """H at a position [rad], hysteresis state (-1 to 1, (loops, n)) and age of the tare [s]."""
        identity = np.eye(self.joints)
        if self.kind == "constant":
            return identity
        loops = [np.diag(loop) for loop in hysteresis]
        columns = [identity, self.regressor(q), *loops, age_s * identity]
        if self.ripple_per_rad is not None:
            angle = self.ripple_per_rad * q
            columns += [np.diag(np.sin(angle)), np.diag(np.cos(angle))]
        return np.concatenate(columns, axis=1)

    def resolution_variance(self) -> Array:
        """Least variance of a residual [Nm^2], shape (n,)."""
        return np.square(self.prior.resolution_share * self.effort_Nm)

    def walk_variance(self, age_s: float) -> Array:
        """Variance that the random walk has added since the tare [Nm^2], shape (n,)."""
        walk = self.prior.walk_share_per_sqrt_min * self.effort_Nm
        return walk**2 * (max(age_s, 0.0) / 60.0)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class TareBlocks:
    """Means over short blocks of free motion, one row each.

    Attributes:
        q_rad: Positions, shape (m, n).
        hysteresis: States of the torques' loops, -1 to 1, shape (m, loops, n), see
            `residual.bias_estimator.play_operator`.
        residual_Nm: Residuals before offset removal, shape (m, n).
        age_s: Time relative to the end of the tare, <= 0, shape (m,).
        scatter_Nm2: Variance of single residuals about their block's mean, shape (n,).
    """

    q_rad: Array
    hysteresis: Array
    residual_Nm: Array
    age_s: Array
    scatter_Nm2: Array

    def split(self, count: int) -> tuple["TareBlocks", "TareBlocks"]:
        """The first ``count`` blocks and the others."""
        return tuple(
            TareBlocks(
                q_rad=self.q_rad[part],
                hysteresis=self.hysteresis[part],
                residual_Nm=self.residual_Nm[part],
                age_s=self.age_s[part],
                scatter_Nm2=self.scatter_Nm2,
            )
            for part in (slice(None, count), slice(count, None))
        )  # type: ignore[return-value]


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Tare:
    """A fitted offset.

    Attributes:
        basis: The linear model.
        mean: Its parameters, shape (m,).
        covariance: Of the parameters, shape (m, m).
        noise_Nm2: Covariance of a single residual about the model, shape (n, n).
    """

    basis: BiasModel
    mean: Array
    covariance: Array
    noise_Nm2: Array

    def __post_init__(self) -> None:
        for array in (self.mean, self.covariance, self.noise_Nm2):
            array.setflags(write=False)

    def bias_Nm(self, q: Array, hysteresis: Array, age_s: float) -> Array:
        """Residual without contact at a configuration, hysteresis and age since the tare, (n,)."""
        groups, mean = self.basis.groups, self.mean
        bias = mean[groups["offset"]]
        if "links" not in groups:
            return bias
        bias = (
            bias
            + self.basis.regressor(q).dot(mean[groups["links"]])
            + (hysteresis * mean[groups["hysteresis"]].reshape(hysteresis.shape)).sum(axis=0)
            + age_s * mean[groups["drift"]]
        )
        if self.basis.ripple_per_rad is not None:
            angle = self.basis.ripple_per_rad * q
            bias += np.sin(angle) * mean[groups["sine"]] + np.cos(angle) * mean[groups["cosine"]]
        return bias

    def covariance_Nm2(self, q: Array, hysteresis: Array, age_s: float) -> Array:
        """Covariance of the residual's error after the tare: noise, model and drift, (n, n)."""
        columns = self.basis.columns(q, hysteresis, age_s)
        model = columns.dot(self.covariance).dot(columns.T)
        walk = np.diag(self.basis.walk_variance(age_s))
        return model + self.noise_Nm2 + walk


def prior_tare(basis: BiasModel) -> Tare:
    """What is known before any free motion was seen: no offset, the prior's covariance."""
    noise = np.diag((1e-3 * basis.effort_Nm) ** 2)
    return Tare(
        basis=basis,
        mean=np.zeros(len(basis.std)),
        covariance=np.diag(basis.std**2),
        noise_Nm2=noise,
    )
