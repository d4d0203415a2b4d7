"""The catalogue of scenarios under their permanent names, and random ones.

The catalogue follows Sections II and VI of the paper. Random scenarios draw layers,
membranes, speed and motion within documented ranges, which span what the catalogue and
the real recordings show, with room on both sides, so that nothing can be tuned to a
dozen curves.
"""

import math
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from foundation.arrays import Array
from groundtruth.errors import ScenarioError
from groundtruth.layers import Layer, Membrane, ShaftFriction
from groundtruth.materials import ABDOMEN, BOVINE_LIVER, GLOVE, TABLE_I_SPEED_M_S, gel
from groundtruth.motion import (
    Motion,
    Move,
    constant_motion,
    protocol,
    sinusoidal_motion,
)
from groundtruth.variations import VARIATIONS, TissueVariation, random_variation

# What reaches arm and tissue from outside; no estimator learns of it but through the
# signals.


class Wave(NamedTuple):
    """A wave of `TissueMotion`.

    Attributes:
        amplitude_m: Half of its stroke.
        frequency_Hz: Waves per second.
        phase_rad: Phase at time zero.
    """

    amplitude_m: float
    frequency_Hz: float
    phase_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class TissueMotion:
    """Motion of the tissue along the needle, as with heart or breath: waves.

        x(t) = sum_i amplitude_i sin(2π frequency_i t + phase_i)

    Attributes:
        waves: Waves that add up.
    """

    waves: tuple[Wave, ...]

    def at(self, t_s: ArrayLike) -> tuple[Array, Array]:
        """Return position [m] and speed [m/s] of the undeformed surface.

        Both are positive away from the robot.
        """
        amplitude, frequency, phase = np.array(self.waves).T
        rate = 2.0 * np.pi * frequency
        angle = np.multiply.outer(np.asarray(t_s, dtype=np.float64), rate) + phase
        return np.sin(angle) @ amplitude, np.cos(angle) @ (rate * amplitude)


@dataclass(frozen=True, slots=True, kw_only=True)
class LateralForce:
    """Force of the tissue across the needle at its tip, in contact only.

    Attributes:
        constant_N: Force at the surface.
        growth_N_per_m: Growth of the force with depth.
        direction_rad: Direction at the surface, from the tool's x axis towards its y
            axis.
        turn_rad_per_m: Turn of that direction with depth.
    """

    constant_N: float = 0.0
    growth_N_per_m: float = 0.0
    direction_rad: float = 0.0
    turn_rad_per_m: float = 0.0

    def at(self, depth_m: float) -> tuple[float, float]:
        """Return the force on the needle along the tool's x and y axes [N]."""
        if depth_m <= 0.0:
            return 0.0, 0.0
        size = self.constant_N + self.growth_N_per_m * depth_m
        angle = self.direction_rad + self.turn_rad_per_m * depth_m
        return size * math.cos(angle), size * math.sin(angle)


@dataclass(frozen=True, slots=True, kw_only=True)
class ElbowPush:
    """Pushes of a hand on the elbow, each of half a sine.

    Attributes:
        force_N: The largest force, base axes.
        start_s: Time at which each push begins.
        duration_s: Length of each push in time.
    """

    force_N: tuple[float, float, float]
    start_s: tuple[float, ...]
    duration_s: float

    def at(self, t_s: float) -> Array:
        """Return the force on the elbow in base axes [N], shape (3,)."""
        phases = [(t_s - start) / self.duration_s for start in self.start_s]
        size = sum(math.sin(math.pi * phase) for phase in phases if 0.0 < phase < 1.0)
        return size * np.array(self.force_N)


