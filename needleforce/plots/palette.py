"""Colours and the words on axes, in one place.

The hues are those of Okabe and Ito, which colour-blind eyes can separate; lines differ
in their dashes as well, for print.
"""

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
TARE = "#d5efd9"
