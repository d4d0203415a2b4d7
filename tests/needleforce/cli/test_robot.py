"""Options of the robot: the joints that a log has, its inertia, its mounting."""

import json

import pytest

from needleforce.cli import main
from needleforce.recordings import read_table, write_table
from needleforce.recordings.output import open_table
from needleforce.recordings.table import TableLabels
from tests.needleforce.cli.residual_command_log import (
    AXIAL_N,
    SMALL_ARM,
    insertion,
    refusal,
    write_insertion,
)
from urdf import load_urdf

TIP_M = (0.3, 0.3, 0.2)  # where both joints have a lever
ON_TIP = [
    *("--tool-frame", "tip", "--tip-offset", *map(str, TIP_M)),
    *("--tare", "0:2.5", "--mode", "axial"),
]
HEAD = """<link name="head"/><joint name="neck" type="continuous">
<parent link="base"/><child link="head"/></joint>
<link name="ball"/><joint name="ball_joint" type="floating">
<parent link="base"/><child link="ball"/></joint></robot>"""


@pytest.fixture
def arm(tmp_path):
    """Write the small arm with a head that nothing measures, and return its path."""
    path = tmp_path / "arm.urdf"
    path.write_text(SMALL_ARM.replace("</robot>", HEAD))
    return path


def robot_of(arm, **options):
    options = {"keep_joints": ["shoulder", "elbow"]} | options
    return load_urdf(arm, tool_frame="tip", tool_placement=TIP_M, **options)


def force_of(capsys, argv, folder):
    """Run `force`; return the last axial force, what it printed, and its warnings."""
    table = folder / "forces.csv"
    code = main(["force", *map(str, argv), *ON_TIP, "-o", str(table)])
    printed = capsys.readouterr()
    assert code == 0, printed.err
    return read_table(table).columns["axial_N"][-1], printed.out, printed.err


def test_joints_that_the_log_lacks_are_locked_at_once(arm, tmp_path, capsys):
    log = write_insertion(tmp_path / "log.npz", robot_of(arm))
    line = refusal(["force", str(log), "--urdf", str(arm), *ON_TIP], capsys)

    assert "'ball_joint' is of type 'floating'" in line
    assert "--lock-others" in line

    fixed = ["--urdf", str(arm), "--lock", "ball_joint", "--accept-inertia", *ON_TIP]
    line = refusal(["force", str(log), *fixed], capsys)

    assert "4 joints: neck, shoulder, elbow, gripper" in line
    assert "--lock-others" in line

    axial_N, out, _ = force_of(capsys, [log, "--urdf", arm, "--lock-others"], tmp_path)

    assert axial_N == pytest.approx(AXIAL_N, abs=0.2)
    assert "arm, 2 joints" in out


@pytest.mark.slow
def test_joints_that_the_log_names_are_kept_in_the_order_of_the_robot(
    arm, tmp_path, capsys
):
    robot = robot_of(arm, keep_joints=["shoulder", "elbow", "gripper"])
    columns = insertion(robot)
    log = tmp_path / "log.mcap"
    labels = TableLabels(joint_names=("gripper", "elbow", "shoulder"))
    with open_table(str(log), is_live=False, labels=lambda: labels) as table:
        table.append(
            {
                name: values[:, ::-1] if values.ndim == 2 else values
                for name, values in columns.items()
                if name != "tau_ext_Nm"
            }
        )
    options = ["--urdf", arm, "--lock-others"]
    axial_N, out, _ = force_of(capsys, [log, *options], tmp_path)

    assert axial_N == pytest.approx(AXIAL_N, abs=0.2)
    assert "arm, 3 joints" in out

    options += ["--lock", "gripper=0.05", "--force-tare"]
    _, out, err = force_of(capsys, [log, *options], tmp_path)

    assert "arm, 2 joints" in out
    assert err == ""


def test_a_joint_before_the_tool_that_the_log_lacks_is_named(arm, tmp_path, capsys):
    log = write_insertion(tmp_path / "log.npz", robot_of(arm, keep_joints=["elbow"]))
    (tmp_path / "names.toml").write_text('joints = ["elbow"]')
    options = ["--lock-others", "--mapping", tmp_path / "names.toml", "--no-tare"]
    argv = ["force", log, "--urdf", arm, *options, *ON_TIP[:-4]]

    assert main([str(word) for word in argv]) == 0

    printed = capsys.readouterr()
    for text in (printed.out, printed.err):
        assert "are locked at 0: shoulder; --lock JOINT=POSITION" in text


@pytest.mark.slow
def test_a_mapping_names_the_joints_of_a_log_without_names(arm, tmp_path, capsys):
    robot = robot_of(arm)
    log = write_insertion(tmp_path / "log.npz", robot)
    (tmp_path / "names.toml").write_text('joints = ["shoulder", "elbow"]')
    options = ["--lock-others", "--mapping", tmp_path / "names.toml"]
    _, out, _ = force_of(capsys, [log, "--urdf", arm, *options], tmp_path)

    assert "arm, 2 joints" in out

    for names in ('"left/shoulder", "left/elbow"', '"shoulder_1", "elbow_1"'):
        (tmp_path / "names.toml").write_text(f"joints = [{names}]")
        _, out, _ = force_of(capsys, [log, "--urdf", arm, *options], tmp_path)

        assert "arm, 2 joints" in out

    (tmp_path / "names.toml").write_text('joints = ["j1", "j2"]')
    argv = ["force", log, "--urdf", arm, *options, *ON_TIP]
    line = refusal([str(word) for word in argv], capsys)

    assert "the log has the joints j1, j2, the robot shoulder, elbow" in line