@dataclass(frozen=True, slots=True, kw_only=True)
class Scenario:
    """One insertion, ready to be simulated: layers and motion.

    Attributes:
        id: Permanent name.
        title: One line for people.
        layers: First the one the needle meets first; none for free motion.
        motion: Motion of the needle tip relative to the undeformed surface.
        tissue_motion: Motion of the surface about its place.
        lateral: Force across the needle; a simulation of the needle alone does not feel
            it.
        elbow: Pushes on the elbow; a simulation of the needle alone does not feel them.
    """

    id: str
    title: str
    layers: tuple[Layer, ...]
    motion: Motion
    tissue_motion: TissueMotion | None = None
    lateral: LateralForce | None = None
    elbow: ElbowPush | None = None

    def with_variation(
        self, change: TissueVariation, rng: np.random.Generator
    ) -> "Scenario":
        """Return the same scenario with every layer changed.

        Args:
            change: What changes.
            rng: Draws the texture.
        """
        return replace(
            self, layers=tuple(change.layer(layer, rng) for layer in self.layers)
        )


CONSTANT_STANDOFF_M = 5e-3  # room to reach the constant speed before contact


def _insertions(
    name: str,
    title: str,
    layers: tuple[Layer, ...],
    speed_m_s: float,
    stroke_m: float | None,
) -> Iterator[Scenario]:
    """Yield the insertion at constant speed, and at sinusoidal with a stroke."""
    # How far a constant-speed insertion goes beyond the last layer
    beyond_m = 12e-3
    depth = sum(layer.thickness_m for layer in layers) + beyond_m
    even = constant_motion(
        speed_m_s=speed_m_s, depth_m=depth, standoff_m=CONSTANT_STANDOFF_M
    )
    motions = {"constant": even}
    if stroke_m is not None:
        # With a stroke of 70 mm the 70 % gel ruptures after 20.7 s; in the paper about
        # 20.
        motions["sinusoidal"] = sinusoidal_motion(
            stroke_m=stroke_m, frequency_hz=0.016, standoff_m=20e-3
        )
    for kind, motion in motions.items():
        line = f"{title}, {kind} speed"
        yield Scenario(id=f"{name}-{kind}", title=line, layers=layers, motion=motion)


def _catalogue() -> Iterator[Scenario]:
    gel_stroke_m = 70e-3
    # The full gels are 98 mm together, more than the paper's stroke for one.
    stack_stroke_m = 130e-3
    # The paper's speed for the stack with the glove
    glove_speed_m_s = 3e-3
    for percent in (25, 50, 70):
        name = f"gel-{percent}"
        title = f"one {percent} % isinglass gel"
        yield from _insertions(
            name, title, (gel(percent),), TABLE_I_SPEED_M_S, gel_stroke_m
        )
    bare = (gel(25), gel(50), gel(70))
    gloved = (gel(25), gel(50, membrane=GLOVE), gel(70, membrane=GLOVE))
    glove = "three gels, latex glove around the middle one"
    # 2.3 mm/s, not the glove's 3: the plateau is then the sum of Table I's products.
    yield from _insertions(
        "stack", "three gels", bare, TABLE_I_SPEED_M_S, stack_stroke_m
    )
    yield from _insertions(
        "stack-glove", glove, gloved, glove_speed_m_s, stack_stroke_m
    )
    liver = "bovine liver, capsule first"
    yield from _insertions("liver", liver, (BOVINE_LIVER,), TABLE_I_SPEED_M_S, None)
    sine = sinusoidal_motion(stroke_m=115e-3, frequency_hz=0.02, standoff_m=22e-3)
    title = "abdominal phantom: fat, muscle, liver; sinusoidal speed"
    yield Scenario(id="abdomen-sinusoidal", title=title, layers=ABDOMEN, motion=sine)
    yield Scenario(
        id="free-motion",
        title="no tissue",
        layers=(),
        # A sinusoid of 0.05 Hz that turns 20 mm above the surface.
        motion=protocol(20e-3 + 120e-3, [Move("cosine", 10.0, 120e-3)]),
    )


SCENARIOS = {
    item.id: item for item in _catalogue()
}  # Each of them under its permanent name


