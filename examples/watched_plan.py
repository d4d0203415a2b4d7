"""Watch a plan while the needle advances
=======================================

A plan names the layers; each rupture corrects it. The browser page shows both.
"""

import matplotlib.pyplot as plt
import numpy as np

from groundtruth import simulate
from needleforce import InsertionSession, PlannedPath
from needleforce.anatomy import Layer, PlanMatch
from needleforce.scene import PlanScene, open_viewer

STANDOFF_m = 5e-3  # from the tip to the gel's surface at the tare
PLAN = [  # as a CT might have it: the gel 2 mm too thin
    Layer("gel", 0.0, 26e-3, 0.5e-3, 0.5e-3, is_obstacle=False),
    Layer("behind", 26e-3, 80e-3, 0.5e-3, 0.5e-3, is_obstacle=False),
]

if __name__ == "__main__":  # the page is a process of its own
    arm = simulate("gel-25-constant", "clean")
    signals = arm.signals
    session = InsertionSession(arm.robot)
    rows = []
    with open_viewer(arm.robot, PlanScene(layers=PLAN)) as view:
        print(f"the scene is at {view.url}")
        for t_s, q, dq, tau in zip(
            signals.t_s, signals.q_rad, signals.dq_rad_s, signals.tau_Nm, strict=True
        ):
            estimate = session.update(q, dq, tau, 1e-3)
            view.put(estimate, q)
            if not session.tared and t_s > arm.tare_end_s:
                session.tare()
                tip_m, axis = session.zero
                match = PlanMatch(PLAN, offset_std_m=3e-3)  # registered within 3 mm
                entry_m = tip_m + STANDOFF_m * axis
                path = PlannedPath.of_std(entry_m, entry_m + 0.05 * axis, std_m=3e-3)
                session.follow(match, path=path)
            plan = estimate.plan
            if plan is not None:
                rows.append((t_s, 1e3 * plan.offset_m, 1e3 * plan.offset_std_m))
            if estimate.identification.identified_layer is not None:
                break
    times_s, offset_mm, std_mm = np.array(rows).T
    plt.plot(times_s, offset_mm)
    plt.fill_between(times_s, offset_mm - std_mm, offset_mm + std_mm, alpha=0.3)
    plt.xlabel("time [s]; the gel ruptures at 27.7 s")
    plt.ylabel("deeper than planned by [mm], ± σ")
    plt.show()
    print(f"deeper than planned by {offset_mm[-1]:+.1f} ± {std_mm[-1]:.1f} mm")
