"""Estimates the bias tick by tick: records free motion, fits the tare, follows it."""

import math
from collections.abc import Mapping
from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pinocchio as pin

from foundation.arrays import Array
from foundation.steps import Steps
from residual.bias.fit import FreeMotionFit
from residual.bias.joint_states import joint_states_step
from residual.bias.model import BiasModel, Tare, TareBlocks
from residual.bias.tare_check import check_free_of_contact
from residual.bias.torque_scale import TorqueDiagnosis
from residual.checks.input import ROUNDING_S
from residual.config import SensorConfig
from residual.errors import TareError
from residual.wrench_estimator import WrenchEstimator
from urdf import Robot

MAX_BLOCKS = 400
"""Number of recorded blocks at which the older half is merged in pairs: fitting 400
takes part of a second."""

COVARIANCE_S = 0.25
"""Time after which the covariance is renewed: it changes with pose and age, both
slowly."""

SMOOTHING_S = 0.05
"""Lag of a low-pass for the acceleration, (velocity - lagged velocity) / lag: encoder
noise in it stays below a tenth of the torque sensor's noise, and a motion of 2 Hz loses
a sixth."""


@dataclass(slots=True, eq=False)
class TareRecorder:
    """Sums of residual, position and joint states over short blocks of free motion.

    Memory is bounded: once there are `MAX_BLOCKS`, pairs of neighbours in the older
    half become one; the latest blocks stay short.

    Attributes:
        sums: Per block: number of samples, and the sums of their times [s], positions,
            residuals, squared residuals, torques and states; shape (m, 6 + states, n).
        open: The same of the block that is not complete yet, shape (6 + states, n).
        lagged_torque: Torque as it was measured, without gravity that was added, as
            late as the residual [Nm], shape (n,).
        age_s: Length of that block so far.
    """

    sums: Array
    open: Array
    lagged_torque: Array
    age_s: float = 0.0

    @classmethod
    def of_size(cls, joints: int, states: int) -> Self:
        """Return a recorder that has recorded nothing yet."""
        return cls(
            np.zeros((0, 6 + states, joints)),
            np.zeros((6 + states, joints)),
            np.zeros(joints),
        )

    def follow_torque(self, torque: Array, fraction: Array) -> None:
        """Bring the lagged torque to the end of a time step.

        Args:
            torque: Torque of the sample [Nm], shape (n,).
            fraction: Fraction of the way that it goes in the time step, shape (n,).
        """
        if not (len(self.sums) or self.open[0].any()):
            self.lagged_torque = torque.copy()
        self.lagged_torque = self.lagged_torque + fraction * (
            torque - self.lagged_torque
        )

    def add(
        self, q: Array, states: Array, residual: Array, now_s: float, dt_s: float
    ) -> None:
        """Add a sample to the open block.

        Args:
            q: Position [rad], shape (n,).
            states: Joint states, shape (states, n).
            residual: Residual before offset removal [Nm], shape (n,).
            now_s: Time of the sample.
            dt_s: Time since the sample before.
        """
        count = np.ones_like(q)
        self.open += np.vstack(
            (
                count,
                now_s * count,
                q,
                residual,
                residual * residual,
                self.lagged_torque,
                states,
            )
        )
        self.age_s += dt_s

    def close_block(self) -> None:
        """End the open block; the next sample begins another."""
        self.sums = np.concatenate((self.sums, self.open[None]))
        self.open = np.zeros_like(self.open)
        self.age_s = 0.0
        if len(self.sums) >= MAX_BLOCKS:
            older = self.sums[: MAX_BLOCKS // 2]
            newer = self.sums[MAX_BLOCKS // 2 :]
            self.sums = np.concatenate((older[::2] + older[1::2], newer))

    def blocks(self, now_s: float, window_s: float | None = None) -> TareBlocks:
        """Return the recorded blocks, or those of the last ``window_s``.

        There must be one; the last one is always among them.
        """
        means = self.sums / self.sums[:, :1]
        age_s = means[:, 1, 0] - now_s
        if window_s is not None:
            is_recent = -age_s <= window_s
            is_recent[-1] = True
            means = means[is_recent]
            age_s = age_s[is_recent]
        scatter = np.maximum(means[:, 4] - means[:, 3] ** 2, 0.0)
        return TareBlocks(
            q_rad=means[:, 2],
            states=means[:, 6:],
            residual_Nm=means[:, 3],
            torque_Nm=means[:, 5],
            age_s=age_s,
            # The median, so that a knock in one block does not pass for noise in all.
            scatter_Nm2=np.median(scatter, axis=0),
        )


@dataclass(slots=True, kw_only=True, eq=False)
class TareRequest:
    """What a tare is fitted to; the fit is a function of it, so a state needs no more.

    Attributes:
        blocks: The recorded motion.
        ignore_contact: Whether contacts are not looked for.
        is_external: Whether torques are the robot's own external ones.
        started_s: Time at which it was asked for, from which its age counts.
        leapt_s: Time in long steps until then, see `BiasState.leapt_s`.
        steps_per_tick: Steps of the fit that are done in a tick.
        done: Steps that are done.
    """

    blocks: TareBlocks
    ignore_contact: bool
    is_external: bool
    started_s: float
    leapt_s: float
    steps_per_tick: int
    done: int = 0


@dataclass(slots=True, kw_only=True, eq=False)
class BiasState:
    """State of a `BiasEstimator`.

    Attributes:
        recorder: Free motion recorded for the next tare.
        plays: States of the play operators, see `residual.bias.joint_states`.
        lagged_torque: Torque that they follow [Nm], shape (n,).
        lagged_q: Position that they follow [rad], shape (n,).
        states: States of hysteresis and friction, shape (states, n).
        torque_sum: Sum of the torques since the last renewal [Nm], shape (n,).
        bias: Bias that is subtracted [Nm], shape (n,).
        motion_Nm2: Variance of the residual's error due to motion, shape (n,).
        max_motion_Nm2: Value beyond which the covariance is renewed at once, shape
            (n,).
        covariance_s: When the covariance was renewed last.
        q: Last position [rad], shape (n,).
        dq: Last velocity [rad/s], shape (n,).
        tau: Last torque [Nm], shape (n,).
        smooth_dq: Lagged velocity, for the acceleration [rad/s], shape (n,).
        tare: The tare in force, the prior's before the first.
        started: Whether a sample has come.
        tared: Whether that tare is current: no new recording was started.
        tared_s: When it was taken.
        now_s: Time since the start.
        renewed_s: When states and offset were renewed last.
        due_s: When they are renewed next.
        summed: Number of torques in the sum.
        leapt_s: Time in steps longer than `BiasEstimator.LEAP_S` since the tare, or
            since free motion is recorded.
        request: The tare that is being fitted; None for none.
    """

    recorder: TareRecorder
    plays: Array
    lagged_torque: Array
    lagged_q: Array
    states: Array
    torque_sum: Array
    bias: Array
    motion_Nm2: Array
    max_motion_Nm2: Array
    covariance_s: float = -COVARIANCE_S
    q: Array
    dq: Array
    tau: Array
    smooth_dq: Array
    tare: Tare
    started: bool = False
    tared: bool = False
    tared_s: float = 0.0
    now_s: float = 0.0
    renewed_s: float = 0.0
    due_s: float = 0.0
    summed: int = 0
    leapt_s: float = 0.0
    request: TareRequest | None = None


class BiasEstimator:
    """Subtracts the bias, the residual without contact, from the observer's output.

    Until the first `tare` the prior is used: no offset, a large covariance.

    Attributes:
        block_s: Length of a recorded block.
        memory: Its state, to be read every tick, not to be written; one of the same
            robot and settings may replace it.
        diagnosis: What the motion of the latest tare shows of the torques; None before
            one, of external torques, and of a tare that ignored contact.
    """

    RENEW_S = 0.02
    """Interval at which the bias is renewed: it changes slowly, with pose and
    torque."""

    LEAP_S = 60.0
    """A longer time step is a pause or a clock that was set: one step cannot show
    which. It counts as a pause and is reported until the next tare; free motion
    recorded before it is forgotten. Drift is hundredths of a newton in a minute,
    newtons in an hour."""

    BLOCK_LAGS = 2.0
    """Length of a recorded block in lags of the observer: blocks are then nearly
    independent."""

    def __init__(self, robot: Robot, config: SensorConfig) -> None:
        self._config = config
        self._basis = BiasModel(robot, config.tare, config.prior)
        self.block_s = self.BLOCK_LAGS / config.slowest_gain_per_s
        self._weightless = pin.Model(robot.model)
        self._data = robot.create_data()
        self._weightless.gravity = pin.Motion.Zero()
        self._joints = robot.nv
        self._gain_per_s = np.broadcast_to(config.gain_per_s, robot.nv).astype(float)
        loops_Nm = np.outer(config.prior.hysteresis_widths, self._basis.effort_Nm)
        elements_rad = np.outer(config.prior.presliding_rad, np.ones(robot.nv))
        self._half_widths = np.vstack((loops_Nm, elements_rad))
        self.reset()

    @property
    def warning(self) -> str:
        """Effect of a long time step on tare or recorded motion; empty without one."""
        if self.memory.leapt_s == 0.0:
            return ""
        came = "a time step of minutes has come, a pause or a clock that was set"
        if self.memory.tared:
            return (
                f"since the tare {came}; axial_std holds for a pause: withdraw and "
                "tare again"
            )
        return (
            f"while free motion was recorded {came}; what was recorded before it is "
            "forgotten: move in free air again, then tare"
        )

    @property
    def is_fresh(self) -> bool:
        """Whether there is neither a current tare nor recorded motion."""
        recorder = self.memory.recorder
        return not (self.memory.tared or len(recorder.sums) or recorder.open[0].any())

    def update(self, q: Array, dq: Array, tau: Array, dt_s: float) -> bool:
        """Follow the motion by one sample, and renew the bias when that is due.

        Args:
            q: Position [rad], shape (n,); kept, not copied, like the others.
            dq: Velocity [rad/s], shape (n,).
            tau: Torque [Nm], shape (n,).
            dt_s: Time since the sample before.

        Returns:
            Whether joint states and bias were renewed: the covariance may then be
            renewed, too.
        """
        memory = self.memory
        memory.q = q
        memory.dq = dq
        memory.now_s += dt_s
        if dt_s > self.LEAP_S:
            # A drift fitted to motion before and after such a step would be far off.
            if not self.is_fresh:
                memory.leapt_s += dt_s
            if not memory.tared:
                memory.recorder = TareRecorder.of_size(self._joints, self._basis.states)
        memory.tau = tau
        memory.torque_sum += tau
        memory.summed += 1
        if memory.now_s < memory.due_s - ROUNDING_S:
            return False
        self._renew()
        return True

    def _renew(self) -> None:
        """Renew what changes slowly: joint states, bias and the error by motion."""
        memory = self.memory
        q = memory.q
        dt_s = memory.now_s - memory.renewed_s
        torque = memory.torque_sum / memory.summed
        memory.torque_sum = np.zeros(self._joints)
        memory.summed = 0
        memory.renewed_s = memory.now_s
        memory.due_s = memory.now_s + self.RENEW_S
        if not memory.started:
            memory.lagged_torque[:] = torque
            memory.lagged_q[:] = q
            memory.smooth_dq = memory.dq
            memory.started = True
        if dt_s > 0.0:
            joint_states_step(
                memory.plays,
                memory.lagged_torque,
                memory.lagged_q,
                memory.states,
                q,
                torque,
                self._half_widths,
                self._basis.loops,
                self._basis.prior.stribeck_rad_s,
                dt_s,
            )
        memory.bias = self._basis.bias_Nm(memory.tare, q, memory.states, self._age_s)
        self._renew_motion_error(dt_s)

    def _renew_motion_error(self, dt_s: float) -> None:
        """Renew the variance due to motion, a time after the last renewal."""
        memory = self.memory
        # A tare is recorded in slow motion: it corrects masses and first moments as far
        # as gravity shows them. Torque that accelerates the links stays as uncertain as
        # the prior's masses.
        behind = memory.dq - memory.smooth_dq
        memory.smooth_dq = memory.smooth_dq - math.expm1(-dt_s / SMOOTHING_S) * behind
        motion_Nm = pin.rnea(
            self._weightless, self._data, memory.q, memory.dq, behind / SMOOTHING_S
        )
        memory.motion_Nm2 = np.square(self._basis.prior.mass_fraction * motion_Nm)

    def record(self, residual: Array, dt_s: float) -> None:
        """Record a residual [Nm] of free motion, for the next tare."""
        memory = self.memory
        recorder = memory.recorder
        measured = memory.tau
        if self._config.torque_is_gravity_compensated:
            measured = measured - self._basis.gravity_Nm(memory.q)
        recorder.follow_torque(measured, -np.expm1(-self._gain_per_s * dt_s))
        recorder.add(memory.q, memory.states, residual, memory.now_s, dt_s)
        if recorder.age_s >= self.block_s - ROUNDING_S:
            recorder.close_block()

    @property
    def is_covariance_due(self) -> bool:
        """Whether `covariance_Nm2` may have changed since the last call."""
        memory = self.memory
        if memory.now_s - memory.covariance_s >= COVARIANCE_S - ROUNDING_S:
            return True
        return bool((memory.motion_Nm2 > memory.max_motion_Nm2).any())

    def covariance_Nm2(self) -> Array:
        """Return the covariance of the corrected residual now, shape (n, n)."""
        memory = self.memory
        covariance = self._basis.covariance_Nm2(
            memory.tare, memory.q, memory.states, self._age_s
        )
        covariance += np.diag(memory.motion_Nm2)
        memory.covariance_s = memory.now_s
        # By a tenth more: the covariance is then renewed at once.
        tolerated_growth = 0.1 * covariance.diagonal()
        memory.max_motion_Nm2 = memory.motion_Nm2 + tolerated_growth
        return covariance

    @property
    def tare_error_Nm2(self) -> Array | None:
        """Variance of the torque about the fit that lasts for a block, shape (n,).

        None before the tare.
        """
        memory = self.memory
        if not memory.tared:
            return None
        return memory.tare.noise_Nm2.diagonal() - memory.tare.scatter_Nm2

    @property
    def _age_s(self) -> float:
        return self.memory.now_s - self.memory.tared_s

    def start_tare(
        self, *, ignore_contact: bool, is_external: bool, steps_per_tick: int
    ) -> None:
        """Prepare to fit the offset to the motion recorded so far.

        Args:
            ignore_contact: Do not check for a contact.
            is_external: Whether torques are the robot's own external ones.
            steps_per_tick: Steps of the fit that `continue_tare` does.

        Raises:
            TareError: Without new data; the tare in force then stays.
        """
        memory = self.memory
        if memory.tared:
            raise TareError(
                "already tared, and nothing was recorded since",
                "Call `start_tare_recording`, move in free air, then call "
                "`tare` again.",
            )
        if not len(memory.recorder.sums):
            reason = (
                "no settled free motion has been recorded (less than "
                f"{self.block_s:g} s of it)"
            )
            raise TareError(
                "; ".join(filter(None, (reason, self.warning))),
                "Call `update` in free air first, in steps no longer than "
                "`max_gap_s`, then `tare`.",
            )
        blocks = memory.recorder.blocks(memory.now_s, self._config.tare_window_s)
        if not is_external:
            blocks = replace(blocks, lag_s=1.0 / self._config.slowest_gain_per_s)
        self._work = None
        memory.request = TareRequest(
            blocks=blocks,
            ignore_contact=ignore_contact,
            is_external=is_external,
            started_s=memory.now_s,
            leapt_s=memory.leapt_s,
            steps_per_tick=steps_per_tick,
        )

    def continue_tare(self, wrench: WrenchEstimator) -> bool:
        """Do the steps of a tick; take the tare once it is fitted.

        Args:
            wrench: See `check_free_of_contact`.

        Returns:
            Whether it is fitted.

        Raises:
            TareError: With contact in sight; the tare in force then stays.
        """
        request = self.memory.request
        if request is None:
            return False
        if self._work is None:
            self._work = self._fit_in_steps(request, wrench)
            for _ in range(request.done):  # by what this is a copy of
                next(self._work)
        try:
            for _ in range(request.steps_per_tick):
                next(self._work)
                request.done += 1
        except StopIteration as end:
            self._take(request, *end.value)
            return True
        except BaseException:  # Ctrl-C, too: what was begun cannot go on
            self.cancel_tare()
            raise
        return False

    def cancel_tare(self) -> None:
        """Give up the tare that is being fitted; what was recorded stays."""
        self.memory.request = None
        self._work = None

    def __getstate__(self) -> Mapping[str, object]:
        """Return what a copy needs; it does the steps of a running fit again."""
        return self.__dict__ | {"_work": None}

    def _fit_in_steps(
        self, request: TareRequest, wrench: WrenchEstimator
    ) -> Steps[tuple[Tare, TorqueDiagnosis | None]]:
        """Fit a tare and look for contacts; see `continue_tare`."""
        fit = yield from FreeMotionFit.in_steps(self._basis, request.blocks)
        if request.ignore_contact:
            return fit.tare, None
        diagnosis = yield from check_free_of_contact(
            fit,
            wrench,
            self._config.contact_force_N,
            is_external=request.is_external,
            adds_gravity=self._config.torque_is_gravity_compensated,
        )
        tare = fit.tare
        if diagnosis is not None and tare.kind == "model":
            tare = tare._replace(scale_std=diagnosis.scale_doubt)
        yield  # who takes the tare has work of its own in that tick
        return tare, diagnosis

    def _take(
        self, request: TareRequest, tare: Tare, diagnosis: TorqueDiagnosis | None
    ) -> None:
        """Subtract a fitted tare from now on, as old as its request."""
        memory = self.memory
        self.diagnosis = diagnosis
        memory.tare = tare
        memory.tared = True
        memory.tared_s = request.started_s
        memory.leapt_s -= request.leapt_s
        memory.covariance_s = memory.now_s - COVARIANCE_S
        memory.bias = self._basis.bias_Nm(tare, memory.q, memory.states, self._age_s)
        self.cancel_tare()

    def start_tare_recording(self) -> None:
        """Record free motion anew; the tare in force stays until the next."""
        self.memory.recorder = TareRecorder.of_size(self._joints, self._basis.states)
        self.memory.tared = False
        self.memory.leapt_s = 0.0
        self.cancel_tare()

    def reset(self) -> None:
        """Forget everything."""
        self._work: Steps[tuple[Tare, TorqueDiagnosis | None]] | None = None
        self.diagnosis: TorqueDiagnosis | None = None
        still = np.zeros(self._joints)
        states = self._basis.states
        self.memory = BiasState(
            recorder=TareRecorder.of_size(self._joints, states),
            plays=np.zeros(self._half_widths.shape),
            lagged_torque=np.zeros(self._joints),
            lagged_q=np.zeros(self._joints),
            states=np.zeros((states, self._joints)),
            torque_sum=np.zeros(self._joints),
            bias=still,
            motion_Nm2=still,
            max_motion_Nm2=still,
            q=still,
            dq=still,
            tau=still,
            smooth_dq=still,
            tare=self._basis.prior_tare,
        )
