"""What motion of the tissue explains of the force over the last seconds.

In tissue that moves by x(t) the force is one of the depth z - x and the speed v -
dx/dt: friction turns round where the tissue overtakes the needle. The motion repeats,

    x(t) = sum over beats and h = 1, 2 of  a_h cos(2 pi h f t) + b_h sin(2 pi h f t)

and the force over the last seconds within one layer is

    force = o + (C + c y) w + (V + b y)(v - dx/dt) + (T + K y + H y²) g + E s + F s²

with y the farthest that the tip came since then, w the presliding deflection, g the
part of the tip's force that is left behind there, and s the place of the tip, all of z
- x: a membrane yields as the tissue comes and goes, a cut does not. After an alarm the
layer before stays in the window: then c y and b y are sums over both, and each has its
own T, K, H, E, F. Given f, a and b that is linear in the rest: separable least squares
(Golub and Pereyra 1973) by Gauss-Newton steps. Where to begin, a scan of frequencies
and a breath's phases say. Lengths are in mm, speeds in mm/s.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from identification.multilayer.force_model import COULOMB_SPEED, FRACTION, FRACTION_STD
from identification.multilayer.force_split import contact_along

# the window: means over so long, so many of them at most
STEP_S = 0.05
SIZE = 256
BREATH = np.linspace(0.15, 0.45, 13)
HEART = np.linspace(0.8, 1.9, 23)
"""Frequencies scanned [Hz]: 9 to 27 breaths and 48 to 114 beats a minute."""
SLOWEST_HEART = 0.6
_BREATH_STD = np.array([0.03, 1.5, 1.5, 0.75, 0.75])
_HEART_STD = np.array([0.05, 0.3, 0.3, 0.15, 0.15])
"""Standard deviation of a beat's frequency [Hz] from one step on, and of its sizes
[mm]."""
_BREATH_S = 6.0, 10.0
"""Least length of a window that shows a breath, and of one that shows two: shorter ones
take part of a breath for a quick one."""
# Mean square of a good fit's errors, and of a fair one's
GOOD = 0.05
FAIR = 0.5
_CLEARER = ((4.0, FAIR), (20.0, FAIR), (100.0, GOOD))
CLEAR = 10.0
"""The motion must lower the error by this factor, to at most that mean square: a
heartbeat, breathing (a layer that bends looks like one), and less than two breaths; and
by so much."""
_UNLIKE = 1.5
"""Breath shows only where the law of tissue at rest is off by more than it admits, a
mean square of 1: a membrane, or a layer of another law, bends the force within that, as
a slow breath would."""
_NOISE_N = 0.02
_LAW_ERROR = 0.03
"""Error of a mean that the law leaves: a part of its own and one of the force."""
_OWN = 7  # unknowns that a layer has of its own
Pair = tuple[Matrix, Matrix]


class Fit(NamedTuple):
    """A motion fitted to a window.

    Attributes:
        beats: f [Hz], a1, b1, a2, b2 [mm] of each, the slowest first.
        at_s: Time from which their phases count.
        error: Sum of squares it leaves.
        rms_N: Of what it leaves.
        damping: Levenberg's.
    """

    beats: Array = np.zeros((0, 5))
    at_s: float = 0.0
    error: float = 1e30
    rms_N: float = 0.0
    damping: float = 0.01


@compiled
def displacement(beats: Matrix, time_s: Vector) -> tuple[Vector, Vector]:
    """Place [mm] and speed [mm/s] of the tissue at n times since its phases' zero."""
    place = np.zeros_like(time_s)
    speed = np.zeros_like(time_s)
    for k in range(len(beats)):
        rate = 2.0 * math.pi * beats[k, 0]
        a = beats[k, 1]
        b = beats[k, 2]
        c = beats[k, 3]
        d = beats[k, 4]
        cosine = np.cos(rate * time_s)
        sine = np.sin(rate * time_s)
        cosine_2 = cosine * cosine - sine * sine
        sine_2 = 2.0 * cosine * sine
        place += a * cosine + b * sine + c * cosine_2 + d * sine_2
        speed += rate * (b * cosine - a * sine + 2.0 * (d * cosine_2 - c * sine_2))
    return place, speed


