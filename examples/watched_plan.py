"""An insertion in the browser page: a plan names the layers, a rupture moves it."""

from groundtruth import simulate
from needleforce import InsertionSession
from needleforce.anatomy import Layer, PlanMatch
from needleforce.scene import PlanScene, open_viewer

# As a CT might have it: 2 mm too thin.
PLAN = [
    Layer("gel", 0.0, 26e-3, 0.5e-3, 0.5e-3, is_obstacle=False),
    Layer("behind", 26e-3, 80e-3, 0.5e-3, 0.5e-3, is_obstacle=False),
]
PLAN_STD_m = 3e-3  # error of the registration along the needle
STANDOFF_m = 5e-3  # from the tip to the gel's surface at the tare


def follow_plan(session):
    """Let a tared session follow the plan.

    A registration gives the entry point; here it is known to lie ahead of the tip.
    """
    tip_m, axis = session.zero
    entry_m = tip_m + STANDOFF_m * axis
    session.follow(PlanMatch(PLAN, offset_std_m=PLAN_STD_m), entry_m)


def watch(arm):
    """Run an insertion beside the page, and print what the plan learns from it."""
    session = InsertionSession(arm.robot)
    signals = arm.signals
    previous_s = signals.t_s[0]
    with open_viewer(arm.robot, PlanScene(layers=PLAN)) as view:
        print(f"the scene is at {view.url}")
        for t_s, q, dq, tau in zip(
            signals.t_s, signals.q_rad, signals.dq_rad_s, signals.tau_Nm, strict=True
        ):
            estimate = session.update(q, dq, tau, t_s - previous_s)
            previous_s = t_s
            view.put(estimate, q)

            if not session.tared and t_s > arm.tare_end_s:
                session.tare()
                follow_plan(session)

            rupture = estimate.identification.rupture
            if rupture is not None:
                plan = estimate.plan
                depth_mm = 1e3 * rupture.depth_m
                print(f"rupture at {depth_mm:.1f} mm, into {plan.matched_name}")

    offset_mm = 1e3 * plan.offset_m
    std_mm = 1e3 * plan.offset_std_m
    print(f"everything lies {offset_mm:+.1f} ± {std_mm:.1f} mm deeper than planned")


if __name__ == "__main__":
    watch(simulate("gel-25-constant", "clean"))
