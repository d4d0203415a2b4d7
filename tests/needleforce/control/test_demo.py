"""Demonstrations: a table, a page, and figures of the closed loop that they share."""

import numpy as np
import pytest

from groundtruth.tissue import Rupture
from needleforce.cli import main
from needleforce.cli.demos import guidance, teleoperation
from needleforce.cli.demos.hand_driven import (
    BACK_S,
    HAND_STROKE_M,
    HandPlan,
    Teleinsertion,
    ruptures_felt,
)


def test_the_hand_reaches_the_travel_in_strokes():
    """The hand reaches its travel in strokes, and goes back with the pedal up."""
    hand = HandPlan(needle_speed_m_s=4e-3, needle_travel_m=0.1, scale=0.4)

    assert hand.strokes == 2

    t_s = np.arange(0.0, hand.duration_s + 0.5, 1e-3)
    wish, pedal = map(np.array, zip(*(hand.at(t) for t in t_s), strict=True))

    assert wish.max() <= HAND_STROKE_M

    moved = np.diff(wish) * pedal[1:]

    assert hand.scale * moved[moved > 0.0].sum() == pytest.approx(0.1, rel=1e-3)
    assert (~pedal).sum() == pytest.approx(1e3 * BACK_S, abs=2)


def test_felt_rupture_is_the_fall_of_each_force():
    run = Teleinsertion()
    for k in range(2000):
        broken = k >= 1000
        run.t_s.append(1e-3 * k)
        run.tip_N.append(0.0 if broken else 1.0)
        run.shown_N.append(0.1 if broken else 1.1)
        run.raw_N.append(3.0 if broken else 4.0)

    run.alarms_s.append(1.05)
    ends = {"onset_s": 1.0, "end_s": 1.1, "onset_m": 0.03, "drop_N": 1.0}
    ends |= {"visible_drop_N": 1.0, "layer_friction_N": 1.0, "friction_N": 3.0}
    run.ruptures = (Rupture(layer=1, **ends),)
    (felt,) = ruptures_felt(run)

    assert felt == pytest.approx((1.0 / 1.1, 0.25, 0.1, 0.05), rel=1e-6)


def number_behind(text, words):
    """The number that a line of a table begins with behind some words."""
    return float(text.split(words)[1].split()[0])


def shown(kind, folder, capsys):
    """What a demonstration prints, once its page holds as many charts as it has
    pictures."""

    assert (
        main(["demo", kind, "--report", str(folder), "--figure", str(folder / "a.svg")])
        == 0
    )

    page = (folder / "index.html").read_text(encoding="utf-8")
    assert page.count("data:image/svg+xml") == len(list(folder.glob("*.svg"))) - 1 > 0
    assert (folder / "a.svg").read_text(encoding="utf-8").startswith("<?xml")

    said = capsys.readouterr().out
    assert "not a medical device" in said

    return said


def test_a_needle_turns_about_its_entry(tmp_path, capsys):
    assert number_behind(shown("rcm", tmp_path, capsys), "entry, largest error") < 0.01


def test_an_arm_yields_and_rests_when_released(tmp_path, capsys, monkeypatch):
    """An arm yields to a push and rests when let go."""
    for name, value in (("PUSH_S", 4.5), ("PUSH_END_S", 7.5), ("GUIDED_S", 9.0)):
        monkeypatch.setattr(guidance, name, value)

    said = shown("guidance", tmp_path, capsys)

    assert 0.5 < number_behind(said, "yielded by 0.5 mm") < 2.0
    assert number_behind(said, "after it was let go") == 0.0


def test_a_needle_stops_by_itself_behind_a_rupture(tmp_path, capsys):
    said = shown("autonomous", tmp_path, capsys)

    assert number_behind(said, "ruptures passed") == 1
    assert 0.0 < number_behind(said, "overshoot past the rupture") < 0.25


def test_a_hand_feels_a_rupture_more_with_compensation(tmp_path, capsys, monkeypatch):
    plan = HandPlan(needle_speed_m_s=4e-3, needle_travel_m=45e-3, scale=0.4)
    monkeypatch.setattr(teleoperation, "HandPlan", lambda **_: plan)
    said = shown("teleop", tmp_path, capsys)
    with_, without = said.split("without compensation")[1].split("%")[:2]

    assert float(with_) > 80.0 > 60.0 > float(without.strip(" ,"))
    assert number_behind(said, "at the hand's port") >= -0.1
    assert number_behind(said, "between hand and needle") < 1.0
