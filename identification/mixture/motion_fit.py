"""What motion of the tissue explains of the force over the last seconds.

In tissue that moves by x(t) the force is one of the depth z - x and the speed v -
dx/dt: friction turns round where the tissue overtakes the needle. The motion repeats,

    x(t) = sum over beats and h = 1, 2 of  a_h cos(2 pi h f t) + b_h sin(2 pi h f t)

and the force over the last seconds within one layer is

    force = o + (C + c y) w + (V + b y)(v - dx/dt) + (T + K y + H y²) g + E s + F s²

with y the farthest that the tip came since then, w the presliding deflection, g the
part of the tip's force that remains behind there, and s the place of the tip, all of z
- x: a membrane yields as the tissue comes and goes, a cut does not. After an alarm the
layer before stays in the window: then c y and b y are sums over both, and each has its
own T, K, H, E, F. Given f, a and b that is linear in the rest: separable least squares
(Golub and Pereyra 1973) by Gauss-Newton steps. Lengths are in mm, speeds in mm/s.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from identification.mixture.needle_contact import contact_along
from identification.mixture.priors import (
    COULOMB_SPEED_MM_S,
    FRICTION_FRACTION,
    FRICTION_FRACTION_STD,
)

WINDOW_STEP_S = 0.05
"""The window holds means over so long."""

WINDOW_MEANS = 256
"""Means that it holds at most: 13 s."""

MAX_BREATHING_HZ = 0.6
"""A slower beat is a breath, a quicker one a heartbeat."""

BREATHS_HZ = np.linspace(0.15, 0.45, 7)
"""Breathing frequencies that a search begins with: 9 to 27 breaths a minute."""

HEARTBEATS_HZ = np.linspace(0.8, 1.9, 23)
"""Those of the heartbeat: 48 to 114 beats a minute."""

CLEARLY_LOWER = 10.0
"""By which a motion lowers the sum of squares of the errors at least."""

GOOD_ERROR = 0.05
"""Mean square of a good fit's errors."""

FAIR_ERROR = 0.5
"""Mean square of a fair fit's errors."""


class Fit(NamedTuple):
    """A motion fitted to a window.

    Attributes:
        beats: f [Hz], a1, b1, a2, b2 [mm] of each, shape (m, 5).
        at_s: Time from which their phases count.
        error: Sum of squares of the errors that it leaves, over their deviations.
        rms_N: Force that it leaves.
        damping: Levenberg's.
    """

    beats: Array = np.zeros((0, 5))
    at_s: float = 0.0
    error: float = 1e30
    rms_N: float = 0.0
    damping: float = 0.01


@compiled
def displacement(beats: Matrix, time_s: Vector) -> tuple[Vector, Vector]:
    """Return place [mm] and speed [mm/s] of the tissue.

    Args:
        beats: As in `Fit`, shape (m, 5).
        time_s: Times since the phases' zero, shape (n,).

    Returns:
        Two arrays of shape (n,).
    """
    place = np.zeros(len(time_s))
    speed = np.zeros(len(time_s))
    for k in range(len(beats)):
        rate = 2.0 * math.pi * beats[k, 0]
        for i in range(len(time_s)):
            cosine = math.cos(rate * time_s[i])
            sine = math.sin(rate * time_s[i])
            for h in range(1, 3):
                a = beats[k, 2 * h - 1]
                b = beats[k, 2 * h]
                place[i] += a * cosine + b * sine
                speed[i] += h * rate * (b * cosine - a * sine)
                double_sine = 2.0 * cosine * sine
                cosine = cosine * cosine - sine * sine
                sine = double_sine
    return place, speed


def turned(fit: Fit, time_s: float) -> Fit:
    """Return the same motion with its phases counted from another time."""
    beats = fit.beats.copy()
    shift_s = time_s - fit.at_s
    phase = 2.0 * math.pi * shift_s * fit.beats[:, :1] * np.array([1.0, 2.0])
    cosine = np.cos(phase)
    sine = np.sin(phase)
    a = fit.beats[:, 1::2]
    b = fit.beats[:, 2::2]
    beats[:, 1::2] = a * cosine + b * sine
    beats[:, 2::2] = b * cosine - a * sine
    return fit._replace(beats=beats, at_s=time_s)


class Solution(NamedTuple):
    """The force that a motion explains.

    Attributes:
        rows: Of the linear unknowns, shape (n, m).
        linear: The linear unknowns, shape (m,).
        errors: That they leave, over their deviations, shape (n,).
        error: Sum of their squares.
    """

    rows: Array
    linear: Array
    errors: Array
    error: float


