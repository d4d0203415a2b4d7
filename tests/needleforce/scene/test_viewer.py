"""The page: ruptures, verdicts, nearest structure, forces and CT of the time shown."""

import re
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

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

pytest.importorskip("viser")

from needleforce import NeedleTool, load_lwr
from needleforce.scene import PlanScene, SceneError, Viewer
from urdf import example_robot_path, load_example, load_urdf


@pytest.fixture
def open_page():
    """Opens pages, and closes them at the end."""
    pages = []

    def make(scene=None, robot=None, **settings):
        robot = robot or load_lwr(payload=NeedleTool())
        page = Viewer(robot, scene or plan(), port=8601, **settings)
        pages.append(page)
        return page

    yield make
    for page in pages:
        page.stop()


def words_of(handle):
    return " ".join(re.sub("<[^>]*>", " ", handle.content).split())


def shown_marks(page):
    """Whether each rupture is seen; its label is shown and hidden with it."""
    for mark in page.marks:
        assert mark.ring.line.visible == mark.ring.label.visible
    return [bool(mark.ring.line.visible) for mark in page.marks]


def test_ruptures_are_shown_from_their_time_on(open_page):
    page = open_page()
    for k in range(0, 200, 30):
        page.append(insertion()[k : k + 30])
    page.show()

    assert page.marks[0].time_s == pytest.approx(6.0)
    assert shown_marks(page) == [True]
    assert "rupture 1 at 12.0 mm" in words_of(page._text)
    for time_s, is_shown in ((3.0, False), (7.0, True), (-1.0, False)):
        page.show(time_s)
        assert shown_marks(page) == [is_shown]

    page.show(1.0)
    page.append([moment(11.0, 0.021, rupture=2)])  # while somebody looks at the past
    assert shown_marks(page) == [False, False]
    needle = page._arm.find_needle(HOME)
    page.append([moment(12.0, 0.05, retracted=2)])
    page.show(12.0)
    assert shown_marks(page) == [True, False]
    page.show(11.5)
    assert shown_marks(page) == [True, True]
    assert np.allclose(page.marks[1].ring.line.position, needle.tip_m, atol=1e-6)


def test_a_plan_names_tissue_ruptures_and_the_next_boundary(open_page):
    page = open_page()
    page.append([moment(0.0, plan=planned(-1, 0.002))])
    page.append([moment(1.0, 0.01, plan=planned(0, 0.022))])
    page.show(0.5)
    assert "in outside (93 %), fat at 2.0 ± 0.5 mm" in words_of(page._text)

    page.show()
    assert "in fat (93 %), liver at 22.0 ± 0.5 mm" in words_of(page._text)
    assert "+2.0 ± 0.4 mm deeper" in words_of(page._text)
    assert page._expected.line.visible
    assert page._expected.label.text == "liver, expected"
    assert np.allclose(page._expected.line.position, [0.0, 0.0, 0.012])

    page.append([moment(2.0, 0.0221, rupture=1, plan=planned(1, 0.052, 1))])
    page.append([moment(3.0, 0.03, rupture=2, plan=planned(2, np.nan, -1))])
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
    page = open_page()
    page.append([moment(1.0, 0.02, deviation=deviation(**state))])
    page.show()

    assert page._warning.visible == bool(banner)
    assert page._warning.text == banner
    assert (page._arm.needle.color == (230, 30, 30)) is is_red
    assert banner in words_of(page._card)


def test_a_line_joins_the_needle_and_the_nearest_structure(open_page):
    page = open_page()
    tip_m, axis = page._arm.find_needle(HOME)
    aside = np.cross(axis, [0.0, 1.0, 0.0])
    place_m = tip_m + 0.004 * axis + 0.012 * aside / np.linalg.norm(aside)
    near = clearance(place_m=place_m)
    page.append([moment(0.0), moment(1.0, clearances=(near,))])
    page.append([moment(2.0, clearances=(near._replace(needed_m=0.02),))])
    page.show(0.0)
    assert not page._nearest.visible
    page.show(1.0)
    start_m, end_m = page._nearest.points[0]
    assert page._nearest.visible
    assert np.allclose(end_m, place_m, atol=1e-6)
    # At a right angle to the needle, where the structure is nearest to it.
    assert np.allclose(start_m, tip_m + 0.004 * axis, atol=1e-6)
    assert page._nearest.colors.tolist() == [150, 0, 120]
    page.show(2.0)
    assert page._nearest.colors.tolist() == [230, 30, 30]


