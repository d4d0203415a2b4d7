"""Bad samples are reported and skipped, bad settings refused; what follows is not
harmed."""

import math
import pickle
import warnings
from dataclasses import fields, replace
from fractions import Fraction
from typing import NamedTuple

import numpy as np
import pytest

from foundation.records import as_record, read_field
from identification.config import (
    MIXTURE,
    PUBLISHED,
    PUBLISHED_KV,
    CheckConfig,
    MixtureConfig,
    PublishedConfig,
)
from identification.errors import InvalidConfigError, InvalidSnapshotError
from identification.estimate import Estimate, Events, SampleStatus, make_estimate
from identification.identifier import Identifier
from identification.sample_check import STATUSES, CheckState
from identification.travel_filter import TravelState, process_sample

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


@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
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
def test_a_bad_sample_is_reported_and_not_used(config, place, value, status):
    identifier = Identifier(config)
    good = identifier.update(*GOOD)
    state = pickle.dumps(identifier.snapshot().state)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        bad = identifier.update(*GOOD[:place], value, *GOOD[place + 1 :])

    assert bad.status is status
    assert pickle.dumps(identifier.snapshot().state) == state
    assert bad.enhanced_force_N == good.enhanced_force_N
    # Time passes if it is given: a missing force does not shift the clock of what
    # follows.
    assert bad.time_s == pytest.approx(1e-3 if place == 3 else 2e-3)

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


@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
@pytest.mark.parametrize("dt_s", [1e308, 1e-13])
def test_an_absurd_interval_leaves_every_number_finite(config, dt_s):
    identifier = Identifier(config)
    for k in range(300):
        estimate = identifier.update(
            1e-5 * k, 0.01, 0.1 + 1e-3 * k, dt_s if k % 3 else 1e-3
        )
        expected = SampleStatus.TIME_RANGE if k % 3 else SampleStatus.OK
        assert estimate.status is expected
        numbers = [value for value in estimate if isinstance(value, float)]
        assert all(map(math.isfinite, numbers))

    assert estimate.time_s == pytest.approx(0.1)


@pytest.mark.slow
def test_events_are_on_the_clock_of_the_caller():
    summed = Identifier()
    absolute = Identifier()
    for k in range(8000):
        depth = 2.5e-6 * k - 2e-3
        force = 60.0 * max(depth, 0.0) if depth < 0.01 else 0.1
        on_own_clock = summed.update(depth, 2.5e-3, force, 1e-3)
        time_s = 5e4 + 1e-3 * k
        on_callers_clock = absolute.update(depth, 2.5e-3, force, 1e-3, time_s=time_s)
        assert on_own_clock.time_s == pytest.approx(1e-3 * (k + 1))
        assert on_callers_clock.time_s == time_s
        assert (on_callers_clock.rupture is None) == (on_own_clock.rupture is None)
    own = summed.layers[0].rupture
    callers = absolute.layers[0].rupture

    assert callers.time_s - own.time_s == pytest.approx(5e4 - 1e-3)
    assert callers.alarm_s - own.alarm_s == pytest.approx(5e4 - 1e-3)
    assert callers.depth_m == own.depth_m


@pytest.mark.parametrize("time_s", [math.nan, "now", [1.0]])
def test_a_sample_without_a_usable_time_is_rejected(time_s):
    identifier = Identifier()
    identifier.update(0.0, 0.0, 0.0, 1e-3, 7.0)
    rejected = identifier.update(0.0, 0.0, 0.0, 1e-3, time_s)

    assert not rejected.status.is_used
    assert rejected.time_s == 7.0
    assert identifier.update(0.0, 0.0, 0.0, 1e-3, np.float32(8.0)).time_s == 8.0


