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
(Golub and Pereyra 1973) by Gauss-Newton steps. Where to begin, a scan of frequencies
and a breath's phases say. Lengths are in mm, speeds in mm/s.
"""

import math
from typing import NamedTuple

import numpy as np

from foundation.arrays import Array, Matrix, Vector
from foundation.jit import compiled
from foundation.linear_algebra import decompose_cholesky, dot, solve_cholesky
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

BREATHS_HZ = np.linspace(0.15, 0.45, 13)
"""Breathing frequencies that are scanned: 9 to 27 breaths a minute."""

HEARTBEATS_HZ = np.linspace(0.8, 1.9, 23)
"""Heartbeat frequencies that are scanned: 48 to 114 beats a minute."""

MAX_BREATHING_HZ = 0.6
"""A slower beat is a breath, a quicker one a heartbeat."""

BREATHING_STD = np.array([0.03, 1.5, 1.5, 0.75, 0.75])
"""Standard deviation of a breath's frequency [Hz] from one step on, and of its sizes
[mm]."""

HEARTBEAT_STD = np.array([0.05, 0.3, 0.3, 0.15, 0.15])
"""The same of a heartbeat."""

MIN_BREATH_S = 6.0
"""Least length of a window that shows a breath: a shorter one takes part of a breath
for a quick one."""

MIN_TWO_BREATHS_S = 10.0
"""Least length of a window that shows two."""

HEARTBEAT_PERIODS = 4.0
"""Periods of a heartbeat that a window must hold."""

FREQUENCY_MARGIN_HZ = 0.03
"""By which a fitted frequency may lie outside the scanned ones."""

GOOD_ERROR = 0.05
"""Mean square of a good fit's errors."""

FAIR_ERROR = 0.5
"""Mean square of a fair fit's errors."""

CLEARLY_LOWER = 10.0
"""The motion must lower the sum of squares of the errors by this."""

BENT_ERROR = 1.5
"""Breath shows only where the force in tissue at rest is off by more than it admits, a
mean square of 1: a membrane, or a layer of another law, bends the force within that, as
a slow breath would."""

NOISE_N = 0.02
"""Error of a mean force."""

RELATIVE_ERROR = 0.03
"""Its part in proportion to the force."""

LAYER_UNKNOWNS = 7
"""Linear unknowns that a layer has of its own: c, b, T, K, H, E, F."""

SHARED_UNKNOWNS = 3
"""Linear unknowns that all layers share: o, C, V."""

WAVE_COLUMNS = 4
"""Columns of a wave: cosine and sine, each also growing with the travel."""

COURSE_COLUMNS = 8
"""Columns of a smooth course beside waves."""

SLOPE_MEANS = 25
"""Means at either end of a layer that its growth is taken from."""

SLOPE_RANK = 5
"""Of these the fifth largest lies above most turns of friction."""

MIN_SLOPE_N_PER_MM = 0.005
"""Growth of the force in a layer, at least."""

MIN_SPEED_MM_S = 0.3
"""Speed that viscous friction refers to, at least."""

MIN_FORCE_N = 0.05
"""Force that the priors refer to, at least."""

OFFSET_STD_N = 0.05
"""Prior standard deviation of the offset."""

SPLIT_STD = 0.3
"""Prior standard deviation of how both frictions split a layer's growth."""

FREQUENCY_STEP_HZ = 1e-4
"""Step of a frequency for derivatives."""

SIZE_STEP_MM = 1e-3
"""Step of a size for derivatives."""

KEPT_SIZE_FRACTION = 0.3
"""Standard deviation of a size of a motion in use, as a part of it."""

KEPT_STD_FRACTION = 0.1
"""The same, as a part of that of any motion."""

KEPT_FREQUENCY_STD_HZ = 0.02
"""Standard deviation of its frequency."""

FIRST_SCALES = (0.5, 1.0, 2.0)
"""Scales of the first fit that are tried: damping is known roughly."""

