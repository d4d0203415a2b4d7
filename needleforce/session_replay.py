"""A session over a recording, tared as it goes.

log = read_log("insertion.csv", required=["q", "tau"], joints=robot.joint_names)
for q_rad, estimate in replay_session(InsertionSession(robot), log):
print(estimate.time_s, estimate.identification.tip_force_N)
"""

from collections.abc import Iterator
from itertools import repeat

import numpy as np

from foundation.arrays import Array
from needleforce.recordings import Log
from needleforce.session import InsertionSession, SessionEstimate
from needleforce.tare_run import AutoTare


def replay_session(
    session: InsertionSession,
    log: Log,
    tare: AutoTare | None = None,
) -> Iterator[tuple[Array, SessionEstimate]]:
    """Run a session over a recording of joint signals, sample by sample.

    The first sample has the time step of the second. Yields joint positions, shape
    (n,), and what the session estimates.

    Args:
        session: A session that has seen nothing.
        log: The recording, with the channels ``q``, ``tau`` and perhaps ``dq``.
        tare: When it is tared; None for after 4 s of motion without contact.
    """
    if tare is None:
        tare = AutoTare(4.0, at_once=True)
    velocities = log["dq_rad_s"] if "dq_rad_s" in log else repeat(None)
    steps_s = np.diff(log.t_s, prepend=2.0 * log.t_s[0] - log.t_s[1]).tolist()
    signals = zip(log["q_rad"], velocities, log["tau_Nm"], steps_s, strict=False)
    for q_rad, dq_rad_s, tau_Nm, step_s in signals:
        estimate = session.update(q_rad, dq_rad_s, tau_Nm, step_s)
        tare.after(session, estimate)
        yield q_rad, estimate