def test_the_arrow_shows_the_tip_force_where_it_is_valid(open_page):
    page = open_page()
    page.append([moment(0.0, 0.05, status="not tared"), moment(1.0, 0.05)])
    page.show(0.0)
    assert not page._force.arrow.visible
    page.show(1.0)
    needle = page._arm.find_needle(HOME)
    assert np.allclose(page._arm.frame.position, needle.tip_m)
    w, x, y, z = page._arm.frame.wxyz
    assert np.allclose(pin.Quaternion(w, x, y, z).matrix()[:, 2], needle.axis)
    start_m, end_m = page._force.arrow.points[0]
    # 0.5 N at 25 mm/N, in the direction in which tissue pushes.
    assert np.allclose(end_m - start_m, [0.0, 0.0, -0.0125], atol=1e-6)
    bar_m = np.ptp(page._force.bar.points[0], axis=0)
    assert np.allclose(bar_m, [0.0, 0.0, 4 * 0.1 * 0.025], atol=1e-6)


def test_plots_show_valid_forces_until_the_time_shown(open_page):
    page = open_page()
    page.append([moment(0.0, status="not tared"), *insertion()[2:]])
    page.append([moment(10.0, 0.015)])  # back
    page.show(5.0)
    curves = page._plots.over_time.data
    times_s, axial_N, upper_N, lower_N, tip_N, tip_upper_N, tip_lower_N = curves
    assert times_s[0] == pytest.approx(0.1)
    assert times_s[-1] == pytest.approx(5.0)
    assert axial_N[-1] == pytest.approx(20.0 * 0.01)
    assert tip_N[-1] == pytest.approx(10.0 * 0.01)
    assert np.allclose(upper_N - axial_N, 0.1)
    assert np.allclose(axial_N - lower_N, 0.1)
    assert np.allclose(tip_upper_N - tip_N, 0.2)
    assert np.allclose(tip_N - tip_lower_N, 0.2)
    page.show()
    depths_mm, *forces_N = page._plots.over_depth.data
    assert depths_mm[-1] == pytest.approx(19.9)  # over depth no curve runs back
    assert all(np.isfinite(force_N).all() for force_N in forces_N)


def test_before_the_first_sample_the_plan_is_shown(open_page):
    page = open_page()
    words = words_of(page._card)

    assert words.startswith("PLANNED waiting for the first sample")
    assert "100.0 mm from the planned entry to the target" in words
    assert words.endswith("Watched, no distance yet: rib, vein")


def test_planned_boundaries_stand_where_a_layer_ends(open_page):
    page = open_page()
    nodes = page._server.scene._handle_from_node_name
    entry_m = plan().path.entry_m
    for name, depth_m, text in (("1", 0.02, "liver"), ("2", 0.05, "rib (obstacle)")):
        ring = nodes[f"/plan/boundary {name}"]
        assert np.allclose(ring.position, entry_m + np.array([0.0, 0.0, -depth_m]))
        assert nodes[f"/plan/boundary {name}/label"].text == text


def test_a_live_page_follows_and_a_recording_opens_at_its_start(open_page):
    page = open_page(PlanScene())
    page.append([moment(2.0), moment(3.0, 0.01)])
    page.follow()
    assert page.slider.value == 3.0
    page.jump(2.0)
    page.append([moment(4.0)])
    page.follow()
    assert page._shown_s == 2.0

    page.open_recording()
    assert page.slider.value == 2.0
    assert page._shown_s == 2.0
    assert not page.live.visible


def test_the_ct_is_cut_at_the_target_until_the_needle_comes(open_page):
    robot = load_lwr(payload=NeedleTool())
    viewer = open_page(PlanScene(), robot)
    tip_m, axis = viewer._arm.find_needle(HOME)
    page = open_page(scanned(np.zeros(3), tip_m, axis), robot)
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
    page = open_page(PlanScene(), load_urdf(path, tool_frame="tip"), urdf_path=path)
    page.append([moment(0.0, q=[0.5])])
    page.show()

    assert page.unread_shapes
    assert page._server.scene._handle_from_node_name["/bones"].visible


@pytest.mark.slow
def test_joints_the_robot_lacks_stay_locked(open_page):
    path = Path(example_robot_path("panda"))
    page = open_page(PlanScene(), load_example("panda"), urdf_path=path)
    page.append(insertion(2))
    page.show()

    assert np.allclose(page._arm._shapes._urdf.cfg, [*HOME, 0.0])


@pytest.mark.parametrize("port", [-1, 70000])
def test_a_port_that_cannot_be_is_refused(open_page, port):
    with pytest.raises(SceneError, match=str(port)):
        Viewer(load_lwr(), port=port)


def test_a_plan_of_one_point_is_refused(open_page):
    place_m = np.zeros(3)
    with pytest.raises(SceneError, match="two points"):
        open_page(PlanScene(entry_m=place_m, target_m=place_m))
