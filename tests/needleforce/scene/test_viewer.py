"""The page: ruptures, verdicts, nearest structure, forces and CT of the time shown."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from needleforce import load_lwr
from needleforce.scene import PlanScene, SceneError, Viewer
from tests.needleforce.scene.insertions import (
    HOME,
    clearance,
    deviation,
    insertion,
    moment,
    plan,
    planned,
    scanned,
)
from urdf import example_robot_path, load_example, load_urdf


def words_of(handle):
    return " ".join(re.sub("<[^>]*>", " ", handle.content).split())


def shown_marks(page, time_s=None):
    """Whether line and label of each rupture are seen, at a time or now."""
    if time_s is not None:
        page.show(time_s)
    return [(one.ring.line.visible, one.ring.label.visible) for one in page.marks]


SEEN = (True, True)
HIDDEN = (False, False)


def test_ruptures_are_shown_from_their_time_on(open_page):
    page = open_page()
    for k in range(0, 200, 30):
        page.append(insertion()[k : k + 30])
    page.show()

    assert page.marks[0].time_s == pytest.approx(6.0)
    assert shown_marks(page) == [SEEN]
    assert "rupture of layer 1 at 12.0 mm" in words_of(page._text)
    assert [shown_marks(page, time_s) for time_s in (3.0, 7.0, -1.0, 1.0)] == [
        [HIDDEN],
        [SEEN],
        [HIDDEN],
        [HIDDEN],
    ]
    page.append([moment(11.0, 0.021, rupture=2)])  # while somebody looks at the past
    assert shown_marks(page) == [HIDDEN, HIDDEN]
    needle = page._arm.find_needle(HOME)
    page.append([moment(12.0, 0.05, retracted=2)])
    assert shown_marks(page, 12.0) == [SEEN, HIDDEN]
    assert shown_marks(page, 11.5) == [SEEN, SEEN]
    assert np.allclose(page.marks[1].ring.line.position, needle.tip_m, atol=1e-6)


def test_a_plan_names_tissue_ruptures_and_the_next_boundary(open_page):
    page = open_page(
        moment(0.0, plan=planned(-1, 0.002)),
        moment(1.0, 0.01, plan=planned(0, 0.022)),
    )
    page.show(0.5)
    assert "in outside (93 %), fat at 2.0 ± 0.5 mm" in words_of(page._text)

    page.show()
    assert "in fat (93 %), liver at 22.0 ± 0.5 mm" in words_of(page._text)
    assert "+2.0 ± 0.4 mm deeper" in words_of(page._text)
    expected = (page._expected.line.visible, page._expected.label.text)
    assert expected == (True, "liver, expected")
    assert np.allclose(page._expected.line.position, [0.0, 0.0, 0.012])

    page.append(
        [
            moment(2.0, 0.0221, rupture=1, plan=planned(1, 0.052, 1)),
            moment(3.0, 0.03, rupture=2, plan=planned(2, np.nan, -1)),
        ]
    )
    page.show()
    assert "into liver (97 %)" in page.marks[0].text
    assert page.marks[1].text.endswith("a false alarm (97 %)")
    assert not page._expected.line.visible


@pytest.mark.parametrize(
    ("state", "banner", "is_red"),
    [
        ({}, "", False),
        ({"is_doubtful": True}, "CANNOT TELL", False),
        ({"is_past_target": True}, "PAST TARGET", True),
        ({"is_off_plan": True}, "OFF PLAN", True),
    ],
)
def test_a_verdict_stands_at_the_needle_and_turns_it_red(
    open_page, state, banner, is_red
):
    page = open_page(moment(1.0, 0.02, deviation=deviation(**state)))
    color = page._arm.needle.color
    shown = (page._warning.visible, page._warning.text, color == (230, 30, 30))

    assert shown == (bool(banner), banner, is_red)
    assert banner in words_of(page._card)


def test_a_line_joins_the_needle_and_the_nearest_structure(open_page):
    page = open_page()
    tip_m, axis = page._arm.find_needle(HOME)
    aside = np.cross(axis, [0.0, 1.0, 0.0])
    place_m = tip_m + 0.004 * axis + 0.012 * aside / np.linalg.norm(aside)
    near = clearance(place_m=place_m)
    for k, found in enumerate([(), (near,), (near._replace(needed_m=0.02),)]):
        page.append([moment(float(k), clearances=found)])
    page.show(0.0)
    assert not page._nearest.visible
    page.show(1.0)
    assert page._nearest.visible
    # At a right angle to the needle, where the structure is nearest to it.
    ends_m = [tip_m + 0.004 * axis, place_m]
    assert np.allclose(page._nearest.points[0], ends_m, atol=1e-6)
    assert page._nearest.colors.tolist() == [150, 0, 120]
    page.show(2.0)
    assert page._nearest.colors.tolist() == [230, 30, 30]


def test_the_arrow_shows_the_tip_force_where_it_is_valid(open_page):
    page = open_page(moment(0.0, 0.05, status="not tared"), moment(1.0, 0.05))
    page.show(0.0)
    assert not page._force.arrow.visible
    page.show(1.0)
    needle = page._arm.find_needle(HOME)
    assert np.allclose(page._arm.frame.position, needle.tip_m)
    w, x, y, z = page._arm.frame.wxyz
    assert np.allclose(pin.Quaternion(w, x, y, z).matrix()[:, 2], needle.axis)
    # 0.5 N at 25 mm/N, in the direction in which tissue pushes; a bar of 4 deviations.
    arrow_m = np.diff(page._force.arrow.points[0], axis=0)[0]
    bar_m = np.ptp(page._force.bar.points[0], axis=0)
    expected_m = [[0.0, 0.0, -0.0125], [0.0, 0.0, 4 * 0.1 * 0.025]]
    assert np.allclose([arrow_m, bar_m], expected_m, atol=1e-6)


def test_plots_show_valid_forces_until_the_time_shown(open_page):
    back = moment(10.0, 0.015)
    page = open_page(moment(0.0, status="not tared"), *insertion()[2:], back)
    page.show(5.0)
    curves = page._plots.over_time.data
    times_s, axial_N, upper_N, lower_N, tip_N, tip_upper_N, tip_lower_N = curves
    ends = (times_s[0], times_s[-1], axial_N[-1], tip_N[-1])
    assert ends == pytest.approx((0.1, 5.0, 20.0 * 0.01, 10.0 * 0.01))
    assert np.allclose([upper_N - axial_N, axial_N - lower_N], 0.1)
    assert np.allclose([tip_upper_N - tip_N, tip_N - tip_lower_N], 0.2)
    page.show()
    depths_mm, *forces_N = page._plots.over_depth.data
    assert depths_mm[-1] == pytest.approx(19.9)  # over depth no curve runs back
    assert all(np.isfinite(force_N).all() for force_N in forces_N)


def test_before_the_first_sample_the_plan_is_shown(open_page):
    words = words_of(open_page()._card)

    assert words.startswith("PLANNED waiting for the first sample")
    assert "100.0 mm from the planned entry to the target" in words
    assert words.endswith("Watched, no distance yet: rib, vein")


def test_planned_boundaries_stand_where_a_layer_ends(open_page):
    nodes = open_page()._server.scene._handle_from_node_name
    entry_m = plan().path.entry_m
    for name, depth_m, text in (("1", 0.02, "liver"), ("2", 0.05, "rib (obstacle)")):
        ring = nodes[f"/plan/boundary {name}"]
        assert np.allclose(ring.position, entry_m + np.array([0.0, 0.0, -depth_m]))
        assert nodes[f"/plan/boundary {name}/label"].text == text


def test_a_live_page_follows_and_a_recording_opens_at_its_start(open_page):
    page = open_page(moment(2.0), moment(3.0, 0.01), scene=PlanScene())
    page.follow()
    assert page.slider.value == 3.0
    page.jump(2.0)
    page.append([moment(4.0)])
    page.follow()
    assert page._shown_s == 2.0

    page.open_recording()
    shown = (page.slider.value, page._shown_s, page.live.visible)
    assert shown == (2.0, 2.0, False)


def test_the_ct_is_cut_at_the_target_until_the_needle_comes(open_page):
    tip_m, axis = open_page(scene=PlanScene())._arm.find_needle(HOME)
    page = open_page(scene=scanned(np.zeros(3), tip_m, axis))
    at_target = page._images[0].image
    far = deviation(depth_m=-0.05)
    page.append([moment(0.0, deviation=far), moment(1.0, 0.01, deviation=deviation())])
    page.show(0.0)
    assert np.array_equal(page._images[0].image, at_target)
    page.show(1.0)
    assert not np.array_equal(page._images[0].image, at_target)
    # The tip is at the bright place, below a needle that comes from above.
    assert page._images[0].image[163, 140].min() > 200
    assert tuple(page._images[0].image[100, 140]) == (255, 212, 0)


def test_an_arm_whose_meshes_cannot_be_read_is_a_line(open_page, tmp_path):
    (tmp_path / "link.wrl").write_text("#VRML V2.0 utf8\nShape {}\n")
    mesh = '<visual><geometry><mesh filename="link.wrl"/></geometry></visual>'
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
        'izz="1"/></inertial>'
    )
    path = tmp_path / "arm.urdf"
    path.write_text(
        f'<robot name="arm"><link name="base">{mesh}</link>'
        f'<link name="tip">{inertial}</link>'
        '<joint name="j" type="revolute"><parent link="base"/><child link="tip"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        "</joint></robot>"
    )
    robot = load_urdf(path, tool_frame="tip")
    page = open_page(
        moment(0.0, q=[0.5]), scene=PlanScene(), robot=robot, urdf_path=path
    )

    assert page.unread_shapes
    assert page._server.scene._handle_from_node_name["/bones"].visible


@pytest.mark.slow
def test_joints_the_robot_lacks_stay_locked(open_page):
    page = open_page(
        *insertion(2),
        scene=PlanScene(),
        robot=load_example("panda"),
        urdf_path=Path(example_robot_path("panda")),
    )

    assert np.allclose(page._arm._shapes._urdf.cfg, [*HOME, 0.0])


POINT = PlanScene(entry_m=np.zeros(3), target_m=np.zeros(3))


@pytest.mark.parametrize(
    ("scene", "port", "word"),
    [(plan(), -1, "-1"), (plan(), 70000, "70000"), (POINT, 8601, "two points")],
)
def test_a_port_or_a_plan_that_cannot_be_is_refused(scene, port, word):
    with pytest.raises(SceneError, match=word):
        Viewer(load_lwr(), scene, port=port)
