"""A session that follows a plan: what it reports, and what stopping and false alarms
do to it."""

import copy
import json
import pickle
import re
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from identification import Identifier, Rupture
from needleforce import InsertionError, InsertionSession, read_snapshot, write_snapshot
from needleforce.anatomy import Layer, PlanMatch
from needleforce.anatomy.plan_match import OUTSIDE
from needleforce.cli import main
from needleforce.cli.arms import arm_connection, arm_watch
from needleforce.devices.link import Link
from needleforce.needle_on_plan import PlannedPath
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

    assert estimates[TARE - 1].plan is None

    (alarm,) = [
        k for k, e in enumerate(estimates) if e.identification.rupture is not None
    ]
    above = estimates[TARE + 200]
    inside = estimates[alarm - 1000]
    behind = estimates[alarm + 200]

    assert (above.plan.name, above.plan.next_name) == (OUTSIDE, "gel")
    assert snapshots[TARE - 50].plan.contact_m is None
    assert snapshots[TARE + 4000].plan.contact_m == pytest.approx(SURFACE_m, abs=0.5e-3)
    assert above.plan.next_m == pytest.approx(SURFACE_m, abs=1e-3)
    assert (inside.plan.name, inside.plan.next_name) == ("gel", "behind")
    assert inside.plan.next_m == pytest.approx(
        SURFACE_m + GEL_m, abs=3.0 * inside.plan.next_std_m
    )
    assert (behind.plan.name, behind.plan.matched, behind.plan.next_name) == (
        "behind",
        1,
        "",
    )
    assert behind.plan.offset_m == pytest.approx(SHIFT_m, abs=1e-3)
    assert behind.plan.offset_std_m < inside.plan.offset_std_m
    assert min(e.plan.probability for e in (above, inside, behind)) > 0.8


@pytest.mark.parametrize("where", ["file", "pickle", "copy"])
def test_it_goes_on_bit_for_bit(whole, where, tmp_path):
    estimates, snapshots = whole
    for cut, snapshot in snapshots.items():
        session = InsertionSession(RUN.robot)
        session.follow(MATCH, path=PATH)
        if where == "file":
            write_snapshot(snapshot, tmp_path / "s")
            snapshot = read_snapshot(tmp_path / "s")
        session.restore(snapshot)
        if where != "file":
            again = (
                copy.deepcopy
                if where == "copy"
                else lambda s: pickle.loads(pickle.dumps(s))
            )
            session = again(session)
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
        unchanged = session.snapshot()
        with pytest.raises(InsertionError, match="plan"):
            session.restore(refused_snapshot)
        assert same(session.snapshot(), unchanged)


def test_an_invalid_plan_is_refused():
    with pytest.raises(InsertionError, match="list"):
        InsertionSession(RUN.robot).follow(layers("gel", "behind"))


def test_a_retracted_alarm_restores_the_plan():
    """After an alarm is retracted the plan is as before it."""
    quiet = Identifier().snapshot().last
    numbers = {
        "layer": 1,
        "alarm_s": 5.0,
        "time_s": 5.0,
        "force_N": 1.0,
        "speed_m_s": 4e-3,
    }
    numbers |= {"probability": 0.95, "contact_depth_m": 0.0}
    alarm = Rupture(depth_m=0.012, alarm_depth_m=0.0125, **numbers)
    wrong, right = (PlanFollower(MATCH, None) for _ in range(2))
    for follower in (wrong, right):
        follower.begin(TravelZero(np.zeros(3), np.array([0.0, 0.0, 1.0])))
        follower.match(quiet, 0.0125, None)

    unmoved = right.state
    wrong.match(quiet._replace(rupture=alarm), 0.0125, None)

    assert wrong.memory.ruptures == ((5.0, 0.012),)
    assert wrong.state != unmoved

    # The depth may have been counted anew since.
    wrong.match(quiet._replace(retracted=replace(alarm, depth_m=0.013)), 0.0125, None)

    assert (wrong.memory, wrong.state) == (right.memory, unmoved)

    # Above a rupture there is no other one: the needle has been pushed in again.
    wrong.match(quiet._replace(rupture=alarm), 0.0125, None)
    shallow = SimpleNamespace(depth_m=0.005)
    wrong.match(quiet._replace(rupture=shallow), 0.005, None)

    assert wrong.memory.ruptures == ((5.0, 0.012),)
    assert wrong.memory.deepest_m == 0.0125


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
    ends = (SURFACE_m + GEL_m - SHIFT_m, SURFACE_m + GEL_m + 0.05)
    named = [
        {"name": n, "exit_m": end}
        for n, end in zip(("gel", "behind"), ends, strict=True)
    ]
    path = written(tmp_path, start_m=SURFACE_m, layers=named)

    assert main(["live", arm, "--plan", path, "--tare", str(TARE * 1e-3)]) == 0

    said = capsys.readouterr().out

    assert re.search(
        r"rupture of layer 1 at 2\d\.\d mm below first contact \(\d+ %\), by the plan "
        "into behind",
        said,
    )
    assert re.search(
        r"in outside \(\d+ ?%\), gel at .*in gel \(\d+ ?%\), behind at .* offset",
        said,
        re.S,
    )


def test_a_force_sensor_stands_beside_the_estimate(arm, monkeypatch, capsys):
    class Sensor(Link):
        def __init__(self, host):
            assert host == "127.0.0.9"
            super().__init__()
            self.weight = np.array([0.0, 0.0, 3.0, 0.0, 0.0, 0.0])
            self.k = -1
            self.faults = 0

        def read(self):
            self.k += 1
            is_lost = self.k % 100 == 0 or self.k > TARE + 15_000
            return None if is_lost else RUN.signals.ft_wrench[self.k] + self.weight

    monkeypatch.setattr(arm_watch, "NetFT", Sensor)
    options = ["--reference", "127.0.0.9", "--tare", str(TARE * 1e-3)]

    assert main(["live", arm, *options]) == 0

    said = capsys.readouterr()

    assert "(reference nan N, rms difference nan N)" in said.out.splitlines()[0]

    summary = re.search(
        r"reference nan N, rms difference (?P<rms_N>.*) N of (?P<ticks>\d+) ticks",
        said.err,
    )

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

    said = capsys.readouterr().err

    assert re.search(why, said)
    assert said.startswith("error: ")
