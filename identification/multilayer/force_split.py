"""What every sample asks of the switching filter: shaft friction out of the force.

All else is done once per block of samples, see `method`.
"""

import math

import numpy as np

from foundation.arrays import Matrix, Vector, WrittenVector
from foundation.jit import compiled
from identification.estimate import Outputs

_MM = 1e3
_BLOCK_S = 0.01
_BLOCK_MM = 0.06
_LEAST_S = 0.002
"""A block ends after a travel well below any release, or after a time; both are enough
to average the noise of single samples."""
_PRESLIDING_MM = 0.3
"""Travel over which friction turns after a reversal: gel clings for a fifth, soft
tissue for half a millimetre."""
_DEADBAND = 3.0
_LEAST_DEADBAND_M = 2e-5
"""Standard deviations of the depth, and least travel, within which the needle may not
have moved: an arm's joints have play, and a filtered depth swings past a sudden stop."""
_REST_SPEED = 0.1
_REST_S = 8.5
"""Slower than this [mm/s] the needle rests; real liver loses its force in that time."""
_RELAXED = 0.6
_UNKNOWN = 0.3
"""Part of the friction lost in a long rest, as of the whole force in real liver (19
holds of 60 s); and standard deviation of that part, and of friction while presliding
turns."""
_UNLOADED_M = 1e-3  # A tip drawn back by a needle diameter touches nothing
_UNLOADING_MM = 0.5  # travel over which its force goes on the way
_MASS_KG = 10.0
_JITTER = 3.0
_ACCELERATION_S = 0.03
_INERTIA_S = 0.2
"""Masses are known roughly, and inertia is taken out with another lag than the force
has: so a virtual force is uncertain where the arm accelerates. Mass that the needle is
taken to have there at most (an LWR's along it: 3 to 4 kg in the insertions, below 10 kg
in nine of ten postures); deviations of the speed's noise that are no acceleration; the
time over which that is measured, and the one for which it is remembered."""
IDENTIFIED = 0.25  # A value is identified if its standard deviation is no more of it
_TINY = 1e-12
_NOWHERE_M = -1e9  # deepest point before the first sample

# Places in the memory. Length of the block being filled, and integrals over it: of
# depth [m s], speed [m], presliding deflection [s], force [N s], unfiltered depth [m s]
# and variance of force by motion [N² s]. That deflection, -1 to 1; depth less the
# jitter of its measurement; how far friction may have let go at rest, 0 to 1; deepest
# point so far; noise of the last depth and speed; the arm's speed with a lag; square of
# the force that accelerates it, at most; that variance now.
FILLED, DEPTH_SUM, SPEED_SUM, DEFLECTION_SUM, FORCE_SUM, RAW_SUM, BY_MOTION_SUM = range(
    7
)
_DEFLECTION, _FOLLOWER, _REST, _DEEPEST, DEPTH_STD, SPEED_STD = range(7, 13)
_LAGGED, _INERTIA, _BY_MOTION = range(13, 16)
FIRST_MEMORY = np.zeros(16)
FIRST_MEMORY[_DEEPEST] = _NOWHERE_M
FIRST_MEMORY.setflags(write=False)

# Places in an answer, shape (10, 8): what the bank knows of the shaft at one depth, all
# hypotheses together; N, mm, mm/s. Its first row: whether tissue has been met; the
# layer the tip is in, from 1, 0 before contact; depth at which the first was met [m];
# depth the answer is of; variance of a sample's force; force at the tip; speed for the
# cumulative friction: that of the last rupture, 0 before the first, to take the present
# one; variance of the law's error. The second row holds the mean, the others the
# covariance of: force in free air; Coulomb and viscous friction of the layers left, and
# of the whole shaft; their growth with depth; stiffness of the tip's force.
IN_CONTACT, LAYER_NUMBER, CONTACT_M, DEPTH, NOISE, TIP_FORCE, CUMULATIVE_SPEED, _LAW = (
    range(8)
)
_OFFSET, LEFT_COULOMB, LEFT_VISCOUS, COULOMB, VISCOUS = range(5)
_OWN_COULOMB, _OWN_VISCOUS, _STIFFNESS = range(5, 8)
NO_ANSWER = np.zeros((10, 8))
NO_ANSWER.setflags(write=False)


