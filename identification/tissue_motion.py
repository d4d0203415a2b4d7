"""Motion of the tissue by itself, heartbeat and breathing, found in the force.

In tissue that moves by x(t) the force is one of the depth z - x and the speed v - dx/dt: friction
turns round where the tissue overtakes the needle. The motion repeats,

    x(t) = sum over beats and h = 1, 2 of  a_h cos(2 pi h f t) + b_h sin(2 pi h f t)

and the force over the last seconds within one layer is

    force = o + (C + c y) w + (V + b y)(v - dx/dt) + (T + K y + H y²) g

with y the travel since then, w the presliding deflection and g the part of the tip's force that is
left behind its deepest point, both of z - x. Given f, a and b that is linear in the rest: separable
least squares (Golub and Pereyra 1973) by Gauss-Newton steps. Where to begin, a scan of frequencies
says. A unit of this work is done per block of samples. Lengths are in mm, speeds in mm/s.
"""

import math
from typing import NamedTuple

import numpy as np

from identification.estimate import Array
from identification.hypothesis_bank import Place
from identification.hypothesis_filter import COULOMB_SPEED, FRACTION, FRACTION_STD
from identification.switching_update import contact_along
from needleforce.jit import Matrix, Vector, compiled

_STEP_S, _SIZE = 0.05, 256  # the window: means over so long, so many of them at most
_LEAST_S, _MARGIN = 2.5, 7
"""Least length of a window, and newest means left out: a release may have begun there."""
_SETTLE_S = 0.25  # after an alarm, until its release is over
BREATH, HEART = np.linspace(0.15, 0.45, 13), np.linspace(0.8, 1.9, 23)
"""Frequencies scanned [Hz]: 9 to 27 breaths and 48 to 114 beats a minute."""
_SLOWEST_HEART = 0.6
_BREATH_STD = np.array([0.03, 1.5, 1.5, 0.75, 0.75])
_HEART_STD = np.array([0.05, 0.3, 0.3, 0.15, 0.15])
"""Standard deviation of a beat's frequency [Hz] from one step on, and of its sizes [mm]."""
_PERIODS, _BREATH_S = {True: 2.0, False: 4.0}, 7.0
"""Least number of them in the window, of breathing and of a heartbeat; a window that is shorter
takes half a breath for a quick one."""
_CLEARER, _CLEAR = {True: 20.0, False: 4.0}, 10.0
"""The motion must lower the error by this factor (a layer that bends looks like a slow breath), and
by so much."""
_NOISE_N, _LAW_ERROR = 0.02, 0.03
"""Error of a mean that the law leaves: a part of its own and one of the force."""
_FAIR, _LOST, _PATIENCE = 0.5, 1.0, 8
"""Mean square of the errors, in those units, of a good fit, and of one to give up after so many
steps in a row."""
_CHECK_S, _ADAPT_S, _WAIT_S = 0.25, 0.2, 0.5
"""Between two looks whether the tissue moves, two steps of a known motion, and two searches."""
_STEPS = 8  # Gauss-Newton steps of a new fit
_UNITS = len(BREATH) + 2 * len(HEART) + 3 * _STEPS + 1  # Of a search
_FADE_S, _BELIEF_S = 1.0, 2.0
"""Over which a motion just found comes in, and is believed: the bank has learned without it."""
_LINEAR, _EMPTY = 8, (0.0,) * 5


class Fit(NamedTuple):
    """A motion fitted to a window."""

    beats: Array = np.zeros((0, 5))  # f [Hz], a1, b1, a2, b2 [mm] of each, the slowest first
    at_s: float = 0.0  # time from which their phases count
    error: float = 1e30  # sum of squares it leaves
    rms_N: float = 0.0  # of what it leaves
    damping: float = 0.01  # Levenberg's


