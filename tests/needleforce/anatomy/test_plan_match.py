"""The plan and the ruptures correct each other."""

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy import stats

from needleforce.anatomy import Layer, PlanError, PlanMatch

NAMES = ("fat", "muscle", "gland", "lesion", "gland")


def plan(*depths_mm, names=NAMES, std_mm=0.5):
    edges = [0.0, *depths_mm, depths_mm[-1] + 50.0]
    return [
        Layer(
            *(names[k], 1e-3 * edges[k], 1e-3 * edges[k + 1]),
            *(1e-3 * std_mm * (k > 0), 1e-3 * std_mm, False),
        )
        for k in range(len(depths_mm) + 1)
    ]


def test_ruptures_move_the_plan_and_name_the_layer():
    match = PlanMatch(plan(20, 35, 60), 3e-3)
    above = match.state(-0.002)
    start = match.state(0.005)
    first = match.state(0.024, [0.024])
    second = match.state(0.039, [0.024, 0.039])
    last = match.state(0.064, [0.024, 0.039, 0.064])

    assert [
        (one.name, one.next_name) for one in (above, start, first, second, last)
    ] == [*pairwise(["outside", *NAMES[:4], ""])]
    assert (above.layer, start.matched_name) == (-1, "")
    assert start.offset_std_m == pytest.approx(3e-3, rel=0.5)
    assert 1e-3 < first.offset_m < 4e-3  # or a membrane ruptured late
    assert match.state(0.0).offset_m == pytest.approx(0.0, abs=0.5e-3)
    assert second._asdict() == second._asdict() | {
        "offset_m": pytest.approx(4e-3, abs=0.5e-3),
        "next_m": pytest.approx(0.064, abs=1e-3),
        "next_std_m": pytest.approx(np.hypot(second.offset_std_m, 0.5e-3)),
        "matched": 2,
        "matched_name": "gland",
    }
    assert second.offset_std_m < 1.2e-3
    assert min(second.probability, second.matched_probability) > 0.8
    assert np.isnan(last.next_m)

    moved = match.state(0.139, [0.124, 0.139], contact_m=0.1, entry_depth_m=0.1)
    same = match.state(0.039, [0.024, 0.039], contact_m=0.0)
    assert (moved.next_m, moved.offset_m) == pytest.approx(
        (same.next_m + 0.1, same.offset_m)
    )


@pytest.mark.parametrize(("rupture_m", "name"), [(0.028, "muscle"), (0.03, "gland")])
def test_one_boundary_in_five_is_passed_unnoticed(rupture_m, name):
    """Planned at 20 and 30 mm, give or take 3 mm; behind fat three in five would be."""
    layers = plan(20, 30, 60, names=("lesion", *NAMES[1:]))
    state = PlanMatch(layers, 3e-3).state(rupture_m + 1e-3, [rupture_m])

    assert state.name == state.matched_name == name
    # Thus a rupture that may be either is the first one less often behind fat.
    soft = PlanMatch(plan(20, 30, 60), 3e-3).state(0.029, [0.028])
    assert (soft.matched_name, name) != ("muscle", "gland")


def test_where_the_surface_was_met_counts_for_half():
    match = PlanMatch(plan(20, 35, 60), 3e-3)
    # At a rupture 4 mm late a membrane ruptured late, or all lies deeper: so does the
    # surface.
    deeper, unknown, late = (
        match.state(0.024, [0.024], contact_m=contact_m)
        for contact_m in (4e-3, None, 0.0)
    )

    assert late.offset_m < unknown.offset_m < deeper.offset_m
    assert deeper.offset_std_m < unknown.offset_std_m
    # Organs move beneath a skin that lies where it was: two ruptures outvote it.
    beneath = match.state(0.039, [0.024, 0.039], contact_m=0.0)
    assert (deeper.offset_m, beneath.offset_m) == (
        pytest.approx(4e-3, abs=0.2e-3),
        pytest.approx(4e-3, abs=0.5e-3),
    )
    # The skin ruptures behind where it was met.
    shallow = PlanMatch(plan(8, 35), 5e-3)
    assert [
        shallow.state(8.5e-3, [8.5e-3], contact_m=c).matched for c in (None, 4e-3)
    ] == [1, 0]


def test_the_surface_lies_off_with_the_plan_or_alone():
    """Offsets after contact alone: half of Student's law, half of it times contact."""
    std_m = 3e-3
    grid_m = 0.1e-3 * np.arange(-150, 151)
    contact_std_m = np.hypot(0.5e-3, 0.15e-3)
    layers = plan(20, 35)
    layers[0] = replace(layers[0], entry_std_m=0.5e-3)
    student = stats.t(3, scale=std_m).pdf(grid_m)
    for contact_m in (0.0, 2e-3, 6e-3):
        off = stats.norm.pdf(contact_m - grid_m, scale=contact_std_m)
        alone = stats.t(3, scale=np.hypot(contact_std_m, std_m)).pdf(contact_m)
        weight = student * (off + alone) / (student @ (off + alone))
        median_m = np.interp(0.5, np.cumsum(weight) - 0.5 * weight, grid_m)
        spread_m = np.sqrt(weight @ (grid_m - median_m) ** 2)
        state = PlanMatch(layers, std_m).state(contact_m, contact_m=contact_m)

        assert (state.offset_m, state.offset_std_m) == (
            pytest.approx(median_m, abs=2e-5),
            pytest.approx(spread_m, rel=0.01),
        )


