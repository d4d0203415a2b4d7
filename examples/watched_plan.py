"""An insertion in the browser page beside its loop: a plan names the layers, a
rupture moves it."""

from groundtruth import simulate
from needleforce import InsertionSession
from needleforce.anatomy import Layer, PlanMatch
from needleforce.scene import PlanScene, open_viewer

PLAN = [  # as a CT might have it: 2 mm too thin
    Layer("gel", 0.0, 26e-3, 0.5e-3, 0.5e-3, is_obstacle=False),
    Layer("behind", 26e-3, 80e-3, 0.5e-3, 0.5e-3, is_obstacle=False),
]


def watch(arm):
    session = InsertionSession(arm.robot)
    sent = arm.signals
    last_s = arm.signals.t_s[0]
    with open_viewer(arm.robot, PlanScene(layers=PLAN)) as view:
        print(f"the scene is at {view.url}")
        for t_s, q, dq, tau in zip(
            sent.t_s, sent.q_rad, sent.dq_rad_s, sent.tau_Nm, strict=True
        ):
            now = session.update(q, dq, tau, t_s - last_s)
            last_s = t_s
            view.put(now, q)
            if not session.tared and t_s > arm.tare_end_s:
                session.tare()
                # A registration gives the entry; here the gel's surface is 5 mm ahead.
                tip_m, axis = session.snapshot().zero
                session.follow(PlanMatch(PLAN, offset_std_m=3e-3), tip_m + 5e-3 * axis)
            if now.identification.rupture is not None:
                plan = now.plan
                rupture = now.identification.rupture
                print(
                    f"rupture at {1e3 * rupture.depth_m:.1f} mm, into "
                    f"{plan.matched_name}"
                )
    mm = 1e3 * plan.offset_m, 1e3 * plan.offset_std_m
    print(f"everything lies {mm[0]:+.1f} ± {mm[1]:.1f} mm deeper than planned")


if __name__ == "__main__":
    watch(simulate("gel-25-constant", "clean"))
