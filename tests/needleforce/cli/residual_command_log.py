"""A short synthetic insertion for tests of the commands: what is in the log is
known."""

import re

import numpy as np

from needleforce.cli import main
from needleforce.recordings import TableLabels, write_table
from tests.residual.residual_signals import external_torque_of, pose_of, swing

CONTACT_S = 2.8
AXIAL_N = 1.5
OFFSET_NM = np.array([0.3, -0.2, 0.1, 0.3, -0.1, 0.05, 0.02])


def insertion(robot, *, seconds=4.0, contact_s=CONTACT_S, axial_N=AXIAL_N, start_s=0.0):
    """Columns of a log: smooth motion, sensor offsets, and a tip force from
    ``contact_s`` on."""
    t_s, q, dq, tau = swing(robot, seconds=seconds, amplitude=0.05)
    external = np.zeros_like(tau)
    for k in np.flatnonzero(t_s >= contact_s):
        needle = pose_of(robot, q[k]).rotation[:, 2]
        external[k] = external_torque_of(robot, q[k], -axial_N * needle)
    noise = 0.01 * np.random.default_rng(4).normal(size=tau.shape)
    offset = OFFSET_NM[: robot.nv]
    return {
        "t_s": start_s + t_s,
        "q_rad": q,
        "dq_rad_s": dq,
        "tau_Nm": tau - external + offset + noise,
        "tau_ext_Nm": external - offset + noise,
    }


def write_insertion(path, robot, *, only=None, **changes):
    """Write it, or only some of its columns."""
    columns = insertion(robot, **changes)
    write_table(path, {name: columns[name] for name in only or columns})
    return path


def write_turned(path, columns, joint_names):
    """Write a bag whose joints stand in the opposite order, with their names."""
    turned = {
        name: values[:, ::-1] if values.ndim == 2 else values
        for name, values in columns.items()
        if name != "tau_ext_Nm"
    }
    write_table(path, turned, labels=TableLabels(joint_names=joint_names[::-1]))


def refusal(argv, capsys):
    """Run a command that refuses; return its one line of complaint, warnings and the
    news of the compiler aside."""
    assert main(argv) == 2
    printed = capsys.readouterr()
    assert printed.out == ""
    lines = [
        line
        for line in printed.err.splitlines()
        if not line.startswith(("warning: ", "needleforce: compiling"))
    ]
    assert len(lines) == 1, printed.err
    assert re.match(r"error: \S", lines[0])
    return lines[0]


SMALL_ARM = """<robot name="arm">
  <link name="base"/>
  <link name="upper"><inertial><origin xyz="0 0 0.2"/><mass value="2"/>
    <inertia ixx="0.02" ixy="0" ixz="0" iyy="0.02" iyz="0" izz="0.01"/>
  </inertial></link>
  <link name="tip"><inertial><origin xyz="0 0 0.2"/><mass value="1"/>
    <inertia ixx="0.01" ixy="0" ixz="0" iyy="0.01" iyz="0" izz="0.01"/>
  </inertial></link>
  <link name="finger"><inertial><origin xyz="0 0 0"/><mass value="0.1"/>
    <inertia ixx="1e-4" ixy="0" ixz="0" iyy="1e-4" iyz="0" izz="1e-4"/>
  </inertial></link>
  <joint name="shoulder" type="revolute"><parent link="base"/><child link="upper"/>
    <axis xyz="0 1 0"/><limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
  <joint name="elbow" type="revolute"><origin xyz="0 0 0.4"/><parent link="upper"/>
    <child link="tip"/><axis xyz="1 0 0"/>
    <limit lower="-3" upper="3" effort="50" velocity="2"/></joint>
  <joint name="gripper" type="prismatic"><parent link="tip"/><child link="finger"/>
    <axis xyz="1 0 0"/><limit lower="0" upper="0.1" effort="5" velocity="1"/></joint>
</robot>
"""
"""Two joints and a gripper that is not in the log."""
