"""The force of one hypothesis: linear in twenty unknowns, given a history of ruptures.

This is the material law of the estimator; what a rupture does is left to `events`.

A hypothesis assumes where the tissue ruptured and what the tip is in (`Assumptions`).
The axial force is then

    f = o + C w + V v + R r(z) + L l(z) + T t(z) + K x + H x² + U u(z) + c y w + b y v +
    d + e

with the unknowns, in the order of their indices:

- o: offset, the force in free air;
- C, V: Coulomb and viscous friction of the layers traversed;
- R: tip force at the last rupture, which its release takes away with travel;
- L: correction of R r(z) for a release that is longer than assumed;
- T: cutting force, or a tip force that is held (see `HELD`);
- K, H: stiffness, and half its growth with travel (see `STIFFENING`);
- U: tip force that outlasts the release and fades later;
- c, b: Coulomb and viscous friction per length of shaft in the layer;
- d: disturbances, the sum of coloured sensor noise, heartbeat, breathing and the error
  of this model.

The white noise e is no unknown. The known factors are:

- w: presliding deflection, 1 when the shaft slides inwards;
- v: speed;
- x: travel of the tip since its last event;
- y: length of shaft in the layer;
- r(z), l(z), t(z), u(z): functions of the depth z, see `regressor`.

Equation (3) of the paper has a stiffness and purely viscous friction for each layer.
This force replaces it: it adds Coulomb friction, a cutting force, releases of the tip
force and disturbances.

Each hypothesis is a Kalman filter (switching linear model, Shumway and Stoffer 1991),
and how well it predicts the force is the evidence for it. Lengths are in mm, speeds in
mm/s, forces in N.

Two unknowns are no part of the force: the friction record. `FRICTION_LAST` is the
friction of the section of shaft between the last two ruptures, as it was at the last
one, and `FRICTION_BEFORE` that of the section before. The filter keeps both, for the
layer report, because force measured later still corrects them. See
`events.begins_friction_record` for where a section begins.
"""

import math
from dataclasses import dataclass

import numpy as np

from foundation.arrays import Vector
from foundation.jit import compiled, compiled_inside
from identification.mixture.block import Block

OFFSET = 0
"""o: force in free air [N]."""

TRAVERSED_COULOMB = 1
"""C: Coulomb friction of the layers traversed [N]."""

TRAVERSED_VISCOUS = 2
"""V: viscous friction of the layers traversed [N/(mm/s)]."""

RELEASED = 3
"""R: whole tip force at the last rupture [N]. What is released is R less the part that
fades (`FADING`)."""

RELEASE_STRETCH = 4
"""L: R times the relative error of the release's length [N]."""

HELD = 5
"""T [N], with two uses: the cutting force, reached `CUTTING_ONSET_MM` into a layer; or
the whole tip force at which a membrane was met under a layer, until it ruptures.
`Assumptions.holds_force` is 0 for the first, 1 for the second."""

STIFFNESS = 6
"""K: growth of the tip force with travel [N/mm]."""

STIFFENING = 7
"""H: half the growth of the stiffness with travel [N/mm²]. The term is H x², so the
stiffness grows by 2 H per mm."""

FADING = 8
"""U: tip force that outlasts the release and then fades [N]."""

LAYER_COULOMB = 9
"""c: Coulomb friction per length of shaft in the layer [N/mm]."""

LAYER_VISCOUS = 10
"""b: viscous friction per length of shaft in the layer [N/(mm mm/s)]."""

FRICTION_LAST = 11
"""Friction record: friction of the section of shaft between the last two ruptures, as
it was at the last one [N]. It is kept for the layer report and no part of the force."""

FRICTION_BEFORE = 12
"""Friction record: the same for the section before that one [N]."""

COLOURED_NOISE = 13
"""Coloured noise of the force sensor [N]."""

HEARTBEAT = 14
"""Force by the heartbeat [N]; its rate [N/s] follows it."""

BREATHING = 16
"""Force by breathing [N]; its rate follows it."""

MODEL_ERROR = 18
"""Error of this model [N]; its slope follows it."""

MODEL_ERROR_SLOPE = 19
"""Slope of the model's error over travel [N/mm]."""

UNKNOWNS = 20
"""Number of unknowns."""

TIP_BEGIN = RELEASED
"""The first unknown of the force at the tip."""

TIP_END = FADING + 1
"""Index after the last unknown of the force at the tip."""

AIR = 0.0
"""Medium of a tip that touches nothing."""

