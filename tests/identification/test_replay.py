"""A recording through the identifier does not depend on how it is written down."""

from functools import cache
from typing import NamedTuple

import numpy as np
import pytest

from groundtruth import insert_needle
from identification import replay
from tests.identification.worlds import rows_of, run

RATE_HZ = 250.0


class Recording(NamedTuple):
    """Columns in the order of the arguments of `replay`, each of shape (n,)."""

    t_s: np.ndarray
    depth_m: np.ndarray
    force_N: np.ndarray
    speed_m_s: np.ndarray


@cache
def record():
    """One gel, from 10 mm in front of it until the needle has left it."""
    made = insert_needle("gel-25-constant", seed=3, rate_hz=RATE_HZ)
    is_kept = (made.t_s > made.tare_end_s) & (made.depth_m > -10e-3)
    is_kept &= made.t_s < made.truth.rupture_s[0] + 3.0
    columns = (made.t_s, made.depth_m, made.force_N, made.speed_m_s)
    return Recording(*(column[is_kept] for column in columns))


@cache
def replayed():
    return replay(*record())


def still(recording):
    """The same with a needle that rests in front of the tissue for a second first."""
    count = round(RATE_HZ)
    noise_N = np.random.default_rng(1).normal(0.0, 0.01, count)
    return Recording(
        np.arange(count + len(recording.t_s)) / RATE_HZ,
        np.append(np.full(count, recording.depth_m[0]), recording.depth_m),
        np.append(noise_N, recording.force_N),
        np.append(np.zeros(count), recording.speed_m_s),
    )


def cut_approach(recording):
    """The same from 1 mm in front of the tissue on."""
    begin = int(np.argmax(recording.depth_m > -1e-3))
    return Recording(*(column[begin:] for column in recording))


CHANGES = {
    "depth begins 0.2 m in front": lambda r: r._replace(depth_m=r.depth_m - 0.2),
    "depth begins at 1 m": lambda r: r._replace(depth_m=r.depth_m + 1.0),
    "time begins at 1.7e9 s": lambda r: r._replace(t_s=r.t_s + 1.7e9),
    "a still second in front": still,
    "no approach": cut_approach,
    "half the rate": lambda r: Recording(*(column[::2] for column in r)),
    "rows twice": lambda r: Recording(*(np.repeat(column, 2) for column in r)),
}


@pytest.mark.slow
@pytest.mark.parametrize("change", CHANGES)
def test_the_same_insertion_has_the_same_layers(change):
    (layer,) = replayed().layers
    (after,) = replay(*CHANGES[change](record())[:3]).layers
    std_N = np.hypot(layer.friction_std_N, after.friction_std_N)

    assert abs(after.friction_N - layer.friction_N) < std_N
    assert after.thickness_m == pytest.approx(layer.thickness_m, abs=3e-4)


def test_a_replay_is_a_loop_over_update():
    t_s, depth_m, force_N, speed_m_s = record()
    steps_s = np.append(1.0 / RATE_HZ, np.diff(t_s))
    _, looped = run(rows_of(depth_m, speed_m_s, force_N, steps_s))

    assert [e.tip_force_N for e in replayed().estimates] == pytest.approx(
        [e.tip_force_N for e in looped], abs=1e-9
    )


def test_late_rows_and_a_clock_set_back_hide_no_event():
    t_s, depth_m, *others = record()
    signals = depth_m, *others
    row = np.arange(len(t_s))
    late_s = t_s - 0.05 * ((row >= 400) & ((row - 400) % (len(t_s) // 30) == 0))
    back_s = t_s - 20.0 * (row >= np.argmax(depth_m > 0.004))
    late = replay(late_s, *signals)
    set_back = replay(back_s, *signals, dt_s=np.diff(back_s, prepend=-np.inf))
    rupture_s, *others_s = (
        [layer.rupture.time_s for layer in result.layers]
        for result in (replayed(), late, set_back)
    )

    assert sum(not e.status.is_used for e in set_back.estimates) <= 12
    # Events are on the clock of the log, which stands 20 s earlier by then.
    assert others_s == [
        [pytest.approx(rupture_s[0], abs=0.02)],
        [pytest.approx(rupture_s[0] - 20.0, abs=0.03)],
    ]


def test_a_bad_stamp_or_depth_spoils_its_own_row_only():
    t_s, depth_m, *others = (column.copy() for column in record())
    t_s[[0, 500, 501, 800]] = np.nan
    depth_m[300] = np.nan
    result = replay(t_s, depth_m, *others)
    rejected = [k for k, e in enumerate(result.estimates) if not e.status.is_used]

    assert (rejected, len(result.layers)) == ([0, 300, 500, 501, 800], 1)


def test_a_mostly_still_clock_has_a_usual_step_and_a_jump_of_it_is_counted():
    t_s = np.repeat(np.arange(100) / 100, 3)
    result = replay(t_s, 0.01 * t_s, 0.0 * t_s)
    jumped = replay(t_s + 1e9 * (t_s > 0.5), t_s, t_s)

    assert sum(estimate.status.is_used for estimate in result.estimates) == 100
    assert any("dt" in hint.text for hint in jumped.hints)


@pytest.mark.parametrize(
    ("change", "word"),
    [
        (lambda r: r._replace(speed_m_s=-r.speed_m_s), "speed"),
        (lambda r: r._replace(depth_m=0.0 * r.depth_m), "nothing"),
        (lambda r: r._replace(force_N=-r.force_N), "negative"),
        (lambda r: r._replace(depth_m=-r.depth_m, speed_m_s=-r.speed_m_s), "falls"),
        (lambda r: r._replace(depth_m=1e3 * r.depth_m), "millimetres"),
    ],
)
def test_wrong_signs_and_units_get_a_hint(change, word):
    hints = replay(*change(record())).hints

    assert any(word in hint.text for hint in hints)
    assert replayed().hints == ()


@pytest.mark.parametrize("offset_N", [-49.0, 22.0])
def test_an_offset_of_the_sensor_is_no_sign(offset_N):
    offset = record()._replace(force_N=record().force_N + offset_N)
    turned = record()._replace(force_N=-record().force_N + offset_N)

    assert replay(*offset).hints == ()
    assert any("negative" in hint.text for hint in replay(*turned).hints)
