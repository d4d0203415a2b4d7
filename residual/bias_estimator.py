"""Keeps the tare: records free motion, fits, subtracts, and says how far it may be trusted."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from residual.bias_fit import fit_tare
from residual.bias_model import BiasModel, Tare, TareBlocks, prior_tare
from residual.bias_recorder import RecorderState, TareRecorder
from residual.config import SensorConfig
from residual.errors import TareError
from residual.estimate import FORGOTTEN, TARE_EXPIRED
from residual.input_validation import ROUNDING_S
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

# Which way each torque went last: the state that a torque sensor's hysteresis depends on.


SMOOTHING_S = 0.15
"""Lag of the torque whose trend is followed [s]: its noise is then well below the loop's width."""


def trend_step(
    trend: NDArray[np.float64], change: NDArray[np.float64], half_width: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Play operator: +1 once a signal has risen by the loop's width, -1 once it has fallen by it.

    It remembers at rest, as strain gauges do: friction of a joint would depend on its velocity,
    the hysteresis of its torque sensor depends on the torque.

    Args:
        trend: Before the change, -1 to 1, shape (loops, n).
        change: Of the signal, shape (n,).
        half_width: Half of each loop's width, in the signal's unit, shape (loops, n).

    Returns:
        Trend after the change, -1 to 1, shape (loops, n).
    """
    return np.minimum(np.maximum(trend + change / half_width, -1.0), 1.0)


# Refuses a tare that would hide a contact.


SIGMAS = 5.0
"""A force must exceed this many standard deviations to count as contact."""
SPLITS = (0.1, 0.2, 0.35, 0.55, 0.75, 0.9)
"""Shares of the motion from which the rest is foretold."""
SMOOTHING_BLOCKS = 5
"""A contact lasts: forces are averaged over this many blocks."""


def check_free_of_contact(
    prior: Tare, blocks: TareBlocks, wrench: WrenchEstimator, contact_force_N: float
) -> None:
    """Look for contact in the motion that a tare is to be fitted to.

    Free motion foretells itself: a tare fitted to its beginning must hold for the rest within its
    own standard deviation. A needle that touches something on the way breaks that; one that is in
    contact all the time breaks the prior. The measure is the arm's own misfit, so a coarse model
    does not pass for contact.

    Args:
        prior: What is known before data, see `residual.bias_model.prior_tare`.
        blocks: The motion.
        wrench: Reads the axial force from joint torques; its covariance is overwritten, so it must
            be the guard's own.
        contact_force_N: Smallest force that counts [N].

    Raises:
        TareError: If there is contact, with the force seen.
    """
    force, doubt = _worst_excess(prior, blocks, wrench, contact_force_N)
    for share in SPLITS:
        if force == 0.0 and (known := round(share * len(blocks.age_s))) >= SMOOTHING_BLOCKS:
            early, late = blocks.split(known)
            force, doubt = _worst_excess(
                fit_tare(prior.basis, early), late, wrench, contact_force_N
            )
    if force != 0.0:
        raise TareError(
            f"the sensor reads {force:.2f} N along the needle where 0 +/- {doubt:.2f} N is "
            "expected in free motion: the needle seems to be in contact, or the payload is wrong. "
            "Tare in free air, or force=True if you know better"
        )


def _worst_excess(
    known: Tare, blocks: TareBlocks, wrench: WrenchEstimator, contact_force_N: float
) -> tuple[float, float]:
    """Largest axial force beyond what a tare allows, with its standard deviation; zeros if none."""
    forces, doubts = [], []
    for q, trend, age, residual in zip(
        blocks.q_rad, blocks.trend, blocks.age_s, blocks.residual_Nm, strict=True
    ):
        wrench.set_torque_covariance(known.covariance_Nm2(q, trend, abs(float(age))))
        seen = wrench.estimate(q, residual - known.bias_Nm(q, trend, float(age)))
        forces.append(seen.axial)
        doubts.append(seen.axial_std)
    width = min(SMOOTHING_BLOCKS, len(forces))
    average = np.full(width, 1.0 / width)
    force = np.convolve(forces, average, mode="valid")
    doubt = np.convolve(doubts, average, mode="valid")
    excess = np.abs(force) - np.maximum(contact_force_N, SIGMAS * doubt)
    worst = int(np.argmax(excess))
    return (float(force[worst]), float(doubt[worst])) if excess[worst] > 0.0 else (0.0, 0.0)


MOST_TORQUES = 1000
"""As many samples are kept apart between two renewals at most; then their sum is."""


class TareNumbers(NamedTuple):
    """A fitted `Tare` without its basis, which robot and settings give.

    Attributes:
        mean: See `Tare`.
        covariance: See `Tare`.
        noise_Nm2: See `Tare`.
    """

    mean: NDArray[np.float64]
    covariance: NDArray[np.float64]
    noise_Nm2: NDArray[np.float64]


class OffsetState(NamedTuple):
    """All that an `BiasEstimator` remembers.

    Attributes:
        recorder: Free motion recorded for the next tare.
        tare: The tare in force; None before the first.
        tared: Whether it is the current one.
        tared_s: When it was taken [s].
        now_s: Time since the start [s].
        renewed_s: When trend and offset were renewed last [s].
        due_s: When they are renewed next [s].
        trend: Of the torques, shape (loops, n).
        smooth_torque: Torque whose trend is followed [Nm], shape (n,); None before the first.
        torque_sum: Of the torques since the last renewal [Nm], shape (n,).
        summed: Their number.
        bias: Offset that is subtracted [Nm], shape (n,).
        q: Last position [rad], shape (n,).
        leapt_s: Time in steps longer than `BiasEstimator.LEAP_S` since the tare, or since free
            motion is recorded [s].
    """

    recorder: RecorderState
    tare: TareNumbers | None
    tared: bool
    tared_s: float
    now_s: float
    renewed_s: float
    due_s: float
    trend: NDArray[np.float64]
    smooth_torque: NDArray[np.float64] | None
    torque_sum: NDArray[np.float64]
    summed: int
    bias: NDArray[np.float64]
    q: NDArray[np.float64]
    leapt_s: float = 0.0


class BiasEstimator:
    """Subtracts the residual's error without contact from the observer's output.

    Until the first `tare` the prior stands in: no offset, a large covariance.

    Args:
        robot: The arm with its payload.
        config: Settings of the sensor.
    """

    RENEW_S = 0.02
    """The offset changes with pose and torque, slowly: it is renewed this often."""
    LEAP_S = 60.0
    """A longer time step is a pause or a clock that was set: one step cannot tell which. Drift is
    hundredths of a newton in a minute, newtons in an hour. It counts as a pause, and is told until
    the next tare. Free motion recorded before it is forgotten."""
    BLOCK_LAGS = 2.0
    """Length of a recorded block in lags of the observer: blocks are then nearly independent."""

    def __init__(self, robot: Robot, config: SensorConfig) -> None:
        self._config = config
        self._basis = BiasModel(robot, config.tare, config.prior)
        self._recorder = TareRecorder(
            robot.nv, self._basis.loops, self.BLOCK_LAGS / config.slowest_gain_per_s
        )
        self._joints = robot.nv
        self.reset()

    @property
    def tared(self) -> bool:
        """Whether `tare` has succeeded since the last `reset` or `start_tare_recording`."""
        return self._tared

    @property
    def warning(self) -> str:
        """What a leap has made of the tare, or of the motion recorded for it; empty without one."""
        if self._leapt_s == 0.0:
            return ""
        return TARE_EXPIRED if self._tared else FORGOTTEN

    @property
    def is_fresh(self) -> bool:
        """Whether neither tare nor recorded motion is of any use now."""
        return not self._tared and self._recorder.is_empty

    def follow(self, q: NDArray[np.float64], tau: NDArray[np.float64], dt_s: float) -> bool:
        """Follow position [rad], torque [Nm], both kept, not copied, and time since the last [s].

        Returns:
            Whether trend and offset have been renewed; the covariance may then be read anew.
        """
        self._q = q
        self._now_s += dt_s
        if dt_s > self.LEAP_S:
            self._leap(dt_s)
        self._torques.append(tau)
        if len(self._torques) >= MOST_TORQUES:  # a clock of nanoseconds
            self._forget_torques(self._torque_sum(), self._summed + len(self._torques))
        if self._now_s < self._due_s - ROUNDING_S:
            return False
        self._renew()
        return True

    def _leap(self, dt_s: float) -> None:
        """Tell a leap; a drift fitted to motion on both sides of it would be far off."""
        if not self.is_fresh:
            self._leapt_s += dt_s
        if not self._tared:
            self._recorder.clear()

    def _renew(self) -> None:
        """Renew what changes slowly: the trend of the torques and the offset."""
        dt_s = self._now_s - self._renewed_s
        torque = self._torque_sum() / (self._summed + len(self._torques))
        self._forget_torques(np.zeros(self._joints), 0)
        self._renewed_s, self._due_s = self._now_s, self._now_s + self.RENEW_S
        if self._smooth_torque is None:
            self._smooth_torque = torque
        change = (torque - self._smooth_torque) * (dt_s / (SMOOTHING_S + dt_s))
        self._smooth_torque = self._smooth_torque + change
        self._trend = trend_step(self._trend, change, self._basis.half_width_Nm)
        self._bias = self._tare.bias_Nm(self._q, self._trend, self._age_s)

    def _torque_sum(self) -> NDArray[np.float64]:
        return np.add.reduce([self._summed_torque, *self._torques])

    def _forget_torques(self, sum_Nm: NDArray[np.float64], count: int) -> None:
        """Keep a sum of so many torques only."""
        self._summed_torque, self._summed = sum_Nm, count
        self._torques: list[NDArray[np.float64]] = []

    def record(self, residual: NDArray[np.float64], dt_s: float) -> None:
        """Record one settled residual [Nm] of free motion; ignored once tared."""
        if not self._tared:
            self._recorder.add(self._q, self._trend, residual, self._now_s, dt_s)

    @property
    def offset_Nm(self) -> NDArray[np.float64]:
        """What the residual reads here and now without contact, shape (n,): not to be written."""
        return self._bias

    def covariance_Nm2(self) -> NDArray[np.float64]:
        """Covariance of the corrected residual here and now [Nm^2], shape (n, n)."""
        return self._tare.covariance_Nm2(self._q, self._trend, self._age_s)

    @property
    def _age_s(self) -> float:
        return self._now_s - self._tared_s

    def tare(self, wrench: WrenchEstimator, *, force: bool) -> Tare:
        """Fit the offset to what was recorded.

        Args:
            wrench: Reads axial force, to look for contact.
            force: Take it even where contact is seen.

        Raises:
            TareError: Without new data, or with contact in sight; the tare in force then stays.
        """
        if self._tared:
            raise TareError(
                "already tared, and nothing was recorded since; call "
                "start_tare_recording(), move in free air, then tare() again"
            )
        try:
            blocks = self._recorder.blocks(self._now_s, self._config.tare_window_s)
        except TareError as error:
            raise TareError("; ".join(filter(None, (str(error), self.warning)))) from None
        if not force:
            prior = prior_tare(self._basis)
            check_free_of_contact(prior, blocks, wrench, self._config.contact_force_N)
        fitted = fit_tare(self._basis, blocks)
        self._tare, self._tared, self._tared_s = fitted, True, self._now_s
        self._is_fitted, self._leapt_s = True, 0.0
        self._bias = fitted.bias_Nm(self._q, self._trend, 0.0)
        return fitted

    def start_tare_recording(self) -> None:
        """Forget what was recorded and record anew; the tare in force stays until the next."""
        self._recorder.clear()
        self._tared, self._leapt_s = False, 0.0

    @property
    def q(self) -> NDArray[np.float64]:
        """Position of the last sample [rad], shape (n,): not to be written."""
        return self._q

    @property
    def state(self) -> OffsetState:
        """All that is remembered, as copies."""
        tare = self._tare
        return OffsetState(
            self._recorder.state,
            TareNumbers(tare.mean, tare.covariance, tare.noise_Nm2) if self._is_fitted else None,
            self._tared,
            self._tared_s,
            self._now_s,
            self._renewed_s,
            self._due_s,
            self._trend,
            self._smooth_torque,
            self._torque_sum(),
            self._summed + len(self._torques),
            self._bias,
            self._q.copy(),
            self._leapt_s,
        )

    def restore(self, state: OffsetState) -> None:
        """Go on from a `state` taken earlier with the same robot and settings."""
        self._recorder.restore(state.recorder)
        self._is_fitted = state.tare is not None
        self._tare = prior_tare(self._basis)
        if state.tare is not None:
            self._tare = Tare(basis=self._basis, **state.tare._asdict())
        self._tared, self._tared_s, self._now_s = state.tared, state.tared_s, state.now_s
        self._renewed_s, self._due_s = state.renewed_s, state.due_s
        self._trend, self._smooth_torque = state.trend, state.smooth_torque
        self._forget_torques(state.torque_sum, state.summed)
        self._bias, self._q = state.bias, state.q.copy()
        self._leapt_s = state.leapt_s

    def reset(self) -> None:
        """Forget everything."""
        self._recorder.clear()
        still = np.zeros(self._joints)
        self.restore(
            OffsetState(
                recorder=self._recorder.state,
                tare=None,
                tared=False,
                tared_s=0.0,
                now_s=0.0,
                renewed_s=0.0,
                due_s=0.0,
                trend=np.zeros_like(self._basis.half_width_Nm),
                smooth_torque=None,
                torque_sum=still,
                summed=0,
                bias=still,
                q=still,
            )
        )
