"""Bad samples are reported and skipped, bad settings refused; what follows is not
harmed."""

import math
import pickle
import warnings
from dataclasses import fields, replace
from fractions import Fraction

import numpy as np
import pytest

from identification.config import (
    MULTILAYER,
    PUBLISHED,
    PUBLISHED_KV,
    CheckConfig,
    MultilayerConfig,
    PublishedConfig,
)
from identification.errors import InvalidConfigError, InvalidSnapshotError
from identification.estimate import SampleStatus
from identification.identifier import Identifier
from identification.sample_filter import (
    LAST_USED,
    SAMPLE_MEMORY,
    STATUSES,
    TIME,
    check_limits,
    take_sample,
)

GOOD = (0.001, 0.002, 0.1, 1e-3)


class Hostile:
    """Raises whatever is asked of it."""

    def fail(self, *_):
        raise RuntimeError("not a number")

    __float__ = __array__ = __len__ = __index__ = fail
    __repr__ = lambda self: "Hostile()"  # noqa: E731


NO_NUMBERS = [
    *(
        1j,
        np.array(1.0 + 0.0j),
        np.ma.masked,
        np.ma.array(1.0, mask=True),
        True,
        np.array(True),
    ),
    *(
        "0.1",
        np.array("0.1"),
        None,
        np.timedelta64(1, "ms"),
        Hostile(),
        [0.1],
        np.zeros(3),
    ),
]
BAD_ANYWHERE = [
    *((value, SampleStatus.NOT_A_SCALAR) for value in NO_NUMBERS),
    *(
        (value, SampleStatus.NOT_FINITE)
        for value in (math.nan, math.inf, 10**400, -(10**400))
    ),
]


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
@pytest.mark.parametrize(
    ("place", "value", "status"),
    [
        *(
            (place, *bad)
            for place in range(4)
            for bad in BAD_ANYWHERE
            if place != 1 or bad[0] is not None
        ),
        (3, 0.0, SampleStatus.TIME_NOT_FORWARD),
        (3, -1e-3, SampleStatus.TIME_NOT_FORWARD),
        (2, 1000.0, SampleStatus.FORCE_RANGE),
        (0, 1e4, SampleStatus.MOTION_RANGE),
        (1, -1e308, SampleStatus.MOTION_RANGE),
        (0, 0.1, SampleStatus.DEPTH_JUMP),
    ],
)
def test_a_bad_sample_is_reported_without_a_warning_and_not_used(
    config, place, value, status
):
    identifier = Identifier(config)
    before = identifier.update(*GOOD)
    state = pickle.dumps(identifier.snapshot().state)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        found = identifier.update(*GOOD[:place], value, *GOOD[place + 1 :])
    assert found.status is status
    assert pickle.dumps(identifier.snapshot().state) == state
    assert found.enhanced_force_N == before.enhanced_force_N
    # Time passes if it is given: a missing force does not shift the clock of what
    # follows.
    assert found.time_s == pytest.approx(1e-3 if place == 3 else 2e-3)
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


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
@pytest.mark.parametrize("dt_s", [1e308, 1e-13])
def test_an_absurd_interval_is_rejected_and_every_number_stays_finite(config, dt_s):
    identifier = Identifier(config)
    for k in range(300):
        found = identifier.update(
            1e-5 * k, 0.01, 0.1 + 1e-3 * k, dt_s if k % 3 else 1e-3
        )
        assert found.status is (SampleStatus.TIME_RANGE if k % 3 else SampleStatus.OK)
        assert all(math.isfinite(value) for value in found if isinstance(value, float))
    assert found.time_s == pytest.approx(0.1)


