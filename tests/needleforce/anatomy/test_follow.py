"""A session that follows a plan: what it reports, and what stopping and false alarms
do to it."""

import copy
import json
import pickle
import re
from dataclasses import replace
from itertools import count
from types import SimpleNamespace

import numpy as np
import pytest

from identification import Identifier, Rupture
from needleforce import (
    InsertionError,
    InsertionSession,
    PlannedPath,
    read_snapshot,
    write_snapshot,
)
from needleforce.anatomy import OUTSIDE, Layer, PlanMatch
from needleforce.cli import main
from needleforce.cli.arms import arm_connection, arm_watch
from needleforce.devices import Link
from needleforce.plan_follower import PlanFollower
from needleforce.tip_travel import TravelZero
from tests.insertion_run import (
    following,
    same,
    samples,
    short_run,
    stopped_after,
    tare_index,
)

pytestmark = pytest.mark.slow


RUN = short_run()
TARE = tare_index(RUN)
SURFACE_m = float(-RUN.truth.depth_m[TARE])
"""Depth of the gel's surface from where the session counts."""
GEL_m = RUN.scenario.layers[0].thickness_m
SHIFT_m = 2e-3


def layers(*names):
    """Gel, planned some millimetres too thin, and 50 mm of what lies behind."""
    edges = [0.0, GEL_m - SHIFT_m, GEL_m + 0.05]
    return [
        Layer(n, edges[k], edges[k + 1], 0.5e-3, 0.5e-3, False)
        for k, n in enumerate(names)
    ]


MATCH = PlanMatch(layers("gel", "behind"), 3e-3)
ZERO = stopped_after(TARE).course.zero
ENTRY_m = ZERO.start_in_base_m + SURFACE_m * ZERO.axis_in_base
PATH = PlannedPath.of_std(ENTRY_m, ENTRY_m + 0.05 * ZERO.axis_in_base, 3e-3)


@pytest.fixture(scope="module")
def whole():
    """Estimates of the insertion, and snapshots above, in and behind the gel."""
    session = InsertionSession(RUN.robot)
    estimates = []
    snapshots = {}
    session.follow(MATCH, path=PATH)
    for k, row in samples(RUN):
        if k == TARE:
            session.tare()
        estimates.append(session.update(*row))
        if k in (TARE - 50, TARE + 4000, TARE + 16_500):
            snapshots[k] = session.snapshot()
        if k == TARE + 17_500:
            return estimates, snapshots


def test_estimates_name_layer_next_boundary_and_offset(whole):
    """Estimates name the layer, the next boundary and the offset."""
    estimates, snapshots = whole
    (alarm,) = [
        k for k, e in enumerate(estimates) if e.identification.rupture is not None
    ]
    above, inside, behind = (
        estimates[k].plan for k in (TARE + 200, alarm - 1000, alarm + 200)
    )

    assert estimates[TARE - 1].plan is None
    assert [(one.name, one.next_name) for one in (above, inside, behind)] == [
        (OUTSIDE, "gel"),
        ("gel", "behind"),
        ("behind", ""),
    ]
    contacts_m = [snapshots[k].plan.contact_m for k in (TARE - 50, TARE + 4000)]
    assert contacts_m == [None, pytest.approx(SURFACE_m, abs=0.5e-3)]
    assert (above.next_m, behind.offset_m) == pytest.approx(
        (SURFACE_m, SHIFT_m), abs=1e-3
    )
    assert abs(inside.next_m - SURFACE_m - GEL_m) < 3.0 * inside.next_std_m
    assert behind.matched == 1
    assert behind.offset_std_m < inside.offset_std_m
    assert min(one.probability for one in (above, inside, behind)) > 0.8


@pytest.mark.parametrize("where", ["file", "pickle", "copy"])
def test_it_goes_on_bit_for_bit(whole, where, tmp_path):
    estimates, snapshots = whole
    for cut, snapshot in snapshots.items():
        session = InsertionSession(RUN.robot)
        session.follow(MATCH, path=PATH)
        write_snapshot(snapshot, tmp_path / "s")
        session.restore(read_snapshot(tmp_path / "s") if where == "file" else snapshot)
        if where == "copy":
            session = copy.deepcopy(session)
        elif where == "pickle":
            session = pickle.loads(pickle.dumps(session))
        for k, row in enumerate(following(cut, 800), cut + 1):
            if k == TARE:
                session.tare()
            assert same(session.update(*row), estimates[k]), (cut, k)


def test_restoring_with_another_plan_changes_nothing(whole):
    _, snapshots = whole
    snapshot = snapshots[TARE + 4000]
    for plan, path, refused_snapshot in [
        (None, None, snapshot),
        (PlanMatch(layers("gel", "bone"), 3e-3), PATH, snapshot),
        (PlanMatch(layers("gel", "behind"), 2e-3), PATH, snapshot),
        (MATCH, None, snapshot),
        (MATCH, PATH, stopped_after(TARE)),
    ]:
        session = InsertionSession(RUN.robot)
        session.follow(plan, path=path)
        with pytest.raises(InsertionError, match="list"):
            session.follow(layers("gel", "behind"))
        unchanged = session.snapshot()
        with pytest.raises(InsertionError, match="plan"):
            session.restore(refused_snapshot)
        assert same(session.snapshot(), unchanged)


