"""Bad samples are reported and skipped, bad settings refused; the rest is unharmed."""

import math
import pickle
import warnings
from dataclasses import fields, replace
from fractions import Fraction

import numpy as np
import pytest

from identification import (
    MIXTURE,
    PUBLISHED,
    PUBLISHED_KV,
    CheckConfig,
    Identifier,
    InvalidConfigError,
    InvalidSnapshotError,
    MixtureConfig,
    PublishedConfig,
    SampleStatus,
)
from tests.identification.worlds import rows_of, run

GOOD = (0.001, 0.002, 0.1, 1e-3)


class Hostile:
    """Raises whatever is asked of it."""

    def fail(self, *_):
        raise RuntimeError("not a number")

    __float__ = __array__ = __len__ = __index__ = fail


NO_SCALARS = [
    1j,
    np.array(1.0 + 0.0j),
    np.ma.masked,
    np.ma.array(1.0, mask=True),
    True,
    np.array(True),
    "0.1",
    np.array("0.1"),
    None,
    np.timedelta64(1, "ms"),
    Hostile(),
    [0.1],
    np.zeros(3),
]
NOT_FINITE = [math.nan, math.inf, 10**400, -(10**400)]
BAD = [
    *(
        (place, value, SampleStatus.NOT_A_SCALAR)
        for place in range(4)
        for value in NO_SCALARS
        if not (place == 1 and value is None)
    ),
    *(
        (place, value, SampleStatus.NOT_FINITE)
        for place in range(4)
        for value in NOT_FINITE
    ),
    (3, 0.0, SampleStatus.TIME_NOT_FORWARD),
    (3, -1e-3, SampleStatus.TIME_NOT_FORWARD),
    (3, 1e308, SampleStatus.TIME_RANGE),
    (3, 1e-13, SampleStatus.TIME_RANGE),
    (2, 1000.0, SampleStatus.FORCE_RANGE),
    (0, 1e4, SampleStatus.MOTION_RANGE),
    (1, -1e308, SampleStatus.MOTION_RANGE),
    (0, 0.1, SampleStatus.DEPTH_JUMP),
]


@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
def test_a_bad_sample_is_reported_and_not_used(config):
    for place, value, status in BAD:
        identifier = Identifier(config)
        good = identifier.update(*GOOD)
        state = pickle.dumps(identifier.snapshot().state)
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            bad = identifier.update(*GOOD[:place], value, *GOOD[place + 1 :])

        # A missing force does not shift the clock of what follows.
        time_s = pytest.approx(1e-3 if place == 3 else 2e-3)
        assert (bad.status, bad.enhanced_force_N, bad.time_s) == (
            status,
            good.enhanced_force_N,
            time_s,
        ), (place, value)
        assert pickle.dumps(identifier.snapshot().state) == state
        if status is not SampleStatus.DEPTH_JUMP:
            assert identifier.update(*GOOD).status is SampleStatus.OK


@pytest.mark.parametrize(
    "sample",
    [
        (np.float32(0.0), np.float64(0.002), 0, np.ma.array(1e-3, mask=False)),
        (Fraction(0), np.int32(0), 0, np.array(1e-3)),
    ],
)
def test_numpy_scalars_integers_and_fractions_are_welcome(sample):
    assert Identifier(PUBLISHED).update(*sample).status is SampleStatus.OK


@pytest.mark.parametrize(
    "std", [None, "x", np.zeros(2), math.nan, math.inf, -1.0, 1e200, 10**400]
)
def test_an_impossible_deviation_counts_as_not_stated(std):
    rows = [(1e-5 * k, 1e-2, 0.01 * (k % 3), 1e-3, 0.001 * k) for k in range(300)]

    assert run((*row, std) for row in rows)[1] == run(rows)[1]


def one_layer(contact_m=0.0):
    """Samples of a needle that leaves a layer of 10 mm."""
    depth_m = 2.5e-6 * np.arange(9_000)
    in_layer_m = np.maximum(depth_m - contact_m, 0.0)
    force_N = np.where(depth_m < contact_m + 10e-3, 60.0 * in_layer_m, 0.1)
    return rows_of(depth_m, 2.5e-3, force_N, 1e-3)


def test_events_are_on_the_clock_of_the_caller():
    rows = one_layer(2e-3)
    times_s = [5e4 + 1e-3 * k for k in range(len(rows))]
    summed, own = run(rows)
    stamped, callers = run((*row, t_s) for row, t_s in zip(rows, times_s, strict=True))
    own_rupture, callers_rupture = (
        each.layers[0].rupture for each in (summed, stamped)
    )

    assert [e.time_s for e in own] == pytest.approx(np.arange(1, 9_001) * 1e-3)
    assert [e.time_s for e in callers] == times_s
    assert (callers_rupture.time_s, callers_rupture.alarm_s) == pytest.approx(
        (own_rupture.time_s + 5e4 - 1e-3, own_rupture.alarm_s + 5e4 - 1e-3), abs=1e-6
    )


@pytest.mark.parametrize("time_s", [math.nan, "now", [1.0]])
def test_a_sample_without_a_usable_time_is_rejected(time_s):
    identifier = Identifier()
    identifier.update(0.0, 0.0, 0.0, 1e-3, 7.0)
    rejected = identifier.update(0.0, 0.0, 0.0, 1e-3, time_s)

    accepted = identifier.update(0.0, 0.0, 0.0, 1e-3, np.float32(8.0))

    assert (rejected.status.is_used, rejected.time_s) == (False, 7.0)
    assert accepted.time_s == 8.0


