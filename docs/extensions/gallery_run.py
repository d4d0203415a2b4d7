"""How the scripts of the gallery run: in which order, and with which style."""

import gc
from functools import cache
from pathlib import Path
from typing import Any

import matplotlib.pyplot as plt
from cycler import cycler
from sphinx_gallery.sorting import ExplicitOrder

import groundtruth
from needleforce.plots import STYLE, palette

COLOURS = (palette.BLUE, palette.VERMILION, palette.GREEN, palette.PURPLE)
SIZE_inch = (5.4, 3.2)  # text is legible on a telephone too

SCRIPTS = (
    "controller_loop",
    "csv_to_layers",
    "virtual_sensor",
    "known_push",
    "tare",
    "observer_gain",
    "noise_spectrum",
    "estimated_velocity",
    "own_torque_estimate",
    "own_urdf",
    "payload_from_log",
    "rupture_alarms",
    "published_method",
    "stop_and_resume",
    "virtual_fixture",
    "hand_guidance",
    "remote_centre",
    "teleoperation",
    "autonomous_insertion",
    "landmarks",
    "watched_plan",
    "any_arm",
)
"""The scripts in examples/, in the order of the gallery."""

ORDER = ExplicitOrder([f"{name}.py" for name in SCRIPTS])

groundtruth.simulate = cache(groundtruth.simulate)  # equal arguments give equal runs


def prepare(gallery_conf: dict[str, Any], script: str | Path) -> None:
    """Draw the pictures of a script in the style of our charts."""
    # The objects of the build stay: the collector need not look at them in each script.
    gc.freeze()
    plt.style.use(["default", STYLE])
    plt.rcParams["figure.figsize"] = SIZE_inch
    plt.rcParams["text.parse_math"] = True  # 10⁻² on logarithmic axes
    plt.rcParams["axes.prop_cycle"] = cycler(color=COLOURS)
    plt.rcParams["figure.constrained_layout.use"] = True