LAYER = 1.0
"""Medium of a tip that cuts through a layer, with friction on the shaft."""

MEMBRANE = 2.0
"""Medium of a tip that pushes a membrane, which it has not cut yet."""

NO_RELEASE_MM = -1e9
"""Value of `release_start_mm` without a release."""

CUTTING_ONSET_MM = 1.0
"""Travel until a new layer's cutting force is full: a needle's diameter."""

MODEL_ERROR_FRACTION = 0.03
"""Standard deviation of this model's error, as a fraction of the force less the
friction of the layers traversed."""

MODEL_ERROR_MM = 5.0
"""Correlation length of the model's error."""

TRAVERSED_ERROR_FRACTION = 0.1
"""Weight of shaft friction beside the tip force, where the model's error is computed:
friction that stays on the shaft depends on the motion alone, so the model errs less."""

CUTTING_ON_SHAFT = 0.4
"""Mean fraction of the undecided force that is friction of the shaft: see
`undecided_cutting`."""

CUTTING_ON_SHAFT_STD = 0.35
"""Standard deviation of that fraction."""


@dataclass(slots=True)
class Assumptions:
    """What a hypothesis assumes, and what the regressor depends on.

    All are floats, so that a record of them is a row of numbers. "Reported" is a
    rupture of which the caller has been told by an alarm that still stands.

    Attributes:
        medium: What the tip is in: `AIR`, `LAYER` or `MEMBRANE`.
        layer_start_mm: Depth at which the layer's friction begins.
        tip_start_mm: Depth at which the layer's tip force begins.
        release_start_mm: Depth of the last release, `NO_RELEASE_MM` without one.
        release_length_mm: Travel that the release takes.
        holds_force: 1 where `HELD` is the tip force at which a membrane was met under a
            layer, 0 where it is the cutting force.
        prior_speed_mm_s: Speed at which the layer's first prior was made, while
            `priors.use_friction_fraction` is still to be applied in it; then, in air
            and at a membrane 0.
        ruptures: Number of ruptures; counts at most one more than were reported.
        unchecked_force_N: Force of the layer before, until its release has been
            checked; then 0.
        is_punctured: 1 where the layer was entered through a membrane.
    """

    medium: float = AIR
    layer_start_mm: float = 0.0
    tip_start_mm: float = 0.0
    release_start_mm: float = NO_RELEASE_MM
    release_length_mm: float = 1.0
    holds_force: float = 0.0
    prior_speed_mm_s: float = 0.0
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
    # The derivative of `remaining` with respect to the logarithm of release length.
    row[RELEASE_STRETCH] = 2.0 * completed * (1.0 - completed)
    if assumption.holds_force > 0.0:
        row[HELD] = 1.0 - remaining
    else:
        onset = min(travel / CUTTING_ONSET_MM, 1.0)
        row[HELD] = onset * (2.0 - onset)
    row[STIFFNESS] = travel
    row[STIFFENING] = travel * travel
    if assumption.release_start_mm > NO_RELEASE_MM:
        # A tip force that outlasts its rupture fades over 5 mm: chosen.
        row[FADING] = max(1.0 - release_travel / 5.0, 0.0) ** 2 - remaining
    row[LAYER_COULOMB] = block.deflection * length
    row[LAYER_VISCOUS] = block.speed_mm_s * length
    row[COLOURED_NOISE] = 1.0
    row[HEARTBEAT] = 1.0
    row[BREATHING] = 1.0
    row[MODEL_ERROR] = 1.0
    return row


@compiled_inside
def undecided_cutting(assumption: Assumptions, depth_mm: float) -> tuple[float, float]:
    """Return how much of what began as cutting force may be friction by now.

    At constant speed a force that was there from the layer's beginning looks the same
    whether it stays at the tip, as a cutting force does, or has become friction of a
    shaft that tissue grips. Nothing decides between the two before the next rupture.
    The fraction of it that is friction grows with travel x as
    ``CUTTING_ON_SHAFT * (1 - exp(-x / 10 mm))``.

    Returns:
        The fraction of the cutting force that is undecided, 0 to 1, and its growth with
        travel [1/mm].
    """
    undecided_mm = 10.0
    if assumption.medium != LAYER:
        return 0.0, 0.0
    travel = max(depth_mm - assumption.tip_start_mm, 0.0)
    remaining = math.exp(-travel / undecided_mm)
    return 1.0 - remaining, remaining / undecided_mm
