"""The force of one hypothesis: linear in twenty unknowns, given a history of ruptures.

Given such a history the axial force is

    f = o + C w + V v + R r(z) + L l(z) + U u(z) + T t(z) + K x + H x² + c y w + b y v +
    d + e

with o the offset; C, V Coulomb and viscous friction of the layers traversed; R the tip
force being released, L the part of it by which its release is longer than assumed, U
the part that stays and fades later, T the force held or needed to cut, K, H stiffness
and its growth; c, b friction per length of shaft in the layer; d disturbances: coloured
sensor noise, heartbeat, breathing, error of this model. Known are the presliding
deflection w (1 when sliding inwards), the speed v, the travel x of the tip and the
length y of shaft in the layer; e is white.

So each hypothesis is a Kalman filter (switching linear model, Shumway and Stoffer
1991), and how well it predicts the force is the evidence for it. Lengths are in mm,
speeds in mm/s, forces in N.
"""

from dataclasses import dataclass

import numpy as np

from foundation.arrays import Vector
from foundation.jit import compiled
from identification.multilayer.block import Block

OFFSET = 0
"""o: force in free air [N]."""

TRAVERSED_COULOMB = 1
"""C: Coulomb friction of the layers traversed [N]."""

TRAVERSED_VISCOUS = 2
"""V: viscous friction of the layers traversed [N/(mm/s)]."""

RELEASED = 3
"""R: tip force that the last rupture releases [N]."""

RELEASE_STRETCH = 4
"""L: R times the relative error of the release's length [N]."""

HELD = 5
"""T: force that the tip holds after a partial rupture, or needs to cut [N]."""

STIFFNESS = 6
"""K: growth of the tip force with travel [N/mm]."""

STIFFENING = 7
"""H: growth of that stiffness [N/mm²]."""

FADING = 8
"""U: tip force that outlasts the release and then fades [N]."""

LAYER_COULOMB = 9
"""c: Coulomb friction per length of shaft in the layer [N/mm]."""

LAYER_VISCOUS = 10
"""b: viscous friction per length of shaft in the layer [N/(mm mm/s)]."""

FRICTION_LAST = 11
"""Friction of the layer that the last rupture ended, of the shaft since the rupture
reported before [N]; no part of the force."""

FRICTION_BEFORE = 12
"""The same of the rupture reported before [N]."""

COLOURED_NOISE = 13
"""Coloured noise of the force sensor [N]."""

HEARTBEAT = 14
"""Force by the heartbeat [N]; its rate [N/s] follows it."""

HEARTBEAT_RATE = 15
"""Rate of the force by the heartbeat [N/s]."""

BREATHING = 16
"""Force by breathing [N]; its rate follows it."""

BREATHING_RATE = 17
"""Rate of the force by breathing [N/s]."""

MODEL_ERROR = 18
"""Error of this model [N]; its slope follows it."""

MODEL_ERROR_SLOPE = 19
"""Slope of that error over travel [N/mm]."""

UNKNOWNS = 20
"""Number of unknowns."""

TIP_BEGIN = RELEASED
"""The first unknown of the force at the tip."""

TIP_END = FADING + 1
"""The first unknown behind those of the force at the tip."""

AIR = 0.0
"""Medium of a tip that touches nothing."""

LAYER = 1.0
"""Medium of a tip that cuts through a layer, with friction on the shaft."""

MEMBRANE = 2.0
"""Medium of a tip that pushes a membrane, which it has not cut yet."""

NO_RELEASE_MM = -1e9
"""Depth of a release that there was not."""

NEVER_MM = -1e8
"""Every release lies deeper than this, `NO_RELEASE_MM` does not."""

CUTTING_ONSET_MM = 1.0
"""Travel until a new layer's cutting force is full: a needle's diameter."""

FADING_MM = 5.0
"""Travel over which a tip force that outlasts its rupture fades: chosen."""

MODEL_ERROR_FRACTION = 0.03
"""Standard deviation of the linear model's error, as a fraction of the tip force."""

MODEL_ERROR_MM = 5.0
"""Correlation length of that error."""

TRAVERSED_ERROR_FRACTION = 0.1
"""Fraction of that error which friction of the layers traversed has: it depends on the
motion alone."""


@dataclass(slots=True)
class Assumptions:
    """What a hypothesis takes for granted, and the regressor depends on.

    All are floats, so that a record of them is a row of numbers.

    Attributes:
        medium: What the tip is in: `AIR`, `LAYER` or `MEMBRANE`.
        layer_start_mm: Depth at which the layer's friction begins.
        tip_start_mm: Depth at which the layer's tip force begins.
        release_start_mm: Depth of the last release, `NO_RELEASE_MM` without one.
        release_length_mm: Travel that the release takes.
        holds_force: 1 where `HELD` is force held after a rupture, 0 where it cuts.
        is_fraction_used: 1 once the prior of friction's fraction has been used.
        ruptures: Number of ruptures, at most one more than were reported.
        unchecked_force_N: Force of the layer before, until its release was checked.
        is_punctured: 1 where the layer was entered through a membrane.
    """

    medium: float = AIR
    layer_start_mm: float = 0.0
    tip_start_mm: float = 0.0
    release_start_mm: float = NO_RELEASE_MM
    release_length_mm: float = 1.0
    holds_force: float = 0.0
    is_fraction_used: float = 1.0
    ruptures: float = 0.0
    unchecked_force_N: float = 0.0
    is_punctured: float = 0.0


@compiled
def regressor(assumption: Assumptions, block: Block) -> Vector:
    """Return the row of a hypothesis at a block's place: force = row @ unknowns.

    Returns:
        Shape (20,).
    """
    depth = block.depth_mm
    row = np.zeros(UNKNOWNS)
    release_travel = depth - assumption.release_start_mm
    completed = min(max(release_travel / assumption.release_length_mm, 0.0), 1.0)
    remaining = (1.0 - completed) ** 2
    travel = max(depth - assumption.tip_start_mm, 0.0)
    length = max(depth - assumption.layer_start_mm, 0.0)
    if assumption.is_punctured > 0.0:
        # Tissue that the membrane had pushed in springs back along the shaft with the
        # release.
        length *= 1.0 - remaining
    row[OFFSET] = 1.0
    row[TRAVERSED_COULOMB] = block.deflection
    row[TRAVERSED_VISCOUS] = block.speed_mm_s
    row[RELEASED] = remaining
    # The derivative of `remaining` by the logarithm of the release's length.
    row[RELEASE_STRETCH] = 2.0 * completed * (1.0 - completed)
    if assumption.holds_force > 0.0:
        row[HELD] = 1.0 - remaining
    else:
        onset = min(travel / CUTTING_ONSET_MM, 1.0)
        row[HELD] = onset * (2.0 - onset)
    row[STIFFNESS] = travel
    row[STIFFENING] = travel * travel
    if assumption.release_start_mm > NEVER_MM:
        row[FADING] = max(1.0 - release_travel / FADING_MM, 0.0) ** 2 - remaining
    row[LAYER_COULOMB] = block.deflection * length
    row[LAYER_VISCOUS] = block.speed_mm_s * length
    row[COLOURED_NOISE] = 1.0
    row[HEARTBEAT] = 1.0
    row[BREATHING] = 1.0
    row[MODEL_ERROR] = 1.0
    return row