def test_events_are_on_the_clock_of_the_caller():
    summed = Identifier()
    absolute = Identifier()
    for k in range(8000):
        depth = 2.5e-6 * k - 2e-3
        force = 60.0 * max(depth, 0.0) if depth < 0.01 else 0.1
        found = summed.update(depth, 2.5e-3, force, 1e-3)
        other = absolute.update(depth, 2.5e-3, force, 1e-3, time_s=5e4 + 1e-3 * k)
        assert found.time_s == pytest.approx(1e-3 * (k + 1))
        assert other.time_s == 5e4 + 1e-3 * k
        assert (other.rupture is None) == (found.rupture is None)
    one = summed.layers[0].rupture
    two = absolute.layers[0].rupture
    assert two.time_s - one.time_s == pytest.approx(5e4 - 1e-3)
    assert two.alarm_s - one.alarm_s == pytest.approx(5e4 - 1e-3)
    assert two.depth_m == one.depth_m


@pytest.mark.parametrize("time_s", [math.nan, "now", [1.0]])
def test_a_sample_without_a_usable_time_is_rejected(time_s):
    identifier = Identifier()
    identifier.update(0.0, 0.0, 0.0, 1e-3, 7.0)
    found = identifier.update(0.0, 0.0, 0.0, 1e-3, time_s)
    assert not found.status.is_used
    assert found.time_s == 7.0
    assert identifier.update(0.0, 0.0, 0.0, 1e-3, np.float32(8.0)).time_s == 8.0


@pytest.mark.parametrize("config", [MULTILAYER, PUBLISHED])
def test_events_count_depth_from_the_zero_of_the_caller(config):
    config = replace(config, contact_depth_m=3e-3) if config is PUBLISHED else config
    plain = Identifier(config)
    moved = Identifier(config)
    assert plain.contact_depth_m is None
    for k in range(9000):
        depth = 2.5e-6 * k
        force = 60.0 * max(depth - 3e-3, 0.0) if depth < 0.013 else 0.1
        found = plain.update(depth, 2.5e-3, force, 1e-3)
        other = moved.update(depth + (0.05 if k > 500 else 0.0), 2.5e-3, force, 1e-3)
        assert (other.rupture is None) == (found.rupture is None)
    one = plain.layers[0]
    two = moved.layers[0]
    shift_m = pytest.approx(0.05, abs=1e-5)
    assert two.rupture.depth_m - one.rupture.depth_m == shift_m
    assert two.rupture.contact_depth_m - one.rupture.contact_depth_m == shift_m
    assert two.start_depth_m - one.start_depth_m == shift_m
    if config is MULTILAYER:
        assert plain.contact_depth_m == pytest.approx(3e-3, abs=0.5e-3)
        assert moved.contact_depth_m - plain.contact_depth_m == shift_m
    else:
        assert moved.contact_depth_m is None
    assert two.thickness_m == pytest.approx(one.thickness_m, abs=1e-5)


def check_rows(rows):
    """Statuses, memory after each row, and the depth of the last one used."""
    memory = np.zeros(SAMPLE_MEMORY)
    seen = []
    depth_m = None
    used_s = 0.0
    for row in rows:
        taken = take_sample(*row, True, memory, check_limits(CheckConfig()))
        number, dt_s, _, depth, _ = taken
        seen.append(STATUSES[number])
        if number <= LAST_USED:
            depth_m = depth
            used_s = used_s + dt_s
            # What has passed over rejected samples is in the interval of the next one
            # used.
            assert memory[TIME] == pytest.approx(used_s)
    return seen, memory[TIME], depth_m


def test_a_jump_of_depth_is_removed_for_good():
    places = (0.0, 0.05, 0.050001)
    seen, _, depth_m = check_rows([(place, 0.001, 0.0, 1e-3) for place in places])
    assert seen == [SampleStatus.OK, SampleStatus.DEPTH_JUMP, SampleStatus.OK]
    assert depth_m == pytest.approx(2e-6)