@pytest.mark.slow
@pytest.mark.parametrize("config", [MIXTURE, PUBLISHED])
def test_events_count_depth_from_the_callers_zero(config):
    config = replace(config, contact_depth_m=3e-3) if config is PUBLISHED else config
    plain = Identifier(config)
    moved = Identifier(config)

    assert plain.contact_depth_m is None

    for k in range(9000):
        depth = 2.5e-6 * k
        force = 60.0 * max(depth - 3e-3, 0.0) if depth < 0.013 else 0.1
        plain.update(depth, 2.5e-3, force, 1e-3)
        moved_depth = depth + (0.05 if k > 500 else 0.0)
        moved.update(moved_depth, 2.5e-3, force, 1e-3)

    assert len(moved.layers) == len(plain.layers) == 1

    layer = plain.layers[0]
    moved_layer = moved.layers[0]
    rupture = layer.rupture
    moved_rupture = moved_layer.rupture
    shift_m = pytest.approx(0.05, abs=1e-5)

    assert moved_rupture.alarm_s == pytest.approx(rupture.alarm_s, abs=0.01)
    # Blocks of samples begin elsewhere after the jump.
    moved_m = moved_rupture.depth_m - rupture.depth_m
    assert moved_m == pytest.approx(0.05, abs=5e-5)
    assert moved_rupture.contact_depth_m - rupture.contact_depth_m == shift_m
    assert moved_layer.start_depth_m - layer.start_depth_m == shift_m

    if config is MIXTURE:
        assert plain.contact_depth_m == pytest.approx(3e-3, abs=0.5e-3)
        assert moved.contact_depth_m - plain.contact_depth_m == shift_m
    else:
        assert moved.contact_depth_m is None

    assert moved_layer.thickness_m == pytest.approx(layer.thickness_m, abs=5e-5)


class CheckedRows(NamedTuple):
    """Statuses of rows, time after the last, and the depth of the last one used."""

    statuses: list[SampleStatus]
    time_s: float
    depth_m: float | None


def check_rows(rows):
    limits = as_record(CheckConfig())
    check = as_record(CheckState())
    travel = as_record(TravelState())
    statuses = []
    last_depth_m = None
    used_s = 0.0
    for row in rows:
        number, elapsed_s, time_s, depth_m, *_ = process_sample(
            *row, True, limits, check, travel
        )
        statuses.append(STATUSES[number])
        if statuses[-1].is_used:
            last_depth_m = depth_m
            used_s += elapsed_s
            # What has passed over rejected samples is in the interval of the next one
            # used.
            assert time_s == pytest.approx(used_s)
    return CheckedRows(statuses, read_field(check, "time_s"), last_depth_m)


def test_a_jump_of_depth_is_removed_for_good():
    places = (0.0, 0.05, 0.050001)
    checked = check_rows([(place, 0.001, 0.0, 1e-3) for place in places])

    assert checked.statuses == [
        SampleStatus.OK,
        SampleStatus.DEPTH_JUMP,
        SampleStatus.OK,
    ]
    assert checked.depth_m == pytest.approx(2e-6)


def test_travel_before_a_gap_ends_is_no_jump():
    rows = [(8e-6 * k, 8e-3, 0.0, 1e-3) for k in range(500)]
    checked = check_rows([*rows, (8e-3, 0.0, 0.0, 1.0), (8e-3, 0.0, 0.0, 1e-3)])

    assert checked.statuses[-2:] == [SampleStatus.TIME_GAP, SampleStatus.OK]
    assert checked.depth_m == pytest.approx(8e-3)


def test_in_a_gap_only_a_new_zero_jumps():
    rows = [(0.0, 0.0, 0.0, 1e-3)] * 50
    for there_m, kept_m, status in ((8e-3, 8e-3, "TIME_GAP"), (0.5, 0.0, "DEPTH_JUMP")):
        checked = check_rows(
            [*rows, (there_m, 0.0, 0.0, 3.0), (there_m, 0.0, 0.0, 1e-3)]
        )
        assert checked.statuses[-2] is SampleStatus[status]
        assert checked.statuses[-1].is_used
        assert checked.depth_m == pytest.approx(kept_m)


