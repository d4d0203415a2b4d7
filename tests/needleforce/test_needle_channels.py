"""Depth needs no calls, and a channel that was cut is remembered."""

import math
from typing import NamedTuple

import numpy as np
import pytest

from groundtruth import gel
from identification.channel import ChannelFriction
from needleforce import (
    ChannelState,
    Identifier,
    InsertionSession,
    SessionEstimate,
    read_snapshot,
    write_snapshot,
)
from needleforce.insertion_course import follow_needle
from needleforce.needle_channels import (
    NeedleChannel,
    OldChannel,
    add_channel,
    find_channel,
)
from needleforce.tip_travel import TipTravel, TravelZero
from residual import ToolKinematics
from tests.insertion_run import same
from tests.needleforce.needle_trips import DT_S, Trip

SPEED_M_S = 4e-3
IN_AIR_M = 0.012
"""Height of the tip above the surface before and after an insertion."""
TURN_RAD = 0.3


def above(layer, seed):
    """A trip that begins in free air above a layer."""
    trip = Trip((layer,), np.random.default_rng(seed))
    trip.advance(-IN_AIR_M, 0.02)
    trip.rows.clear()
    return trip


def tare_here(trip):
    """Rest and strokes in free air; the sample at which to tare."""
    trip.rest(0.5)
    trip.advance(-0.02, 0.02)
    trip.advance(0.02, 0.02)
    trip.rest(0.3)
    return len(trip.rows)


def insert(trip, deep_m):
    """In and out again, to where the needle was."""
    trip.advance(IN_AIR_M + deep_m, SPEED_M_S)
    trip.rest(0.2)
    trip.advance(-IN_AIR_M - deep_m, 0.01)
    trip.rest(0.2)


def run(trip, tare, begins=(), session=None, first=0):
    """A session and its estimates of a trip, from a sample on."""
    session = InsertionSession(trip.robot) if session is None else session
    estimates = []
    for k in range(first, len(trip.rows)):
        if k == tare:
            session.tare()
        if k in begins:
            session.begin_insertion()
        row = trip.rows[k]
        estimates.append(session.update(row.q, row.dq, row.tau, DT_S))
    return session, estimates


def rupture_samples(estimates):
    return [k for k, e in enumerate(estimates) if e.identification.rupture]


def tip_forces(estimates, rows):
    """Estimated and true force on the tip in each sample [N]."""
    estimated_N = np.array([e.identification.tip_force_N for e in estimates])
    return estimated_N, np.array([row.tip_N for row in rows])


def advancing(trip, first, shallow_m, deep_m):
    """Samples from one on that advance between two depths."""
    depth_m = np.array([row.depth_m for row in trip.rows])
    is_advancing = np.diff(depth_m, prepend=depth_m[0]) > 1e-6
    samples = np.flatnonzero(is_advancing & (depth_m > shallow_m) & (depth_m < deep_m))
    return samples[samples >= first]


def true_ruptures(trip, thickness_m, first=0):
    """Sample at which the far side of the tissue is passed first."""
    return [advancing(trip, first, thickness_m, math.inf)[0]]


@pytest.mark.slow
@pytest.mark.parametrize("where", ["turned", "aside", "below"])
def test_a_tare_elsewhere_needs_no_call(where):
    layer = gel(25)
    trip = above(layer, 1)
    aside_m = (0.04, 0.02) if where == "below" else (0.06, -0.06)
    if where == "turned":
        trip.turn_wrist(TURN_RAD, 1.0)
    else:
        trip.move_aside(aside_m, 1.0)
    if where == "below":
        trip.fresh_tissue(())
        trip.advance(0.05, 0.05)
    trip.rows.clear()
    tare = tare_here(trip)
    if where == "below":
        trip.advance(-0.05, 0.03)
        trip.fresh_tissue((layer,))
    if where == "turned":
        trip.turn_wrist(-TURN_RAD, 1.5)
    else:
        trip.move_aside((-aside_m[0], -aside_m[1]), 1.5)
    trip.rest(0.2)
    begin = len(trip.rows)
    trip.advance(IN_AIR_M + 0.034, SPEED_M_S)
    expected = true_ruptures(trip, layer.thickness_m, begin)

    for begins in ((), {begin}):
        session, estimates = run(trip, tare, begins)
        inside_m = estimates[-1].depth_in_tissue_m
        assert rupture_samples(estimates) == pytest.approx(expected, abs=40)
        assert len(session.layers) == 1
        assert inside_m == pytest.approx(trip.rows[-1].depth_m, abs=2e-3)


