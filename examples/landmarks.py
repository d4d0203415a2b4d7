"""Register the patient by landmarks
==================================

Touch points that the CT shows. The registration says how far off it is at the target,
which lies deeper than all of them.
"""

import matplotlib.pyplot as plt
import numpy as np
from scipy.spatial.transform import Rotation

from needleforce.anatomy import fit_landmarks

TOUCH_STD_m = 1e-3
rng = np.random.default_rng(0)

# Points on the skin in the CT, and the same as the robot's pointer touches them.
skin_m = np.array(
    [[0.0, 0.0, 0.0], [0.12, 0.0, 0.01], [0.12, 0.0, 0.1], [0.0, 0.0, 0.1]]
)
target_m = np.array([0.06, 0.11, 0.05])
true_rotation = Rotation.from_euler("xyz", [10.0, -5.0, 80.0], degrees=True)
true_shift_m = np.array([0.5, 0.1, 0.2])
touched_m = true_rotation.apply(skin_m) + true_shift_m
touched_m = touched_m + rng.normal(0.0, TOUCH_STD_m, touched_m.shape)

registration = fit_landmarks(skin_m, touched_m, std_m=TOUCH_STD_m, is_std_known=True)
true_target_m = true_rotation.apply(target_m) + true_shift_m
error_m = np.linalg.norm(registration.to_robot(target_m) - true_target_m)
expected_m = registration.tre_m(target_m)
print(f"at the target: expected {1e3 * expected_m:.1f} mm, is {1e3 * error_m:.1f} mm")

depths_m = np.linspace(0.0, 0.15, 50)
centre_m = skin_m.mean(axis=0)
below_m = centre_m + np.outer(depths_m, [0.0, 1.0, 0.0])
expected_mm = [1e3 * registration.tre_m(point_m) for point_m in below_m]
plt.plot(1e3 * depths_m, expected_mm, label="expected error, rms")
plt.plot(1e3 * target_m[1], 1e3 * error_m, "o", label="error at the target")
plt.axhline(1e3 * TOUCH_STD_m, color="gray", linestyle="dotted", label="of a touch")
plt.xlabel("depth below the landmarks [mm]")
plt.ylabel("error [mm]")
plt.ylim(bottom=0.0)
plt.legend()
plt.show()
