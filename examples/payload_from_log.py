"""What hangs on the flange, from a log at rest
=============================================

Hold the arm still in some poses: mass and centre of mass of the payload follow from
the joint torques.
"""

import matplotlib.pyplot as plt
import numpy as np
import pinocchio as pin

from urdf import NeedleTool, identify_payload_static, load_lwr

POSES = 20
NOISE_Nm = 0.02
rng = np.random.default_rng(0)

# A log stands in for yours: joint angles and mean torques of each pose.
loaded = load_lwr(payload=NeedleTool())
data = loaded.create_data()
q_rad = rng.uniform(-1.5, 1.5, (POSES, loaded.nv))
gravity_Nm = [pin.computeGeneralizedGravity(loaded.model, data, q) for q in q_rad]
tau_Nm = np.array(gravity_Nm) + rng.normal(0.0, NOISE_Nm, (POSES, loaded.nv))

bare = load_lwr()
masses_kg = []
stds_kg = []
counts = range(2, POSES + 1)
for count in counts:
    estimate = identify_payload_static(bare, q_rad[:count], tau_Nm[:count])
    masses_kg.append(estimate.payload.mass_kg)
    stds_kg.append(estimate.mass_std_kg)

plt.errorbar(counts, masses_kg, stds_kg, fmt="o", label="identified, ± 1 σ")
plt.axhline(0.304, color="gray", linestyle="dotted", label="true")
plt.xlabel("number of poses")
plt.ylabel("mass of the payload [kg]")
plt.legend()
plt.show()

print(f"{1e3 * masses_kg[-1]:.0f} ± {1e3 * stds_kg[-1]:.0f} g")
