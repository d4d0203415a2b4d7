"""The insertion in a browser page, beside a loop, and in 3D Slicer."""

import errno
import json
import os
import re
import subprocess
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.chromium import PROGRAM
from tests.insertion_run import short_run

pytest.importorskip("viser")

from needleforce import NeedleTool, load_lwr
from needleforce.anatomy.plan_match import PlanState
from needleforce.cli import main
from needleforce.scene import (
    PlanScene,
    SceneError,
    SlicerOutput,
    StateRing,
    Viewer,
    open_viewer,
)
from needleforce.scene.state_ring import FIELDS, PLAN_FIELDS, ROWS, view_row
from needleforce.session_event import SessionEvent
from urdf import example_robot_path, load_example, load_urdf

HOME = np.array([0.0, 0.5, 0.0, -1.2, 0.0, 1.0, 0.0])
needs_chromium = pytest.mark.skipif(
    PROGRAM is None, reason="no chromium: apt-get install chromium"
)


def row(time_s, depth_m=0.0, rupture=0.0, q=HOME, **more):
    values = dict.fromkeys(FIELDS, 0.0) | {
        "time_s": time_s,
        "depth_m": depth_m,
        "is_good": 1.0,
    }
    values |= {f"plan_{name}": np.nan for name in PLAN_FIELDS}
    values |= {"force_N": 20.0 * depth_m, "tip_N": 10.0 * depth_m, "force_std_N": 0.05}
    values |= {
        "rupture": rupture,
        "rupture_depth_m": depth_m,
        "layer": 1.0,
        "tip_std_N": 0.1,
    }
    return (*((values | more)[name] for name in FIELDS), *q)


def insertion(count=200):
    return np.array(
        [row(0.05 * k, 1e-4 * k, 1.0 if k == 120 else 0.0) for k in range(count)]
    )


def planned(layer, next_mm, matched=-1):
    """What a plan says, as fields of a row."""
    values = (layer, 0.93, 2e-3, 0.4e-3, 1e-3 * next_mm, 0.5e-3, matched, 0.97)
    return {
        f"plan_{name}": value for name, value in zip(PLAN_FIELDS, values, strict=True)
    }


def plan():
    """Two boxes under the needle, and the way through them."""
    box = (
        np.array(
            [[x, y, z] for x in (0, 1) for y in (0, 1) for z in (0, 1)], dtype=float
        )
        * 0.05
    )
    triangles = np.array(
        [[0, 1, 3], [0, 3, 2], [4, 7, 5], [4, 6, 7], [0, 4, 5], [0, 5, 1]]
    )
    surfaces = [
        SimpleNamespace(
            name=name, colour=color, vertices_m=box + shift, triangles=triangles
        )
        for name, color, shift in (
            ("liver", (0.6, 0.2, 0.2), [-0.6, 0.0, 0.2]),
            ("rib", (0.9, 0.9, 0.9), [-0.6, 0.0, 0.1]),
        )
    ]
    layers = [
        SimpleNamespace(name="fat", exit_m=0.02, is_obstacle=False),
        SimpleNamespace(name="liver", exit_m=0.05, is_obstacle=False),
        SimpleNamespace(name="rib", exit_m=0.08, is_obstacle=True),
    ]
    return PlanScene(
        surfaces, layers, np.array([-0.6, 0.0, 0.3]), np.array([-0.6, 0.0, 0.2])
    )


def is_shown(mark):
    """Whether a mark is visible with its label; they are shown and hidden together."""
    assert mark.ring.line.visible == mark.ring.label.visible
    return mark.ring.line.visible


@pytest.fixture
def viewer():
    page = Viewer(load_lwr(payload=NeedleTool()), plan(), port=8231)
    yield page
    page.stop()