class Twice(NamedTuple):
    """Two insertions in one line.

    Attributes:
        trip: Its samples.
        tare: Sample at which to tare.
        second: Sample at which the second insertion begins.
        session: A session after all of it, without a call.
        estimates: Of that session.
    """

    trip: Trip
    tare: int
    second: int
    session: InsertionSession
    estimates: list[SessionEstimate]

    def until(self, sample):
        """Return the trip up to a sample."""
        start = Trip((), np.random.default_rng(0))
        start.rows = self.trip.rows[:sample]
        return start


def insert_twice(seed, deep_m, fresh=None):
    """Two insertions, of which the second goes through; the tissue may be fresh."""
    trip = above(gel(50), seed)
    tare = tare_here(trip)
    insert(trip, deep_m)
    if fresh:
        trip.fresh_tissue(fresh)
    second = len(trip.rows)
    trip.advance(IN_AIR_M + 0.042, SPEED_M_S)
    return Twice(trip, tare, second, *run(trip, tare))


@pytest.fixture(scope="module")
def twice():
    """The second insertion is deeper, in the same channel."""
    return insert_twice(2, 0.022)


@pytest.mark.slow
@pytest.mark.parametrize("with_call", [False, True])
def test_an_old_channel_has_friction_and_no_tip_force_until_its_end(twice, with_call):
    trip, tare, second, session, estimates = twice
    if with_call:
        session, estimates = run(trip, tare, {second})
    in_channel = advancing(trip, second, 1e-3, 0.020)
    fresh = advancing(trip, second, 0.025, 0.037)
    shaft_N = np.array([e.identification.shaft_friction_N for e in estimates])
    true_friction_N = np.array([row.friction_N for row in trip.rows])
    tip_N, true_tip_N = tip_forces(estimates, trip.rows)
    expected = true_ruptures(trip, 37.7e-3, second)

    assert np.abs(tip_N[in_channel]).max() < 0.02
    assert np.abs(shaft_N - true_friction_N)[in_channel].max() < 0.15
    assert true_tip_N[fresh].mean() > 0.5
    assert np.abs(tip_N - true_tip_N)[fresh].mean() < 0.2
    assert rupture_samples(estimates) == pytest.approx(expected, abs=40)
    assert len(session.layers) == 1


@pytest.mark.slow
def test_layers_stay_until_the_next_contact():
    trip = above(gel(25), 4)
    tare = tare_here(trip)
    insert(trip, 0.034)
    session, _ = run(trip, tare)
    out = len(trip.rows)
    (layer,) = session.layers
    trip.move_aside((0.02, 0.0), 0.5)
    trip.fresh_tissue((gel(25),))
    run(trip, None, session=session, first=out)
    beside = len(trip.rows)
    (kept,) = session.layers
    trip.advance(IN_AIR_M + 0.01, SPEED_M_S)
    run(trip, None, session=session, first=beside)

    assert kept.thickness_m == pytest.approx(layer.thickness_m, abs=1e-4)
    assert session.layers == ()


@pytest.fixture(scope="module")
def moved():
    """Between the two insertions the tissue has moved aside."""
    return insert_twice(5, 0.030, fresh=(gel(50),))


def test_tissue_that_has_moved_contradicts_the_channel(moved):
    trip, _, second, session, estimates = moved
    states = [estimate.channel for estimate in estimates[second:]]

    dropped = second + states.index(ChannelState.CONTRADICTED)
    fresh = advancing(trip, dropped, trip.rows[dropped].depth_m + 2e-3, 0.037)
    tip_N, true_tip_N = tip_forces(estimates, trip.rows)
    expected = true_ruptures(trip, 37.7e-3, second)

    assert set(states) == set(ChannelState)
    assert states[-1] is ChannelState.CONTRADICTED
    assert true_tip_N[dropped] < 0.35
    assert true_tip_N[fresh].mean() > 0.4
    assert np.abs(tip_N - true_tip_N)[fresh].mean() < 0.2
    assert rupture_samples(estimates) == pytest.approx(expected, abs=40)
    assert len(session.layers) == 1


@pytest.mark.slow
def test_channels_that_are_forgotten_are_fresh_tissue(moved):
    trip, tare, second, *_ = moved
    session, _ = run(moved.until(second), tare)
    session.forget_channels()
    _, estimates = run(trip, None, session=session, first=second)
    fresh = advancing(trip, second, 5e-3, 0.037) - second
    tip_N, true_tip_N = tip_forces(estimates, trip.rows[second:])

    assert {estimate.channel for estimate in estimates} == {ChannelState.FRESH}
    assert np.abs(tip_N - true_tip_N)[fresh].mean() < 0.25


