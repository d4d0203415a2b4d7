"""The simulated arm as a MuJoCo model: truth and estimator share no dynamics code.

Bodies: one per joint; ``sensor``, rigid on the flange; ``needle``, all that lies beyond the F/T
sensor's measuring plane; and the massless ``tip``, so that a force on it acts at the needle's tip.
No geometry, contacts, joint limits, damping, armature or friction: the torque of a joint is the
link-side torque its sensor reads.
"""

from collections.abc import Iterable

import numpy as np
import pinocchio as pin

from groundtruth.plant_bodies import PlantBodies

_HEAD = """<mujoco model="needleforce_arm">
<compiler angle="radian" autolimits="false" inertiagrouprange="0 0"/>
<option timestep="{step}" integrator="RK4" gravity="{gravity}">
  <flag constraint="disable" contact="disable"/>
</option>
<worldbody>
"""

_TAIL = """</worldbody>
<sensor>
  <force name="ft_force" site="ft_sensor"/>
  <torque name="ft_torque" site="ft_sensor"/>
</sensor>
</mujoco>
"""


def arm_mjcf(bodies: PlantBodies, substep_s: float) -> str:
    """Write the MJCF of arm, sensor and needle.

    The force and torque sensors sit at the ``ft_sensor`` frame and report, in its axes, what the
    arm exerts on the needle body: everything beyond the measuring plane.

    Args:
        bodies: The true arm.
        substep_s: Physics time step.

    Returns:
        MJCF text.
    """
    robot = bodies.robot
    parts = [_HEAD.format(step=repr(substep_s), gravity=_numbers(robot.gravity_m_s2))]
    for joint, (name, link) in enumerate(zip(robot.joint_names, bodies.links, strict=True), 1):
        placement = robot.model.jointPlacements[joint]
        parts.append(f'<body name="link_{joint}" {_pose(placement)}>\n{_inertial(link)}\n')
        parts.append(f'<joint name="{name}" axis="{_numbers(_joint_axis(robot.model, joint))}"/>\n')
    flange = robot.model.frames[robot.frame_id(robot.flange_frame)].placement
    sensor = robot.model.frames[robot.frame_id("ft_sensor")].placement
    tip = robot.model.frames[robot.frame_id("needle_tip")].placement
    parts.append(f'<body name="sensor" {_pose(flange)}>\n{_inertial(bodies.sensor)}\n</body>\n')
    parts.append(f'<body name="needle" {_pose(sensor)}>\n{_inertial(bodies.needle)}\n')
    parts.append('<site name="ft_sensor"/>\n')
    parts.append(f'<body name="tip" {_pose(sensor.actInv(tip))}><site name="tip"/></body>\n</body>')
    parts.append("</body>\n" * len(bodies.links))
    return "".join(parts) + _TAIL


def _joint_axis(model: pin.Model, joint: int) -> np.ndarray:
    """Axis of a revolute joint in its own frame."""
    data = model.createData()
    pin.computeJointJacobians(model, data, pin.neutral(model))
    local = pin.getJointJacobian(model, data, joint, pin.ReferenceFrame.LOCAL)
    return local[3:, model.joints[joint].idx_v]


def _pose(placement: pin.SE3) -> str:
    x, y, z, w = pin.Quaternion(placement.rotation).coeffs()
    return f'pos="{_numbers(placement.translation)}" quat="{_numbers((w, x, y, z))}"'


def _inertial(body: pin.Inertia) -> str:
    about_com = body.inertia
    rows, columns = (0, 1, 2, 0, 0, 1), (0, 1, 2, 1, 2, 2)
    return (
        f'<inertial mass="{body.mass!r}" pos="{_numbers(body.lever)}" '
        f'fullinertia="{_numbers(about_com[rows, columns])}"/>'
    )


def _numbers(values: Iterable[float]) -> str:
    return " ".join(repr(float(value)) for value in values)