@compiled
def _embedded(depth_m: float, layers: Matrix) -> tuple[float, float]:
    """Fraction of the Coulomb and the viscous friction of the layers left still on
    the shaft.
    """
    coulomb = viscous = all_coulomb = all_viscous = _TINY
    for k in range(len(layers)):
        fraction = min(max(depth_m - layers[k, 0], 0.0) / layers[k, 1], 1.0)
        coulomb += fraction * layers[k, 2]
        viscous += fraction * layers[k, 3]
        all_coulomb += layers[k, 2]
        all_viscous += layers[k, 3]
    return coulomb / all_coulomb, viscous / all_viscous


@compiled
def _variance(answer: Matrix, first: int, w: float, speed: float) -> float:
    """Of a Coulomb part times w and the viscous one behind it times the speed."""
    row = 2 + first
    variance = w * w * answer[row][first] + 2.0 * w * speed * answer[row][first + 1]
    return variance + speed * speed * answer[row + 1][first + 1]


@compiled
def _with_offset(
    answer: Matrix, first: int, w: float, speed: float, variance: float
) -> float:
    """Standard deviation of a force less the offset and such a friction of that
    variance.
    """
    both = w * answer[2][first] + speed * answer[2][first + 1]
    return math.sqrt(
        max(answer[0][NOISE] + answer[2][_OFFSET] + variance + 2.0 * both, 0.0)
    )


@compiled
def _per_speed(answer: Matrix, first: int, speed: float) -> tuple[float, float]:
    """Coulomb and viscous friction as one damping at a speed, and its standard
    deviation.
    """
    damping = answer[1][first] / speed + answer[1][first + 1]
    return damping, math.sqrt(max(_variance(answer, first, 1.0 / speed, 1.0), 0.0))


@compiled
def _not_pulled(tip: float, variance: float) -> tuple[float, float]:
    """Mean of a tip force cut off at zero, since no tissue pulls the tip, and variance
    that goes.

    The variance is that of the law's error: what the hypotheses do not know of.
    """
    std = math.sqrt(max(variance, _TINY))
    a = max(tip / std, -30.0)
    rise = (
        math.sqrt(2.0 / math.pi)
        * math.exp(-0.5 * a * a)
        / math.erfc(-math.sqrt(0.5) * a)
    )
    return std * (a + rise), variance * rise * (rise + a)