@compiled
def _derivatives(beats: Matrix, time_s: Vector) -> Pair:
    """Derivatives of place and speed at n times by the five numbers of each beat, (5
    beats, n).
    """
    places = np.zeros((beats.size, len(time_s)))
    speeds = np.zeros((beats.size, len(time_s)))
    for k in range(len(beats)):
        row = 5 * k
        phase = 2.0 * math.pi * beats[k, 0] * time_s
        cosine = np.cos(phase)
        sine = np.sin(phase)
        for h in range(1, 3):
            hertz = 2.0 * math.pi * h
            rate = hertz * beats[k, 0]
            a = beats[k, 2 * h - 1]
            b = beats[k, 2 * h]
            if h == 2:
                double_sine = 2.0 * cosine * sine
                cosine = cosine * cosine - sine * sine
                sine = double_sine
            ahead = b * cosine - a * sine
            places[row] += hertz * time_s * ahead
            speeds[row] += hertz * (ahead - rate * time_s * (a * cosine + b * sine))
            places[row + 2 * h - 1] = cosine
            places[row + 2 * h] = sine
            speeds[row + 2 * h - 1] = -rate * sine
            speeds[row + 2 * h] = rate * cosine
    return places, speeds


@compiled
def _fitted(
    rows: Matrix, force: Vector, known: Matrix, pull: Vector
) -> tuple[Vector, Vector]:
    """Least squares beside what is known beforehand: the unknowns, and the error
    they leave.
    """
    square = np.dot(rows.T, rows) + known
    # Of unknowns that nothing separates as well.
    square += np.diag(1e-9 * np.diag(square) + 1e-12)
    found = np.linalg.solve(square, np.dot(rows.T, force) + pull)
    return found, force - np.dot(rows, found)