class TissueMotion(NamedTuple):
    """What is known of the motion; immutable."""

    window: Array = np.zeros((0, 4))  # means of time, depth, speed and force, in one layer
    filling: tuple[float, ...] = _EMPTY  # length of the mean being filled, integrals of those
    from_s: float = 0.0  # the window begins later
    fit: Fit = Fit()  # the motion in use, if it has beats
    since_s: float = 0.0  # in use since then
    bad: int = 0  # steps in a row at which it was no good fit
    next_s: float = 0.0  # when it is looked at again
    unit: int = -1  # the next one of a search, -1 outside one
    found: Array = np.zeros((3, 3))  # of breath, heart, one beside the other: error, frequencies
    tried: Fit = Fit()  # being fitted in a search
    best: Fit = Fit()  # so far in that search

    @property
    def damage(self) -> str:
        """What is wrong with a restored one, if anything."""
        return "" if self.unit in range(-1, _UNITS) else f"there is no unit {self.unit!r:.80}"

    @property
    def is_known(self) -> bool:
        """Whether a motion is in use."""
        return len(self.fit.beats) > 0

    @property
    def _is_long(self) -> bool:
        """Whether the window is long enough to be fitted."""
        return len(self.window) >= _MARGIN + _LEAST_S / _STEP_S

    def at(self, time_s: float) -> tuple[float, float]:
        """Place and speed of the tissue [mm, mm/s]."""
        at_s = np.array([time_s - self.fit.at_s])
        place, speed = (float(each[0]) for each in displacement(self.fit.beats, at_s))
        part = min(max((time_s - self.since_s) / _FADE_S, 0.0), 1.0)
        kept, rate = part * part * (3.0 - 2.0 * part), 6.0 * part * (1.0 - part) / _FADE_S
        return kept * place, kept * speed + rate * place

    def limits(self, time_s: float) -> tuple[float, float, float]:
        """Variance of the force that heartbeat and breathing leave unexplained.

        The third is the part by which the motion just found is believed.
        """
        slow = self.fit.beats[:, 0] < _SLOWEST_HEART
        left = (2.0 * self.fit.rms_N) ** 2
        part = min(max((time_s - self.since_s) / _BELIEF_S, 0.0), 1.0)
        return left * float((~slow).any()), left * float(slow.any()), part

    def restarted(self, time_s: float) -> "TissueMotion":
        """After a rupture: the window begins anew, the motion goes on.

        Not if the rupture before was so recent that nobody has checked: every beat may raise one.
        """
        fit = self.fit if self._is_long else Fit()
        return TissueMotion(from_s=time_s + _SETTLE_S, fit=fit, since_s=self.since_s)

    def with_block(self, block: Place, *, is_met: bool) -> "TissueMotion":
        """Use means of a block of samples, in the tissue's frame, once tissue has been met."""
        if not is_met:
            return self if len(self.window) == 0 else TissueMotion()
        if block.time_s < self.from_s:
            return self
        place, speed = self.at(block.time_s) if self.is_known else (0.0, 0.0)
        means = (1.0, block.time_s, block.depth + place, block.speed + speed, block.force)
        sums = zip(self.filling, means, strict=True)
        filling = tuple(total + block.dt_s * mean for total, mean in sums)
        if filling[0] < _STEP_S * (1.0 - 1e-9):
            return self._replace(filling=filling)
        window = np.vstack((self.window[-_SIZE + 1 :], np.array(filling[1:]) / filling[0]))
        return self._replace(window=window, filling=_EMPTY)

    def is_due(self, time_s: float) -> bool:
        """Whether there is work to do."""
        return self._is_long and (self.unit >= 0 or time_s >= self.next_s)

    def worked(self, time_s: float) -> "TissueMotion":
        """Do one unit of what is due."""
        window = _Window(self.window[:-_MARGIN])
        if self.unit >= 0:
            return self._searched(window, time_s)
        if not self.is_known:
            due = 0 if window.still > max(_CLEAR, 0.1 * window.count) else -1
            return self._replace(next_s=time_s + _CHECK_S, unit=due)
        fit = window.stepped(turned(self.fit, time_s), is_prior=True)
        is_good = fit.error < min(_FAIR * window.count, window.still)
        bad = 0 if is_good else self.bad + 1
        unit = 0 if bad >= _PATIENCE else -1
        if 0 < bad < _PATIENCE:  # it may be a rupture: noise does not grow yet
            fit = fit._replace(rms_N=min(fit.rms_N, self.fit.rms_N))
        return self._replace(fit=fit, bad=bad, next_s=time_s + _ADAPT_S, unit=unit)

    def _searched(self, window: "_Window", time_s: float) -> "TissueMotion":
        """The next unit of a search: the frequencies one by one, then the fits, then a choice."""
        n, m, unit = len(BREATH), len(HEART), self.unit
        if unit < n + 2 * m:
            row = 0 if unit < n else 1 if unit < n + m else 2
            slow, fast = BREATH[unit % n], HEART[(unit - n) % m]
            tried, end = np.array([fast if row else slow]), n + 2 * m
            if row == 2:  # of two beats the larger shows by itself, the other one beside it
                (breath, hz, _), (heart, rate, _), _ = self.found.tolist()
                tried = np.array([slow, rate] if heart < breath else [hz, fast])
                end = 2 * n + m if heart < breath else end  # there are fewer slow ones
            # With waves that grow many a slow one fits as well: what matters is where to begin.
            error = window.waves(tried)[1] if row < 2 else window.first_fit(tried, time_s).error
            found = self.found.copy()
            if unit in (0, n, n + m) or error < found[row, 0]:
                found[row] = error, tried[0], tried[-1]
            unit = unit + 1 if unit + 1 < end else n + 2 * m
            return self._replace(found=found, unit=unit, best=Fit())
        kind, step = divmod(unit - n - 2 * m, _STEPS)
        if kind == 3:
            return self._chosen(window, time_s)
        if step == 0:
            hz = self.found[kind, 1:] if kind == 2 else self.found[kind, 1:2]
            return self._replace(tried=window.first_fit(hz, time_s), unit=unit + 1)
        tried, best = window.stepped(self.tried), self.best
        # Of two beats the second is there only if it halves the error.
        factor = 0.5 if kind == 2 else 1.0
        if step == _STEPS - 1 and window.is_clear(tried) and tried.error < factor * best.error:
            best = tried
        return self._replace(tried=tried, best=best, unit=unit + 1)

    def _chosen(self, window: "_Window", time_s: float) -> "TissueMotion":
        state, best = self._replace(unit=-1, bad=0, tried=Fit(), best=Fit()), self.best
        if self.is_known:
            if best.error < 0.5 * self.fit.error:
                return state._replace(fit=best)
            # The law may have changed within the window, or the motion have ended: it begins anew.
            # Before it is full a breath may be missing, which wants all of it.
            most = _LOST * window.count if len(self.window) == _SIZE else math.inf
            is_lost = self.fit.error > min(most, window.still)
            newer = self.window[len(self.window) // 2 :]
            return TissueMotion(window=newer, from_s=self.from_s) if is_lost else state
        if len(best.beats) == 0:
            return state._replace(next_s=time_s + _WAIT_S)
        return state._replace(fit=best, since_s=time_s)


@compiled
def displacement(beats: Matrix, time_s: Vector) -> tuple[Vector, Vector]:
    """Place [mm] and speed [mm/s] of the tissue at n times since its phases' zero."""
    place, speed = np.zeros_like(time_s), np.zeros_like(time_s)
    for k in range(len(beats)):
        rate, a, b = 2.0 * math.pi * beats[k, 0], beats[k, 1], beats[k, 2]
        c, d = beats[k, 3], beats[k, 4]
        cosine, sine = np.cos(rate * time_s), np.sin(rate * time_s)
        cosine_2, sine_2 = cosine * cosine - sine * sine, 2.0 * cosine * sine
        place += a * cosine + b * sine + c * cosine_2 + d * sine_2
        speed += rate * (b * cosine - a * sine + 2.0 * (d * cosine_2 - c * sine_2))
    return place, speed


@compiled
def _derivatives(beats: Matrix, time_s: Vector) -> tuple[Matrix, Matrix]:
    """Derivatives of place and speed at n times by the five numbers of each beat, (5 beats, n)."""
    places, speeds = np.zeros((beats.size, len(time_s))), np.zeros((beats.size, len(time_s)))
    for k in range(len(beats)):
        row = 5 * k
        for h in range(1, 3):
            hertz = 2.0 * math.pi * h
            rate, a, b = hertz * beats[k, 0], beats[k, 2 * h - 1], beats[k, 2 * h]
            cosine, sine = np.cos(rate * time_s), np.sin(rate * time_s)
            ahead = b * cosine - a * sine
            places[row] += hertz * time_s * ahead
            speeds[row] += hertz * (ahead - rate * time_s * (a * cosine + b * sine))
            places[row + 2 * h - 1], places[row + 2 * h] = cosine, sine
            speeds[row + 2 * h - 1], speeds[row + 2 * h] = -rate * sine, rate * cosine
    return places, speeds


@compiled
def _fitted(rows: Matrix, force: Vector, known: Matrix, pull: Vector) -> tuple[Vector, Vector]:
    """Least squares beside what is known beforehand: the unknowns, and the error they leave."""
    square = np.dot(rows.T, rows) + known
    # Of unknowns that nothing separates as well.
    square += np.diag(1e-9 * np.diag(square) + 1e-12)
    found = np.linalg.solve(square, np.dot(rows.T, force) + pull)
    return found, force - np.dot(rows, found)


@compiled
def _waves(hz: Vector, courses: Matrix, sigma: Vector, force: Vector) -> tuple[Vector, float]:
    """Fit of a smooth course and waves that grow with the travel; mean square of the rest.

    `courses`, shape (3, n), are time, travel and speed; `force` is over its deviation `sigma`.
    """
    time_s, y, v = courses[0] - courses[0, -1], courses[1], courses[2]
    columns, row = np.ones((6 + 8 * len(hz), len(y))), 6
    columns[1], columns[2], columns[3], columns[4], columns[5] = y, y * y, y**3, v, v * y
    for k in range(2 * len(hz)):
        phase = 2.0 * math.pi * hz[k // 2] * (1 + k % 2) * time_s
        cosine, sine = np.cos(phase), np.sin(phase)
        columns[row], columns[row + 1], columns[row + 2] = cosine, cosine * y, sine
        columns[row + 3] = sine * y
        row += 4
    columns /= sigma
    scale = np.sqrt((columns * columns).sum(axis=1)) + 1e-12
    matrix, none = np.ascontiguousarray(columns.T / scale), np.zeros(len(scale))
    found, error = _fitted(matrix, force, np.diag(none), none)
    return found / scale, np.dot(error, error) / len(y)


@compiled
def _rows(contact: tuple[Vector, Vector], speed: Vector, powers: Matrix) -> Matrix:
    """Rows of the law in its eight linear unknowns, each over its standard deviation, (n, 8).

    `contact` holds presliding deflection and what is left of the tip's force, `speed` is relative
    to the tissue; `powers`, shape (3, n), are 1, y and y² over the standard deviation.
    """
    (w, g), one, y = contact, powers[0], powers[1]
    rows = np.empty((len(speed), 8))
    rows[:, 0], rows[:, 1], rows[:, 2], rows[:, 3] = one, w * one, w * y, speed * one
    rows[:, 4], rows[:, 5], rows[:, 6], rows[:, 7] = speed * y, g * one, g * y, g * powers[2]
    return rows


@compiled
def _step(
    rows: tuple[Matrix, Matrix],
    error: Vector,
    prior: Matrix,
    stds: Vector,
    pull: Vector,
    damping: float,
) -> Vector:
    """Change of the motion's numbers by a Gauss-Newton step, damped as Levenberg does.

    `rows` are those of the linear unknowns, whose information beforehand is `prior`, and of the
    numbers, which lie within `stds` beforehand and are pulled by `pull`.
    """
    linear, slopes = rows
    n, size = len(prior), len(prior) + len(stds)
    known, pulled = np.zeros((size, size)), np.zeros(size)
    known[:n, :n], pulled[n:] = prior, pull
    for k in range(len(stds)):
        held = stds[k] ** -2.0
        known[n + k, n + k] = held + damping * (held + (slopes[:, k] ** 2).sum())
    return _fitted(np.concatenate((linear, slopes), axis=1), error, known, pulled)[0][n:]


def turned(fit: Fit, time_s: float) -> Fit:
    """The same motion with its phases counted from another time."""
    beats, shift = fit.beats.copy(), time_s - fit.at_s
    phase = 2.0 * math.pi * shift * fit.beats[:, :1] * np.array([1.0, 2.0])
    cosine, sine, a, b = np.cos(phase), np.sin(phase), fit.beats[:, 1::2], fit.beats[:, 2::2]
    beats[:, 1::2], beats[:, 2::2] = a * cosine + b * sine, b * cosine - a * sine
    return fit._replace(beats=beats, at_s=time_s)


class _Window:
    """The force over the last seconds, and what of it a motion explains."""

    def __init__(self, window: Array) -> None:
        self.time_s, self.depth, self.speed, force = window.T.copy()
        self.count, self.travel, size = len(window), self.depth - self.depth[0], np.abs(force)
        self.sigma = _NOISE_N + _LAW_ERROR * size
        # Of its oldest and newest 25 means the fifth largest: above most turns of friction.
        oldest, newest = np.partition(force[:25], -5)[-5], np.partition(force[-25:], -5)[-5]
        self.slope = max(float(newest - oldest) / max(float(self.travel[-1]), 1.0), 0.005)
        self.pace = max(float(self.speed.mean()), 0.3)
        one = 1.0 / self.sigma
        self.powers = np.array((one, self.travel * one, self.travel * self.travel * one))
        self.force, self.prior = force * one, self._prior(max(float(size.max()), 0.05))

    def _prior(self, most: float) -> tuple[Array, Array]:
        """Information and its vector on o, C, c, V, b, T, K, H beforehand; the largest force."""
        slope, pull = self.slope, np.zeros(_LINEAR)
        stds = np.array([0.05, most, slope, most / 3, slope / 3, most, slope, slope / 10])
        information = np.diag(stds**-2.0)
        # Growth of friction as a part of the force's; how both frictions split it, and the rest.
        parts = ((2, 4, self.pace, FRACTION_STD), (2, 4, -COULOMB_SPEED, 0.3))
        for i, j, other, std in (*parts, (1, 3, -COULOMB_SPEED, 0.3 * most / slope)):
            variance = (std * slope) ** 2
            information[i, i] += 1.0 / variance
            information[j, j] += other * other / variance
            information[i, j] = information[j, i] = information[i, j] + other / variance
        pull[2] = FRACTION / (FRACTION_STD**2 * slope)
        pull[4] = self.pace * pull[2]
        return information, pull

    def solved(self, beats: Array, at_s: float) -> tuple[Array, Array, float, Array]:
        """Rows, linear unknowns, sum of squares of the error, and the error of a motion."""
        place, speed = displacement(beats, self.time_s - at_s)
        w, g = contact_along((self.depth - place)[None])
        rows = _rows((w[0], g[0]), self.speed - speed, self.powers)
        linear, error = _fitted(rows, self.force, *self.prior)
        return rows, linear, float(error @ error), error

    def _slopes(self, fit: Fit, linear: Array) -> Array:
        """Derivatives of the rows' sum by the numbers of a motion, shape (n, 5 beats)."""
        (one, y, _), beats = self.powers, fit.beats
        places, speeds = _derivatives(beats, self.time_s - fit.at_s)
        place = (beats * (np.arange(5) > 0)).ravel() @ places  # linear in the sizes
        # What turns round remembers its way there: differences.
        steps = np.array((1e-4, 1e-3, 1e-3, 1e-3, 1e-3) * len(beats))[:, None]
        w, g = contact_along(self.depth - np.vstack((place, place + steps * places)))
        by_w, by_v = linear[1] * one + linear[2] * y, linear[3] * one + linear[4] * y
        turned_by = (w[1:] - w[0]) * by_w + (g[1:] - g[0]) * (linear[5:] @ self.powers)
        return np.ascontiguousarray((turned_by / steps - by_v * speeds).T)

    @property
    def still(self) -> float:
        """Sum of squares of the error if the tissue does not move."""
        return self.solved(Fit().beats, 0.0)[2]

    def is_clear(self, fit: Fit) -> bool:
        """Whether a fit is good, and shows that the tissue moves."""
        still, is_slow = self.still, fit.beats[:, 0] < _SLOWEST_HEART
        length_s = self.count * _STEP_S
        for hz, slow in zip(fit.beats[:, 0], is_slow, strict=True):
            grid = BREATH if slow else HEART
            is_known = grid[0] - 0.03 < hz < grid[-1] + 0.1
            if not is_known or length_s < max(_PERIODS[bool(slow)] / hz, _BREATH_S * slow):
                return False
        is_lower = still > _CLEARER[bool(is_slow.any())] * fit.error
        return is_lower and still - fit.error > _CLEAR and fit.error < _FAIR * self.count

    def waves(self, hz: Array) -> tuple[Array, float]:
        """As `_waves`, of these frequencies."""
        courses = np.array((self.time_s, self.travel, self.speed))
        return _waves(hz, courses, self.sigma, self.force)

    def first_fit(self, hz: Array, time_s: float) -> Fit:
        """A motion of these frequencies that damping would turn into the waves of the force."""
        found, y = self.waves(hz)[0], float(self.travel[-1])
        damping = self.slope * FRACTION * max(y, 0.0) / (COULOMB_SPEED + self.pace) + 1e-3
        waves = found[6:].reshape(len(hz), 2, 2, 2) @ np.array([1.0, y])  # beat, harmonic, cos/sin
        rate = 2.0 * math.pi * np.outer(hz, (1.0, 2.0)) * damping
        sizes = np.stack((waves[:, :, 1] / rate, -waves[:, :, 0] / rate), axis=2).reshape(-1, 4)
        fits, at_s, most = [], float(self.time_s[-1]), _stds(hz[:, None])[:, 1:2]
        for scale in (0.5, 1.0, 2.0):
            limited = np.minimum(np.maximum(scale * sizes, -most), most)
            beats = np.hstack((hz[:, None], limited))
            fits.append(Fit(beats, at_s, self.solved(beats, at_s)[2]))
        return turned(min(fits, key=lambda fit: fit.error), time_s)

    def stepped(self, fit: Fit, *, is_prior: bool = False) -> Fit:
        """One Gauss-Newton step; `is_prior` keeps a motion in use near what it was."""
        beats, at_s = fit.beats, fit.at_s
        rows, linear, _, error = self.solved(beats, at_s)
        stds, target = _stds(beats), beats.copy()
        if is_prior:
            stds[:, 0], stds[:, 1:] = 0.02, 0.3 * np.abs(beats[:, 1:]) + 0.1 * stds[:, 1:]
        else:
            target[:, 1:] = 0.0
        pull = ((target - beats) / stds**2).ravel()
        step = _step(
            (rows, self._slopes(fit, linear)), error, self.prior[0], stds.ravel(), pull, fit.damping
        )
        change, left = step.reshape(beats.shape), float(error @ error)
        before = left + float((((beats - target) / stds) ** 2).sum())
        for _ in range(3):
            tried = beats + change
            error = self.solved(tried, at_s)[2]
            if error + float((((tried - target) / stds) ** 2).sum()) < before:
                return Fit(tried, at_s, error, self._rms(error), max(0.5 * fit.damping, 1e-3))
            change = 0.3 * change
        return fit._replace(error=left, rms_N=self._rms(left), damping=min(3.0 * fit.damping, 1.0))

    def _rms(self, error: float) -> float:
        middle = np.partition(self.sigma, self.count // 2)[self.count // 2]
        return math.sqrt(error / self.count) * float(middle)


def _stds(beats: Array) -> Array:
    """Standard deviations of the five numbers of each beat, whose frequencies come first."""
    return np.where(beats[:, :1] < _SLOWEST_HEART, _BREATH_STD, _HEART_STD)