@compiled
def _forces(
    depth_m: float,
    speed: float,
    force: float,
    memory: Vector,
    answer: Matrix,
    layers: Matrix,
) -> tuple[float, float, float, float, float, float, float]:
    """Enhanced force, tip force and shaft friction, each with its standard deviation
    [N].

    The last number is the force that all this predicts.
    """
    w = memory[_DEFLECTION]
    rest = memory[_REST]
    mean = answer[1]
    offset = mean[_OFFSET]
    force = force - offset
    by_motion = memory[_BY_MOTION]
    std = math.sqrt(answer[0][NOISE] + answer[2][_OFFSET] + by_motion)
    further = _MM * depth_m - answer[0][DEPTH]
    tip = answer[0][TIP_FORCE] + mean[_STIFFNESS] * further
    if answer[0][IN_CONTACT] == 0.0:
        return force, std, force, std, 0.0, 0.0, offset + tip
    if depth_m < answer[0][CONTACT_M]:
        return force, std, force, std, 0.0, 0.0, offset
    is_unloaded = depth_m < memory[_DEEPEST] - _UNLOADED_M
    coulomb_fraction = viscous_fraction = 1.0
    if is_unloaded and len(layers) > 0:
        coulomb_fraction, viscous_fraction = _embedded(depth_m, layers)
    # Friction after a rest, and while it turns, lies somewhere between none and all of
    # it.
    loose = _UNKNOWN * max(1.0 - abs(w), rest)
    w *= 1.0 - _RELAXED * rest
    p = w * coulomb_fraction
    q = speed * viscous_fraction
    left = p * mean[LEFT_COULOMB] + q * mean[LEFT_VISCOUS]
    variance = _variance(answer, LEFT_COULOMB, p, q) + (loose * mean[LEFT_COULOMB]) ** 2
    left_std = _with_offset(answer, LEFT_COULOMB, p, q, variance + by_motion)
    if is_unloaded:
        own = w * max(
            mean[COULOMB] - mean[LEFT_COULOMB] + mean[_OWN_COULOMB] * further, 0.0
        )
        own += speed * max(
            mean[VISCOUS] - mean[LEFT_VISCOUS] + mean[_OWN_VISCOUS] * further, 0.0
        )
        return force - left, left_std, 0.0, std, force, std, offset + left + own
    friction = w * (mean[COULOMB] + mean[_OWN_COULOMB] * further)
    friction += speed * (mean[VISCOUS] + mean[_OWN_VISCOUS] * further)
    variance = _variance(answer, COULOMB, w, speed) + (loose * mean[COULOMB]) ** 2
    predicted = offset + friction + tip
    enhanced = force - left
    # A force counts less, the more uncertain motion makes it, beside what is not known
    # of friction.
    kept = 1.0 - by_motion / (answer[0][NOISE] + max(variance, 0.0) + by_motion + _TINY)
    excess = max(friction - force, 0.0)
    force = kept * force + (1.0 - kept) * (friction + tip)
    tip, known = _not_pulled(force - friction, w * w * answer[0][_LAW])
    # At rest the force may relax faster than this friction says.
    variance += kept * by_motion + excess**2 - known
    tip_std = _with_offset(answer, COULOMB, w, speed, variance)
    std = math.sqrt(max(variance, 0.0))
    return enhanced, left_std, tip, tip_std, force - tip, std, predicted


@compiled
def _layer(depth_m: float, answer: Matrix, layers: Matrix) -> int:
    """Number of the layer that the tip is in, 0 in free air before the first."""
    if depth_m < answer[0][CONTACT_M]:
        return 0
    number = int(answer[0][LAYER_NUMBER])
    for k in range(len(layers)):
        if depth_m < layers[k][0] + layers[k][1]:
            number -= 1
    return number


@compiled
def switching_outputs(
    depth_m: float,
    speed_m_s: float,
    force_N: float,
    memory: Vector,
    answer: Matrix,
    layers: Matrix,
) -> Outputs:
    """What to report of a sample: the fields of an `Estimate` from ``in_contact`` to
    the events.

    `layers`, shape (n, 4), are those left: where they begin [m], their thickness [m],
    and Coulomb [N] and viscous friction [N/(mm/s)] of their whole length.
    """
    speed = _MM * speed_m_s
    mean = answer[1]
    forces = _forces(depth_m, speed, force_N, memory, answer, layers)
    speed = max(abs(speed), _REST_SPEED)
    b, b_std = _per_speed(answer, _OWN_COULOMB, speed)
    if answer[0][CUMULATIVE_SPEED] != 0.0:
        speed = answer[0][CUMULATIVE_SPEED]
    d, d_std = _per_speed(answer, LEFT_COULOMB, speed)
    k = _MM * mean[_STIFFNESS]
    k_std = _MM * math.sqrt(answer[2 + _STIFFNESS][_STIFFNESS])
    b = _MM * _MM * b
    b_std = _MM * _MM * b_std
    in_contact = answer[0][IN_CONTACT] > 0.0
    stiffness = (k, k_std, in_contact and k_std <= IDENTIFIED * abs(k))
    damping = (
        b,
        b_std,
        in_contact and b_std <= IDENTIFIED * abs(b),
        _MM * d,
        _MM * d_std,
    )
    # Numba knows no starred parts of a tuple.
    return (in_contact, _layer(depth_m, answer, layers)) + forces + stiffness + damping  # noqa: RUF005


@compiled
def _presliding(deflection: float, travel: float) -> tuple[float, float]:
    """Presliding deflection after a travel [mm], and the part of the old one that is
    left.

    The exact solution of Dahl's law (1968, shape exponent 1): two half steps equal one.
    """
    kept = math.exp(-abs(travel) / _PRESLIDING_MM)
    aim = math.copysign(1.0, travel)
    return aim + (deflection - aim) * kept, kept