def test_more_columns_than_joints_are_refused_with_the_joints(arm, tmp_path, capsys):
    columns = insertion(robot_of(arm))
    for name in ("q_rad", "dq_rad_s", "tau_Nm", "tau_ext_Nm"):
        columns[name] = columns[name][:, [0, 0, 1]]
    log = tmp_path / "log.npz"
    write_table(log, columns)
    argv = ["force", str(log), "--urdf", str(arm), "--lock-others", *ON_TIP]
    line = refusal(argv, capsys)

    assert "has 3 columns" in line
    assert "move 2: shoulder, elbow" in line


def test_fewer_columns_are_the_joints_nearest_to_the_tool(arm, tmp_path, capsys):
    log = write_insertion(tmp_path / "log.npz", robot_of(arm, keep_joints=["elbow"]))
    argv = ["force", log, "--urdf", arm, "--lock-others", "--no-tare", *ON_TIP[:-4]]

    assert main([str(word) for word in argv]) == 0

    printed = capsys.readouterr()
    assert "arm, 1 joints" in printed.out
    assert "are locked at 0: shoulder; --lock JOINT=POSITION" in printed.err


@pytest.mark.slow
def test_a_report_takes_the_options_and_shows_what_is_odd(arm, tmp_path, capsys):
    wrist = '<inertia ixx="1e-3" ixy="0" ixz="0" iyy="2e-3" iyz="0" izz="0.01"/>'
    text = arm.read_text()
    arm.write_text(
        text.replace(
            '<inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>', wrist
        )
    )
    log = write_insertion(tmp_path / "log.npz", robot_of(arm))
    folder = tmp_path / "report"
    options = ["--urdf", str(arm), "--lock-others", *ON_TIP]

    assert main(["report", str(log), str(folder), *options]) == 0

    printed = capsys.readouterr()
    page = (folder / "index.html").read_text()

    for text in (printed.out, printed.err, page):
        assert "no rigid body has the inertia of tip" in text
    assert "Warning: " in page


@pytest.mark.slow
def test_inertia_is_accepted_with_a_warning_in_every_result(arm, tmp_path, capsys):
    robot = robot_of(arm)
    log = write_insertion(tmp_path / "log.npz", robot)
    text = arm.read_text()
    start = text.index('<inertial><origin xyz="0 0 0.2"/><mass value="2"/>')
    end = text.index("</inertial>", start) + len("</inertial>")
    arm.write_text(text[:start] + text[end:])
    argv = [str(log), "--urdf", str(arm), "--lock-others"]
    line = refusal(["force", *argv, *ON_TIP], capsys)

    assert "without inertia: upper (joint shoulder)" in line
    assert "--accept-inertia" in line

    options = [*argv, "--accept-inertia", "--force-tare"]
    _, out, err = force_of(capsys, options, tmp_path)

    main(["check", *options, *ON_TIP, "--json"])
    found = capsys.readouterr().out

    for printed in (out, err, found):
        assert "accepted without inertia: upper (joint shoulder)" in printed
    assert "accepted without inertia" in json.loads(found)["warnings"][-1]


@pytest.mark.parametrize(
    ("options", "gravity"),
    [
        (["--mount", "wall"], (9.80665, 0.0, 0.0)),
        (["--mount", "ceiling"], (0.0, 0.0, 9.80665)),
        (["--mount", "tilt", "-30"], (-4.903325, 0.0, -8.492808)),
        (["--mount", "tilt=30"], (4.903325, 0.0, -8.492808)),
        (["--gravity", "0", "-9.81", "0"], (0.0, -9.81, 0.0)),
    ],
    ids=lambda value: " ".join(map(str, value)),
)
def test_gravity_is_that_of_the_mounting(arm, tmp_path, capsys, options, gravity):
    log = write_insertion(tmp_path / "log.npz", robot_of(arm, gravity_m_s2=gravity))
    argv = [log, *options, "--urdf", arm, "--lock-others"]
    axial_N, out, _ = force_of(capsys, argv, tmp_path)
    shown = " ".join(f"{component:.4g}" for component in gravity)

    assert axial_N == pytest.approx(AXIAL_N, abs=0.2)
    assert f"gravity {shown} m/s^2 in base axes" in out


@pytest.mark.parametrize(
    ("options", "message"),
    [
        (["--gravity", "0", "0", "1"], "is 1 m/s^2, expected about 9.81"),
        (["--gravity", "0", "0", "9.81", "--mount", "wall"], "say the same"),
        (["--mount", "roof"], "expected wall, ceiling or tilt DEG"),
        (["--mount", "tilt", "up"], "expected wall, ceiling or tilt DEG"),
        (["--lock-others"], "--lock-others is for a robot of --urdf FILE"),
        (["--accept-inertia"], "--accept-inertia is for a robot of --urdf FILE"),
    ],
    ids=lambda value: value if isinstance(value, str) else " ".join(value),
)
def test_options_that_do_not_fit_are_refused(tmp_path, capsys, options, message):
    log = tmp_path / "log.csv"
    log.write_text("t,q1,tau1\n")

    assert message in refusal(["force", str(log), *options], capsys)


def test_a_known_arm_hangs_from_the_ceiling(lwr, tmp_path, capsys):
    log = write_insertion(tmp_path / "log.npz", lwr, seconds=1.0)

    assert main(["force", str(log), "--mount", "ceiling", "--no-tare"]) == 0
    assert "gravity 0 0 9.807 m/s^2 in base axes" in capsys.readouterr().out
