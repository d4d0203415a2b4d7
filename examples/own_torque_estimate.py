"""A robot that estimates external torque itself: tare, wrench and layers from that
torque."""

import numpy as np

from groundtruth import simulate
from needleforce import InsertionSession

arm = simulate("gel-25-constant", "ideal")
rng = np.random.default_rng(0)
# What such a robot sends: the external torque, with an offset and some noise.
estimates = (
    arm.truth.external_torque_Nm
    + 0.2
    + 0.02 * rng.standard_normal((len(arm.truth.t_s), 7))
)

session = InsertionSession(arm.robot)
forces = []
for t_s, q, external_torque in zip(
    arm.signals.t_s, arm.signals.q_rad, estimates, strict=True
):
    now = session.update_external_torque(
        q, None, external_torque, 1e-3
    )  # None: no velocities
    if not session.tared and t_s > arm.tare_end_s:
        session.tare()
    forces.append(now.wrench.axial)
    if now.identification.identified_layer is not None:
        break  # the gel is known

(layer,) = session.layers
print(f"at most {max(forces):.2f} N; the gel is {1e3 * layer.thickness_m:.1f} mm thick")
