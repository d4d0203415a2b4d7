"""Demonstrations: a table, a page, and figures of the closed loop that they share."""

import re
from html import unescape

import numpy as np
import pytest

from groundtruth.tissue import Rupture
from needleforce.cli import main
from needleforce.cli.demos import guidance, remote_centre, teleoperation
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

    (heading,) = re.findall("<h1>(.*?)</h1>", page)
    assert unescape(heading) in " ".join(said.split())
    for cell in re.findall("<td>(.*?)</td>", page):
        assert unescape(cell) in said

    return said


@pytest.mark.slow
def test_a_needle_turns_about_its_entry(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(remote_centre, "CIRCLE_S", 3.0)
    monkeypatch.setattr(remote_centre, "DURATION_S", 4.0)
    said = shown("rcm", tmp_path, capsys)
    perfect, noisy, misplaced, naive = [
        float(item) for item in re.findall(r"entry, largest error +([\d.]+) mm", said)
    ]

    assert perfect < 0.01 < noisy < 0.05 < misplaced < 0.3 < 20.0 < naive
    assert f"within {noisy:.3f} mm" in said
    assert f"within {misplaced:.2f} mm" in " ".join(said.split())


@pytest.mark.slow
def test_an_arm_yields_and_rests_when_released(tmp_path, capsys, monkeypatch):
    """An arm yields to a push and rests when let go."""
    for name, value in (("PUSH_S", 4.5), ("GUIDED_S", 8.5)):
        monkeypatch.setattr(guidance, name, value)

    said = shown("guidance", tmp_path, capsys)

    breakaway_N = number_behind(said, "the arm begins to move")

    assert 0.5 < breakaway_N < 1.3
    assert number_behind(said, "as the push falls") < breakaway_N
    assert number_behind(said, "from 1 s after the push") == 0.0
    assert f"until the hand pushes with {breakaway_N:.2f} N" in said


@pytest.mark.slow
def test_a_needle_stops_by_itself_behind_a_rupture(tmp_path, capsys):
    said = shown("autonomous", tmp_path, capsys)

    assert number_behind(said, "ruptures passed") == 1

    overshoot_mm = number_behind(said, "overshoot past the rupture")

    assert 0.0 < overshoot_mm < 0.25
    assert f"stops {overshoot_mm:.2f} mm past" in said
    # What it travels until it is told to stop, and little more.
    delay_ms = number_behind(said, "after the rupture began")
    assert overshoot_mm == pytest.approx(5e-3 * delay_ms, abs=0.05)


@pytest.mark.slow
def test_a_hand_feels_a_rupture_more_with_compensation(tmp_path, capsys, monkeypatch):
    plan = HandPlan(needle_speed_m_s=4e-3, needle_travel_m=45e-3, scale=0.4)
    monkeypatch.setattr(teleoperation, "HandPlan", lambda **_: plan)
    said = shown("teleop", tmp_path, capsys)
    with_, without = said.split("without compensation")[1].split("%")[:2]

    assert float(with_) > 80.0 > 60.0 > float(without.strip(" ,"))
    assert number_behind(said, "at the hand's port") >= -0.1
    assert number_behind(said, "between hand and needle") < 1.0

    given_mJ = number_behind(said, "energy from the hand, in all")
    got_mJ = number_behind(said, "energy delivered to the hand, in all")

    assert 0.0 < got_mJ < given_mJ
    assert "never got more than it had given" in " ".join(said.split())


def test_the_energies_of_the_hand_are_summed_apart():
    run = Teleinsertion()
    run.energy_J = [0.0, 2.0, 1.5, 3.0]
    energy = teleoperation.energy_of(run)

    assert energy.from_hand_J.tolist() == [0.0, 2.0, 2.0, 3.5]
    assert energy.to_hand_J.tolist() == [0.0, 0.0, 0.5, 0.5]
    assert energy.most_owed_J == 0.0
