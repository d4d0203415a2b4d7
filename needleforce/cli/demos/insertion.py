"""`needleforce demo`: a simulated insertion through three gels, reported like a log."""

from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import pandas as pd

from groundtruth import Run, simulate
from needleforce import plots
from needleforce.cli.logs.forces import add_forces
from needleforce.cli.logs.layers import LayerReplay
from needleforce.cli.logs.replay import add_layers_of_forces
from needleforce.cli.logs.result import Result
from needleforce.cli.options import IdentificationOptions
from needleforce.cli.terminal import aligned, progress_bar, write_out
from needleforce.plots import palette
from needleforce.recordings import Log
from needleforce.session_replay import SensorReplay, TareWindow, replay_sensor
from residual import DEFAULT

if TYPE_CHECKING:
    from matplotlib.figure import Figure

SCENARIO = "stack-glove-constant"
"""What is inserted into: see `needleforce simulate --list`."""

NOT_MEDICAL = "Simulation only: not a medical device."

TRUTH = "Ground truth"

TRUTH_NOTE = (
    "What the simulation knows, and no method sees. In a stack frictions err by more "
    "than in the README, where single gels count, too: behind a rupture the next gel "
    "presses on the tip at once, and from the second layer on a friction is the "
    "difference of two forces."
)

CAPTION = (
    "Above, the force on the needle; below, its part at the tip, which falls where a "
    "layer ruptures. Black: the ground truth."
)

NEXT = {
    "  needleforce identify FILE.csv --png layers.png": "# your CSV of depth and force",
    "  needleforce report FILE.csv DIR": "# your arm's log: q, dq, tau",
    "  needleforce demo abdomen --report DIR": "# a plan on a CT (extra patient)",
    "  python examples/teleoperation.py": "# a hand feels the tip through the robot",
    "  needleforce doctor": "# what is installed here",
}
"""Commands to try next, and what each is for."""


def run(folder: Path, seed: int) -> int:
    """Simulate an insertion, and report it beside the truth.

    Args:
        folder: Folder of the page.
        seed: Seed of everything that is drawn at random.

    Returns:
        The exit code.
    """
    with plots.whole_folder(folder) as draft:
        result = demonstrate(seed)
        write_out(f"{result.text()}{NOT_MEDICAL}\n")
        if draft is not None:
            result.write_page(draft)
    write_out(f"\npage: {folder / plots.PAGE}\n\nnext:\n{aligned(NEXT.items())}")
    return 0


def demonstrate(seed: int) -> Result:
    """Return what is found in the joint signals of a simulated arm, and the truth.

    Args:
        seed: Seed of everything that is drawn at random.
    """
    with progress_bar("simulating arm, needle and gels") as progress:
        # The errors of this plant model are those measured on the real arm.
        insertion = simulate(SCENARIO, "fri", seed, progress)
    signals = insertion.signals
    # Like the real arm it sends no velocities.
    channels = {"q_rad": signals.q_rad, "tau_Nm": signals.tau_Nm}
    log = Log(t_s=signals.t_s, channels=channels)
    window = TareWindow(0.0, insertion.tare_end_s)
    with progress_bar("estimating from joint signals") as progress:
        replay = replay_sensor(
            log, insertion.robot, DEFAULT, window=window, progress=progress
        )
    result = Result(log="a simulated insertion", title="Forces and layers")
    layers = add_layers_of_forces(result, replay, IdentificationOptions())
    add_forces(result, replay)
    _add_truth(result, insertion, replay)
    draw = partial(_draw_truth, insertion, replay, layers)
    result.figures = {"truth": draw, **result.figures}
    result.notes["truth"] = CAPTION
    return result


def _add_truth(result: Result, insertion: Run, replay: SensorReplay) -> None:
    """Add what the simulation knows of the layers, and how far the force is off."""
    truth = insertion.truth
    layers = insertion.scenario.layers
    rows = [
        {
            "layer": f"{true.layer} {layers[true.layer - 1].name}",
            "to mm": f"{1e3 * true.onset_m:.1f}",
            "rupture s": f"{true.onset_s:.2f}",
            "K N/m": f"{layers[true.layer - 1].stiffness_N_per_m:.0f}",
            "friction N": f"{true.layer_friction_N:.3f}",
        }
        for true in truth.ruptures
        if true.layer > 0
    ]
    is_in_tissue = (truth.t_s >= truth.contact_s) & (truth.t_s <= truth.withdrawn_s)
    error_N = (replay.rows["axial_N"].to_numpy() - truth.axial_N)[is_in_tissue]
    rms_N = float(np.sqrt(np.nanmean(error_N**2)))
    result.sentences.append(
        f"Force on the needle within {rms_N:.2f} N rms of the truth, in the tissue."
        f" Simulated LWR 4+, plant model {insertion.plant}, seed {insertion.seed}: "
        f"{insertion.scenario.title}."
    )
    result.tables[TRUTH] = pd.DataFrame(rows)
    result.notes[TRUTH] = TRUTH_NOTE


def _draw_truth(
    insertion: Run, replay: SensorReplay, layers: LayerReplay, width_in: float
) -> "Figure":
    """Return the forces on the needle and at its tip over its depth, with the truth."""
    truth = insertion.truth
    figure, panels = plots.make_panels(2, width_in, 4.6, insertion.scenario.title)
    is_inserted = truth.t_s <= insertion.scenario.motion.insertion_end_s
    rows = np.flatnonzero(is_inserted & (truth.t_s >= truth.contact_s))[::20]
    depth_mm = 1e3 * truth.depth_m[rows]
    forces = {
        "force on the needle [N]": (truth.axial_N, replay.rows["axial_N"]),
        "force at the tip [N]": (truth.tip_N, layers.rows["tip_force_N"]),
    }
    for axes, (label, (true_N, ours_N)) in zip(panels, forces.items(), strict=True):
        estimated_N = ours_N.to_numpy()[rows]
        plots.draw_line(
            axes, depth_mm, estimated_N, color=palette.BLUE, label="needleforce"
        )
        plots.draw_line(
            axes, depth_mm, true_N[rows], color=palette.BLACK, lw=0.9, label=TRUTH
        )
        axes.set(ylabel=label)
    panels[1].set(xlabel="depth of the tip below the surface [mm]")
    plots.add_legend(figure)
    return figure
