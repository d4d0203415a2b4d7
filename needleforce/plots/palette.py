"""Colours, line styles and the words on axes, in one place.

The hues are those of Okabe and Ito, which colour-blind eyes can separate; every role
has a line style of its own as well, for print. Where curves coincide, broad pale lines
are drawn below and thin dashed or dotted ones above, so that all are seen.
"""

from dataclasses import replace

from needleforce.plots.chart import Dash, LineStyle

TIME = "time [s]"
INSERTION_TIME = "time since the insertion began [s]"
DEPTH = "depth since first contact [mm]"
FORCE = "axial force [N]"
FORCE_ERROR = "error [N]"
STIFFNESS = "stiffness K\n[N/m]"
FRICTION = "friction B\n[Ns/m²]"
CUMULATIVE_FRICTION = "cumulative\nfriction [Ns/m]"

BLACK = "#000000"
GREY = "#7f7f7f"
GREEN = "#009e73"
ORANGE = "#e69f00"
BLUE = "#0072b2"
VERMILION = "#d55e00"
PURPLE = "#a3468a"

DOTTED: Dash = (0.0, (1.0, 1.6))
DASHED: Dash = (0.0, (5.0, 2.0))
DASH_DOTTED: Dash = (0.0, (6.0, 2.0, 1.2, 2.0))

TRUE = LineStyle(color=BLACK, width_pt=0.9)
"""What the ground truth says."""

TRUE_PART = LineStyle(color=BLACK, dash=DOTTED, width_pt=1.5)
"""A part of the true force, or a true parameter, drawn over others."""

READING = LineStyle(color=GREEN, width_pt=2.6, opacity=0.45)
"""The force that an identifier is given, drawn below the others."""

OTHER_SENSOR = LineStyle(color=GREY, width_pt=4.0, opacity=0.4)
"""The force of another sensor for comparison, drawn below the others."""

OTHER_DASHED = LineStyle(color="#555555", dash=DASHED, width_pt=0.9)
PREDICTED = LineStyle(color=ORANGE, dash=DASHED, width_pt=1.0)
OURS = LineStyle(color=BLUE, width_pt=1.4)

PUBLISHED = LineStyle(color=VERMILION, dash=DASHED, width_pt=1.2)
"""The published method with its multi-layer model."""

PUBLISHED_KV = LineStyle(color=PURPLE, dash=DASH_DOTTED, width_pt=1.1)
"""The published method with the model of Kelvin and Voigt."""

TIP = LineStyle(color=PURPLE, dash=DASH_DOTTED, width_pt=1.0)
UNTARED = LineStyle(color=GREY, width_pt=1.0)

COMPONENTS = (
    replace(UNTARED, color=VERMILION),
    replace(UNTARED, color=GREEN, dash=DASHED),
    replace(UNTARED, color=PURPLE, dash=DASH_DOTTED),
)
"""The components of a vector along x, y, z."""

RUPTURE = LineStyle(color=BLACK, marker="|", width_pt=1.6, size_pt=13.0)
HARD_CONTACT = replace(RUPTURE, color=VERMILION)
COMPENSATION = replace(RUPTURE, marker="o", width_pt=0.5, size_pt=3.0)
REJECTED = LineStyle(color="#c0392b", marker="|", width_pt=1.0, size_pt=7.0)

TRUE_RUPTURE = "#d2d2d2"
"""Colour of the time in which a layer ruptures, in the ground truth."""

TARE = "#d5efd9"
INITIALIZING = "#e4e4e4"
