"""A session over a simulated insertion, and what it found beside the truth.

    run = simulate("stack-glove-constant", "fri", seed=0)
    found = judge(run, run_session(run, InsertionSession(run.robot)))

The session gets joint positions, velocities and torques, as a robot reports them. What
the simulation knows is used for the comparison alone.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from foundation.arrays import Array
from groundtruth import Run, Rupture
from groundtruth.rupture_match import nearest_pairs
from identification import PUBLISHED, LayerEstimate
from needleforce.session import InsertionSession
from residual import PUBLISHED as PUBLISHED_SENSOR
from residual import TareError


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class SessionResult:
    """What a session made of n samples.

    Attributes:
        force_N: Force on the needle, shape (n,).
        force_std_N: Its standard deviation, shape (n,).
        tip_N: Force at the tip, shape (n,); zero before the tare.
        tip_std_N: Its standard deviation, shape (n,); NaN where none is stated.
        alarm_samples: Number of the sample that raised each alarm for a rupture, in
            order, by the alarm's time on the session's clock, which names its layer.
        layers: The layers traversed, as known at the end.
    """

    force_N: Array
    force_std_N: Array
    tip_N: Array
    tip_std_N: Array
    alarm_samples: Mapping[float, int]
    layers: tuple[LayerEstimate, ...]


class FoundRupture(NamedTuple):
    """A true rupture and what a session reported of it.

    Attributes:
        true: The true rupture.
        alarm_sample: Sample of the alarm that belongs to it; None if it was missed.
        layer: The layer that it ended, as known at the end; None if it was missed or
            never identified.
    """

    true: Rupture
    alarm_sample: int | None
    layer: LayerEstimate | None


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JudgedSession:
    """What a session made of an insertion, against the truth.

    Attributes:
        result: What it made of the signals.
        ruptures: The true ruptures, and what it reported of each.
        false_alarms: Alarms without a true rupture.
        force_error_N: Root mean square error of the force on the needle, from first
            contact until the needle has left the tissue.
        tip_error_N: The same of the force at the tip, from first contact to the deepest
            point.
    """

    result: SessionResult
    ruptures: tuple[FoundRupture, ...]
    false_alarms: int
    force_error_N: float
    tip_error_N: float

    @property
    def found(self) -> int:
        """Number of true ruptures that it reported."""
        return sum(rupture.alarm_sample is not None for rupture in self.ruptures)


def published_session(run: Run) -> InsertionSession:
    """Return a session by the published method with its published settings.

    It is told the depth of the surface since the tare, which the method assumes known,
    and smooths the speed, which the method takes as exact.
    """
    surface_m = -float(run.scenario.motion.position_m(run.tare_end_s))
    return InsertionSession(
        run.robot,
        PUBLISHED_SENSOR,
        replace(PUBLISHED, contact_depth_m=surface_m),
        speed_lag_s=0.02,
    )


def run_session(
    run: Run,
    session: InsertionSession,
    progress: Callable[[float], None] = lambda fraction: None,
) -> SessionResult:
    """Run a session over the signals of an insertion, tared once in free air.

    Args:
        run: The insertion; only its signals and the end of its free motion are used.
        session: A session that has seen nothing.
        progress: Takes the fraction of the samples that are done.
    """
    signals = run.signals
    count = len(signals.t_s)
    series = np.zeros((4, count))
    alarm_samples: dict[float, int] = {}
    # Time stamps are whole nanoseconds; differences of their floats are not.
    steps_s = np.round(np.diff(signals.t_s, prepend=signals.t_s[0]), 9)
    for number, step_s in enumerate(steps_s.tolist()):
        if number % 1000 == 0:
            progress(number / count)
        if not session.tared and signals.t_s[number] > run.tare_end_s:
            try:
                session.tare()
            except TareError:  # the check took the free motion for a contact
                session.tare(ignore_contact=True)
        velocity_rad_s = None if signals.dq_rad_s is None else signals.dq_rad_s[number]
        estimate = session.update(
            signals.q_rad[number], velocity_rad_s, signals.tau_Nm[number], step_s
        )
        wrench = estimate.wrench
        layers = estimate.identification
        tip_std_N = layers.tip_force_std_N
        series[:, number] = (
            wrench.axial,
            wrench.axial_std,
            layers.tip_force_N,
            np.nan if tip_std_N is None else tip_std_N,
        )
        if layers.rupture is not None:
            alarm_samples[layers.rupture.alarm_s] = number
    return SessionResult(
        force_N=series[0],
        force_std_N=series[1],
        tip_N=series[2],
        tip_std_N=series[3],
        alarm_samples=alarm_samples,
        layers=tuple(session.layers),
    )


def is_insertion(run: Run) -> NDArray[np.bool_]:
    """Return which samples lie between first contact and the deepest point."""
    t_s = run.truth.t_s
    return (t_s >= run.truth.contact_s) & (t_s <= run.scenario.motion.insertion_end_s)


def judge(run: Run, result: SessionResult) -> JudgedSession:
    """Compare what a session made of an insertion with the truth."""
    truth = run.truth
    alarms = list(result.alarm_samples.items())
    alarms_s = [float(truth.t_s[sample]) for _, sample in alarms]
    pairs = nearest_pairs([item.onset_s for item in truth.ruptures], alarms_s)
    layer_of = {layer.rupture.alarm_s: layer for layer in result.layers}
    ruptures: list[FoundRupture] = []
    for number, true in enumerate(truth.ruptures):
        alarm_s, sample = alarms[pairs[number]] if number in pairs else (np.nan, None)
        ruptures.append(FoundRupture(true, sample, layer_of.get(alarm_s)))
    touches = (truth.t_s >= truth.contact_s) & (truth.t_s <= truth.withdrawn_s)
    inserts = is_insertion(run)
    return JudgedSession(
        result=result,
        ruptures=tuple(ruptures),
        false_alarms=len(alarms) - len(pairs),
        force_error_N=_rms((result.force_N - truth.axial_N)[touches]),
        tip_error_N=_rms((result.tip_N - truth.tip_N)[inserts]),
    )


def _rms(errors: Array) -> float:
    """Return the root mean square of errors, shape (n,)."""
    return float(np.sqrt(np.mean(errors**2)))