MIN_FRICTION_NS_PER_MM = 1e-3
"""Friction per speed of a first fit, at least."""

MIN_DAMPING = 1e-3
"""Levenberg's damping, at least."""

MAX_DAMPING = 1.0
"""Levenberg's damping, at most."""

MAX_SHORTENINGS = 3
"""Lengths of a step that are tried."""

SHORTENING = 0.3
"""Part of a step that is tried next."""

MIN_WINDOW_COUNT = 50
"""Means that the rest of a fit refers to, at least."""

REGULARISATION = 1e-9
"""What is added to information, relative to it: of unknowns that nothing separates."""

TINY = 1e-12
"""What keeps a denominator above zero."""

Pair = tuple[Matrix, Matrix]
"""Two matrices of one shape."""


class Clearness(NamedTuple):
    """What a motion must reach to be taken for one.

    Attributes:
        factor: By which it lowers the sum of squares of the errors.
        max_error: Mean square of the errors that it leaves, at most.
    """

    factor: float
    max_error: float


CLEAR_HEARTBEAT = Clearness(4.0, FAIR_ERROR)
"""For a heartbeat alone."""

CLEAR_BREATHING = Clearness(20.0, FAIR_ERROR)
"""For breathing: a layer that bends looks like one."""

CLEAR_BREATH = Clearness(100.0, GOOD_ERROR)
"""For less than two breaths."""


UNKNOWN_ERROR = 1e30
"""Error of what has not been fitted yet: larger than any other."""


class Fit(NamedTuple):
    """A motion fitted to a window.

    Attributes:
        beats: f [Hz], a1, b1, a2, b2 [mm] of each, the slowest first, shape (m, 5).
        at_s: Time from which their phases count.
        error: Sum of squares of the errors that it leaves.
        rms_N: Force that it leaves.
        damping: Levenberg's.
    """

    beats: Array = np.zeros((0, 5))
    at_s: float = 0.0
    error: float = UNKNOWN_ERROR
    rms_N: float = 0.0
    damping: float = 0.01

    GROWING = ("beats",)


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


@compiled
def _derivatives(beats: Matrix, time_s: Vector) -> Pair:
    """Return derivatives of place and speed by the five numbers of each beat.

    Args:
        beats: As in `Fit`, shape (m, 5).
        time_s: Times since the phases' zero, shape (n,).

    Returns:
        Two arrays of shape (5 m, n).
    """
    places = np.zeros((beats.size, len(time_s)))
    speeds = np.zeros((beats.size, len(time_s)))
    for k in range(len(beats)):
        row = 5 * k
        for i in range(len(time_s)):
            time = time_s[i]
            cosine = math.cos(2.0 * math.pi * beats[k, 0] * time)
            sine = math.sin(2.0 * math.pi * beats[k, 0] * time)
            for h in range(1, 3):
                hertz = 2.0 * math.pi * h
                rate = hertz * beats[k, 0]
                a = beats[k, 2 * h - 1]
                b = beats[k, 2 * h]
                ahead = b * cosine - a * sine
                behind = a * cosine + b * sine
                places[row, i] += hertz * time * ahead
                speeds[row, i] += hertz * (ahead - rate * time * behind)
                places[row + 2 * h - 1, i] = cosine
                places[row + 2 * h, i] = sine
                speeds[row + 2 * h - 1, i] = -rate * sine
                speeds[row + 2 * h, i] = rate * cosine
                double_sine = 2.0 * cosine * sine
                cosine = cosine * cosine - sine * sine
                sine = double_sine
    return places, speeds


class LinearFit(NamedTuple):
    """Least squares beside prior information.

    Attributes:
        unknowns: Shape (n,).
        errors: That they leave, shape (m,).
    """

    unknowns: Vector
    errors: Vector