@pytest.mark.parametrize("config", [MIXTURE, replace(PUBLISHED, contact_depth_m=3e-3)])
def test_events_count_depth_from_the_callers_zero(config):
    rows = one_layer(3e-3)
    moved_rows = rows[:501] + [r._replace(depth_m=r.depth_m + 0.05) for r in rows[501:]]
    plain, moved = (run(each, Identifier(config))[0] for each in (rows, moved_rows))
    (layer,) = plain.layers
    (moved_layer,) = moved.layers
    by_m = [
        moved_layer.rupture.depth_m - layer.rupture.depth_m,
        moved_layer.rupture.contact_depth_m - layer.rupture.contact_depth_m,
        moved_layer.rupture.alarm_depth_m - layer.rupture.alarm_depth_m,
        moved_layer.start_depth_m - layer.start_depth_m,
        moved_layer.thickness_m - layer.thickness_m,
    ]

    # Blocks begin elsewhere after the jump.
    assert by_m == pytest.approx([0.05] * 4 + [0.0], abs=5e-5)
    if config is MIXTURE:
        assert (plain.contact_depth_m, moved.contact_depth_m) == (
            pytest.approx(3e-3, abs=0.5e-3),
            pytest.approx(plain.contact_depth_m + 0.05, abs=5e-5),
        )


def statuses_of(rows):
    """Statuses of rows of depth, speed and interval, and the depth seen at the end."""
    identifier, estimates = run((depth, speed, 0.0, dt) for depth, speed, dt in rows)
    return [e.status for e in estimates], identifier.snapshot().travel.depth.value


REST = [(0.0, 0.0, 1e-3)] * 50
ADVANCE = [(8e-6 * k, 8e-3, 1e-3) for k in range(500)]


@pytest.mark.parametrize(
    ("rows", "status", "depth_m"),
    [
        # A jump of depth is removed for good.
        ([*REST, (0.05, 1e-3, 1e-3), (0.050001, 1e-3, 1e-3)], "DEPTH_JUMP", 1e-6),
        # Travel before a gap ends is none; in a gap only a new zero jumps.
        ([*ADVANCE, (8e-3, 0.0, 1.0), (8e-3, 0.0, 1e-3)], "TIME_GAP", 8e-3),
        ([*REST, (8e-3, 0.0, 3.0), (8e-3, 0.0, 1e-3)], "TIME_GAP", 8e-3),
        # A gap makes no gap usual.
        ([*REST, (0.0, 0.0, 100.0), *REST, (0.0, 0.0, 10.0), REST[0]], "TIME_GAP", 0.0),
        ([*REST, (0.5, 0.0, 3.0), (0.5, 0.0, 1e-3)], "DEPTH_JUMP", 0.0),
    ],
)
def test_a_jump_of_depth_is_removed_and_a_gap_is_none(rows, status, depth_m):
    statuses, seen_m = statuses_of(rows)

    assert (statuses[-2], statuses[-1].is_used) == (SampleStatus[status], True)
    assert seen_m == pytest.approx(depth_m, abs=2e-5)


def test_wrong_speed_sign_is_reported_and_time_passes():
    k = np.arange(3_500)
    speed_m_s = np.where((k >= 500) & (k < 3_000), -0.002, 0.002)
    _, estimates = run(rows_of(2e-6 * k, speed_m_s, 0.0, 1e-3))
    statuses = [estimate.status for estimate in estimates]
    after = len(statuses) - statuses[::-1].index(SampleStatus.SPEED_SIGN)
    gaps = [k for k, each in enumerate(statuses) if each is SampleStatus.TIME_GAP]

    assert statuses.count(SampleStatus.SPEED_SIGN) > 2000
    assert (gaps, SampleStatus.DEPTH_JUMP in statuses) == ([after], False)
    assert estimates[-1].time_s == pytest.approx(3.5)


@pytest.mark.parametrize(
    ("jumps", "after"), [(1, SampleStatus.OK), (300, SampleStatus.TIME_GAP)]
)
def test_time_passes_over_jumps_of_depth(jumps, after):
    places = [0.05 * min(max(k - 99, 0), jumps) for k in range(500)]
    statuses, _ = statuses_of(
        [(z + 2e-6 * k, 0.002, 1e-3) for k, z in enumerate(places)]
    )
    jumped = [SampleStatus.DEPTH_JUMP] * jumps

    assert statuses[100:] == [*jumped, after, *[SampleStatus.OK] * (399 - jumps)]


def test_unknown_configuration_and_foreign_snapshots_are_refused():
    with pytest.raises(InvalidConfigError, match="PublishedConfig"):
        Identifier(object())
    with pytest.raises(InvalidSnapshotError):
        Identifier(PUBLISHED).restore(Identifier(PUBLISHED_KV).snapshot())


@pytest.mark.parametrize("kind", [PublishedConfig, MixtureConfig, CheckConfig])
def test_what_is_no_number_is_refused(kind):
    for field in fields(kind):
        for value in (None, "1", True, np.ones(2), np.nan, 10**400):
            with pytest.raises(InvalidConfigError, match=field.name):
                kind(**{field.name: value})


@pytest.mark.parametrize(
    ("kind", "word", "values"),
    [
        (PublishedConfig, "model", {"model": "xx"}),
        (PublishedConfig, "sigma1_N", {"sigma0_N": 0.1}),
        (PublishedConfig, "reset_frequency_Hz", {"reset_frequency_Hz": 0.0}),
        (PublishedConfig, "most_windows", {"most_windows": 0.5}),
        (MixtureConfig, "alarm_probability", {"alarm_probability": 0.3}),
        (MixtureConfig, "alarm_probability", {"alarm_probability": 1.0}),
        (MixtureConfig, "provisional_probability", {"provisional_probability": 0.99}),
    ],
)
def test_settings_out_of_range_are_refused(kind, word, values):
    with pytest.raises(InvalidConfigError, match=word):
        kind(**values)
