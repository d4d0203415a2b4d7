"""Options of the robot: the joints that a log has, its inertia, its mounting."""

import re

import pytest

from needleforce.cli import main
from needleforce.cli.options import RobotOptions
from needleforce.cli.robot import robot_from_options
from needleforce.recordings import read_table, write_table
from tests.needleforce.cli.residual_command_log import (
    AXIAL_N,
    SMALL_ARM,
    insertion,
    refusal,
    write_insertion,
    write_turned,
)
from urdf import load_urdf

pytestmark = pytest.mark.slow

TIP_M = (0.3, 0.3, 0.2)  # where both joints have a lever
ON_TIP = ["--tool-frame", "tip", "--tip-offset", *map(str, TIP_M), "--mode", "axial"]
TARE = ["--tare", "0:2.5"]
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


@pytest.fixture
def force(arm, tmp_path, capsys):
    """Run `force` on a log; return the last axial force, what it printed, and its
    warnings."""

    def run(log, *options):
        table = tmp_path / "forces.csv"
        argv = ["force", log, "--urdf", arm, *options, *ON_TIP, "-o", table]
        code = main([str(word) for word in argv])
        printed = capsys.readouterr()
        assert code == 0, printed.err
        return read_table(table).columns["axial_N"][-1], printed.out, printed.err

    return run


def test_joints_that_the_log_lacks_are_locked_at_once(arm, force, tmp_path, capsys):
    log = write_insertion(tmp_path / "log.npz", robot_of(arm))
    options = ["force", str(log), "--urdf", str(arm), *ON_TIP, *TARE]
    fixed = ["--lock", "ball_joint", "--accept-inertia"]

    assert "ball_joint" in refusal(options, capsys)
    assert "neck, shoulder, elbow, gripper" in refusal([*options, *fixed], capsys)

    axial_N, out, err = force(log, "--lock-others", *TARE)

    assert (axial_N, err) == (pytest.approx(AXIAL_N, abs=0.2), "")
    assert "arm, 2 joints" in out


def test_joints_that_the_log_names_are_kept_in_the_order_of_the_robot(
    arm, force, tmp_path
):
    log = tmp_path / "log.mcap"
    robot = robot_of(arm, keep_joints=["shoulder", "elbow", "gripper"])
    write_turned(log, insertion(robot), ("shoulder", "elbow", "gripper"))
    axial_N, out, _ = force(log, "--lock-others", *TARE)
    options = ["--lock-others", "--lock", "gripper=0.05", "--force-tare"]
    _, locked, err = force(log, *options, *TARE)

    assert axial_N == pytest.approx(AXIAL_N, abs=0.2)
    assert "arm, 3 joints" in out
    assert "arm, 2 joints" in locked
    assert err == ""


def test_without_a_log_the_joints_on_the_way_to_the_tool_are_kept(arm):
    options = RobotOptions(urdf=str(arm), lock_others=True, tool_frame="tip")

    assert robot_from_options(options, None).joint_names == ("shoulder", "elbow")


@pytest.mark.parametrize("mapping", ['joints = ["elbow"]', "joints = []"])
def test_a_joint_before_the_tool_that_the_log_lacks_is_named(
    arm, force, tmp_path, mapping
):
    log = write_insertion(tmp_path / "log.npz", robot_of(arm, keep_joints=["elbow"]))
    (tmp_path / "names.toml").write_text(mapping)
    options = ["--lock-others", "--mapping", tmp_path / "names.toml", "--no-tare"]
    _, out, err = force(log, *options)

    # The nearest to the tool where none is named.
    assert "arm, 1 joints" in out
    assert "are locked at 0: shoulder" in out
    assert "are locked at 0: shoulder" in err


def test_joints_of_other_names_or_too_many_are_refused(arm, tmp_path, capsys):
    columns = insertion(robot_of(arm))
    log = tmp_path / "log.npz"
    write_table(log, columns)
    (tmp_path / "names.toml").write_text('joints = ["j1", "j2"]')
    argv = ["force", str(log), "--urdf", str(arm), "--lock-others", *ON_TIP]
    named = ["--mapping", str(tmp_path / "names.toml")]

    assert "j1, j2" in refusal([*argv, *named], capsys)

    for name in ("q_rad", "dq_rad_s", "tau_Nm", "tau_ext_Nm"):
        columns[name] = columns[name][:, [0, 0, 1]]
    write_table(log, columns)

    assert "3 columns" in refusal(argv, capsys)


def test_inertia_is_accepted_with_a_warning_in_every_result(
    arm, force, tmp_path, capsys
):
    log = write_insertion(tmp_path / "log.npz", robot_of(arm))
    text = arm.read_text()
    upper = r'<inertial><origin xyz="0 0 0.2"/><mass value="2"/>.*?</inertial>'
    arm.write_text(re.sub(upper, "", text, flags=re.DOTALL))
    argv = [str(log), "--urdf", str(arm), "--lock-others", *ON_TIP]

    assert "joint shoulder" in refusal(["force", *argv, *TARE], capsys)

    options = ["--accept-inertia", "--force-tare", *TARE]
    _, out, err = force(log, "--lock-others", *options)
    folder = tmp_path / "page"

    assert main(["check", *argv, *options, "--json"]) == 1

    found = capsys.readouterr().out

    assert main(["report", argv[0], str(folder), *argv[1:], *options]) == 0
    for printed in (out, err, found, (folder / "index.html").read_text()):
        assert "accepted: behind joint shoulder" in printed


def test_gravity_is_that_of_the_mounting(arm, force, tmp_path):
    gravity = (0.0, -9.81, 0.0)
    log = write_insertion(tmp_path / "log.npz", robot_of(arm, gravity_m_s2=gravity))
    options = ["--gravity", *gravity, "--lock-others", *TARE]
    axial_N, out, _ = force(log, *options)

    assert axial_N == pytest.approx(AXIAL_N, abs=0.2)
    assert "gravity 0 -9.81 0 m/s^2 in base axes" in out


@pytest.mark.parametrize(
    ("content", "changes"),
    [
        ("rotor_inertia_kg_m2 = [2.0, 2.0, 2.0, 2.0, 2.0, 2.0, 2.0]\n", True),
        (
            "[viscous_coulomb]\nviscous_Nms = [9.0, 9.0, 9.0, 9.0, 9.0, 9.0, 9.0]\n"
            "coulomb_Nm = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n"
            "offset_Nm = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n",
            True,
        ),
        ("rotor_inertia_kg_m2 = [0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]\n", False),
    ],
)
def test_rotors_and_friction_of_a_file_count(lwr, tmp_path, capsys, content, changes):
    log = str(write_insertion(tmp_path / "log.npz", lwr, seconds=1.0))
    (tmp_path / "friction.toml").write_text(content)
    forces = []
    for options in ([], ["--friction", str(tmp_path / "friction.toml")]):
        table = str(tmp_path / "forces.npz")
        assert main(["force", log, "--no-tare", *options, "-o", table]) == 0
        forces.append(read_table(table).columns["axial_N"][-1])

    assert bool(abs(forces[1] - forces[0]) > 0.05) is changes