@pytest.mark.slow
def test_begin_insertion_in_tissue_moves_only_the_zero_of_depth(twice):
    trip, tare, second, _, estimates = twice
    in_tissue = advancing(trip, tare, 0.015, 0.02)[0]
    _, begun = run(twice.until(second), tare, {in_tissue})
    moved_m = begun[-1].depth_m - estimates[second - 1].depth_m

    found, expected = (
        [
            (e.identification.tip_force_N, e.depth_in_tissue_m, e.identification.layer)
            for e in each[in_tissue:second]
        ]
        for each in (begun, estimates)
    )

    assert moved_m == pytest.approx(-trip.rows[in_tissue].depth_m - IN_AIR_M, abs=1e-3)
    np.testing.assert_allclose(found, expected, atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("second_s", [1.0, 5.0])
def test_a_resumed_session_knows_its_channels(twice, tmp_path, second_s):
    trip, tare, second, whole, estimates = twice
    resume = second + round(second_s / DT_S)
    before, _ = run(twice.until(resume), tare)
    write_snapshot(before.snapshot(), tmp_path / "session")
    resumed = InsertionSession(trip.robot)
    resumed.restore(read_snapshot(tmp_path / "session"))
    _, rest = run(trip, None, session=resumed, first=resume)

    assert all(
        same(one, other) for one, other in zip(rest, estimates[resume:], strict=True)
    )
    assert same(resumed.snapshot().course, whole.snapshot().course)
    assert len(resumed.snapshot().course.channels) == 1


@pytest.mark.parametrize(
    ("was_in_air", "excess_N", "is_contradicted"),
    [(True, 0.3, True), (True, 0.15, False), (False, 0.3, False), (False, 0.7, True)],
)
def test_what_is_uncertain_in_air_already_hides_no_rise(
    was_in_air, excess_N, is_contradicted
):
    friction = ChannelFriction(0.0025, 0.0, 0.0, 0.0001)
    in_air = Identifier().snapshot()
    depths_m = np.arange(-0.002 if was_in_air else 0.005, 0.015, 1e-5)
    channel = OldChannel(0.0, 0.03, friction, 0.0, in_air, checked_m=depths_m[0])
    for depth_m in depths_m:
        travel = TipTravel(depth_m, SPEED_M_S, depth_m, SPEED_M_S)
        channel = channel.compared(travel, excess_N, force_std_N=0.2)

    found = channel.is_contradicted(
        SPEED_M_S, friction_N=0.2, force_std_N=0.205, noise_std_N=0.03
    )

    assert found == is_contradicted


# Geometry alone.


@pytest.fixture(scope="module")
def beside():
    """A channel of 30 mm, and the needle at a place and a turn beside its entry."""
    trip = Trip((), np.random.default_rng(0))
    tool = ToolKinematics(trip.robot)
    tool.update(trip.posture)
    pose = tool.pose.copy()

    def place(aside_m, height_m, turn_rad):
        axis = pose[:3, :3] @ [math.sin(turn_rad), 0.0, math.cos(turn_rad)]
        entry_m = pose[:3, 3] - pose[:3, 0] * aside_m - height_m * axis
        entry = TravelZero(entry_m, axis)
        return NeedleChannel(entry, 0.03, 0.0, 0.0, Identifier().snapshot())

    return place, tool


@pytest.mark.parametrize(
    ("aside_m", "height_m", "turn_rad", "is_met"),
    [
        (0.0, -1e-3, 0.0, True),
        (0.0, -3e-3, 0.0, False),  # not there yet
        (0.0, 0.02, 0.0, True),
        (0.0, 0.035, 0.0, False),  # beyond its end
        (0.8e-3, -1e-3, 0.0, True),
        (2e-3, -1e-3, 0.0, False),
        (0.0, -1e-3, 0.02, True),
        (0.0, -1e-3, 0.08, False),  # its end is missed by 2.5 mm
    ],
)
def test_a_channel_is_met_within_a_needle_diameter(
    beside, aside_m, height_m, turn_rad, is_met
):
    place, tool = beside
    channel = place(aside_m, height_m, turn_rad)
    needle = TravelZero(tool.pose[:3, 3], tool.axis_in_base)

    assert (find_channel((channel,), needle) is channel) == is_met


def test_the_newest_channel_replaces_the_one_it_goes_on_in(beside):
    place, _ = beside
    old = place(0.0, 0.0, 0.0)
    deeper = place(0.2e-3, 0.0, 0.0)
    other = place(2e-3, 0.0, 0.0)

    assert add_channel((old, other), deeper) == (other, deeper)
    assert add_channel((old,), other) == (old, other)


@pytest.mark.parametrize(
    ("aside_m", "height_m", "is_aside"),
    [(2e-3, 0.0, False), (5e-3, 0.0, True), (5e-3, 0.03, False), (0.02, 0.03, True)],
)
def test_only_free_air_lets_a_needle_move_aside(beside, aside_m, height_m, is_aside):
    place, tool = beside
    line = place(aside_m, height_m, 0.0).entry
    motion = follow_needle(line.axis_in_base, *line, tool.needle, np.zeros(7))

    assert motion[3] == is_aside