def test_travel_before_a_stop_within_a_gap_is_no_jump():
    rows = [(8e-6 * k, 8e-3, 0.0, 1e-3) for k in range(500)]
    seen, _, depth_m = check_rows(
        [*rows, (8e-3, 0.0, 0.0, 1.0), (8e-3, 0.0, 0.0, 1e-3)]
    )
    assert seen[-2:] == [SampleStatus.TIME_GAP, SampleStatus.OK]
    assert depth_m == pytest.approx(8e-3)


def test_travel_within_a_gap_is_no_jump_but_a_new_zero_of_the_depth_is():
    rows = [(0.0, 0.0, 0.0, 1e-3)] * 50
    for there_m, kept_m, status in ((8e-3, 8e-3, "TIME_GAP"), (0.5, 0.0, "DEPTH_JUMP")):
        seen, _, depth_m = check_rows(
            [*rows, (there_m, 0.0, 0.0, 3.0), (there_m, 0.0, 0.0, 1e-3)]
        )
        assert (seen[-2], seen[-1].is_used) == (SampleStatus[status], True)
        assert depth_m == pytest.approx(kept_m)


def test_a_gap_does_not_make_the_next_one_usual():
    rows = [(0.0, 0.0, 0.0, dt_s) for dt_s in (*[1e-3] * 50, 100.0, *[1e-3] * 20, 10.0)]
    seen, _, _ = check_rows(rows)
    assert [each for each in seen if each is not SampleStatus.OK] == [
        SampleStatus.TIME_GAP
    ] * 2


@pytest.mark.parametrize(
    "std", [None, "x", np.zeros(2), math.nan, math.inf, -1.0, 1e200, 10**400]
)
def test_a_deviation_that_is_none_counts_as_not_stated(std):
    found = Identifier()
    other = Identifier()
    for k in range(300):
        row = (1e-5 * k, 1e-2, 0.01 * (k % 3), 1e-3, 0.001 * k)
        assert found.update(*row, std) == other.update(*row)


def test_speed_of_the_wrong_sign_is_reported_and_time_passes_over_it():
    rows = [
        (2e-6 * k, -0.002 if 500 <= k < 3000 else 0.002, 0.0, 1e-3) for k in range(3500)
    ]
    seen, time_s, _ = check_rows(rows)
    rejected = [k for k, status in enumerate(seen) if status is SampleStatus.SPEED_SIGN]
    assert len(rejected) > 2000
    assert seen[max(rejected) + 1] is SampleStatus.TIME_GAP
    assert seen.count(SampleStatus.TIME_GAP) == 1
    assert SampleStatus.DEPTH_JUMP not in seen
    assert time_s == pytest.approx(3.5)


@pytest.mark.parametrize(
    ("jumps", "after"), [(1, SampleStatus.OK), (300, SampleStatus.TIME_GAP)]
)
def test_time_passes_over_jumps_of_depth(jumps, after):
    places = [0.05 * min(max(k - 99, 0), jumps) for k in range(500)]
    seen, _, _ = check_rows(
        [(z + 2e-6 * k, 0.002, 0.0, 1e-3) for k, z in enumerate(places)]
    )
    assert seen[100 : 100 + jumps] == [SampleStatus.DEPTH_JUMP] * jumps
    assert seen[100 + jumps] is after
    assert set(seen[101 + jumps :]) == {SampleStatus.OK}


def test_unknown_configuration_and_foreign_snapshots_are_refused():
    with pytest.raises(InvalidConfigError, match="PublishedConfig"):
        Identifier(object())
    with pytest.raises(InvalidSnapshotError, match="Snapshot"):
        Identifier(PUBLISHED).restore(Identifier(PUBLISHED_KV).snapshot())


FIELDS = [
    (kind, field.name)
    for kind in (PublishedConfig, MultilayerConfig, CheckConfig)
    for field in fields(kind)
]


@pytest.mark.parametrize(("kind", "name"), FIELDS)
def test_what_is_no_number_is_refused(kind, name):
    for value in (None, "1", True, np.ones(2), np.nan, 10**400):
        with pytest.raises(InvalidConfigError, match=name):
            kind(**{name: value})