def shift_depth(memory: WrittenVector, by_m: float) -> None:
    """Count depth from elsewhere."""
    memory[_FOLLOWER] += by_m
    memory[_DEEPEST] += by_m
    memory[DEPTH_SUM] += by_m * memory[FILLED]
    memory[RAW_SUM] += by_m * memory[FILLED]


@compiled
def contact_along(depths_mm: Matrix) -> tuple[Matrix, Matrix]:
    """Presliding deflection, and part of the tip's force that is left, along courses of
    depths.

    A course is a row, shape (m, n); so are the results.
    """
    deflection = np.ones_like(depths_mm)
    left = np.ones_like(depths_mm)
    for course in range(len(depths_mm)):
        depth = depths_mm[course]
        deepest = depth[0]
        for k in range(1, len(depth)):
            travel = depth[k] - depth[k - 1]
            deflection[course, k] = _presliding(deflection[course, k - 1], travel)[0]
            deepest = max(deepest, depth[k])
            left[course, k] = min(
                max(1.0 - (deepest - depth[k]) / _UNLOADING_MM, 0.0), 1.0
            )
    return deflection, left


@compiled
def update_switching(
    sample: tuple[float, float, float, float, float, float, float],
    arm_m_s: float,
    dt_s: float,
    memory: WrittenVector,
    answer: Matrix,
    layers: Matrix,
) -> tuple[bool, Outputs]:
    """Use one sample.

    It is depth, speed and the deviations of their noise, the force and the deviation of
    its slow error, and the unfiltered depth. Depths and speed are those in the tissue,
    which may move; the arm has a speed of its own.

    Returns whether the block being filled is full, and what to report, see
    `switching_outputs`.
    """
    m = memory
    depth_m, speed_m_s, depth_std_m, speed_std_m_s, force_N, std, raw_m = sample
    m[_LAGGED] += (arm_m_s - m[_LAGGED]) * dt_s / (_ACCELERATION_S + dt_s)
    change = max(abs(arm_m_s - m[_LAGGED]) - _JITTER * speed_std_m_s, 0.0)
    inertia = (_MASS_KG * change / _ACCELERATION_S) ** 2
    m[_INERTIA] = max(inertia, m[_INERTIA] * math.exp(-dt_s / _INERTIA_S))
    m[_BY_MOTION] = min(std * std, m[_INERTIA])
    w = m[_DEFLECTION]
    last = m[_FOLLOWER]
    rest = m[_REST]
    if m[_DEEPEST] == _NOWHERE_M:
        last = depth_m
    deadband = max(_DEADBAND * depth_std_m, _LEAST_DEADBAND_M)
    follower = (
        depth_m - deadband
        if last < depth_m - deadband
        else min(last, depth_m + deadband)
    )
    if follower != last:
        w, kept = _presliding(w, _MM * (follower - last))
        rest *= kept
    if _MM * abs(speed_m_s) < _REST_SPEED:
        rest += (1.0 - rest) * -math.expm1(-dt_s / _REST_S)
    m[FILLED] += dt_s
    m[DEPTH_SUM] += dt_s * depth_m
    m[SPEED_SUM] += dt_s * speed_m_s
    m[DEFLECTION_SUM] += dt_s * w
    m[FORCE_SUM] += dt_s * force_N
    m[RAW_SUM] += dt_s * raw_m
    m[BY_MOTION_SUM] += dt_s * m[_BY_MOTION]
    m[_DEFLECTION] = w
    m[_FOLLOWER] = follower
    m[_REST] = rest
    m[_DEEPEST] = max(m[_DEEPEST], depth_m)
    m[DEPTH_STD] = depth_std_m
    m[SPEED_STD] = speed_std_m_s
    is_far = _MM * abs(m[SPEED_SUM]) >= _BLOCK_MM and m[FILLED] > _LEAST_S * (
        1.0 - 1e-6
    )
    is_full = is_far or m[FILLED] > _BLOCK_S * (1.0 - 1e-6)
    return is_full, switching_outputs(depth_m, speed_m_s, force_N, m, answer, layers)