def test_a_gap_makes_no_gap_usual():
    rows = [(0.0, 0.0, 0.0, dt_s) for dt_s in (*[1e-3] * 50, 100.0, *[1e-3] * 20, 10.0)]
    statuses = [
        status for status in check_rows(rows).statuses if status is not SampleStatus.OK
    ]

    assert statuses == [SampleStatus.TIME_GAP] * 2


@pytest.mark.parametrize(
    "std", [None, "x", np.zeros(2), math.nan, math.inf, -1.0, 1e200, 10**400]
)
def test_an_impossible_deviation_counts_as_not_stated(std):
    with_std = Identifier()
    without = Identifier()
    for k in range(300):
        row = (1e-5 * k, 1e-2, 0.01 * (k % 3), 1e-3, 0.001 * k)
        assert with_std.update(*row, std) == without.update(*row)


def test_wrong_speed_sign_is_reported_and_time_passes():
    rows = [
        (2e-6 * k, -0.002 if 500 <= k < 3000 else 0.002, 0.0, 1e-3) for k in range(3500)
    ]
    checked = check_rows(rows)
    statuses = checked.statuses
    rejected = [
        k for k, status in enumerate(statuses) if status is SampleStatus.SPEED_SIGN
    ]

    assert len(rejected) > 2000
    assert statuses[max(rejected) + 1] is SampleStatus.TIME_GAP
    assert statuses.count(SampleStatus.TIME_GAP) == 1
    assert SampleStatus.DEPTH_JUMP not in statuses
    assert checked.time_s == pytest.approx(3.5)


@pytest.mark.parametrize(
    ("jumps", "after"), [(1, SampleStatus.OK), (300, SampleStatus.TIME_GAP)]
)
def test_time_passes_over_jumps_of_depth(jumps, after):
    places = [0.05 * min(max(k - 99, 0), jumps) for k in range(500)]
    statuses = check_rows(
        [(z + 2e-6 * k, 0.002, 0.0, 1e-3) for k, z in enumerate(places)]
    ).statuses

    assert statuses[100 : 100 + jumps] == [SampleStatus.DEPTH_JUMP] * jumps
    assert statuses[100 + jumps] is after
    assert set(statuses[101 + jumps :]) == {SampleStatus.OK}


def test_unknown_configuration_and_foreign_snapshots_are_refused():
    with pytest.raises(InvalidConfigError, match="PublishedConfig"):
        Identifier(object())
    with pytest.raises(InvalidSnapshotError, match="Snapshot"):
        Identifier(PUBLISHED).restore(Identifier(PUBLISHED_KV).snapshot())


FIELDS = [
    (kind, field.name)
    for kind in (PublishedConfig, MixtureConfig, CheckConfig)
    for field in fields(kind)
]


@pytest.mark.parametrize(("kind", "name"), FIELDS)
def test_what_is_no_number_is_refused(kind, name):
    for value in (None, "1", True, np.ones(2), np.nan, 10**400):
        with pytest.raises(InvalidConfigError, match=name):
            kind(**{name: value})


def test_an_estimate_holds_outputs_under_their_names():
    others = (*Events._fields, "rupture_probability", "warnings")
    names = [name for name in Estimate._fields if name not in others][3:]
    outputs = tuple(range(len(names)))
    events = Events("r", "l", provisional="p")
    estimate = make_estimate(0.5, SampleStatus.OK, "state", outputs, events, 0.25)
    values = estimate._asdict()

    assert [values[name] for name in names] == list(outputs)
    assert (estimate.time_s, estimate.rupture_state) == (0.5, "state")
    assert (estimate.rupture, estimate.identified_layer) == ("r", "l")
    assert estimate.retracted is None
    assert estimate.provisional == "p"
    assert estimate.rupture_probability == 0.25
    assert estimate.warnings == 0