def scenario(name: str, seed: int = 0) -> Scenario:
    """Return a catalogued scenario, or one drawn from the seed.

    Args:
        name: As catalogued, or one of `DRAWN`; followed by ``+`` and one of
            `VARIATIONS`, in that tissue: ``stack-constant+texture-20mN``.
        seed: Of what is drawn.

    Raises:
        ScenarioError: There is none of that name; the message lists the names.
    """
    base, plus, change = name.partition("+")
    if base in DRAWN:
        chosen = DRAWN[base](np.random.default_rng(seed))
    elif base in SCENARIOS:
        chosen = SCENARIOS[base]
    else:
        known = ", ".join((*SCENARIOS, *DRAWN))
        raise ScenarioError(
            f"no scenario {base!r}; known: {known} (the last are drawn from a seed)"
        )
    if not plus:
        return chosen
    if change not in VARIATIONS:
        raise ScenarioError(f"no variation {change!r}; known: {', '.join(VARIATIONS)}")
    varied = chosen.with_variation(VARIATIONS[change], np.random.default_rng([seed, 1]))
    return replace(varied, id=name, title=f"{chosen.title}, {change}")


def random_stack(rng: np.random.Generator) -> Scenario:
    """Draw one to four layers and a speed profile.

    A quarter of the layers have a membrane.
    """
    # With the stretch beyond and the standoff, still short of the 153 mm needle.
    max_total_m = 110e-3
    count = int(rng.integers(1, 5))
    sine = bool(rng.random() < 0.5)
    # The peak of a sinusoid: gels 3.5, abdomen 7.2 mm/s. A constant speed: the paper
    # 2.3 and 3 mm/s, real liver 5 mm/s.
    speed = rng.uniform(3e-3, 8e-3) if sine else rng.uniform(2e-3, 6e-3)
    # From muscle over a rib to a slice of liver; gels are 28-38 mm.
    thickness = rng.uniform(10e-3, 40e-3, size=count)
    thickness *= min(1.0, max_total_m / thickness.sum())
    layers = tuple(
        _layer(rng, f"layer {i}", float(d), speed) for i, d in enumerate(thickness, 1)
    )
    depth = float(thickness.sum()) + rng.uniform(11e-3, 16e-3)
    if sine:
        # Deep enough in the stroke for contact at speed.
        standoff = rng.uniform(12e-3, 22e-3)
        stroke = depth + standoff
        motion = sinusoidal_motion(
            stroke_m=stroke, frequency_hz=speed / (np.pi * stroke), standoff_m=standoff
        )
    else:
        motion = constant_motion(
            speed_m_s=speed, depth_m=depth, standoff_m=CONSTANT_STANDOFF_M
        )
    kind = "sinusoidal" if sine else "constant"
    title = f"{count} random layers, {kind} speed up to {speed * 1e3:.1f} mm/s"
    return Scenario(id=RANDOM_STACK, title=title, layers=layers, motion=motion)


def random_tissue(rng: np.random.Generator) -> Scenario:
    """Draw a random stack, then the law of each of its layers."""
    stack = random_stack(rng)
    layers = tuple(random_variation(rng).layer(layer, rng) for layer in stack.layers)
    title = f"{stack.title}, each of its own law"
    return replace(stack, id=RANDOM_TISSUE, title=title, layers=layers)


