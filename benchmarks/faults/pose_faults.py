"""Faults of pose and load: a joint at its limit, an arm stretched out, a weight, a push aside."""

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from benchmarks.faults.fault_stream import FaultStream
from groundtruth import ARM_LEVELS, Run
from groundtruth.plant_bodies import lwr_bodies

Array = NDArray[np.float64]
WRIST = 5
STOP_NM = 2.0
"""Torque with which the wrist is pressed against its end stop."""
WAY_S, STAY_S, TICK_S = 3.0, 1.0, 1e-3


def loaded(
    run: Run, stream: FaultStream, at: int, samples: int, force_in_base_N: Array
) -> FaultStream:
    """A force on the tool beside that of the tissue, for some samples."""
    bent = stream.bent(at, at + samples)
    data = run.robot.create_data()
    axes = pin.ReferenceFrame.LOCAL_WORLD_ALIGNED
    for k in range(at, at + samples):
        jacobian = pin.computeFrameJacobian(
            run.robot.model, data, bent.q_rad[k], run.robot.tool_frame_id, axes
        )
        bent.tau_Nm[k] -= jacobian[:3].T @ force_in_base_N
    return bent


def detour(run: Run, stream: FaultStream, target_rad: Array, stop_Nm: Array) -> FaultStream:
    """A motion in free air to a pose and back, before a stream that starts at rest in free air.

    The fault ends when the arm is back.

    Torques are those of the true arm, with the sensors' noise and the offset that they show where
    the motion begins.

    Args:
        run: Gives the arm.
        stream: What follows.
        target_rad: The pose, shape (n,).
        stop_Nm: Torque of an end stop on the joints there, shape (n,).
    """
    start = stream.q_rad[0]
    share, rate, change = _there_and_back()
    q = start + share[:, None] * (target_rad - start)
    dq, ddq = rate[:, None] * (target_rad - start), change[:, None] * (target_rad - start)
    mass_seed, _ = np.random.SeedSequence(run.seed).spawn(2)
    level = ARM_LEVELS[run.arm]
    model = lwr_bodies(run.tool, level, np.random.default_rng(mass_seed)).model()
    data = model.createData()
    ideal = np.array([pin.rnea(model, data, *row) for row in zip(q, dq, ddq, strict=True)])
    rest = pin.computeGeneralizedGravity(model, data, start)
    offset = stream.tau_Nm[:20].mean(axis=0) - rest
    rng = np.random.default_rng(0)
    pressed = share > 1.0 - 1e-9
    made = FaultStream(
        dt_s=np.full(len(q), TICK_S),
        q_rad=q + level.position_noise_std_rad * rng.normal(size=q.shape),
        dq_rad_s=dq + (level.velocity_noise_std_rad_s or 0.0) * rng.normal(size=q.shape),
        tau_Nm=ideal
        + offset
        - pressed[:, None] * stop_Nm
        + np.array(level.torque_noise_std_Nm) * rng.normal(size=q.shape),
        reference_N=np.zeros(len(q)),
        start=0,
        stop=len(q),
    )
    return made.then(stream)


def _there_and_back() -> tuple[Array, Array, Array]:
    """Share of the way, its rate and that one's rate: quintic out, a stay, quintic back."""
    s = np.arange(0.0, 1.0, TICK_S / WAY_S)
    way = s**3 * (10.0 + s * (6.0 * s - 15.0))
    rate = 30.0 * (s * (1.0 - s)) ** 2 / WAY_S
    change = 60.0 * s * (1.0 - s) * (1.0 - 2.0 * s) / WAY_S**2
    stay = round(STAY_S / TICK_S)
    still = np.zeros(stay)
    return (
        np.concatenate((way, np.ones(stay), way[::-1])),
        np.concatenate((rate, still, -rate[::-1])),
        np.concatenate((change, still, change[::-1])),
    )


def wrist_at_limit(run: Run, stream: FaultStream) -> FaultStream:
    """The wrist goes to its upper limit and is pressed against the stop."""
    target, stop = stream.q_rad[0].copy(), np.zeros(run.robot.nv)
    target[WRIST] = run.robot.position_upper_rad[WRIST]
    stop[WRIST] = -STOP_NM
    return detour(run, stream, target, stop)


def stretched(run: Run, stream: FaultStream) -> FaultStream:
    """The arm stretches out along the needle: no joint feels a force along it."""
    return detour(run, stream, np.full(run.robot.nv, 0.01), np.zeros(run.robot.nv))


def heavier(run: Run, stream: FaultStream, at: int) -> FaultStream:
    """A cable of 50 g comes to hang on the needle's mount for 2 s, after the tare."""
    return loaded(run, stream, at, 2000, 0.05 * run.robot.gravity_m_s2)


def pushed_aside(run: Run, stream: FaultStream, at: int) -> FaultStream:
    """Somebody pushes the needle aside with 1 N for 2 s."""
    return loaded(run, stream, at, 2000, np.array([1.0, 0.0, 0.0]))