@compiled
def solve_least_squares(
    rows: Matrix, values: Vector, information: Matrix, pull: Vector
) -> LinearFit:
    """Solve rows @ unknowns = values, beside prior information.

    Args:
        rows: Shape (m, n).
        values: Shape (m,).
        information: Prior information on the unknowns, shape (n, n).
        pull: That information times the prior mean, shape (n,).
    """
    count, size = rows.shape
    square = information.copy()
    right_side = pull.copy()
    for k in range(count):
        for i in range(size):
            factor = rows[k, i]
            right_side[i] += factor * values[k]
            for j in range(i + 1):
                square[i, j] += factor * rows[k, j]
    for i in range(size):
        square[i, i] += REGULARISATION * square[i, i] + TINY
    unknowns = solve_cholesky(decompose_cholesky(square), right_side)
    errors = values.copy()
    for k in range(count):
        errors[k] -= dot(rows[k], unknowns)
    return LinearFit(unknowns, errors)


class Waves(NamedTuple):
    """Waves fitted to the force.

    Attributes:
        coefficients: Of the course and the waves, shape (8 + 8 m,).
        error: Mean square of what they leave.
    """

    coefficients: Array
    error: float


@compiled
def fit_waves(
    hz: Vector,
    time_s: Vector,
    travel: Vector,
    speed: Vector,
    later: Vector,
    weight: Vector,
    force: Vector,
) -> tuple[Vector, float]:
    """Return the fields of `Waves`: a smooth course, and waves that grow with travel.

    Args:
        hz: Frequencies of the waves, each with its double, shape (m,).
        time_s: Shape (n,).
        travel: Since the begin of the window [mm], shape (n,).
        speed: Of the needle [mm/s], shape (n,).
        later: Travel in a second layer, negative outside one, shape (n,).
        weight: One over the standard deviation of each force, shape (n,).
        force: Over its deviation, shape (n,).
    """
    count = len(travel)
    matrix = np.zeros((count, COURSE_COLUMNS + 2 * WAVE_COLUMNS * len(hz)))
    columns = matrix.shape[1]
    scale = np.zeros(columns)
    for i in range(count):
        row = matrix[i]
        row[0] = 1.0
        row[1] = travel[i]
        row[2] = travel[i] ** 2
        row[3] = travel[i] ** 3
        row[4] = speed[i]
        row[5] = speed[i] * travel[i]
        row[6] = 1.0 if later[i] >= 0.0 else 0.0
        row[7] = max(later[i], 0.0)
        column = COURSE_COLUMNS
        for k in range(2 * len(hz)):
            frequency_hz = hz[k // 2] * (1 + k % 2)
            phase = 2.0 * math.pi * frequency_hz * (time_s[i] - time_s[count - 1])
            row[column] = math.cos(phase)
            row[column + 1] = row[column] * travel[i]
            row[column + 2] = math.sin(phase)
            row[column + 3] = row[column + 2] * travel[i]
            column += WAVE_COLUMNS
        for j in range(columns):
            row[j] *= weight[i]
            scale[j] += row[j] ** 2
    for j in range(columns):
        scale[j] = math.sqrt(scale[j]) + TINY
    for i in range(count):
        for j in range(columns):
            matrix[i, j] /= scale[j]
    no_information = np.zeros((columns, columns))
    solution = solve_least_squares(matrix, force, no_information, no_information[0])
    coefficients = np.zeros(columns)
    for j in range(columns):
        coefficients[j] = solution.unknowns[j] / scale[j]
    return coefficients, dot(solution.errors, solution.errors) / count


@compiled
def force_rows(
    contact: tuple[Vector, Vector],
    depth: Vector,
    speed: Vector,
    weight: Vector,
    begin: int,
) -> Matrix:
    """Return the rows of the force in its linear unknowns, each over its deviation.

    Args:
        contact: Presliding deflection, and what remains of the tip's force, shapes
            (n,).
        depth: Relative to the tissue, shape (n,).
        speed: Relative to the tissue, shape (n,).
        weight: One over the standard deviation of each force, shape (n,).
        begin: Row at which a second layer begins, 0 without one.

    Returns:
        Shape (n, 3 + 7 layers).
    """
    w, g = contact
    layers = 2 if begin else 1
    rows = np.zeros((len(speed), SHARED_UNKNOWNS + LAYER_UNKNOWNS * layers))
    end = depth[0]
    deepest = depth[0]
    for k in range(len(speed)):
        deepest = max(deepest, depth[k])
        end = deepest if k <= begin else end
        rows[k, 0] = weight[k]
        rows[k, 1] = w[k] * weight[k]
        rows[k, 2] = speed[k] * weight[k]
        for layer in range(layers):
            if layer == 1:
                shaft = deepest - end
            elif begin:
                shaft = end - depth[0]
            else:
                shaft = deepest - depth[0]
            first = SHARED_UNKNOWNS + LAYER_UNKNOWNS * layer
            rows[k, first] = rows[k, 1] * shaft
            rows[k, first + 1] = rows[k, 2] * shaft
            is_in_second = begin > 0 and k >= begin
            if is_in_second == (layer == 1):
                tip = g[k] * weight[k]
                place = shaft - deepest + depth[k]
                rows[k, first + 2] = tip
                rows[k, first + 3] = tip * shaft
                rows[k, first + 4] = tip * shaft**2
                rows[k, first + 5] = place * weight[k]
                rows[k, first + 6] = place**2 * weight[k]
    return rows


@compiled
def force_changes(
    contact: Pair, courses: Pair, weight: Vector, begin: int, linear: Vector
) -> Matrix:
    """Return what courses of the needle change of the force of the first.

    Args:
        contact: As in `force_rows`, a course a row, shapes (m, n).
        courses: Depths and speeds relative to the tissue, shapes (m, n).
        weight: As in `force_rows`.
        begin: As in `force_rows`.
        linear: The linear unknowns.

    Returns:
        Shape (n, m - 1).
    """
    w, g = contact
    depths, speeds = courses
    count = len(weight)
    changes = np.zeros((count, len(depths) - 1))
    first_forces = np.zeros(count)
    for k in range(len(depths)):
        rows = force_rows((w[k], g[k]), depths[k], speeds[k], weight, begin)
        for i in range(count):
            force = dot(rows[i], linear)
            if k == 0:
                first_forces[i] = force
            else:
                changes[i, k - 1] = force - first_forces[i]
    return changes


@compiled
def gauss_newton_step(
    rows: Pair, error: Vector, prior: Matrix, stds: Vector, pull: Vector, damping: float
) -> Vector:
    """Return the change of a motion's numbers by a step, damped as Levenberg does.

    Args:
        rows: Those of the linear unknowns, shape (n, m), and derivatives by the numbers
            of the motion, shape (n, p).
        error: Of the force, shape (n,).
        prior: Information on the linear unknowns beforehand, shape (m, m).
        stds: Prior deviations of the numbers, shape (p,).
        pull: That draws the numbers to their prior means, shape (p,).
        damping: Levenberg's.
    """
    linear, slopes = rows
    count, linear_count = linear.shape
    number_count = len(stds)
    size = linear_count + number_count
    columns = np.zeros((count, size))
    squares = np.zeros(number_count)
    for i in range(count):
        for j in range(linear_count):
            columns[i, j] = linear[i, j]
        for k in range(number_count):
            columns[i, linear_count + k] = slopes[i, k]
            squares[k] += slopes[i, k] ** 2
    information = np.zeros((size, size))
    all_pull = np.zeros(size)
    for i in range(linear_count):
        for j in range(linear_count):
            information[i, j] = prior[i, j]
    for k in range(number_count):
        prior_information = stds[k] ** -2.0
        damped = damping * (prior_information + squares[k])
        information[linear_count + k, linear_count + k] = prior_information + damped
        all_pull[linear_count + k] = pull[k]
    fit = solve_least_squares(columns, error, information, all_pull)
    return fit.unknowns[linear_count:]


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


def _growth(force: Array) -> float:
    """Return how far the force in a layer has grown, turns of friction left out."""
    oldest = force[:SLOPE_MEANS]
    newest = force[-SLOPE_MEANS:]
    rank = -min(SLOPE_RANK, len(oldest))
    return float(np.partition(newest, rank)[rank] - np.partition(oldest, rank)[rank])


def _stds(beats: Array) -> Array:
    """Return standard deviations of the five numbers of each beat.

    The frequencies are the first column.
    """
    return np.where(beats[:, :1] < MAX_BREATHING_HZ, BREATHING_STD, HEARTBEAT_STD)


class Prior(NamedTuple):
    """Prior information on the linear unknowns.

    Attributes:
        information: Shape (n, n).
        pull: Information times the prior mean, shape (n,).
    """

    information: Array
    pull: Array


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

    def __init__(self, window: Array, until_s: float, from_s: float) -> None:
        self._time_s, self._depth, self._speed, force = window.T.copy()
        size_N = np.abs(force)
        self._travel = self._depth - self._depth[0]
        until, end = np.searchsorted(self._time_s, (until_s, from_s)).tolist()
        self._begin = end if end < len(window) else 0
        self._weight = 1.0 / (NOISE_N + RELATIVE_ERROR * size_N)
        self._weight[until:end] = 0.0  # while the force was released
        self.count = max(len(window) - max(end - until, 0), 1)
        layers = force[:until], force[end:]
        grown_N = sum(_growth(layer) for layer in layers if len(layer))
        travel_mm = max(float(self._travel[-1]), 1.0)
        self._slope = max(grown_N / travel_mm, MIN_SLOPE_N_PER_MM)
        self._mean_speed = max(float(self._speed.mean()), MIN_SPEED_MM_S)
        begin_mm = self._travel[self._begin] if self._begin else math.inf
        # Travel in a second layer; before it, and without one, negative.
        self._later = self._travel - begin_mm
        self._force = force * self._weight
        self._prior = self._make_prior(max(float(size_N.max()), MIN_FORCE_N))

    def _make_prior(self, force_N: float) -> Prior:
        """Return the prior of the linear unknowns, for a largest force."""
        layers = 2 if self._begin else 1
        slope = self._slope
        pull = np.zeros(SHARED_UNKNOWNS + LAYER_UNKNOWNS * layers)
        of_layer = (slope, slope / 3, force_N, slope, slope / 10, slope, slope / 10)
        stds = [OFFSET_STD_N, force_N, force_N / 3, *of_layer * layers]
        information = np.diag(np.array(stds) ** -2.0)
        # How Coulomb and viscous friction split what was there before.
        shared_std = SPLIT_STD * force_N / slope
        self._relate(information, 1, -COULOMB_SPEED_MM_S, shared_std)
        for coulomb in range(SHARED_UNKNOWNS, len(stds), LAYER_UNKNOWNS):
            # Growth of friction as a part of the force's, and how both split it.
            self._relate(information, coulomb, self._mean_speed, FRICTION_FRACTION_STD)
            self._relate(information, coulomb, -COULOMB_SPEED_MM_S, SPLIT_STD)
            pull[coulomb] = FRICTION_FRACTION / (FRICTION_FRACTION_STD**2 * slope)
            pull[coulomb + 1] = self._mean_speed * pull[coulomb]
        return Prior(information, pull)

    def _relate(
        self, information: Array, coulomb: int, speed: float, std: float
    ) -> None:
        """Add that Coulomb plus viscous friction times a speed is known to a deviation.

        Args:
            information: That is changed, shape (n, n).
            coulomb: Index of the Coulomb friction; the viscous one follows it.
            speed: That multiplies the viscous friction [mm/s].
            std: Over the growth of the force.
        """
        viscous = coulomb + 1
        variance = (std * self._slope) ** 2
        information[coulomb, coulomb] += 1.0 / variance
        information[viscous, viscous] += speed * speed / variance
        shared = information[coulomb, viscous] + speed / variance
        information[coulomb, viscous] = shared
        information[viscous, coulomb] = shared

    def solve(self, beats: Array, at_s: float) -> Solution:
        """Return the force that a motion explains.

        Args:
            beats: As in `Fit`, shape (m, 5).
            at_s: Time from which their phases count.
        """
        place, speed = displacement(beats, self._time_s - at_s)
        depth = self._depth - place
        deflections, remaining = contact_along(depth[None])
        contact = (deflections[0], remaining[0])
        speed = self._speed - speed
        rows = force_rows(contact, depth, speed, self._weight, self._begin)
        linear, errors = solve_least_squares(rows, self._force, *self._prior)
        return Solution(rows, linear, errors, float(errors @ errors))

    def _slopes(self, fit: Fit, linear: Array) -> Array:
        """Return derivatives of the force by a motion's numbers, shape (n, 5 m)."""
        beats = fit.beats
        time_s = self._time_s - fit.at_s
        places, speeds = _derivatives(beats, time_s)
        place, speed = displacement(beats, time_s)
        # What turns round remembers its way there: differences.
        of_beat = (FREQUENCY_STEP_HZ, *(SIZE_STEP_MM,) * 4)
        steps = np.array(of_beat * len(beats))[:, None]
        depths = self._depth - np.vstack((place, place + steps * places))
        speeds = self._speed - np.vstack((speed, speed + steps * speeds))
        contact = contact_along(depths)
        courses = (depths, speeds)
        changes = force_changes(contact, courses, self._weight, self._begin, linear)
        return changes / steps.T

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
        error_at_rest = self.error_at_rest
        length_s = self.count * WINDOW_STEP_S
        clearness = CLEAR_HEARTBEAT
        min_error_at_rest = 0.0
        for hz in fit.beats[:, 0].tolist():
            if hz > MAX_BREATHING_HZ:
                scanned_hz = HEARTBEATS_HZ
                min_length_s = HEARTBEAT_PERIODS / hz
            else:
                scanned_hz = BREATHS_HZ
                min_length_s = max(1.0 / hz, MIN_BREATH_S)
                min_error_at_rest = BENT_ERROR * self.count
                is_long = is_proven or length_s > max(MIN_TWO_BREATHS_S, 2.0 / hz)
                clearness = CLEAR_BREATHING if is_long else CLEAR_BREATH
            min_hz = scanned_hz[0] - FREQUENCY_MARGIN_HZ
            max_hz = scanned_hz[-1] + FREQUENCY_MARGIN_HZ
            if not min_hz < hz < max_hz or length_s < min_length_s:
                return False
        is_lower = error_at_rest > max(
            clearness.factor * fit.error, fit.error + CLEARLY_LOWER, min_error_at_rest
        )
        return is_lower and fit.error < clearness.max_error * self.count

    def fit_waves(self, hz: Array) -> Waves:
        """Return waves of these frequencies that explain the force best, shape (m,)."""
        courses = self._time_s, self._travel, self._speed, self._later
        return Waves(*fit_waves(hz, *courses, self._weight, self._force))

    def first_fit(self, hz: Array, time_s: float) -> Fit:
        """Return a motion that damping would turn into the waves of the force.

        Args:
            hz: Its frequencies, shape (m,).
            time_s: From which its phases count.
        """
        coefficients = self.fit_waves(hz).coefficients
        travel_mm = float(self._travel[-1])
        friction = self._slope * FRICTION_FRACTION * max(travel_mm, 0.0)
        damping = friction / (COULOMB_SPEED_MM_S + self._mean_speed)
        damping += MIN_FRICTION_NS_PER_MM
        # Axes: beat, harmonic, cosine and sine, constant and growing.
        parts = coefficients[COURSE_COLUMNS:].reshape(len(hz), 2, 2, 2)
        waves = parts @ np.array([1.0, travel_mm])
        rate = 2.0 * math.pi * np.outer(hz, (1.0, 2.0)) * damping
        cosines = waves[:, :, 1] / rate
        sines = -waves[:, :, 0] / rate
        sizes = np.stack((cosines, sines), axis=2).reshape(-1, 4)
        at_s = float(self._time_s[-1])
        limits = _stds(hz[:, None])[:, 1:2]
        fits = []
        for scale in FIRST_SCALES:
            limited = np.minimum(np.maximum(scale * sizes, -limits), limits)
            beats = np.hstack((hz[:, None], limited))
            fits.append(Fit(beats, at_s, self.solve(beats, at_s).error))
        return turned(min(fits, key=lambda fit: fit.error), time_s)

    def turned_fit(self, fit: Fit, size_mm: float) -> Fit:
        """Return a fit with its slow beat of such a size and of any phase.

        It is the fit itself where that leaves the least error.
        """
        beats = fit.beats.copy()
        best = fit
        for phase in np.arange(0.0, 2.0 * math.pi, 0.25 * math.pi).tolist():
            cosine = size_mm * math.cos(phase)
            sine = size_mm * math.sin(phase)
            beats[0, 1:] = (cosine, sine, 0.0, 0.0)
            error = self.solve(beats, fit.at_s).error
            if error < best.error:
                best = Fit(beats.copy(), fit.at_s, error)
        return best

    def stepped(self, fit: Fit, *, is_prior: bool = False) -> Fit:
        """Return a fit after one Gauss-Newton step.

        Args:
            fit: Before the step.
            is_prior: Whether it is in use, and stays near what it was.
        """
        beats = fit.beats
        solution = self.solve(beats, fit.at_s)
        stds = _stds(beats)
        target = beats.copy()
        if is_prior:
            sizes = KEPT_SIZE_FRACTION * np.abs(beats[:, 1:])
            stds[:, 1:] = sizes + KEPT_STD_FRACTION * stds[:, 1:]
            stds[:, 0] = KEPT_FREQUENCY_STD_HZ
        else:
            target[:, 1:] = 0.0
        pull = ((target - beats) / stds**2).ravel()
        rows = (solution.rows, self._slopes(fit, solution.linear))
        information = self._prior.information
        step = gauss_newton_step(
            rows, solution.errors, information, stds.ravel(), pull, fit.damping
        )
        change = step.reshape(beats.shape)
        cost = solution.error + _prior_cost(beats, target, stds)
        for _ in range(MAX_SHORTENINGS):
            tried = beats + change
            error = self.solve(tried, fit.at_s).error
            if error + _prior_cost(tried, target, stds) < cost:
                damping = max(0.5 * fit.damping, MIN_DAMPING)
                return Fit(tried, fit.at_s, error, self._rms_N(error), damping)
            change = SHORTENING * change
        return fit._replace(
            error=solution.error,
            rms_N=self._rms_N(solution.error),
            damping=min(3.0 * fit.damping, MAX_DAMPING),
        )

    def _rms_N(self, error: float) -> float:
        """Return the force that a fit leaves, by its sum of squares."""
        middle = len(self._weight) // 2
        median_weight = max(float(np.partition(self._weight, middle)[middle]), 1.0)
        # Of a short window a motion goes on for less long as it was.
        length = max(self.count, MIN_WINDOW_COUNT)
        return math.sqrt(error / self.count) / median_weight * WINDOW_MEANS / length


def _prior_cost(beats: Array, target: Array, stds: Array) -> float:
    """Return the sum of squares of beats about their prior means."""
    return float((((beats - target) / stds) ** 2).sum())