@pytest.mark.parametrize(
    ("depth_m", "ruptures_m"), [(-0.005, []), (0.005, []), (0.024, [0.024])]
)
def test_air_before_the_skin_is_no_layer(depth_m, ruptures_m):
    layers = plan(20, 35)
    moved = [
        replace(layer, entry_m=layer.entry_m + 0.015, exit_m=layer.exit_m + 0.015)
        for layer in layers
    ]
    air = Layer("unlabelled", 0.0, 0.015, 0.0, 0.0, False)
    contact = {"contact_m": 0.002} if depth_m > 0.002 else {}
    bare = PlanMatch(layers, 3e-3).state(depth_m, ruptures_m, **contact)
    state = PlanMatch([air, *moved], 3e-3).state(
        depth_m, ruptures_m, **contact, entry_depth_m=-0.015
    )

    expected = (bare.layer + 1, bare.name, bare.matched + (bare.matched >= 0))
    assert (state.layer, state.name, state.matched) == expected
    assert (state.next_m, state.offset_m) == pytest.approx((bare.next_m, bare.offset_m))
    # In front of an organ it is tissue without a label.
    tissue = PlanMatch([air, *(replace(layer, name="liver") for layer in moved)], 3e-3)
    assert tissue.state(0.01, [], contact_m=0.0).name == "unlabelled"


def test_an_unnoticed_boundary_is_passed_all_the_same():
    match = PlanMatch(plan(20, 35, 60), 2e-3)
    last = match.state(0.0601, [0.0200, 0.0601])

    assert [match.state(depth_m, [0.0200]).name for depth_m in (0.030, 0.050)] == [
        "muscle",
        "gland",
    ]
    assert (last.matched, last.name) == (3, "lesion")
    # Withdrawn, the tip is in layers that it has crossed.
    assert [
        match.state(depth_m, [0.0200], deepest_m=0.050).name
        for depth_m in (0.045, 0.025, -0.01)
    ] == ["gland", "muscle", "outside"]


def test_a_boundary_passed_by_less_than_an_alarm_takes_is_not_yet_missed():
    match = PlanMatch(plan(20, names=("gel", "muscle"), std_mm=0.1), 2e-4)
    before, at, behind = (
        match.state(depth_m, contact_m=0.0) for depth_m in (0.0195, 0.0203, 0.022)
    )

    assert (before.name, at.name, behind.name) == ("gel", "gel", "muscle")
    assert before.probability > 0.98
    assert at.probability > 0.7


@pytest.mark.parametrize(
    ("names", "offset_mm"),
    [
        (("fat", "muscle", "gland", "lesion"), 3.0),
        (("liver", "muscle", "liver", "lesion"), 3.0),
        *((("fat", "muscle", name, "lesion"), -1.0)
          for name in ("liver", "Left Kidney", "spleen")),
    ],
)  # fmt: skip
def test_a_capsule_is_expected_to_rupture_late_once(names, offset_mm):
    state = PlanMatch(plan(20, 35, 60, names=names), 3e-3).state(0.0385, [0.0385])
    offset_m = pytest.approx(1e-3 * offset_mm, abs=1e-3)

    assert (state.matched, state.offset_m) == (2, offset_m)


def test_a_false_alarm_is_no_boundary():
    state = PlanMatch(plan(20, 60), 1e-3).state(0.041, [0.0200, 0.041])
    found = (state.matched, state.matched_name, state.name)

    assert found == (-1, "a false alarm", "muscle")


def test_bone_is_passed_only_where_it_is_accepted():
    layers = plan(10, 14, names=("fat", "rib_left_7", "lung"))
    layers[1] = replace(layers[1], is_obstacle=True)

    with pytest.raises(PlanError, match="rib_left_7"):
        PlanMatch(layers, 3e-3)
    match = PlanMatch(layers, 3e-3, accepted_obstacles=["rib_left_7"])
    assert match.state(0.005).is_obstacle_next
    assert not match.state(0.012, [0.01]).is_obstacle_next


def test_equal_plans_have_one_fingerprint():
    matches = [
        PlanMatch(plan(20, 35), 3e-3),
        PlanMatch(plan(20, 35), 3e-3),
        PlanMatch(plan(20, 35), 2e-3),
        PlanMatch(plan(20, 36), 3e-3),
        PlanMatch(plan(20, 35, names="abc"), 3e-3),
        PlanMatch(plan(20, 35, std_mm=0.4), 3e-3),
    ]
    first, same, *others = (match.fingerprint for match in matches)
    assert (first, len({first, *others})) == (same, 5)


def test_off_the_plan_no_layer_is_named():
    state = PlanMatch(plan(20, 35), 3e-3).off_plan_state()
    assert state[:5] == (-2, "off plan", 0.0, 0.0, 3e-3)
    assert np.isnan(state.next_m)


@pytest.mark.parametrize(
    ("field", "value"),
    [("entry_m", bad) for bad in (np.nan, 20.0, -0.01)]
    + [("entry_std_m", bad) for bad in (np.nan, -1.0)],
)
def test_boundaries_that_cannot_be_are_refused(field, value):
    layers = plan(20, 35)
    layers[1] = replace(layers[1], **{field: value})
    for wrong in (layers, plan(20, 35)[::-1], plan(20)[:1]):
        with pytest.raises(PlanError):
            PlanMatch(wrong, 3e-3)
    with pytest.raises(PlanError, match="offset_std_m"):
        PlanMatch(plan(20), 0.0)


@pytest.mark.parametrize("bad_m", [np.nan, np.inf])
def test_depths_that_cannot_be_are_refused(bad_m):
    match = PlanMatch(plan(20, 35), 3e-3)
    names = ("contact_m", "entry_depth_m", "deepest_m")
    for depth_m, ruptures_m, others in (
        *((0.0, [], {name: bad_m}) for name in names),
        *((0.03, [0.03, rupture_m], {}) for rupture_m in (bad_m, 0.01)),
        (bad_m, [], {}),
    ):
        with pytest.raises(PlanError):
            match.state(depth_m, ruptures_m, **others)