@compiled
def _waves(
    hz: Vector, courses: Matrix, one: Vector, force: Vector
) -> tuple[Vector, float]:
    """Fit of a smooth course and waves that grow with the travel; mean square of the
    rest.

    `courses`, shape (4, n), are time, travel, speed, and travel in a second layer,
    negative before; `one` and `force` are over its deviation.
    """
    time_s = courses[0] - courses[0, -1]
    y = courses[1]
    v = courses[2]
    later = courses[3]
    columns = np.ones((8 + 8 * len(hz), len(y)))
    row = 8
    columns[1] = y
    columns[2] = y * y
    columns[3] = y**3
    columns[4] = v
    columns[5] = v * y
    columns[7] = np.maximum(later, 0.0)
    columns[6] = 1.0 * (later >= 0.0)
    for k in range(2 * len(hz)):
        phase = 2.0 * math.pi * hz[k // 2] * (1 + k % 2) * time_s
        cosine = np.cos(phase)
        sine = np.sin(phase)
        columns[row] = cosine
        columns[row + 1] = cosine * y
        columns[row + 2] = sine
        columns[row + 3] = sine * y
        row += 4
    columns *= one
    scale = np.sqrt((columns * columns).sum(axis=1)) + 1e-12
    matrix = np.ascontiguousarray(columns.T / scale)
    none = np.zeros(len(scale))
    found, error = _fitted(matrix, force, np.diag(none), none)
    return found / scale, np.dot(error, error) / len(y)


@compiled
def _rows(
    contact: tuple[Vector, Vector],
    depth: Vector,
    speed: Vector,
    one: Vector,
    begin: int,
) -> Matrix:
    """Rows of the law in its linear unknowns, three and `_OWN` a layer, each over its
    deviation.

    `contact` holds presliding deflection and what is left of the tip's force, depth and
    speed are relative to the tissue; a second layer begins at row `begin`, if that is
    not 0.
    """
    w, g = contact
    layers = 2 if begin else 1
    rows = np.zeros((len(speed), 3 + _OWN * layers))
    end = depth[0]
    deepest = depth[0]
    for k in range(len(speed)):
        deepest = max(deepest, depth[k])
        end = deepest if k <= begin else end
        rows[k, 0] = one[k]
        rows[k, 1] = w[k] * one[k]
        rows[k, 2] = speed[k] * one[k]
        for layer in range(layers):
            shaft = deepest - end if layer else (end if begin else deepest) - depth[0]
            at = 3 + _OWN * layer
            rows[k, at] = rows[k, 1] * shaft
            rows[k, at + 1] = rows[k, 2] * shaft
            if (begin > 0 and k >= begin) == (layer == 1):
                tip = g[k] * one[k]
                back = shaft - deepest + depth[k]
                rows[k, at + 2] = tip
                rows[k, at + 3] = tip * shaft
                rows[k, at + 4] = tip * shaft**2
                rows[k, at + 5] = back * one[k]
                rows[k, at + 6] = back**2 * one[k]
    return rows


@compiled
def _changes(
    contact: Pair, courses: Pair, one: Vector, begin: int, linear: Vector
) -> Matrix:
    """What m courses of depth and speed change of the force of the first, shape (n,
    m - 1).
    """
    w, g = contact
    depths, speeds = courses
    forces = np.zeros((len(depths), len(one)))
    for k in range(len(depths)):
        rows = _rows((w[k], g[k]), depths[k], speeds[k], one, begin)
        forces[k] = np.dot(rows, linear)
    return (forces[1:] - forces[0]).T


@compiled
def _step(
    rows: Pair, error: Vector, prior: Matrix, stds: Vector, pull: Vector, damping: float
) -> Vector:
    """Change of the motion's numbers by a Gauss-Newton step, damped as Levenberg does.

    `rows` are those of the linear unknowns, whose information beforehand is `prior`,
    and of the numbers, which lie within `stds` beforehand and are pulled by `pull`.
    """
    linear, slopes = rows
    n = len(prior)
    size = len(prior) + len(stds)
    known = np.zeros((size, size))
    pulled = np.zeros(size)
    known[:n, :n] = prior
    pulled[n:] = pull
    for k in range(len(stds)):
        held = stds[k] ** -2.0
        known[n + k, n + k] = held + damping * (held + (slopes[:, k] ** 2).sum())
    return _fitted(np.concatenate((linear, slopes), axis=1), error, known, pulled)[0][
        n:
    ]


def turned(fit: Fit, time_s: float) -> Fit:
    """The same motion with its phases counted from another time."""
    beats = fit.beats.copy()
    shift = time_s - fit.at_s
    phase = 2.0 * math.pi * shift * fit.beats[:, :1] * np.array([1.0, 2.0])
    cosine = np.cos(phase)
    sine = np.sin(phase)
    a = fit.beats[:, 1::2]
    b = fit.beats[:, 2::2]
    beats[:, 1::2] = a * cosine + b * sine
    beats[:, 2::2] = b * cosine - a * sine
    return fit._replace(beats=beats, at_s=time_s)


def _growth(force: Array) -> float:
    """Of the force in a layer: of 25 means the fifth largest is above most turns of
    friction.
    """
    oldest = force[:25]
    newest = force[-25:]
    at = -min(5, len(oldest))
    return float(np.partition(newest, at)[at] - np.partition(oldest, at)[at])


class Window:
    """The force over the last seconds, and what of it a motion explains."""

    def __init__(self, window: Array, until_s: float, from_s: float) -> None:
        self.time_s, self.depth, self.speed, force = window.T.copy()
        size = np.abs(force)
        self.travel = self.depth - self.depth[0]
        until, end = np.searchsorted(self.time_s, (until_s, from_s)).tolist()
        self.begin = end if end < len(window) else 0
        self.one = 1.0 / (_NOISE_N + _LAW_ERROR * size)
        self.one[until:end] = 0.0  # while the force was released
        self.count = max(len(window) - max(end - until, 0), 1)
        parts = force[:until], force[end:]  # of its layers
        grown = sum(_growth(part) for part in parts if len(part))
        self.slope = max(grown / max(float(self.travel[-1]), 1.0), 0.005)
        self.pace = max(float(self.speed.mean()), 0.3)
        # Travel in a second layer; before it, and without one, negative.
        self.later = self.travel - (self.travel[self.begin] if self.begin else math.inf)
        self.force = force * self.one
        self.prior = self._prior(max(float(size.max()), 0.05), 2 if self.begin else 1)

    def _prior(self, most: float, layers: int) -> tuple[Array, Array]:
        """Information on the linear unknowns beforehand, and its vector; `most` is
        the force.
        """
        slope = self.slope
        pull = np.zeros(3 + _OWN * layers)
        own = (slope, slope / 3, most, slope, slope / 10, slope, slope / 10)
        stds = [0.05, most, most / 3, *own * layers]
        information = np.diag(np.array(stds) ** -2.0)
        # Growth of friction as a part of the force's; how both frictions split it, and
        # the rest.
        parts = [(1, 2, -COULOMB_SPEED, 0.3 * most / slope)]
        for c in range(3, len(stds), _OWN):
            parts += [
                (c, c + 1, self.pace, FRACTION_STD),
                (c, c + 1, -COULOMB_SPEED, 0.3),
            ]
            pull[c] = FRACTION / (FRACTION_STD**2 * slope)
            pull[c + 1] = self.pace * pull[c]
        for i, j, other, std in parts:
            variance = (std * slope) ** 2
            information[i, i] += 1.0 / variance
            information[j, j] += other * other / variance
            information[i, j] = information[j, i] = information[i, j] + other / variance
        return information, pull

    def solved(self, beats: Array, at_s: float) -> tuple[Array, Array, float, Array]:
        """Rows, linear unknowns, sum of squares of the error, and the error of a
        motion.
        """
        place, speed = displacement(beats, self.time_s - at_s)
        w, g = contact_along((self.depth - place)[None])
        rows = _rows(
            (w[0], g[0]), self.depth - place, self.speed - speed, self.one, self.begin
        )
        linear, error = _fitted(rows, self.force, *self.prior)
        return rows, linear, float(error @ error), error

    def _slopes(self, fit: Fit, linear: Array) -> Array:
        """Derivatives of the rows' sum by the numbers of a motion, shape (n, 5
        beats).
        """
        beats = fit.beats
        time_s = self.time_s - fit.at_s
        places, speeds = _derivatives(beats, time_s)
        place, speed = displacement(beats, time_s)
        # What turns round remembers its way there: differences.
        steps = np.array((1e-4, 1e-3, 1e-3, 1e-3, 1e-3) * len(beats))[:, None]
        depths = self.depth - np.vstack((place, place + steps * places))
        speeds = self.speed - np.vstack((speed, speed + steps * speeds))
        contact = contact_along(depths)
        courses = (depths, speeds)
        changes = _changes(contact, courses, self.one, self.begin, linear)
        return np.ascontiguousarray(changes / steps.T)

    @property
    def still(self) -> float:
        """Sum of squares of the error if the tissue does not move."""
        return self.solved(Fit().beats, 0.0)[2]

    def is_clear(self, fit: Fit, *, is_proven: bool = False) -> bool:
        """Whether a fit is good, and shows that the tissue moves.

        Of a motion that is proven, which has explained what came later, less than two
        breaths do.
        """
        still = self.still
        length_s = self.count * STEP_S
        clearer, most = _CLEARER[0]
        least = 0.0
        for hz in fit.beats[:, 0].tolist():
            grid = BREATH
            periods = 1.0
            least_s = _BREATH_S[0]
            if hz > SLOWEST_HEART:
                grid = HEART
                periods = 4.0
                least_s = 0.0
            else:
                least = _UNLIKE * self.count
                is_long = is_proven or length_s > max(_BREATH_S[1], 2.0 / hz)
                clearer, most = _CLEARER[1 if is_long else 2]
            is_known = grid[0] - 0.03 < hz < grid[-1] + 0.03
            if not is_known or length_s < max(periods / hz, least_s):
                return False
        is_lower = still > max(clearer * fit.error, fit.error + CLEAR, least)
        return is_lower and fit.error < most * self.count

    def waves(self, hz: Array) -> tuple[Array, float]:
        """As `_waves`, of these frequencies."""
        courses = np.array((self.time_s, self.travel, self.speed, self.later))
        return _waves(hz, courses, self.one, self.force)

    def first_fit(self, hz: Array, time_s: float) -> Fit:
        """A motion of these frequencies that damping would turn into the waves of
        the force.
        """
        found = self.waves(hz)[0]
        y = float(self.travel[-1])
        damping = (
            self.slope * FRACTION * max(y, 0.0) / (COULOMB_SPEED + self.pace) + 1e-3
        )
        waves = found[8:].reshape(len(hz), 2, 2, 2) @ np.array(
            [1.0, y]
        )  # beat, harmonic, cos/sin
        rate = 2.0 * math.pi * np.outer(hz, (1.0, 2.0)) * damping
        sizes = np.stack(
            (waves[:, :, 1] / rate, -waves[:, :, 0] / rate), axis=2
        ).reshape(-1, 4)
        fits = []
        at_s = float(self.time_s[-1])
        most = _stds(hz[:, None])[:, 1:2]
        for scale in (0.5, 1.0, 2.0):
            limited = np.minimum(np.maximum(scale * sizes, -most), most)
            beats = np.hstack((hz[:, None], limited))
            fits.append(Fit(beats, at_s, self.solved(beats, at_s)[2]))
        return turned(min(fits, key=lambda fit: fit.error), time_s)

    def turned_fit(self, fit: Fit, size: float) -> Fit:
        """A fit with its slow beat of such a size and of any phase, if that leaves
        less error.
        """
        beats = fit.beats.copy()
        best = fit
        for phase in np.arange(0.0, 2.0 * math.pi, 0.25 * math.pi).tolist():
            beats[0, 1:] = size * math.cos(phase), size * math.sin(phase), 0.0, 0.0
            error = self.solved(beats, fit.at_s)[2]
            if error < best.error:
                best = Fit(beats.copy(), fit.at_s, error)
        return best

    def stepped(self, fit: Fit, *, is_prior: bool = False) -> Fit:
        """One Gauss-Newton step; `is_prior` keeps a motion in use near what it was."""
        beats = fit.beats
        at_s = fit.at_s
        rows, linear, _, error = self.solved(beats, at_s)
        stds = _stds(beats)
        target = beats.copy()
        if is_prior:
            stds[:, 1:] = 0.3 * np.abs(beats[:, 1:]) + 0.1 * stds[:, 1:]
            stds[:, 0] = 0.02
        else:
            target[:, 1:] = 0.0
        pull = ((target - beats) / stds**2).ravel()
        step = _step(
            (rows, self._slopes(fit, linear)),
            error,
            self.prior[0],
            stds.ravel(),
            pull,
            fit.damping,
        )
        change = step.reshape(beats.shape)
        left = float(error @ error)
        before = left + float((((beats - target) / stds) ** 2).sum())
        for _ in range(3):
            tried = beats + change
            error = self.solved(tried, at_s)[2]
            if error + float((((tried - target) / stds) ** 2).sum()) < before:
                return Fit(
                    tried, at_s, error, self._rms(error), max(0.5 * fit.damping, 1e-3)
                )
            change = 0.3 * change
        return fit._replace(
            error=left, rms_N=self._rms(left), damping=min(3.0 * fit.damping, 1.0)
        )

    def _rms(self, error: float) -> float:
        middle = np.partition(self.one, len(self.one) // 2)[len(self.one) // 2]
        # Of a short window a motion goes on for less long as it was.
        return (
            math.sqrt(error / self.count)
            / max(float(middle), 1.0)
            * SIZE
            / max(self.count, 50)
        )


def _stds(beats: Array) -> Array:
    """Standard deviations of the five numbers of each beat, whose frequencies come
    first.
    """
    return np.where(beats[:, :1] < SLOWEST_HEART, _BREATH_STD, _HEART_STD)
