"""A recording through the identifier: what comes out does not depend on how rows
come."""

from itertools import pairwise
from typing import NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from groundtruth import insert_needle
from identification import Identifier, replay
from identification.log_replay import HEAD_ROWS, ReplayStream, SignCheck


class Columns(NamedTuple):
    """A recording in the order of the arguments of `replay`, each of shape (n,)."""

    t_s: np.ndarray
    depth_m: np.ndarray
    force_N: np.ndarray
    speed_m_s: np.ndarray


@pytest.fixture(scope="module")
def columns():
    """An insertion from the end of the free motion until it has left the gel, one
    depth missing."""
    run = insert_needle("gel-50-constant", seed=1, rate_hz=100.0)
    ends_s = run.tare_end_s, run.truth.rupture_s[0] + 3.0
    rows = slice(*np.searchsorted(run.t_s, ends_s))
    depth_m = run.depth_m[rows].copy()
    depth_m[300] = np.nan
    return Columns(run.t_s[rows], depth_m, run.force_N[rows], run.speed_m_s[rows])


@pytest.fixture(scope="module")
def results(columns):
    """What its replay gives, by whether it has the speed."""
    return {True: replay(*columns), False: replay(*columns[:3])}


@pytest.mark.slow
def test_a_replay_is_a_loop_over_update(columns, results):
    t_s, depth_m, force_N, speed_m_s = columns
    result = results[True]
    identifier = Identifier()
    usual = float(np.median(np.diff(t_s[:HEAD_ROWS])))
    dt_s = np.concatenate(([usual], np.diff(t_s))).tolist()
    columns = (
        depth_m.tolist(),
        speed_m_s.tolist(),
        force_N.tolist(),
        dt_s,
        t_s.tolist(),
    )
    rows = zip(*columns, strict=True)

    assert list(result.estimates) == [identifier.update(*row) for row in rows]
    assert result.layers == identifier.layers


@pytest.mark.slow
@settings(max_examples=2)
@given(st.lists(st.integers(HEAD_ROWS, 3000), max_size=6), st.booleans())
def test_pieces_give_what_the_whole_gives(columns, results, cuts, has_speed):
    t_s, depth_m, force_N, speed_m_s = columns
    whole = results[has_speed]
    stream = ReplayStream()
    dt_s = np.diff(t_s, prepend=t_s[0])
    edges = [0, *sorted(set(cuts)), len(t_s)]  # the first piece is the head at least
    runs = [
        stream.run(
            t_s[p], dt_s[p], depth_m[p], force_N[p], speed_m_s[p] if has_speed else None
        )
        for p in (slice(a, b) for a, b in pairwise(edges) if b > a)
    ]

    assert [e for estimates in runs for e in estimates] == list(whole.estimates)
    assert stream.layers == whole.layers
    assert stream.hints == whole.hints


def test_a_mostly_still_clock_has_a_usual_step():
    t_s = np.repeat(np.arange(100) / 100, 3)
    result = replay(t_s, 0.01 * t_s, 0.0 * t_s)

    assert sum(estimate.status.is_used for estimate in result.estimates) == 100
    assert (
        "longer than 0.25 s: 1;"
        in replay(t_s + 1e9 * (t_s > 0.5), t_s, t_s).hints[-1].text
    )


def test_wrong_speed_sign_and_still_depth_get_hints(columns):
    _, depth_m, force_N, speed_m_s = columns
    for depth, speed, words, advice in (
        (
            depth_m,
            np.append(np.inf, -speed_m_s[1:]),
            "speed has the sign opposite",
            "Negate `speed_m_s` or `depth_m`, or leave the speed out.",
        ),
        (
            0.0 * depth_m,
            speed_m_s,
            "there is nothing to identify",
            "Give `depth_m` in metres, of a recording that has an insertion.",
        ),
    ):
        check = SignCheck()
        check.add_rows(depth, speed, force_N)
        assert words in check.hints()[-1].text
        assert check.hints()[-1].advice == advice


@pytest.mark.slow
def test_repeated_rows_change_no_layer(columns, results):
    t_s, depth_m, force_N, _ = columns
    once = results[False]
    twice = replay(*(np.repeat(column, 2) for column in (t_s, depth_m, force_N)))

    assert twice.layers == once.layers


@pytest.mark.slow
@pytest.mark.parametrize("has_speed", [True, False])
def test_late_rows_and_clock_steps_hide_no_event(columns, results, has_speed):
    t_s, depth_m, force_N, speed_m_s = columns
    late_s = t_s.copy()
    back_s = t_s.copy()
    late_s[400 :: len(t_s) // 30] -= 0.05
    back_s[int(np.nanargmax(depth_m > 0.004)) :] -= 20.0
    signals = (depth_m, force_N, speed_m_s if has_speed else None)
    clean = results[has_speed]
    late = replay(late_s, *signals)
    set_back = replay(back_s, *signals, dt_s=np.diff(back_s, prepend=-np.inf))
    rejected = [k for k, e in enumerate(set_back.estimates) if not e.status.is_used]

    assert len([k for k in rejected if k != 300]) <= 12

    rupture_s = clean.layers[0].rupture.time_s

    assert late.layers[0].rupture.time_s == pytest.approx(rupture_s, abs=0.02)

    # The step in which it was set is not known.
    # Events are on the clock of the log, which stands 20 s earlier by then.
    back_rupture_s = set_back.layers[0].rupture.time_s

    assert back_rupture_s == pytest.approx(rupture_s - 20.0, abs=0.03)
    assert len(clean.layers) == len(late.layers) == len(set_back.layers) == 1


@pytest.mark.slow
def test_a_bad_stamp_spoils_its_own_row_only(columns):
    t_s, depth_m, force_N, speed_m_s = columns
    t_s = t_s.copy()
    t_s[[0, 500, 501, 502, 503, 800]] = np.nan
    result = replay(t_s, depth_m, force_N, speed_m_s)
    rejected = [k for k, e in enumerate(result.estimates) if not e.status.is_used]

    assert rejected == [0, 300, 500, 501, 502, 503, 800]
    assert len(result.layers) == 1