def drawn_tissue(rng: np.random.Generator) -> Scenario:
    """Draw one to three layers, every property by itself, pushed through at 5 mm/s.

    `random_stack` draws the force at the end of a layer, and what fraction of it cuts.
    Here stiffness and cutting force are drawn, and the force at the end follows, so
    behind a rupture the tip goes on against the cutting force of what comes next.
    Friction and membranes are drawn as there: 4 to 40 N/m (a phantom's fat; gels, Ferro
    et al., Table I; human liver, de Jong 2017), rupture at 0.4 to 2 N (a phantom's
    skin; latex; capsule of bovine liver, Okamura, Simone, O'Leary 2004) after 0.1 to
    0.3 of the layer.

    Stiffness: 5 to 50 N/m; the gels, from Fig. 8 of Ferro et al., have 10 to 39.
    Cutting force: 0.1 to 0.9 N, chosen: the identifier's prior has no source for it.
    """
    speed_m_s = 5e-3  # of the recordings in liver
    count = int(rng.integers(1, 4))
    layers = []
    for number in range(1, count + 1):
        layer = _layer(rng, f"layer {number}", rng.uniform(15e-3, 30e-3), speed_m_s)
        cutting_N = _log_uniform(rng, 0.1, 0.9)
        cut_m = layer.thickness_m - layer.entry_m
        exit_N = cutting_N + _log_uniform(rng, 5.0, 50.0) * cut_m
        fraction = cutting_N / exit_N
        layers.append(replace(layer, exit_force_N=exit_N, cutting_fraction=fraction))
    depth_m = sum(layer.thickness_m for layer in layers) + 12e-3
    return Scenario(
        id=DRAWN_TISSUE,
        title=f"{count} layers of drawn stiffness, cutting force and friction, 5 mm/s",
        layers=tuple(layers),
        motion=constant_motion(
            speed_m_s=speed_m_s, depth_m=depth_m, standoff_m=CONSTANT_STANDOFF_M
        ),
    )


RANDOM_STACK = "random-stack"
"""The id of every drawn scenario under the catalogue's law."""
RANDOM_TISSUE = "random-tissue"
"""The id of those whose layers draw their law too."""
DRAWN_TISSUE = "drawn-tissue"
"""The id of those whose properties are drawn each by itself."""
DRAWN = {
    RANDOM_STACK: random_stack,
    RANDOM_TISSUE: random_tissue,
    DRAWN_TISSUE: drawn_tissue,
}
"""What draws a scenario, by its id."""


def _log_uniform(rng: np.random.Generator, low: float, high: float) -> float:
    """Draw a quantity of scale: equal chance per octave."""
    return float(np.exp(rng.uniform(np.log(low), np.log(high))))


def _layer(
    rng: np.random.Generator, name: str, thickness_m: float, speed_m_s: float
) -> Layer:
    """Draw a layer of a random stack, with what its nominal speed makes of friction."""
    # Arguments are drawn in this order: another order gives other scenarios for the
    # same seed.
    friction = ShaftFriction.calibrated(
        # Phantom fat 4, gels 9-38, real liver 6.5-18.
        force_N_per_m=_log_uniform(rng, 4.0, 40.0),
        reference_speed_m_s=speed_m_s,
        coulomb_fraction=rng.uniform(0.2, 0.8),  # gels 0.4, liver 0.8
        presliding_m=rng.uniform(0.1e-3, 0.9e-3),  # gels 0.2, liver 0.9 mm
    )
    return Layer(
        # At the end of gels 0.3-1.4 N; ruptures in real liver drop 0.15-1.4 N.
        exit_force_N=_log_uniform(rng, 0.15, 2.0),
        name=name,
        thickness_m=thickness_m,
        cutting_fraction=rng.uniform(0.0, 0.2),
        stiffening=rng.uniform(0.0, 0.3),
        release_m=rng.uniform(0.1e-3, 0.5e-3),  # in gels and most tissues
        relaxed_fraction=rng.uniform(0.1, 0.6),  # gels 0.2, liver 0.55
        friction=friction,
        membrane=_membrane(rng, thickness_m) if rng.random() < 0.25 else None,
    )


def _membrane(rng: np.random.Generator, thickness_m: float) -> Membrane:
    """Draw the membrane of a layer."""
    return Membrane(
        # Phantom skin 0.6, latex 1.0, bovine liver capsule 1.43 N
        puncture_N=_log_uniform(rng, 0.4, 2.0),
        # The bovine capsule's is 11 mm on 32.
        indentation_m=rng.uniform(0.1, 0.3) * thickness_m,
        hardening=rng.uniform(0.3, 1.0),
        release_m=rng.uniform(0.1e-3, 0.5e-3),
    )