def test_a_ring_returns_rows_not_yet_overwritten():
    with StateRing(7) as ring:
        reader = StateRing(7, ring.name)
        count, rows = reader.since(0)
        assert (count, len(rows)) == (0, 0)
        for k in range(10):
            ring.put(row(0.001 * k))

        count, rows = reader.since(count)
        assert (count, len(rows)) == (10, 10)
        assert np.allclose(rows[:, 0], 0.001 * np.arange(10))
        assert np.allclose(rows[3, len(FIELDS) :], HOME)
        for k in range(3 * ROWS):
            ring.put(row(float(k)))

        count, rows = reader.since(count)
        assert count == 10 + 3 * ROWS
        assert len(rows) == 3 * ROWS // 4
        assert rows[-1, 0] == 3 * ROWS - 1
        reader.close()


def test_rows_overwritten_while_they_are_read_are_left_out(monkeypatch):
    with StateRing(7) as ring:
        for k in range(ROWS // 2):
            ring.put(row(float(k)))
        reader = StateRing(7, ring.name)
        read_count = reader._written_count

        def held_up():
            count = read_count()
            if count == ROWS // 2:  # the writer goes on before the rows are copied
                for k in range(ROWS // 2, ROWS + 100):
                    ring.put(row(float(k)))
            return count

        monkeypatch.setattr(reader, "_written_count", held_up)
        count, rows = reader.since(0)
        count, later = reader.since(count)

        assert np.array_equal(rows[:, 0], np.arange(101, ROWS // 2))
        assert np.array_equal(later[:, 0], np.arange(ROWS // 2, ROWS + 100))
        reader.close()


def test_marks_show_ruptures_up_to_the_time_shown(viewer):
    rows = insertion()
    for chunk in np.array_split(rows, 7):
        viewer.append(chunk)

    viewer.show()
    (mark,) = viewer.marks

    assert mark.text == "rupture 1 at 12.0 mm from the tare, before contact"
    assert mark.time_s == pytest.approx(6.0)
    assert is_shown(mark)

    viewer.show(3.0)

    assert not is_shown(mark)

    viewer.show(7.0)

    assert is_shown(mark)

    viewer.show(1.0)
    later = insertion(260)[200:]
    later[30, FIELDS.index("rupture")] = 2.0
    viewer.append(later)  # while somebody looks at the past
    viewer.show(1.0)

    assert not is_shown(viewer.marks[1])

    viewer.append(np.array([row(13.001), row(13.002, 0.03, 3.0)]))  # in one slot
    viewer.show()

    assert is_shown(viewer.marks[2])


def test_before_the_tare_no_curve_is_shown(viewer):
    viewer.append(np.vstack([row(0.0, is_good=0.0), insertion()[2:]]))
    for time_s, points in ((None, 198), (0.0, 0)):
        viewer.show(time_s)
        for plot in viewer._plots.charts.values():
            known = np.isfinite(plot.data[2])
            assert known.sum() == pytest.approx(points, abs=12)
            assert known.any() == bool(points)


def test_a_plan_names_layers_retracted_alarms_vanish(viewer):
    viewer.append(
        np.array([row(0.0, **planned(-1, 2.0)), row(1.0, 0.01, **planned(0, 22.0))])
    )
    viewer.show(0.5)

    assert "in outside (93 %), fat at 2.0 ± 0.5 mm" in viewer._text.content

    viewer.show()

    assert "in fat (93 %), liver at 22.0 ± 0.5 mm" in viewer._text.content
    assert "all lies +2.0 ± 0.4 mm deeper than planned" in viewer._text.content

    ring, label = viewer._ahead

    assert ring.visible
    assert label.text == "liver, expected"

    alarm = row(2.0, 0.0221, 1.0, **planned(1, 52.0, 1))
    viewer.append(np.array([alarm, row(3.0, 0.03, retracted=1.0, **planned(0, 32.0))]))
    viewer.append(np.array([row(4.0, 0.032, 1.0, **planned(2, np.nan, -1))]))
    viewer.show()
    texts = [
        "rupture 1 at 22.1 mm from the tare, before contact: into liver (97 %)",
        "rupture 1 at 32.0 mm from the tare, before contact: a false alarm (97 %)",
    ]

    assert [mark.text for mark in viewer.marks] == texts

    for time_s, shown in ((1.9, [0, 0]), (2.5, [1, 0]), (3.5, [0, 0]), (4.0, [0, 1])):
        viewer.show(time_s)
        assert [is_shown(mark) for mark in viewer.marks] == shown

    assert "in rib (93 %)<" in viewer._text.content
    assert not ring.visible


def test_a_row_holds_the_estimate_and_its_plan():
    plan = PlanState(
        1, "liver", 0.9, 2e-3, 1e-3, "rib", 0.05, 1e-3, 1, "liver", 0.8, True
    )
    rupture = SimpleNamespace(layer=1, depth_m=0.03)
    identification = SimpleNamespace(
        rupture=None, retracted=rupture, tip_force_N=0.5, layer=2
    )
    identification.tip_force_std_N = None
    identification.shaft_friction_N = 0.1
    identification.enhanced_force_N = 0.7
    estimate = SimpleNamespace(
        time_s=1.0,
        depth_m=0.04,
        speed_m_s=0.0,
        identification=identification,
        plan=plan,
    )
    identification.hard_contact = SimpleNamespace(
        depth_m=0.03, force_N=1.0, growth_N_per_m=1e3
    )
    identification.identified_layer = None
    estimate.plan_events = (SessionEvent("too_near", "", {}),)
    estimate.wrench = SimpleNamespace(axial=1.0, axial_std=0.1)
    estimate.status = SimpleNamespace(value="ok")
    numbers = dict(zip(FIELDS, view_row(estimate, HOME), strict=False))

    assert (numbers["retracted"], numbers["rupture"], numbers["is_good"]) == (1, 0, 1)
    assert numbers["event"] == 3.0  # too near is more urgent than a hard contact
    assert [numbers[f"plan_{name}"] for name in PLAN_FIELDS] == [
        1,
        0.9,
        2e-3,
        1e-3,
        0.05,
        1e-3,
        1,
        0.8,
    ]


@pytest.mark.slow
@needs_chromium
def test_the_page_shows_the_insertion_in_a_browser(viewer, tmp_path):
    from tests.needleforce.scene.scene_page import open_page

    viewer.append(insertion())
    viewer.show()
    with open_page(viewer.url) as page:
        assert page.wait_for("document.querySelectorAll('canvas').length > 0")
        assert page.wait_for("document.body.innerText.includes('tip force')")
        assert page.wait_for("document.body.innerText.includes('rupture 1 at 12.0 mm')")
        text = page.evaluate("document.body.innerText")
        assert "not a medical device" in text
        viewer.show(3.0)
        assert page.wait_for(
            "!document.body.innerText.includes('rupture 1 at 12.0 mm')"
        )
        assert page.wait_for("document.body.innerText.includes('3.0 s')")
        time.sleep(3.0)  # the scene fades in
        picture = page.picture(tmp_path / "scene.png")
        assert picture.stat().st_size > 20_000
        assert page.errors == []


@pytest.mark.slow
def test_a_loop_hands_rows_to_a_page_process():
    robot = load_lwr(payload=NeedleTool())
    wrench = SimpleNamespace(axial=1.0, axial_std=0.1)
    identification = SimpleNamespace(
        rupture=None, retracted=None, tip_force_N=0.5, tip_force_std_N=None
    )
    identification.shaft_friction_N = 0.1
    identification.enhanced_force_N = 0.7
    identification.layer = 1
    identification.hard_contact = None
    identification.identified_layer = None
    with open_viewer(robot, port=8241) as view:
        assert view.url.startswith("http://127.0.0.1:")
        for k in range(2000):
            estimate = SimpleNamespace(
                time_s=0.001 * k,
                depth_m=0.0,
                speed_m_s=0.0,
                wrench=wrench,
                identification=identification,
                status=SimpleNamespace(value="ok"),
                plan=None,
                plan_events=(),
            )
            view.put(estimate, HOME)

        time.sleep(0.2)


@pytest.mark.slow
@needs_chromium
def test_a_recording_becomes_one_standalone_page(tmp_path, monkeypatch, capsys):
    from needleforce.recordings import write_table
    from needleforce.simulation import signal_table
    from tests.needleforce.scene.scene_page import open_page

    monkeypatch.chdir(tmp_path)
    run = short_run()
    table = {name: values[::4] for name, values in signal_table(run).items()}
    write_table(
        "insertion.npz",
        {name: table[name] for name in ("t_s", "q_rad", "dq_rad_s", "tau_Nm")},
    )
    options = [
        "--payload",
        "needle",
        "--tare",
        "13",
        "--export",
        "scene.html",
        "--port",
        "8251",
    ]

    assert main(["view", "insertion.npz", *options]) == 0
    assert "scene.html" in capsys.readouterr().out

    text = (tmp_path / "scene.html").read_text(encoding="utf-8")

    assert len(text) > 100_000

    with open_page((tmp_path / "scene.html").as_uri()) as page:
        assert page.wait_for(
            "document.getElementById('scene').contentDocument"
            "?.querySelectorAll('canvas').length > 0"
        )


@pytest.mark.slow
@pytest.mark.parametrize(
    ("joints", "torque", "options", "code", "why"),
    [
        (
            6,
            1.0,
            [],
            2,
            "error: the log has 6 columns .* the robot has 7 joints",
        ),
        (
            7,
            1.0,
            ["--tare", "-3"],
            2,
            "error: --tare -3: expected seconds of free motion",
        ),
        (
            7,
            1.0,
            ["--tare", "100"],
            0,
            r"warning: no tare in 2.001 s \(--tare 100 asks",
        ),
        (
            7,
            1e3,
            [],
            0,
            "warning: samples rejected, 19..: 19.. x tau is at the effort limit",
        ),
        (
            7,
            -1.0,
            ["--tare", "1"],
            0,
            "no tare at 1.0 s, .* no single unit, sign, order or direction of gravity",
        ),
        (7, np.nan, [], 2, "error: tau_Nm has no finite value"),
    ],
)
def test_a_recording_without_tare_is_reported(
    joints, torque, options, code, why, tmp_path, monkeypatch, capsys
):
    from needleforce.recordings import write_table
    from needleforce.simulation import signal_table

    monkeypatch.chdir(tmp_path)
    table = signal_table(short_run())
    signals = {
        name: table[name][:2001, :joints] for name in ("q_rad", "dq_rad_s", "tau_Nm")
    }
    signals["tau_Nm"] = torque * signals["tau_Nm"]
    write_table("a.npz", {"t_s": table["t_s"][:2001], **signals})

    assert (
        main(["view", "a.npz", *options, "--export", "a.html", "--port", "8271"])
        == code
    )

    said, warned = capsys.readouterr()

    assert said == ("" if code else "a.html\n")
    assert re.search(why, warned)
    assert "ignore_contact" not in warned


def test_viewed_joints_are_found_by_name(tmp_path):
    from needleforce.cli.logs.session_view import scene_rows
    from needleforce.recordings import write_table
    from needleforce.recordings.table import TableLabels
    from needleforce.simulation import signal_table

    model = load_lwr()
    order = [3, 1, 0, 2, 6, 5, 4]
    table = signal_table(short_run())
    signals = {
        name: table[name][:1001] for name in ("t_s", "q_rad", "dq_rad_s", "tau_Nm")
    }
    turned = {name: v[:, order] if v.ndim == 2 else v for name, v in signals.items()}
    names = tuple(model.joint_names[k] for k in order)
    write_table(
        tmp_path / "a.mcap", signals, labels=TableLabels(joint_names=model.joint_names)
    )
    write_table(tmp_path / "b.mcap", turned, labels=TableLabels(joint_names=names))
    rows, reordered_rows = (
        scene_rows(tmp_path / name, model) for name in ("a.mcap", "b.mcap")
    )

    assert len(rows) > 90
    assert np.array_equal(rows, reordered_rows, equal_nan=True)


@pytest.mark.slow
def test_an_arm_is_watched_with_its_scene(monkeypatch, capsys):
    monkeypatch.setattr(
        "needleforce.cli.arms.arm_connection.simulate", lambda *_, **__: short_run()
    )

    assert (
        main(
            [
                "live",
                "sim:gel-25-constant",
                "--view",
                "--port",
                "8261",
                "--seconds",
                "0.5",
            ]
        )
        == 0
    )

    said, warned = capsys.readouterr()

    assert "layer 0" in said
    assert "http://127.0.0.1:8261 shows the scene" in warned


def test_an_unreadable_plan_is_reported(tmp_path, capsys):
    (tmp_path / "a.csv").write_text("t,q_1\n0,0\n")

    assert main(["view", "a.csv", "--anatomy", str(tmp_path)]) == 2

    said = capsys.readouterr().err

    assert "plan.json: " in said
    assert said.startswith("error: ")


def test_an_arm_is_shown_without_the_meshes_that_cannot_be_read(tmp_path):
    (tmp_path / "link.wrl").write_text("#VRML V2.0 utf8\nShape {}\n")
    mesh = '<visual><geometry><mesh filename="{}"/></geometry></visual>'
    box = '<visual><geometry><box size="1 1 1"/></geometry></visual>'
    inertial = (
        '<inertial><mass value="1"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0" '
        'izz="1"/></inertial>'
    )
    path = tmp_path / "arm.urdf"
    path.write_text(
        f'<robot name="arm"><link name="base">{mesh.format("link.wrl")}</link>'
        f'<link name="tip">{inertial}{mesh.format("link.wrl")}{box}'
        f"{mesh.format('absent.stl')}</link>"
        '<joint name="j" type="revolute"><parent link="base"/><child link="tip"/>'
        '<axis xyz="0 0 1"/><limit lower="-1" upper="1" effort="1" velocity="1"/>'
        "</joint></robot>"
    )
    page = Viewer(load_urdf(path, tool_frame="tip"), port=8291, urdf_path=path)
    page.append(np.array([row(0.0, q=[0.5])]))
    page.show()

    assert page.unread_meshes == ("link.wrl",)
    assert len(page._arm._shapes._meshes) == 1

    page.stop()


@pytest.mark.slow
def test_joints_the_robot_lacks_stay_locked():
    page = Viewer(
        load_example("panda"), port=8281, urdf_path=Path(example_robot_path("panda"))
    )
    page.append(insertion(2))
    page.show()
    shapes = page._arm._shapes

    assert np.allclose(shapes._urdf.cfg, [*HOME, 0.0])

    page.stop()


@pytest.mark.parametrize(
    ("options", "why"),
    [
        (
            ["--port", "70000"],
            "error: 127.0.0.1, port 70000: .*expected an address",
        ),
        (["--port", "-1"], "port -1: .*a port of 0 to 65535"),
        (
            ["--host", "nosuchhost.invalid"],
            "nosuchhost.invalid, port 8080: .*expected an address",
        ),
        (["--host", "192.0." + "2.1"], "expected an address of this machine"),
        (["--host", "::1", "--port", "70000"], "::1, port 70000"),
    ],
)
def test_an_impossible_address_is_reported_in_one_line(options, why, tmp_path, capsys):
    assert main(["view", str(tmp_path / "none.csv"), *options]) == 2

    (said,) = capsys.readouterr().err.splitlines()

    assert re.search(why, said)


@pytest.mark.parametrize(
    ("export", "why"),
    [
        ("log.csv", "--export log.csv: its name must end in .html"),
        ("link.html", "cannot write link.html: it is the log itself"),
        ("no/page.html", "there is no folder no"),
    ],
)
def test_a_harmful_or_impossible_export_is_refused_early(
    export, why, tmp_path, monkeypatch, capsys
):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text("no log")
    Path("link.html").symlink_to("log.csv")

    assert main(["view", "log.csv", "--export", export]) == 2
    assert why in capsys.readouterr().err
    assert Path("log.csv").read_text() == "no log"


def test_a_failing_export_leaves_the_older_page(viewer, tmp_path, monkeypatch):
    def full(_handle):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    page = tmp_path / "page.html"
    page.write_text("old")
    viewer.append(insertion(2))
    monkeypatch.setattr(os, "fsync", full)

    with pytest.raises(SceneError, match="No space left"):
        viewer.export(page, frames=2)

    assert [path.read_text() for path in tmp_path.iterdir()] == ["old"]


@pytest.mark.slow
def test_a_page_that_cannot_open_is_reported():
    robot = load_lwr()

    with pytest.raises(SceneError, match="port 70000"):
        open_viewer(robot, port=70000)

    place = np.zeros(3)

    with pytest.raises(SceneError, match="expected two points"):
        open_viewer(robot, PlanScene((), (), place, place), port=8291)


RECEIVER = """
import json, sys, time, pyigtl
client = pyigtl.OpenIGTLinkClient("127.0.0.1", int(sys.argv[1]))
client.start()
received = {"poses": 0, "forces": 0, "ruptures": []}
end_s = time.monotonic() + 20.0
print("ready", flush=True)
while time.monotonic() < end_s and not received["ruptures"]:
    for message in client.get_latest_messages():
        if message.device_name == "NeedleToReference":
            received["poses"] += 1
            received["matrix"] = message.matrix.tolist()
        elif message.device_name == "Force":
            received["forces"] += 1
        elif message.device_name == "Rupture":
            received["ruptures"].append(json.loads(message.string))
    time.sleep(0.005)
print(json.dumps(received), flush=True)
client.stop()
"""


def tick(time_s, force_N=1.0, rupture=None):
    identification = SimpleNamespace(tip_force_N=0.5, rupture=rupture)
    wrench = SimpleNamespace(axial=force_N, axial_std=0.1)
    return SimpleNamespace(
        time_s=time_s, depth_m=0.02, wrench=wrench, identification=identification
    )


@pytest.mark.slow
def test_slicer_is_updated_when_time_restarts(monkeypatch):
    pytest.importorskip("pyigtl")
    sent = []
    with SlicerOutput(18978) as output:
        monkeypatch.setattr(output, "_send", sent.append)
        times = (0.0, 0.01, 60.0, 60.01, 0.5, 0.51, 0.52)
        assert [output.put(tick(time_s), np.eye(4)) for time_s in times] == [
            1,
            0,
            1,
            0,
            1,
            0,
            1,
        ]
        assert output.put(tick(1.0, np.float64(np.nan)), np.eye(4))
        assert (
            json.loads(sent[-1].string, parse_constant=pytest.fail)["force_N"] is None
        )
        for port in (18978, 70000):
            with pytest.raises(SceneError, match=f"port {port}: .*expected a free one"):
                SlicerOutput(port)


@pytest.mark.slow
def test_3d_slicer_gets_pose_force_and_ruptures():
    pytest.importorskip("pyigtl")
    port = 18977
    with SlicerOutput(port) as output:
        receiver = subprocess.Popen(
            [sys.executable, "-c", RECEIVER, str(port)],
            stdout=subprocess.PIPE,
            text=True,
        )
        try:
            assert receiver.stdout.readline().strip() == "ready"
            end_s = time.monotonic() + 20.0
            while not output.is_connected and time.monotonic() < end_s:
                time.sleep(0.05)

            assert output.is_connected
            pose = np.eye(4)
            pose[:3, 3] = 0.01, 0.02, 0.03
            rupture = SimpleNamespace(
                layer=1, depth_m=0.02, probability=0.9, time_s=1.0
            )
            sent = 0
            for k in range(1000):
                tick_rupture = rupture if k == 999 else None
                sent += output.put(tick(0.001 * k, rupture=tick_rupture), pose)
                time.sleep(0.001)

            assert sent == pytest.approx(51, abs=1)
            received = json.loads(receiver.communicate(timeout=30.0)[0])
        finally:
            receiver.kill()

    assert received["poses"] > 5
    assert received["forces"] > 5
    assert received["ruptures"][0]["depth_mm"] == pytest.approx(20.0)
    assert np.allclose(
        np.array(received["matrix"])[:3, 3], [-10.0, -20.0, 30.0], atol=1e-3
    )
