"""A hand drives the needle and feels the force at its tip."""

import numpy as np

from groundtruth.rig_arm import SimulatedArm
from needleforce.cli.demos.hand_driven import (
    STANDOFF_M,
    HandPlan,
    Teleinsertion,
    ruptures_felt,
    teleoperate,
)
from needleforce.cli.demos.result_page import DemoResult
from needleforce.cli.terminal import Progress
from needleforce.plots import (
    Chart,
    Curve,
    LineStyle,
    Panel,
    Shading,
    palette,
)


def teleoperate_needle(progress: Progress) -> DemoResult:
    """A hand drives the needle through three gels and feels the force at its tip."""
    arm = SimulatedArm("stack-glove-constant", "clean", 1, standoff_m=STANDOFF_M)
    hand = HandPlan(needle_speed_m_s=4e-3, needle_travel_m=108e-3, scale=0.4)
    made = teleoperate(arm, hand, seed=1, delay_s=0.01, progress=progress)
    felt = ruptures_felt(made)
    rows = {}
    for k, item in enumerate(felt, 1):
        text = f"{100 * item.shown_drop:.0f} %, {100 * item.raw_drop:.0f} %"
        rows[f"rupture {k}: contrast with, without compensation"] = text
    rows["alarms for ruptures"] = f"{len(made.alarms_s)} for {len(felt)}"
    rows["least energy at the hand's port"] = f"{1e3 * made.least_energy_J:.3f} mJ"
    rows["drift between hand and needle"] = f"{1e3 * abs(made.drift_m):.2f} mm"
    title = "Teleoperation, 10 ms of delay each way"
    return DemoResult(title, tuple(rows.items()), _charts(made))


def _charts(made: Teleinsertion) -> tuple[tuple[str, Chart, str], ...]:
    t_s = made.rows("t_s")
    step = 20
    depth_mm = 1e3 * (made.rows("depth_m") - made.depth_m[0])

    def curve(name: str, label: str, style: LineStyle, scale: float = 1.0) -> Curve:
        smooth = np.convolve(made.rows(name), np.full(step, 1.0 / step), "same")[::step]
        return Curve(style=style, x=t_s[::step], y=scale * smooth, label=label)

    ends = tuple((item.onset_s, item.end_s) for item in made.ruptures if item.layer)
    turns = np.flatnonzero(np.diff(made.rows("is_open"), prepend=False, append=False))
    back = tuple((float(t_s[k]), float(t_s[n - 1])) for k, n in turns.reshape(-1, 2))
    marks = (
        Shading("a layer ruptures", palette.TRUE_RUPTURE, ends, 1.5),
        Shading("clutch open: the hand goes back", palette.TARE, back),
    )
    forces = (
        curve("raw_N", "without compensation: force at the base", palette.READING),
        curve("shown_N", "with compensation: shown to the hand", palette.OURS),
        curve("tip_N", "true force at the tip", palette.TRUE_PART),
    )
    contrast = Chart(
        title="What the surgeon feels\nneedle driven by a hand, three gels, 10 ms delay",
        x_label=palette.TIME,
        panels=(Panel(y_label="force [N]", curves=forces),),
        shadings=marks,
    )
    motion = Curve(
        style=palette.OURS, x=t_s[::step], y=depth_mm[::step], label="needle"
    )
    energy = Chart(
        title="Energy that the hand has put in, and depth\nnever below zero: passive",
        x_label=palette.TIME,
        panels=(
            Panel(
                y_label="energy [mJ]",
                curves=(curve("energy_J", "", palette.OURS, 1e3),),
            ),
            Panel(y_label="travel [mm]", curves=(motion,)),
        ),
        shadings=marks,
    )
    return (
        (
            "contrast",
            contrast,
            "Force before and after each rupture, with friction and without.",
        ),
        ("energy", energy, "Energy through the hand's port and travel of the needle."),
    )