class Window:
    """The force over the last seconds, and what of it a motion explains.

    Attributes:
        count: Number of means that are used.
    """

    def __init__(self, means: Array, until_s: float, from_s: float) -> None:
        self._time_s, depth, speed, force_N = means.T.copy()
        self._depth = depth
        self._speed = speed
        size_N = np.abs(force_N)
        until, begin = np.searchsorted(self._time_s, (until_s, from_s)).tolist()
        # Noise of 20 mN, and an error of the law in proportion to the force
        self._weight = 1.0 / (0.02 + 0.03 * size_N)
        self._weight[until:begin] = 0.0  # while the force was released
        self._force = force_N * self._weight
        self.count = max(len(means) - max(begin - until, 0), 1)
        self._begin = begin if begin < len(means) else 0
        layers = [force_N[:until], force_N[begin:]]
        grown_N = sum(_growth(layer) for layer in layers if len(layer))
        travel_mm = max(float(depth[-1] - depth[0]), 1.0)
        slope = max(grown_N / travel_mm, 0.005)
        first_N = max(float(size_N[:5].mean()), 0.05)
        self._set_prior(slope, max(float(size_N.max()), 0.05), first_N)

    def _set_prior(self, slope: float, force_N: float, first_N: float) -> None:
        """Set what is known of the linear unknowns beforehand.

        Args:
            slope: Growth of the force [N/mm].
            force_N: The largest.
            first_N: At the begin of the window.
        """
        split_std = 0.3  # of how Coulomb and viscous friction share what grows
        mean_speed = max(float(self._speed.mean()), 0.3)
        layers = 2 if self._begin else 1
        # All layers share o, C, V; a layer has c, b, T, K, H, E, F of its own.
        of_layer = (slope, slope / 3, force_N, slope, slope / 10, slope, slope / 10)
        stds = np.array((0.05, force_N, force_N / 3, *of_layer * layers))
        # The force at the begin of the window may be any part of it friction.
        pairs = [(1, force_N, FRICTION_FRACTION * first_N, 0.5 * first_N)]
        growth = FRICTION_FRACTION * slope
        pairs += [
            (coulomb, slope, growth, FRICTION_FRACTION_STD * slope)
            for coulomb in range(3, len(stds), len(of_layer))
        ]
        rows = np.zeros((2 * len(pairs), len(stds)))
        values = np.zeros(len(rows))
        for k, (coulomb, size, value, std) in enumerate(pairs):
            # Coulomb friction + speed * viscous friction = value ± std; at the speed of
            # equal parts their difference is zero.
            friction = slice(coulomb, coulomb + 2)
            rows[2 * k, friction] = (1.0 / std, mean_speed / std)
            values[2 * k] = value / std
            split_row = (1.0, -COULOMB_SPEED_MM_S)
            rows[2 * k + 1, friction] = np.divide(split_row, split_std * size)
        self._information = np.diag(stds**-2.0) + rows.T @ rows
        self._pull = rows.T @ values

    def _rows(self, places: Array, speeds: Array) -> Array:
        """Return the rows of the force for motions, each over its deviation.

        Args:
            places: Of the tissue, shape (m, n).
            speeds: Of the tissue, shape (m, n).

        Returns:
            Shape (m, n, unknowns).
        """
        depths = self._depth - places
        deflections, remaining = contact_along(depths)
        deepest = np.maximum.accumulate(depths, axis=1)
        weight = np.broadcast_to(self._weight, depths.shape)
        coulomb = deflections * weight
        viscous = (self._speed - speeds) * weight
        end = deepest.copy()  # of the first layer
        is_second = np.zeros(len(self._depth), dtype=bool)
        if self._begin:
            is_second[self._begin :] = True
            end[:, self._begin :] = deepest[:, self._begin : self._begin + 1]
        shafts = {False: end - depths[:, :1], True: deepest - end}
        columns = [weight, coulomb, viscous]
        for is_of_second in (False, True)[: 1 + bool(self._begin)]:
            shaft = shafts[is_of_second]
            is_here = is_second == is_of_second
            tip = remaining * weight * is_here
            place = shaft - deepest + depths
            placed = [place * weight * is_here, place**2 * weight * is_here]
            columns += [coulomb * shaft, viscous * shaft, tip, tip * shaft]
            columns += [tip * shaft**2, *placed]
        return np.stack(columns, axis=-1)

    def solve(self, beats: Array, at_s: float) -> Solution:
        """Return the force that a motion explains.

        Args:
            beats: As in `Fit`, shape (m, 5).
            at_s: Time from which their phases count.
        """
        place, speed = displacement(beats, self._time_s - at_s)
        rows = self._rows(place[None], speed[None])[0]
        square = rows.T @ rows + self._information
        linear = _solve(square, rows.T @ self._force + self._pull)
        errors = self._force - rows @ linear
        return Solution(rows, linear, errors, float(errors @ errors))

    def _slopes(self, fit: Fit, linear: Array) -> Array:
        """Return derivatives of the force by a motion's numbers, shape (n, 5 m).

        What turns round remembers its way there: they are differences.
        """
        steps = np.array((1e-4, 1e-3, 1e-3, 1e-3, 1e-3))  # Hz, then mm
        time_s = self._time_s - fit.at_s
        motions = [np.array(displacement(fit.beats, time_s))]
        for beat in fit.beats:
            others = motions[0] - displacement(beat[None], time_s)
            motions += [
                others + displacement(changed[None], time_s)
                for changed in beat + np.diag(steps)
            ]
        places, speeds = np.array(motions).transpose(1, 0, 2)
        forces = self._rows(places, speeds) @ linear
        return (forces[1:] - forces[0]).T / np.tile(steps, len(fit.beats))

    @property
    def error_at_rest(self) -> float:
        """Sum of squares of the errors if the tissue does not move."""
        return self.solve(Fit().beats, 0.0).error

    def is_clear(self, fit: Fit, *, is_proven: bool = False) -> bool:
        """Return whether a fit is good, and shows that the tissue moves.

        Args:
            fit: Of a motion.
            is_proven: Whether it has explained what came later: then less than two
                breaths do.
        """
        length_s = self.count * WINDOW_STEP_S
        factor = 4.0
        max_error = FAIR_ERROR
        min_error_at_rest = fit.error + CLEARLY_LOWER
        for hz in fit.beats[:, 0].tolist():
            is_breath = hz < MAX_BREATHING_HZ
            known_hz = BREATHS_HZ if is_breath else HEARTBEATS_HZ
            is_known = known_hz[0] - 0.03 < hz < known_hz[-1] + 0.03
            # A shorter window takes part of a breath for a quick one.
            min_length_s = max(6.0, 1.0 / hz) if is_breath else 4.0 / hz
            if not is_known or length_s < min_length_s:
                return False
            if is_breath:
                is_long = is_proven or length_s > max(10.0, 2.0 / hz)
                # A layer that bends looks like less than two breaths.
                factor = 40.0 if is_long else 100.0
                max_error = FAIR_ERROR if is_long else GOOD_ERROR
                # A membrane, or a layer of another law, bends the force as a slow
                # breath would, within what the law admits: a mean square of 1.
                min_error_at_rest = max(min_error_at_rest, 1.5 * self.count)
        is_lower = self.error_at_rest > max(factor * fit.error, min_error_at_rest)
        return is_lower and fit.error < max_error * self.count

    def first_frequencies(self, breath_hz: Array, time_s: float) -> Fit:
        """Return beats without a size yet: breaths, and the heartbeat beside them.

        The heartbeat is that of the largest waves which these breaths leave.
        """
        breath = np.zeros((len(breath_hz), 5))
        breath[:, 0] = breath_hz
        columns, change = self._small_motion(breath, time_s)
        errors = self.solve(breath, time_s).errors - columns @ change
        heartbeat = np.array([[self._heartbeat_hz(errors), 0.0, 0.0, 0.0, 0.0]])
        return Fit(np.vstack((breath, heartbeat)), time_s)

    def first_sizes(self, fit: Fit) -> Fit:
        """Return beats with the sizes that tissue as expected would show so."""
        _, change = self._small_motion(fit.beats, fit.at_s)
        sizes = change[len(self._pull) :].reshape(fit.beats.shape)[:, 1:]
        limits = _stds(fit.beats)[:, 1:2]
        fits = []
        for scale in (0.5, 1.0, 2.0):  # the law is known roughly
            tried = fit.beats.copy()
            tried[:, 1:] = np.clip(scale * sizes, -limits, limits)
            fits.append(Fit(tried, fit.at_s, self.solve(tried, fit.at_s).error))
        return min(fits, key=lambda fit: fit.error)

    def _small_motion(self, beats: Array, time_s: float) -> tuple[Array, Array]:
        """Return the step from rest in tissue as expected, as `_gauss_newton_step`."""
        expected = np.linalg.solve(self._information, self._pull)
        solution = self.solve(beats, time_s)._replace(linear=expected)
        fit = Fit(beats, time_s)
        return self._gauss_newton_step(fit, solution, beats, _stds(beats))

    def _heartbeat_hz(self, errors: Array) -> float:
        """Return the frequency of the heartbeat whose waves are largest."""
        step_s = float(self._time_s[-1] - self._time_s[0]) / (len(self._time_s) - 1)
        power = np.abs(np.fft.rfft(errors, 1024)) ** 2
        hz = np.fft.rfftfreq(1024, step_s)
        first, last = np.searchsorted(hz, (HEARTBEATS_HZ[0], HEARTBEATS_HZ[-1]))
        # Means that are far apart, as of a slow log or with gaps, show no fast waves.
        last = min(last, len(power) // 2)
        if last <= first:
            return float(HEARTBEATS_HZ.mean())
        with_double = power[first:last] + power[2 * first : 2 * last : 2]
        return float(hz[first + np.argmax(with_double)])

    def turned_fit(self, fit: Fit) -> Fit:
        """Return a fit with its slow beat of 1 mm and of any phase.

        It is the fit itself where that leaves the least error.
        """
        best = fit
        for phase in (0.25 * math.pi * np.arange(8)).tolist():
            beats = fit.beats.copy()
            beats[0, 1:] = (math.cos(phase), math.sin(phase), 0.0, 0.0)
            error = self.solve(beats, fit.at_s).error
            if error < best.error:
                best = Fit(beats, fit.at_s, error)
        return best

    def stepped(self, fit: Fit, *, is_prior: bool = False) -> Fit:
        """Return a fit after one Gauss-Newton step, damped as Levenberg does.

        Args:
            fit: Before the step.
            is_prior: Whether it is in use, and stays near what it was.
        """
        beats = fit.beats
        solution = self.solve(beats, fit.at_s)
        stds = _stds(beats)
        target = beats.copy()
        if is_prior:
            stds[:, 1:] = 0.3 * np.abs(beats[:, 1:]) + 0.1 * stds[:, 1:]
            stds[:, 0] = 0.02
        else:
            target[:, 1:] = 0.0
        cost = solution.error + _prior_cost(beats, target, stds)
        _, change = self._gauss_newton_step(fit, solution, target, stds)
        change = change[len(self._pull) :].reshape(beats.shape)
        for _ in range(3):
            tried = beats + change
            error = self.solve(tried, fit.at_s).error
            if error + _prior_cost(tried, target, stds) < cost:
                damping = max(0.5 * fit.damping, 1e-3)
                return Fit(tried, fit.at_s, error, self._rms_N(error), damping)
            change = 0.3 * change
        rms_N = self._rms_N(solution.error)
        damping = min(3.0 * fit.damping, 1.0)
        return fit._replace(error=solution.error, rms_N=rms_N, damping=damping)

    def _gauss_newton_step(
        self, fit: Fit, solution: Solution, target: Array, stds: Array
    ) -> tuple[Array, Array]:
        """Return columns of all unknowns, the beats' last, and what a step changes."""
        known = len(solution.linear)
        columns = np.hstack((solution.rows, self._slopes(fit, solution.linear)))
        square = columns.T @ columns
        square[:known, :known] += self._information
        right_side = columns.T @ solution.errors
        right_side[:known] = 0.0  # the linear unknowns are those of the beats
        information = stds.ravel() ** -2.0
        right_side[known:] += information * (target - fit.beats).ravel()
        diagonal = np.arange(known, len(square))
        square[diagonal, diagonal] += information
        square[diagonal, diagonal] *= 1.0 + fit.damping
        return columns, _solve(square, right_side)

    def _rms_N(self, error: float) -> float:
        """Return the force that a fit leaves, by its sum of squares."""
        middle = len(self._weight) // 2
        median_weight = max(float(np.partition(self._weight, middle)[middle]), 1.0)
        # Of a short window a motion goes on for less long as it was.
        length = max(self.count, 50)
        return math.sqrt(error / self.count) / median_weight * WINDOW_MEANS / length


def _growth(force_N: Array) -> float:
    """Return how far the force in a layer has grown, turns of friction left out."""
    oldest = np.sort(force_N[:25])
    newest = np.sort(force_N[-25:])
    rank = -min(5, len(oldest))  # above most turns
    return float(newest[rank] - oldest[rank])


def _solve(square: Array, right_side: Array) -> Array:
    """Solve normal equations, also where nothing separates some unknowns."""
    regular = square + np.diag(1e-9 * np.diag(square))
    return np.asarray(np.linalg.solve(regular, right_side), dtype=np.float64)


def _stds(beats: Array) -> Array:
    """Return standard deviations of the five numbers of each beat.

    Of a frequency [Hz] from one step on, and of the sizes [mm].
    """
    breathing = np.array([0.03, 1.5, 1.5, 0.75, 0.75])
    heartbeat = np.array([0.05, 0.3, 0.3, 0.15, 0.15])
    return np.where(beats[:, :1] < MAX_BREATHING_HZ, breathing, heartbeat)


def _prior_cost(beats: Array, target: Array, stds: Array) -> float:
    """Return the sum of squares of beats about their prior means."""
    return float((((beats - target) / stds) ** 2).sum())