def test_a_retracted_alarm_restores_the_plan():
    """After an alarm is retracted the plan is as before it."""
    quiet = Identifier().snapshot().last
    alarm = Rupture(
        layer=1,
        alarm_s=5.0,
        time_s=5.0,
        force_N=1.0,
        speed_m_s=4e-3,
        probability=0.95,
        contact_depth_m=0.0,
        depth_m=0.012,
        alarm_depth_m=0.0125,
    )
    follower = PlanFollower(MATCH, None)
    follower.begin(TravelZero(np.zeros(3), np.array([0.0, 0.0, 1.0])))
    follower.match(quiet, 0.0125, None)
    unmoved = (follower.memory, follower.state)
    follower.match(quiet._replace(rupture=alarm), 0.0125, None)

    assert follower.memory.ruptures == (alarm,)
    assert follower.state != unmoved[1]

    # The depth may have been counted anew since.
    counted = replace(alarm, depth_m=0.013)
    follower.match(quiet._replace(retracted=counted), 0.0125, None)

    assert (follower.memory, follower.state) == unmoved

    # Above a rupture there is no other one: the needle has been pushed in again.
    for depth_m, rupture in ((0.0125, alarm), (5e-3, SimpleNamespace(depth_m=5e-3))):
        follower.match(quiet._replace(rupture=rupture), depth_m, None)

    reached = (follower.memory.ruptures, follower.memory.deepest_m)
    assert reached == ((alarm,), 0.0125)


@pytest.fixture
def arm(monkeypatch):
    """The simulated arm of `needleforce live`, as fast as it can."""
    monkeypatch.setattr(arm_connection, "simulate", lambda *_, **__: RUN)
    monkeypatch.setattr(arm_connection, "pace", lambda arm: arm)
    return "sim:gel-25-constant"


TWO = [{"name": "fat", "exit_m": 0.1}, {"name": "liver", "exit_m": 0.2}]


def written(folder, **plan):
    path = folder / "plan.json"
    path.write_text(json.dumps(plan))
    return str(path)


def test_an_arm_is_watched_with_a_plan(arm, tmp_path, capsys):
    named = [
        {"name": "gel", "exit_m": SURFACE_m + GEL_m - SHIFT_m},
        {"name": "behind", "exit_m": SURFACE_m + GEL_m + 0.05},
    ]
    path = written(tmp_path, start_m=SURFACE_m, layers=named)

    assert main(["live", arm, "--plan", path, "--tare", str(TARE * 1e-3)]) == 0

    said = capsys.readouterr().out
    for pattern in (
        r"rupture of layer 1 at 2\d\.\d mm .*by the plan into behind",
        r"in outside \(\d+ ?%\), gel at .*in gel \(\d+ ?%\), behind at .* deeper",
    ):
        assert re.search(pattern, said, re.DOTALL)


def test_a_force_sensor_stands_beside_the_estimate(arm, monkeypatch, capsys):
    class Sensor(Link):
        faults = 0
        numbers = count()

        def __init__(self, host):
            assert host == "127.0.0.9"
            super().__init__()

        def read(self):
            k = next(self.numbers)
            if k % 100 == 0 or k > TARE + 15_000:
                return None
            return RUN.signals.ft_wrench[k] + np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])

    monkeypatch.setattr(arm_watch, "NetFT", Sensor)

    reference = ["--reference", "127.0.0.9", "--tare", str(TARE * 1e-3)]
    assert main(["live", arm, *reference]) == 0

    said = capsys.readouterr()
    summary = re.search(
        r"reference nan N, rms difference (?P<rms_N>.*) N of (?P<ticks>\d+) ticks",
        said.err,
    )

    assert "reference nan N, rms difference nan N" in said.out.splitlines()[0]
    assert 0.005 < float(summary["rms_N"]) < 0.05
    # All until the sensor ends, less one in a hundred and a second of taring.
    assert 13_500 < int(summary["ticks"]) < 14_500


@pytest.mark.parametrize(
    ("plan", "why"),
    [
        ({}, "layers"),
        (
            {"entry_m": [0, 0, 0], "target_m": [0, 0, 1]},
            "labels.nii.gz",
        ),
        ({"layers": [{"name": "fat"}]}, "exit_m"),
        (
            {"layers": [{"name": "fat", "exit_m": 0.0}]},
            "fat",
        ),
        ({"layers": [{"name": "fat", "exit_m": 0.1}]}, "1 layers"),
        ({"rotation": [[1, 0, 0], [0, 1, 0], [0, 0, -1]]}, "mirror"),
        (
            {"entry_m": [0, 0, 0], "target_m": [0, 0, 0], "layers": TWO},
            "same",
        ),
        ({"layers": [TWO[0], TWO[1] | {"exit_m": 50}]}, "boundaries"),
        ({"layers": [TWO[0] | {"exit_std_m": -1}, TWO[1]]}, "boundaries"),
        (
            {"entry_m": [0, 0, 0], "layers": TWO},
            "target_m",
        ),
        (
            {"translation_m": [600, 0, 300], "layers": TWO},
            "metres",
        ),
        ({"entry_mm": [0, 0, 0]}, "entry_mm"),
        (
            {"entry_m": [0, 0]},
            "length",
        ),
    ],
)
def test_a_plan_that_says_too_little_is_refused(plan, why, arm, tmp_path, capsys):
    assert main(["live", arm, "--plan", written(tmp_path, **plan)]) == 2
    assert re.match(f"(?s)error: .*{why}", capsys.readouterr().err)
