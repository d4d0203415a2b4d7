"""Random scenarios: layers, membranes, speed and motion drawn within documented ranges.

The ranges span what the catalogue and the real recordings show, with room on both sides, so that
nothing can be tuned to a dozen curves.
"""

import numpy as np

from groundtruth.friction import ShaftFriction
from groundtruth.layer import Layer
from groundtruth.membrane import Membrane
from groundtruth.motion import Motion, constant_motion, sinusoidal_motion
from groundtruth.scenario import Scenario

RANDOM_STACK = "random-stack"
"""The id of every drawn scenario."""

LAYERS = (1, 4)
THICKNESS_M = (10e-3, 40e-3)
"""From muscle over a rib to a slice of liver; gels are 28-38 mm."""
TOTAL_MAX_M = 110e-3
"""With the stretch beyond and the standoff, still short of the 153 mm needle."""
FRICTION_N_PER_M = (4.0, 40.0)
"""At the nominal speed: phantom fat 4, gels 9-38, real liver 6.5-18."""
COULOMB_SHARE = (0.2, 0.8)
"""Gels 0.4, liver 0.8."""
PRESLIDING_M = (0.1e-3, 0.9e-3)
"""Gels 0.2, liver 0.9 mm."""
RELAXED_SHARE = (0.1, 0.6)
"""Gels 0.2, liver 0.55."""
EXIT_FORCE_N = (0.15, 2.0)
"""Tip force at the end of a layer: gels 0.3-1.4 N; ruptures in real liver drop 0.15-1.4 N."""
CUTTING_SHARE = (0.0, 0.2)
STIFFENING = (0.0, 0.3)
RELEASE_M = (0.1e-3, 0.5e-3)
"""Travel of a release in gels and most tissues."""
MEMBRANE_CHANCE = 0.25
PUNCTURE_N = (0.4, 2.0)
"""Phantom skin 0.6, latex 1.0, bovine liver capsule 1.43 N."""
INDENTATION_SHARE = (0.1, 0.3)
"""Of the layer's thickness: the bovine capsule gives 11 mm on 32."""
HARDENING = (0.3, 1.0)
SPEED_M_S = (2e-3, 6e-3)
"""Constant speed: the paper 2.3 and 3 mm/s, real liver 5 mm/s."""
PEAK_SPEED_M_S = (3e-3, 8e-3)
"""Of a sinusoid: gels 3.5, abdomen 7.2 mm/s."""
BEYOND_M = (11e-3, 16e-3)
CONSTANT_STANDOFF_M = 5e-3
SINE_STANDOFF_M = (12e-3, 22e-3)
"""Deep enough inside the stroke for contact at speed."""


def _uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    return float(rng.uniform(*limits))


def _log_uniform(rng: np.random.Generator, limits: tuple[float, float]) -> float:
    """Equal chance per octave: a quantity of scale, not of place."""
    return float(np.exp(rng.uniform(*np.log(limits))))


def _membrane(rng: np.random.Generator, thickness_m: float) -> Membrane | None:
    if rng.random() >= MEMBRANE_CHANCE:
        return None
    return Membrane(
        puncture_N=_log_uniform(rng, PUNCTURE_N),
        indentation_m=_uniform(rng, INDENTATION_SHARE) * thickness_m,
        hardening=_uniform(rng, HARDENING),
        release_m=_uniform(rng, RELEASE_M),
    )


def _layer(rng: np.random.Generator, name: str, thickness_m: float, speed_m_s: float) -> Layer:
    friction = ShaftFriction.calibrated(
        force_N_per_m=_log_uniform(rng, FRICTION_N_PER_M),
        reference_speed_m_s=speed_m_s,
        coulomb_share=_uniform(rng, COULOMB_SHARE),
        presliding_m=_uniform(rng, PRESLIDING_M),
    )
    return Layer(
        exit_force_N=_log_uniform(rng, EXIT_FORCE_N),
        name=name,
        thickness_m=thickness_m,
        cutting_share=_uniform(rng, CUTTING_SHARE),
        stiffening=_uniform(rng, STIFFENING),
        release_m=_uniform(rng, RELEASE_M),
        relaxed_share=_uniform(rng, RELAXED_SHARE),
        friction=friction,
        membrane=_membrane(rng, thickness_m),
    )


def _motion(rng: np.random.Generator, total_m: float, speed_m_s: float, *, sine: bool) -> Motion:
    depth = total_m + _uniform(rng, BEYOND_M)
    if not sine:
        return constant_motion(speed_m_s=speed_m_s, depth_m=depth, standoff_m=CONSTANT_STANDOFF_M)
    standoff = _uniform(rng, SINE_STANDOFF_M)
    stroke = depth + standoff
    return sinusoidal_motion(
        stroke_m=stroke, frequency_hz=speed_m_s / (np.pi * stroke), standoff_m=standoff
    )


def random_stack(rng: np.random.Generator) -> Scenario:
    """Draw a scenario: one to four layers, a speed profile, membranes on a quarter of the layers.

    Args:
        rng: Source of everything drawn.
    """
    count = int(rng.integers(LAYERS[0], LAYERS[1] + 1))
    sine = bool(rng.random() < 0.5)
    speed = _uniform(rng, PEAK_SPEED_M_S if sine else SPEED_M_S)
    thickness = rng.uniform(*THICKNESS_M, size=count)
    thickness *= min(1.0, TOTAL_MAX_M / thickness.sum())
    layers = tuple(
        _layer(rng, f"layer {i}", float(d), speed) for i, d in enumerate(thickness, start=1)
    )
    kind = "sinusoidal" if sine else "constant"
    return Scenario(
        id=RANDOM_STACK,
        title=f"{count} random layers, {kind} speed up to {speed * 1e3:.1f} mm/s",
        layers=layers,
        motion=_motion(rng, float(thickness.sum()), speed, sine=sine),
    )
